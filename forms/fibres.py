r"""Fibre directions that follow an axis.

Symbols: x position (3,) [mm], a unit direction of the axis (3,), c a point of it (3,) [mm]. On the
axis neither direction exists.
"""

from __future__ import annotations

from typing import Any

from ufl import cross, dot, sqrt
from ufl.core.expr import Expr


def circumferential(x: Expr, a: Any, c: Any) -> Expr:
    r"""Unit direction around the axis (3,): :math:`a × (x - c)` over its length."""
    return _unit(cross(a, x - c))


def radial(x: Expr, a: Any, c: Any) -> Expr:
    r"""Unit direction away from the axis (3,): :math:`(x - c) - a (a·(x - c))` over its length."""
    return _unit(x - c - dot(a, x - c) * a)


def _unit(v: Expr) -> Expr:
    return v / sqrt(dot(v, v))
