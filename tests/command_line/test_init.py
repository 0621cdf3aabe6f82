"""``mantle init``: short cases to start from."""

from __future__ import annotations

import errno
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mantle
import meshes
from app.case import new_case
from app.case.case import load_case
from app.cli import main
from app.foundation.errors import GeometryError, InputError
from app.foundation.verdict import Severity, recorded
from app.results import verdicts
from tests import support
from tests.support import CONFIGS

MSH = """\
$MeshFormat
4.1 0 8
$EndMeshFormat
$PhysicalNames
4
2 1 "foot"
2 2 "top end"
3 3 "shaft"
3 4 "marrow"
$EndPhysicalNames
"""


@pytest.fixture
def error_of_init(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Callable[..., str]:
    """Return the error of `mantle init`, which ends with exit code 2, in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> str:
        assert main(["init", *arguments]) == 2
        return capsys.readouterr().err

    return run


@pytest.mark.parametrize(
    "options",
    [
        ["--kind", "femur"],
        ["--kind", "cylinders"],
        ["--kind", "blocks"],
        ["--kind", "head_cup"],
        ["--cementless"],
    ],
    ids=" ".join,
)
def test_init_writes_a_short_valid_case(
    options: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MANTLE_CALLED", "mantle")
    assert main(["init", "first", *options]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert out.splitlines() == [
        "first.yaml is written; next:",
        "  mantle check first.yaml",
        "  mantle run first.yaml -o out/first",
        "  open out/first/report.html in a browser",
    ]
    lines = (tmp_path / "first.yaml").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 40 and sum("#" in line for line in lines) >= 5
    assert lines[0] == f"# yaml-language-server: $schema={CONFIGS / 'schema.json'}"
    assert main(["check", "first.yaml"]) == 0
    assert capsys.readouterr().err == ""
    assert main(["init", "first.yaml"]) == 2
    assert (
        capsys.readouterr().err
        == "first.yaml: exists already and was not changed; choose another name\n"
    )
    assert (tmp_path / "first.yaml").read_text(encoding="utf-8").splitlines() == lines


def test_init_femur_stands_on_one_leg(tmp_path: Path) -> None:
    """The hip force is 261 % of 750 N (mean of ten patients).

    Other values are those of the stance.
    """
    case = load_case(new_case.write(tmp_path / "femur", "femur", "cocr")).config
    stance = load_case(CONFIGS / "stance_cocr.yaml").config
    for part in ("regions", "interfaces", "supports", "stages"):
        assert support.without_origin(case)[part] == support.without_origin(stance)[part]
    assert math.hypot(*case.loads["hip"].force) == pytest.approx(2.60 * 750, rel=0.005)  # type: ignore[attr-defined]


@pytest.mark.slow
def test_init_cementless_runs_without_a_warning(tmp_path: Path) -> None:
    """The first stem without cement is within the limits of physiology and of bone's strength."""
    path = new_case.write(tmp_path / "hip", "femur", cementless=True)
    case = mantle.load(path, **{"mesh.size": "6 mm"})
    assert mantle.check(case).notes == ()
    summary = mantle.run(case, tmp_path / "out").summary
    doubtful = (Severity.WARNING, Severity.ERROR)
    judged = [*verdicts.of_numbers(summary), *recorded(summary)]
    assert [v.text for v in judged if v.severity in doubtful] == []


@pytest.mark.slow
@pytest.mark.parametrize("stem", new_case.STEMS)
def test_init_femur_runs_without_a_warning(stem: str, tmp_path: Path) -> None:
    """The first hip is within the limits of physiology."""
    case = mantle.load(new_case.write(tmp_path / "hip", "femur", stem))
    assert mantle.check(case).notes == ()
    summary = mantle.run(case, tmp_path / "out").summary
    doubtful = (Severity.NOTE, Severity.WARNING, Severity.ERROR)
    judged = [*verdicts.of_numbers(summary), *recorded(summary)]
    assert [v.text for v in judged if v.severity in doubtful] == []
    assert np.linalg.norm(summary["femur"]["head_displacement"]) < 5.0


def test_init_stem_has_the_given_material(tmp_path: Path) -> None:
    moduli = []
    for stem in new_case.STEMS:
        case = load_case(new_case.write(tmp_path / stem, "cylinders", stem)).config
        moduli.append(case.regions["stem"].youngs_modulus)  # type: ignore[union-attr]
    assert moduli == [110e3, 200e3, 193e3]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["--kind", "blocks", "--stem", "cocr"],
            "--stem cocr: geometries of kind blocks have no stem",
        ),
        (["--kind", "blocks", "--cementless"], "--cementless: only femora have such a stem"),
        (["--kind", "file"], "new.msh: not a gmsh .msh file"),
        (["--ct", "new.msh"], "--ct: needs --labels FILE"),
        (["--side", "right", "--label", "1"], "--side, --label: needs --labels FILE"),
        (["--labels", "new.msh", "--kind", "femur"], "--kind: has no effect with --labels"),
        (["--labels", "new.msh", "--stem", "cocr"], "--stem: has no effect with --labels"),
        (["--kind", "knee"], "mantle init: argument --kind: invalid choice: 'knee'"),
    ],
)
def test_init_refuses(
    arguments: list[str], message: str, error_of_init: Callable[..., str]
) -> None:
    Path("new.msh").touch()
    assert error_of_init("new", *arguments).startswith(message)
    assert not Path("new.yaml").exists()


