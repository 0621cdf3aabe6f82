"""Meshes too large for the memory are refused with an estimate and a size that fits."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.case import overlay
from app.case.case import load_case, resolve
from app.cli import main
from app.foundation.errors import InputError
from app.soundness import cost, memory
from tests.support import CONFIGS

BLOCKS = CONFIGS / "blocks.yaml"


@pytest.mark.parametrize("name", ["blocks", "cylinders", "stance", "cure"])
@pytest.mark.parametrize("command", ["run", "mesh", "check"])
def test_memory_refuses_a_mesh_of_a_nanometre(
    name: str, command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = CONFIGS / f"{name}.yaml"
    arguments = [] if command == "check" else ["-o", str(tmp_path / "out")]
    # What the command line gives wins; far_size, where the case gives it, stays as it is.
    assert main([command, str(path), *arguments, "--set", "mesh.size=1 nm"]) == 2
    printed = capsys.readouterr().err
    assert "\n--set mesh.size: 1e-06 mm makes about " in f"\n{printed}"
    for word in (" cells", " unknowns", " GB", " fits into the memory"):
        assert word in printed
    assert not (tmp_path / "out").exists()


def test_memory_suggested_size_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "available_memory", lambda: 8e9)
    file = overlay.read(BLOCKS, ["mesh.size=1e-3 mm"])
    with pytest.raises(InputError) as caught:
        memory.check(file, resolve(file, BLOCKS.parent))
    size = str(caught.value).split("; ")[-1].removesuffix(" fits into the memory")
    case = load_case(BLOCKS, [f"mesh.size={size}"]).config
    assert 0.5 * 8e9 < memory.needed(case) <= 8e9
    assert cost.estimated_unknowns(case) > 1e5


@pytest.mark.parametrize("option", ["around=900", "around=0.06 mm", "along=0.01 mm"])
def test_memory_suggested_lines_and_steps_fit(option: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The key that makes the mesh too large is refused, with a value that fits."""
    monkeypatch.setattr(memory, "available_memory", lambda: 8e9)
    path, key = CONFIGS / "stance.yaml", option.split("=")[0]
    file = overlay.read(path, [f"mesh.{option}"])
    with pytest.raises(InputError, match=rf"mesh\.{key}: .* fits into the memory") as caught:
        memory.check(file, resolve(file, CONFIGS))
    hint = str(caught.value).split("; ")[-1]
    fits = hint.removesuffix(" fits into the memory").removesuffix(" lines")
    assert 0.5 * 8e9 < memory.needed(load_case(path, [f"mesh.{key}={fits}"]).config) <= 8e9


PERIMETER = "the section of the stem has a perimeter of 43.2 mm; expected 0.043 to 10.8 mm"


@pytest.mark.parametrize(
    ("option", "why"),
    [
        ("around=11 mm", f"11 mm: {PERIMETER}"),
        ("around=0.04 mm", f"0.04 mm: {PERIMETER}"),
        ("along=21 mm", "21 mm: is longer than every part; expected at most 20 mm"),
        ("around=1.4", "1.4 is not a whole number; a distance needs a unit, e.g. '1.4 mm'"),
        ("around=3", "3 must be at least 4"),
        ("around=28 kg", "'28 kg' is not a number of lines or a length such as '1.4 mm'"),
    ],
)
def test_memory_refuses_too_many_lines(option: str, why: str) -> None:
    with pytest.raises(InputError, match=rf"--set mesh\.{option.split('=')[0]}: {why}"):
        load_case(CONFIGS / "stance.yaml", [f"mesh.{option}"])


def test_memory_without_a_size_that_fits() -> None:
    file = overlay.read(
        CONFIGS / "cylinders.yaml", ["geometry.length=1e10 mm", "geometry.taper=0 deg"]
    )
    text = r"mesh.size: 2 mm makes about .*[\d,]+\.\d GB are available$"
    with pytest.raises(InputError, match=text):
        memory.check(file, resolve(file, CONFIGS))


@pytest.mark.parametrize(
    "environ",
    [{"SLURM_NNODES": "4"}, {"OMPI_COMM_WORLD_SIZE": "8", "OMPI_COMM_WORLD_LOCAL_SIZE": "2"}],
)
def test_memory_of_several_machines(environ: dict[str, str]) -> None:
    assert memory.available_memory(environ) == 4 * memory.available_memory({})


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
def test_memory_limit_of_the_process_group(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    groups, limits = CGROUPS[name]
    (tmp_path / "cgroup").write_text(groups)
    for file, limit in limits.items():
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).write_text(limit if limit == "max" else f"{float(limit):.0f}\n")
    monkeypatch.setattr(memory, "OWN_GROUPS", tmp_path / "cgroup")
    monkeypatch.setattr(memory, "GROUPS", tmp_path)
    assert memory.available_memory({}) == 2e9
