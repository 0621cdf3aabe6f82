"""Loads have the resultant and the moment of the case."""

from __future__ import annotations

import numpy as np
import pytest

from app.case.case import load_case
from app.foundation.errors import InputError
from app.mechanics.problem import Problem
from tests import support

CYLINDERS = (
    support.STEM.replace("length: 20 mm", "length: 30 mm")
    .replace("size: 5 mm", "size: 4 mm")
    .replace("[300 N, 0 N, -900 N]", "[150 N, -80 N, -900 N]")
)


def nodal_moment(problem: Problem, about: tuple[float, float, float]) -> np.ndarray:
    """Moment of the nodal forces at the end of the first stage about a point [N mm]."""
    x = problem.space.tabulate_dof_coordinates()
    forces = problem.forces.applied(1.0).nodal.reshape(-1, 3)
    return np.cross(x[: len(forces)] - np.array(about), forces).sum(axis=0)


def assembled(text: str, *overrides: str) -> Problem:
    return support.assemble(support.case(text, *overrides))[0]


@pytest.mark.parametrize("order", [1, 2])
def test_loads_force_at_a_point_has_resultant_and_moment(order: int) -> None:
    """A linear traction over the patch has the resultant F.

    Its moment about the point of the force is zero.
    """
    at = (40.0, 5.0, 60.0)
    where = f"loads.hip.at=[{at[0]} mm, {at[1]} mm, {at[2]} mm]"
    problem = assembled(CYLINDERS, f"mesh.order={order}", where, "interfaces={}")
    force = np.array([150.0, -80.0, -900.0])
    np.testing.assert_allclose(problem.forces.resultants(1.0)[0], force, rtol=1e-11)
    scale = np.linalg.norm(force) * np.linalg.norm(at)
    assert np.abs(nodal_moment(problem, at)).max() < 1e-12 * scale


def test_loads_even_force_acts_at_the_centroid() -> None:
    """Without a point the traction is uniform, without a moment about the patch's centroid."""
    problem = assembled(CYLINDERS, "interfaces={}")
    moment = nodal_moment(problem, tuple(problem.body_forms.patch("stem_top").centroid))
    assert np.abs(moment).max() < 1e-12 * 900 * 30


@pytest.mark.parametrize("order", [1, 2])
def test_loads_varying_body_force_has_resultant_and_moment(order: int) -> None:
    """Polynomials of second degree on a box have integrals by hand."""
    text = """
geometry: {kind: blocks, blocks: [{name: low, size: [4 mm, 3 mm, 2 mm]},
                                  {name: high, size: [4 mm, 3 mm, 2 mm]}]}
mesh: {order: 1, size: 2 mm, far_size: 2 mm}
regions:
  low: {youngs_modulus: 100 MPa, poisson_ratio: 0.3}
  high: {youngs_modulus: 100 MPa, poisson_ratio: 0.3}
supports: {base: {kind: fixed, boundary: bottom}}
loads:
  b: {kind: body_force, regions: [high], density: "[x * y, z**2, 2e-2 N/mm^3]", history: [2]}
"""
    solved = support.solve(text, f"mesh.order={order}", balances=True)
    # Over 0..4, 0..3, 2..4, twice.
    exact = 2 * np.array([8 * 4.5 * 2, 12 * 56 / 3, 24 * 0.02])
    np.testing.assert_allclose(
        solved.problem.forces.resultants(solved.problem.time)[0], exact, rtol=1e-12
    )
    m_x = 2 * (12 * 1.5 * 0.04 - 12 * (4**4 - 2**4) / 4)
    m_y = 2 * (8 * 4.5 * 6 - 3 * 8 * 2 * 0.02)
    m_z = 2 * (8 * 3 * 56 / 3 - 8 * 9 * 2)
    moment = nodal_moment(solved.problem, (0.0, 0.0, 0.0))
    np.testing.assert_allclose(moment, [m_x, m_y, m_z], rtol=1e-12)
    assert solved.balances.max() < 1e-9


def test_loads_varying_load_is_evaluated_only_in_its_regions() -> None:
    """An expression needs to be finite in its regions only. The error names the key."""
    density = "density: ['log(hypot(x, y) - 10)', 0 N/mm^3, 0 N/mm^3]"
    bone = f"loads.hip={{kind: body_force, regions: [bone], {density}}}"
    problem = assembled(CYLINDERS, "geometry.taper=0 deg", bone)
    # The middle of the bone's cells is beyond 10 mm, its inner surface at 11 mm.
    assert np.isfinite(problem.forces.resultants(1.0)[0]).all()
    with pytest.raises(InputError, match=r"loads\.hip\.density\[0\]: .*not finite at"):
        assembled(CYLINDERS, bone.replace("[bone]", "[stem]"))


@pytest.mark.parametrize("size", [8, 6])
def test_loads_of_the_stance_are_independent_of_facets(size: int) -> None:
    """Hip and muscles act through points of the femur, for any facets of the mesh."""
    case = load_case(
        support.CONFIGS / "stance.yaml", [f"mesh.size={size} mm", "mesh.order=1", "interfaces={}"]
    ).config
    points = {"hip": case.geometry.head_centre, **case.geometry.points}
    arms = [points[name if name == "hip" else load.boundary] for name, load in case.loads.items()]
    forces = np.array([load.force for load in case.loads.values()])
    moment = np.cross(np.array(arms), forces).sum(axis=0)
    problem, _ = support.assemble(case)
    np.testing.assert_allclose(nodal_moment(problem, (0, 0, 0)), moment, rtol=1e-9)
