"""Numbers with errors as text."""

from __future__ import annotations

import pytest

from app.case.number_text import UNITS, Number


@pytest.mark.parametrize(
    "number, text",
    [
        (Number(41.26, 1.83), "41.3 ± 1.8"),
        (Number(0.00123), "0.00123"),
        (Number(12345.6, 150.0), "12346 ± 150"),
        (Number(100.0, 3e-8), "100 ± 3e-08"),
        (Number(5.0, 0.0), "5"),
        (Number(0.01, 0.2), "0.01 ± 0.2"),
    ],
)
def test_number_text_digits_follow_errors(number: Number, text: str) -> None:
    assert str(number) == text


def test_number_text_dimensions_of_units_are_distinct() -> None:
    """Section ``units`` of a summary has one unit for each dimension."""
    dimensions = list(UNITS.values())
    assert len({*dimensions}) == len(dimensions)
