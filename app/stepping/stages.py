"""The outer loop: stages of a scene, by load steps, time steps, or as bone remodels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from app.scene.scene import Stage
from app.stepping.heat_steps import HeatStepper
from app.stepping.load_steps import LoadStepper
from app.stepping.remodelling import Remodeller


def run_stages(
    stages: Sequence[Stage],
    load_stepper: LoadStepper | None,
    heat_stepper: HeatStepper | None,
    begin: Callable[[Stage], None] = lambda stage: None,
    checkpoint_point: Callable[[int], None] = lambda k: None,
    first: int = 0,
    remodeller: Remodeller | None = None,
) -> None:
    """Run a model through its stages, from one in which both steppers have been restored.

    Raises:
        ConvergenceError: A failed step cannot or may not be cut, or a body runs away.
    """
    for k, stage in enumerate(stages[first:], first):
        begin(stage)
        if load_stepper is not None:
            load_stepper.problem.set_stage(k, load_stepper.solver.u_and_q()[0])
        stepper: LoadStepper | HeatStepper | Remodeller | None = load_stepper
        if stage.takes_time:
            stepper = heat_stepper
        elif stage.remodels:
            stepper = remodeller
        if stepper is not None:
            stepper.run_stage(k, stage, partial(checkpoint_point, k))
