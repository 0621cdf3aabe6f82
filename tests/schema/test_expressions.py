"""Expressions in x, y, z: values, and refused texts."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic_core import PydanticCustomError

from app.foundation.errors import InputError
from app.schema.expressions import Varying, values_at_points
from app.schema.units import Dimension, Part

POINTS = np.random.default_rng(1).uniform(0.5, 2.0, (7, 3))


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("-0.02 * (1 - z / 50)", lambda x, y, z: -0.02 * (1 - z / 50)),
        ("2", lambda x, y, z: 2 + 0 * x),
        ("min(x, y, z)", lambda x, y, z: np.minimum(np.minimum(x, y), z)),
        ("max(x, y)", lambda x, y, z: np.maximum(x, y)),
        ("hypot(x, y) - 7", lambda x, y, z: np.hypot(x, y) - 7),
        ("atan2(y, x)", lambda x, y, z: np.arctan2(y, x)),
        ("-x**2 + +y", lambda x, y, z: -(x**2) + y),
        ("0.01 * cos(2 * pi * z)", lambda x, y, z: 0.01 * np.cos(2 * np.pi * z)),
        ("abs(log(x)) * exp(-y) / sqrt(z) + sin(x) * tan(y/9)",
         lambda x, y, z: np.abs(np.log(x)) * np.exp(-y) / np.sqrt(z) + np.sin(x) * np.tan(y / 9)),
    ],
)  # fmt: skip
def test_expressions_are_evaluated(expression: str, expected: object) -> None:
    values = values_at_points(expression, POINTS)
    assert values.shape == (7,)
    np.testing.assert_allclose(values, expected(*POINTS.T), rtol=1e-14)  # type: ignore[operator]


@pytest.mark.parametrize(
    ("expression", "reason"),
    [
        ("sqrt(x - 100)", "is not finite at"),
        ("1 / (x - x)", "is not finite at"),
        ("9**9**9**9", "is not finite at"),
        ("__import__('os')", "'__import__' is not one of"),
        ("(lambda: 1)()", "is not allowed"),
        ("x < y", "has no conditions; a step at x = 3 mm"),
        ("1 if z < -70 else 0", "has no conditions"),
        ("1 if z < -70 else 0 if x > 1 and y > 1 else 2", "has no conditions"),
        ("x @ y", "is not allowed"),
        ("min(x)", "min takes 2 to 9 arguments, got 1"),
        (f"min({', '.join(['x'] * 10)})", "min takes 2 to 9 arguments, got 10"),
        ("sqrt(x, y)", r"sqrt takes 1 argument\(s\), got 2"),
        ("sin(x, out=y)", "is not allowed"),
        ("1e999", "too large"),
        ("True", "not numbers"),
        ("'a'", "is not allowed"),
        ("(" * 300 + "x" + ")" * 300, "is not an expression"),
        ("x" + "+x" * 600, "characters"),
        ("", "is not an expression"),
    ],
)
def test_expressions_are_refused(expression: str, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        values_at_points(expression, POINTS)


@pytest.mark.parametrize("kind", [Part(), Dimension("mm", "a length", "0.05 mm")])
def test_expressions_with_conditions_are_not_read_as_units(kind: Dimension) -> None:
    with pytest.raises(PydanticCustomError, match="an expression has no conditions"):
        Varying(kind).read("1 if z < -70 else 0")
