"""The closing lines say in words what is good and what is not; the tables have every number."""

from __future__ import annotations

from typing import Any

from app.results import closing_lines

CHANGE = "peaks that still change with the mesh"


def summary(**changes: Any) -> dict[str, Any]:
    interface = {
        **{"penetration_max": 0.0, "penetration_sampled": 4.1e-3, "facet_size": 4.0},
        **{"slip_max": 0.07, "slip_p99": 0.05, "slip_p99_error": 0.001},
        **{"pressure_p95": 2.0, "pressure_p95_error": 0.1},
        **{"pressure_max": 9.0, "pressure_max_error": 9.0},
    }
    return {
        "interfaces": {"stem_cement": interface},
        "regions": {},
        "balance": {"force": 1e-12, "moment": 1e-12, "energy": 1e-12},
        "solver": {"dofs": 974, "steps": 36, "newton_iterations": 546, "ranks": 2},
        "timing": {"total": 12.0},
    } | changes


def told(found: dict[str, Any]) -> dict[str, tuple[str, str]]:
    """By what it is about: the words and the tone of each line but the first."""
    first, *rest = (*closing_lines.verdict(found), *closing_lines.peaks(found))
    assert first.text.startswith("converged: 974 unknowns") and not first.tone
    parts = [(*clause.text.split(": ", 1), clause.tone) for clause in rest]
    return {about: (words, tone) for about, words, tone in parts}


def test_what_is_good() -> None:
    assert told(summary()) == {
        "equilibrium": ("exact to rounding", "good"),
        "contact": ("exact to rounding at points, within 4.1 um between them", "good"),
        "mesh and step": ("error not estimated (--error does)", ""),
    }


def test_largest_pressure_that_facets_decide() -> None:
    found = summary()
    found["interfaces"]["stem_cement"]["pressure_by_facets"] = 4.0
    words, tone = told(found)["pressure"]
    assert words.startswith("the maximum on stem_cement, 9.00 ± 9.00 MPa, depends on the facets")
    assert "makes up to 4.00 MPa" in words and tone == "doubtful"


def test_largest_pressure_far_above_the_means_of_points() -> None:
    found = summary()
    found["interfaces"]["stem_cement"] |= {"pressure_max": 9.0, "pressure_mean_max": 5.9}
    words, tone = told(found)["pressure"]
    assert words == (
        "the maximum on stem_cement, 9.00 ± 9.00 MPa, is at a ridge or an edge; the mean at one "
        "point is 5.90 MPa at most"
    )
    assert tone == "doubtful"
    found["interfaces"]["stem_cement"]["pressure_mean_max"] = 6.1
    assert "pressure" not in told(found)


def test_what_is_bad_stands_out() -> None:
    found = summary(balance={"force": 1e-3, "moment": 0.0, "energy": 0.0, "heat": 1e-3})
    found["interfaces"]["stem_cement"] |= {"penetration_max": 2e-3, "slip_max": 5.0}
    lines = told(found)
    assert lines["equilibrium"] == ("NOT balanced (force), do not use", "bad")
    assert lines["heat"] == ("NOT balanced, do not use", "bad")
    assert lines["contact"] == ("the bodies penetrate by 2 um", "doubtful")
    assert lines["slip"][0].endswith("do not use") and lines["slip"][1] == "bad"


def test_what_is_reported_apart() -> None:
    """The rim's gap is told; bodies that slip too far there are not to be used."""
    found = summary()
    found["interfaces"]["stem_cement"]["rim"] = {"gap_max": 0.074, "slip_max": 5.0}
    lines = told(found)
    words = "; numbers are without rim and tip, the rim opens by 74.0 um (stem_cement)"
    assert lines["contact"][0].endswith(words)
    assert lines["slip"][0].startswith("on stem_cement exceeds")


def test_the_error_is_told_without_peaks() -> None:
    unsettled = {"stem_cement.pressure_max": [[4.0, 9.0], [8.0, 6.1], [12.0, 4.25]]}
    error = {"companions": ["mesh 8 mm", "mesh 12 mm"], "unsettled": unsettled, "within": 0.9}
    lines = told(summary(error=error))
    words = (
        "half of the percentiles within ± 5 %, the least sure (pressure_p95 of stem_cement) within "
        "± 5 %; about 90 of 100 such numbers lie within their ±"
    )
    assert lines["mesh and step"] == (words, "")
    assert "load step" not in lines
    peaks = "stem_cement.pressure_max 9.00 MPa at 4 mm, 6.10 at 8, 4.25 at 12"
    assert lines[CHANGE] == (peaks, "doubtful")


def test_of_many_peaks_the_three_worst_are_told() -> None:
    keys = ("gap_max", "pressure_max", "slip_max", "motion_max", "shear_max")
    unsettled = {f"stem_cement.{k}": [[2.5, 0.0742], [5.0, 0.06]] for k in keys}
    words, _ = told(summary(error={"companions": ["mesh 5 mm"], "unsettled": unsettled}))[CHANGE]
    first, *others, rest = words.split("; ")
    assert first == "stem_cement.gap_max 74.2 um at 2.5 mm, 60.0 at 5"
    assert [name.split()[0] for name in others] == [f"stem_cement.{k}" for k in keys[1:3]]
    assert rest == "2 more in error.unsettled of summary.json"


def test_where_only_steps_were_compared_the_error_is_theirs() -> None:
    """The mesh of a file has no coarser one."""
    error = {"companions": ["mesh 4 mm, 0.5 times the steps"], "of": "load step"}
    lines = told(summary(error=error))
    assert "mesh and step" not in lines and CHANGE not in lines
    assert lines["load step"][0].endswith("within ± 5 %; error of the mesh not estimated")


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
    return summary(
        interfaces={},
        stem={},
        thermal={
            "regions": {"bone": region},
            "interfaces": {"cement_bone": sides | {"temperature_jump_max": 63.0}},
        },
        cure={"cement": degrees | {"time_50": 622.13, "time_90": None, "rate_max": 0.0941}},
        balance={"heat": 3e-12, "heat_quadrature": 1e-3},
    )


def test_every_number_of_heat_has_its_place() -> None:
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


def test_a_run_of_heat_alone_says_nothing_of_forces() -> None:
    told = closing_lines.closing_table(heat())
    assert "von Mises" not in told and "contact" not in told
    assert told.endswith("balance of heat 3.0e-12") and closing_lines.Verdict(
        "heat: none is lost", "good"
    ) in closing_lines.verdict(heat())
    lost = heat()
    lost["balance"]["heat"] = 2e-6
    assert any(clause.tone == "bad" for clause in closing_lines.verdict(lost))


def test_a_femur_that_is_not_a_living_one_is_told() -> None:
    femur = {"head_displacement": [3.0, 0.0, -3.9], "strain_lateral_10": 1.2e-3}
    loads = [{"force": (0.0, 0.0, -500.0)}]
    good = femur | {"strain_lateral_10_error": 0.1}
    assert "physiology" not in told(summary(femur=good, section_loads=loads))
    femur |= {"head_displacement": [3.0, 0.0, -4.1], "strain_medial_80": -2.6e-3}
    assert "physiology" not in told(summary(femur=femur, section_loads=[{"force": (0.0,) * 3}]))
    assert told(summary(femur=femur, section_loads=loads))["physiology"] == (
        "the head moves 5.1 mm, above 5; the cortex is strained by 1200 to 2600 um/m, not within "
        "500 to 2500",
        "doubtful",
    )
