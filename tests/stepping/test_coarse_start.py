"""Starts from a coarse model: equal results, failures, interpolation of jumps."""

from __future__ import annotations

import logging
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest

from app.foundation.errors import GeometryError, MantleError, StoppedError
from app.numerics import remedies
from app.numerics.newton import NewtonResult, Solver
from app.simulation import model as models
from app.simulation.model import Model
from app.stepping import coarse_start, load_steps
from app.system.timing import Timing
from meshes.nearest_facets import nearest
from tests import support
from tests.cases.coarse_start_stem import ALWAYS, STEM, TURNS, go

AT_FIRST = ("mesh.order=2", "solver.linear=multigrid", "mesh.size=4 mm", "mesh.far_size=4 mm")
# A support that gives jumps: it holds stem and cement where they meet, and moves.
SIDES = "supports.sink={kind: displacement, boundary: bottom, z: -0.002 mm, history: [0.5, 1]}"
BLOCKS = """
geometry: {kind: blocks, blocks: [{name: base, size: [9 mm, 7 mm, 4 mm]},
                                  {name: lid, size: [9 mm, 7 mm, 4 mm]}], tilt: 10 deg}
mesh: {order: 1, size: SIZE mm, far_size: SIZE mm}
regions:
  base: {youngs_modulus: 10 GPa, poisson_ratio: 0.3}
  lid: {youngs_modulus: 2 GPa, poisson_ratio: 0.3}
interfaces:
  base_lid: {kind: contact, friction_coefficient: 0.3}
supports:
  floor: {kind: fixed, boundary: bottom}
"""


def always(monkeypatch: pytest.MonkeyPatch) -> None:
    """Start from a coarse model although this one is small."""
    for name, value in ALWAYS.items():
        monkeypatch.setattr(models, name, value)


def states(model: Model) -> Any:
    """Jumps and forces of the last step, each relative to its largest (2, n, 3)."""
    j = model.mechanics.problem.contact
    return np.array([v / np.abs(v).max() for v in (j.state.jump, j.state.force)])


# From a coarse model


