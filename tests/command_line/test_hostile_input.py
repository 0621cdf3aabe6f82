"""Input that means harm or nonsense: refused in words, before anything is run or meshed."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

import meshes
from app.case import overlay
from app.case import sweep as sweep_file
from app.case.case import load, resolve
from app.case.gmsh_header import ALLOWED
from app.cli import main
from app.foundation.errors import GeometryError, InputError
from app.schema import yaml_file
from app.schema.units import LONGEST_VALUE
from app.soundness import cost, memory
from tests import support
from tests.cases.gmsh_scripts import LAYERS, script
from tests.support import CONFIGS

BLOCKS = CONFIGS / "blocks.yaml"


# All that mesh a case, or say what that would be.
COMMANDS = (
    *("run case.yaml", "check case.yaml", "check case.yaml --mesh", "mesh case.yaml"),
    *("study study.yaml", "sweep sweep.yaml"),
)


def complaint(path: Path, *overrides: str) -> str:
    """The message on a file with one defect."""
    with pytest.raises(InputError) as caught:
        load(path, overrides)
    (message,) = caught.value.messages
    assert message.isprintable()
    return message


def test_texts_without_end(tmp_path: Path) -> None:
    path = tmp_path / "case.yaml"
    path.write_text(f"title: {'x' * 10_001}\n")
    assert complaint(path) == f"{path}:1:8: a text of 10001 characters; at most 10000"
    long = complaint(BLOCKS, f"mesh.size=1{' ' * LONGEST_VALUE}mm")
    assert long.startswith("--set mesh.size: '1   ") and len(long) < 200


def test_a_file_too_long_to_be_a_case_is_not_read_to_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "case.yaml"
    monkeypatch.setattr(yaml_file, "MOST_NODES", 1000)
    path.write_text("a: [" + "1," * (yaml_file.MOST_NODES + 10))
    assert "too many or too deeply nested values" in complaint(path)
    path.write_text("#" * yaml_file.LARGEST + "\n")
    assert complaint(path) == f"{path}: is larger than 4 MB; no case is"
    assert complaint(Path("/dev/zero")) == "/dev/zero: is larger than 4 MB; no case is"


def test_combinations_beyond_number(tmp_path: Path) -> None:
    path = tmp_path / "sweep.yaml"
    values = f"[{', '.join(map(str, range(40)))}]"
    axes = "".join(f"  a.b{i}: {values}\n" for i in range(6))
    path.write_text(f"base: {BLOCKS}\ngrid:\n{axes}")
    with pytest.raises(InputError, match="4096000000 combinations; at most 20000 are allowed"):
        sweep_file.read(path)


# ------------------------------------------------------------------------------------ size


@pytest.mark.parametrize("name", ["blocks", "cylinders", "stance", "cure"])
@pytest.mark.parametrize("command", ["run", "mesh", "check"])
def test_a_mesh_of_a_nanometre_is_refused_with_the_estimate(
    name: str, command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = CONFIGS / f"{name}.yaml"
    arguments = [] if command == "check" else ["-o", str(tmp_path / "out")]
    # What the command line gives wins; far_size, where the case gives it, stays as it is.
    assert main([command, str(path), *arguments, "--set", "mesh.size=1 nm"]) == 2
    said = capsys.readouterr().err
    assert "\n--set mesh.size: 1e-06 mm makes about " in f"\n{said}"
    for word in (" cells", " unknowns", " GB", " would do"):
        assert word in said
    assert not (tmp_path / "out").exists()


def test_the_size_that_would_do_does(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "available", lambda: 8e9)
    file = overlay.read(BLOCKS, ["mesh.size=1e-3 mm"])
    with pytest.raises(InputError) as caught:
        memory.check(file, resolve(file, BLOCKS.parent))
    size = str(caught.value).split("; ")[-1].removesuffix(" would do")
    case = load(BLOCKS, [f"mesh.size={size}"]).config
    assert 0.5 * 8e9 < memory.needed(case) <= 8e9
    assert cost.unknowns(case) > 1e5


@pytest.mark.parametrize("option", ["around=900", "around=0.06 mm", "along=0.01 mm"])
def test_the_lines_and_steps_that_would_do_do(option: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The key that makes the mesh too large is refused, with its value that fits."""
    monkeypatch.setattr(memory, "available", lambda: 8e9)
    path, key = CONFIGS / "stance.yaml", option.split("=")[0]
    file = overlay.read(path, [f"mesh.{option}"])
    with pytest.raises(InputError, match=rf"mesh\.{key}: .* would do") as caught:
        memory.check(file, resolve(file, CONFIGS))
    fits = str(caught.value).split("; ")[-1].removesuffix(" would do").removesuffix(" lines")
    assert 0.5 * 8e9 < memory.needed(load(path, [f"mesh.{key}={fits}"]).config) <= 8e9


