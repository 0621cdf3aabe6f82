"""Errors in case files, with line, column and message.

``bad_input.yaml`` edits good cases and lists every expected message, and no other.
"""

from __future__ import annotations

import errno
import re
from pathlib import Path

import pytest
from ruamel.yaml import YAML

import mantle
from app.case import sweep as sweep_file
from app.case.case import load_case
from app.cli import main
from app.foundation import files
from app.foundation.errors import InputError
from app.schema import yaml_file
from app.schema.units import LONGEST_VALUE
from tests import support
from tests.support import CONFIGS

TABLE = YAML(typ="safe", pure=True).load(Path(__file__).with_name("bad_input.yaml"))
GOOD = TABLE["press"]["case"]
EDITS = [(case, name) for case in TABLE for name in TABLE[case].get("edits", ())]
SETS = [(case, sets) for case in TABLE for sets in TABLE[case].get("sets", ())]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A good case."""
    (tmp_path / "case.yaml").write_text(GOOD)
    return tmp_path / "case.yaml"


def complaints(path: Path, *overrides: str) -> list[str]:
    with pytest.raises(InputError) as caught:
        load_case(path, overrides)
    return [m.removeprefix(f"{path}:") for m in caught.value.messages]


def check(reported: list[str], expected: list[str]) -> None:
    assert len(reported) == len(expected), reported
    for message, start in zip(reported, expected, strict=True):
        assert message.startswith(start) and message.isprintable()


@pytest.mark.parametrize(("case", "name"), EDITS)
def test_bad_input_complaint(case: str, name: str, path: Path) -> None:
    text = TABLE[case]["case"]
    rows = TABLE[case]["edits"][name]
    for old, new in (row for row in rows if isinstance(row, list)):
        assert old in text
        text = text.replace(old, new, 1)
    path.write_text(text)
    check(complaints(path), [row for row in rows if isinstance(row, str)])


@pytest.mark.parametrize(("case", "sets"), SETS)
def test_bad_input_override(case: str, sets: str, path: Path) -> None:
    path.write_text(TABLE[case]["case"])
    check(complaints(path, *sets.split(" --set ")), TABLE[case]["sets"][sets])


def test_bad_input_of_file_and_overrides_is_reported_together(path: Path) -> None:
    path.write_text(GOOD.replace("length: 20 mm", "length: 20"))
    reported = complaints(path, "mesh.size=3", "nonsense")
    assert [m.split(": ")[0] for m in reported] == ["7:3", "--set mesh.size", "--set nonsense"]


def test_bad_input_files_that_cannot_be_read(tmp_path: Path) -> None:
    assert complaints(tmp_path / "none.yaml") == [" no such file"]
    assert complaints(tmp_path) == [" is a folder; expected a YAML file"]
    latin = tmp_path / "latin.yaml"
    latin.write_bytes(b"title: a\n# \xb5m\n")
    assert complaints(latin) == ["2:3: not UTF-8 text (byte 0xb5)"]
    assert complaints(latin / "below")[0].startswith(" cannot be read: Not a dir")


def test_bad_input_aliases_cannot_blow_up(path: Path) -> None:
    rows = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    rows += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 12)]
    path.write_text("\n".join(rows))
    assert "too many or too deeply nested values" in complaints(path)[0]
    path.write_text("a: " + "[" * 3000)
    assert "not valid YAML" in complaints(path)[0]


def test_bad_input_thin_block_is_named() -> None:
    thin = "geometry.blocks.1.size=[10 mm, 10 mm, 0.01 mm]"
    reported = complaints(CONFIGS / "blocks.yaml", thin, "mesh.size=3 mm")
    assert (
        reported[0].startswith("--set geometry.blocks.1.size: ") or "blocks[1].size" in reported[0]
    )
    assert "expected at least 0.12 mm" in reported[0]


def test_bad_input_found_by_the_mesher_has_its_place(
    path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The stem is too wide. Only the mesher knows the place of the bone."""
    text = TABLE["femur"]["case"]
    path.write_text(text.replace("kind: femur}", "kind: femur,\n  stem: {half_width: 14 mm}}"))
    assert main(["check", str(path), "--mesh"]) == 3
    assert f"{path}:1:1: geometry: the stem cuts" in capsys.readouterr().err


