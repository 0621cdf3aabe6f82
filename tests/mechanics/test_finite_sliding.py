"""Finite sliding over rigid surfaces: a head that rotates in its cup by given angles."""

from __future__ import annotations

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from app.foundation.arrays import Floats
from app.foundation.errors import ConvergenceError
from app.verification.changed_meshes import ROTATION
from meshes.distribute import distribute
from tests import support
from tests.cases.turning_head import (
    CUP,
    DRIVEN,
    FORCE,
    FRICTION,
    MU,
    QUARTER,
    SWING,
    R,
    Step,
    built,
    cycle_table,
    solve,
    stages,
    turning,
)
from tests.cases.varied_stem import Runs
from tests.support import vector

AS_IT_IS = np.eye(3)


def loaded(*forces: Floats) -> str:
    """Override by which forces [N] at equal times load the head."""
    rows = cycle_table("force {} [N]", forces)
    return f"loads.hip={{kind: force, boundary: head_bore, cycle_table: {rows}}}"


def same(one: list[Step], other: list[Step], tolerance: float, Q: Floats = AS_IT_IS) -> None:
    """Steps are equal, or those of a case that is rotated by Q."""
    assert len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        assert support.difference(a.load, b.load) < tolerance
        assert a.dissipated == pytest.approx(b.dissipated, rel=tolerance, abs=tolerance)
        for name in ("force", "torque", "place"):
            assert support.difference(getattr(a, name), Q @ getattr(b, name)) < tolerance, name


def test_finite_sliding_rotation_without_friction_changes_nothing() -> None:
    """Pressures, place and force of a rotating sphere stay constant. There is no torque."""
    settled = ", ".join(f"{{name: settle_{k}}}" for k in range(4))
    steps = solve(f"{FRICTION}=0", QUARTER, f"stages=[{settled}, {{name: turn, increments: 5}}]")
    before, *turned = steps[3:]
    assert len(turned) == 5 and np.linalg.norm(turned[-1].turn) > 0.08
    for step in turned:
        assert support.difference(step.load, before.load) < 1e-10
        assert support.difference(step.place, before.place) < 1e-10
        np.testing.assert_allclose(step.force, FORCE, rtol=1e-11)
        assert np.linalg.norm(step.torque) < 1e-12 * R * np.linalg.norm(FORCE)
        assert step.dissipated == 0


@pytest.mark.parametrize("axis", [(0, 1, 0), (2, -1, 1)])
def test_finite_sliding_dissipation_equals_torque_times_angle(axis: tuple[int, int, int]) -> None:
    """The dissipated energy is the integral of M dθ, and M is the sum of μ p W R sqrt(1 - n_y²).

    Newton needs few iterations.
    """
    angles = 30 * Rotation.from_rotvec(np.array(axis)).as_rotvec() / np.linalg.norm(axis)
    ways = [Rotation.from_rotvec(s * angles, degrees=True) for s in np.linspace(0, 1, 7)]
    rows = [w.as_euler("YXZ", degrees=True)[[1, 0, 2]] for w in ways]
    steps = solve(turning(*map(tuple, rows), largest_step="6 deg"), stages(6))
    assert max(s.iterations for s in steps[1:]) <= 5
    spent = np.diff([s.dissipated for s in steps])
    for step, energy in zip(steps[-2:], spent[-2:], strict=True):
        θ = float(np.linalg.norm(step.turn))
        assert np.degrees(θ) == pytest.approx(5)
        assert energy == pytest.approx(step.spends, rel=1e-8)
        arms = R * np.linalg.norm(np.cross(step.turn / θ, step.normal), axis=1)
        assert step.spends == pytest.approx(θ * MU * step.load @ arms, rel=1e-8)
    # As for a load that is spread over the cup, a little more than that of one point.
    assert 1.0 < np.linalg.norm(steps[-1].torque) / (MU * R * np.linalg.norm(FORCE)) < 1.1


def test_finite_sliding_dissipation_is_independent_of_steps() -> None:
    """Swings of 25 degrees have 4, 8 and 20 steps."""
    cycles = []
    for increments in (4, 8, 20):
        steps = solve(SWING, stages(increments, cycles=3))
        ends = [steps[k * increments] for k in range(4)]
        _, second, third = np.diff([s.dissipated for s in ends])
        assert second == pytest.approx(third, rel=1e-9)
        same([ends[2]._replace(dissipated=0)], [ends[3]._replace(dissipated=0)], 1e-7)
        assert max(s.iterations for s in steps[1:]) <= 5
        cycles.append(second)
    assert cycles[0] == pytest.approx(cycles[2], rel=1e-5)
    assert cycles[1] == pytest.approx(cycles[2], rel=1e-5)


def test_finite_sliding_results_are_invariant_under_rotation() -> None:
    """The model is rotated as a whole, then the mesh of the head below it too."""
    angles = [(0, 0, 0), (4, 5, -3), (9, 12, -5), (3, 20, 2)]
    one = solve(turning(*angles, largest_step="30 deg"), stages(3))
    data, Q = built(), ROTATION
    x, head = data.points @ Q.T, np.unique(data.cells[data.cell_tags == data.regions["head"]])
    x[head] = x[head] @ Q.T
    T = Rotation.from_matrix(Q)
    ways = [T * Rotation.from_euler("YXZ", (b, a, c), degrees=True) * T.inv() for a, b, c in angles]
    rows = [W.as_euler("ZYX", degrees=True)[::-1] for W in ways]
    other = solve(
        turning(*map(tuple, rows), axes="zyx", largest_step="30 deg"),
        stages(3),
        f"loads.hip.force={vector(Q @ FORCE, ' N')}",
        tagged=distribute(replace(data, points=x), MPI.COMM_WORLD),
    )
    same(other, one, 1e-8, Q)


