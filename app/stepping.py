"""Load steps: through the stages, cutting back where a step does not converge.

A step is committed only when it has converged. When it has not, the augmentation of the
augmented-Lagrangian interfaces is lowered first (it changes the path of the iteration, not the
answer), then the step is halved; an easy step lets a shortened one grow back to the increments the
stage asks for.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass

from app.diagnosis import explain, runaway
from app.errors import ConvergenceError
from app.problem import Problem, Trial
from app.solver import Outcome, Solver
from app.terms import Stage

# Augmentation tried in turn, as multiples of the default.
AUGMENTATIONS = (1.0, 0.1, 0.01)
EASY_ITERATIONS = 8
GROWTH = 2.0


@dataclass(frozen=True)
class Step:
    """A committed step.

    Attributes:
        number: 1 for the first.
        stage: Name of its stage.
        time: Time at its end: stage k runs from k to k + 1.
        outcome: What the solver said.
        augmentation: Multiple of the default augmentation that it converged with.
        seconds: Wall time, failed attempts included.
    """

    number: int
    stage: str
    time: float
    outcome: Outcome
    augmentation: float
    seconds: float


@dataclass(frozen=True)
class Summary:
    """What a whole loading took."""

    steps: int
    newton_iterations: int
    linear_iterations: int
    rejected: int
    augmentation: float


def run(
    problem: Problem,
    solver: Solver,
    stages: tuple[Stage, ...],
    on_step: Callable[[Step, Trial | None], None],
    on_trouble: Callable[[str], None],
) -> Summary:
    """Load the model through all stages.

    Args:
        problem: What is solved; at rest at time 0.
        solver: Its solver.
        stages: Parts of the loading.
        on_step: Called after each converged step, once it is history.
        on_trouble: Told in plain words what is tried when a step fails.

    Raises:
        ConvergenceError: A step cannot be made smaller or may not be, or a body runs away.
    """
    number = newton = krylov = rejected = 0
    level = 0
    for k, stage in enumerate(stages):
        whole = 1.0 / stage.increments
        step, done, cuts = whole, 0.0, 0
        while done < 1.0:
            begin = clock.perf_counter()
            reach = 1.0 if done + 1.001 * step > 1.0 else done + step
            start = solver.x.copy()
            while True:
                problem.set_time(k + reach)
                problem.scale_augmentation(AUGMENTATIONS[level])
                outcome = solver.solve()
                newton += outcome.iterations
                krylov += outcome.linear_iterations
                if outcome.converged:
                    break
                rejected += 1
                start.copy(solver.x)
                why = explain(problem, solver, outcome)
                if problem.augmented and level + 1 < len(AUGMENTATIONS):
                    level += 1
                    on_trouble(f"{why.short}; augmentation lowered to {AUGMENTATIONS[level]:g} r")
                    continue
                # A smaller step does not hold a body that nothing holds: one is tried, no more.
                hopeless = bool(why.free) and cuts > 0
                if not stage.adaptive or cuts == stage.max_cut_backs or hopeless:
                    raise ConvergenceError(why.text(stage.name, reach, cuts))
                cuts += 1
                level = 0
                step /= 2
                reach = done + step
                on_trouble(f"{why.short}; step halved to {step:.4g} of stage '{stage.name}'")
            number += 1
            u, q = solver.parts()
            trial = problem.trial(u, q) if q is not None else None
            if trial is not None and (away := runaway(problem, trial)):
                raise ConvergenceError(
                    f"stage '{stage.name}' at {100 * reach:.3g} % of it: {away}\n"
                    "  what to change: hold the body (a support, friction, an elastic foundation)"
                )
            problem.spread(u, q)
            problem.commit(trial)
            on_step(
                Step(
                    number,
                    stage.name,
                    k + reach,
                    outcome,
                    AUGMENTATIONS[level],
                    clock.perf_counter() - begin,
                ),
                trial,
            )
            done = reach
            if outcome.iterations <= EASY_ITERATIONS and step < whole:
                step, cuts = min(GROWTH * step, whole), max(cuts - 1, 0)
    return Summary(number, newton, krylov, rejected, AUGMENTATIONS[level])
