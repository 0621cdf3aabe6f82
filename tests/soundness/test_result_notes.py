"""Notes on the numbers of a solved case."""

from __future__ import annotations

from app.soundness import result_notes
from tests import support
from tests.soundness.judged import TWO


def test_result_notes_on_large_strains() -> None:
    case = support.case(TWO)
    numbers = {"bone": {"von_mises_p99": 1200.0}, "metal": {"von_mises_p99": 1200.0}}
    note = result_notes.of_results(case, {"regions": numbers})[0].text
    assert note.startswith("region 'bone': is strained by 7.1 %")