@pytest.mark.parametrize("overrides", [(), TURNS, (*TURNS, SIDES), (*AT_FIRST, *TURNS)])
def test_coarse_start_changes_iterations_but_not_results(
    overrides: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Jumps and forces are equal. The first step has a start that is much nearer.

    Supports may give jumps. A start of second order is first order on the same mesh, if that may
    not be coarser.
    """
    if AT_FIRST[0] in overrides:
        monkeypatch.setattr(models, "COARSENING_OF_START", 1e3)
    cold, first = go(*overrides)
    always(monkeypatch)
    warm, then = go(*overrides)
    assert support.difference(states(warm), states(cold)) < 1e-6
    assert len(then) == len(first)
    assert then[0].outcome.residuals[0] < 0.3 * first[0].outcome.residuals[0]


def test_coarse_start_is_reused_by_the_companion(monkeypatch: pytest.MonkeyPatch) -> None:
    """A companion on the mesh of the coarse model continues from its states, to its tolerance."""
    always(monkeypatch)
    monkeypatch.setattr(models, "TOLERANCE", 1e-2)
    model, _ = go()
    companion = support.case(STEM, "mesh.size=5 mm", "mesh.far_size=5 mm", "stages.0.increments=1")
    coarse = next(m for m in model._other_models if m.case.mesh.size == 5.0)
    m = coarse.mechanics
    solves: list[NewtonResult] = []

    def noted(solver: Solver) -> NewtonResult:
        outcome = remedies.solve(solver)
        if solver is m.solver:
            solves.append(outcome)
        return outcome

    monkeypatch.setattr(load_steps, "solve", noted)
    relative = model.numbers_of_companion(companion)
    assert len(solves) == 1 and solves[0].residuals[0] < 1e-2
    assert solves[0].residuals[-1] < companion.solver.tolerance
    monkeypatch.undo()
    alone = Model(companion, MPI.COMM_WORLD, {}, Timing(), str)
    expected = alone.numbers_of_companion(companion)["interfaces"]["stem_cement"]
    for name, number in relative["interfaces"]["stem_cement"].items():
        if isinstance(number, float) and not name.startswith("penetration"):
            assert number == pytest.approx(expected[name], rel=1e-6, abs=1e-9), name


def test_coarse_start_only_for_large_models_with_contact(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small models and bonded ones start from rest."""
    bonded = "interfaces={stem_cement: {kind: bonded}, cement_bone: {kind: bonded}}"
    tied, small = (
        Model(support.case(STEM, *o), MPI.COMM_WORLD, {}, Timing(), str) for o in ((bonded,), ())
    )
    assert len(small._predictors(small.mechanics)) == 1
    always(monkeypatch)
    assert len(small._predictors(small.mechanics)) == 2
    assert len(tied._predictors(tied.mechanics)) == 1


@pytest.mark.parametrize(
    ("size", "order", "unknowns", "expected"),
    [
        (4.0, 2, 100_000, (8.0, 2)),
        (4.0, 1, 100_000, (8.0, 1)),
        (4.0, 2, 10_000, None),  # small
        (11.0, 2, 100_000, (11.0, 1)),  # no mesh so coarse
        (11.0, 1, 100_000, None),
    ],
)
def test_coarse_start_coarse_cases(
    size: float, order: int, unknowns: int, expected: tuple[float, int] | None
) -> None:
    text = support.CONFIGS.joinpath("stance.yaml").read_text()
    case = support.case(text, f"mesh.size={size} mm", f"mesh.order={order}")
    other = models.coarse_case(case, unknowns)
    assert (other and (other.mesh.size, other.mesh.order)) == expected
    if other is not None:
        assert other.mesh.far_size_or_default / other.mesh.size == pytest.approx(
            case.mesh.far_size_or_default / case.mesh.size
        )
        assert other.geometry == case.geometry and other.solver.tolerance == models.TOLERANCE


@pytest.mark.parametrize("error", [GeometryError("no such mesh"), StoppedError("stopped")])
def test_coarse_start_failure_is_ignored(
    error: MantleError, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A signal stops the run. No other error of the coarse model matters."""

    def fail(self: Model, case: object) -> None:
        raise error

    always(monkeypatch)
    monkeypatch.setattr(Model, "_coarse_stepper", fail)
    if isinstance(error, StoppedError):
        with pytest.raises(StoppedError):
            go()
        return
    with caplog.at_level(logging.INFO, logger="mantle"):
        _, steps = go()
    assert len(steps) == 3
    assert caplog.text.count("no such mesh") == 1


def test_coarse_start_interpolation_is_exact_for_linear_jumps() -> None:
    """The interface is plane. Neither of the meshes contains the other."""
    coarse, fine = (
        support.assemble(support.case(BLOCKS.replace("SIZE", size)))[0].contact
        for size in ("3.1", "1.3")
    )
    weights = coarse_start.interpolation_matrix(coarse.points, fine.points, fine.local.rows)
    slope = np.random.default_rng(5).normal(size=(3, 3))
    interpolated = weights @ (coarse.points.x @ slope + 1.0)
    assert len(fine.local.rows) > 2 * len(coarse.local.rows)
    assert support.difference(interpolated, fine.local.x @ slope + 1.0) < 1e-12


def test_coarse_start_between_two_states() -> None:
    """A fine step that was cut needs a time that the coarse model has passed."""
    known = [(1.0, np.zeros((2, 3))), (2.0, np.ones((2, 3)))]
    assert coarse_start.jumps_between(known, 1.25) == pytest.approx(np.full((2, 3), 0.25))
    assert coarse_start.jumps_between(known, 2.0) == pytest.approx(np.ones((2, 3)))


def test_coarse_start_nearest_point_of_a_triangle() -> None:
    """No point of a fine grid on any triangle is nearer, also next to corners and edges."""
    random = np.random.default_rng(1)
    corners, x = random.normal(size=(5, 3, 3)), 2 * random.normal(size=(200, 3))
    triangle, weights = nearest(x, corners)
    assert weights.min() >= 0 and np.allclose(weights.sum(axis=1), 1)
    off = np.linalg.norm(np.einsum("nc,nci->ni", weights, corners[triangle]) - x, axis=1)
    n = 60
    i, j = (k.ravel() for k in np.meshgrid(np.arange(n + 1), np.arange(n + 1)))
    i, j = i[i + j <= n], j[i + j <= n]
    grid = np.einsum("gc,tci->tgi", np.stack([i, j, n - i - j], axis=1) / n, corners).reshape(-1, 3)
    least = np.linalg.norm(x[:, None] - grid, axis=2).min(axis=1)
    assert (off <= least + 1e-12).all()
    assert (off >= least - 0.1).all()
