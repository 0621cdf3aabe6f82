"""The discrete problem: forces in time, residual, energy, displacements of bodies, states."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest

from app.foundation.arrays import Floats
from app.mechanics.problem import Problem
from app.numerics.newton import Solver
from app.numerics.remedies import solve
from app.scene.scene import build_scene
from tests import support
from tests.cases.blocks import HALVES

# A bar of two halves, 2 GPa and 1 GPa, each 2 mm long, on 16 mm2.
BAR = f"""\
{HALVES}supports:
  base: {{kind: fixed, boundary: bottom}}
loads:
  pull: {{kind: pressure, boundary: top, pressure: -3 MPa, history: [1, 0.5]}}
  shove: {{kind: force, boundary: top, force: [0 N, 8 N, 0 N], history: [0, 1]}}
stages: [{{name: one}}, {{name: two}}]
solver: {{tolerance: 1.0e-12}}
"""
PULL = "loads.shove=null"
CONTACT = "interfaces={lower_upper: {kind: contact, friction_coefficient: 0.3}}"
AREA = 16.0
FLEXIBILITY = (2 / 2000 + 2 / 1000) / AREA  # stretch per force [mm/N]


def vectors(problem: Problem) -> tuple[PETSc.Vec, PETSc.Vec]:
    return problem.stiffness.K.createVecRight(), problem.stiffness.K.createVecLeft()


def solved(problem: Problem, solver: Solver, time: float) -> PETSc.Vec:
    """The displacement at a time."""
    problem.set_time(time)
    assert solve(solver).converged
    return solver.u_and_q()[0]


def total(vector: PETSc.Vec) -> Floats:
    """Sum of the vectors at all nodes (3,)."""
    return np.asarray(vector.array_r.reshape(-1, 3).sum(axis=0))


@pytest.mark.parametrize(
    ("time", "pull", "shove"), [(0.0, 0, 0), (0.5, 0.5, 0), (1.0, 1, 0), (1.5, 0.75, 0.5)]
)
def test_problem_forces_follow_the_histories(time: float, pull: float, shove: float) -> None:
    """The nodal forces add up to pressure times area, and to the given force."""
    problem, _ = support.assemble(support.case(BAR))
    problem.set_time(time)
    expected = [0, 8 * shove, 3 * AREA * pull]
    np.testing.assert_allclose(total(problem.f), expected, atol=1e-12)
    assert problem.size_of_loads == pytest.approx(problem.f.norm())


def test_problem_residual_is_equilibrium_and_prescribed_values() -> None:
    """At rest it is minus the load. The reactions of the solution bear the load.

    In constrained rows it is the deviation from the prescribed displacement, times a stiffness.
    """
    problem, solver = support.assemble(
        support.case(
            BAR, "supports.base={kind: displacement, boundary: bottom, x: 0 mm, y: 0 mm, z: 1 mm}"
        )
    )
    problem.set_time(1.0)
    u, r = vectors(problem)
    assert problem.residual(u, None, r) is None
    is_constrained = problem.stiffness.constraints.constrained
    np.testing.assert_array_equal(r.array_r[~is_constrained], -problem.f.array_r[~is_constrained])
    held = r.array_r.reshape(-1, 3)[is_constrained.reshape(-1, 3)[:, 2]]
    np.testing.assert_allclose(
        held, np.tile([0, 0, -problem.stiffness.mean_diagonal], (len(held), 1))
    )
    problem.impose(u)
    problem.residual(u, None, r)
    assert not r.array_r[is_constrained].any()
    x = solved(problem, solver, 1.0)
    problem.residual(x, None, r)
    assert r.norm() < 1e-9 * problem.size_of_loads
    internal = problem.stiffness.reactions * x
    assert internal.sum() == pytest.approx(-3 * AREA, rel=1e-9)


def test_problem_elastic_energy_is_half_the_work_of_the_load() -> None:
    """Clapeyron: u K u / 2 = F δ / 2, with δ by Hooke's law."""
    problem, solver = support.assemble(support.case(BAR, PULL))
    u = solved(problem, solver, 1.0)
    force = 3 * AREA
    K_u = problem.stiffness.K * u
    # The matrix has unit rows at supports, which do not move.
    assert u.dot(K_u) / 2 == pytest.approx(force**2 * FLEXIBILITY / 2, rel=1e-9)
    assert u.dot(problem.f) / 2 == pytest.approx(force**2 * FLEXIBILITY / 2, rel=1e-9)


def test_problem_size_of_forces_has_loads_and_reactions() -> None:
    """Forces at free nodes and reactions at supports: each has the size of the load.

    The forces of a change of the prescribed displacement alone are no scale.
    """
    problem, solver = support.assemble(support.case(BAR, PULL))
    u = solved(problem, solver, 1.0)
    scale = problem.size_of_forces(u, None)
    reactions = problem.stiffness.reactions * u
    assert scale == pytest.approx(problem.size_of_loads + reactions.norm(), rel=1e-12)
    # Between a force spread over all nodes of an end, and one at a single node.
    assert 2 * 3 * AREA / 5 < scale < 2 * 3 * AREA
    u.scale(0.5)
    assert problem.size_of_forces(u, None) == pytest.approx(
        problem.size_of_loads + reactions.norm() / 2, rel=1e-12
    )


