r"""Potentials of loads and supports (paper eq. 51, last two terms).

Each returns the integrand of the external potential, the work of the load in a displacement v.
Symbols: v displacement (3,) [mm], x position (3,) [mm], n outward normal (3,).
"""

from __future__ import annotations

from typing import Any

from ufl import cross, dot, inner
from ufl.core.expr import Expr


def traction_work(t: Expr, v: Expr) -> Expr:
    """Work of a uniform traction t [MPa] per area: t . v."""
    return dot(t, v)


def linear_traction_work(t: Expr, ω: Expr, x: Expr, centroid: Any, v: Expr) -> Expr:
    r"""Work of the traction :math:`t + ω × (x - x_c)` per area.

    With x_c the centroid of the patch the first part carries the force alone and the second the
    moment about the centroid alone, so that a resultant force and a resultant moment fix t and ω
    (the latter by the patch's 3 x 3 second-moment matrix).

    Args:
        t: Mean traction (3,) [MPa].
        ω: Rate of its linear part (3,) [MPa/mm].
        x: Position (3,) [mm].
        centroid: Centroid of the patch (3,) [mm].
        v: Displacement (3,) [mm].
    """
    return dot(t + cross(ω, x - centroid), v)


def pressure_work(p: Any, n: Expr, v: Expr) -> Expr:
    """Work of a pressure p [MPa], positive when it compresses: -p n . v."""
    return -p * dot(n, v)


def body_force_work(b: Expr, v: Expr) -> Expr:
    """Work of a force density b [N/mm^3]: b . v."""
    return dot(b, v)


def foundation_energy(k: Expr, v: Expr) -> Expr:
    r"""Energy of a bed of springs per area, :math:`\tfrac12 k_i v_i^2` [N/mm], k (3,) [MPa/mm]."""
    return sum(k[i] * v[i] ** 2 for i in range(3)) / 2


def mechanical_work(σ: Expr, ε: Expr) -> Expr:
    """Work of a stress in a strain per volume: σ : ε [MPa]."""
    return inner(σ, ε)
