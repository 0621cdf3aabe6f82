"""Stages of a run: peaks and valleys of their loads."""

from __future__ import annotations

import pytest

from app.case.run_options import Stage


def test_run_options_stage_with_cycles_has_peaks_and_valleys() -> None:
    stage = Stage(name="walk", cycles=3)
    times = [2.0 + k / 5 for k in range(1, 6)]
    assert stage.has_valleys
    assert [stage.is_peak(t) for t in times] == [True, False, True, False, True]
    assert [stage.is_valley(t) for t in times] == [False, True, False, True, False]
    assert not stage.is_peak(2.1) and not stage.is_valley(2.1)


@pytest.mark.parametrize("cycles", [1, 3])
def test_run_options_cycle_tables_have_no_valleys(cycles: int) -> None:
    stage = Stage(name="walk", cycles=cycles).repeating()
    assert not stage.has_valleys
    assert all(stage.is_peak((k + 1) / cycles) for k in range(cycles))
