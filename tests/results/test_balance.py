"""Balances: of forces, with refused results, and of heat, with its integrals."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.results.balance import HeatBalance
from app.results.verdicts import unbalanced
from tests import support
from tests.cases.blocks import WALL
from tests.cases.heated import BAR, CLAMPS, CYLINDERS, Heated, cure, expanding, setting

ORDERS = pytest.mark.parametrize("order", [1, pytest.param(2, marks=pytest.mark.slow)])


def refused(*sums: float) -> list[str]:
    """Sums of force, moment and energy that do not close."""
    return unbalanced({"balance": dict(zip(("force", "moment", "energy"), sums, strict=True))})


def judged(model: Heated) -> list[str]:
    return refused(model.balance.force, model.balance.moment, model.balance.energy)


# A rod on a wall: its end is moved, or pushed at with a gap before the wall or none.
ROD = """
geometry: {kind: blocks, blocks: [{name: wall, size: [3 mm, 3 mm, 3 mm]},
                                  {name: rod, size: [3 mm, 3 mm, 6 mm]}]}
mesh: {order: 1, size: 1.5 mm, far_size: 1.5 mm}
regions:
  wall: {youngs_modulus: 1 GPa, poisson_ratio: 0.3}
  rod: {youngs_modulus: 1 GPa, poisson_ratio: 0.3}
interfaces: {wall_rod: {kind: contact, friction_coefficient: 0.3}}
supports:
  floor: {kind: fixed, boundary: bottom}
  grip: {kind: displacement, boundary: top, x: 0 mm, y: 0 mm, z: -0.01 mm, history: [1, -1]}
