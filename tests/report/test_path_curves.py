"""Curves along paths on the page of a run and of a comparison."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import mantle
from app.report import compare, path_curves, run_report
from app.report.sweep_results import CONVERGED, SweptCase

BAR = """
geometry: {kind: blocks, blocks: [{name: bar, size: [4 mm, 4 mm, 6 mm]}]}
mesh: {order: 1, size: 2 mm, far_size: 2 mm}
regions: {bar: {youngs_modulus: 100 MPa, poisson_ratio: 0, tissue: other}}
supports: {base: {kind: fixed, boundary: bottom}}
loads: {press: {kind: pressure, boundary: top, pressure: 1 MPa, history: [1, 3]}}
stages: [{name: half_load}, {name: full_load}]
output:
  paths:
    through: {kind: line, start: "[2, 2, -1] mm", end: "[2, 2, 7] mm", points: 9,
      fields: [displacement.z, von_mises]}
"""


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The bar, and a softer one with a path that ends inside."""
    folder = tmp_path_factory.mktemp("bars")
    (folder / "case.yaml").write_text(BAR)
    softer = {"regions.bar.youngs_modulus": "50 MPa", "output.paths.through.end": "[2, 2, 5] mm"}
    for name, changes in (("hard", {}), ("soft", softer)):
        mantle.run(mantle.load(folder / "case.yaml", **changes), folder / name)
    return [folder / "hard", folder / "soft"]


def test_path_curves_draw_the_ends_of_stages(runs: list[Path]) -> None:
    """Units are those of the page, with a gap where the path is outside."""
    case = SweptCase("hard", runs[0], CONVERGED)
    shown = path_curves.panels_of_path(case.paths["through"], path_curves.stages_of(case))
    assert [(panel.title, panel.y) for panel in shown] == [
        ("displacement z", "µm"),
        ("von Mises stress", "MPa"),
    ]
    first, last = shown[0].lines
    assert (first.label, last.label) == ("half load", "full load")
    assert first.x == list(range(1, 8))
    assert last.y == pytest.approx(-30.0 * np.arange(7), abs=1e-6)


def test_path_curves_of_rounding_are_zero(runs: list[Path]) -> None:
    case = SweptCase("hard", runs[0], CONVERGED)
    table = dict(case.paths["through"])
    table["displacement.z [mm]"] = np.full_like(table["displacement.z [mm]"], 4e-12)
    first, *_ = path_curves.panels_of_path(table, path_curves.stages_of(case))
    assert not any(any(line.y) for line in first.lines)


def test_path_curves_are_on_the_page(runs: list[Path]) -> None:
    html = (runs[0] / "report.html").read_text(encoding="utf-8")
    section = html[html.index('<section id="paths">') :].partition("</section>")[0]
    assert section.count("<svg") == 2 and "full load" in section
    assert path_curves.GAPS in section
    files = run_report.write(runs[0])
    assert runs[0] / "report" / "path_through.png" in files


def test_path_curves_of_runs_are_over_each_other(runs: list[Path], tmp_path: Path) -> None:
    """The page also has the keys that differ, and paths of one run alone."""
    other = shutil.copytree(runs[1], tmp_path / "soft")
    shutil.copy(other / "path_through.csv", other / "path_alone.csv")
    html = compare.write([runs[0], other], tmp_path / "both.html").read_text(encoding="utf-8")
    section = html[html.index('<section id="paths">') :].partition("</section>")[0]
    assert section.count("<svg") == 2 and "hard" in section and "soft" in section
    assert "The keys of the path differ: " in section and "[2, 2, 7] mm" in section
    assert "path alone: only in soft" in section


def test_path_curves_over_time_draw_some_moments() -> None:
    """A stage with time has five moments, named by their seconds."""
    steps = np.repeat(np.arange(1, 21), 3)
    table = {
        "step": steps,
        "time [-]": steps / 20,
        "seconds [s]": 6.0 * steps,
        path_curves.ARC: np.tile([0.0, 1.0, 2.0], 20),
        path_curves.REGION: np.full(60, "bar"),
        "temperature [degC]": 37.0 + steps,
    }
    (panel,) = path_curves.panels_of_path(table, ["cool"])
    assert [line.label for line in panel.lines] == ["6 s", "36 s", "60 s", "90 s", "120 s"]
    assert panel.y == "°C"
