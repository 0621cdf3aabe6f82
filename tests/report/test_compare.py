"""The page that compares runs."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest

from app.foundation.errors import InputError
from app.report import compare
from app.results.reading import Run
from tests.report.sweeps import FRICTION


def cells(html: str, anchor: str, table: int = 0) -> list[list[str]]:
    """Rows of a table of a section."""
    section = html[html.index(f'<section id="{anchor}">') :]
    body = section.split("<tbody>")[1 + table].partition("</tbody>")[0]
    rows = re.findall(r"<tr>(.*?)</tr>", body, re.S)
    return [re.findall(r"<td[^>]*>(.*?)</td>", row, re.S) for row in rows]


def test_compare_page_lists_differences(stems: tuple[Run, Run], tmp_path: Path) -> None:
    """The page has the changed key alone, and numbers of both runs with their differences."""
    folders = [run.folder for run in stems]
    html = compare.write(folders, tmp_path / "new" / "page.html").read_text(encoding="utf-8")
    assert cells(html, "input") == [[FRICTION, "0.4", "0.9"]]
    slips: list[Any] = [1e3 * run.summary["interfaces"]["stem_cement"]["slip_p99"] for run in stems]
    rows = cells(html, "differences", table=0) + cells(html, "differences", table=1)
    row = next(r for r in rows if r[0].startswith("stem-cement slip, p99"))
    assert [float(row[1]), float(row[2])] == pytest.approx(slips, rel=1e-3)
    assert float(row[3].split()[0]) == pytest.approx(slips[1] - slips[0], rel=1e-3)
    assert html.count('class="one"') == 3  # two runs and their difference
    # No errors were estimated: none is claimed to be known, in sentence, table or verdict.
    assert "Run with --error to see whether" in html and row[3].endswith("unknown")
    assert "by more than their errors" not in html and "within the errors" not in html
    assert html.count("converged</span>: smooth; errors not estimated") == 1
    for run in stems:  # as if they had been: 1 % of the smooth run, all of the other
        copy = tmp_path / run.folder.name
        copy.mkdir()
        numbers = run.summary | {"error": {"companions": ["mesh 8 mm"]}}
        for q in numbers["interfaces"].values():
            q |= {f"{key}_error": 0.01 * q[key] for key in ("slip_p99", "motion_p99")}
        (copy / "summary.json").write_text(json.dumps(numbers))
    html = compare.write([tmp_path / r.folder.name for r in stems], tmp_path / "b.html").read_text()
    assert re.search(r"\d of 4 numbers differ from those of smooth by more than", html)
    assert re.search(r"\d+ of \d+ numbers without errors differ from those of smooth\.", html)
    scripts = re.sub(r"<script>.*?</script>", "", html, flags=re.S)
    assert not re.search(r"(src|href)=\"(?!#|data:)", scripts)


def test_compare_equal_runs_have_no_difference(stems: tuple[Run, Run], tmp_path: Path) -> None:
    """Neither input nor numbers differ."""
    copy = shutil.copytree(stems[0].folder, tmp_path / "copy")
    html = compare.write([stems[0].folder, copy], tmp_path / "same.html").read_text("utf-8")
    assert re.search(r"0 of \d+ numbers without errors differ", html)
    assert "runs of the same case" in html
    assert {row[3] for row in cells(html, "differences")} == {"0"}


def test_compare_refuses_folders_without_results(tmp_path: Path) -> None:
    """The message names each folder. One run alone cannot be compared."""
    with pytest.raises(InputError) as caught:
        compare.write([tmp_path / "a", tmp_path / "b"], tmp_path / "page.html")
    assert str(caught.value).count("summary.json") == 2
    with pytest.raises(InputError, match="given twice"):
        compare.write([tmp_path / "a", tmp_path / "x" / ".." / "a"], tmp_path / "page.html")
    with pytest.raises(InputError, match="not 1"):
        compare.write([tmp_path / "a"], tmp_path / "page.html")
    assert not list(tmp_path.iterdir())


def test_compare_refuses_runs_without_a_common_number(tmp_path: Path) -> None:
    """One run has one interface, the other another."""
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        numbers = {"status": "converged", "time": 1.0, "interfaces": {name: {"slip_p99": 0.1}}}
        (tmp_path / name / "summary.json").write_text(json.dumps(numbers))
    with pytest.raises(InputError, match="no numbers in common"):
        compare.write([tmp_path / "a", tmp_path / "b"], tmp_path / "page.html")
