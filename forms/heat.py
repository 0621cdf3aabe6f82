r"""Heat in bodies: dissipation potentials of conduction and exchange, power of heat sources.

The heat equation of each body, :math:`c\,\dotθ = ∇·(k ∇θ) + Q`, has the weak form

.. math:: ∫ c\, \dotθ\, v + ∂_θ \Big( ∫ φ(∇θ) + ∫ φ_b(θ) + ∫_{∂} φ_a(θ) \Big)[v]
          = ∫ Q\, v + ∫_{∂} q\, v \qquad ∀ v.

The derivatives of the potentials are heat fluxes. Fourier's heat flux :math:`-∂φ/∂∇θ = -k ∇θ` is
directed down the gradient (paper eq. 20). The heat that leaves through a surface is
:math:`∂φ_a/∂θ` per area.

Symbols: θ temperature [K], g = ∇θ [K/mm], c capacity per volume (density times specific heat)
[N/(mm2 K)], k conductivity [N/(s K)], m unit fibre direction (3,), v virtual temperature.
"""

from __future__ import annotations

from ufl import dot, inner
from ufl.core.expr import Expr

from forms import Scalar


def isotropic_conduction(g: Expr, k: Scalar) -> Expr:
    r"""Potential of Fourier conduction :math:`φ = \tfrac12 k\, g·g`."""
    return k / 2 * inner(g, g)


def fibre_conduction(g: Expr, m: Expr, k_l: Scalar, k_t: Scalar) -> Expr:
    r"""Potential of conduction along and across a fibre.

    .. math:: φ = \tfrac12 k_t\, g·g + \tfrac12 (k_l - k_t) (m·g)^2

    Args:
        g: Temperature gradient (3,).
        m: Fibre direction, unit (3,).
        k_l: Conductivity along the fibre [N/(s K)].
        k_t: Conductivity across the fibre [N/(s K)].
    """
    return isotropic_conduction(g, k_t) + (k_l - k_t) / 2 * dot(m, g) ** 2


def exchange(θ: Expr, coefficient: Scalar, outside: Scalar) -> Expr:
    r"""Potential of exchange with surroundings: :math:`\tfrac12 a (θ - θ_a)^2`.

    Convection acts per area; a is its film coefficient [N/(mm s K)]. Perfusion acts per volume; a
    is the perfusion rate times the heat capacity of blood [N/(mm2 s K)]: Pennes (1948),
    doi:10.1152/jappl.1948.1.2.93.

    Args:
        θ: Temperature [K].
        coefficient: Coefficient a.
        outside: Temperature θ_a of the surroundings or of the blood [K].
    """
    return coefficient / 2 * (θ - outside) ** 2


def heating_power(q: Scalar, v: Expr) -> Expr:
    """Power q v of heat that enters, with q per area [N/(mm s)] or per volume [N/(mm2 s)]."""
    return q * v