def test_problem_begins_again_with_other_loads() -> None:
    """State and time are reset, the matrix stays, and the new load counts."""
    problem, solver = support.assemble(support.case(BAR, PULL))
    problem.update_displacements(solved(problem, solver, 1.0), None)
    assert problem.u.x.array.max() == pytest.approx(3 * AREA * FLEXIBILITY, rel=1e-9)
    K = problem.stiffness.K
    other = support.case(BAR, PULL, "loads.pull.pressure=-6 MPa")
    problem.begin(build_scene(other), other.solver.augmentation_factor)
    assert problem.time == 0.0 and problem.stiffness.K is K
    assert not problem.u.x.array.any() and problem.size_of_loads == 0.0
    u = solved(problem, solver, 1.0)
    assert u.max()[1] == pytest.approx(6 * AREA * FLEXIBILITY, rel=1e-9)


def test_problem_displacements_differ_by_the_jump() -> None:
    """A jump field moves one of the bodies at the interface, and no other node."""
    problem, solver = support.assemble(support.case(BAR, CONTACT))
    contact = problem.contact
    assert contact is not None
    u, q = solver.u_and_q()
    assert q is not None
    jump = np.random.default_rng(1).normal(size=(len(contact.local), 3))
    q.array[:] = jump.ravel()
    u.set(0.0)
    problem.update_displacements(u, q)
    master, slave = contact.local.bodies[0]
    fields = [f.x.array.reshape(-1, 3) for f in problem.displacements()]
    nodes = problem.space.tabulate_dof_coordinates()
    distance = np.linalg.norm(nodes[:, None] - contact.local.x[None], axis=2)
    at_interface = distance.argmin(axis=0)
    difference = fields[slave] - fields[master]
    np.testing.assert_allclose(difference[at_interface], jump, rtol=1e-14)
    others = np.setdiff1d(np.arange(len(nodes)), at_interface)
    assert not difference[others].any()


def test_problem_residual_of_contact_is_that_of_a_whole_bar_if_it_sticks() -> None:
    """The bar is pressed, and sheared below the friction limit: no jump, the same displacement.

    μ p is 0.9 MPa, and 1 N is 0.06 MPa. The pressure of 3 MPa keeps all points closed in bending.
    """
    press = "loads.pull={kind: pressure, boundary: top, pressure: 3 MPa, history: [1, 1]}"
    force = "loads.shove.force=[0 N, 1 N, 0 N]"
    whole, whole_solver = support.assemble(support.case(BAR, press, force))
    parted, solver = support.assemble(support.case(BAR, press, force, CONTACT))
    expected = solved(whole, whole_solver, 2.0)
    u = solved(parted, solver, 2.0)
    q = solver.u_and_q()[1]
    assert q is not None
    assert abs(q.array).max() < 1e-9 * expected.norm()
    np.testing.assert_allclose(u.array, expected.array, atol=1e-9 * expected.norm())
    r_u, r_q = u.duplicate(), q.duplicate()
    trial = parted.residual(u, q, r_u, r_q)
    assert trial is not None
    assert max(r_u.norm(), r_q.norm()) < 1e-9 * parted.size_of_loads
    weight = trial.contact.local.weight
    np.testing.assert_allclose(weight @ trial.forces.force, [0, 1, -3 * AREA], atol=1e-7)


def test_problem_commit_keeps_the_jump_and_its_work() -> None:
    """The upper half is lifted off: the jump is the motion, and contact does no work in it."""
    lift = "supports={base: {kind: fixed, boundary: bottom}, lift: {kind: displacement, "
    lift += "boundary: top, x: 0 mm, y: 0 mm, z: 0.25 mm}}"
    problem, solver = support.assemble(support.case(BAR, CONTACT, "loads=null", lift))
    u = solved(problem, solver, 1.0)
    q = solver.u_and_q()[1]
    assert q is not None and problem.contact is not None
    problem.update_displacements(u, q)
    problem.commit(problem.trial(u, q))
    state = problem.contact.state
    slave = problem.contact.local.bodies[0, 1]
    motion = 0.25 if problem.bodies.names[slave].startswith("upper") else -0.25
    np.testing.assert_allclose(
        state.jump, np.tile([0, 0, motion], (len(q.array) // 3, 1)), atol=1e-9
    )
    assert problem.contact_work == pytest.approx(0, abs=1e-12)
    assert not state.path.any() and not state.dissipation.any()
    q.array[:] = 0.0
    assert state.jump.any()
