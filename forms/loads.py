r"""Potentials of loads and supports (paper eq. 51, last two terms).

Each function returns an integrand of the external potential, per area or per volume: the work of a
load along a displacement v, or the energy of an elastic support.
Symbols: v displacement (3,) [mm], x position (3,) [mm], n outward normal (3,).
"""

from __future__ import annotations

from ufl import cross, dot, inner
from ufl.core.expr import Expr

from forms import Scalar


def traction_work(t: Expr, v: Expr) -> Expr:
    """Work of a uniform traction t [MPa] per area: t . v."""
    return dot(t, v)


def linear_traction_work(t: Expr, ω: Expr, x: Expr, centroid: Scalar, v: Expr) -> Expr:
    r"""Work of the traction :math:`t + ω × (x - x_c)` per area.

    x_c is the centroid of the patch. The first term has only a resultant force, the second only a
    moment about the centroid. The resultant force thus determines t, and the resultant moment
    determines ω by the 3 x 3 matrix of second moments of the patch.

    Args:
        t: Mean traction (3,) [MPa].
        ω: Rate of its linear part (3,) [MPa/mm].
        x: Position (3,) [mm].
        centroid: Centroid of the patch (3,) [mm].
        v: Displacement (3,) [mm].
    """
    return dot(t + cross(ω, x - centroid), v)


def pressure_work(p: Scalar, n: Expr, v: Expr) -> Expr:
    """Work of a pressure p [MPa], positive when it compresses: -p n . v."""
    return -p * dot(n, v)


def body_force_work(b: Expr, v: Expr) -> Expr:
    """Work of a force density b [N/mm^3]: b . v."""
    return dot(b, v)


def foundation_energy(k: Expr, v: Expr) -> Expr:
    r"""Energy of an elastic foundation per area, :math:`\tfrac12 k_i v_i^2` [N/mm].

    Args:
        k: Stiffness along x, y, z (3,) [MPa/mm].
        v: Displacement (3,) [mm].
    """
    return sum(k[i] * v[i] ** 2 for i in range(3)) / 2


def mechanical_work(σ: Expr, ε: Expr) -> Expr:
    """Work of a stress along a strain per volume: σ : ε [MPa]."""
    return inner(σ, ε)
