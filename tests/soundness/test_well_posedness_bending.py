"""Linear cells that are too stiff in bending: the amount in the note, and its place."""

from __future__ import annotations

import csv
import html
import json
import re
from pathlib import Path

import numpy as np
import pytest

import meshes
from app.cli import main
from app.results.verdicts import notes_of
from app.soundness import well_posedness
from tests import support

# A cantilever of E = 1 GPa and nu = 0, pushed down at its end by 1 N.
BEAM = """
geometry: {{kind: blocks, blocks: [{{name: beam, size: [{L} mm, {b} mm, {h} mm]}}]}}
mesh: {{size: {size} mm, far_size: {size} mm, order: {order}}}
regions: {{beam: {{youngs_modulus: 1 GPa, poisson_ratio: 0, tissue: other}}}}
supports: {{wall: {{kind: fixed, boundary: x_min}}}}
loads: {{tip: {{kind: force, boundary: x_max, force: [0 N, 0 N, -1 N]}}}}
"""


def noted(text: str) -> list[str]:
    case = support.case(text)
    parts = well_posedness.mesh_parts(case, meshes.build(case.geometry, case.mesh))
    return [v.text for v in well_posedness.check_on_mesh(case, parts)]


@pytest.mark.parametrize(
    ("L", "b", "h", "size"),
    [(100, 10, 10, 10), (100, 10, 10, 5), (100, 10, 10, 2.5), (50, 10, 10, 5), (100, 40, 5, 5)],
)
def test_well_posedness_bending_note_on_linear_cells_has_the_stiffness_of_a_beam(
    L: float, b: float, h: float, size: float
) -> None:
    """The end moves by L^3 / (3 E I) + L / (5/6 G b h) (Timoshenko).

    The same mesh of order 2 is exact.
    """
    text = BEAM.format(L=L, b=b, h=h, size=size, order=1)
    (note,) = noted(text)
    match = re.fullmatch(
        r"region 'beam' is ([\d.]+) mm thick with linear cells of [\d.]+ mm: in bending it is "
        r"about (\d+) % too stiff; use mesh.order: 2",
        note,
    )
    assert match and float(match[1]) == pytest.approx(h, rel=0.1)
    exact = L**3 / (3 * 1000 * b * h**3 / 12) + L / (5 / 6 * 500 * b * h)
    x, u = support.solve(text).displacement("beam")
    excess = exact / -u[np.isclose(x[:, 0], L), 2].mean() - 1
    assert 1 / 1.4 < 0.01 * float(match[2]) / excess < 1.4
    assert noted(text.replace("order: 1", "order: 2")) == []


def test_well_posedness_bending_note_is_absent_without_bending() -> None:
    """A cube, a bar of many cells, and a slice between rollers have no bending."""
    assert noted(BEAM.format(L=10, b=10, h=10, size=10, order=1)) == []
    assert noted(BEAM.format(L=50, b=10, h=10, size=1.3, order=1)) == []
    plate = BEAM.format(L=50, b=50, h=2, size=4, order=1)
    assert len(noted(plate)) == 1
    rollers = "".join(
        f"  {side}: {{kind: roller, boundary: {side}, axis: z}}\n" for side in ("bottom", "top")
    )
    held = plate.replace("x_min}}", "x_min}").replace("supports: {", f"supports:\n{rollers}  ")
    assert noted(held) == []


def test_well_posedness_bending_note_is_in_summary_table_and_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A sweep over the order has the note for the linear case only."""
    (tmp_path / "case.yaml").write_text(BEAM.format(L=100, b=10, h=10, size=10, order=1))
    (tmp_path / "sweep.yaml").write_text("base: case.yaml\ngrid: {mesh.order: [1, 2]}\n")
    folder = tmp_path / "out"
    assert main(["sweep", str(tmp_path / "sweep.yaml"), "-o", str(folder), "--cores", "1"]) == 0
    linear, quadratic = json.loads((folder / "sweep.json").read_text())["cases"]
    (note,) = linear["notes"]
    assert "with linear cells of" in note and quadratic["notes"] == []
    summary = json.loads((folder / linear["folder"] / "summary.json").read_text())
    assert notes_of(summary) == [note]
    assert f"note: {note} ({linear['name']})" in "".join(capsys.readouterr())
    rows = list(csv.DictReader((folder / "sweep.csv").read_text().splitlines()))
    assert [row["notes"] for row in rows] == [note, ""]
    assert main(["report", str(folder)]) == 0
    page = html.unescape((folder / "report.html").read_text())
    assert f"{note} ({linear['name']})" in page and "1 of 2 cases have notes" in page
