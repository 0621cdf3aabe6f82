"""The loop over steps: try one, cut it back or let the next one grow, commit, save.

A stepper solves steps: of loads, of given fracture energy, of heat, of creep, or those of another
package. The control of a stepper chooses their lengths.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class Step:
    """A step along a path: of loads, of time, or of cycles.

    Attributes:
        begin: Position on the path at which it begins.
        end: Position at which it ends.
        length: Length. Equal steps have exactly equal lengths, unlike ``end - begin``.
        ends_increment: True if it ends an increment of its stage.
    """

    begin: float
    end: float
    length: float
    ends_increment: bool


class Control(Protocol):
    """Control of the lengths of steps."""

    @property
    def finished(self) -> bool:
        """Return True if the path is done."""

    def propose(self) -> Step:
        """Return the next step to try."""

    def judge(self, step: Step, error: float) -> bool:
        """Choose the length of the next step; return True if this one is accepted.

        ``error`` is the error over its tolerance, or a number of iterations. It is infinite if the
        step was not solved.
        """


class Stepper(Protocol):
    """Solution of steps along a path."""

    def try_step(self, step: Step) -> float:
        """Solve a step without commit; return its error, infinite if not solved; collective."""

    def refuse(self, step: Step) -> None:
        """Go back to the beginning of a step that was not accepted; collective.

        Raises:
            ConvergenceError: The step may not be shorter.
        """

    def commit(self, step: Step, started: float) -> None:
        """Commit the step last tried, which began at a wall time; collective."""


def advance(
    stepper: Stepper, control: Control, checkpoint_point: Callable[[], None] = lambda: None
) -> None:
    """Take steps to the end of a path.

    ``checkpoint_point`` is called wherever the state may be saved.

    Raises:
        ConvergenceError: A step fails and may not be shorter, or a body runs away.
    """
    while not control.finished:
        started = clock.perf_counter()
        step = control.propose()
        while not control.judge(step, stepper.try_step(step)):
            stepper.refuse(step)
            if control.finished:
                return
            step = control.propose()
        stepper.commit(step, started)
        checkpoint_point()


@dataclass
class Progress:
    """Progress along a path from 0 to 1 that consists of increments.

    Attributes:
        step: Length of the next step, as a fraction of the path; 0 before the path begins.
        done: Completed fraction of the path.
        cuts: Number of halvings of the step less the number of later increases.
    """

    step: float = 0.0
    done: float = 0.0
    cuts: int = 0

    def next(self, increment: float) -> Step:
        """Return the next step; it does not exceed the end of the current increment.

        It reaches this end if less than a thousandth of a step would be left.

        Args:
            increment: Length of an increment, as a fraction of the path.
        """
        goal = (math.floor(self.done / increment + 1e-9) + 1) * increment
        if goal > 1.0 - 1e-9:
            goal = 1.0
        end = goal if self.done + 1.001 * self.step > goal else self.done + self.step
        return Step(self.done, end, end - self.done, end == goal)


@dataclass(frozen=True)
class Growth:
    """Factor from the length of a step to that of the next, by its error over the tolerance.

    Attributes:
        safety: Factor on the length that the tolerance allows for an error of second order.
        smallest: Smallest factor.
        largest: Largest factor.
        after_failure: Factor after a step that was not solved.
    """

    safety: float
    smallest: float
    largest: float
    after_failure: float

    def factor(self, error: float) -> float:
        """Return the factor."""
        if math.isinf(error):
            return self.after_failure
        if error == 0.0:
            return self.largest
        return min(max(self.safety / math.sqrt(error), self.smallest), self.largest)


class FixedSteps:
    """Steps of given lengths, none of which may be shorter.

    Args:
        steps: The steps.
        completed: Number of steps that are done.
    """

    def __init__(self, steps: Sequence[Step], completed: int) -> None:
        self._remaining = list(steps[completed:])

    @property
    def finished(self) -> bool:
        """Return True if all steps are done."""
        return not self._remaining

    def propose(self) -> Step:
        """Return the next step."""
        return self._remaining[0]

    def judge(self, step: Step, error: float) -> bool:
        """Accept every step that was solved."""
        if math.isinf(error):
            return False
        self._remaining.pop(0)
        return True
