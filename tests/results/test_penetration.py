"""Penetration between contact points: curved facets, and an independent distance of surfaces."""

from __future__ import annotations

import numpy as np
import pytest

from app.arrays import Floats, Ints
from app.results.penetration import LATTICE, gaps
from meshes.contact_facets import InterfaceFacets, shape_functions, surface
from tests.support import STEM, Solved, solve

MIDDLES = ((1, 2), (0, 2), (0, 1))
PRESSED = """
geometry:
  kind: blocks
  blocks: [{name: base, size: [10 mm, 10 mm, 5 mm]}, {name: upper, size: [10 mm, 10 mm, 5 mm]}]
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
    """One curved facet on a cylinder about z, its master inside; and its nodes."""
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
    )
    return facets, nodes


def test_a_slide_along_a_curved_facet_opens_nothing() -> None:
    """Turning about the axis keeps a distance of 0, moving aside opens by c . n, widening by w."""
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


def distances(s: Solved, i: int, steps: int) -> Floats:
    """Signed distances of points of the deformed slave surface to the deformed master surface.

    The nearest of all facets' points, by Newton's method on their shape functions; its sign is that
    of the way along the normal of the deformed facet there.
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
    points = np.einsum("qn,fni->fqi", shape_functions(LATTICE, 6), slave).reshape(-1, 3)
    nearest, signed = np.full(len(points), np.inf), np.zeros(len(points))
    for f, x in zip(rows, master, strict=True):
        close = np.flatnonzero(np.linalg.norm(points - x.mean(axis=0), axis=1) < 8.0)
        at = np.full((len(close), 2), 1 / 3)
        for _ in range(steps):
            bary = np.column_stack([1 - at.sum(axis=1), at])
            y = shape_functions(bary, 6) @ x
            t = _tangents(bary, x)
            left = points[close] - y
            gram = np.einsum("pki,pli->pkl", t, t)
            right = np.einsum("pki,pi->pk", t, left)
            at = at + np.clip(np.linalg.solve(gram, right[:, :, None])[:, :, 0], -0.5, 0.5)
        bary = np.column_stack([1 - at.sum(axis=1), at])
        left = points[close] - shape_functions(bary, 6) @ x
        n = np.stack([surface(x[None], b[None])[0][0, 0] for b in bary])
        outwards = np.sign(surface(rest[rows == f], np.eye(3))[0][0, 0] @ facets.normal[f, 0])
        far = np.linalg.norm(left, axis=1)
        better = (bary > -1e-9).all(axis=1) & (far < nearest[close])
        nearest[close[better]] = far[better]
        signed[close[better]] = outwards * np.einsum("pi,pi->p", left, n)[better]
    return signed[np.isfinite(nearest)]


def _tangents(bary: Floats, x: Floats) -> Floats:
    """Derivatives of a curved facet's points by its second and third coordinate (p, 2, 3)."""
    h = 1e-6
    ways = np.array([[-1, 1, 0], [-1, 0, 1]]) * h
    return np.stack(
        [(shape_functions(bary + w, 6) - shape_functions(bary - w, 6)) @ x / (2 * h) for w in ways],
        axis=1,
    )


@pytest.mark.slow
def test_it_is_the_distance_of_the_deformed_surfaces() -> None:
    """Along the normals of the deformed facets, to what small motions neglect: slip^2 / 2 R."""
    s = solve(STEM, "mesh.order=2", "mesh.size=3.5 mm")
    found = s.interfaces["stem_cement"]
    deepest = -distances(s, 0, 8).min()
    neglected = found["slip_max"] ** 2 / (2 * 7.0)
    assert deepest > 1e-4
    assert abs(found["penetration_sampled"] - deepest) < 2 * neglected


def test_a_penalty_penetrates_between_points_as_at_points() -> None:
    """Both methods are measured alike: on plane facets between points is what is at points."""
    s = solve(PRESSED)
    q = s.interfaces["base_upper"]
    for what in ("max", "sampled", "mean"):
        assert q[f"penetration_{what}"] == pytest.approx(2 / 1000, rel=1e-9)
