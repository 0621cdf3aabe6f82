"""The first sentences of a report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import pytest

from app.case.number_text import Number
from app.report import lead


@pytest.mark.parametrize(
    ("numbers", "value", "error", "detail"),
    [
        ({"slip_p99": 0.0271, "slip_p99_error": 0.03}, "27.1", "± 30.0 µm (not resolved)",
         "99 % of the surface slips less. It stays closed."),
        ({"slip_p99": 0.002, "gap_p99": 0.0082, "gap_p99_error": 0.0095, "rim": {}}, "2.0", "",
         "99 % of the surface without rim and tip slips less. 99 % is open by less than "
         "8.2 ± 9.5 µm (not resolved)."),
        ({"slip_p99": 0.002, "area_gap_over_30um": 1200, "area": 3000}, "2.0", "",
         "99 % of the surface slips less. Open by more than 30 µm: 1,200 of 3,000 mm²."),
        ({"slip_p99": 1e-6}, "0", "", ""),
        ({"slip_p99": 0.1, "gap_p99": 0.2, "open_fraction": 1.0}, "200.0", "",
         "The gap is smaller than this on 99 % of the surface. The sides touch nowhere."),
        ({"slip_p99": 0.002, "area_gap_over_30um": 0.4, "area": 3000}, "2.0", "",
         "99 % of the surface slips less. It stays closed."),
        ({"slip_p99": 0.002, "area_gap_over_30um": 0.6, "area": 3000}, "2.0", "",
         "99 % of the surface slips less. Open by more than 30 µm: 1 of 3,000 mm²."),
        ({"slip_p99": 0.00006}, "0.1", "", "99 % of the surface slips less. It stays closed."),
        ({"slip_p99": 0.00004}, "0", "", ""),
    ],
)  # fmt: skip
def test_lead_has_slip_and_opening(
    numbers: dict[str, Any], value: str, error: str, detail: str
) -> None:
    (number,) = lead.large_numbers({"interfaces": {"stem_cement": numbers}})
    assert (number.value, number.error, number.detail) == (value, error, detail)


def test_lead_takes_a_number_of_each_group() -> None:
    """The first number of contact, stem and heat is taken, in this order.

    A second one is added if there is room.
    """
    slip = {"slip_p99": 0.01}
    numbers: dict[str, Any] = {
        "interfaces": {"stem_cement": slip, "cement_bone": slip},
        "stem": {"subsidence": 0.02},
    }
    captions = [number.caption for number in lead.large_numbers(numbers)]
    both = ["slip of the stem in its cement", "slip of the cement on the bone"]
    assert captions == [*both, "subsidence of the stem"]
    numbers["thermal"] = {"regions": {"rod": {"temperature_max": 60.0}}}
    captions = [number.caption for number in lead.large_numbers(numbers)]
    assert captions == [both[0], "subsidence of the stem", "highest temperature of rod"]


@pytest.mark.parametrize(("volume", "detail"), [(0.4, "No bone dies by any rule."), (0.6, "1 mm³")])
def test_lead_names_dead_bone_from_half_a_cubic_millimetre(volume: float, detail: str) -> None:
    bone: dict[str, Any] = {"temperature_max": 48.0}
    bone |= {f"seconds_over_{level}": 0.0 for level in (47, 50, 56)}
    bone |= {f"necrosis_{rule}_volume": volume for rule in lead.NECROSIS}
    numbers: dict[str, Any] = {"interfaces": {}, "thermal": {"regions": {"bone": bone}}}
    *_, dead_bone = lead.large_numbers(numbers)
    assert dead_bone.caption == "dead bone" and detail in dead_bone.detail


@dataclass(frozen=True)
class Case:
    """A case of a sweep with one number in its printed unit."""

    name: str
    value: float

    def number(self, _: str) -> Number:
        return Number(self.value)


@pytest.mark.parametrize(
    ("name", "values", "expected"),
    [
        ("stem_cement.slip_p99", (0.04, 3.0), ["0 to 3"]),
        ("stem_cement.slip_p99", (0.01, 0.04), []),
        ("thermal.regions.bone.temperature_max", (41.0, 48.5), ["41 to 48.5"]),
        ("stem_cement.slip_max", (1.0, 3.0), []),
    ],
)
def test_lead_ranges_have_thresholds_by_quantity(
    name: str, values: tuple[float, float], expected: list[str]
) -> None:
    cases = [Case(f"case_{k}", value) for k, value in enumerate(values)]
    numbers = lead.ranges_over_runs(cast(Any, cases), [name])
    assert [number.value for number in numbers] == expected
