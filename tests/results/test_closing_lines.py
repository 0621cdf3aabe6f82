"""The closing tables have every number of a run."""

from __future__ import annotations

from typing import Any

from app.results import closing_lines


def heat() -> dict[str, Any]:
    region = {
        **{"temperature_max": 54.94, "temperature_max_error": 1.62, "temperature_max_time": 6.4},
        **{"temperature_end_max": 37.9, "temperature_mean": 37.4, "seconds_over_47": 52.03},
        **{f"necrosis_cem43_{m}_volume": 700.0 / m for m in (16, 60, 240)},
        **{f"necrosis_cem43_{m}_depth": 20.0 / m for m in (16, 60, 240)},
    }
    for rule in ("47C_1min", "henriques_moritz"):
        region |= {f"necrosis_{rule}_volume": 0.0, f"necrosis_{rule}_depth": 0.0}
    sides = {"temperature_max_first": 100.0, "temperature_max_second": 54.9}
    degrees = {"degree_min": 0.62, "degree_max": 0.99}
    return {
        **{"interfaces": {}, "regions": {}, "stem": {}},
        "thermal": {
            "regions": {"bone": region},
            "interfaces": {"cement_bone": sides | {"temperature_jump_max": 63.0}},
        },
        "cure": {"cement": degrees | {"time_50": 622.13, "time_90": None, "rate_max": 0.0941}},
        "balance": {"heat": 3e-12, "heat_quadrature": 1e-3},
    }


def test_closing_lines_have_every_number_of_heat() -> None:
    assert list(closing_lines.lines({"interfaces": {}, "regions": {}, "stem": {}})) == []
    lines = list(closing_lines.lines(heat()))
    hottest = next(line for line in lines if line.startswith("bone"))
    assert "54.9 ± 1.6" in hottest and "52.0" in hottest
    sides = next(line for line in lines if line.startswith("cement_bone"))
    assert sides.split() == ["cement_bone", "100.0", "54.9", "63.0", "-"]
    dead = next(line for line in lines if line.startswith("CEM43 of 16"))
    assert dead.split()[-2:] == ["43.8", "1.25"]
    assert lines[-1] == (
        "cement has set to 0.6200 .. 0.9900, 50 % everywhere at 622.1 s; fastest rate 0.0941 1/s"
    )


def test_closing_lines_of_heat_alone_have_no_forces() -> None:
    told = closing_lines.closing_table(heat())
    assert "von Mises" not in told and "contact" not in told
    assert told.endswith("balance of heat 3.0e-12")
