r"""Elastic bodies: strain, strain energy and stress (paper eq. 48-51).

Symbols: u displacement (3,) [mm], ε small strain (3, 3) [-], σ Cauchy stress (3, 3) [MPa],
m fibre direction (3,) [-], M = m ⊗ m. Equation numbers are those of Rakotomanana and Ramaniraka's
paper. Its printed eq. 49 and 50 have a wrong sign and two wrong factors, which make the stiffness
indefinite. The forms here are corrected, and their docstrings give the differences.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ufl import Identity, as_matrix, diff, dot, inner, outer, sym, tr, variable
from ufl import grad as nabla
from ufl.algorithms import expand_derivatives, strip_variables
from ufl.core.expr import Expr

from forms import Scalar


def strain(u: Expr) -> Expr:
    r"""Small strain :math:`ε = \tfrac12 (∇u + ∇u^T)`, shape (3, 3), eq. 49."""
    return sym(nabla(u))


def isotropic_coefficients(E: Scalar, ν: Scalar) -> tuple[Scalar, Scalar]:
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
    E_l: Scalar, E_t: Scalar, ν_l: Scalar, ν_t: Scalar, μ_l: Scalar
) -> tuple[Scalar, Scalar, Scalar, Scalar, Scalar]:
    r"""Coefficients e1..e5 of eq. 50, corrected.

    In e1, e3 and e5 the paper prints :math:`ν_t^2 E_t/E_l` instead of :math:`ν_l^2 E_t/E_l`. In the
    last term of e5 it prints :math:`E_t/E_l` instead of :math:`E_l/E_t`. The coefficients here give
    the inverse of the compliance with :math:`S_{13} = -ν_l/E_l`.

    Args:
        E_l: Young's modulus along the fibre [MPa].
        E_t: Young's modulus across it [MPa].
        ν_l: Transverse contraction under tension along the fibre [-].
        ν_t: Poisson's ratio in the plane of isotropy [-].
        μ_l: Shear modulus in planes that contain the fibre [MPa].

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


def isotropic_energy(ε: Expr, e1: Scalar, e2: Scalar) -> Expr:
    r"""Strain energy :math:`ψ = \tfrac12 e_1 tr^2 ε + \tfrac12 e_2 tr\,ε^2` [MPa], eq. 48."""
    return e1 / 2 * tr(ε) ** 2 + e2 / 2 * inner(ε, ε)


def transversely_isotropic_energy(
    ε: Expr, m: Expr, e1: Scalar, e2: Scalar, e3: Scalar, e4: Scalar, e5: Scalar
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


def stress(energy: Callable[[Expr], Expr], ε: Expr) -> Expr:
    r"""Stress :math:`σ = +∂ψ/∂ε` (3, 3) [MPa]: eq. 49 with its sign corrected.

    With nine independent components of ε, the derivative of a term in ε m is not symmetric. The
    derivative with respect to symmetric strains is its symmetric part.

    Args:
        energy: Strain energy density as a function of the strain, ε -> ψ(ε) [MPa].
        ε: Elastic strain (3, 3).
    """
    e = variable(ε)
    # The label of the variable differs between runs. Without it compiled forms are reused.
    return strip_variables(expand_derivatives(sym(diff(energy(e), e))))


def symmetric(components: Sequence[Scalar]) -> Expr:
    """Symmetric tensor (3, 3) from its components xx, yy, zz, yz, xz, xy.

    The off-diagonal entries of a strain are half the engineering shear.
    """
    xx, yy, zz, yz, xz, xy = components
    return as_matrix([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def isotropic_strain(e: Scalar) -> Expr:
    r"""Strain :math:`e\,I` (3, 3) that is equal in all directions [-].

    Thermal strain has :math:`e = α (θ - θ_{ref})`. Equation 51 leaves it out: the elastic strain is
    the total strain minus :math:`e\,I`.

    Args:
        e: Linear strain [-].
    """
    return e * Identity(3)