def test_finite_sliding_load_follows_the_head() -> None:
    """The load equals that of a cycle table with the rotated components."""
    follows = solve(QUARTER, stages(5), "loads.hip.follows=ball")
    ways = [Rotation.from_euler("Y", 5 * k, degrees=True).as_matrix() for k in range(6)]
    same(follows, solve(QUARTER, stages(5), loaded(*(W @ FORCE for W in ways))), 1e-8)
    np.testing.assert_allclose(follows[-1].force, ways[-1] @ FORCE, rtol=1e-10)


def test_finite_sliding_time_course_starts_at_its_first_row() -> None:
    """A course that begins at some degrees acts as if the head had been pressed in before."""
    given = loaded(FORCE, FORCE)
    at_once, pressed = solve(QUARTER, stages(5, press=0), given), solve(QUARTER, stages(5), given)
    np.testing.assert_allclose(at_once[0].force, FORCE, rtol=1e-10)
    assert len(at_once) == len(pressed) - 1
    same([at_once[-1]._replace(dissipated=0)], [pressed[-1]._replace(dissipated=0)], 1e-5)


def test_finite_sliding_over_a_rigid_ellipsoid_equals_that_over_a_stiff_one() -> None:
    """No formula describes the head, which is 0.4 % longer along z.

    It is rigid, or has 21,000 GPa.
    """
    data = built()
    x, head = data.points.copy(), np.unique(data.cells[data.cell_tags == data.regions["head"]])
    x[head] *= [1.0, 1.0, 1.004]
    tagged = distribute(replace(data, points=x), MPI.COMM_WORLD)
    stiff = "regions.head={youngs_modulus: 21000 GPa, poisson_ratio: 0.3}"
    rigid = solve(QUARTER, stages(3), tagged=tagged)[-1]
    elastic = solve(DRIVEN, stages(3), stiff, tagged=tagged)[-1]
    assert support.difference(rigid.load, elastic.load) < 1e-3
    assert support.difference(rigid.torque, elastic.torque) < 1e-4
    assert rigid.dissipated == pytest.approx(elastic.dissipated, rel=1e-4)


def test_finite_sliding_head_with_held_centre() -> None:
    """An interference presses the head.

    Its centre stays, and the work of the torque is dissipated.
    """
    held = turning((0, 0, 0), (0, 25, 0), translation="held")
    steps = solve(held, stages(5), "interfaces.bearing.gap=-0.15 mm")
    assert all((s.place == 0).all() for s in steps)
    assert steps[-1].load.sum() > 1e4
    spent = steps[-1].dissipated - steps[-2].dissipated
    assert spent == pytest.approx(steps[-1].spends, rel=1e-8)


@pytest.mark.parametrize("soft", [False, True])
def test_finite_sliding_friction_varies_on_one_model(soft: bool) -> None:
    """Matrices are reused; angles and slip of the head are not."""
    runs, elastic = Runs(), "regions.head={youngs_modulus: 210 GPa, poisson_ratio: 0.3}"
    changes = [elastic] if soft else []
    for k, μ in enumerate((MU, 0, 0.2)):
        turn = turning((0, 0, 0), (5, 10 + k, 0), **{"boundary": "head_bore"} if soft else {})
        case = support.case(CUP, turn, stages(2), f"{FRICTION}={μ}", *changes)
        reused, expected = runs.run(case)[0], Runs().run(case)[0]
        for u, v in zip(reused, expected, strict=True):
            assert support.difference(u, v) < 1e-8
        assert runs.last and len(runs.last._other_models) == 1


@pytest.mark.parametrize("μ", [0, MU])
@pytest.mark.parametrize("force", [(0, 0, 20), (1500, 0, 1500)])
def test_finite_sliding_head_comes_into_contact(
    μ: float, force: tuple[float, float, float]
) -> None:
    """Nothing touches at first. A few points bear a small load."""
    changes = (f"{FRICTION}={μ}", f"loads.hip.force={vector(force, ' N')}")
    clearance = "geometry.radial_clearance=0.02 mm"
    tagged = support.mesh(support.case(CUP, clearance))
    steps = solve(*changes, clearance, QUARTER, stages(1), tagged=tagged)
    assert steps[0].iterations <= 12
    np.testing.assert_allclose(steps[0].force, force, rtol=1e-9, atol=1e-8)


def test_finite_sliding_head_outside_its_cup_is_an_error() -> None:
    """The head is off its cup from the start, or in the middle of a cycle table.

    A step over a large distance converges or fails by rounding, and both are reported.
    """
    message = r"(head.* and the loads act in this|more than the interface's size).*\[loose-body\]"
    for load in (loaded(-FORCE, -FORCE), loaded(FORCE, -FORCE)):
        with pytest.raises(ConvergenceError, match=message):
            solve(QUARTER, stages(5), load)
