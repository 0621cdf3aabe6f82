"""The table of published numbers: rows, values with units, text and places."""

from __future__ import annotations

import pytest

from app.case import quantities


def test_quantities_have_a_row_each() -> None:
    rows = {section: set(table) for section, table in quantities.TABLE.items()}
    assert rows["regions"] >= {f"volume_over_{level}_MPa" for level in quantities.TENSION_LEVELS}
    assert rows["femur"] >= {
        f"strain_{side}_{level}" for side in ("lateral", "medial") for level in quantities.GAUGES
    }
    assert rows["thermal.regions"] >= {
        f"necrosis_{rule}_{key}" for rule in quantities.NECROSIS for key in ("volume", "depth")
    }


@pytest.mark.parametrize(
    ("quantity", "unit", "given", "value"),
    [
        ("cement_bone.temperature_max_second", "degC", "323.15 K", 50.0),
        ("cement_bone.heat_flux_max", "W/m^2", "1.704821 mW/mm^2", 1704.821),
        ("cortical_bone.cem43_max", "min", "1 hour", 60.0),
        ("cement.rate_max", "1/s", "94.0834 1/ks", 0.0940834),
        ("cement_bone.strength_fraction", "-", 0.5, 0.5),
    ],
)
def test_quantities_known_values_have_units(
    quantity: str, unit: str, given: str | float, value: float
) -> None:
    assert quantities.quantity_or_fail(quantity).unit == unit
    assert quantities.known_value(quantity, given) == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (0.04131, 0.0018, "41.3 ± 1.8"),
        (0.04131, None, "41.3"),
        (0.04131, 0.00002, "41.31 ± 0.02"),
        (0.04131, 1e-9, "41.3"),
        (0.0003, 0.0005, "0.3 ± 0.5 (not resolved)"),
        (None, None, "-"),
    ],
)
def test_quantities_are_printed_to_a_digit_of_the_error(
    value: float | None, error: float | None, text: str
) -> None:
    q = quantities.TABLE["interfaces"]["gap_p99"]  # mm, shown in um with one decimal
    assert q.text({"gap_p99": value, "gap_p99_error": error}) == text


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("stem_cement", "stem-cement"),
        ("stem_cement_rim", "stem-cement rim"),
        ("stem_bone_half_coated", "stem-bone half coated"),
        ("cortical_bone", "cortical bone"),
    ],
)
def test_quantities_have_places_in_words(place: str, words: str) -> None:
    assert quantities.place_in_words(place) == words
