"""Values in words."""

from __future__ import annotations

import pytest

from app.foundation.layout import (
    alternatives,
    fixed,
    percent,
    plain_text,
    rounded_count,
    two_digits,
)


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ([41.0, 1.3e-15, 58.0], "[41, 0, 58]"),
        (["41 mm", "1.3e-15 mm", "58.0266 mm"], "[41, 0, 58.0266] mm"),
        (["41 mm", "1e-15 deg"], "[41 mm, 1e-15 deg]"),
        (["stem", "bone"], "[stem, bone]"),
        ([2, 2, 1], "[2, 2, 1]"),
        ([], "[]"),
        ({"low": 0.25, "names": ["a"]}, "low 0.25, names [a]"),
    ],
)
def test_layout_writes_values_on_one_line(value: object, expected: str) -> None:
    """Rounding errors of a vector are zero, with units or without."""
    assert plain_text(value) == expected


@pytest.mark.parametrize(
    ("number", "expected"),
    [
        (0.01234, "0.012"),
        (4.06, "4.1"),
        (99.6, "100"),
        (123.0, "120"),
        (-1550.4, "-1600"),
        (0, "0"),
    ],
)
def test_layout_writes_two_digits_without_an_exponent(number: float, expected: str) -> None:
    assert two_digits(number) == expected


@pytest.mark.parametrize(
    ("value", "expected"), [(0.0041, "0.41 %"), (0.12, "12 %"), (0.996, "100 %"), (1.48, "148 %")]
)
def test_layout_writes_percentages_without_an_exponent(value: float, expected: str) -> None:
    assert percent(value) == expected


@pytest.mark.parametrize(("number", "expected"), [(1.234e8, "120,000,000"), (99.6, "100")])
def test_layout_writes_rounded_counts_without_an_exponent(number: float, expected: str) -> None:
    assert rounded_count(number) == expected


@pytest.mark.parametrize(
    ("choices", "expected"), [(("a",), "a"), (("a", "b"), "a or b"), (("a", "b", "c"), "a, b or c")]
)
def test_layout_lists_alternatives(choices: tuple[str, ...], expected: str) -> None:
    assert alternatives(choices) == expected


def test_layout_fixed_has_no_negative_zero() -> None:
    assert [fixed(v) for v in (-0.04, 0.0, -0.06, 1.25)] == ["0.0", "0.0", "-0.1", "1.2"]
    assert [fixed(v, sign="+") for v in (-0.04, -0.06, 2.0)] == ["+0.0", "-0.1", "+2.0"]
    assert fixed(-0.4, 0) == "0"
