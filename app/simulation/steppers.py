"""Steppers that other packages add for their stages (`case.run_options.StageKind`)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from app.case.run_options import Stage
    from app.stepping.load_steps import LoadStepper
    from app.stepping.stages import StageStepper

# Function that makes the stepper for a `simulation.model.Model`; collective. The model imports this
# module, so its type is not named. The attribute ``saved`` of the stepper names its saved state.
StepperMaker = Callable[[Any, "LoadStepper"], "StageStepper"]
# These functions by key of the stages.
MAKERS: dict[str, StepperMaker] = {}


def add_stepper(key: str, make: StepperMaker) -> None:
    """Register the function that makes the stepper for stages with a key.

    Raises:
        ValueError: The key has a stepper.
    """
    if key in MAKERS:
        raise ValueError(f"stages with '{key}' have a stepper already")
    MAKERS[key] = make


def steppers(
    stages: Iterable[Stage], model: Any, load_stepper: LoadStepper
) -> dict[str, StageStepper]:
    """The steppers that stages need, by key; collective."""
    keys = dict.fromkeys(stage.extension_kind.key for stage in stages if stage.extension_kind)
    return {key: MAKERS[key](model, load_stepper) for key in keys}