@pytest.mark.parametrize(
    ("option", "why"),
    [
        ("around=11 mm", "11 mm: the stem is 43.2 mm around .*; expected 0.043 to 10.8 mm"),
        ("around=0.04 mm", "0.04 mm: the stem is 43.2 mm around .*; expected 0.043 to 10.8 mm"),
        ("along=21 mm", "21 mm: no part holds such steps; expected at most 20 mm"),
        ("around=1.4", "1.4 is not a whole number; a distance needs a unit, e.g. '1.4 mm'"),
        ("around=3", "3 must be at least 4"),
        ("around=28 kg", "'28 kg' is not a number of lines or a length such as '1.4 mm'"),
    ],
)
def test_lines_that_the_stem_cannot_hold_are_refused(option: str, why: str) -> None:
    with pytest.raises(InputError, match=rf"--set mesh\.{option.split('=')[0]}: {why}"):
        load(CONFIGS / "stance.yaml", [f"mesh.{option}"])


def test_a_geometry_too_large_for_any_mesh_has_no_size_that_would_do() -> None:
    file = overlay.read(
        CONFIGS / "cylinders.yaml", ["geometry.length=1e10 mm", "geometry.taper=0 deg"]
    )
    with pytest.raises(InputError, match=r"mesh.size: 2 mm makes about .*[\d,]+\.\d GB$"):
        memory.check(file, resolve(file, CONFIGS))


@pytest.mark.parametrize(
    "environ",
    [{"SLURM_NNODES": "4"}, {"OMPI_COMM_WORLD_SIZE": "8", "OMPI_COMM_WORLD_LOCAL_SIZE": "2"}],
)
def test_several_machines_have_more_memory(environ: dict[str, str]) -> None:
    assert memory.available(environ) == 4 * memory.available({})


# What /proc/self/cgroup holds, and the limits below /sys/fs/cgroup, as systemd, Slurm and Docker
# make them: the least that holds for the process counts, of itself or of any above.
CGROUPS = {
    "systemd": ("0::/user.slice/run-1.scope\n", {"user.slice/run-1.scope/memory.max": "2e9"}),
    "of a parent": (
        "0::/a/b/c\n",
        {"a/memory.max": "2e9", "a/b/memory.max": "max", "a/b/c/memory.max": "3e9"},
    ),
    "Slurm": (
        "9:name=systemd:/\n4:cpu,memory:/slurm/uid_1/job_7/step_0\n0::/\n",
        {
            "memory/slurm/uid_1/job_7/step_0/memory.limit_in_bytes": "9223372036854771712",
            "memory/slurm/uid_1/job_7/memory.limit_in_bytes": "2e9",
            "memory/memory.limit_in_bytes": "9223372036854771712",
        },
    ),
    "container": ("4:memory:/docker/0ab1\n", {"memory/memory.limit_in_bytes": "2e9"}),
    "others": ("0::/mine\n", {"mine/memory.max": "2e9", "theirs/memory.max": "1e9"}),
}


@pytest.mark.parametrize("name", CGROUPS)
def test_memory_is_what_the_group_of_the_process_may_use(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    groups, limits = CGROUPS[name]
    (tmp_path / "cgroup").write_text(groups)
    for file, limit in limits.items():
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).write_text(limit if limit == "max" else f"{float(limit):.0f}\n")
    monkeypatch.setattr(memory, "OWN_GROUPS", tmp_path / "cgroup")
    monkeypatch.setattr(memory, "GROUPS", tmp_path)
    assert memory.available({}) == 2e9


