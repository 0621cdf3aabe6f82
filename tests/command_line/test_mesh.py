"""``mantle mesh``: the mesh as a file, and its picture."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.cli import main
from tests.support import CONFIGS


def test_mesh_writes_mesh_and_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("gmsh")
    case = str(CONFIGS / "blocks.yaml")
    coarse = ["--set", "mesh.size=5 mm"]
    assert main(["mesh", case, "-o", str(tmp_path / "new" / "folder"), *coarse]) == 0
    out = capsys.readouterr().out.splitlines()
    assert [Path(line).name for line in out[:2]] == ["blocks.msh", "blocks.png"]
    assert all(Path(line).stat().st_size > 1000 for line in out[:2])
    # The written file is a valid geometry.
    given = tmp_path / "again.yaml"
    given.write_text(
        f"geometry: {{kind: file, path: {out[0]}, "
        "interfaces: {joint: [bone, cement], other: [cement, metal]}}\n"
        "mesh: {order: 1, size: 5 mm}\n"
        "supports: {base: {kind: fixed, boundary: bottom}}\nregions:\n"
        + "".join(
            f"  {n}: {{youngs_modulus: 1 GPa, poisson_ratio: 0, tissue: other}}\n"
            for n in ("bone", "cement", "metal")
        )
    )
    assert main(["check", str(given), "--mesh"]) == 0
    out = capsys.readouterr().out
    assert "joint 100" in out and "estimated" not in out
    assert main(["mesh", case, "-o", str(given / "below"), *coarse]) == 2
    assert "a folder above it is a file" in capsys.readouterr().err


def test_mesh_draws_the_cement_mantle(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("gmsh")
    sizes = ["--set", "mesh.size=10 mm", "--set", "mesh.around=8"]
    assert main(["mesh", str(CONFIGS / "stance.yaml"), "-o", str(tmp_path), *sizes]) == 0
    out = capsys.readouterr().out.splitlines()
    assert [Path(line).name for line in out[:4]] == [
        *("stance.msh", "stance.png", "stance_sections.png", "stance_interfaces.png")
    ]
    for line in out[1:4]:
        assert Path(line).read_bytes().startswith(b"\x89PNG")
    drawn = tmp_path / "check" / "stance.png"
    assert main(["check", str(CONFIGS / "stance.yaml"), "-o", str(drawn.parent), *sizes]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == str(drawn) and drawn.exists()
