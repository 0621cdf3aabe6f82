"""Tables of a sweep; `test_sweep_report.py` tests levels and rank correlations."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.report import sweep_results, sweep_tables
from tests.report.sweeps import Maker, femur


@pytest.mark.parametrize(("ranks", "shown"), [((1, 1), False), ((1, 2), True)])
def test_sweep_tables_leave_out_columns_without_content(
    ranks: tuple[int, int], shown: bool, tmp_path: Path
) -> None:
    """A number that is 1 in each case is content; one rank in each case is none."""
    maker = Maker(tmp_path)
    for k, count in enumerate(ranks):
        numbers = {"stem_cement": {"open_fraction": 1.0}}
        maker.add(f"case {k}", femur(), {"interfaces": numbers}, ranks=count)
    cases = sweep_results.read(maker.write()).cases
    (table,) = sweep_tables.cases_table(cases, ["stem_cement.open_fraction"], tmp_path)
    assert ("ranks" in str(table)) == shown
    assert "open" in str(table) and "message" not in str(table)
