"""Verdicts on the numbers of a run: good, doubtful and bad ones."""

from __future__ import annotations

from typing import Any

import pytest

from app.foundation.verdict import Severity, Verdict, note, recorded
from app.results import verdicts


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


def judged(numbers: dict[str, Any]) -> dict[str, tuple[str, str]]:
    """Words and severity of each verdict but the first, by the part of the result."""
    first, *rest = verdicts.of_numbers(numbers)
    assert first.text.startswith("converged: 974 unknowns") and first.severity is Severity.PLAIN
    return {v.where: (f"{v.what}; {v.remedy}" if v.remedy else v.what, v.severity) for v in rest}


def test_verdicts_on_good_results() -> None:
    assert judged(summary()) == {
        "equilibrium": (
            "satisfied to rounding (relative errors: force 1.0e-12, moment 1.0e-12, "
            "energy 1.0e-12)",
            "good",
        ),
        "contact": (
            "satisfied to rounding at nodes; between nodes bodies overlap by up to 4.1 um",
            "good",
        ),
        "mesh and step": ("errors are not estimated; run with --error", "plain"),
    }


def test_verdicts_on_pressure_by_facets() -> None:
    numbers = summary()
    numbers["interfaces"]["stem_cement"]["pressure_by_facets"] = 4.0
    words, tone = judged(numbers)["pressure"]
    assert words.startswith("the maximum on stem_cement, 9.00 ± 9.00 MPa, depends on the facets")
    assert "may cause up to 4.00 MPa" in words and tone == "warning"
    numbers["interfaces"]["stem_cement"]["pressure_by_facets"] = 14.0  # more than there is
    assert "may cause all of it" in judged(numbers)["pressure"][0]


def test_verdicts_on_singular_pressure() -> None:
    numbers = summary()
    numbers["interfaces"]["stem_cement"] |= {"pressure_max": 9.0, "pressure_mean_max": 5.9}
    words, tone = judged(numbers)["pressure"]
    assert words == (
        "the maximum on stem_cement, 9.00 ± 9.00 MPa, is at a ridge or an edge; averaged over the "
        "area of a node on one face the pressure is at most 5.90 MPa"
    )
    assert tone == "warning"
    numbers["interfaces"]["stem_cement"]["pressure_mean_max"] = 6.1
    assert "pressure" not in judged(numbers)


@pytest.mark.parametrize(("largest", "mean"), [(0.0, -0.03), (2e-10, 1e-10), (0.004, 0.001)])
def test_verdicts_on_pressure_that_is_zero(largest: float, mean: float) -> None:
    """A bond in tension and an unloaded interface have no meaningful largest pressure."""
    numbers = summary()
    numbers["interfaces"]["stem_cement"] |= {"pressure_max": largest, "pressure_mean_max": mean}
    assert "pressure" not in judged(numbers)


def test_verdicts_on_bad_results() -> None:
    numbers = summary(balance={"force": 1e-3, "moment": 0.0, "energy": 0.0, "heat": 1e-3})
    numbers["interfaces"]["stem_cement"] |= {"penetration_max": 2e-3, "slip_max": 5.0}
    lines = judged(numbers)
    lost = "NOT satisfied: relative error of force 1.0e-03; allowed 1e-08"
    assert lines["equilibrium"] == (lost, "error")
    assert lines["heat"] == (
        "NOT balanced: relative error of heat 1.0e-03; allowed 1e-06",
        "error",
    )
    assert lines["contact"] == ("bodies overlap by 2 um at nodes", "warning")
    assert lines["slip"][0].endswith("use `sliding: finite`") and lines["slip"][1] == "error"


def test_verdicts_on_layers_say_their_compression() -> None:
    """The overlap of an elastic layer follows from its law.

    The overlap of exact contact is a fault.
    """
    numbers = summary()
    layer = {"penetration_max": 0.024, "penetration_sampled": 0.025, "compression_max": 0.024}
    numbers["interfaces"]["stem_bone"] = layer
    assert judged(numbers)["contact"] == (
        "satisfied to rounding at nodes; between nodes bodies overlap by up to 4.1 um; the elastic "
        "layer of stem_bone is compressed by up to 24 um",
        "good",
    )
    numbers["interfaces"]["stem_cement"]["penetration_max"] = 2e-3
    words, tone = judged(numbers)["contact"]
    assert words.startswith("bodies overlap by 2 um at nodes; the elastic layer of stem_bone is")
    assert tone == "warning"


def test_verdicts_on_rim_and_tip() -> None:
    """The rim's gap is reported.

    Bodies that slip too far at the rim have the verdict 'not to be used'.
    """
    numbers = summary()
    numbers["interfaces"]["stem_cement"]["rim"] = {"gap_max": 0.074, "slip_max": 5.0}
    lines = judged(numbers)
    words = ". These numbers exclude rim and tip; the rim opens by 74.0 um (stem_cement)"
    assert lines["contact"][0].endswith(words)
    assert lines["slip"][0].startswith("larger than a facet on stem_cement")


def test_verdicts_on_errors_exclude_maxima() -> None:
    unsettled = {"stem_cement.pressure_max": [[4.0, 9.0], [8.0, 6.1], [12.0, 4.25]]}
    error = {
        "companions": ["mesh 8 mm", "mesh 12 mm"],
        "unsettled": unsettled,
        "share_within_error": 0.9,
    }
    lines = judged(summary(error=error))
    words = (
        "half of the percentiles have errors below ± 5 %; the largest error is ± 5 % "
        "(stem-cement pressure, p95). For about 90 % of such numbers the true error is smaller "
        "than ±"
    )
    assert lines["mesh and step"] == (words, "plain")
    assert "load step" not in lines
    peaks = "stem-cement pressure 9.00 MPa at 4 mm, 6.10 at 8, 4.25 at 12"
    assert lines[verdicts.PEAKS] == (peaks, "warning")


