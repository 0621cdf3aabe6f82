"""The shipped cases give the frozen numbers (`tests/frozen.py`)."""

from __future__ import annotations

import pytest

from tests import frozen

# On another kernel of BLAS Newton ends elsewhere below its tolerance: seen 1e-9.
TOLERANCE = 1e-6
CASES = [
    pytest.param(name, marks=() if name in ("blocks", "cylinders") else pytest.mark.slow)
    for name in (*frozen.CASES, *frozen.LONG)
]


@pytest.mark.parametrize("name", CASES)
def test_frozen_numbers_are_unchanged(name: str) -> None:
    moved = frozen.moved(frozen.frozen()[name], frozen.solve(name), TOLERANCE)
    assert not moved, "\n".join(moved)


def test_frozen_numbers_that_change_are_named() -> None:
    old = {"a": 1.0, "b": 2.0, "gone": 0.0}
    new = {"a": 1.0 + 1e-9, "b": 2.1, "new": 0.0}
    names = [line.split(":")[0] for line in frozen.moved(old, new, TOLERANCE)]
    assert names == ["b", "gone"]
    assert frozen.moved(old, old | {"a": float("nan")}, TOLERANCE)
