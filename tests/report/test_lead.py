"""The first sentences of a report."""

from __future__ import annotations

from typing import Any

import pytest

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
         "99 % of the surface is closer. The sides touch nowhere."),
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
