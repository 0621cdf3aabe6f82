"""Cement that sets: kinetics, heat of cure, order of time steps."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from app.results.reading import Run
from app.verification import closed_forms_heat as exact
from app.verification.measures import summary_number
from app.verification.problem import (
    Comparison,
    KnownProblem,
    quick,
    relative,
    verify,
    worst,
)

CASE = "verification/exotherm.yaml"
CURE = "regions.cube.thermal.cure"
KINETICS = (2.6397e8, 62866.0)
PMMA = exact.ExactKinetics(*KINETICS, 0.98, 1.064)
LOGISTIC = exact.ExactKinetics(*KINETICS, 1, 1)
RISE = 155 / 1.74  # K, of a whole cure without losing heat
INITIAL = 1e-3  # degree of cure
QUADRATURE = "integral over the degree of cure, on which alone the temperature depends"


def held(temperature: float) -> tuple[str, ...]:
    """Overrides for a bath at a temperature [degC]."""
    bath = f"{{kind: temperature, regions: [cube], temperature: {temperature} degC}}"
    return (f"heat={{bath: {bath}}}", *begun(temperature))


def begun(temperature: float) -> tuple[str, str]:
    """Overrides for a start at a temperature [degC]."""
    return (
        f"regions.cube.thermal.initial_temperature={temperature} degC",
        "stages.0.duration=3200 s",
    )


@verify
@pytest.mark.parametrize(
    ("changes", "reference"),
    [
        pytest.param((), PMMA.time(0.5, 310.15, INITIAL, RISE), id="adiabatic_37C"),
        pytest.param(
            begun(23), PMMA.time(0.5, 296.15, INITIAL, RISE), id="adiabatic_23C", marks=quick
        ),
        pytest.param(
            held(23), PMMA.time(0.5, 296.15, INITIAL, 0), id="isothermal_23C", marks=quick
        ),
        pytest.param(
            (*held(37), f"{CURE}.kinetics.m=1", f"{CURE}.kinetics.n=1"),
            LOGISTIC.time(0.5, 310.15, INITIAL, 0),
            id="logistic_37C",
        ),
    ],
)
def test_cure(problem: KnownProblem, changes: Sequence[str], reference: float) -> None:
    problem.expects(
        "when half of it has set, default tolerances [s], relative",
        tolerance=1e-4,
        source=QUADRATURE,
    )
    problem.compare(summary_number(problem.solve(CASE, *changes), "cube.time_50", reference))


@verify
@quick
def test_cure_heat(problem: KnownProblem) -> None:
    """The final temperature follows from the heat of the final degree of cure."""
    problem.expects(
        "temperature after it has set without losing heat, over its rise",
        tolerance=1e-9,
        source="conservation of energy",
    )
    solved = problem.solve(CASE)
    rise = RISE * (solved.summary["cure"]["cube"]["degree_max"] - INITIAL)
    computed = solved.summary["thermal"]["regions"]["cube"]["temperature_max"]
    problem.compare(Comparison(abs(computed - 37 - rise) / rise, computed, 37 + rise))


@verify
@pytest.mark.parametrize(
    ("method", "order", "counts", "tolerance"),
    [
        pytest.param("backward_euler", 1.0, (40, 80, 160), 0.02, id="backward_euler", marks=quick),
        pytest.param("sdirk4", 4.0, (4, 6, 8, 12), 1e-5, id="sdirk4"),
    ],
)
def test_cure_order(
    problem: KnownProblem, method: str, order: float, counts: Sequence[int], tolerance: float
) -> None:
    """The final degree of cure is uniform in space."""
    problem.expects(
        "degree of cure after 300 s in steps of one length, relative",
        tolerance=tolerance,
        order=order,
        rung="time step (s)",
        source=QUADRATURE,
    )
    end = 300.0
    steps = problem.rungs([end / n for n in counts], finest="quick")
    changes = []
    for step, n in zip(steps, counts, strict=True):
        stage = f"{{name: forced, duration: {step * n} s, increments: {n}, adaptive: false}}"
        changes.append((f"time={{method: {method}}}", f"stages=[{stage}]"))
    runs = problem.solve_each(CASE, changes)
    reference = PMMA.degree(end, 310.15, INITIAL, RISE)

    def degree(run: Run) -> Comparison:
        q = run.summary["cure"]["cube"]
        return worst([relative(q[key], reference) for key in ("degree_min", "degree_max")])

    problem.converges([degree(solved) for solved in runs])
