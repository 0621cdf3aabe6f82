"""Files of a run."""

from __future__ import annotations

import csv
import io

from app.system.folders import csv_text


def test_no_text_of_a_case_is_a_formula_in_a_spreadsheet() -> None:
    bad = ["=1+1", "@SUM(A1)", "+cmd|' /C calc'!A0", "-x", "-1+1", "\t=1", "\r=1"]
    good = ["-1.5", "+.5", "1e-3", "-1e-3", "a=b", "", "titanium, 4 mm"]
    rows = [{"=key": text, "n": -1.5} for text in (*bad, *good)] + [{"other": None}]
    first, *found = csv.reader(io.StringIO(csv_text(rows), newline=""))
    assert first == ["'=key", "n", "other"]
    assert [row[0] for row in found] == [*(f"'{text}" for text in bad), *good, ""]
    assert {row[1] for row in found} == {"-1.5", ""}
