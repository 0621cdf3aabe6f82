"""Log of the steps of a run: a header for each stage, a line for each step."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping

from app.results.interface_numbers import ContactSamples
from app.scene.scene import Stage
from app.stepping.heat_state import HeatStep
from app.stepping.load_steps import LoadStep
from forms.contact import OPEN, SLIP

log = logging.getLogger("mantle")

# Columns of the lines of steps and of heat steps, with their widths.
STEP_COLUMNS = {"step": 4, "time": 7, "newton": 6, "krylov": 6, "residual": 9}
STEP_COLUMNS |= {"open": 6, "slip": 6, "penetration": 12, "elapsed": 9, "left": 9}
HEAT_COLUMNS = {"step": 4, "time": 11, "step of": 10, "newton": 6, "krylov": 6}
HEAT_COLUMNS |= {"hottest": 10, "balance": 9, "elapsed": 9}


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
        columns = HEAT_COLUMNS if stage.takes_time else STEP_COLUMNS
        self._header = _aligned_line(columns, columns)

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
        outcome = step.outcome
        effort = (outcome.iterations, outcome.linear_iterations, f"{outcome.residuals[-1]:.1e}")
        states = (*(f"{100 * fraction:.1f}%" for fraction in fractions), f"{deepest:.1e} mm")
        times = (f"{wall:.1f} s", f"{time_left:.1f} s")
        texts = (step.number, f"{step.time:.4g}", *effort, *states, *times)
        self._log(_aligned_line(STEP_COLUMNS, texts))

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
        hottest = max(v for k, v in row.items() if k.endswith("temperature_max [degC]"))
        outcome = heat_step.outcome
        times = (f"{heat_step.seconds:.4g} s", f"{heat_step.dt:.3g} s")
        state = (f"{hottest:.1f} degC", f"{row['heat balance [-]']:.1e}", f"{wall:.1f} s")
        texts = (number, *times, outcome.iterations, outcome.linear_iterations, *state)
        self._log(_aligned_line(HEAT_COLUMNS, texts))

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


def _aligned_line(columns: Mapping[str, int], texts: Iterable[object]) -> str:
    """Return a line of right-aligned texts, one for each column with its width."""
    return " ".join(f"{t:>{width}}" for t, width in zip(texts, columns.values(), strict=True))
