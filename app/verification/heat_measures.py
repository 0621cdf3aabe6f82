"""Errors of the thermal runs of ``mantle verify``: one small function per quantity."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from app.foundation.arrays import Floats
from app.results.reading import Run
from app.verification import closed_forms_coupled as coupled
from app.verification import closed_forms_heat as exact
from app.verification.check import Sample, worst
from app.verification.measures import by_region, in_l2, relative

# Conductivity [N/(s K)] and capacity [N/(mm2 K)] of the cases.
CEMENT, BONE = (0.2, 1.74), (0.58, 2.331)
KELVIN = 273.15
# Temperature (n,) [degC] of a region at points (n, 3) at a time [s].
HeatField = Callable[[Floats, float], NDArray[np.floating]]


def temperatures(
    run: Run,
    fields: Sequence[HeatField],
    scale: float,
    ends: Sequence[float] = (),
    since: float = 0.0,
) -> Sample:
    """Largest temperature error of any node at any written step, over a scale [K].

    ``fields`` are one for each region, ``ends`` seconds at the start and at the end of each stage,
    empty for a steady state; steps up to ``since`` [s] are not compared.
    """
    samples = []
    for step, seconds in _written(run, ends, since):
        T = run.temperature(step)
        for region, field in enumerate(fields, start=1):
            nodes = run.nodes_of(region)
            should = field(run.points[nodes], seconds)
            off = np.abs(T[nodes] - should) / scale
            at = int(np.argmax(off))
            samples.append(Sample(float(off[at]), float(T[nodes[at]]), float(should[at])))
    return worst(samples)


def mean_square(
    run: Run, fields: Sequence[HeatField], zero: float, ends: Sequence[float] = ()
) -> Sample:
    """Temperatures over zero, relative in L2, at the worst written step; the rest as above."""

    def at(step: int, seconds: float) -> Sample:
        error, norm, reference = run.norms(
            lambda x, region: by_region(region, [T(x, seconds)[:, None] - zero for T in fields]),
            run.temperature(step)[:, None] - zero,
        )
        return Sample(error / reference, norm, reference)

    return worst([at(step, seconds) for step, seconds in _written(run, ends)])


def _written(run: Run, ends: Sequence[float], since: float = 0.0) -> list[tuple[int, float]]:
    """Written steps of stages that take time, and their seconds; the last of a steady state."""
    if not ends:
        return [(len(run.times) - 1, math.inf)]
    seconds = np.interp(run.times, np.arange(len(ends)), ends)
    return [(k, float(s)) for k, s in enumerate(seconds) if s > since]


def _walls(hot: float, first: float, second: float, cold: float) -> list[HeatField]:
    """Temperatures of two bars of 5 mm between walls, linear in each."""
    return [
        lambda x, t: hot + (first - hot) * x[:, 2] / 5,
        lambda x, t: cold + (second - cold) * (2 - x[:, 2] / 5),
    ]


def bars(run: Run, conductance: float) -> Sample:
    """Temperatures of two_bars.yaml over 63 K, and its flux."""
    q, hot, cold = exact.two_bars(100, 37, (5 / CEMENT[0], 5 / BONE[0]), conductance)
    flux = run.summary["thermal"]["interfaces"]["cement_bone"]["heat_flux_max"]
    found = temperatures(run, _walls(100, hot, cold, 37), 63.0)
    return worst([found, relative(flux, 1e3 * q)])


def rings(run: Run) -> Sample:
    """Temperatures of two_rings.yaml over 37 degC, relative in L2."""
    _, hot, cold = exact.two_rings(100, 37, (10, 14, 18), (CEMENT[0], BONE[0]), 0.5)
    fields: list[HeatField] = [
        lambda x, t: np.full(len(x), 100.0),
        lambda x, t: 100 + (hot - 100) * np.log(_radius(x) / 10) / math.log(14 / 10),
        lambda x, t: 37 + (cold - 37) * np.log(18 / _radius(x)) / math.log(18 / 14),
    ]
    return mean_square(run, fields, 37.0)


def _radius(x: Floats) -> Floats:
    return np.asarray(np.hypot(x[:, 0], x[:, 1]))


def slab(run: Run) -> Sample:
    """Temperatures of perfused_slab.yaml over 20 degC, relative in L2."""
    law = exact.Slab(10.0, 0.5, 0.02, 37.0, 0.1, 0.6, 0.05, 20.0)
    return mean_square(run, [lambda x, t: law.temperature(x[:, 2])], 20.0)


def in_fibre(run: Run) -> Sample:
    """Temperature of fibre_heat.yaml over 310 K, relative in L2."""
    zero = 310 - KELVIN
    return mean_square(run, [lambda x, t: zero + x[:, 0] ** 2 + 2 * x[:, 0] * x[:, 1]], zero)


def cylinder(run: Run) -> Sample:
    """Temperatures of cooling_cylinder.yaml over 37 degC, relative in L2."""

    def field(x: Floats, t: float) -> Floats:
        return exact.cooling_cylinder(_radius(x), t, 10, CEMENT, 100, 37)

    return mean_square(run, [field], 37.0, (0, 60, 100, 300))


def half_spaces(run: Run, conductance: float) -> Sample:
    """Temperatures of half_spaces.yaml over 63 K."""
    law = exact.HalfSpaces(CEMENT, BONE, (100, 37), conductance)
    fields = [lambda x, t, s=side: law.temperature(x[:, 2] - 8, t, s) for side in (True, False)]
    return temperatures(run, fields, 63.0, (0, 10))


def rubbed(run: Run, share: float) -> Sample:
    """Temperatures of rubbing.yaml over the rise of the hotter surface; share of the cement."""
    fields: list[HeatField] = [
        lambda x, t: 37 + exact.heated_half_space(x[:, 2] - 8, t, 75 * share, CEMENT),
        lambda x, t: 37 + exact.heated_half_space(x[:, 2] - 8, t, 75 * (1 - share), BONE),
    ]
    surface = np.array([[0.0, 0.0, 8.0]])
    most = float(np.max([field(surface, 10) for field in fields])) - 37
    return temperatures(run, fields, most, (0, 0, 10), since=2.4)


def rubbing_heat(run: Run) -> Sample:
    """Heat stored in rubbing.yaml against the work lost by friction [N mm]."""
    capacity = np.array([CEMENT[1], BONE[1]])[run.region - 1]
    rise = (run.temperature() - 37)[run.cells[:, :4]].mean(axis=1)
    stored = float((capacity * rise * run.volumes()).sum())
    return relative(stored, run.summary["interfaces"]["cement_bone"]["dissipation"])


def degree(run: Run, reference: float) -> Sample:
    """Degree of cure of exotherm.yaml at its end, uniform in space."""
    q = run.summary["cure"]["cube"]
    return worst([relative(q[key], reference) for key in ("degree_min", "degree_max")])


def heat_of_cure(run: Run) -> Sample:
    """Final temperature of exotherm.yaml, from the heat of the degree of cure reached [degC]."""
    q = run.summary["cure"]["cube"]
    rise = 155 / 1.74 * (q["degree_max"] - 1e-3)
    value = run.summary["thermal"]["regions"]["cube"]["temperature_max"]
    return Sample(abs(value - 37 - rise) / rise, value, 37 + rise)


def layers_stress(run: Run, joined: tuple[bool, bool]) -> Sample:
    """Radial and hoop stress of the cement of cooled_layers.yaml at its surfaces [MPa].

    Both are of the form A + B / r²: fitted to the cells' means, taken at 6 and 10 mm.
    """
    law = _layers(joined)
    cells = run.region == 2
    scale = abs(law.at(1, 6.0)[2])
    x = run.points[run.cells[cells, :4]].mean(axis=1)
    r = np.hypot(x[:, 0], x[:, 1])
    n = x[:, :2] / r[:, None]
    σ = run.stress()[cells][:, :2, :2]
    radial = np.einsum("ci,cij,cj->c", n, σ, n)
    hoop = σ[:, 0, 0] + σ[:, 1, 1] - radial
    weights = np.sqrt(run.volumes()[cells])
    rows = np.column_stack([np.ones(len(r)), r**-2.0]) * weights[:, None]
    samples = []
    for k, values in ((1, radial), (2, hoop)):
        A, B = np.linalg.lstsq(rows, values * weights, rcond=None)[0]
        for at in (6.0, 10.0):
            value, reference = float(A + B / at**2), float(law.at(1, at)[k])
            samples.append(Sample(abs(value - reference) / scale, value, reference))
    return worst(samples)


def layers_contact(run: Run) -> Sample:
    """Grip on the stem [MPa] and gap at the bone [mm] of cooled_layers.yaml without tension."""
    law, sides = _layers((True, False)), run.summary["interfaces"]
    grip = relative(sides["stem_cement"]["pressure_mean"], -law.at(1, 6.0)[1])
    return worst([grip, relative(sides["cement_bone"]["gap_p99"], law.gap(1))])


def _layers(joined: tuple[bool, bool]) -> coupled.Layers:
    """Stem, cement that shrinks by 40 K times 80e-6, and bone."""
    materials = ((200e3, 0.3), (2200.0, 0.3), (17e3, 0.3))
    return coupled.Layers((6, 10, 15), materials, (0.0, -80e-6 * 40, 0.0), joined)


def hot_fit(run: Run) -> Sample:
    """Mean pressure of hot_fit.yaml [MPa]."""
    core, ring = ((200e3, 0.3), 14e-6), ((2200.0, 0.3), 10e-6)
    reference = coupled.hot_fit_pressure((7, 10), core, ring, 0.4, 0.3, (80, 37, 37))
    return relative(run.summary["interfaces"]["stem_cement"]["pressure_mean"], reference)


WALLS = coupled.HeatedWalls(
    (5, 5), (110e3, 2200), (9e-6, 80e-6), (6.7, 0.2), 0.01, 0.3, 0.005, (80, 37, 37)
)


def walls(run: Run, closed: bool) -> Sample:
    """Temperatures over 43 K and pressure of heated_walls.yaml, in one of its stable states."""
    state = WALLS.states()[-1 if closed else 0]
    found = temperatures(run, _walls(80, state.first, state.second, 37), 43.0)
    pressure = run.summary["interfaces"]["metal_cement"]["pressure_mean"]
    off = abs(pressure - state.pressure) / WALLS.states()[-1].pressure
    return worst([found, Sample(off, pressure, state.pressure)])


WAVY = coupled.WavyContact()


def wavy_temperature(run: Run) -> Sample:
    """Temperature of wavy_contact.yaml over 37 degC, relative in L2."""
    fields = [lambda x, t, u=upper: WAVY.temperature(x, u) for upper in (False, True)]
    return mean_square(run, fields, 37.0)


def wavy_displacement(run: Run) -> Sample:
    """Displacement of wavy_contact.yaml, relative in L2."""
    return in_l2(run, [lambda x: WAVY.displacement(x, False), lambda x: WAVY.displacement(x, True)])


def endured(run: Run, low: float, high: float) -> Sample:
    """Largest violation of the bounds of a stiff case.

    The error is the largest of: heat lost, over all heat that moved; temperatures [degC] beyond the
    bounds, over their distance; degrees of cure beyond 0 and 1. ``low`` and ``high`` are the bounds
    of the data, the latter infinite if there is a source of heat.
    """
    summary = run.summary
    regions, cured = summary["thermal"]["regions"].values(), summary.get("cure", {}).values()
    balance = float(summary["balance"]["heat"])
    span = high - low if math.isfinite(high) else 100.0
    coldest = min(r["temperature_min"] for r in regions)
    hottest = max(r["temperature_max"] for r in regions)
    cures = [a for q in cured for a in (-q["degree_min"], q["degree_max"] - 1)]
    off = max(0.0, (low - coldest) / span, (hottest - high) / span, *cures)
    solver = summary["solver"]
    steps = f"steps {solver['steps']}, rejected {solver['rejected_steps']}"
    note = f"{steps}, balance {balance:.0e}, {coldest:.2f} to {hottest:.2f} degC"
    sample = worst([Sample(abs(balance), balance, 0.0), Sample(off, hottest, high)])
    return replace(sample, note=note)