def test_verdicts_on_errors_name_numbers_that_are_not_resolved() -> None:
    """A number below its ± counts neither in the median nor as the largest error."""
    numbers = summary(error={"companions": ["mesh 8 mm"]})
    numbers["interfaces"]["stem_cement"] |= {"slip_p99": 0.03, "slip_p99_error": 0.04}
    words, _ = judged(numbers)["mesh and step"]
    assert words == (
        "half of the percentiles have errors below ± 5 %; the largest error is ± 5 % (stem-cement "
        "pressure, p95). Not resolved, because ± exceeds them: stem-cement slip, p99"
    )


def test_verdicts_name_the_three_worst_maxima() -> None:
    keys = ("gap_max", "pressure_max", "slip_max", "motion_max", "shear_max")
    unsettled = {f"stem_cement.{k}": [[2.5, 0.0742], [5.0, 0.06]] for k in keys}
    words, _ = judged(summary(error={"companions": ["mesh 5 mm"], "unsettled": unsettled}))[
        verdicts.PEAKS
    ]
    first, *others, rest = words.split("; ")
    assert first == "stem-cement gap 74.2 um at 2.5 mm, 60.0 at 5"
    assert [text.split()[1] for text in others] == ["pressure", "slip"]
    assert rest == "2 more: `error.unsettled` in summary.json"


def test_verdicts_on_errors_of_steps_alone() -> None:
    """The mesh of a file has no coarser version."""
    error = {"companions": ["mesh 4 mm, 0.5 times the steps"], "sources": "load step"}
    lines = judged(summary(error=error))
    assert "mesh and step" not in lines and verdicts.PEAKS not in lines
    assert lines["load step"][0].endswith("; the error of the mesh is not estimated")


def test_verdicts_on_heat_alone() -> None:
    """A balance of 2e-6 is above its limit."""
    numbers = summary(interfaces={}, balance={"heat": 3e-12, "heat_quadrature": 1e-3})
    assert judged(numbers)["heat"] == ("balanced (relative error 3.0e-12)", "good")
    assert "equilibrium" not in judged(numbers) and "contact" not in judged(numbers)
    numbers["balance"]["heat"] = 2e-6
    assert judged(numbers)["heat"][1] == "error"


def test_verdicts_are_read_as_recorded() -> None:
    numbers = summary(balance={"force": 1e-3, "moment": 0.0, "energy": 0.0})
    remark = note("is it in per cent?", "interfaces.a", "expected 0 to 1.5")
    verdicts.record_verdicts(numbers, [remark])
    assert recorded(numbers) == [*verdicts.of_numbers(numbers), remark]
    assert verdicts.notes_of(numbers) == ["interfaces.a: is it in per cent?; expected 0 to 1.5"]
    assert verdicts.reasons_not_to_use(numbers) == [
        "equilibrium: NOT satisfied: relative error of force 1.0e-03; allowed 1e-08"
    ]


def test_verdicts_name_failed_companions() -> None:
    numbers = summary(
        error={"companions": ["mesh 8 mm"], "failed": ["mesh 12 mm"], "share_within_error": 0.9}
    )
    words = "these coarser runs failed and are left out of the estimate: mesh 12 mm"
    assert Verdict(words, "error", severity=Severity.WARNING) in verdicts.of_numbers(numbers)


def test_verdicts_on_physiology() -> None:
    femur = {"head_displacement": [3.0, 0.0, -3.9], "strain_lateral_10": 1.2e-3}
    loads = [{"force": (0.0, 0.0, -500.0)}]
    good = femur | {"strain_lateral_10_error": 0.1}
    assert "physiology" not in judged(summary(femur=good, section_loads=loads))
    femur |= {"head_displacement": [3.0, 0.0, -4.1], "strain_medial_80": -2.6e-3}
    assert "physiology" not in judged(summary(femur=femur, section_loads=[{"force": (0.0,) * 3}]))
    assert judged(summary(femur=femur, section_loads=loads))["physiology"] == (
        "the head moves 5.1 mm (usually at most 5 mm); the strain of the cortex is 1200 to 2600 "
        "um/m (usually 500 to 2500 um/m)",
        "warning",
    )


def test_verdicts_on_physiology_allow_cortex_shielded_by_a_stem() -> None:
    """Small strains next to a stem are usual. If all strains are small, the load is too small."""
    femur = {"head_displacement": [0.0, 0.0, -1.0], "strain_lateral_10": 4e-4}
    loads = [{"force": (0.0, 0.0, -500.0)}]
    intact = femur | {"strain_lateral_80": 2e-3}
    words = "the strain of the cortex is 400 to 2000 um/m (usually 500 to 2500 um/m)"
    verdict = judged(summary(femur=intact, section_loads=loads, stem={}))
    assert verdict["physiology"] == (words, "warning")
    stem = {"subsidence": 0.02}
    assert "physiology" not in judged(summary(femur=intact, section_loads=loads, stem=stem))
    small = judged(summary(femur=femur, section_loads=loads, stem=stem))
    assert small["physiology"][0].startswith("the strain of the cortex is 400 to 400 um/m")
