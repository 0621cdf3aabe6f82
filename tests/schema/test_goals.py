"""Goals and divided cells in case files: what is allowed, and what is said of the rest."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.case import divided_cells
from app.errors import InputError
from tests import support
from tests.results.test_goal import STACK


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("output.goal=stem.subsidense", "did you mean 'subsidence'"),
        ("output.goal=bone_stem.pressure_p95", "is no motion; expected"),
        ("output.goal=bone.von_mises_p99", "is no motion; expected"),
        ("output.goal=bone_steam.slip_p99", "did you mean 'bone_stem'"),
        ("output.goal=3", "is not the name of a number"),
        ("mesh.divided=nowhere.csv", "No such file"),
    ],
)
def test_wrong_ones_are_refused(change: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        support.case(STACK, change)


def test_goals_need_what_they_are_of() -> None:
    with pytest.raises(InputError, match="interface in contact"):
        support.case(STACK, "output.goal=bone_stem.slip_p99", "interfaces.bone_stem={kind: bonded}")
    with pytest.raises(InputError, match="no region is of the tissue implant"):
        support.case(STACK, "output.goal=stem.varus", "regions.stem.tissue=other")


def test_cells_are_read_as_they_are_written(tmp_path: Path) -> None:
    passes = [[(1.0, 2.0, 3.0), (-1.5, 0.0, 1e-6)], [(4.0, 5.0, 6.0)]]
    path = tmp_path / "cells.csv"
    path.write_text(divided_cells.text(passes))
    assert divided_cells.read(path) == tuple(map(tuple, passes))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "does not begin with the line pass,x_mm,y_mm,z_mm"),
        ("a,b\n", "does not begin with"),
        ("pass,x_mm,y_mm,z_mm\n1,2,3\n", "line 2 is not a pass and three coordinates"),
        ("pass,x_mm,y_mm,z_mm\n1,2,3,x\n", "line 2 is not"),
        ("pass,x_mm,y_mm,z_mm\n1,2,3,4\n3,2,3,4\n", "line 3: passes are not numbered"),
        ("pass,x_mm,y_mm,z_mm\n0,2,3,4\n", "line 2: passes are not numbered"),
        ("pass,x_mm,y_mm,z_mm\n1,inf,3,4\n", "line 2 is not"),
    ],
)
def test_other_tables_are_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "cells.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=said):
        support.case(STACK, f"mesh.divided={path}")


def test_companions_and_straight_cells_do_not_go_with_divided_ones(tmp_path: Path) -> None:
    path = tmp_path / "cells.csv"
    path.write_text(divided_cells.text([[(1.0, 2.0, 3.0)]]))
    with pytest.raises(InputError, match="no coarser companion"):
        support.case(STACK, f"mesh.divided={path}", "output.error=true")
    with pytest.raises(InputError, match=r"expected mesh\.order: 2"):
        support.case(support.STEM, f"mesh.divided={path}")
    support.case(support.STEM, f"mesh.divided={path}", "mesh.order=2")
