"""Uncertainty of keys, and directions without information, against formulas."""

from __future__ import annotations

import numpy as np
import pytest

from app.campaigns.identifiability import direction_in_words, identify


def test_identifiability_of_independent_keys() -> None:
    """Diagonal derivatives d give uncertainties 1 / d and no correlation."""
    known = identify(np.array([[10.0, 0.0], [0.0, 40.0], [0.0, 0.0]]))
    assert known.uncertainties == pytest.approx([0.1, 0.025])
    assert known.correlation == pytest.approx(np.eye(2))
    assert known.singular_values == pytest.approx([40.0, 10.0])
    assert known.influence == pytest.approx([10.0, 40.0])
    assert known.undetermined() == []


def test_identifiability_of_a_straight_line() -> None:
    """Intercept a and slope b of a + b x in n points have the variances of the textbook."""
    x = np.array([0.0, 1.0, 2.0, 5.0])
    known = identify(np.column_stack([np.ones(4), x]) / 0.1)
    spread = ((x - x.mean()) ** 2).sum()
    variance_b = 0.01 / spread
    variance_a = 0.01 * (x**2).sum() / (4 * spread)
    assert known.uncertainties**2 == pytest.approx([variance_a, variance_b])
    expected = -x.mean() / np.sqrt((x**2).mean())
    assert known.correlation[0, 1] == pytest.approx(expected)


def test_identifiability_of_keys_of_which_only_the_sum_acts() -> None:
    known = identify(np.array([[20.0, 20.0, 0.0], [0.0, 0.0, 30.0], [10.0, 10.0, 0.0]]))
    (direction,) = known.undetermined()
    assert direction.keys() == {0, 1}
    assert np.isinf(known.uncertainties[:2]).all()
    assert known.uncertainties[2] == pytest.approx(1 / 30)
    assert np.isnan(known.correlation[0]).all() and known.correlation[2, 2] == pytest.approx(1)
    assert direction_in_words(direction, ["a", "b", "c"]) == "a against b"


def test_identifiability_with_fewer_numbers_than_keys() -> None:
    known = identify(np.array([[20.0, -20.0]]))
    (direction,) = known.undetermined()
    assert direction_in_words(direction, ["a", "b"]) == "a and b"


@pytest.mark.parametrize(("influence", "weak"), [(3.4, True), (3.5, False)])
def test_identifiability_compares_with_a_value_known_by_its_range(
    influence: float, weak: bool
) -> None:
    """A value known only by its range has the standard deviation of 1 / sqrt(12) of the range."""
    known = identify(np.array([[influence, 0.0], [0.0, 50.0]]))
    assert [*map(list, known.undetermined())] == ([[0]] if weak else [])


def test_identifiability_without_any_influence() -> None:
    known = identify(np.zeros((2, 2)))
    assert np.isinf(known.uncertainties).all() and len(known.undetermined()) == 2
