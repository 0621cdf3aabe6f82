"""Heat and contact that depend on each other, as one system."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

from petsc4py import PETSc

import numpy as np
import pytest

from app.campaigns.work_precision import fitted_order
from tests.cases import coupled
from tests.support import difference

# States of a point.
OPEN = 0
STICK = 1
SLIP = 2
# Of these units, of which rounding leaves LITTLE in the remainder.
SIZES = {"temperature": 1.0, "temperature_jump": 1.0, "displacement": 1e-5, "jump": 1e-5}
STEPS = (1e-1, 1e-2)
LITTLE = 1e-5
HEAT = ("temperature", "temperature_jump")
MOTION = ("displacement", "jump")

INTERFACE = "interfaces.lower_upper"
PRESSED = "conductance: {kind: pressure, open: 50 W/(m^2 K), per_pressure: 400 W/(m^2 K MPa)}"
CONTACT = "kind: contact, friction_coefficient: 0.3"
COLD = f"{INTERFACE}={{{CONTACT}, {PRESSED}}}"
PENALTY = (
    f"{INTERFACE}={{kind: penalty, friction_coefficient: 0.3, penalty: 800 MPa/mm, {PRESSED}, "
    "friction_heating: 0.3}"
)
PERFECT = f"{INTERFACE}={{kind: contact, friction_coefficient: 0.6, friction_heating: 0.3}}"
CAPPED = f"{INTERFACE}.conductance.cap=600 W/(m^2 K)"
STIFF = [f"regions.{r}.thermal.thermal_expansion=null" for r in ("lower", "upper")]
# Heat that does not depend on contact.
ONE_WAY = f"{INTERFACE}={{{CONTACT}, conductance: 500 W/(m^2 K)}}"


@pytest.mark.parametrize(
    "overrides",
    [[], ["mesh.order=2"], [COLD], STIFF, [PERFECT], [PENALTY], [CAPPED]],
    ids=["all", "P2", "no heat of friction", "no expansion", "perfect", "penalty", "capped"],
)
def test_coupled_system_taylor_remainder_is_of_second_order(
    monkeypatch: pytest.MonkeyPatch, overrides: list[str]
) -> None:
    """All blocks are tested, off a solution with points that are open, stick and slip."""
    c = coupled.solve(monkeypatch, *overrides)
    solver, problem = c.solver, c.model.mechanics.problem
    operators, j = c.model.thermal.operators, problem.contact
    held = [
        operators.fixed.base_condition >= 0,
        *([operators.jumps.prescribed] if operators.jumps else []),
        problem.stiffness.constraints.constrained,
        j.points.is_prescribed[j.local.rows].ravel(),
    ]
    free = dict(zip(solver.blocks_by_name(), map(np.logical_not, held), strict=True))
    rng = np.random.default_rng(1)

    def some(*names: str) -> PETSc.Vec:
        v = solver.vector()
        for name in names:
            part = solver.blocks_by_name(v)[name]
            part.array[:] = SIZES[name] * free[name] * rng.standard_normal(part.array.size)
        return v

    x, J = solver.x, solver.snes.getJacobian()[0]
    # Off the last state, which is its history: nothing slips there.
    x.axpy(3.0, some(*free))
    assert set(map(int, problem.trial(*solver.u_and_q()).forces.status)) == {OPEN, STICK, SLIP}
    base, moved, linear, there = (solver.vector() for _ in range(4))
    solver.snes.computeFunction(x, base)
    solver.snes.computeJacobian(x, J)
    blocks = set()
    for column in free:
        step = some(column)
        J.mult(step, linear)
        remainders = []
        for ε in STEPS:
            x.copy(there)
            there.axpy(ε, step)
            solver.snes.computeFunction(there, moved)
            moved.axpy(-1.0, base)
            moved.axpy(-ε, linear)
            remainders.append([v.norm() / ε for v in solver.blocks(moved)])
        for row, part, (first, second) in zip(
            free, solver.blocks(linear), np.transpose(remainders), strict=True
        ):
            size = part.norm()
            # Of second order: relative to the linear part it falls with the step.
            assert second <= max(0.2 * first, LITTLE * size), (row, column, first, second, size)
            assert first <= 0.1 * size, (row, column)
            blocks |= {(row, column)} if size else set()
    # What is in the scene is in the Jacobian.
    heat = [name for name in HEAT if name in free]
    expected = set(product(heat, heat)) | set(product(MOTION, MOTION))
    if overrides is not STIFF:
        expected |= set(product(MOTION, heat))
    if overrides != [COLD]:
        expected |= set(product(["temperature"], MOTION))
    if overrides != [PERFECT]:
        expected |= set(product(["temperature_jump"], MOTION))
    assert blocks == expected


@pytest.mark.parametrize("method", ["backward_euler", "sdirk4"])
def test_coupled_system_equals_one_way_coupling(
    monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    """Mechanics that follow the heat step by step equal one system of both."""
    steps = (f"time.method={method}", "time.mechanical_step=1000 K")
    one = coupled.solve(monkeypatch, *steps, ONE_WAY)
    assert not one.model.scene.coupled
    couple = lambda scene: replace(scene, coupled=True)  # noqa: E731
    together = coupled.solve(monkeypatch, *steps, ONE_WAY, change=couple)
    assert set(one.solver.block_sizes) == set(HEAT)
    assert set(together.solver.block_sizes) == {*HEAT, *MOTION}
    a, b = one.state(), together.state()
    assert a.keys() == b.keys()
    for name, values in a.items():
        assert difference(b[name], values) <= 1e-8, name


@pytest.mark.parametrize("method", ["backward_euler", "sdirk4"])
@pytest.mark.parametrize("overrides", [[], [PENALTY]], ids=["multiplier", "penalty"])
def test_coupled_system_friction_heat_equals_dissipation(
    monkeypatch: pytest.MonkeyPatch, overrides: list[str], method: str
) -> None:
    """The equality holds step by step, to the tolerance of the equations. The balance closes."""
    c = coupled.solve(monkeypatch, *overrides, f"time.method={method}", "solver.tolerance=1e-12")
    before = c.before
    for accepted, dissipated in zip(c.steps, c.dissipated, strict=True):
        heat = accepted.heats["friction lower_upper"]
        assert heat > 1e-3
        assert heat == pytest.approx(dissipated - before, rel=1e-8)
        before = dissipated
    thermal = c.model.thermal
    balance = thermal.balance
    assert balance.heats["friction lower_upper"] == pytest.approx(before - c.before, rel=1e-8)
    assert balance.heat < 1e-11
    assert thermal.record.summary()["interfaces"]["lower_upper"]["entropy_production_min"] > -1e-15


# Pressed and slid in proportion, from nothing, by blocks that temperature does not change.
TOGETHER = (
    "supports.press={kind: displacement, boundary: top, z: -0.005 mm}",
    "supports.slide={kind: displacement, boundary: top, x: 0.03 mm, y: 0 mm}",
    *STIFF,
)


def together(monkeypatch: pytest.MonkeyPatch, steps: int, *overrides: str) -> coupled.Coupled:
    """Solve the coupled case in equal steps."""
    stage = f"stages=[{{name: slide, duration: 2 s, increments: {steps}, adaptive: false}}]"
    return coupled.solve(monkeypatch, *TOGETHER, stage, "solver.tolerance=1e-12", *overrides)


@pytest.mark.parametrize("method", ["backward_euler", "sdirk4"])
def test_coupled_system_friction_heat_of_growing_force_and_slip(
    monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    """Force F t and slip s t grow from t = 0 to 1.

    With n implicit steps the heat is F s (n + 1)/(2 n), of order 1.
    """
    counts, heats = (1, 2, 4, 8), []
    for n in counts:
        c = together(monkeypatch, n, f"time.method={method}")
        j = c.model.mechanics.problem.contact
        h = j.state
        whole = float(j.local.weight @ np.einsum("pi,pi->p", h.friction, h.jump))
        heats.append(sum(step.heats["friction lower_upper"] for step in c.steps))
        assert heats[-1] == pytest.approx(whole * (n + 1) / (2 * n), rel=1e-8)
    errors = [heat - whole / 2 for heat in heats]
    assert fitted_order([1 / n for n in counts], errors) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("method", ["backward_euler", "sdirk4"])
def test_coupled_system_penalty_stretch_is_no_heat(
    monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    """A penalty holds the points, so there is no heat of friction.

    Its stretch taken for slip would give A τ s (n + 1)/(2 n) in n increments.
    """
    law = PENALTY.replace("friction_coefficient: 0.3", "friction_coefficient: 5")
    little = "supports.slide={kind: displacement, boundary: top, x: 0.003 mm, y: 0 mm}"
    c = together(monkeypatch, 2, f"time.method={method}", law, little)
    j = c.model.mechanics.problem.contact
    h = j.state
    assert float(j.local.weight @ np.einsum("pi,pi->p", h.friction, h.jump)) > 1e-3
    assert c.dissipated == (0.0, 0.0)
    assert [step.heats["friction lower_upper"] for step in c.steps] == [0.0, 0.0]


@pytest.mark.parametrize("perfect", [False, True], ids=["conductance", "perfect"])
def test_coupled_system_insulated_bodies_keep_friction_heat(
    monkeypatch: pytest.MonkeyPatch, perfect: bool
) -> None:
    """The bodies have one temperature and no cooling, so friction alone warms them.

    Each side has its share.
    """
    share = 0.3
    law = "" if perfect else "conductance: 0 W/(m^2 K), "
    c = coupled.solve(
        monkeypatch,
        f"{INTERFACE}={{{CONTACT}, {law}friction_heating: {share}}}",
        "heat={}",
        "regions.upper.thermal.initial_temperature=37 degC",
        "solver.tolerance=1e-12",
    )
    heating = c.model.thermal.heating
    operators = heating.operators
    released = c.dissipated[-1] - c.before
    warmed = [
        float((m * (T - 310.15)).sum())
        for m, T in zip(operators.capacity, operators.nodal(heating.vectors()), strict=True)
    ]
    assert released > 0.01
    assert sum(warmed) == pytest.approx(released, rel=1e-8)
    if not perfect:
        # The first side is the lower block.
        lower = warmed[operators.bodies.body_of_region["lower"]]
        assert lower == pytest.approx(share * released, rel=1e-8)


def test_coupled_system_cured_cement_equals_an_elastic_solid(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Cement that has set already deforms like any solid, so both laws give the same state."""
    law = f"{INTERFACE}={{{CONTACT}, conductance: 500 W/(m^2 K), friction_heating: 0.3}}"
    rigid = "regions.lower.thermal.thermal_expansion=null"
    one_sided = (rigid, law, "heat.wall.temperature=60 degC", "time.mechanical_step=1000 K")
    clock = "{kind: prescribed, rate: [[100 s, 1], [200 s, 1]]}"
    cement = (
        f"regions.upper.thermal.cure={{kinetics: {clock}, heat: 1e6 J/m^3, initial: 0.999999, "
        "gel: 0.5, shrinkage: 0}"
    )
    runs = [coupled.solve(monkeypatch, *one_sided, *change) for change in ((), (cement,))]
    solid, hardened = (run.model.mechanics.solver.blocks_by_name() for run in runs)
    for name in MOTION:
        size = np.abs(solid[name].array).max()
        assert np.abs(solid[name].array - hardened[name].array).max() <= 1e-4 * size, name


