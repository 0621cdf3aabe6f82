"""Estimated times beside those measured on one idle core."""

from __future__ import annotations

import pytest

from mantle.schema import config
from mantle.soundness import cost
from tests.support import CONFIGS

NO_ERRORS = "output.error=false"
# Of runs whose processor time was near their time by the clock, with all forms compiled.
MEASURED = {
    ("stance",): 38.2,
    ("stance", NO_ERRORS): 31.5,
    ("stance", NO_ERRORS, "mesh.size=8 mm"): 4.9,
    ("stance", NO_ERRORS, "mesh.size=6 mm"): 4.9,
    ("stance", NO_ERRORS, "mesh.size=3 mm"): 49.0,
    ("stance", NO_ERRORS, "mesh.size=2.5 mm"): 316.0,
    ("intact",): 50.0,
    ("cylinders",): 5.0,
    ("cure",): 36.0,
    ("thermal_100C",): 73.5,
    ("residual",): 210.0,
}


@pytest.mark.parametrize("case", MEASURED, ids=" ".join)
def test_times_are_estimated_within_a_factor_of_two(case: tuple[str, ...]) -> None:
    name, *changes = case
    seconds = cost.seconds(config.load(CONFIGS / f"{name}.yaml", changes))
    assert 0.5 < seconds / MEASURED[case] < 2


def test_check_tells_the_time() -> None:
    told = cost.estimated_size(config.load(CONFIGS / "variations.yaml"))
    assert " s on one core, " in told and "for all variations" in told
    assert "10 s more where forms are compiled first" in told
