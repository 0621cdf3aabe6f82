"""Degree of cure: a state of every node of a curing region, advanced node by node; its heat.

The degree of cure at the end of an implicit step follows from the temperature there,
a(T) = a* + h f(a, T). A node that stands for the volume V releases the power Q V (a(T) - a*)/h. For
any step the heat released is thus the heat of the change of a.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
from ufl import as_ufl, diff, variable
from ufl.algorithms import expand_derivatives, strip_variables
from ufl.core.expr import Expr

from app.foundation.arrays import Bools, Floats, Ints
from app.heat.heat_forms import HeatForms
from app.laws.cure import Autocatalytic, Cure, Prescribed
from app.laws.values import multiplier
from app.numerics.integrator import SAME_TIME
from app.numerics.pointwise import Pointwise
from app.scene.bodies import Bodies
from app.scene.scene import Scene
from forms import cure as forms

# A reaction ends this far below its limit. The rest would take ever longer and warm by less than
# any tolerance, but stages of a long step would overshoot the limit.
UNREACTED = 1e-6
# Degrees further than this from [0, 1] are not rounding errors.
ROUNDING_OF_DEGREES = 1e-12
# Below this degree errors count relative to the degree.
_SMALL_DEGREE = 1e-2
# Smallest degree that errors are relative to.
_SMALLEST_DEGREE = 1e-9
# Newton's method is in the logarithm of the reacting over the remaining part.
_LOG_TOLERANCE = 1e-8
# Fractions of the reactive part between these are accepted from the last step without a check of
# the ends.
_LOWEST_SHARE = 1e-12
_HIGHEST_SHARE = 0.5
# Logarithm of a negligible fraction.
_LOWEST_LOG = -50.0
# Lowest meaningful temperature of solver iterates [K].
_COLDEST = 1.0
# Highest one [K].
_HOTTEST = 1e9
# Least reactive share whose powers are finite.
_SMALLEST_SHARE = 1e-300
_ITERATIONS = 100


@dataclass(frozen=True)
class Degrees:
    """Degree of cure after an implicit step and its derivative by the temperature there (n,)."""

    degree: Floats
    by_temperature: Floats


def are_admissible(degrees: Floats) -> bool:
    """Return True if every degree is in [0, 1] up to rounding.

    An implicit stage of too long a time step may start from one that does not.
    """
    return bool((np.abs(degrees - 0.5) <= 0.5 + ROUNDING_OF_DEGREES).all())


class PrescribedKinetics:
    """Cure as a function of time, independent of temperature."""

    def __init__(self, terms: Prescribed, initial: float) -> None:
        self._time_course, self._initial = terms.rate, initial
        times, rates = np.array(terms.rate).T
        self._total = float(np.trapezoid(rates, times))
        self.events = tuple(map(float, times))

    def update(self, start: Floats, temperature: Floats, h: float, seconds: float) -> Degrees:
        """Advance all nodes alike."""
        start = np.clip(start, 0.0, 1.0)
        # Before and after its time course the reaction rests. Where it begins or ends abruptly, a
        # step that ends there has the rate before; times are rounded.
        time_rounding = SAME_TIME * seconds
        is_running = self.events[0] + time_rounding < seconds <= self.events[-1] + time_rounding
        rate_factor = multiplier(self._time_course, seconds) if is_running else 0.0
        rate = forms.prescribed_rate(rate_factor, self._total, self._initial)
        return Degrees(np.minimum(start + h * rate, 1.0), np.zeros_like(start))


class AutocatalyticKinetics:
    """Nodes of a region with autocatalytic kinetics."""

    events: tuple[float, ...] = ()

    def __init__(self, comm: MPI.Comm, terms: Autocatalytic, nodes: int) -> None:
        pairs = terms.limit or ()
        orders = {"k0": terms.rate_constant, "Ea": terms.activation_energy}
        orders |= {"m": terms.m, "n": terms.n}
        knots = {f"T_{k}": T for k, (T, _) in enumerate(pairs)}
        levels = {f"limit_{k}": a for k, (_, a) in enumerate(pairs)}

        def laws(x: dict[str, Expr]) -> list[Expr]:
            """Rate and limit with their derivatives by degree and temperature."""
            a, T = variable(x["a"]), variable(x["T"])
            limit = as_ufl(1.0)
            if pairs:
                limit = forms.piecewise_linear(T, [x[k] for k in knots], [x[k] for k in levels])
            rate = forms.autocatalytic_rate(a, T, limit, *(x[k] for k in orders))
            expressions = [rate, diff(rate, a), diff(rate, T)]
            expressions += [limit, diff(limit, T)] if pairs else []
            # Labels of variables differ from run to run: without them compiled code is used again.
            return [strip_variables(expand_derivatives(e)) for e in expressions]

        constants = orders | knots | levels
        self._limited = bool(pairs)
        self._laws = Pointwise(comm, nodes, dict.fromkeys(["a", "T", *constants], 1), laws)
        self._laws.set(**constants)
        # Mean rates of the last step, with their temperatures and derivatives: close to the next.
        self._mean_rate, self._temperature, self._rate_by_temperature = np.zeros((3, nodes))

    def update(self, start: Floats, temperature: Floats, h: float, seconds: float) -> Degrees:
        """Advance the nodes that still react."""
        start = np.clip(start, 0.0, 1.0)
        # Solver iterates may be unphysically cold, or NaN: nothing reacts there.
        T = np.minimum(np.fmax(temperature, _COLDEST), _HOTTEST)
        limit, limit_by_T = np.ones_like(T), np.zeros_like(T)
        if self._limited:
            limit, limit_by_T = self._laws(a=start, T=T)[3:]
        degree, by_T = start.copy(), np.zeros_like(start)

        def rates(rows: Ints, reacted: Floats) -> list[Floats]:
            return self._laws(rows, a=start[rows] + reacted, T=T[rows])[:3]

        sought = self._sought(start, limit, T, h)
        sought, finished = _bracketed(sought, start, h, rates)
        degree[finished], by_T[finished] = limit[finished] - UNREACTED, limit_by_T[finished]
        rows = sought.rows
        reacted, f, f_a, f_T = _reacted(sought, h, rates)
        degree[rows] = start[rows] + reacted
        with np.errstate(divide="ignore", invalid="ignore"):
            # The step itself, or the rest of it where the reaction has ended before.
            reaction_time = np.fmin(h, reacted / f)
            slope = reaction_time * f_T / (1 - reaction_time * f_a)
        by_T[rows] = np.where(np.isfinite(slope), slope, 0.0)
        self._mean_rate[:] = (degree - start) / h
        self._temperature[:] = T
        self._rate_by_temperature[:] = by_T / h
        return Degrees(degree, by_T)

    def _sought(self, start: Floats, limit: Floats, T: Floats, h: float) -> _SoughtShares:
        """Nodes that can still react, with the shares that the rates of the last step give."""
        rows = np.flatnonzero(limit - start > UNREACTED)
        remaining = limit[rows] - start[rows]
        warming = T[rows] - self._temperature[rows]
        mean_rate = self._mean_rate[rows] + self._rate_by_temperature[rows] * warming
        return _SoughtShares(
            rows,
            remaining,
            share=np.where(self._mean_rate[rows] > 0, h * mean_rate / remaining, 0.0),
            lower=np.full(len(rows), _LOWEST_LOG),
            upper=np.log((remaining - UNREACTED) / UNREACTED),
        )


@dataclass
class _SoughtShares:
    """Nodes whose reacted share of the remaining part is sought, each array (r,).

    The unknown of a share p is ln(p / (1 - p)).

    Attributes:
        rows: The nodes.
        remaining: Degree of cure that is left to the limit.
        share: First guess; 0 where there is none.
        lower: Lower bound of the unknown.
        upper: Upper bound of the unknown.
    """

    rows: Ints
    remaining: Floats
    share: Floats
    lower: Floats
    upper: Floats

    def part(self, taken: Bools) -> _SoughtShares:
        """Some of the nodes."""
        return _SoughtShares(
            self.rows[taken],
            self.remaining[taken],
            self.share[taken],
            self.lower[taken],
            self.upper[taken],
        )


# Rate and its derivatives by degree and temperature at nodes, for the degree that reacted there.
_Rates = Callable[[Ints, Floats], list[Floats]]


def _bracketed(
    sought: _SoughtShares, start: Floats, h: float, rates: _Rates
) -> tuple[_SoughtShares, Ints]:
    """Evaluate rates at the ends of the interval where the last step says too little.

    Returns:
        The nodes with a share between the ends, with better bounds and guesses, and the nodes that
        reach their limit within the step h [s].
    """
    is_known = (sought.share > _LOWEST_SHARE) & (sought.share < _HIGHEST_SHARE)
    unknown = np.flatnonzero(~(is_known & (start[sought.rows] > 0)))
    if not len(unknown):
        return sought, unknown
    rows, remaining = sought.rows[unknown], sought.remaining[unknown]
    rate_at_start = rates(rows, np.zeros(len(rows)))[0]
    rate_at_limit = rates(rows, remaining - UNREACTED)[0]
    # Rates in between are at least the lower of the two at the ends.
    lowest_share = h * np.minimum(rate_at_start, rate_at_limit) / remaining
    sought.lower[unknown] = np.log(np.maximum(lowest_share, _SMALLEST_SHARE)) - 1.0
    guess = sought.share[unknown]
    sought.share[unknown] = np.where(guess > 0, guess, h * rate_at_start / remaining)
    starts = rate_at_start > 0
    reaches_limit = h * rate_at_limit >= remaining - UNREACTED
    is_between = np.ones(len(sought.rows), dtype=bool)
    is_between[unknown[reaches_limit | ~starts]] = False
    return sought.part(is_between), rows[reaches_limit & starts]


def _reacted(
    sought: _SoughtShares, h: float, rates: _Rates
) -> tuple[Floats, Floats, Floats, Floats]:
    r"""Degree that reacts at nodes, with the rate and its derivatives by degree and temperature.

    Newton's method solves ln(a - a*) - ln(h f) = 0 between bounds, with the unknown s:

    .. math:: a = a^* + (a_{max} - a^*) / (1 + e^{-s}) .

    The function is nearly linear in s at both ends. For m <= 1 it increases, so that there is
    one root. For m > 1 a long step may have several; one of them is returned.
    """
    lower, upper = sought.lower.copy(), sought.upper.copy()
    with np.errstate(divide="ignore", invalid="ignore"):
        unknown = np.log(sought.share) - np.log1p(-sought.share)
    at_rows = np.zeros((3, len(unknown)))
    unconverged = np.arange(len(unknown))
    for _ in range(_ITERATIONS):
        if not len(unconverged):
            break
        lower_bound, upper_bound = lower[unconverged], upper[unconverged]
        trial = unknown[unconverged]
        is_within = (trial > lower_bound) & (trial < upper_bound)
        trial = np.where(is_within, trial, (lower_bound + upper_bound) / 2)
        share = _logistic(trial)
        reacted = sought.remaining[unconverged] * share
        f, f_a, f_T = rates(sought.rows[unconverged], reacted)
        at_rows[:, unconverged] = f, f_a, f_T
        with np.errstate(divide="ignore", invalid="ignore"):
            value = np.log(reacted / (h * f))
            slope = (1 - share) * (1 - reacted * f_a / f)
            step = np.where(slope > 0, -value / slope, np.inf)
        lower[unconverged] = np.where(value > 0, lower_bound, trial)
        upper[unconverged] = np.where(value > 0, trial, upper_bound)
        unknown[unconverged] = trial + step
        is_unconverged = ~(np.abs(step) <= _LOG_TOLERANCE) & (
            upper[unconverged] - lower[unconverged] > _LOG_TOLERANCE
        )
        unconverged = unconverged[is_unconverged]
    return sought.remaining * _logistic(np.clip(unknown, lower, upper)), *at_rows


Kinetics = AutocatalyticKinetics | PrescribedKinetics


def kinetics_of(comm: MPI.Comm, cure: Cure, nodes: int) -> Kinetics:
    """Kinetics of a curing region with a number of nodes on this rank; collective."""
    if cure.kinetics.kind == "prescribed":
        return PrescribedKinetics(cure.kinetics, cure.initial)
    return AutocatalyticKinetics(comm, cure.kinetics, nodes)


def error_as_temperature(degree: Floats, error: Floats, rise: float) -> Floats:
    """Errors of degrees of cure as temperatures (n,) [K], by the heat that they release.

    At small degrees an error counts relative to the degree, for both grow together. ``rise`` is the
    adiabatic temperature rise of the region by full cure [K].
    """
    return rise * error * np.maximum(1, _SMALL_DEGREE / np.maximum(degree, _SMALLEST_DEGREE))


def fraction_since_gelation(gel: float, start: Floats, end: Floats, s: float) -> Floats:
    """Fraction of a step's free strain reached at a fraction s of the step (n,).

    The degree of cure is linear in s; ``gel`` is that at gelation.
    """
    gelation_share = np.divide(
        gel - start, end - start, out=np.zeros_like(start), where=end > start
    )
    clipped_share = np.clip(gelation_share, 0.0, 1.0)
    after_gelation = np.maximum(s - clipped_share, 0.0)
    return np.divide(
        after_gelation, 1 - clipped_share, out=np.ones_like(after_gelation), where=clipped_share < 1
    )


def free_strain(comm: MPI.Comm, cure: Cure, expansion: float, nodes: int) -> Pointwise:
    """Compiled stress-free strain (n,) [-] of a step from (a_old, T_old) to (a, T [K]).

    ``expansion`` is the coefficient of thermal expansion [1/K], n the ``nodes`` on this rank.
    """
    constants = {
        "gel": cure.gel,
        "expansion": expansion,
        "shrinkage": cure.shrinkage,
    }
    input_names = ("a_old", "T_old", "a", "T", *constants)
    increment = forms.free_strain_increment
    sizes = dict.fromkeys(input_names, 1)
    law = Pointwise(comm, nodes, sizes, lambda x: [increment(*(x[k] for k in input_names))])
    law.set(**constants)
    return law


def _logistic(s: Floats) -> Floats:
    """1 / (1 + exp(-s)) without overflow."""
    small = np.exp(-np.abs(s))
    return np.where(s < 0, small, 1.0) / (1 + small)


@dataclass(frozen=True)
class CuringNodes:
    """Owned nodes of a curing region.

    Attributes:
        region: Name of the region.
        body: Thermal body whose temperature they have.
        dof: Owned nodes, rising (n,).
        heat: Heat that each releases from degree 0 to 1 (n,) [N mm].
        adiabatic_rise: Adiabatic temperature rise of the region by that heat [K].
        kinetics: Kinetics of their cure.
    """

    region: str
    body: int
    dof: Ints
    heat: Floats
    adiabatic_rise: float
    kinetics: Kinetics


class CureHeat:
    """Degrees of cure and their heat in an implicit step.

    Attributes:
        nodes: Nodes of each curing region.
        events: Times [s] that no time step should cross.
    """

    def __init__(self, scene: Scene, bodies: Bodies, forms: HeatForms) -> None:
        self._forms = forms
        capacity = {c.region: c.capacity for c in scene.conductors}
        self.nodes: list[CuringNodes] = []
        for c in scene.cures:
            volume = forms.volumes(c.region)
            dof = np.flatnonzero(volume > 0)
            with forms.compiling():
                kinetics = kinetics_of(forms.comm, c, len(dof))
            body, rise = bodies.body_of_region[c.region], c.heat / capacity[c.region]
            heat = c.heat * volume[dof]
            self.nodes.append(CuringNodes(c.region, body, dof, heat, rise, kinetics))
        self.events = {t for n in self.nodes for t in n.kinetics.events}
        initial = {c.region: c.initial for c in scene.cures}
        self._start: list[Floats] = [np.full(len(n.dof), initial[n.region]) for n in self.nodes]
        self._step_length: float = np.inf
        self._seconds = 0.0
        self._last: tuple[list[Floats], list[Degrees]] | None = None

    def begin(self, start: Sequence[Floats], h: float, seconds: float) -> bool:
        """Prepare a step; False if it starts from inadmissible degrees; collective."""
        self._start = [a.copy() for a in start]
        self._step_length, self._seconds, self._last = h, seconds, None
        return bool(self._forms.comm.allreduce(all(map(are_admissible, start)), op=MPI.LAND))

    def degrees_at(self, T: Floats) -> list[Degrees]:
        """Degrees of cure for temperatures of owned nodes of each body (b, n) [K].

        A steady state keeps its initial degrees: all heat of cure is already released.
        """
        temperatures = [T[n.body, n.dof] for n in self.nodes]
        if self._last is None or not all(map(np.array_equal, temperatures, self._last[0])):
            if np.isinf(self._step_length):
                degrees = [Degrees(a, np.zeros_like(a)) for a in self._start]
            else:
                degrees = [
                    n.kinetics.update(a, t, self._step_length, self._seconds)
                    for n, a, t in zip(self.nodes, self._start, temperatures, strict=True)
                ]
            self._last = temperatures, degrees
        return self._last[1]

    def released(self, T: Floats) -> list[Floats]:
        """Heat that nodes of each region release (n,) [N mm/s]."""
        rate = 1 / self._step_length
        return [
            rate * n.heat * (d.degree - a)
            for n, d, a in zip(self.nodes, self.degrees_at(T), self._start, strict=True)
        ]

    def heat_into_nodes(self, T: Floats) -> Floats:
        """Heat released at owned nodes of each body (b, n) [N mm/s]."""
        total = self._forms.zeros()
        for n, heat in zip(self.nodes, self.released(T), strict=True):
            total[n.body, n.dof] += heat
        return total

    def heat_by_temperature(self, T: Floats) -> dict[int, Floats]:
        """Derivative of released heat by temperature at owned nodes of bodies [N mm/(s K)]."""
        total = self._forms.zeros()
        for n, d in zip(self.nodes, self.degrees_at(T), strict=True):
            total[n.body, n.dof] += 1 / self._step_length * n.heat * d.by_temperature
        return {b: total[b] for b in sorted({n.body for n in self.nodes})}