@pytest.mark.parametrize("options", [[], ["--cementless"], ["--labels", "labels.nii.gz"]])
def test_init_names_a_missing_folder(options: list[str], error_of_init: Callable[..., str]) -> None:
    """The file of labels is not read before."""
    Path("labels.nii.gz").touch()
    message = "none/new.yaml: folder none does not exist; make it first\n"
    assert error_of_init("none/new", *options) == message


def test_init_names_all_missing_files_as_typed(error_of_init: Callable[..., str]) -> None:
    Path("a.nii.gz").touch()
    missing_ct = "--ct below/../none.nii.gz: no such file or folder\n"
    ct = ("--ct", "below/../none.nii.gz")
    assert error_of_init("new", "--labels", "a.nii.gz", *ct) == missing_ct
    missing_labels = "--labels b.nii.gz: no such file or folder\n"
    assert error_of_init("new", "--labels", "b.nii.gz", *ct) == missing_labels + missing_ct


def test_init_lists_names_of_a_mesh(tmp_path: Path) -> None:
    (tmp_path / "bone.msh").write_text(MSH, encoding="utf-8")
    path = new_case.write(tmp_path / "bone", "file")
    text = path.read_text(encoding="utf-8")
    for line in (
        "  path: bone.msh # relative to this file",
        "  # its boundaries: foot, top_end",
        "  shaft: {material: cortical_bone}",
        "  marrow: {material: cortical_bone}",
        "  hold: {kind: fixed, boundary: foot}",
    ):
        assert line in text.splitlines()
    assert list(load_case(path).config.regions) == ["shaft", "marrow"]


def test_init_of_touching_blocks_runs_unchanged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Interior surfaces are no boundaries. The launcher prints the name by which it was called."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MANTLE_CALLED", "./mantle")
    meshes.write_msh(
        mantle.mesh(load_case(new_case.write(tmp_path / "b", "blocks"))), Path("own.msh")
    )
    assert main(["init", "own", "--kind", "file"]) == 0
    assert "\n  ./mantle run own.yaml -o out/own\n" in capsys.readouterr().out
    results = mantle.run(mantle.load("own.yaml", mesh__order=1), "out")
    assert list(results.summary["bonds"]) == ["bone_cement", "cement_metal"]
    # Without these lines the message has them to paste.
    text = Path("own.yaml").read_text()
    cut = re.sub(r"^(interfaces|  interfaces):\n(    .*\n|  .*\n){2}", "", text, flags=re.M)
    Path("cut.yaml").write_text(cut)
    with pytest.raises(GeometryError, match="where no interface is declared") as refused:
        mantle.mesh(mantle.load("cut.yaml"))
    paste = str(refused.value).partition("such as\n")[2]
    Path("again.yaml").write_text(f"base: cut.yaml\n{paste}\n")
    assert mantle.load("again.yaml").config == mantle.load("own.yaml").config


def test_init_reports_a_read_only_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = Path.open

    def refused(path: Path, mode: str = "r", **how: Any) -> Any:
        if mode == "x":
            raise OSError(errno.EROFS, "Read-only file system")
        return opened(path, mode, **how)

    monkeypatch.setattr(Path, "open", refused)
    assert main(["init", str(tmp_path / "x")]) == 5
    assert capsys.readouterr().err.endswith("x.yaml: Read-only file system\n")


def test_init_without_the_mesh_names_missing_entries(tmp_path: Path) -> None:
    path = new_case.write(tmp_path / "own", "file")
    text = path.read_text(encoding="utf-8")
    assert "NAME_OF_A_REGION" in text and "It is not there yet" in text
    with pytest.raises(InputError) as caught:
        load_case(path)
    (message,) = caught.value.messages
    assert message == f"{path}:10:3: geometry.path: no such file: {path.parent}/own.msh"
