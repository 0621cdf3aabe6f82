"""Heat: conduction, friction, heated elastic bodies, bounds and balance of stiff cases."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from app.foundation.arrays import Floats
from app.results.reading import Run
from app.verification import closed_forms
from app.verification import closed_forms_heat as exact
from app.verification.measures import by_region, in_l2, slice_of
from app.verification.problem import (
    Comparison,
    KnownProblem,
    quick,
    relative,
    stress,
    verify,
    worst,
)

# Conductivity [N/(s K)] and capacity [N/(mm2 K)] of the cases.
CEMENT = (0.2, 1.74)
BONE = (0.58, 2.331)
KELVIN = 273.15
# Temperature (n,) [degC] of a region at points (n, 3) at a time [s].
HeatField = Callable[[Floats, float], NDArray[np.floating]]
CARSLAW = "Carslaw & Jaeger, Conduction of Heat in Solids, section {}"


def written(run: Run, ends: Sequence[float], since: float = 0.0) -> list[tuple[int, float]]:
    """Written steps of stages that take time, and their seconds; the last step of a steady state.

    ``ends`` are seconds at the start and at the end of each stage, empty for a steady state. Steps
    up to ``since`` [s] are left out.
    """
    if not ends:
        return [(len(run.times) - 1, math.inf)]
    seconds = np.interp(run.times, np.arange(len(ends)), ends)
    return [(k, float(s)) for k, s in enumerate(seconds) if s > since]


def temperatures(
    run: Run,
    fields: Sequence[HeatField],
    scale: float,
    ends: Sequence[float] = (),
    since: float = 0.0,
) -> Comparison:
    """Largest temperature error of any node at any written step, over a scale [K].

    ``fields`` are one for each region; ``ends`` and ``since`` as in `written`.
    """
    comparisons = []
    for step, seconds in written(run, ends, since):
        T = run.temperature(step)
        for region, field in enumerate(fields, start=1):
            nodes = run.nodes_of(region)
            should = field(run.points[nodes], seconds)
            errors = np.abs(T[nodes] - should) / scale
            worst_node = int(np.argmax(errors))
            comparisons.append(
                Comparison(
                    float(errors[worst_node]),
                    float(T[nodes[worst_node]]),
                    float(should[worst_node]),
                )
            )
    return worst(comparisons)


def mean_square(
    run: Run, fields: Sequence[HeatField], zero: float, ends: Sequence[float] = ()
) -> Comparison:
    """Error of temperatures above zero, relative in L2, at the worst written step.

    Other arguments are those of `temperatures`.
    """

    def at(step: int, seconds: float) -> Comparison:
        error, norm, reference = run.norms(
            lambda x, region: by_region(region, [T(x, seconds)[:, None] - zero for T in fields]),
            run.temperature(step)[:, None] - zero,
        )
        return Comparison(error / reference, norm, reference)

    return worst([at(step, seconds) for step, seconds in written(run, ends)])


def between_walls(hot: float, first: float, second: float, cold: float) -> list[HeatField]:
    """Temperatures of two bars of 5 mm between walls, linear in each."""
    return [
        lambda x, t: hot + (first - hot) * x[:, 2] / 5,
        lambda x, t: cold + (second - cold) * (2 - x[:, 2] / 5),
    ]


# Steady conduction


@verify
@quick
def test_heat_bars(problem: KnownProblem) -> None:
    problem.expects(
        "temperatures of two bars, over their range, and flux; 0.2 to 1e12 W/(m2 K), perfect",
        tolerance=1e-6,
        source="resistances in series",
    )
    conductances = {f"{h} W/(m^2 K)": h for h in (0.2, 1.0, 300.0, 1e6, 1e9, 1e12)}
    conductances["perfect"] = math.inf
    changes_of_runs = [(f"interfaces.cement_bone.conductance={h}",) for h in conductances]
    runs = problem.solve_each("verification/two_bars.yaml", changes_of_runs)
    comparisons = []
    for solved, h in zip(runs, conductances.values(), strict=True):
        q, hot_side, cold_side = exact.two_bars(100, 37, (5 / CEMENT[0], 5 / BONE[0]), 1e-3 * h)
        comparisons.append(temperatures(solved, between_walls(100, hot_side, cold_side, 37), 63.0))
        if math.isfinite(h):  # perfect contact has no flux law
            flux = solved.summary["thermal"]["interfaces"]["cement_bone"]["heat_flux_max"]
            comparisons.append(relative(flux, 1e3 * q))
    problem.compare(*comparisons)


def radius(x: Floats) -> Floats:
    """Distances (n,) of points (n, 3) from the axis z."""
    return np.asarray(np.hypot(x[:, 0], x[:, 1]))


@verify
def test_heat_rings(problem: KnownProblem) -> None:
    problem.expects(
        "temperatures of two rings, relative in L2",
        tolerance=1e-4,
        order=2.0,
        source="resistances in series, ln(b/a) / (2 pi k) each",
    )
    sizes = problem.rungs((1, 0.5, 0.35, 0.25))
    runs = problem.solve_each("verification/two_rings.yaml", [slice_of(h) for h in sizes])
    _, hot_side, cold_side = exact.two_rings(100, 37, (10, 14, 18), (CEMENT[0], BONE[0]), 0.5)
    fields: list[HeatField] = [
        lambda x, t: np.full(len(x), 100.0),
        lambda x, t: 100 + (hot_side - 100) * np.log(radius(x) / 10) / math.log(14 / 10),
        lambda x, t: 37 + (cold_side - 37) * np.log(18 / radius(x)) / math.log(18 / 14),
    ]
    problem.converges([mean_square(solved, fields, 37.0) for solved in runs])


@verify
@quick
def test_heat_slab(problem: KnownProblem) -> None:
    problem.expects(
        "temperatures of a perfused slab, relative in L2",
        tolerance=1e-3,
        source="Pennes, J. Appl. Physiol. 1, 1948",
    )
    solved = problem.solve("verification/perfused_slab.yaml")
    law = exact.Slab(L=10.0, k=0.5, w=0.02, T_b=37.0, s=0.1, q=0.6, h=0.05, T_a=20.0)
    problem.compare(mean_square(solved, [lambda x, t: law.temperature(x[:, 2])], 20.0))


@verify
def test_heat_fibre(problem: KnownProblem) -> None:
    problem.expects(
        "temperatures with a fibre in any direction, relative in L2",
        tolerance=5e-3,
        order=2.0,
        source="manufactured: 310 K + x^2 + 2 x y",
    )
    sizes = problem.rungs((1 / 3, 1 / 4, 1 / 6, 1 / 8))
    changes_of_runs = [(f"mesh.size={h!r} mm",) for h in sizes]
    runs = problem.solve_each("verification/fibre_heat.yaml", changes_of_runs)
    zero = 310 - KELVIN
    fields: list[HeatField] = [lambda x, t: zero + x[:, 0] ** 2 + 2 * x[:, 0] * x[:, 1]]
    problem.converges([mean_square(solved, fields, zero) for solved in runs])


# Transient conduction


@verify
def test_heat_cylinder(problem: KnownProblem) -> None:
    problem.expects(
        "temperatures of a cooling cylinder, relative in L2",
        tolerance=0.005,
        order=2.0,
        source=CARSLAW.format("7.6"),
    )
    sizes = problem.rungs((2, 1, 0.5, 0.3))
    runs = problem.solve_each("verification/cooling_cylinder.yaml", [slice_of(h) for h in sizes])

    def field(x: Floats, t: float) -> Floats:
        return exact.cooling_cylinder(radius(x), t, 10, CEMENT, 100, 37)

    problem.converges([mean_square(solved, [field], 37.0, (0, 60, 100, 300)) for solved in runs])


@verify
@pytest.mark.parametrize(
    ("conductance", "text"),
    [
        pytest.param(math.inf, "perfect", id="perfect"),
        pytest.param(1.0, "1000.0 W/(m^2 K)", id="resistance", marks=quick),
    ],
)
def test_heat_contact(problem: KnownProblem, conductance: float, text: str) -> None:
    problem.expects(
        "temperatures of two half-spaces in contact, over their range",
        tolerance=0.01,
        source=CARSLAW.format("2.15"),
    )
    solved = problem.solve(
        "verification/half_spaces.yaml", f"interfaces.cement_bone.conductance={text}"
    )
    law = exact.HalfSpaces(CEMENT, BONE, (100, 37), conductance)
    fields: list[HeatField] = [
        lambda x, t: law.temperature(x[:, 2] - 8, t, True),
        lambda x, t: law.temperature(x[:, 2] - 8, t, False),
    ]
    problem.compare(temperatures(solved, fields, 63.0, (0, 10)))


# Heat of friction

RUBBING = "verification/rubbing.yaml"
E_CEMENT = exact.effusivity(CEMENT)
E_BONE = exact.effusivity(BONE)
BY_EFFUSIVITY = E_CEMENT / (E_CEMENT + E_BONE)


@verify
@pytest.mark.parametrize(
    ("what", "share", "changes"),
    [
        pytest.param("shared by effusivity", BY_EFFUSIVITY, (), id="split"),
        pytest.param(
            "shared as given",
            0.7,
            (
                "interfaces.cement_bone.friction_heating=0.7",
                "interfaces.cement_bone.conductance=0 W/(m^2 K)",
            ),
            id="given",
        ),
        pytest.param(
            "perfect contact",
            BY_EFFUSIVITY,
            ("interfaces.cement_bone.conductance=perfect",),
            id="perfect",
        ),
    ],
)
def test_rubbing(problem: KnownProblem, what: str, share: float, changes: Sequence[str]) -> None:
    """Temperatures over the rise of the hotter surface, and the share of heat of the cement."""
    problem.expects(
        f"heat of friction, {what}, relative", tolerance=0.01, source=CARSLAW.format("2.9")
    )
    solved = problem.solve(RUBBING, *changes)
    fields: list[HeatField] = [
        lambda x, t: 37 + exact.heated_half_space(x[:, 2] - 8, t, 75 * share, CEMENT),
        lambda x, t: 37 + exact.heated_half_space(x[:, 2] - 8, t, 75 * (1 - share), BONE),
    ]
    surface = np.array([[0.0, 0.0, 8.0]])
    largest_rise = float(np.max([field(surface, 10) for field in fields])) - 37
    problem.compare(temperatures(solved, fields, largest_rise, (0, 0, 10), since=2.4))


@verify
def test_rubbing_energy(problem: KnownProblem) -> None:
    problem.expects(
        "heat of friction, heat stored over work lost, relative",
        tolerance=1e-6,
        source="conservation of energy",
    )
    solved = problem.solve(RUBBING)
    capacity = np.array([CEMENT[1], BONE[1]])[solved.region - 1]
    rise = (solved.temperature() - 37)[solved.cells[:, :4]].mean(axis=1)
    stored_heat = float((capacity * rise * solved.volumes()).sum())
    dissipation = solved.summary["interfaces"]["cement_bone"]["dissipation"]
    problem.compare(relative(stored_heat, dissipation))


# Heated elastic bodies

LAYERS = "Lamé with free strains (Timoshenko & Goodier, Theory of Elasticity, section 151)"


@verify
def test_hot_fit(problem: KnownProblem) -> None:
    problem.expects(
        "mean pressure of a hot stem in a cooled ring [MPa], relative",
        tolerance=0.005,
        order=2.0,
        source=LAYERS,
    )
    sizes = problem.rungs((1.2, 0.6, 0.3, 0.2))
    runs = problem.solve_each("verification/hot_fit.yaml", [slice_of(h) for h in sizes])
    core = ((200e3, 0.3), 14e-6)
    ring = ((2200.0, 0.3), 10e-6)
    reference = exact.hot_fit_pressure((7, 10), core, ring, 0.4, 0.3, (80, 37, 37))
    problem.converges(
        [
            relative(solved.summary["interfaces"]["stem_cement"]["pressure_mean"], reference)
            for solved in runs
        ]
    )


def cooled_layers(joined: tuple[bool, bool]) -> closed_forms.Layers:
    """Stem, cement that shrinks by 40 K times 80e-6, and bone."""
    materials = ((200e3, 0.3), (2200.0, 0.3), (17e3, 0.3))
    return closed_forms.Layers((6, 10, 15), materials, (0.0, -80e-6 * 40, 0.0), joined)


def layer_stresses(run: Run, joined: tuple[bool, bool]) -> Comparison:
    """Radial and hoop stress of the cement of cooled_layers.yaml at its surfaces [MPa].

    Both stresses are of the form A + B / r², fitted to the cells' means at 6 and 10 mm.
    """
    law = cooled_layers(joined)
    cells = run.region == 2
    scale = abs(law.state_at(1, 6.0)[2])
    x = run.points[run.cells[cells, :4]].mean(axis=1)
    r = np.hypot(x[:, 0], x[:, 1])
    n = x[:, :2] / r[:, None]
    σ = run.stress()[cells][:, :2, :2]
    radial = np.einsum("ci,cij,cj->c", n, σ, n)
    hoop = σ[:, 0, 0] + σ[:, 1, 1] - radial
    weights = np.sqrt(run.volumes()[cells])
    rows = np.column_stack([np.ones(len(r)), r**-2.0]) * weights[:, None]
    comparisons = []
    for k, values in ((1, radial), (2, hoop)):
        A, B = np.linalg.lstsq(rows, values * weights, rcond=None)[0]
        for radius in (6.0, 10.0):
            computed = float(A + B / radius**2)
            reference = float(law.state_at(1, radius)[k])
            comparisons.append(Comparison(abs(computed - reference) / scale, computed, reference))
    return worst(comparisons)


@verify
@quick
def test_layers_bonded(problem: KnownProblem) -> None:
    problem.expects(
        "stresses of a mantle cooled between stem and bone [MPa], over the largest",
        tolerance=0.01,
        source=LAYERS,
    )
    solved = problem.solve("verification/cooled_layers.yaml")
    problem.compare(layer_stresses(solved, joined=(True, True)))


@verify
def test_layers_unilateral(problem: KnownProblem) -> None:
    """Pressure on the stem [MPa] and gap at the bone [mm]."""
    problem.expects(
        "the same without tension; pressure, gap [mm], relative", tolerance=0.01, source=LAYERS
    )
    law = "{kind: contact, friction_coefficient: 0}"
    solved = problem.solve(
        "verification/cooled_layers.yaml",
        f"interfaces.stem_cement={law}",
        f"interfaces.cement_bone={law}",
    )
    joined = (True, False)
    layers = cooled_layers(joined)
    sides = solved.summary["interfaces"]
    problem.compare(
        layer_stresses(solved, joined),
        relative(sides["stem_cement"]["pressure_mean"], -layers.state_at(1, 6.0)[1]),
        relative(sides["cement_bone"]["gap_p99"], layers.gap(1)),
    )


# Conductance that depends on pressure


@verify
@pytest.mark.parametrize(
    ("closed", "changes"),
    [
        pytest.param(False, (), id="open"),
        pytest.param(True, ("regions.cement.thermal.initial_temperature=75 degC",), id="closed"),
    ],
)
def test_walls(problem: KnownProblem, closed: bool, changes: Sequence[str]) -> None:
    """Temperatures over 43 K, and the pressure, in one of the stable states."""
    problem.expects(
        "conductance that depends on pressure: one of two states, relative",
        tolerance=1e-4,
        source="Barber, Dundurs & Comninou, J. Appl. Mech. 47, 1980",
    )
    solved = problem.solve("verification/heated_walls.yaml", *changes)
    state = exact.WALLS.states()[-1 if closed else 0]
    pressure = solved.summary["interfaces"]["metal_cement"]["pressure_mean"]
    error = abs(pressure - state.pressure) / exact.WALLS.states()[-1].pressure
    problem.compare(
        temperatures(solved, between_walls(80, state.first, state.second, 37), 43.0),
        Comparison(error, pressure, state.pressure),
    )


@verify
@pytest.mark.parametrize("field", ["temperature", "displacement"])
def test_wavy(problem: KnownProblem, field: str) -> None:
    problem.expects(
        f"{field} of a manufactured contact, conductance by pressure, relative in L2",
        tolerance=0.005,
        order=2.0,
        source="manufactured: pressure p0 + p1 cos(pi x/L), temperature jump g",
    )
    sizes = problem.rungs((0.125, 0.0833, 0.0625, 0.05))
    changes_of_runs = [(f"mesh.size={h} mm", f"mesh.far_size={h} mm") for h in sizes]
    runs = problem.solve_each("verification/wavy_contact.yaml", changes_of_runs)
    law = exact.WavyContact()
    if field == "temperature":
        temperature: list[HeatField] = [
            lambda x, t: law.temperature(x, False),
            lambda x, t: law.temperature(x, True),
        ]
        problem.converges([mean_square(solved, temperature, 37.0) for solved in runs])
    else:
        displacements = [lambda x: law.displacement(x, False), lambda x: law.displacement(x, True)]
        problem.converges([in_l2(solved, displacements) for solved in runs])


# Stiff cases: heat balance and bounds of temperatures and degrees of cure


def endured(run: Run, low: float, high: float) -> Comparison:
    """Largest violation of the bounds of a stiff case.

    The error is the largest of three numbers: lost heat over all heat that moved; temperatures
    [degC] beyond the bounds over their distance; degrees of cure beyond 0 and 1. ``low`` and
    ``high`` are the bounds of the data. ``high`` is infinite if there is a source of heat.
    """
    summary = run.summary
    regions = summary["thermal"]["regions"].values()
    cured = summary.get("cure", {}).values()
    balance = float(summary["balance"]["heat"])
    span = high - low if math.isfinite(high) else 100.0
    coldest = min(r["temperature_min"] for r in regions)
    hottest = max(r["temperature_max"] for r in regions)
    cures = [a for q in cured for a in (-q["degree_min"], q["degree_max"] - 1)]
    excess = max(0.0, (low - coldest) / span, (hottest - high) / span, *cures)
    solver = summary["solver"]
    steps = f"steps {solver['steps']}, rejected {solver['rejected_steps']}"
    note = f"{steps}, balance {balance:.0e}, {coldest:.2f} to {hottest:.2f} degC"
    return worst(
        [Comparison(abs(balance), balance, 0.0, note), Comparison(excess, hottest, high, note)]
    )


def cures(energy: float = 62866.0, heat: float = 1.55e8, initial: float = 1e-3) -> tuple[str, str]:
    """Overrides for cement that sets, as in exotherm.yaml."""
    rate = f"rate_constant: 2.6397e8 1/s, activation_energy: {energy} J/mol, m: 0.98, n: 1.064"
    kinetics = f"{{kind: autocatalytic, {rate}}}"
    cure = f"{{kinetics: {kinetics}, heat: {heat} J/m^3, initial: {initial}}}"
    thermal = "regions.cement.thermal"
    return f"{thermal}.initial_temperature=23 degC", f"{thermal}.cure={cure}"


def forced(step: float, count: int) -> tuple[str]:
    """Override for steps of one length [s]."""
    stage = f"{{name: forced, duration: {step * count} s, increments: {count}, adaptive: false}}"
    return (f"stages=[{stage}]",)


def conducts(h: float) -> tuple[str, ...]:
    """Overrides for the conductance of both interfaces [W/(m^2 K)]."""
    interface_names = ("stem_cement", "cement_bone")
    return tuple(f"interfaces.{name}.conductance={h} W/(m^2 K)" for name in interface_names)


EULER = "time.method=backward_euler"
THIN = ("geometry.cement_thickness=0.5 mm", "mesh.size=1 mm")
SOURCE = math.inf  # highest temperature of cases with a source of heat
# Overrides and the highest temperature of the data [degC].
STIFF: dict[str, tuple[tuple[str, ...], float]] = {
    "h_0": (conducts(0.0), 100.0),
    "h_1": (conducts(1.0), 100.0),
    "h_1e3": (conducts(1e3), 100.0),
    "h_1e6": (conducts(1e6), 100.0),
    "h_1e9": (conducts(1e9), 100.0),
    "h_1e9_cure": ((*conducts(1e9), *cures()), SOURCE),
    "steps_1ms": (forced(1e-3, 20), 100.0),
    "steps_1s": (forced(1, 20), 100.0),
    "steps_1min": (forced(60, 20), 100.0),
    "steps_1h": (forced(3600, 2), 100.0),
    "steps_1ms_euler": ((*forced(1e-3, 20), EULER), 100.0),
    "steps_1h_euler": ((*forced(3600, 2), EULER), 100.0),
    "steps_1min_cure": ((*forced(60, 60), *cures()), SOURCE),
    "steps_1h_cure": ((*forced(3600, 2), *cures()), SOURCE),
    "seed_1e-6": (cures(initial=1e-6), SOURCE),
    "energy_doubled": (cures(energy=125732.0), SOURCE),
    "exotherm_doubled": (cures(heat=3.1e8), SOURCE),
    "mantle_half_mm": (THIN, 100.0),
    "mantle_half_mm_cure": ((*THIN, *cures()), SOURCE),
    "diffusivity_1e3": (("regions.stem.thermal.conductivity=430 W/(m K)",), 100.0),
}
BOUNDS = "conservation of energy; the maximum principle"


@verify
@stress(group="heat")
@pytest.mark.parametrize("name", STIFF)
def test_stiff(problem: KnownProblem, name: str) -> None:
    problem.expects(
        "heat lost, temperatures beyond the data, degrees beyond 0 and 1",
        tolerance=1e-6,
        source=BOUNDS,
    )
    changes, high = STIFF[name]
    initial_temperature = 23.0 if any("23 degC" in change for change in changes) else 37.0
    problem.compare(
        endured(problem.solve("verification/stiff.yaml", *changes), initial_temperature, high)
    )


def compare_stiff_contact(problem: KnownProblem, high: float, *changes: str) -> None:
    """Solve the case and compare with its bounds."""
    problem.expects(
        "the same as contact opens and closes under 200 K", tolerance=1e-6, source=BOUNDS
    )
    solved = problem.solve("verification/stiff_contact.yaml", *changes)
    problem.compare(endured(solved, -163.0, high))


@verify
@stress(group="heat")
def test_stiff_contact(problem: KnownProblem) -> None:
    compare_stiff_contact(problem, 237.0)


@verify
@stress(group="heat")
def test_stiff_contact_rubbing(problem: KnownProblem) -> None:
    compare_stiff_contact(problem, SOURCE, "interfaces.stem_cement.friction_heating=effusivity")
