r"""Heat at interfaces: conductance, flux, friction heat, entropy production.

Symbols:

* θ, θ': temperature of the master side, of the slave side [K]; jump τ = θ' - θ
* p: contact pressure [MPa], positive in compression
* h: conductance [N/(mm s K)]
* q: heat from master to slave per area [N/(mm s)]
* D: friction heat per area [N/(mm s)]

Equations are from Rakotomanana and Ramaniraka's paper, three of them corrected:

* Eq. 14 prints two signs for the heat into the slave: q' = -κ δθ/θ' and, from the potential ψ_c,
  q' = +κ δθ/θ', with δθ = θ - θ'. Only the second produces entropy, q' δθ/θ' >= 0. The first is the
  flux out of a body, as in eq. 20. Here h = κ/θ'.
* Eq. 66-68 print the potential ½ h P T^2, where P <= 0 is the contact force and T = θ' - θ. Heat
  would then flow from cold to warm. The correct potential is ½ h |P| T^2: conductance grows with
  the pressure.
* The last term of eq. 68, (friction power) T, gives +D to one side and -D to the other: no heat in
  total. Both sides must get a part of D. The potential is -D ((1 - β) θ + β θ'), where β is the
  share of the slave.
"""

from __future__ import annotations

from ufl import conditional, diff, gt, lt, variable
from ufl.algorithms import expand_derivatives, strip_variables
from ufl.core.expr import Expr

from forms import Scalar


def conductance(p: Expr, open_: Scalar, per_pressure: Scalar, cap: Scalar) -> Expr:
    r"""Conductance :math:`h = \min(h_o + h_p \max(p, 0), h_{cap})`, eq. 66 with its sign corrected.

    Args:
        p: Contact pressure [MPa].
        open_: Conductance without pressure [N/(mm s K)].
        per_pressure: Increase with pressure [N/(mm s K) per MPa].
        cap: Largest conductance [N/(mm s K)]; may be infinite.
    """
    h = open_ + per_pressure * conditional(gt(p, 0), p, 0 * p)
    return conditional(lt(h, cap), h, cap)


def conduction_potential(τ: Expr, h: Scalar) -> Expr:
    r"""Dissipation potential :math:`\tfrac12 h τ^2` per area, eq. 68 with its sign corrected."""
    return h / 2 * τ**2


def flux_and_derivatives(
    p: Expr, τ: Expr, open_: Scalar, per_pressure: Scalar, cap: Scalar
) -> tuple[Expr, Expr, Expr]:
    """Heat flux from master to slave and its derivatives.

    Args:
        p: Contact pressure [MPa].
        τ: Temperature jump θ' - θ [K].
        open_: Conductance without pressure [N/(mm s K)].
        per_pressure: Increase with pressure [N/(mm s K) per MPa].
        cap: Largest conductance [N/(mm s K)]; may be infinite.

    Returns:
        q = -h τ (eq. 14 with the sign +) [N/(mm s)], dq/dτ and dq/dp.
    """
    pressure, jump = variable(p), variable(τ)
    h = conductance(pressure, open_, per_pressure, cap)
    q = -diff(conduction_potential(jump, h), jump)
    # The labels of variables differ between runs. Without them compiled forms are reused.
    flux, by_jump, by_pressure = (
        strip_variables(expand_derivatives(e)) for e in (q, diff(q, jump), diff(q, pressure))
    )
    return flux, by_jump, by_pressure


def friction_heat(D: Scalar, share: Scalar) -> tuple[Scalar, Scalar]:
    r"""Friction heat into master and slave: :math:`(1 - β) D, β D`, eq. 68 corrected."""
    return (1 - share) * D, share * D


def entropy_production(q: Scalar, D: Scalar, share: Scalar, θ: Scalar, θ_slave: Scalar) -> Scalar:
    r"""Entropy production per area and time [N/(mm s K)].

    .. math:: q \Big(\frac{1}{θ'} - \frac{1}{θ}\Big) + D \Big(\frac{1 - β}{θ} + \frac{β}{θ'}\Big)

    It is not negative, since q has the sign of θ - θ' and D is not negative. The arguments may be
    expressions or arrays.
    """
    return q * (θ - θ_slave) / (θ * θ_slave) + D * ((1 - share) / θ + share / θ_slave)
