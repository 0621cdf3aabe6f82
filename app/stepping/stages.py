"""The outer loop: stages of a scene, by steps of loads, heat or creep, or as bone remodels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

from app.scene.scene import Stage
from app.stepping.creep_steps import CreepStepper
from app.stepping.heat_steps import HeatStepper
from app.stepping.load_steps import LoadStepper

if TYPE_CHECKING:
    from app.stepping.remodelling import Remodeller


def run_stages(
    stages: Sequence[Stage],
    load_stepper: LoadStepper | None,
    heat_stepper: HeatStepper | None,
    creep_stepper: CreepStepper | None = None,
    begin: Callable[[Stage], None] = lambda stage: None,
    checkpoint_point: Callable[[int], None] = lambda k: None,
    first: int = 0,
    remodeller: Remodeller | None = None,
) -> None:
    """Run a model through its stages, from one in which the steppers have been restored.

    Raises:
        ConvergenceError: A failed step cannot or may not be cut, or a body runs away.
    """
    for k, stage in enumerate(stages[first:], first):
        begin(stage)
        if load_stepper is not None:
            load_stepper.problem.set_stage(k, load_stepper.solver.u_and_q()[0])
        timed = heat_stepper if stage.takes_time else load_stepper
        slow = creep_stepper if stage.creep else remodeller if stage.remodels else None
        stepper = slow or timed
        if stepper is not None:
            stepper.run_stage(k, stage, partial(checkpoint_point, k))
