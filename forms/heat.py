r"""Heat in bodies: dissipation potentials of conduction and exchange, power of what heats.

The heat equation of each body, :math:`c\,\dotθ = ∇·(k ∇θ) + Q`, is the stationarity in the
virtual temperature of capacity, potentials and powers,

.. math:: ∫ c\, \dotθ\, v + ∂_θ \Big( ∫ φ(∇θ) + ∫ φ_b(θ) + ∫_{∂} φ_a(θ) \Big)[v]
          = ∫ Q\, v + ∫_{∂} q\, v \qquad ∀ v,

with potentials whose derivatives are the flows: :math:`-∂φ/∂∇θ = -k ∇θ` is Fourier's heat flux
(paper eq. 20: flux out of a body is positive down the gradient), :math:`∂φ_a/∂θ` what leaves
through a surface.

Symbols: θ temperature [K], g = ∇θ [K/mm], c capacity per volume (density times specific heat)
[N/(mm2 K)], k conductivity [N/(s K)], m unit fibre direction (3,), v virtual temperature.
"""

from __future__ import annotations

from typing import Any

from ufl import dot, inner
from ufl.core.expr import Expr


def isotropic_conduction(g: Expr, k: Any) -> Expr:
    r"""Potential of Fourier conduction :math:`φ = \tfrac12 k\, g·g`."""
    return k / 2 * inner(g, g)


def fibre_conduction(g: Expr, m: Expr, k_l: Any, k_t: Any) -> Expr:
    r"""Potential of conduction along and across a fibre.

    .. math:: φ = \tfrac12 k_t\, g·g + \tfrac12 (k_l - k_t) (m·g)^2

    Args:
        g: Temperature gradient (3,).
        m: Fibre direction, unit (3,).
        k_l: Conductivity along it.
        k_t: Conductivity across it.
    """
    return isotropic_conduction(g, k_t) + (k_l - k_t) / 2 * dot(m, g) ** 2


def exchange(θ: Expr, coefficient: Any, outside: Any) -> Expr:
    r"""Potential of exchange with surroundings: :math:`\tfrac12 a (θ - θ_a)^2`.

    Per area with a film coefficient [N/(mm s K)]: convection. Per volume with rate of perfusion
    times capacity of blood [N/(mm2 s K)] and the blood's temperature: Pennes (1948),
    doi:10.1152/jappl.1948.1.2.93.
    """
    return coefficient / 2 * (θ - outside) ** 2


def heating_power(q: Any, v: Expr) -> Expr:
    """Power of heat that comes in, per area [N/(mm s)] or per volume [N/(mm2 s)]: q v."""
    return q * v
