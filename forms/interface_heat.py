r"""Heat at interfaces: conductance, flux, friction heat, entropy production.

Symbols: θ temperature of the master side, θ' of the slave side [K], jump τ = θ' - θ, p contact
pressure [MPa], positive in compression, h conductance [N/(mm s K)], q heat from master to slave per
area [N/(mm s)], D friction heat per area [N/(mm s)]. Equations are those of Rakotomanana and
Ramaniraka's paper, three of them corrected:

* eq. 14 prints both q' = -κ δθ/θ' and, from the potential ψ_c, q' = +κ δθ/θ' for the heat into the
  slave, δθ = θ - θ'. Only the second makes entropy, q' δθ/θ' >= 0; the first is that of the flux
  out of a body of eq. 20. Here h = κ/θ'.
* eq. 66-68 print the potential ½ h P T^2 with P the negative part of the contact force (P <= 0,
  T = θ' - θ), which would make heat flow up the jump. It has to be ½ h |P| T^2: conductance grows
  with the size of the pressure.
* the last term of eq. 68, (friction power) T, gives +D to one side and -D to the other: no heat in
  sum. Both sides get a part of D: its potential is -D ((1 - β) θ + β θ') with β the slave's share.
"""

from __future__ import annotations

from typing import Any

from ufl import conditional, diff, gt, lt, variable
from ufl.algorithms import expand_derivatives, strip_variables
from ufl.core.expr import Expr


def conductance(p: Expr, open_: Any, per_pressure: Any, cap: Any) -> Expr:
    r"""Conductance :math:`h = \min(h_o + h_p \max(p, 0), h_{cap})`, eq. 66 with its sign corrected.

    Args:
        p: Contact pressure [MPa].
        open_: Conductance without pressure [N/(mm s K)].
        per_pressure: Increase with pressure [N/(mm s K) per MPa].
        cap: Largest conductance [N/(mm s K)]; may be infinite.
    """
    h = open_ + per_pressure * conditional(gt(p, 0), p, 0 * p)
    return conditional(lt(h, cap), h, cap)


def conduction_potential(τ: Expr, h: Any) -> Expr:
    r"""Dissipation potential :math:`\tfrac12 h τ^2` per area, eq. 68 with its sign corrected."""
    return h / 2 * τ**2


def flux_and_derivatives(
    p: Expr, τ: Expr, open_: Any, per_pressure: Any, cap: Any
) -> tuple[Expr, Expr, Expr]:
    """Heat from master to slave q = h (θ - θ'), eq. 14 with +; dq/dτ and dq/dp."""
    s, t = variable(p), variable(τ)
    q = -diff(conduction_potential(t, conductance(s, open_, per_pressure, cap)), t)
    # The labels of variables differ from run to run; without them compiled forms are found again.
    parts = [strip_variables(expand_derivatives(e)) for e in (q, diff(q, t), diff(q, s))]
    return parts[0], parts[1], parts[2]


def friction_heat(D: Any, share: Any) -> tuple[Any, Any]:
    r"""Friction heat into master and slave: :math:`(1 - β) D, β D`, eq. 68 corrected."""
    return (1 - share) * D, share * D


def entropy_production(q: Any, D: Any, share: Any, θ: Any, θ_slave: Any) -> Any:
    r"""Entropy made per area and time [N/(mm s K)].

    .. math:: q \Big(\frac{1}{θ'} - \frac{1}{θ}\Big) + D \Big(\frac{1 - β}{θ} + \frac{β}{θ'}\Big)

    Not negative, since q has the sign of θ - θ' and D is not negative. Of numbers too.
    """
    return q * (θ - θ_slave) / (θ * θ_slave) + D * ((1 - share) / θ + share / θ_slave)
