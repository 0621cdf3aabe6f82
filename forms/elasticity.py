r"""Elastic bodies: strain, strain energy, stress (paper eq. 48-51).

Symbols: u displacement (3,) [mm], ε small strain (3, 3) [-], σ Cauchy stress (3, 3) [MPa],
m fibre direction (3,) [-], M = m ⊗ m. The equation numbers are those of Rakotomanana and
Ramaniraka's paper; its printed eq. 49 and 50 carry a sign and two factors that make the stiffness
indefinite, the forms here are the corrected ones and say where they differ.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ufl import Identity, as_matrix, diff, dot, inner, outer, sym, tr, variable
from ufl import grad as nabla
from ufl.algorithms import expand_derivatives, strip_variables
from ufl.core.expr import Expr


def strain(u: Expr) -> Expr:
    r"""Small strain :math:`ε = \tfrac12 (∇u + ∇u^T)`, shape (3, 3), eq. 49."""
    return sym(nabla(u))


def isotropic_coefficients(E: Any, ν: Any) -> tuple[Any, Any]:
    """Coefficients (e1, e2) of eq. 48 for an isotropic body.

    e1 is Lamé's λ and e2 is twice the shear modulus; the fibre terms vanish.

    Args:
        E: Young's modulus [MPa].
        ν: Poisson's ratio [-].

    Returns:
        e1 and e2 [MPa].
    """
    return E * ν / ((1 + ν) * (1 - 2 * ν)), E / (1 + ν)


def transversely_isotropic_coefficients(
    E_l: Any, E_t: Any, ν_l: Any, ν_t: Any, μ_l: Any
) -> tuple[Any, Any, Any, Any, Any]:
    r"""Coefficients e1..e5 of eq. 50, corrected.

    The paper prints :math:`ν_t^2 E_t/E_l` where e1, e3 and e5 need :math:`ν_l^2 E_t/E_l`, and
    :math:`E_t/E_l` where the last term of e5 needs :math:`E_l/E_t`. These forms equal the inverse
    of the compliance with :math:`S_{13} = -ν_l/E_l`.

    Args:
        E_l: Young's modulus along the fibre [MPa].
        E_t: Young's modulus across it [MPa].
        ν_l: Transverse contraction under tension along the fibre [-].
        ν_t: Poisson's ratio in the plane of isotropy [-].
        μ_l: Shear modulus in planes that hold the fibre [MPa].

    Returns:
        e1, e2, e3, e4, e5 [MPa].
    """
    Δ = (1 - ν_t - 2 * ν_l**2 * E_t / E_l) * (1 + ν_t)
    a = ν_l**2 * E_t / E_l
    e1 = (ν_t + a) * E_t / Δ
    e2 = E_t / (1 + ν_t)
    e3 = (ν_l - ν_t + ν_l * ν_t - a) * E_t / Δ
    e4 = 2 * μ_l - E_t / (1 + ν_t)
    e5 = -4 * μ_l + (1 - 2 * ν_l - 2 * ν_l * ν_t - a + (1 - ν_t**2) * E_l / E_t) * E_t / Δ
    return e1, e2, e3, e4, e5


def isotropic_energy(ε: Expr, e1: Any, e2: Any) -> Expr:
    r"""Strain energy :math:`ψ = \tfrac12 e_1 tr^2 ε + \tfrac12 e_2 tr\,ε^2` [MPa], eq. 48."""
    return e1 / 2 * tr(ε) ** 2 + e2 / 2 * inner(ε, ε)


def transversely_isotropic_energy(
    ε: Expr, m: Expr, e1: Any, e2: Any, e3: Any, e4: Any, e5: Any
) -> Expr:
    r"""Strain energy of a body with one fibre direction, eq. 48.

    .. math:: ψ = \tfrac12 e_1 tr^2 ε + \tfrac12 e_2 tr\,ε^2 + e_3\, tr Mε\, tr ε
                  + e_4\, tr Mε^2 + \tfrac12 e_5\, tr^2 Mε

    Args:
        ε: Strain (3, 3).
        m: Fibre direction, unit (3,).
        e1: First coefficient of eq. 50 [MPa].
        e2: Second [MPa].
        e3: Third [MPa].
        e4: Fourth [MPa].
        e5: Fifth [MPa].

    Returns:
        Energy density [MPa].
    """
    M = outer(m, m)
    trM = inner(M, ε)
    εm = dot(ε, m)
    return isotropic_energy(ε, e1, e2) + e3 * trM * tr(ε) + e4 * inner(εm, εm) + e5 / 2 * trM**2


def stress(energy: Any, ε: Expr) -> Expr:
    r"""Stress :math:`σ = +∂ψ/∂ε` (3, 3) [MPa]: eq. 49 with its sign corrected.

    The derivative by nine independent components is not symmetric where ψ holds ε m; that by
    symmetric strains is its symmetric part.

    Args:
        energy: Function ε -> ψ(ε).
        ε: Elastic strain (3, 3).
    """
    e = variable(ε)
    # The label of the variable differs from run to run; without it compiled forms are found again.
    return strip_variables(expand_derivatives(sym(diff(energy(e), e))))


def symmetric(components: Sequence[Any]) -> Expr:
    """Symmetric tensor (3, 3) from its components xx, yy, zz, yz, xz, xy.

    The off-diagonal entries of a strain are half the engineering shear.
    """
    xx, yy, zz, yz, xz, xy = components
    return as_matrix([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def isotropic_strain(e: Any) -> Expr:
    r"""Strain :math:`e\,I` (3, 3) that is equal in all directions [-].

    Thermal strain has :math:`e = α (θ - θ_{ref})`. Equation 51 leaves it out: the elastic strain is
    the total strain minus :math:`e\,I`.

    Args:
        e: Linear strain [-].
    """
    return e * Identity(3)