@pytest.mark.parametrize(
    "wrong", ["stem: {length: 250 mm}", "stem: {legth: 147 mm}", "neck_angle: 2"]
)
def test_bad_input_wrong_geometry_is_the_only_error(wrong: str, path: Path) -> None:
    """A load at a point of an invalid geometry causes no second error."""
    text = (CONFIGS / "stance.yaml").read_text()
    path.write_text(text.replace("  kind: femur\n", f"  kind: femur\n  {wrong}\n"))
    assert ["geometry." in m for m in complaints(path)] == [True]
    # Other faults of such a load are reported too.
    path.write_text(path.read_text().replace("at: psoas", "at: psoas\n    histori: [1]"))
    assert ["geometry." in m or "histori" in m for m in complaints(path)] == [True, True]


# ----------------------------------------------------------------------------------- mesh files

FILE = "geometry:\n  kind: file\n  path: {}\nmesh: {{size: 1 mm}}\nregions: {{}}\n"


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.msh", "nonsense", "not a gmsh .msh file"),
        ("a.msh", "$MeshFormat\n2.1 0 8\n", "not of .msh format 2.2 or 4.1"),
        ("a.msh", "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n", "names no region"),
        ("a.msh", None, "no such file: "),
        ("mesh.py", "$MeshFormat\n", "is not one of .geo, .msh, .inp"),
        ("~nosuchuser/a.msh", None, "'~nosuchuser/a.msh': Could not determine home directory"),
        ("a" * 300 + ".msh", None, "cannot be read: File name too long"),
        ('"a\\0.msh"', None, "no such file"),
    ],
)
def test_bad_input_mesh_file(name: str, content: str | None, words: str, path: Path) -> None:
    path.write_text(FILE.format(name))
    if content is not None:
        path.with_name(name).write_text(content)
    message = next(m for m in complaints(path) if "geometry" in m)
    assert message.startswith("3:3: geometry.path: ") and words in message


def test_bad_input_names_of_a_mesh_file(path: Path) -> None:
    path.with_name("a.msh").write_text(
        '$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$PhysicalNames\n3\n2 7 "bottom"\n3 1 "rock"\n'
        '3 2 "soil"\n$EndPhysicalNames\n'
    )
    path.write_text(
        "geometry:\n  kind: file\n  path: a.msh\n  interfaces:\n    joint: [rock, [soli]]\n"
        "mesh: {size: 1 mm}\nregions: {rock: {rigid: true, tissue: other}}\nsupports:\n"
        "  base: {kind: fixed, boundary: botom}\n"
    )
    assert complaints(path) == [
        "5:19: geometry.interfaces.joint[1]: 'soli' is not one of rock, soil; did you mean 'soil'?"
    ]
    path.write_text(path.read_text().replace("soli", "soil"))
    assert [m.split(";")[0] for m in complaints(path)] == [
        "7:1: regions: no material for soil",
        "9:23: supports.base.boundary: the geometry (file) has no boundary 'botom'",
    ]


# --------------------------------------------------------------------------------- command line


def test_bad_input_is_printed_once_with_exit_code_2(
    path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path.write_text(GOOD.replace("110 GPa", "110 mm"))
    for command in ("check", "run", "mesh"):
        assert main([command, str(path)]) == 2
        out, err = capsys.readouterr()
        assert (out, err.count("\n")) == ("", 1)
        assert err.startswith(f"{path}:12:5: regions.stem.youngs_modulus: ")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ("", "the following arguments are required: COMMAND"),
        ("chek x", "doctor); did you mean 'check'?; see mantle --help"),
        ("check", "the following arguments are required: CASE"),
        ("check none.yaml", "none.yaml: no such file"),
        ("check stanse", "stanse: no such file or shipped case; did you mean 'stance'?"),
        ("check none.yaml --colour", "unrecognized arguments: --colour; see mantle check --help"),
        ("check none.yaml -- -log_view", "takes no PETSc options"),
        ("run none.yaml -n zero", "-n: 'zero' is not a number of ranks"),
        ("run none.yaml -o", "expected one argument"),
        ("report a b -o page.pdf", "-o page.pdf: expected a folder, whose name"),
        ("report none", "none: no such folder; expected a folder written by mantle run, sweep or"),
        ("run none.yaml -o out.html", "-o out.html: expected a folder, whose name"),
    ],
)
def test_bad_input_on_the_command_line(
    arguments: str, expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments.split()) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1) and expected in err


