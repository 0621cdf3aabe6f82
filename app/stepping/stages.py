"""The outer loop: stages of a scene, by steps of loads, heat, creep or of another package."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Protocol

from app.scene.scene import Stage
from app.stepping.creep_steps import CreepStepper
from app.stepping.heat_steps import HeatStepper
from app.stepping.load_steps import LoadStepper


class StageStepper(Protocol):
    """Stepper of a stage."""

    def run_stage(self, k: int, stage: Stage, checkpoint_point: Callable[[], None]) -> None:
        """Step through stage k, which may have been begun before a restart; collective."""


def run_stages(
    stages: Sequence[Stage],
    load_stepper: LoadStepper | None,
    heat_stepper: HeatStepper | None,
    creep_stepper: CreepStepper | None = None,
    begin: Callable[[Stage], None] = lambda stage: None,
    checkpoint_point: Callable[[int], None] = lambda k: None,
    first: int = 0,
    others: Mapping[str, StageStepper] | None = None,
) -> None:
    """Run a model through its stages, from one in which the steppers have been restored.

    ``others`` are the steppers of other packages by the key of their stages (`Stage.other`).

    Raises:
        ConvergenceError: A failed step cannot or may not be cut, or a body runs away.
    """
    for k, stage in enumerate(stages[first:], first):
        begin(stage)
        if load_stepper is not None:
            load_stepper.problem.set_stage(k, load_stepper.solver.u_and_q()[0])
        stepper: StageStepper | None = heat_stepper if stage.takes_time else load_stepper
        if stage.creep:
            stepper = creep_stepper or stepper
        if stage.other and others:
            stepper = others[stage.other.key]
        if stepper is not None:
            stepper.run_stage(k, stage, partial(checkpoint_point, k))
