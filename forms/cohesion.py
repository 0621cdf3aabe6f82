r"""Cohesion of an interface that breaks: quadratic onset, softening, mixed modes, then friction.

With :math:`D^+` the opening and sliding part of the jump D [mm], :math:`m = |D^+|`, K the stiffness
[MPa/mm], N and S the strengths in tension and shear [MPa], :math:`B = D_t^2/m^2` the mixture,

.. math:: m_0 = \frac1{K \sqrt{(1-B)/N^2 + B/S^2}}, \qquad
          G = G_I + (G_{II} - G_I) B^η \quad [N/mm]

are the size at onset (Camanho and Davila 2002) and the fracture energy (Benzeggagh and Kenane
1996). The damage d of a jump has the softening traction (1 - d) K D^+ use up G:

.. math:: d = \frac{m_f (m - m_0)}{m (m_f - m_0)}, \; m_f = \frac{2 G}{K m_0}; \qquad
          d = 1 - \frac{m_0}m e^{-(m - m_0)/δ}, \; δ = \frac G{K m_0} - \frac{m_0}2 .

It never falls. An undamaged point is a spring both ways; a damaged one has exact contact besides,
with Coulomb friction :math:`d μ p`: F = T + P(F - T + r D), T = (1 - d) K D^+ (after Alfano and
Sacco 2006, there with an elastic slip).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ufl import And, conditional, exp, ge, gt, sqrt
from ufl.core.expr import Expr

from forms.contact import derivative

# A point whose damage is this close to that of its jump is loading: so is the state that begins a
# step, without which the first tangent of a step would be elastic.
LOADING = 1e-12
# Square of a jump that counts as none [mm2].
NONE = 1e-30


@dataclass(frozen=True)
class Cohesion:
    """Constants of the law.

    Attributes:
        K: Stiffness in both modes [MPa/mm].
        N: Strength in tension [MPa].
        S: Strength in shear [MPa].
        G_I: Fracture energy in tension [N/mm].
        G_II: Fracture energy in shear [N/mm].
        η: Exponent of the mixture [-].
        unbonded: Share of the area that has never been bonded [-].
        exponential: Whether softening is exponential, else linear.
    """

    K: Any
    N: Any
    S: Any
    G_I: Any
    G_II: Any
    η: Any
    unbonded: Any
    exponential: bool

    def mode(self, opened: Any, slid: Any) -> tuple[Any, Any]:
        """Jump at onset m_0 [mm], fracture energy G [N/mm], of squares of opening and sliding."""
        square = opened + slid
        B = conditional(gt(square, NONE), slid / conditional(gt(square, NONE), square, 1), 0)
        m_0 = 1 / (self.K * sqrt((1 - B) / self.N**2 + B / self.S**2))
        mixed = conditional(gt(B, 0), conditional(gt(B, 0), B, 1) ** self.η, 0)
        return m_0, self.G_I + (self.G_II - self.G_I) * mixed

    def left(self, m: Any, m_0: Any, G: Any) -> Any:
        """1 - d of a jump of size m beyond onset: to all digits, as a stiff bond needs [-]."""
        if self.exponential:
            return m_0 / m * exp((m_0 - m) / (G / (self.K * m_0) - m_0 / 2))
        m_f = 2 * G / (self.K * m_0)
        return conditional(ge(m, m_f), 0, m_0 * (m_f - m) / (m * (m_f - m_0)))

    def spent(self, m: Any, m_0: Any, G: Any) -> Any:
        """Part of G that a jump of size m beyond onset has used up [-]."""
        if self.exponential:
            left = exp((m_0 - m) / (G / (self.K * m_0) - m_0 / 2))
            return 1 - left * (1 + self.K * m_0 * (m - m_0) / (2 * G))
        m_f = 2 * G / (self.K * m_0)
        return conditional(ge(m, m_f), 1, (m - m_0) / (m_f - m_0))


def bond(c: Cohesion, opened: Any, slid: Any, old: Mapping[str, Any], live: Any) -> dict[str, Expr]:
    """Damage of the bond of a contact point, by name, with derivatives by the two squares.

    Args:
        c: The constants.
        opened: Square of the opening, a UFL variable [mm2].
        slid: Square of the sliding, a UFL variable [mm2].
        old: ``damage`` of the bonded share, and the part of its energy ``spent``, at the last
            converged state.
        live: 1, or 0 where damage is frozen.

    Returns:
        Share of the area ``left``, that broken ``before``, energy ``used`` in the step per area
        [N/mm], and the new history.
    """
    m_0, G = c.mode(opened, slid)
    size = opened + slid
    m = sqrt(conditional(gt(size, m_0**2), size, m_0**2))
    left = c.left(m, m_0, G)
    loading = And(ge(1 - left, old["damage"] - LOADING), gt(live, 0.5))
    damage = conditional(loading, 1 - left, old["damage"])
    left = (1 - c.unbonded) * conditional(loading, left, 1 - old["damage"])
    # Where the mixture changes, more damage may be a smaller part of another energy.
    spent = c.spent(m, m_0, G)
    more = ge(spent, old["spent"] - LOADING)
    spent = conditional(And(loading, more), spent, old["spent"])
    before = c.unbonded + (1 - c.unbonded) * old["damage"]
    used = (1 - c.unbonded) * G * (spent - old["spent"])
    told = {"left": left, "used": used}
    told |= {
        f"{n} by {k}": derivative(e, by)
        for n, e in told.items()
        for k, by in (("opened", opened), ("slid", slid))
    }
    return told | {"before": before, "new damage": damage, "new spent": spent}