stages: [{name: press}, {name: draw}]
"""
ONCE = "stages=[{name: a, increments: 2}]"
TWICE = "stages=[{name: a}, {name: b}]"
OFF = "supports.grip={kind: displacement, boundary: top, x: 0.03 mm, y: -0.02 mm, z: 0.11 mm}"
GRIP = "supports.grip={kind: displacement, boundary: top, x: 0 mm, y: 0 mm}"
GAP = "interfaces.wall_rod.gap=0.05 mm"
WHOLE = "interfaces.wall_rod={kind: bonded}"


def push(size: str, history: str = "[1, 1]") -> str:
    force = f"force: [0 N, 0 N, -{size}], history: {history}"
    return f"loads.push={{kind: force, boundary: top, {force}}}"


RODS = ["rod={rigid: true}", "wall={rigid: true}", "rod.youngs_modulus=1e6 GPa"]
STACKS = [(OFF, ONCE, f"regions.{rod}") for rod in [*RODS, "wall.youngs_modulus=1 Pa"]]
STACKS += [(OFF.replace(" mm", unit), ONCE) for unit in ("e-8 mm", " mm", "e5 mm")]
STACKS += [(OFF, ONCE, WHOLE, OFF.replace("grip", "floor").replace("top", "bottom"))]
STACKS += [("supports.grip.z=0 mm",), ("supports.grip.history=[1, 0]",), ()]
for size in ("1e-12 N", "1 N", "1e6 N"):
    loads = (push(size), push(size, "[1, 1e-18]"))
    STACKS += [(GRIP, TWICE, load, *gap) for load in loads for gap in ((), (GAP,))]
# A stem pressed in and let go: friction holds it, and reactions vanish.
LET_GO = (support.STEM, ("stages=[{name: push}, {name: release}]", "loads.hip.history=[1, 0]"))


@ORDERS
@pytest.mark.parametrize("stack", [LET_GO, *((ROD, changes) for changes in STACKS)])
def test_balance_of_lifted_or_lightly_loaded_bodies(
    stack: tuple[str, tuple[str, ...]], order: int
) -> None:
    text, changes = stack
    solved = support.solve(text, *changes, f"mesh.order={order}", balances=True)
    assert not [row for row in solved.balances if refused(*row)]


def swollen(history: str = "[1, 1]") -> tuple[str, ...]:
    strain = f"{{strain: [2e-3, 2e-3, 2e-3, 0, 0, 0], history: {history}}}"
    return tuple(f"regions.{name}.eigenstrains=[{strain}]" for name in ("one", "two"))


APART = "interfaces.one_two={kind: contact, friction_coefficient: 0}"
TOUCHED = push("1e-12 N")
BARS = [(), (APART,), (TOUCHED,), (APART, TOUCHED), swollen("[50, 1e-12]"), (*swollen(), APART)]


def heated(changes: tuple[str, ...], *rises: float) -> Heated:
    """A bar that may grow freely, before its last step."""
    model = Heated.make(BAR, expanding(one=8e-5, two=8e-5), TWICE, *changes)
    for k, rise in enumerate(rises, 1):
        model.problem.set_time(float(k))
        model.problem.set_temperature({r: model.scalar(300 + rise) for r in ("one", "two")})
        if k < len(rises):
            model.step()
            assert not judged(model)
    return model


@ORDERS
@pytest.mark.parametrize("rises", [(1e-9, 0), (40, 20), (1e3, 0), (-60, 40)])
@pytest.mark.parametrize("changes", BARS)
def test_balance_of_a_growing_bar(
    changes: tuple[str, ...], rises: tuple[float, ...], order: int
) -> None:
    model = heated((*changes, f"mesh.order={order}"), *rises)
    model.step()
    assert not judged(model), (model.balance.force, model.balance.energy)


SMOOTH = "contact, friction_coefficient: 0"
ROUGH = "contact, friction_coefficient: 0.4"
LOOSE = "supports.top.boundary=bottom"


def set_on(stem: str, bone: str, *changes: str) -> Heated:
    """Rings about a rigid core whose cement sets and shrinks by 1.7 %, before the last step."""
    sides = {"stem_cement": stem, "cement_bone": bone}
    changes += tuple(f"interfaces.{name}={{kind: {law}}}" for name, law in sides.items())
    size = ("mesh.size=3 mm", "mesh.far_size=3 mm", "geometry.length=2 mm")
    law = setting(cure("cement", 0.1, gel=0.25))
    model = Heated.make(CYLINDERS, law, *size, "regions.stem={rigid: true}", *changes)
    for k in range(1, 5):
        model.problem.set_time(k / 4)
        model.set(0.1 + 0.225 * k, -0.017 / 3 * (k - 1) / 3, "cement")
        if k < 4:
            model.step()
            assert not judged(model), (k, model.balance.force, model.balance.energy)
    return model


@ORDERS
@pytest.mark.parametrize("ends", [(), (LOOSE,)])
@pytest.mark.parametrize("stem", [SMOOTH, ROUGH, SMOOTH + ", gap: 0.1 mm", "bonded"])
@pytest.mark.parametrize("bone", [SMOOTH, "bonded"])
def test_balance_of_setting_cement(stem: str, bone: str, ends: tuple[str, ...], order: int) -> None:
    curved = f"mesh.curved={str(order == 2).lower()}"
    model = set_on(stem, bone, *ends, f"mesh.order={order}", curved)
    model.step()
    assert not judged(model), (model.balance.force, model.balance.energy)


# Planted faults: each alone, between the last solution and its balances.


def pushed(size: str = "100 N") -> Heated:
    model = Heated.make(ROD, lambda scene: scene, TWICE, GAP, GRIP, push(size))
    model.problem.set_time(1.0)
    return model


def ring(law: str) -> Heated:
    return set_on(law, law, LOOSE, "mesh.order=1", "mesh.curved=false")


def load(model: Heated) -> Any:
    return model.problem.forces._loads[0][1].nodal


PARTS: dict[str, tuple[Callable[[], Heated], Callable[[Any], Any]]] = {
    "load": (pushed, load),
    "weak-load": (lambda: pushed("1e-3 N"), load),
    "load-beside-heat": (lambda: heated((push("1 N"),), 1e3), load),
    "motion": (pushed, lambda m: m.problem.displacements()[1].x.array),
    "contact": (pushed, lambda m: m.problem.contact.state.work),
    "modulus": (pushed, lambda m: m.problem.body_forms._constants["rod"][0][0].value),
    "heat": (
        lambda: heated((CLAMPS,), 40),
        lambda m: m.problem.body_forms.free_strain["one"].x.array,
    ),
    "stress": (lambda: ring(SMOOTH), lambda m: m.problem.stress_history.stress_at_points.x.array),
    "rough-stress": (
        lambda: ring(ROUGH),
        lambda m: m.problem.stress_history.stress_at_points.x.array,
    ),
}
FAULTS = {"lost": 0.0, "turned": -1.0, "off": 1.001, "unknown": np.nan}


@pytest.mark.parametrize("fault", [*FAULTS, "largest-lost"])
@pytest.mark.parametrize("what", PARTS)
def test_balance_detects_a_planted_fault(
    what: str, fault: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    make, part = PARTS[what]
    model = make()
    update = model.balance.update

    def faulty(*state: Any) -> None:
        values = part(model).reshape(-1)
        where = slice(None) if fault in FAULTS else np.abs(values).argmax()
        values[where] *= FAULTS.get(fault, 0.0)
        update(*state)

    monkeypatch.setattr(model.balance, "update", faulty)
    model.step()
    assert judged(model), (model.balance.force, model.balance.energy)


# Heat: one lump that cools by c T' = -k T, by the implicit trapezoidal rule and by backward Euler.
C = 3.0  # heat capacity
K = 0.7  # conductance to the air
STEP = 0.4  # of time


def cool(theta: float, steps: int, leak: float = 0.0) -> HeatBalance:
    T = 10.0
    balance = HeatBalance(C * T, {"air": -K * T})
    for _ in range(steps):
        new = T * (C - (1 - theta) * K * STEP) / (C + theta * K * STEP)
        heats = {"air": -STEP * K * ((1 - theta) * T + theta * new * (1 - leak))}
        balance.update(STEP, heats, {"air": -K * new}, C * new, C * abs(T - new))
        T = new
    return balance


def test_balance_of_heat_by_the_integrator_is_exact() -> None:
    """The other sum is that of the trapezoidal rule. A leak of heat is visible."""
    balance = cool(1.0, 12)
    assert balance.heat < 1e-14
    # Backward Euler's flow is not the trapezoidal one: off by half a step's decay.
    assert balance.quadrature == pytest.approx(K * STEP / C / 2, rel=1e-12)
    balance = cool(0.5, 12)
    assert balance.heat < 1e-14 and balance.quadrature < 1e-14
    assert cool(1.0, 5, leak=1e-3).heat == pytest.approx(1e-3, rel=1e-9)


def test_balance_of_heat_sums_flows_by_condition() -> None:
    balance = HeatBalance(0.0, {})
    for stored in (1.0, 2.0):
        flows = {"cure": 5.0, "air": -3.0}
        heats = {name: 0.5 * flow for name, flow in flows.items()}
        balance.update(0.5, heats, flows, stored, 0.0)
    assert balance.heats == pytest.approx({"cure": 5.0, "air": -3.0})
    assert balance.heat < 1e-14 and balance.quadrature < 1e-14


def test_balance_of_heat_is_relative_to_internal_flow() -> None:
    balance = HeatBalance(100.0, {})
    balance.update(1.0, {}, {}, 100.0 + 1e-9, 50.0)
    assert balance.heat == pytest.approx(2e-11, rel=1e-3)


def test_balance_of_heat_in_steady_states() -> None:
    balance = HeatBalance(10.0, {})
    balance.update(1.0, {"in": 1.0}, {"in": 1.0}, 11.0, 0.0)
    balance.steady({"in": 2.0, "out": -2.0 + 4e-7}, 500.0, 1e-12)
    assert balance.heat == pytest.approx(1e-7, rel=1e-3)
    after = balance.heat
    balance.update(1.0, {"in": 1.0}, {"in": 1.0}, 501.0, 0.0)
    assert balance.heat == after
    balance.update(1.0, {"in": 1.0}, {"in": 1.0}, 502.5, 0.0)
    assert balance.heat == pytest.approx(0.5 / 3)
    assert np.isfinite(balance.quadrature)


def test_balance_of_heat_ignores_rounding() -> None:
    """A model waits for its first heat. After that all of the heat counts."""
    balance = HeatBalance(0.0, {})
    balance.update(1.0, {"friction": 2e-22}, {"friction": 0.0}, 1e-16, 2e-16, 1e-12)
    assert balance.heat == 0
    balance.update(1.0, {"friction": 1.0}, {"friction": 1.0}, 1.0 - 1e-5, 0.0, 1e-12)
    assert balance.heat == pytest.approx(1e-5, rel=1e-6)


@pytest.mark.parametrize("moduli", [None, (1, 2), (2, 1)])
def test_balance_of_heat_flows_through_a_wall(
    moduli: tuple[int, int] | None, tmp_path: Path
) -> None:
    """The heat is 60 K / (L1/k1 + 1/h + L2/k2 + 1/a) on 16 mm2, with either side stiffer."""
    changes = ["supports={base: {kind: fixed, boundary: bottom}}"] if moduli else []
    for region, E in zip(("hot", "cold"), moduli or (), strict=False):
        solid = f"youngs_modulus: {E} GPa, poisson_ratio: 0.3"
        heat = "initial_temperature: 37 degC, density: 1000 kg/m^3, specific_heat: 1000 J/(kg K)"
        k = {"hot": 2, "cold": 0.5}[region]
        changes.append(
            f"regions.{region}={{{solid}, thermal: {{conductivity: {k} W/(m K), {heat}}}}}"
        )
    flows = support.run(WALL, tmp_path, *changes).summary["thermal"]["flows"]
    # In mm, mW and K: conductivities in mW/(mm K), coefficients in mW/(mm2 K).
    milliwatts = 60.0 / (5 / 2.0 + 1 / 0.4 + 3 / 0.5 + 1 / 0.2) * 16.0
    assert flows["into"] == pytest.approx({"stove": milliwatts, "air": -milliwatts}, rel=1e-6)
    assert flows["through"] == pytest.approx({"hot_cold": milliwatts}, rel=1e-6)
