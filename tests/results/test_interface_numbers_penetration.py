"""Penetration between contact points: curved facets, and an independent distance of surfaces."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from app.foundation.arrays import Floats, Ints
from app.interfaces.interface_facets import InterfaceFacets
from app.results.interface_numbers import LATTICE, gaps
from meshes.facets import facet_shape_functions, normals_and_areas
from tests.support import STEM, Solved, solve

MIDDLES = ((1, 2), (0, 2), (0, 1))
PRESSED = """
geometry: {kind: blocks, blocks: [{name: base, size: [10 mm, 10 mm, 5 mm]},
                                  {name: upper, size: [10 mm, 10 mm, 5 mm]}]}
mesh: {order: 2, size: 5 mm}
regions: {base: &one {youngs_modulus: 1 GPa, poisson_ratio: 0}, upper: *one}
interfaces:
  base_upper: {kind: penalty, penalty: 1000 MPa/mm, friction_coefficient: 0}
supports:
  below: {kind: fixed, boundary: bottom}
  side: {kind: displacement, boundary: top, x: 0 mm, y: 0 mm}
loads: {weight: {kind: pressure, boundary: top, pressure: 2 MPa}}
"""


def on_a_cylinder(radius: float, angle: float) -> tuple[InterfaceFacets, Floats]:
    """One curved facet on a cylinder about z, with its master inside, and its nodes."""
    phi = np.array([0.0, angle, 0.0])
    z = np.array([0.0, 0.0, 1.0])
    phi = np.concatenate([phi, [phi[list(e)].mean() for e in MIDDLES]])
    z = np.concatenate([z, [z[list(e)].mean() for e in MIDDLES]])
    nodes = np.stack([radius * np.cos(phi), radius * np.sin(phi), z], axis=1)
    none: Ints = np.zeros((1, 3), dtype=np.int64)
    facets = InterfaceFacets(
        interface=none[:, 0],
        vertices=none,
        bodies=np.array([[0, 1]]),
        dofs=none,
        nodes=nodes[None],
        normal=(nodes[None, :3] * (1, 1, 0)) / radius,
        area=np.ones((1, 3)),
        stiffness=np.ones((1, 2)),
        rounded_angle=np.zeros(1),
    )
    return facets, nodes


def test_interface_numbers_penetration_of_sliding_along_a_curved_facet_is_zero() -> None:
    """Rotation about the axis keeps a distance of 0. Translation opens by c . n, widening by w."""
    facets, x = on_a_cylinder(7.0, 0.3)
    rows = np.zeros(1, dtype=np.int64)
    radial = x * (1, 1, 0) / 7.0
    turned = np.cross([0, 0, 0.01], x)
    gap, _ = gaps(facets, rows, turned[None], np.zeros((1, 3)))
    # A parabola through the ends and the middle of an arc has at its ends the slopes 2 tan(θ/4),
    # not tan(θ/2): normals there are off by θ^3 / 32.
    assert np.abs(gap).max() == pytest.approx(0.01 * 7.0 * 0.3**3 / 32, rel=0.02)
    gap, _ = gaps(facets, rows, 0.01 * radial[None], np.zeros((1, 3)))
    np.testing.assert_allclose(gap, 0.01, rtol=2e-4)
    gap, area = gaps(facets, rows, -0.004 * radial[None], np.full((1, 3), 0.01))
    np.testing.assert_allclose(gap, 0.006, rtol=2e-4)
    # Of a right triangle with legs of 0.3 * 7 and 1: twice its area everywhere.
    np.testing.assert_allclose(area, 2.1, rtol=0.3**2 / 12)


def distances(s: Solved, i: int) -> Floats:
    """Signed distances of points of the deformed slave surface to the deformed master surface.

    The distance is along the normal at the nearest of many points of the master's facets.
    """
    j = s.problem.contact
    facets = j.facets
    rows = np.flatnonzero(facets.interface == i)
    dofs = facets.dofs[rows]
    moved = [u.x.array.reshape(-1, 3) for u in s.problem.displacements()]
    rest = facets.nodes[rows]
    master, slave = (
        rest + np.array([moved[b][d] for b, d in zip(body[rows], dofs, strict=True)])
        for body in facets.bodies.T
    )
    points = np.einsum("qn,fni->fqi", facet_shape_functions(LATTICE, 6), slave).reshape(-1, 3)
    a, b = np.meshgrid(np.linspace(0, 1, 101), np.linspace(0, 1, 101))
    fine = np.column_stack([(1 - a - b).ravel(), a.ravel(), b.ravel()])[(a + b).ravel() < 1 + 1e-9]
    outwards = np.sign(
        np.einsum("fi,fi->f", normals_and_areas(rest, fine[:1])[0][:, 0], facets.normal[rows, 0])
    )
    normals = (normals_and_areas(master, fine)[0] * outwards[:, None, None]).reshape(-1, 3)
    dense = np.einsum("qn,fni->fqi", facet_shape_functions(fine, 6), master).reshape(-1, 3)
    _, nearest = cKDTree(dense).query(points)
    return np.einsum("pi,pi->p", points - dense[nearest], normals[nearest])


@pytest.mark.slow
def test_interface_numbers_penetration_is_the_distance_of_deformed_surfaces() -> None:
    """Distances are along the normals of the deformed facets, up to what small motions neglect."""
    s = solve(STEM, "mesh.order=2", "mesh.size=3.5 mm")
    deepest = -distances(s, 0).min()
    assert deepest > 1e-4
    assert s.interfaces["stem_cement"]["penetration_sampled"] == pytest.approx(deepest, rel=0.3)


def test_interface_numbers_penetration_of_a_penalty_is_equal_between_points() -> None:
    """Both methods are measured alike.

    On plane facets the value between points is that at points.
    """
    s = solve(PRESSED)
    q = s.interfaces["base_upper"]
    for what in ("max", "sampled", "mean"):
        assert q[f"penetration_{what}"] == pytest.approx(2 / 1000, rel=1e-9)
