"""Heat and contact that depend on each other, solved by the model of the application."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import pytest

from app.foundation.arrays import Floats
from app.mechanics.contact import TrialState
from app.numerics.newton import Solver
from app.scene.scene import Scene, build_scene
from app.simulation import model
from app.simulation.model import Model
from app.stepping.heat_state import HeatStep
from app.stepping.load_steps import LoadStep
from app.system.timing import Timing
from tests import support

# A hot block tilts and rubs on a cold one: points are open, stick and slip, and heat goes through
# where they are pressed.
CASE = (
    support.TWO_BLOCKS
    + support.LOWER
    + """\
  upper:
    youngs_modulus: 2000 MPa
    poisson_ratio: 0.3
    thermal: {conductivity: 0.3 W/(m K), density: 1200 kg/m^3, specific_heat: 1500 J/(kg K),
      initial_temperature: 80 degC, thermal_expansion: 80e-6 1/K}
interfaces:
  lower_upper:
    kind: contact
    friction_coefficient: 0.3
    conductance: {kind: pressure, open: 50 W/(m^2 K), per_pressure: 400 W/(m^2 K MPa)}
    friction_heating: effusivity
heat:
  wall: {kind: temperature, boundary: lower_y_min, temperature: 37 degC}
  air: {kind: convection, boundary: upper_x_max, coefficient: 200 W/(m^2 K), ambient: 20 degC}
supports:
  floor: {kind: fixed, boundary: bottom}
  press: {kind: displacement, boundary: top, z: "-0.005 + 0.006 * x / 6", history: [1, 1]}
  slide: {kind: displacement, boundary: top, x: "0.03 + 0.02 * y / 4", y: 0 mm, history: [0, 1]}
stages:
  - {name: press, adaptive: false}
  - {name: slide, duration: 2 s, increments: 4, adaptive: false}
time: {method: backward_euler, tolerance: 0.1 K}
solver: {tolerance: 1.0e-10}
"""
)


@dataclass(frozen=True)
class Coupled:
    """A solved case of heat and mechanics.

    Attributes:
        model: The model, in its last state.
        steps: Its heat steps.
        rows: Reported temperatures at the start and after each of them.
        before: Dissipated by friction before the first of them, over all interfaces [N mm].
        dissipated: Up to the end of each of them.
    """

    model: Model
    steps: tuple[HeatStep, ...]
    rows: tuple[dict[str, float], ...]
    before: float
    dissipated: tuple[float, ...]

    @property
    def solver(self) -> Solver:
        """Solver of heat and mechanics, or of heat alone."""
        solver = self.model.thermal.heating.solver
        assert isinstance(solver, Solver)
        return solver

    def state(self) -> dict[str, Floats]:
        """Blocks of unknowns of the last state."""
        blocks = dict(self.model.mechanics.solver.blocks_by_name())
        blocks |= self.model.thermal.heating.solver.blocks_by_name()
        return {name: v.array.copy() for name, v in blocks.items()}


def solve(
    monkeypatch: pytest.MonkeyPatch,
    *overrides: str,
    text: str = CASE,
    change: Callable[[Scene], Scene] = lambda old: old,
) -> Coupled:
    """Solve a case.

    Args:
        monkeypatch: What undoes the change.
        overrides: ``key.path=value``.
        text: The case.
        change: Changes its scene before it is solved.
    """
    with monkeypatch.context() as patch:
        patch.setattr(model, "build_scene", lambda case: change(build_scene(case)))
        case = support.case(text, *overrides)
        made = Model(case, support.MPI.COMM_WORLD, {}, Timing(), str)
    steps: list[HeatStep] = []
    rows = [made.thermal.record.row]
    dissipated: list[float] = []
    before = [0.0]

    def so_far() -> float:
        jumps = [made.mechanics.problem.contact] if made.mechanics else []
        return sum(float(j.state.dissipation.sum()) for j in jumps)

    def on_heat(step: LoadStep, accepted: HeatStep) -> None:
        steps.append(accepted)
        rows.append(made.thermal.record.row)
        dissipated.append(so_far())

    def on_step(step: LoadStep, trial: TrialState | None) -> None:
        if not steps and step.stage == made.scene.stages[0].name:
            before[0] = so_far()

    made.run(on_step, on_heat, print)
    return Coupled(made, tuple(steps), tuple(rows), before[0], tuple(dissipated))
