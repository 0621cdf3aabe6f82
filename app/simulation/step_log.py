"""Log of the steps of a run: a header for each stage, a line for each step."""

from __future__ import annotations

import logging

from app.results import closing_lines
from app.results.interface_numbers import ContactSamples
from app.scene.scene import Stage
from app.stepping.heat_state import HeatStep
from app.stepping.load_steps import LoadStep
from forms.contact import OPEN, SLIP

log = logging.getLogger("mantle")


class StepLog:
    """Lines of the log for converged steps.

    Args:
        stage_count: Number of stages of the run; each takes 1 of its time.
    """

    def __init__(self, stage_count: int) -> None:
        self._stage_count = stage_count
        self._header = ""

    def begin_stage(self, stage: Stage) -> None:
        """Begin a stage: a header comes before its first line."""
        columns = closing_lines.HEAT_COLUMNS if stage.takes_time else closing_lines.STEP
        self._header = closing_lines.aligned_line(columns, columns)

    def log_step(
        self, step: LoadStep, samples: ContactSamples | None, wall: float, solve_seconds: float
    ) -> None:
        """Log a step of the mechanics.

        Args:
            step: The step.
            samples: Contact points after the step, if there are any.
            wall: Wall time since the run began [s].
            solve_seconds: Wall time of all solves so far [s]. The time left is estimated from it.
        """
        fractions = area_fraction(samples, OPEN), area_fraction(samples, SLIP)
        interfaces = samples.step_numbers if samples else {}
        deepest = max((q["penetration_max"] for q in interfaces.values()), default=0.0)
        time_left = solve_seconds * ((self._stage_count - step.time) / step.time)
        self._log(closing_lines.step_line(step, fractions, deepest, wall, time_left))

    def log_heat_step(
        self, number: int, heat_step: HeatStep, row: dict[str, float], wall: float
    ) -> None:
        """Log a step of the heat.

        Args:
            number: Number of the step, from 1.
            heat_step: The step.
            row: Numbers of the heat by column title, as in history.csv.
            wall: Wall time since the run began [s].
        """
        self._log(closing_lines.heat_line(number, heat_step, row, wall))

    def _log(self, line: str) -> None:
        if self._header:
            log.info("%s", self._header)
            self._header = ""
        log.info("%s", line)


def area_fraction(samples: ContactSamples | None, status: int) -> float:
    """Fraction of the contact area in a state, OPEN, STICK or SLIP [-]; 0 without contact."""
    if samples is None:
        return 0.0
    return float(samples.weight[samples.status == status].sum() / samples.weight.sum())