# --------------------------------------------------------------------------------- scripts


@pytest.mark.parametrize("command", COMMANDS)
def test_scripts_are_run_only_where_that_is_allowed(
    command: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """No list of words tells what is harmless: in single quotes gmsh runs another script too."""
    monkeypatch.chdir(tmp_path)
    script(tmp_path, f"{LAYERS}Merge 'other.geo';\n")
    Path("other.geo").write_text('SystemCall "touch PWNED";\n')
    study = CONFIGS / "studies" / "errors_hertz_line.yaml"
    Path("study.yaml").write_text(re.sub("base: .*", "base: case.yaml", study.read_text()))
    Path("sweep.yaml").write_text("base: case.yaml\ngrid: {mesh.size: [0.5 mm]}\n")
    assert main(command.split()) == 2
    said = capsys.readouterr().err
    assert "case.yaml:1:24: geometry.path: 'a.geo': a gmsh script is a program" in said
    assert "--allow-scripts" in said
    assert not Path("PWNED").exists()


def test_a_script_that_is_trusted_is_run(tmp_path: Path) -> None:
    """By a case of a sweep: what is allowed on the command line holds for all that it starts."""
    script(tmp_path, LAYERS)
    (tmp_path / "sweep.yaml").write_text(
        "base: case.yaml\nset: {output.fields: false}\ngrid: {mesh.size: [0.5 mm]}\n"
    )
    command = ["-m", "mantle", "sweep", "sweep.yaml", "-o", "out", "--allow-scripts"]
    support.python(*command, cwd=tmp_path)
    assert list(tmp_path.glob("out/runs/*/DONE"))


def test_scripts_of_mantle_itself_are_run(tmp_path: Path) -> None:
    """By their place: a link to another is none of them."""
    case = CONFIGS / "verification" / "cook.yaml"
    assert load(case).config.geometry.region_names
    script(tmp_path, LAYERS)
    copy = tmp_path / "configs" / "verification"
    copy.mkdir(parents=True)
    for name in ("cook.yaml", "cook.geo"):
        shutil.copy(case.with_name(name), copy)
    assert "--allow-scripts" in complaint(copy / "cook.yaml")


def test_options_beside_a_mesh_are_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """gmsh would run them: it never sees them."""
    monkeypatch.setenv(ALLOWED, "1")
    script(tmp_path, LAYERS)
    (tmp_path / "a.geo.opt").write_text('Error("the options were run");')
    case = load(tmp_path / "case.yaml").config
    assert len(meshes.build(case.geometry, case.mesh).cells)


def test_a_script_is_not_meshed_by_the_nanometre(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(ALLOWED, "1")
    script(tmp_path, LAYERS)
    case = load(tmp_path / "case.yaml", ["mesh.size=1 nm"]).config
    with pytest.raises(GeometryError, match=r"mesh\.size: 1e-06 mm: .* 5e\+06 cells long"):
        meshes.build(case.geometry, case.mesh, None)


# ----------------------------------------------------------------------------------- folders


@pytest.mark.parametrize("name", ["../up", "..", ".", "a/b", "/tmp/x", "a b", "$(touch PWNED)", ""])
def test_names_that_become_folders_or_columns_lead_nowhere_else(name: str, tmp_path: Path) -> None:
    path = tmp_path / "case.yaml"
    quoted = name.replace("'", "''")
    path.write_text(f"{BLOCKS.read_text()}\nvariations: {{'{quoted}': {{}}, other: {{}}}}\n")
    assert f"'{name}' is not a name" in complaint(path) or not name
    path.write_text(
        f"{BLOCKS.read_text()}\noutput: {{probes: {{'{quoted}': {{at: [0, 0, 0]}}}}}}\n"
    )
    with pytest.raises(InputError) as caught:
        load(path)
    assert any("is not a name" in m for m in caught.value.messages)
