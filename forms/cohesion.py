r"""Cohesive interface: quadratic onset, softening, mixed modes, then contact with friction.

:math:`δ` is the opening and sliding part of the gap vector [mm] and :math:`m = |δ|` its size. K is
the stiffness [MPa/mm], N and S are the strengths in tension and shear [MPa]. With the mode mixture
:math:`B = |δ_T|^2/m^2`,

.. math:: m_0 = \frac1{K \sqrt{(1-B)/N^2 + B/S^2}}, \qquad
          G = G_I + (G_{II} - G_I) B^η \quad [N/mm]

are the jump at onset (Camanho and Davila 2002) and the fracture energy (Benzeggagh and Kenane
1996). The damage d of a jump follows from the softening traction (1 - d) K δ, whose work is G.
Softening is linear or exponential:

.. math:: d = \frac{m_f (m - m_0)}{m (m_f - m_0)}, \; m_f = \frac{2 G}{K m_0}; \qquad
          d = 1 - \frac{m_0}m e^{-(m - m_0)/m_s}, \; m_s = \frac G{K m_0} - \frac{m_0}2 .

Damage never falls. An undamaged point is a spring in tension and in compression. A damaged point
also has exact contact with Coulomb friction :math:`d μ p` on its debonded area,

.. math:: F = T + P(λ - T + r ΔG), \qquad T = (1 - d) K δ,

with the law P, the multiplier λ and the vector ΔG of `forms.contact`.

It is the law of Alfano and Sacco (2006) without its elastic slip.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ufl import And, conditional, exp, ge, gt, inner, lt, sqrt
from ufl.core.expr import Expr

from forms import Scalar
from forms.contact import Faces

# A point is loading if the damage of its jump is at least its committed damage minus this [-]. The
# state at the start of a step then counts as loading: the first tangent of the step is not elastic.
LOADING = 1e-12
# Squares of a jump below this count as zero [mm2].
ZERO_SQUARE = 1e-30


@dataclass(frozen=True)
class Cohesion:
    """Constants of the cohesive law.

    Attributes:
        K: Stiffness in both modes [MPa/mm].
        N: Strength in tension [MPa].
        S: Strength in shear [MPa].
        G_I: Fracture energy in tension [N/mm].
        G_II: Fracture energy in shear [N/mm].
        η: Exponent of the mode mixture [-].
        unbonded: Share of the area without cohesion from the start [-].
        exponential: True if softening is exponential, False if it is linear.
    """

    K: Scalar
    N: Scalar
    S: Scalar
    G_I: Scalar
    G_II: Scalar
    η: Scalar
    unbonded: Scalar
    exponential: bool

    def mode(self, opening_square: Scalar, sliding_square: Scalar) -> tuple[Scalar, Scalar]:
        """Jump at onset m_0 [mm] and fracture energy G [N/mm] of a mode mixture.

        Args:
            opening_square: Square of the opening [mm2].
            sliding_square: Square of the sliding [mm2].
        """
        square = opening_square + sliding_square
        # Inner conditions avoid derivatives of 0/0 and of a power at 0.
        has_jump = gt(square, ZERO_SQUARE)
        B = conditional(has_jump, sliding_square / conditional(has_jump, square, 1), 0)
        m_0 = 1 / (self.K * sqrt((1 - B) / self.N**2 + B / self.S**2))
        B_to_η = conditional(gt(B, 0), conditional(gt(B, 0), B, 1) ** self.η, 0)
        return m_0, self.G_I + (self.G_II - self.G_I) * B_to_η

    def remaining(self, m: Scalar, m_0: Scalar, G: Scalar) -> Scalar:
        """Return 1 - d of a jump of size m beyond onset [-].

        The formula keeps all digits while d is close to one, as stiff interfaces need.
        """
        if self.exponential:
            return m_0 / m * exp((m_0 - m) / (G / (self.K * m_0) - m_0 / 2))
        m_f = 2 * G / (self.K * m_0)
        return conditional(ge(m, m_f), 0, m_0 * (m_f - m) / (m * (m_f - m_0)))

    def spent(self, m: Scalar, m_0: Scalar, G: Scalar) -> Scalar:
        """Return the fraction of G that a jump of size m beyond onset has dissipated [-]."""
        if self.exponential:
            decay = exp((m_0 - m) / (G / (self.K * m_0) - m_0 / 2))
            return 1 - decay * (1 + self.K * m_0 * (m - m_0) / (2 * G))
        m_f = 2 * G / (self.K * m_0)
        return conditional(ge(m, m_f), 1, (m - m_0) / (m_f - m_0))


@dataclass(frozen=True)
class CohesiveState:
    """Cohesive response of a contact point at a gap.

    Attributes:
        traction: Cohesive traction (3,) [MPa].
        stored: Elastic energy per area [N/mm].
        dissipated_in_step: Fracture energy per area that the step dissipates [N/mm].
        debonded_share: Share of the area on which contact acts [-]; 0 in a step that begins
            undamaged.
        damage: Damage of the bonded share [-].
        spent: Fraction of the fracture energy that is dissipated so far [-].
    """

    traction: Expr
    stored: Expr
    dissipated_in_step: Expr
    debonded_share: Expr
    damage: Expr
    spent: Expr


def cohesive_state(
    law: Cohesion, gap_vector: Expr, normals: Faces, committed: Mapping[str, Expr], frozen: Expr
) -> CohesiveState:
    """Cohesive traction, energies and internal variables of a contact point.

    Args:
        law: Constants of the law.
        gap_vector: Displacement of the slave minus that of the master, with the initial gap (3,)
            [mm].
        normals: Unit normals of the faces, from master to slave.
        committed: Internal variables `damage` and `spent` of the last converged state [-].
        frozen: 1 while damage is frozen, else 0.
    """
    normal_components = normals.components(gap_vector)
    # At zero opening the derivative is that of opening. If it were that of closing, a damaged point
    # would not resist by cohesion, and nothing else would while contact is switched off.
    opening = normals.span([conditional(ge(G_n, 0), G_n, 0) for G_n in normal_components])
    closing = normals.span([conditional(ge(G_n, 0), 0, G_n) for G_n in normal_components])
    sliding = gap_vector - normals.span(normal_components)
    opening_and_sliding = opening + sliding

    m_0, G = law.mode(inner(opening, opening), inner(sliding, sliding))
    square = inner(opening, opening) + inner(sliding, sliding)
    m = sqrt(conditional(gt(square, m_0**2), square, m_0**2))
    remaining_at_jump = law.remaining(m, m_0, G)
    is_loading = And(ge(1 - remaining_at_jump, committed["damage"] - LOADING), lt(frozen, 0.5))
    damage = conditional(is_loading, 1 - remaining_at_jump, committed["damage"])
    bonded = 1 - law.unbonded
    remaining = bonded * conditional(is_loading, remaining_at_jump, 1 - committed["damage"])
    # With another mode mixture, more damage may be a smaller part of another fracture energy:
    # `spent` is then kept, so that it never falls.
    spent_at_jump = law.spent(m, m_0, G)
    is_spending = And(is_loading, ge(spent_at_jump, committed["spent"] - LOADING))
    spent = conditional(is_spending, spent_at_jump, committed["spent"])

    # Undamaged points are springs in compression, points with a debonded area have contact.
    has_debonded_area = gt(law.unbonded + bonded * committed["damage"], 0)
    K_closing = conditional(has_debonded_area, 0, law.K)
    K_remaining = remaining * law.K
    return CohesiveState(
        traction=K_remaining * opening_and_sliding + K_closing * closing,
        stored=(
            K_remaining * inner(opening_and_sliding, opening_and_sliding)
            + K_closing * inner(closing, closing)
        )
        / 2,
        dissipated_in_step=bonded * G * (spent - committed["spent"]),
        debonded_share=conditional(has_debonded_area, 1 - remaining, 0),
        damage=damage,
        spent=spent,
    )
