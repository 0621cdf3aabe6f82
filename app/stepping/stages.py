"""A scene on a mesh, ready to be solved, and the loop over its stages.

`assemble` makes the discrete problem, its solver and the heat of a scene; `Analysis.run` solves all
stages. Runs of a case and Python scripts both use them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol

from app.heat.implicit_step import ImplicitStep
from app.heat.operators import HeatOperators
from app.laws.interface_laws import DEFAULT_AUGMENTATION
from app.mechanics.predictors import Predictor
from app.mechanics.problem import Problem
from app.mechanics.systems import mechanical_system
from app.numerics.newton import Solver
from app.numerics.preconditioners import Options
from app.numerics.system import System
from app.scene.scene import Scene, Stage
from app.stepping.coupled_system import CoupledSystem
from app.stepping.creep_steps import CreepStepper
from app.stepping.heat_state import HeatState
from app.stepping.heat_steps import HeatStepper, OnHeat
from app.stepping.heated_mechanics import SolvedAfterHeat, SolvedWithHeat
from app.stepping.load_steps import Effort, LoadStepper, OnStep
from app.system.timing import Timing
from meshes.distribute import TaggedMesh


class StageStepper(Protocol):
    """Stepper of a stage."""

    def run_stage(self, k: int, stage: Stage, checkpoint_point: Callable[[], None]) -> None:
        """Step through stage k, or the rest of it after a restart; collective."""


def _ignore(*_: Any) -> None:
    """Ignore the arguments."""


@dataclass
class Steppers:
    """Steppers of an analysis.

    Attributes:
        load: Stepper of loads, if there is mechanics.
        heat: Stepper of heat, if regions conduct.
        creep: Stepper of creep, if regions creep.
        extension_steppers: Steppers of other packages by the key of their stages
            (`Stage.extension_kind`).
    """

    load: LoadStepper | None
    heat: HeatStepper | None
    creep: CreepStepper | None
    extension_steppers: Mapping[str, StageStepper] = field(default_factory=dict)

    def run(
        self,
        stages: Sequence[Stage],
        before_stage: Callable[[Stage], None] = _ignore,
        checkpoint_point: Callable[[int], None] = _ignore,
        first: int = 0,
    ) -> Effort:
        """Solve stages, from the first or a restored one on; collective.

        Args:
            stages: All stages.
            before_stage: Called before each stage.
            checkpoint_point: Called with the number of the stage wherever the state may be saved.
            first: Number of the first stage to solve.

        Returns:
            The number of steps and iterations.

        Raises:
            ConvergenceError: A step failed and could not be cut further, or a body floats away.
        """
        for k, stage in enumerate(stages[first:], first):
            before_stage(stage)
            if self.load is not None:
                self.load.problem.set_stage(k, self.load.solver.u_and_q()[0])
            stepper = self._stepper_of(stage)
            if stepper is not None:
                stepper.run_stage(k, stage, partial(checkpoint_point, k))
        total = Effort()
        for stepper_with_counts in (self.load, self.heat):
            if stepper_with_counts is not None:
                total.add(stepper_with_counts.total)
        return total

    def _stepper_of(self, stage: Stage) -> StageStepper | None:
        if stage.extension_kind and self.extension_steppers:
            return self.extension_steppers[stage.extension_kind.key]
        if stage.creep and self.creep is not None:
            return self.creep
        return self.heat if stage.takes_time else self.load


@dataclass
class Analysis:
    """A scene on a mesh, ready to be solved.

    Attributes:
        scene: The scene.
        problem: The mechanical problem, if a region deforms.
        solver: Solver of the problem.
        heating: Heat with its solver, if regions conduct.
    """

    scene: Scene
    problem: Problem | None
    solver: Solver | None
    heating: HeatState | None

    def load_stepper(
        self,
        on_step: OnStep = _ignore,
        on_trouble: Callable[[str], None] = _ignore,
        predictors: tuple[Predictor, ...] = (),
    ) -> LoadStepper | None:
        """Make a stepper of loads; None without mechanics. Arguments: see `steppers`."""
        if self.problem is None or self.solver is None:
            return None
        return LoadStepper(self.problem, self.solver, on_step, on_trouble, predictors)

    def steppers(
        self,
        on_step: OnStep = _ignore,
        on_heat: OnHeat = _ignore,
        on_trouble: Callable[[str], None] = _ignore,
        predictors: tuple[Predictor, ...] = (),
    ) -> Steppers:
        """Make the steppers; collective.

        Args:
            on_step: Called after each step of the mechanics, with its contact.
            on_heat: Called after each step of the heat and of its mechanics.
            on_trouble: Called with the remedy tried when a step fails.
            predictors: Predictors in addition to extrapolation.
        """
        load = self.load_stepper(on_step, on_trouble, predictors)
        creep = CreepStepper(load) if load is not None and load.problem.creep else None
        heat = None
        heating = self.heating
        if heating is not None:
            mechanics: SolvedAfterHeat | SolvedWithHeat | None = None
            if load is not None and heating.coupled:
                mechanics = SolvedWithHeat(load, heating, heating.coupled)
            elif load is not None:
                mechanics = SolvedAfterHeat(load, heating)
            heat = HeatStepper(heating, mechanics, on_heat)
        return Steppers(load, heat, creep)

    def run(
        self,
        on_step: OnStep = _ignore,
        on_heat: OnHeat = _ignore,
        on_trouble: Callable[[str], None] = _ignore,
    ) -> Effort:
        """Solve all stages; collective. Arguments: see `steppers`.

        Raises:
            ConvergenceError: As `Steppers.run`.
        """
        return self.steppers(on_step, on_heat, on_trouble).run(self.scene.stages)


@dataclass(frozen=True)
class SolverSettings:
    """Settings of the solvers of an analysis.

    Attributes:
        tolerance: Residual over the scale of the forces at which a step has converged.
        max_iterations: Largest number of Newton iterations in a step.
        linear: Linear solver: auto, direct, multigrid or condensed.
        petsc: Raw PETSc options.
        augmentation_factor: Ratio of the default augmentation to the softest stiffness [-].
        solves: Expected number of contact solves, by which `auto` chooses; 0 never condenses.
        memory: Memory of a rank [byte], by which `auto` chooses.
        stop: Returns the name of a pending stop signal, or "".
    """

    tolerance: float = 1e-10
    max_iterations: int = 40
    linear: str = "auto"
    petsc: Options = field(default_factory=dict)
    augmentation_factor: float = DEFAULT_AUGMENTATION
    solves: float = 1.0
    memory: float = math.inf
    stop: Callable[[], str] = str  # str() is the empty string: no signal


def assemble(
    scene: Scene,
    tagged: TaggedMesh,
    settings: SolverSettings | None = None,
    timing: Timing | None = None,
    reuse: Analysis | None = None,
    same_stiffness: Problem | None = None,
) -> Analysis:
    """Make the problem of a scene on a mesh, its solver and its heat, all at rest; collective.

    Args:
        scene: Bodies, interfaces, loads and stages (`scene.scene.scene_of`).
        tagged: Mesh with its names (`TaggedMesh.from_tags`).
        settings: Settings of the solvers.
        timing: Seconds by phase.
        reuse: Analysis whose mechanics differs in loads and laws alone. Its problem and solver are
            reset and used.
        same_stiffness: Problem with the same constant stiffness, whose inverse is shared.

    Raises:
        InputError: The scene does not fit the mesh.
    """
    settings = settings or SolverSettings()
    timing = timing or Timing()

    def solver_of(system: System) -> Solver:
        limits = settings.tolerance, settings.max_iterations
        return Solver(system, *limits, settings.linear, settings.petsc, timing, settings.stop)

    problem, solver, heating = None, None, None
    if reuse is not None and reuse.problem is not None and reuse.solver is not None:
        problem, solver = reuse.problem, reuse.solver
        problem.begin(scene, settings.augmentation_factor)
        solver.begin(settings.tolerance)
    elif scene.elastic:
        problem = Problem(scene, tagged, settings.augmentation_factor, timing, same_stiffness)
        solver = solver_of(mechanical_system(problem, settings.solves, settings.memory))
    if scene.conductors:
        step = ImplicitStep(HeatOperators(scene, tagged, timing))
        coupled = None
        if scene.coupled and problem is not None and solver is not None:
            coupled = CoupledSystem(scene, step, problem, solver.blocks())
        heating = HeatState(scene, step, solver_of(coupled or step), coupled)
    return Analysis(scene, problem, solver, heating)
