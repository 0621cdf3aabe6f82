"""Gmsh scripts are programs, so they run only with `--allow-scripts`."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

import meshes
from app.case.case import load_case
from app.case.mesh_names import ALLOWED
from app.cli import main
from app.foundation.errors import GeometryError, InputError
from tests import support
from tests.cases.gmsh_scripts import LAYERS, script
from tests.support import CONFIGS

# All that mesh a case, or say what that would be.
COMMANDS = (
    *("run case.yaml", "check case.yaml", "check case.yaml --mesh", "mesh case.yaml"),
    *("study study.yaml", "sweep sweep.yaml"),
)


@pytest.mark.parametrize("command", COMMANDS)
def test_allow_scripts_runs_scripts_only_if_allowed(
    command: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A list of forbidden words would not suffice: gmsh also runs scripts in single quotes."""
    monkeypatch.chdir(tmp_path)
    script(tmp_path, f"{LAYERS}Merge 'other.geo';\n")
    Path("other.geo").write_text('SystemCall "touch PWNED";\n')
    study = CONFIGS / "studies" / "errors_hertz_line.yaml"
    Path("study.yaml").write_text(re.sub("base: .*", "base: case.yaml", study.read_text()))
    Path("sweep.yaml").write_text("base: case.yaml\ngrid: {mesh.size: [0.5 mm]}\n")
    assert main(command.split()) == 2
    printed = capsys.readouterr().err
    assert "case.yaml:1:24: geometry.path: 'a.geo': a gmsh script is a program" in printed
    assert "--allow-scripts" in printed
    assert not Path("PWNED").exists()


def test_allow_scripts_runs_a_trusted_script(tmp_path: Path) -> None:
    """A sweep runs the script in its cases, because the option applies to all of its runs."""
    script(tmp_path, LAYERS)
    (tmp_path / "sweep.yaml").write_text(
        "base: case.yaml\nset: {output.fields: false}\ngrid: {mesh.size: [0.5 mm]}\n"
    )
    command = ["-m", "mantle", "sweep", "sweep.yaml", "-o", "out", "--allow-scripts"]
    support.python(*command, cwd=tmp_path)
    assert list(tmp_path.glob("out/runs/*/DONE"))


def test_allow_scripts_always_runs_shipped_scripts(tmp_path: Path) -> None:
    """Shipped scripts are known by their place. A link to another script is refused."""
    case = CONFIGS / "verification" / "cook.yaml"
    assert load_case(case).config.geometry.region_names
    script(tmp_path, LAYERS)
    copy = tmp_path / "configs" / "verification"
    copy.mkdir(parents=True)
    for name in ("cook.yaml", "cook.geo"):
        shutil.copy(case.with_name(name), copy)
    with pytest.raises(InputError, match="--allow-scripts"):
        load_case(copy / "cook.yaml")


def test_allow_scripts_ignores_options_next_to_a_mesh(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Gmsh would execute an options file next to a mesh, so it does not get the file."""
    monkeypatch.setenv(ALLOWED, "1")
    script(tmp_path, LAYERS)
    (tmp_path / "a.geo.opt").write_text('Error("the options were run");')
    case = load_case(tmp_path / "case.yaml").config
    assert len(meshes.build(case.geometry, case.mesh).cells)


def test_allow_scripts_refuses_too_fine_a_mesh(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(ALLOWED, "1")
    script(tmp_path, LAYERS)
    case = load_case(tmp_path / "case.yaml", ["mesh.size=1 nm"]).config
    with pytest.raises(GeometryError, match=r"mesh\.size: 1e-06 mm: .* 5e\+06 cells long"):
        meshes.build(case.geometry, case.mesh, None)
