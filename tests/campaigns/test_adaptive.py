"""A mesh graded for one number: it gets there with fewer cells, and says so where it does not."""

from __future__ import annotations

import csv
from functools import partial
from pathlib import Path

import pytest

import mantle
from app.campaigns import adaptive
from app.case import divided_cells, loaded_case
from app.case.case import Case
from app.case.goals import share
from app.errors import ConvergenceError, InputError
from app.schema.yaml_file import CaseFile
from app.soundness import memory
from tests.results.test_goal import STACK

GOAL = "stem.top_displacement.x"


def solved(folder: Path, to: float, case: str = STACK) -> list[dict[str, str]]:
    """Rows of adapt.csv."""
    path = folder / "stack.yaml"
    path.write_text(case)
    loaded = mantle.load(path, output__goal=GOAL, output__report=False, output__fields=False)
    adaptive.run(loaded, folder / "out", to, partial(mantle.run, force=True))
    with (folder / "out" / "adapt.csv").open(newline="") as file:
        return [*csv.DictReader(file)]


def test_cells_are_divided_until_the_error_is_small(tmp_path: Path) -> None:
    rows = solved(tmp_path, 0.05)
    parts = [float(row["error [%]"]) for row in rows]
    assert len(rows) > 1
    assert parts[-1] <= 5 < parts[0]
    assert (tmp_path / "out" / "DONE").exists()
    cells = [int(row["cells"]) for row in rows]
    assert cells == sorted(cells)
    # A pass is a run of its own: its case makes the same mesh again.
    last = tmp_path / "out" / f"pass-{len(rows) - 1}"
    again = loaded_case.load(last / "case.yaml")
    assert len(mantle.mesh(again).cells) == cells[-1]
    assert len(divided_cells.read(last / "divided.csv")) == len(rows)
    # Within what is said of a mesh twice as fine all over, and with fewer cells.
    value = float(rows[-1][f"{GOAL} [mm]"])
    path = tmp_path / "stack.yaml"
    fine = {"mesh.size": "1.6 mm", "mesh.far_size": "1.6 mm"}
    reference = mantle.run(
        mantle.load(path, **fine, output__report=False, output__fields=False),
        tmp_path / "fine",
    )
    truth = reference.summary["stem"]["top_displacement"][0]
    assert abs(value - truth) < 3 * float(rows[-1]["error [mm]"])


def test_too_little_memory_for_the_next_mesh_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first mesh fits; the pass that did is there, with the cells to be divided."""

    def check(file: CaseFile, case: Case) -> None:
        if case.mesh.divided:
            raise InputError("2 GB; there are 1 GB")

    monkeypatch.setattr(memory, "check", check)
    with pytest.raises(ConvergenceError, match=r"known to .* %, not to 0\.01 %.*1 GB"):
        solved(tmp_path, 1e-4)
    assert (tmp_path / "out" / "pass-0" / "divided.csv").exists()
    assert not (tmp_path / "out" / "DONE").exists()


@pytest.mark.parametrize(("text", "value"), [("2%", 0.02), ("0.05", 0.05), (" 10 % ", 0.1)])
def test_parts_of_a_number(text: str, value: float) -> None:
    assert share(text) == pytest.approx(value)


@pytest.mark.parametrize("text", ["2", "0", "-1%", "two", "2%%", "nan", ""])
def test_what_is_no_part_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="not a part of the number"):
        share(text)
