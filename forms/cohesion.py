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

from ufl import And, conditional, exp, ge, gt, inner, sqrt
from ufl.core.expr import Expr

from forms.contact import Faces

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


@dataclass(frozen=True)
class Bond:
    """State of the bond of a contact point at a gap.

    Attributes:
        traction: Force per area of the bond (3,) [MPa].
        stored: Its elastic energy per area [N/mm].
        used: Fracture energy per area that the step uses up [N/mm].
        broken: Share of the area on which contact acts; 0 in a step that begins undamaged [-].
        damage: Damage of the bonded share [-].
        spent: Part of the fracture energy that is used up [-].
    """

    traction: Expr
    stored: Expr
    used: Expr
    broken: Expr
    damage: Expr
    spent: Expr


def bond(c: Cohesion, gap: Expr, normals: Faces, old: Mapping[str, Expr], live: Expr) -> Bond:
    """Traction, energies and internal variables of the bond of a contact point.

    Args:
        c: The constants.
        gap: Displacement of the slave minus that of the master, with the initial gap (3,) [mm].
        normals: Normals of the faces.
        old: `damage` and `spent` of the last converged state.
        live: 1, or 0 where damage is frozen.
    """
    a = normals.components(gap)
    # At rest the slope is that of opening: what is partly broken does not resist closing, and
    # with released contact nothing would resist at all.
    opened = normals.span([conditional(ge(part, 0), part, 0) for part in a])
    pressed = normals.span([conditional(ge(part, 0), 0, part) for part in a])
    slid = gap - normals.span(a)
    parted = opened + slid

    m_0, G = c.mode(inner(opened, opened), inner(slid, slid))
    size = inner(opened, opened) + inner(slid, slid)
    m = sqrt(conditional(gt(size, m_0**2), size, m_0**2))
    left = c.left(m, m_0, G)
    loading = And(ge(1 - left, old["damage"] - LOADING), gt(live, 0.5))
    damage = conditional(loading, 1 - left, old["damage"])
    bonded = 1 - c.unbonded
    left = bonded * conditional(loading, left, 1 - old["damage"])
    # Where the mixture changes, more damage may be a smaller part of another energy.
    spent = c.spent(m, m_0, G)
    more = And(loading, ge(spent, old["spent"] - LOADING))
    spent = conditional(more, spent, old["spent"])

    touches = gt(c.unbonded + bonded * old["damage"], 0)
    spring = conditional(touches, 0, c.K)
    return Bond(
        traction=left * c.K * parted + spring * pressed,
        stored=(left * c.K * inner(parted, parted) + spring * inner(pressed, pressed)) / 2,
        used=bonded * G * (spent - old["spent"]),
        broken=conditional(touches, 1 - left, 0),
        damage=damage,
        spent=spent,
    )
