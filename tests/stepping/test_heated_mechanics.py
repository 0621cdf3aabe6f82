"""Mechanics with heat: steps by change of temperature and cure, free strain, times of solves."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem, mesh

from app.foundation.arrays import Floats
from app.numerics.newton import NewtonResult
from app.results import verdicts
from app.scene.scene import Stage
from app.stepping.heated_mechanics import SolvedAfterHeat, SolvedWithHeat
from tests import support
from tests.cases import laws
from tests.cases.heated import cure

GEL = 0.5  # degree of cure at gelation
SHRINKAGE = 0.06  # volumetric shrinkage from gelation to full cure
α_T = 8e-5  # thermal expansion [1/K]
RISE = 60.0  # adiabatic temperature rise by cure [K]
COLD = 300.0  # initial temperature [K]
NODES = np.arange(2, 6)  # nodes of the cement
STAGE = Stage(name="setting", duration="10 s", increments=2)
SOLVED = NewtonResult(True, 1, 0, (1e-9,), (0,), linear_failed=False)


class Heat:
    """Heat of a stem (body 0) and of cement (body 1) that cures, with values set by hand.

    Attributes:
        T: Temperatures of all nodes of each body (2, 8) [K].
        a: Degrees of cure at the nodes of the cement (4,).
    """

    def __init__(self, degree: float, mechanical_step: float = 10.0) -> None:
        cube = mesh.create_unit_cube(MPI.COMM_SELF, 1, 1, 1)
        curing = SimpleNamespace(region="cement", body=1, dof=NODES, adiabatic_rise=RISE)
        regions = ("stem", "cement")
        self.operators = SimpleNamespace(
            comm=MPI.COMM_SELF,
            forms=SimpleNamespace(space=fem.functionspace(cube, ("Lagrange", 1)), owned=8),
            bodies=SimpleNamespace(names=regions, body_of_region={"stem": 0, "cement": 1}),
            cure=SimpleNamespace(nodes=[curing]),
            scene=SimpleNamespace(
                expansions=[laws.expansion(region, α_T, COLD) for region in regions],
                cures=[cure("cement", gel=GEL, shrinkage=SHRINKAGE)],
            ),
        )
        self.options = SimpleNamespace(mechanical_step=mechanical_step)
        self.solver = SimpleNamespace(blocks=list)
        self.outcome = SOLVED
        self.seconds = 0.0
        self.T = np.full((2, 8), COLD)
        self.a = np.full(len(NODES), degree)

    def temperatures(self) -> Floats:
        """Temperatures of owned nodes of each body (2, 8) [K]."""
        return self.T

    def degrees(self) -> dict[str, Floats]:
        """Degrees of cure at the nodes of the cement."""
        return {"cement": self.a.copy()}


@dataclass
class Load:
    """Record of the loads that the mechanics get at each solve.

    Attributes:
        paths: Increment, begin and end of each path of loads.
        times: Time of each load.
        temperatures: Temperature of each region at each load (8,) [K].
        degrees: Degrees of cure at the nodes of the cement at each load (4,).
        strains: Free strains at the nodes of the cement at each load (4,).
        begins: Displacements from which the stress history began again.
        commits: Time, and True at the end of an increment, of each committed heat step.
    """

    has_history: bool = True
    paths: list[tuple[float, float, float]] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    temperatures: list[dict[str, Floats]] = field(default_factory=list)
    degrees: list[Floats] = field(default_factory=list)
    strains: list[Floats] = field(default_factory=list)
    begins: list[Any] = field(default_factory=list)
    commits: list[tuple[float, bool]] = field(default_factory=list)

    def __post_init__(self) -> None:
        history = SimpleNamespace(set=self._set_history, begin_at=self.begins.append)
        self.problem = SimpleNamespace(
            set_time=self.times.append,
            set_temperature=self._set_temperature,
            displacements=lambda: "displacements",
            stress_history=history if self.has_history else None,
        )

    def _set_temperature(self, functions: dict[str, fem.Function]) -> None:
        self.temperatures.append({r: f.x.array.copy() for r, f in functions.items()})

    def _set_history(self, degrees: dict[str, Any], strains: dict[str, Any]) -> None:
        self.degrees.append(degrees["cement"].x.array[NODES])
        self.strains.append(strains["cement"].x.array[NODES])

    def run_path(
        self, stage: Stage, increment: float, set_load: Any, begin: float, end: float
    ) -> None:
        """Solve the steps of a path."""
        self.paths.append((increment, begin, end))
        for n in range(round(1 / increment)):
            set_load((n + 1) * increment)

    def commit(
        self, stage: Stage, time: float, outcome: Any, started: float, ends_increment: bool
    ) -> None:
        """Commit a heat step."""
        self.commits.append((time, ends_increment))


def solved_after(heat: Heat, load: Load) -> SolvedAfterHeat:
    """Mechanics after the heat, at the begin of the first stage."""
    mechanics = SolvedAfterHeat(load, heat)  # type: ignore[arg-type]
    mechanics.begin(0, STAGE, is_new=True)
    return mechanics


@pytest.mark.parametrize(
    ("limit", "warming", "cure_change", "steps"),
    [
        (10.0, 25.0, 0.0, 3),
        (10.0, -25.0, 0.0, 3),  # cooling counts as warming
        (10.0, 4.0, 0.4, 3),  # cure counts as its adiabatic rise: 24 K
        (10.0, 25.0, 0.1, 3),  # the larger of both counts
        (0.1, 0.3, 0.0, 3),  # 300.3 K - 300 K exceeds three limits by rounding
        (10.0, 0.0, 0.0, 1),
    ],
)
def test_heated_mechanics_number_of_steps(
    limit: float, warming: float, cure_change: float, steps: int
) -> None:
    """A step changes the temperature, or the adiabatic rise by cure, at most by the limit."""
    heat, load = Heat(0.0, limit), Load()
    mechanics = solved_after(heat, load)
    heat.T[0, 7] += warming
    heat.a[1] += cure_change
    mechanics.after_heat_step(0.5, ends_increment=True)
    assert load.paths == [(1 / steps, 0.0, 0.5)]


def test_heated_mechanics_load_is_linear_between_states() -> None:
    """Each body has the load T = T_0 + s ΔT and a = a_0 + s Δa at times t = s t_1."""
    heat, load = Heat(0.1), Load()
    mechanics = solved_after(heat, load)
    stem_rise, cement_rise = np.linspace(0.0, 40.0, 8), np.linspace(5.0, -10.0, 8)
    cure_rise = np.array([0.0, 0.1, 0.2, 0.3])
    heat.T += np.stack([stem_rise, cement_rise])
    heat.a += cure_rise
    mechanics.after_heat_step(0.5, ends_increment=True)
    fractions = np.arange(1, 5) / 4
    assert load.times == pytest.approx(0.5 * fractions)
    for s, T, a in zip(fractions, load.temperatures[1:], load.degrees[1:], strict=True):
        assert T["stem"] == pytest.approx(COLD + s * stem_rise, rel=1e-14)
        assert T["cement"] == pytest.approx(COLD + s * cement_rise, rel=1e-14)
        assert a == pytest.approx(0.1 + s * cure_rise, rel=1e-14)


def test_heated_mechanics_free_strain_grows_from_gelation_on() -> None:
    """At full cure e = α_T (T - T_gel) - S/3.

    The strain is zero before gelation, then linear in the step. The degree of cure grows from 0 to
    1, so the cement gels in the middle of the step at the mean temperature.
    """
    heat, load = Heat(0.0, mechanical_step=15.0), Load()
    mechanics = solved_after(heat, load)
    heat.T += 40.0
    heat.a += 1.0
    mechanics.after_heat_step(1.0, ends_increment=True)
    final = α_T * 20.0 - SHRINKAGE / 3
    assert [e[0] for e in load.strains] == pytest.approx([0.0, 0.0, 0.0, final / 2, final])
    assert mechanics.strains[0].x.array[NODES] == pytest.approx(final)
    others = np.setdiff1d(np.arange(8), NODES)
    assert not mechanics.strains[0].x.array[others].any()


def test_heated_mechanics_free_strain_adds_up_without_solves() -> None:
    """Heat steps too small for a solve add up to e = α_T ΔT - S/3 Δa / (1 - a_gel) of a solid."""
    heat, load = Heat(0.6, mechanical_step=1e3), Load()
    mechanics = solved_after(heat, load)
    for n, (warming, cure_change) in enumerate([(10.0, 0.1), (30.0, 0.0), (-15.0, 0.3)]):
        heat.T += warming
        heat.a += cure_change
        mechanics.after_heat_step(0.1 * (n + 1), ends_increment=False)
    assert load.paths == []
    expected = α_T * 25.0 - SHRINKAGE / 3 * 0.4 / (1 - GEL)
    assert mechanics.strains[0].x.array[NODES] == pytest.approx(expected)


def test_heated_mechanics_solves_at_increments_and_after_large_changes() -> None:
    """A path begins at the time of the last solve; a change below the limit waits."""
    heat, load = Heat(0.0), Load()
    mechanics = solved_after(heat, load)
    for time, warming, ends_increment in [
        (0.1, 6.0, False),  # 6 K since the last solve: waits
        (0.2, 6.0, False),  # 12 K: solved in two steps
        (0.4, 9.0, False),  # 9 K: waits
        (0.5, 0.0, True),  # end of the increment
        (0.6, -10.0, False),  # the limit itself is large
        (1.0, 0.0, True),
    ]:
        heat.T += warming
        mechanics.after_heat_step(time, ends_increment)
    assert load.paths == [(0.5, 0.0, 0.2), (1.0, 0.2, 0.5), (1.0, 0.5, 0.6), (1.0, 0.6, 1.0)]
    mechanics.begin(1, STAGE, is_new=False)
    assert mechanics.time == 1.0
    heat.T += 50.0  # between the stages, e.g. a steady state
    mechanics.begin(2, STAGE, is_new=True)
    mechanics.after_heat_step(2.5, ends_increment=True)
    assert load.paths[4:] == [(1.0, 2.0, 2.5)]


def test_heated_mechanics_restart_loads_the_state_of_the_last_solve() -> None:
    """The heat of a checkpoint can be ahead of the mechanics."""
    heat, load = Heat(0.6), Load()
    mechanics = solved_after(heat, load)
    heat.T += 20.0
    mechanics.after_heat_step(0.5, ends_increment=True)
    heat.T += 5.0
    mechanics.after_heat_step(0.6, ends_increment=False)
    strain = mechanics.strains[0].x.array.copy()
    mechanics.restored()
    assert load.temperatures[-1]["cement"] == pytest.approx(COLD + 20.0)
    assert load.strains[-1] == pytest.approx(α_T * 20.0)
    assert load.begins == ["displacements"]
    assert np.array_equal(mechanics.strains[0].x.array, strain)
    # The next step is from the restored heat.
    heat.T += 1.0
    mechanics.after_heat_step(1.0, ends_increment=True)
    assert mechanics.strains[0].x.array[NODES] == pytest.approx(α_T * 26.0)


@dataclass
class System:
    """Coupled system that records the seconds over which the heat of friction is reported."""

    reported: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.contact_heat = SimpleNamespace(report=self.reported.append)

    def begin_stage(self, k: int, stage: Stage, start: float) -> None:
        """Begin a stage."""

    def restore(self, blocks: Any) -> None:
        """Restore the last state."""

    def commit(self, blocks: Any) -> None:
        """Commit the state."""


@pytest.mark.parametrize("has_history", [False, True])
def test_heated_mechanics_in_one_system_commits_each_heat_step(has_history: bool) -> None:
    """Regions with a stress history are solved again at the end of the step, at a fixed time."""
    heat, load, system = Heat(0.0), Load(has_history), System()
    heat.seconds = 3.0
    mechanics = SolvedWithHeat(load, heat, system)  # type: ignore[arg-type]
    mechanics.begin(0, STAGE, is_new=True)
    for time, seconds, ends_increment in [(0.2, 5.0, False), (0.5, 8.0, True), (0.5, 8.0, True)]:
        heat.T += 12.0
        heat.seconds = seconds
        mechanics.after_heat_step(time, ends_increment)
        assert mechanics.previous.temperatures[1] == pytest.approx(heat.T[1])
    assert system.reported == [2.0, 3.0, np.inf]
    assert mechanics.stage_start == 3.0
    if has_history:
        assert load.paths == [(0.5, 0.2, 0.2), (0.5, 0.5, 0.5), (0.5, 0.5, 0.5)]
        assert load.commits == []
    else:
        assert load.commits == [(0.2, False), (0.5, True), (0.5, True)]
        assert load.paths == []


# A ring that sets around a frictionless rigid core, all at body temperature.
RING = """
geometry: {kind: cylinders, stem_radius: 7 mm, cement_thickness: 1.5 mm, bone_thickness: 1.5 mm,
           length: 1.5 mm, sector: quarter}
