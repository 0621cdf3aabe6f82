"""Functions of one variable that are given by tables."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from ufl import conditional, lt
from ufl.core.expr import Expr


def piecewise_linear(x: Expr, at: Sequence[Any], values: Sequence[Any]) -> Expr:
    """Linear between values at given, rising places, constant beyond them."""
    pairs = list(zip(at, values, strict=True))
    value = pairs[-1][1]
    for (x0, v0), (x1, v1) in reversed(list(pairwise(pairs))):
        value = conditional(lt(x, x1), v0 + (v1 - v0) * (x - x0) / (x1 - x0), value)
    return conditional(lt(x, pairs[0][0]), pairs[0][1], value)
