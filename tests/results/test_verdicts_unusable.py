"""Unusable results have a separate status and exit code, alone and in sweeps."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import mantle
from app.case.case import load_case
from app.cli import main
from app.foundation.errors import UnusableError
from app.results.verdicts import UNUSABLE, unbalanced

# A block drawn over another by so many mm; the facets between them are about 2 mm wide.
DRAWN = """
geometry:
  kind: blocks
  blocks: [{name: low, size: [6 mm, 6 mm, 2 mm]}, {name: high, size: [6 mm, 6 mm, 2 mm]}]
mesh: {order: 1, size: 2 mm, far_size: 2 mm}
regions:
  low: {youngs_modulus: 1 GPa, poisson_ratio: 0.3, tissue: other}
  high: {youngs_modulus: 1 GPa, poisson_ratio: 0.3, tissue: other}
interfaces: {low_high: {kind: contact, friction_coefficient: 0.1}}
supports:
  floor: {kind: fixed, boundary: bottom}
  grip: {kind: displacement, boundary: top, x: 0.1 mm, y: 0 mm, z: -0.001 mm}
"""
FAR = "supports.grip.x=4 mm"


@pytest.fixture
def case(tmp_path: Path) -> Path:
    path = tmp_path / "case.yaml"
    path.write_text(DRAWN)
    return path


def test_verdicts_unusable_run_has_status_and_exit_code(
    case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "out"
    for again in ([], ["--restart", "auto"], []):
        assert main(["run", str(case), "-o", str(folder), "--set", FAR, *again]) == 6
        verdict = f"do not use the numbers in {folder}: slip: larger than a facet on low_high"
        assert verdict in capsys.readouterr().err
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["status"] == UNUSABLE and (folder / "DONE").exists()
    q = summary["interfaces"]["low_high"]
    assert q["slip_max"] > q["facet_size"]
    with pytest.raises(UnusableError, match="slip: larger than a facet on low_high"):
        mantle.run(load_case(case, [FAR]), folder, force=True)
    assert main(["run", str(case), "-o", str(tmp_path / "near")]) == 0


def test_verdicts_unusable_results_out_of_balance() -> None:
    """The balance of force is 1e-8 or more, or not a number."""
    good = {"balance": {"force": 9e-9, "heat": 9e-7}, "interfaces": {}}
    assert unbalanced(good) == []
    assert unbalanced({"balance": {"force": 1e-8, "heat": float("nan")}}) == ["force", "heat"]


@pytest.mark.parametrize("shared", [False, True])
def test_verdicts_unusable_runs_are_separate_in_sweeps_and_reports(
    shared: bool, case: Path, tmp_path: Path
) -> None:
    """One process has several cases, which differ in friction and share the stiffness."""
    grid = "supports.grip.x: [0.1 mm, 4 mm]"
    if shared:
        case.write_text(DRAWN.replace("x: 0.1 mm", "x: 4 mm"))
        grid = "interfaces.low_high.friction_coefficient: [0.1, 0.2]"
    sweep, folder = tmp_path / "sweep.yaml", tmp_path / "out"
    sweep.write_text(f"base: case.yaml\ngrid: {{{grid}}}\n")
    for _ in range(2):  # what is done is not run again
        assert main(["sweep", str(sweep), "-o", str(folder), "--cores", "1"]) == 6
        first, second = json.loads((folder / "sweep.json").read_text())["cases"]
        assert second["status"] == UNUSABLE and second["exit_code"] == 6
        assert "slip: larger than a facet on low_high" in second["message"]
        assert second["numbers"]["low_high.slip_p99"] > 3.0
        assert first["status"] == (UNUSABLE if shared else "converged")
    assert main(["report", str(folder)]) == 0
    page = (folder / "report.html").read_text()
    counts = "2 do not use" if shared else "1 converged, 1 do not use"
    assert f"2 cases: {counts}" in page
