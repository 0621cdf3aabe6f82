"""Numbers of a summary by their names."""

from __future__ import annotations

from app.case import summary_numbers


def test_summary_numbers_are_read_by_name() -> None:
    summary = {
        "interfaces": {"a_b": {"slip_p99": 0.1, "force": [1, 2, 3], "force_error": [4, 5, 6]}},
        "regions": {"stem": {"von_mises_p99": 7.0}},
        "stem": {"subsidence": 0.2, "subsidence_error": 0.3},
        "thermal": {"regions": {"bone": {"temperature_max": 3.0}}, "interfaces": {}},
        "cure": {"cement": {"time_50": 5.0}},
    }
    assert summary_numbers.read(summary, "a_b.slip_p99") == 0.1
    assert summary_numbers.read(summary, "a_b.force.y") == 2
    assert summary_numbers.read(summary, "a_b.force.z", "_error") == 6
    assert summary_numbers.read(summary, "stem.von_mises_p99") == 7
    assert summary_numbers.read(summary, "stem.subsidence", "_error") == 0.3
    assert summary_numbers.read(summary, "bone.temperature_max") == 3
    assert summary_numbers.read(summary, "cement.time_50") == 5
    assert summary_numbers.read(summary, "a_b.gap_p99") is None
    assert summary_numbers.read({}, "stem.subsidence") is None