def test_coupled_system_setting_cement_is_one_step_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stiffness and free strain of a step follow its heat, with an error of order 1.

    The error is in the motion, and in the heat of friction over its dissipation.
    """
    kinetics = "{kind: prescribed, rate: [[0 s, 1], [3 s, 1]]}"
    cement = (
        f"regions.upper.thermal.cure={{kinetics: {kinetics}, heat: 2e7 J/m^3, initial: 0.3, "
        "gel: 0.4, shrinkage: 0.01}"
    )
    counts, motion, heat = (4, 8, 16), [], []
    for n in counts:
        changes = (cement, f"stages.1.increments={n}", "time.mechanical_step=1000 K")
        c = coupled.solve(monkeypatch, *changes)
        kept = c.model.mechanics.solver.blocks_by_name()["displacement"].array
        seen = c.solver.blocks_by_name()["displacement"].array
        motion.append(float(np.abs(seen - kept).max() / np.abs(kept).max()))
        dissipated = c.dissipated[-1] - c.before
        heats = sum(step.heats["friction lower_upper"] for step in c.steps)
        heat.append(abs(heats / dissipated - 1))
    steps = [1 / n for n in counts]
    assert motion[0] < 0.05 and heat[-1] < 0.3
    assert fitted_order(steps, motion) == pytest.approx(1.0, abs=0.05), motion
    assert fitted_order(steps, heat) > 0.9, heat
