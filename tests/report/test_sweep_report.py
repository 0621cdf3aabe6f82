"""The report of made-up sweeps: digits, curves, levels, correlations."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from app.cli import main
from app.report import sweep_keys, sweep_report, sweep_tables
from app.report import sweep_results as rs
from tests.report.sweeps import Maker, as_the_paper_says, contact, femur, sweep

# The page


def test_sweep_report_page_is_self_contained(
    maker: Maker, capsys: pytest.CaptureFixture[str]
) -> None:
    for k, c in enumerate(sweep(maker, as_the_paper_says, 1e-3).cases):
        maker.cases[k]["overrides"] = {
            "geometry.cement_thickness": c.data["geometry"]["cement_thickness"]
        }
    assert main(["report", str(maker.write())]) == 0
    printed = capsys.readouterr().out
    assert "14 of 14 cases have results" in printed
    assert f"{maker.folder / 'report.html'}, and 1 files in" in printed
    written = {f.name for f in (maker.folder / "report").iterdir()}
    assert written == {f"over_geometry_cement_thickness.{kind}" for kind in ("png", "svg", "pdf")}
    text = (maker.folder / "report.html").read_text()
    # The one script opens what is folded before the page is printed.
    assert not re.search(r"https?:|<script(?!>addEventListener\(.beforeprint)|<link", text)
    assert all(href.startswith("#") for href in re.findall(r'href="([^"]*)"', text))
    assert '<td class="n">60.000 ± 0.060</td>' in text


def test_sweep_report_of_a_partial_sweep(maker: Maker) -> None:
    numbers = contact(as_the_paper_says, "titanium", 4, 1, 0.1)
    maker.stance("titanium", 4.0, 1.0, numbers)
    maker.stance("titanium", 3.0, 1.0, numbers)
    maker.stance("titanium", 2.0, 1.0, None, status="stopped", exit_code=5)
    maker.stance("CoCr", 4.0, 1.0, None, status="failed", exit_code=3, message="<b>no</b>")
    gone = {"name": "gone", "folder": "runs/none", "status": "converged"}
    gone["numbers"], gone["errors"] = {"cement_bone.slip_p99": 0.05}, {"cement_bone.slip_p99": 0.01}
    maker.cases.append(gone)
    files, cases = sweep_report.run(maker.write())
    page = files[0].read_text()
    assert (sum(c.done for c in cases), len(cases)) == (3, 5)
    assert "Without results: titanium 2 1, CoCr 4 1" in page
    assert "its folder has no summary.json" in page and "50 ± 10" in page
    assert "In three dimensions" not in page and "Gruen" not in page
    assert "&lt;b&gt;no&lt;/b&gt;" in page and "<b>" not in page


def test_sweep_report_curves_over_varying_keys(maker: Maker) -> None:
    data = femur()
    for taper in (1.0, 2.0, 3.0):
        numbers = contact(lambda *a, x=taper: x, "", 0, 0, 0.1)
        keys = {"geometry.taper": f"{taper:g} deg", "title": "x", "mesh.size": "4 mm"}
        more = {"overrides": keys}
        maker.add(f"taper {taper:g}", data, {"interfaces": numbers}, **more)
    files, _ = sweep_report.run(maker.write())
    assert [f.name for f in files] == ["report.html", "over_geometry_taper.png"]
    page = files[0].read_text()
    assert "Numbers over taper" in page and "cement-bone slip, 99th percentile" in page
    assert "taper (°): 1, 2, 3." in page and "mesh.size" not in page  # the same in all
    assert page.count('role="img"') == 10 and "data:image" not in page
    run = rs.read(maker.folder).cases[1].folder
    (run / "report.html").touch()
    sweep_report.run(maker.folder)
    assert f'<a href="runs/{run.name}/report.html">taper 2</a>' in files[0].read_text()
    assert page.index("Curves over the varied keys") < page.index("All cases")
    for name in ("over_old.png", "mine.png"):
        (maker.folder / "report" / name).write_text("")
    sweep_report.run(maker.folder)
    left = {f.name for f in (maker.folder / "report").glob("*.png")}
    assert left == {"over_geometry_taper.png", "mine.png"}


@pytest.mark.parametrize(
    ("key", "written", "words", "numbers"),
    [
        ("geometry.cement_thickness", ["4 mm", "2 mm"], "cement thickness (mm): 4, 2", [4, 2]),
        ("geometry.length", ["500 um", "0.2 cm"], "length (mm): 0.5, 2", [0.5, 2]),
        ("interfaces.a_b.gap", ["5 um", "20 um"], "gap, a b (µm): 5, 20", [5, 20]),
        ("heat.a.T", ["0 degC", "300 K"], "a temperature (K): 273.15, 300", [273.15, 300]),
        ("interfaces.a_b.gap", [0.2, 1], "gap, a b (mm): 0.2, 1", [0.2, 1]),
        ("interfaces.a_b.gap", ["0.02 * z", "1 mm"], "gap, a b: 0.02 * z, 1 mm", [None, 1]),
        ("mesh.curved", [True, False], "mesh curved: True, False", [None, None]),
        ("a.b", [{"kind": "c", "m": m} for m in (1, 2)], "a b: 2 values of c", [None, None]),
    ],
)
def test_sweep_report_levels_have_one_unit(
    key: str, written: list[Any], words: str, numbers: list[float | None]
) -> None:
    """If the sweep has several units, the levels have the unit of the schema."""
    key = key.replace(".T", ".temperature")
    cases = [rs.SweptCase(str(x), Path(), "converged", "", {key: x}) for x in written]
    assert sweep_tables.axes_in_words(cases) == [f"{words}."]
    assert sweep_keys.levels_of(cases, key)[1] == pytest.approx(numbers)


def test_sweep_report_rank_correlations(maker: Maker) -> None:
    """Slip grows with the taper alone: +1 with the taper in any unit, nothing with the length."""
    data = femur()
    for taper, written in ((1.0, "1 deg"), (2.0, "2 deg"), (3.0, "0.05236 rad")):
        for length in (20.0, 30.0):
            numbers = contact(lambda *a, x=taper: x**3, "", 0, 0, 0.1)
            keys = {"geometry.taper": written, "geometry.length": f"{length:g} mm"}
            name = f"{taper:g} {length:g}"
            maker.add(name, data, {"interfaces": numbers}, overrides=keys)
    head, rows = sweep_tables.sensitivity(rs.read(maker.write()).cases)
    assert len(head) == 2 and rows
    for name, words in rows:
        assert name.startswith("thickness: ")
        assert words == ["+1.00 taper", "+0.00 length"]
    cases = rs.read(maker.folder).cases
    for case in cases:  # the same without numbers
        case.overrides["geometry.taper"] = {"kind": case.overrides["geometry.taper"]}
    assert sweep_tables.sensitivity(cases)[1][0][1] == ["+1.00 taper", "+0.00 length"]
    # With one key alone a curve says it.
    assert sweep_tables.sensitivity(rs.read(maker.folder).cases[::2])[1] == []
    # The page begins with the range of the first numbers and with what they depend on.
    page = sweep_report.run(maker.folder)[0][0].read_text()
    lead = page[page.index('"lead">') : page.index('class="summary"')]
    assert "1 to 27 <small>µm</small>" in lead and "Least: 1 20. Most: 3 30." in lead
    assert "cement-bone gap, p99 depends most on taper (rank correlation +1.00)." in lead


# What is no sweep


@pytest.mark.parametrize(
    "content, complaint",
    [
        (None, "has no sweep.json"),
        ('{"cases": [', "sweep.json: cannot be read: JSONDecodeError"),
        ('{"cases": []}', "sweep.json: has no cases"),
        ('{"cases": [{"name": "a", "status": "failed"}]}', "cannot be read: KeyError('folder')"),
    ],
)
def test_sweep_report_refuses_other_folders(
    tmp_path: Path, content: str | None, complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    if content is not None:
        (tmp_path / "sweep.json").write_text(content)
    assert main(["report", str(tmp_path)]) == 2
    assert complaint in capsys.readouterr().err
    assert not (tmp_path / "report.html").exists()
