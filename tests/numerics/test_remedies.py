"""Remedies for a nonlinear solve that does not converge."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest

import mantle
from app.case.case import load_case
from app.foundation.errors import StoppedError
from app.numerics.remedies import solve
from app.results.reading import Results
from meshes.distribute import TaggedMesh
from tests import support
from tests.numerics.blocks import BLOCK


def test_remedies_limits_of_friction_are_the_given_ones() -> None:
    """Zero pressures give no friction. Pressures of the solution give the same solution."""
    problem, solver = support.assemble(support.case(support.STEM))
    contact = solver.system.contact
    problem.set_time(1.0)
    assert solve(solver).converged
    coulomb = solver.x.copy()
    with contact.remedies.tresca_friction() as has_friction:
        assert has_friction
        solver.residual(solver.x)
        assert contact.remedies.relax_tresca_friction(1.0) > 0.99
        solver.run()
    assert solver.converged
    coulomb.axpy(-1.0, solver.x)
    assert coulomb.norm() < 1e-9 * solver.x.norm()
    with contact.remedies.tresca_friction():
        solver.run()
        assert solver.converged
        u, q = solver.u_and_q()
        forces = problem.trial(u, q).forces
    normal = np.einsum("pk,pki->pi", forces.pressures, contact.local.normals)
    assert np.abs(forces.force + normal).max() < 1e-9 * np.abs(normal).max()
    assert solve(solver).converged


@pytest.mark.parametrize("friction", [5.0, 7.0])
def test_remedies_find_the_same_equilibrium_beyond_the_critical_friction(
    friction: float, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The coefficient is 3.6 and 5 times the critical one of 1.4.

    Each solver finds the solution on the same path.
    """
    names = ("stem_cement", "cement_bone")
    changes = [f"interfaces.{name}.friction_coefficient={friction}" for name in names]
    motions = []
    for linear in ("condensed", "direct"):
        case = load_case(
            support.CONFIGS / "stress/stem.yaml", [*changes, f"solver.linear={linear}"]
        )
        with caplog.at_level(logging.INFO, "mantle"):
            mantle.run(case, tmp_path / linear)
        assert "limiting friction by given pressures" in caplog.text
        caplog.clear()
        record = Results(tmp_path / linear).step_record
        motions.append(record["cement_bone slip_max [mm]"])
    assert (motions[0] > 0).all()
    np.testing.assert_allclose(motions[1], motions[0], rtol=1e-4)


def test_remedies_are_undone_if_a_solve_is_interrupted(
    tagged: TaggedMesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A signal or an error in the middle of any remedy leaves the usual solver and laws."""
    problem, solver = support.assemble(support.case(BLOCK), tagged)
    contact = solver.system.contact
    assert contact is not None
    laws, of_remedies = contact.laws, contact.remedies
    problem.set_time(1.0)
    switches, augmentation = of_remedies.switches, laws.augmentation.copy()

    def changes() -> tuple[str, bool, bool, float]:
        now = of_remedies.switches
        given = now.tresca_trial_force is not None
        return solver._line_search, bool(now.opened.any()), given, float(laws.augmentation[0])

    seen, run = {changes()}, solver.run

    def interrupted_run() -> tuple[int, int]:
        iterations = run()
        if changes() not in seen:
            seen.add(changes())
            raise StoppedError("stopped")
        return iterations

    solver.snes.setTolerances(max_it=0)
    monkeypatch.setattr(solver, "run", interrupted_run)
    solver.begin(1e-10)
    for _ in range(6):
        with pytest.raises(StoppedError):
            solve(solver)
        assert solver._line_search == solver.usual_search
        assert of_remedies.switches is switches
        assert solver.augmentation == 1.0
        np.testing.assert_array_equal(laws.augmentation, augmentation)
    assert {search for search, *_ in seen} == {"bt", "basic"}


def test_remedies_leave_the_augmentation_of_the_case_after_a_failure(tagged: TaggedMesh) -> None:
    """Without iterations no remedy converges."""
    problem, solver = support.assemble(support.case(BLOCK), tagged)
    assert solver.system.contact is not None
    laws = solver.system.contact.laws
    before = laws.augmentation.copy()
    problem.set_time(1.0)
    solver.snes.setTolerances(max_it=0)
    result = solve(solver)
    assert not result.converged and any("augmentation" in remedy for remedy, _ in result.tried)
    np.testing.assert_array_equal(laws.augmentation, before)


def test_remedies_return_to_sor_after_a_converged_step(tagged: TaggedMesh) -> None:
    """Factors serve a Newton iteration that fails, not all later ones."""
    problem, solver = support.assemble(support.case(BLOCK), tagged)
    problem.set_time(1.0)
    krylov = solve(solver).linear_iterations

    def failing() -> bool:
        solver.begin(1e-10)
        solver.snes.setTolerances(max_it=0)
        return not solve(solver).converged and solver.linear.factored

    assert failing()
    solver.snes.setTolerances(max_it=50)
    assert solve(solver).converged and not solver.linear.factored
    # What begins anew after a failure sweeps from the start.
    assert failing()
    solver.snes.setTolerances(max_it=50)
    solver.begin(1e-10)
    assert solve(solver).linear_iterations == krylov
