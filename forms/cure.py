r"""Setting cement: rate of cure, modulus and free strain at a point.

Symbols: a degree of cure [-], T temperature [K]. All functions take UFL expressions.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from ufl import conditional, exp, ge, le, lt, max_value
from ufl.core.expr import Expr

from forms import Scalar

GAS_CONSTANT = 8.314462618
"""Molar gas constant R [J/(mol K)] (exact in the SI of 2019)."""


def autocatalytic_rate(
    a: Expr, T: Expr, limit: Scalar, k0: Scalar, Ea: Scalar, m: Scalar, n: Scalar
) -> Expr:
    r"""Rate of cure of an autocatalytic reaction, which reacted material accelerates [1/s].

    .. math:: \dot a = k_0 e^{-E_a / (R T)} a^m (a_{max} - a)_+^n

    Baliga, Rose and Ahmed, J Biomech Eng 114 (1992) 235, for bone cement with :math:`a_{max} = 1`;
    Borzacchiello et al., J Mater Sci Mater Med 9 (1998) 317, with a limit.

    Args:
        a: Degree of cure.
        T: Temperature [K].
        limit: Largest degree of cure a_max at this temperature [-]. Below its final glass
            transition a cement vitrifies before all monomer has reacted.
        k0: Rate constant [1/s].
        Ea: Activation energy [J/mol].
        m: Exponent of the degree of cure [-].
        n: Exponent of the remaining cure a_max - a [-].
    """
    return k0 * exp(-Ea / (GAS_CONSTANT * T)) * a**m * max_value(limit - a, 0) ** n


def prescribed_rate(r: Scalar, total: Scalar, initial: Scalar) -> Scalar:
    """Prescribed rate of cure [1/s]: (1 - initial) r / total.

    Args:
        r: Prescribed rate at this time [1/s].
        total: Integral of the prescribed rate over all time [-].
        initial: Degree of cure at the start; at the end it is one.
    """
    return (1 - initial) * r / total


def modulus_factor(a: Expr, gel: Scalar, floor: Scalar, exponent: Scalar) -> Expr:
    r"""Elastic modulus of a setting material over its final value [-].

    .. math:: g = g_0 + (1 - g_0) \left(\frac{(a - a_{gel})_+}{1 - a_{gel}}\right)^p

    The floor :math:`g_0` represents the flowing paste before gelation.

    Args:
        a: Degree of cure [-].
        gel: Degree of cure at gelation [-].
        floor: Modulus before gelation over its final value [-].
        exponent: Exponent p [-].
    """
    return floor + (1 - floor) * (max_value(a - gel, 0) / (1 - gel)) ** exponent


def solid_fraction(a_old: Expr, a: Expr, gel: Scalar) -> Expr:
    """Share of a step after gelation [-], for a degree of cure that is linear in the step."""
    share_after_gelation = (a - gel) / conditional(lt(a_old, a), a - a_old, 1)
    return conditional(ge(a_old, gel), 1, conditional(le(a, gel), 0, share_after_gelation))


def free_strain_increment(
    a_old: Expr, T_old: Expr, a: Expr, T: Expr, gel: Scalar, expansion: Scalar, shrinkage: Scalar
) -> Expr:
    r"""Free linear strain of a step [-], equal in all directions.

    .. math:: Δe = α_T (T - T_{gel}) - \frac s3 \frac{(a - a_{gel})_+ - (a_{old} - a_{gel})_+}
              {1 - a_{gel}}

    :math:`T_{gel}` is the temperature at which the material is first solid in the step. If gelation
    happens within the step, it is the temperature at gelation, with T linear in a. Otherwise it is
    the temperature at the start. Before gelation the paste flows and keeps no strain. Temperature
    and shrinkage enter by increments, because the modulus changes with time: Stańczyk and Telega,
    Eng Trans 51 (2003) 267.

    Args:
        a_old: Degree of cure before the step.
        T_old: Temperature before the step [K].
        a: Degree of cure after the step.
        T: Temperature after the step [K].
        gel: Degree of cure at gelation.
        expansion: Thermal expansion α_T [1/K].
        shrinkage: Volumetric shrinkage s from gelation to full cure.
    """
    thermal = expansion * solid_fraction(a_old, a, gel) * (T - T_old)
    cure_after_gelation = max_value(a, gel) - max_value(a_old, gel)
    return thermal - shrinkage / 3 * cure_after_gelation / (1 - gel)


def piecewise_linear(x: Expr, knots: Sequence[Scalar], values: Sequence[Scalar]) -> Expr:
    """Piecewise linear function of x, constant below the first and above the last knot.

    Args:
        x: Argument.
        knots: Values of x, ascending.
        values: Values of the function at the knots.
    """
    pairs = list(zip(knots, values, strict=True))
    value = pairs[-1][1]
    for (x_0, value_0), (x_1, value_1) in reversed(list(pairwise(pairs))):
        linear = value_0 + (value_1 - value_0) * (x - x_0) / (x_1 - x_0)
        value = conditional(lt(x, x_1), linear, value)
    return conditional(lt(x, pairs[0][0]), pairs[0][1], value)