@pytest.mark.parametrize(
    "arguments",
    [
        "check {}",
        "run {}",
        "run stance -o {}",
        "mesh {}.yaml",
        "place {}",
        "report {}",
        "report out {}",
        "init hip --labels {}",
    ],
)
def test_bad_input_path_that_the_system_refuses(
    arguments: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments.format(300 * "x").split()) == 2
    err = capsys.readouterr().err
    assert "xxx...: cannot be opened: file name too long; give another path\n" in err


def test_bad_input_explains_only_paths_of_the_user() -> None:
    locked = PermissionError(errno.EACCES, "Permission denied", "locked/case.yaml")
    error = files.error_of_refused_path(locked)
    assert error is not None and error.exit_code == 2
    assert str(error) == "locked/case.yaml: cannot be opened: permission denied; give another path"
    assert files.error_of_refused_path(FileNotFoundError(errno.ENOENT, "No such file", "a")) is None
    assert files.error_of_refused_path(OSError(errno.EACCES, "Permission denied")) is None
    assert files.error_of_refused_path(ValueError("a")) is None


def test_bad_input_run_folder(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    full = path.parent / "full"
    full.mkdir()
    (full / "fields.vtkhdf").touch()
    for folder, expected in (
        (full, "is not empty; choose another folder, or --force to replace the results"),
        (path, "is a file; expected a folder"),
        (path / "below", "a folder above it is a file"),
        (Path("/proc/nowhere"), "cannot be made or read: "),
    ):
        assert main(["run", str(path), "-o", str(folder)]) == 2
        assert capsys.readouterr().err.startswith(f"-o {folder}: {expected}")
    (full / "checkpoint-3.state").touch()  # of a run that was killed
    assert main(["run", str(path), "-o", str(full)]) == 2
    assert ", --restart auto to continue from its checkpoint, or --force" in capsys.readouterr().err


@pytest.mark.parallel
def test_bad_input_under_mpirun_is_printed_by_one_rank(path: Path) -> None:
    path.write_text(GOOD.replace("110 GPa", "110 mm"))
    result = support.on_ranks(3, "-m", "mantle", "run", path, code=2)
    assert result.stdout == ""
    assert result.stderr.count("regions.stem.youngs_modulus: '110 mm' is not a stress") == 1


@pytest.mark.parametrize("name", ["case.yaml", "fields.vtkhdf", "history.csv", "summary.json"])
def test_bad_input_folder_in_place_of_a_result_is_named(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The error comes before the solve, also for variations."""
    way = tmp_path / name
    way.mkdir()
    case = str(CONFIGS / "blocks.yaml")
    assert main(["run", case, "-o", str(tmp_path), "--force"]) == 2
    assert f"{way}: is a folder, but a file of results has this name" in capsys.readouterr().err
    way.rmdir()
    (tmp_path / "a" / name).mkdir(parents=True)
    varied = "variations={a: {title: one}, b: {title: two}}"
    assert main(["run", case, "-o", str(tmp_path), "--force", "--set", varied]) == 2
    assert f"{tmp_path / 'a' / name}: is a folder" in capsys.readouterr().err


def test_bad_input_read_only_folder_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("os.access", lambda path, mode: Path(path) != tmp_path)
    assert main(["run", str(CONFIGS / "blocks.yaml"), "-o", str(tmp_path)]) == 2
    assert capsys.readouterr().err.strip() == f"-o {tmp_path}: is not writable"


@pytest.mark.parametrize("left", ["checkpoint-3.state", "a/checkpoint-3.state", "a/DONE"])
def test_bad_input_killed_run_names_the_restart_option(
    left: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Variations behave the same. A checkpoint is written each minute by default."""
    (tmp_path / left).parent.mkdir(exist_ok=True)
    (tmp_path / left).touch()
    case = CONFIGS / "blocks.yaml"
    assert main(["run", str(case), "-o", str(tmp_path)]) == 2
    assert "--restart auto to continue from its checkpoint" in capsys.readouterr().err
    assert mantle.load(case).config.output.checkpoint.minutes == 1.0


BLOCKS = CONFIGS / "blocks.yaml"


def test_bad_input_endless_texts(tmp_path: Path) -> None:
    path = tmp_path / "case.yaml"
    path.write_text(f"title: {'x' * 10_001}\n")
    assert complaints(path) == ["1:8: the text has 10001 characters; at most 10000 are allowed"]
    (long,) = complaints(BLOCKS, f"mesh.size=1{' ' * LONGEST_VALUE}mm")
    assert long.startswith("--set mesh.size: '1   ") and len(long) < 200


def test_bad_input_too_long_file_is_not_read_to_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "case.yaml"
    monkeypatch.setattr(yaml_file, "MOST_NODES", 1000)
    path.write_text("a: [" + "1," * (yaml_file.MOST_NODES + 10))
    assert "too many or too deeply nested values" in complaints(path)[0]
    path.write_text("#" * yaml_file.LARGEST + "\n")
    assert complaints(path) == [" is larger than 4 MB, too large for a case file"]
    assert complaints(Path("/dev/zero")) == [" is larger than 4 MB, too large for a case file"]


def test_bad_input_too_many_combinations(tmp_path: Path) -> None:
    path = tmp_path / "sweep.yaml"
    values = f"[{', '.join(map(str, range(40)))}]"
    axes = "".join(f"  a.b{i}: {values}\n" for i in range(6))
    path.write_text(f"base: {BLOCKS}\ngrid:\n{axes}")
    with pytest.raises(InputError, match="4096000000 combinations; at most 20000 are allowed"):
        sweep_file.read(path)


@pytest.mark.parametrize("name", ["../up", "..", ".", "a/b", "/tmp/x", "a b", "$(touch PWNED)", ""])
def test_bad_input_names_cannot_leave_their_folder(name: str, tmp_path: Path) -> None:
    path = tmp_path / "case.yaml"
    quoted = name.replace("'", "''")
    path.write_text(f"{BLOCKS.read_text()}\nvariations: {{'{quoted}': {{}}, other: {{}}}}\n")
    assert f"'{name}' is not a name" in complaints(path)[0] or not name
    path.write_text(
        f"{BLOCKS.read_text()}\noutput: {{probes: {{'{quoted}': {{at: [0, 0, 0]}}}}}}\n"
    )
    assert any("is not a name" in m for m in complaints(path))


# Cases over a shipped base, with the key of the file that goes with an error in the base.
COLLAR = "geometry: {stem: {collar: {thickness: 3 mm, angle: 90 deg}}}"
OVER_BASE = {
    "law": (f"base: pressed\n{COLLAR}\n", "interfaces: no law for collar_bone", "2:19"),
    "material": (f"base: pressed\n{COLLAR}\n", "regions: no material for collar", "2:19"),
    "null": (
        "base: collar\ngeometry: {stem: {collar: null}}\n",
        "regions.collar: .* has no region 'collar'; .*; remove it by `regions: {collar: null}`",
        "2:19",
    ),
    "null law": (
        "base: collar\ngeometry: {stem: {collar: null}}\n",
        "interfaces.collar_bone: .*; remove it by `interfaces: {collar_bone: null}`",
        "2:19",
    ),
    "history": (
        "base: pressed\ninterfaces: {stem_bone: {gap_history: [0, 1]}}\n",
        "stages: the interference grows until the end of the last stage",
        "2:26",
    ),
}


@pytest.mark.parametrize("name", OVER_BASE)
def test_bad_input_in_a_base_names_the_key_of_the_file(name: str, path: Path) -> None:
    """The line of the error is in the base; the cause is in the file."""
    text, fault, place = OVER_BASE[name]
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load_case(path)
    pattern = rf"configs/\w+\.yaml:\d+:\d+: {fault}.*; does .* \({path}:{place}\)"
    assert any(re.search(pattern, message) for message in caught.value.messages)


def test_bad_input_key_of_the_section_above_is_said_to_belong_there(path: Path) -> None:
    path.write_text("base: pressed\ngeometry: {stem: {tip_void: 5 mm}}\n")
    expected = "geometry.stem.tip_void: unknown key here; it is a key of geometry"
    assert complaints(path) == [f"2:19: {expected}"]
    path.write_text("base: pressed\n")
    with pytest.raises(InputError, match=expected):
        load_case(path, ["geometry.stem.tip_void=5 mm"])


def test_bad_input_width_in_another_unit_is_shown_in_mm(path: Path) -> None:
    path.write_text("base: pressed\ngeometry: {stem: {half_width: 12 cm}}\n")
    (message,) = complaints(path)
    start = "2:19: geometry.stem.half_width: is -3.65 mm at 10 mm below the tip, z = -128 mm"
    assert message.startswith(f"{start}; expected more than 0")
    assert "linear: 120 mm at z = 15 mm" in message
