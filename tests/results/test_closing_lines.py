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
    assert list(closing_lines.closing_tables({"interfaces": {}, "regions": {}, "stem": {}})) == []
    lines = list(closing_lines.closing_tables(heat()))
    hottest = next(line for line in lines if line.startswith("bone"))
    assert "54.9 ± 1.6" in hottest and "52.0" in hottest
    sides = next(line for line in lines if line.startswith("cement_bone"))
    assert sides.split() == ["cement_bone", "100.0", "54.9", "63.0"]
    assert not any("largest flux" in line for line in lines), "a column without a number"
    dead = next(line for line in lines if line.startswith("CEM43 of 16"))
    assert dead.split()[-2:] == ["43.8", "1.25"]
    assert lines[-1] == (
        "cement: degree of cure 0.6200 to 0.9900, 50 % everywhere after 622.1 s; "
        "largest rate 0.0941 1/s"
    )


def test_closing_lines_of_heat_alone_have_no_forces() -> None:
    text = "\n".join(closing_lines.closing_tables(heat()))
    assert "von Mises" not in text and "contact" not in text


def moved() -> dict[str, Any]:
    interface = {"motion_p99": 0.0346, "motion_p99_error": 0.0391, "gap_p99": 0.0103}
    tension = {"principal_p99": 3.22, "principal_p99_error": 2.75, "volume_over_3_MPa": 1.0}
    return {
        "interfaces": {"stem_cement": interface, "cement_bone": {"motion_p99": 0.0175}},
        "regions": {"cement": tension, "stem": {"principal_p99": 97.42}},
        "stem": {"subsidence": 0.0164, "retroversion": 0.041, "varus": 0.009},
    }


def test_closing_lines_headline_says_what_moves_and_what_cement_carries() -> None:
    assert list(closing_lines.headline(moved())) == [
        "99 % of the surface moves by less than 34.6 ± 39.1 um (not resolved) (stem_cement), "
        "17.5 um (cement_bone)",
        "the stem moves against the bone: subsidence 16.4 um, retroversion 0.041 deg, "
        "varus 0.009 deg",
        "99 % of the cement has a tension below 3.22 ± 2.75 MPa",
    ]
    assert list(closing_lines.headline({"interfaces": {}, "regions": {}, "stem": {}})) == []


def test_closing_lines_headline_has_the_hottest_bone() -> None:
    hot = heat()
    hot["thermal"]["regions"]["bone"]["cem43_max"] = 12.0
    assert list(closing_lines.headline(hot)) == ["the bone is hottest in bone: 54.9 ± 1.6 degC"]


def test_closing_lines_mark_numbers_that_are_not_resolved_with_a_star() -> None:
    *table, legend = closing_lines.closing_tables(moved())
    row = next(line for line in table if line.startswith("stem_cement"))
    assert "34.6 ± 39.1*" in row and "not resolved" not in row
    assert legend == closing_lines.LEGEND
    summary = moved()
    del summary["interfaces"]["stem_cement"]["motion_p99_error"]
    assert closing_lines.LEGEND not in closing_lines.closing_tables(summary)


def test_closing_lines_name_a_stem_only_where_there_is_one() -> None:
    """Two boxes are bone and implant by their materials.

    Numbers that round to zero have no sign.
    """
    motion = {"subsidence": -1e-6, "retroversion": -1e-5, "varus": 0.009}
    boxes = {"interfaces": {"joint": {}}, "regions": {"lower": {}, "upper": {}}, "stem": motion}
    (line,) = closing_lines.headline(boxes)
    assert line == (
        "the implant moves against the bone: subsidence 0.0 um, retroversion 0.000 deg, "
        "varus 0.009 deg"
    )
    (line,) = closing_lines.headline(boxes | {"interfaces": {"stem_bone": {}}})
    assert line.startswith("the stem moves against the bone")
