"""Remodelling of bone: final state, course, two columns, meshes of a plate."""

from __future__ import annotations

import numpy as np
import pytest

from app.case.summary import added_section
from app.results.reading import Run
from app.verification.closed_forms_long_term import (
    BOUNDS,
    START,
    column_density,
    column_density_at,
)
from app.verification.measures import largest_error
from app.verification.problem import Comparison, KnownProblem, relative, run, stress, verify

BLOCK = "verification/remodelling.yaml"
COLUMNS = "verification/columns.yaml"
PRESS = "loads.press.pressure={} MPa"
MODULUS = "regions.{}.youngs_modulus={} MPa"
LAZY_ZONE = "stimulus P^2 / (2 C rho^(g + 1)) on the edge of the lazy zone"


def densities(run: Run, **expected: float) -> Comparison:
    """Density of regions against the one expected everywhere [g/cm3]."""
    rho = run.on_cells("density")
    deviations = [rho[run.region == run.regions[name]] - value for name, value in expected.items()]
    return Comparison(max(float(np.abs(part).max()) for part in deviations))


@verify
def test_remodelling_ends(problem: KnownProblem) -> None:
    problem.expects(
        "density at the edge of the lazy zone, from above and below [g/cm3]",
        tolerance=1e-3,
        source=LAZY_ZONE,
    )
    # Pressure [MPa], density at the start [g/cm3], and Young's modulus that gives it [MPa].
    end_states = [(3.0, START, 64), (8.0, START, 64), (3.0, 0.3, 9)]
    changes_of_runs = [(PRESS.format(p), MODULUS.format("bone", e)) for p, _, e in end_states]
    runs = problem.solve_each(BLOCK, changes_of_runs)
    problem.compare(
        *(
            densities(solved, bone=column_density(p, start))
            for solved, (p, start, _) in zip(runs, end_states, strict=True)
        )
    )


@verify
def test_remodelling_bounds(problem: KnownProblem) -> None:
    problem.expects("density on its bounds [g/cm3]", tolerance=1e-12, source="the bounds")
    runs = problem.solve_each(BLOCK, [(PRESS.format(p),) for p in (0.001, 40)])
    problem.compare(*(densities(r, bone=b) for r, b in zip(runs, BOUNDS, strict=True)))


@verify
def test_remodelling_course(problem: KnownProblem) -> None:
    problem.expects(
        "density after 2 s, over the tolerance of a step, 1e-2 to 1e-4 g/cm^3",
        tolerance=0.5,
        source="integration of the differential equation",
    )
    steps = (1e-2, 1e-3, 1e-4)
    changes_of_runs = [
        ("stages.1.remodels=2 s", f"remodelling.tolerance={t} g/cm^3") for t in steps
    ]
    runs = problem.solve_each(BLOCK, changes_of_runs)
    exact = column_density_at(2.0, stress=3.0)
    comparisons = []
    for solved, step in zip(runs, steps, strict=True):
        computed = float(solved.on_cells("density").mean())
        comparisons.append(Comparison(abs(computed - exact) / step, computed, exact))
    problem.compare(*comparisons)


@verify
def test_remodelling_two_stay(problem: KnownProblem) -> None:
    problem.expects(
        "density of two columns under one cap [g/cm3]: exponent 0.9, both stay",
        tolerance=0.01,
        source=LAZY_ZONE,
    )
    law = "remodelling.law={density: apparent, ranges: [[0 g/cm^3, 0 MPa, 100 MPa, 0.9]]}"
    solved = problem.solve(COLUMNS, law, MODULUS.format("one", 83), MODULUS.format("other", 70))
    half_density = column_density(3.0, lazy=0.0, exponent=0.9)
    problem.compare(densities(solved, one=half_density, other=half_density))


@verify
def test_remodelling_one_stays(problem: KnownProblem) -> None:
    problem.expects(
        "the same by exponent 2: one bears all, the other vanishes",
        tolerance=0.01,
        source=LAZY_ZONE,
    )
    solved = problem.solve(COLUMNS)
    all_of_it = column_density(6.0, lazy=0.0)
    problem.compare(densities(solved, one=all_of_it, other=BOUNDS[0]))


@verify
def test_remodelling_mass(problem: KnownProblem) -> None:
    """The final mass less the initial mass, with added and cut mass, over the initial mass."""
    problem.expects(
        "mass that is not accounted for, over all, of two columns",
        tolerance=1e-10,
        source="conservation of mass",
    )
    solved = problem.solve(COLUMNS)
    problem.compare(Comparison(abs(added_section(solved.summary, "remodelling")["mass"]["audit"])))


@verify
def test_remodelling_plate(problem: KnownProblem) -> None:
    """A checkerboard is the part of the variance that alternates from cell to cell.

    It must be below 1 %.
    """
    problem.expects(
        "mass of a plate on two meshes, relative, or twice its checkerboards",
        tolerance=0.02,
        source="the finer mesh",
    )
    counts = (10, 20)  # of cells a side
    planned_runs = [run("verification/plate.yaml", f"mesh.size={1 / n} mm") for n in counts]
    runs = problem.solve_all(planned_runs)
    errors = {}
    for solved, n in zip(runs, counts, strict=True):
        x = np.floor(n * solved.points[solved.cells].mean(axis=1)).astype(int)
        place = x[:, 0] * n + x[:, 2]
        sums = np.bincount(place, solved.on_cells("density"))
        rho = (sums / np.bincount(place)).reshape(n, n)
        alternating = np.diff(np.diff(rho, axis=0), axis=1) / 4
        errors[f"checkerboards of {n} cells"] = float(2 * (alternating**2).mean() / rho.var())
    coarse, fine = (added_section(solved.summary, "remodelling")["mass"]["end"] for solved in runs)
    problem.compare(largest_error(errors), relative(coarse, fine))


# Density from one bound to the other


@stress
@pytest.mark.parametrize("p", [pytest.param(p, id=f"{p:g} MPa") for p in 10.0 ** np.arange(-3, 4)])
def test_density(problem: KnownProblem, p: float) -> None:
    problem.expects("density at the end [g/cm3]", tolerance=2e-3, source=LAZY_ZONE)
    solved = problem.solve(BLOCK, f"loads.press.pressure={p:g} MPa")
    problem.compare(densities(solved, bone=column_density(p)))


@stress
def test_density_one_of_two_columns(problem: KnownProblem) -> None:
    problem.expects("density at the end [g/cm3]", tolerance=0.01, source=LAZY_ZONE)
    solved = problem.solve(COLUMNS, "loads.press.force=[0 N, 0 N, -15 N]")
    all_of_it = column_density(15.0, lazy=0.0)
    problem.compare(densities(solved, one=all_of_it, other=BOUNDS[0]))
