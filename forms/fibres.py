r"""Fibre directions that follow an axis.

Symbols: x position (3,) [mm], a unit direction of the axis (3,), c a point on the axis (3,) [mm].
Neither direction is defined on the axis itself.
"""

from __future__ import annotations

from ufl import cross, dot, sqrt
from ufl.core.expr import Expr

from forms import Scalar


def circumferential(x: Expr, a: Scalar, c: Scalar) -> Expr:
    r"""Unit direction around the axis (3,): :math:`a × (x - c)`, normalised."""
    return _unit(cross(a, x - c))


def radial(x: Expr, a: Scalar, c: Scalar) -> Expr:
    r"""Unit direction away from the axis (3,): :math:`(x - c) - a (a·(x - c))`, normalised."""
    return _unit(x - c - dot(a, x - c) * a)


def _unit(v: Expr) -> Expr:
    return v / sqrt(dot(v, v))