mesh: {size: 1.5 mm, far_size: 1.5 mm, order: 1}
regions:
  stem: {rigid: true, thermal: &heat {conductivity: 0.4 W/(m K), density: 1000 kg/m^3,
    specific_heat: 1500 J/(kg K), initial_temperature: 37 degC}}
  cement: &ring {youngs_modulus: 2200 MPa, poisson_ratio: 0.3}
  bone: *ring
interfaces:
  stem_cement: {kind: contact, friction_coefficient: 0}
  cement_bone: {kind: bonded}
supports:
  core: {kind: fixed, boundary: stem_top}
  symmetry_x: {kind: roller, boundary: symmetry_x, axis: x}
  symmetry_y: {kind: roller, boundary: symmetry_y, axis: y}
  bottom: {kind: roller, boundary: bottom, axis: z}
stages:
  - {name: set, duration: 600 s}
output: {fields: false}
"""
RING_SHRINKAGE = 0.03  # by volume
RING_GEL = 0.4  # degree of cure at gelation
FLOOR = 0.1  # part of the modulus at gelation
POWER = 2.0  # exponent of the modulus
SET = [
    f"""regions.{region}.thermal={{conductivity: 0.4 W/(m K), density: 1000 kg/m^3,
    specific_heat: 1500 J/(kg K), initial_temperature: 37 degC,
    cure: {{kinetics: {{kind: prescribed, rate: [[0 s, 1], [600 s, 1]]}}, heat: 7.5e7 J/m^3,
    initial: 0, gel: {RING_GEL}, floor: {FLOOR}, exponent: {POWER},
    shrinkage: {RING_SHRINKAGE}}}}}"""
    for region in ("cement", "bone")
]
BATH = "heat={bath: {kind: temperature, regions: [stem, cement, bone], temperature: 37 degC}}"
SHRUNK = [
    "stages=[{name: shrink}]",
    "regions.stem={rigid: true}",
    *(f"regions.{r}.eigenstrains=[{{strain: {-RING_SHRINKAGE / 3}}}]" for r in ("cement", "bone")),
]


def solve(folder: Path, *overrides: str) -> Any:
    """The summary of the ring, changed."""
    return support.run(RING, Path(tempfile.mkdtemp(dir=folder)), *overrides).summary


def pressure(summary: Any) -> float:
    return float(summary["interfaces"]["stem_cement"]["pressure_mean"])


def test_heated_mechanics_pressure_of_shrinking_cement(tmp_path: Path) -> None:
    """The pressure is that of the set ring times the mean of its modulus since gelation."""
    exact = pressure(solve(tmp_path, *SHRUNK)) * (FLOOR + (1 - FLOOR) / (POWER + 1))
    errors = []
    for step in (10, 2.5):
        summary = solve(tmp_path, *SET, BATH, f"time={{mechanical_step: {step} K}}")
        errors.append(abs(pressure(summary) / exact - 1))
        assert all(summary["balance"][k] < limit for k, limit in verdicts.BALANCES.items())
    # From gelation to full cure the heat is that of 30 K: some 3 and 12 steps; second order.
    assert errors[-1] < 5e-3
    assert errors[0] / errors[-1] > 8


def test_heated_mechanics_heat_balance_with_rounding(tmp_path: Path) -> None:
    """A cure that begins at 0 has a first step of 1e-7 s, which warms by 1e-8 K."""
    alone = ("interfaces.stem_cement.conductance=0 W/(m^2 K)", "stages.0.duration=1 s")
    summary = support.run(RING, tmp_path, *SET, *alone).summary
    assert summary["balance"]["heat"] < 1e-7
    assert not verdicts.reasons_not_to_use(summary)
