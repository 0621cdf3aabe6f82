r"""Setting cement: how fast it sets, how stiff it is meanwhile and how it strains.

Symbols: a degree of cure [-], T temperature [K], all of one point. Every function takes UFL
expressions.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from ufl import conditional, exp, ge, le, lt, max_value
from ufl.core.expr import Expr

GAS_CONSTANT = 8.314462618
"""Molar gas constant R [J/(mol K)] (exact in the SI of 2019)."""


def autocatalytic_rate(a: Expr, T: Expr, limit: Any, k0: Any, Ea: Any, m: Any, n: Any) -> Expr:
    r"""Rate of an autocatalytic reaction [1/s], the faster the more has reacted.

    .. math:: \dot a = k_0 e^{-E_a / (R T)} a^m (a_{max} - a)_+^n

    Baliga, Rose and Ahmed, J Biomech Eng 114 (1992) 235, for bone cement with :math:`a_{max} = 1`;
    Borzacchiello et al., J Mater Sci Mater Med 9 (1998) 317, with a limit.

    Args:
        a: Degree of cure.
        T: Temperature [K].
        limit: Largest degree of cure at this temperature: below its final glass transition a cement
            vitrifies before all monomer has reacted.
        k0: Rate constant [1/s].
        Ea: Activation energy [J/mol].
        m: Exponent of what has reacted.
        n: Exponent of what is left.
    """
    return k0 * exp(-Ea / (GAS_CONSTANT * T)) * a**m * max_value(limit - a, 0) ** n


def prescribed_rate(r: Any, total: Any, initial: Any) -> Any:
    """Rate that follows a clock [1/s]: (1 - initial) r / total.

    Args:
        r: The given course at this time [1/s].
        total: Its integral over all time.
        initial: Degree of cure at the start; it is one at the end.
    """
    return (1 - initial) * r / total


def modulus_factor(a: Expr, gel: Any, floor: Any, exponent: Any) -> Expr:
    r"""Elastic modulus of a setting material over that of the set one.

    .. math:: g = g_0 + (1 - g_0) \left(\frac{(a - a_{gel})_+}{1 - a_{gel}}\right)^p

    The floor :math:`g_0` stands for the paste before gelation, which flows.
    """
    return floor + (1 - floor) * (max_value(a - gel, 0) / (1 - gel)) ** exponent


def solid_share(a_old: Expr, a: Expr, gel: Any) -> Expr:
    """Share of a step that lies past gelation, the degree of cure being linear in the step."""
    crossing = (a - gel) / conditional(lt(a_old, a), a - a_old, 1)
    return conditional(ge(a_old, gel), 1, conditional(le(a, gel), 0, crossing))


def free_strain_increment(
    a_old: Expr, T_old: Expr, a: Expr, T: Expr, gel: Any, expansion: Any, shrinkage: Any
) -> Expr:
    r"""Linear strain that a step causes without stress, the same in all directions.

    .. math:: Δe = α_T (T - T_{gel}) - \frac s3 \frac{(a - a_{gel})_+ - (a_{old} - a_{gel})_+}
              {1 - a_{gel}}

    :math:`T_{gel}` is the temperature from which the step finds a solid: that at its start, or at
    gelation if it happens within the step (T linear in a). Before gelation the paste flows and no
    strain is kept. Temperature and shrinkage enter by increments, never by a strain from a fixed
    state, for the modulus changes meanwhile: Stańczyk and Telega, Eng Trans 51 (2003) 267.

    Args:
        a_old: Degree of cure before the step.
        T_old: Temperature before the step [K].
        a: Degree of cure after it.
        T: Temperature after it [K].
        gel: Degree of cure at gelation.
        expansion: Thermal expansion α_T [1/K].
        shrinkage: Volumetric shrinkage s from gelation to full cure.
    """
    thermal = expansion * solid_share(a_old, a, gel) * (T - T_old)
    gelled = max_value(a, gel) - max_value(a_old, gel)
    return thermal - shrinkage / 3 * gelled / (1 - gel)


def piecewise_linear(x: Expr, at: Sequence[Any], values: Sequence[Any]) -> Expr:
    """Linear between values at given, rising places, constant beyond them."""
    pairs = list(zip(at, values, strict=True))
    value = pairs[-1][1]
    for (x0, v0), (x1, v1) in reversed(list(pairwise(pairs))):
        value = conditional(lt(x, x1), v0 + (v1 - v0) * (x - x0) / (x1 - x0), value)
    return conditional(lt(x, pairs[0][0]), pairs[0][1], value)
