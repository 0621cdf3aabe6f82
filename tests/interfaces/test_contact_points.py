"""Rules of ``contact_points``: normals, edges, bodies that meet on a line, held parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest
from numpy.typing import NDArray

import meshes
from app.campaigns.work_precision import fitted_order
from app.foundation.arrays import Floats
from app.interfaces.contact_points import contact_points
from app.interfaces.corners import ContactPoints, Entries, VertexConstraints
from app.interfaces.interface_facets import InterfaceFacets, sorted_facets
from app.interfaces.smooth_normals import slid_along
from app.verification.changed_meshes import ROTATION
from meshes.distribute import distribute
from tests import support

NONE = np.zeros(0, np.int64)
NOTHING_HELD = VertexConstraints(NONE, NONE, np.zeros((0, 3), np.int64), np.zeros(0, bool))


def facets_of(
    triangles: Sequence[Floats],
    interface: Sequence[int],
    master: Sequence[int],
    slave: Sequence[int],
    inside: Sequence[Floats],
    stiffness: Floats | None = None,
    rounded_angle: float = 0.0,
) -> tuple[InterfaceFacets, Floats]:
    """Facets from triangles by coordinates, and the coordinates of the vertices they share."""
    corners = np.array(triangles)
    x, number = np.unique(corners.reshape(-1, 3).round(9), axis=0, return_inverse=True)
    vertices = number.reshape(-1, 3).astype(np.int64)
    n = len(corners)
    return (
        sorted_facets(
            np.array(interface, np.int64),
            vertices,
            np.array([master, slave], np.int64).T,
            vertices.copy(),
            corners,
            np.array(inside, dtype=float),
            np.zeros((n, 2)) if stiffness is None else stiffness,
            np.full(n, rounded_angle),
        ),
        x,
    )


def between(triangles: Sequence[Floats], inside: Sequence[float]) -> tuple[InterfaceFacets, Floats]:
    """Facets of one interface between body 0 and body 1, the slave, which has a point inside."""
    m = len(triangles)
    return facets_of(triangles, [0] * m, [0] * m, [1] * m, [np.array(inside)] * m)


def patch(origin: Sequence[float], a: Sequence[float], b: Sequence[float], n: int) -> list[Floats]:
    """A parallelogram as 2 n² triangles."""
    o, a, b = (np.array(v, dtype=float) for v in (origin, a, b))
    out = []
    for i in range(n):
        for j in range(n):
            p = [o + a * (i + k) / n + b * (j + m) / n for k, m in ((0, 0), (1, 0), (1, 1), (0, 1))]
            out += [np.array([p[0], p[1], p[2]]), np.array([p[0], p[2], p[3]])]
    return out


def box_in_a_box(n: int = 3) -> tuple[InterfaceFacets, Floats]:
    """The unit cube (body 1, the slave) in its container (body 0)."""
    triangles = []
    for k in range(3):
        a, b = np.eye(3)[(k + 1) % 3], np.eye(3)[(k + 2) % 3]
        triangles += patch([0, 0, 0], a, b, n) + patch(np.eye(3)[k], a, b, n)
    return between(triangles, [0.5, 0.5, 0.5])


def test_contact_points_of_a_box_in_a_box() -> None:
    """One face inside a side, two on its edges, three at its corners, each with its normal."""
    facets, x = box_in_a_box()
    points, _ = contact_points(facets, NOTHING_HELD, ["a"], {})
    np.testing.assert_allclose(points.x, x[points.vertex], atol=1e-8)
    walls = (np.abs(points.x) < 1e-9) | (np.abs(points.x - 1) < 1e-9)
    np.testing.assert_array_equal(points.faces, walls.sum(axis=1))
    assert set(points.faces.tolist()) == {1, 2, 3}
    for p in range(len(points.x)):
        # From the container to the cube: inwards.
        inward = {
            tuple(np.eye(3)[k] * np.sign(0.5 - points.x[p, k])) for k in range(3) if walls[p, k]
        }
        normals = {tuple(v.round(12) + 0.0) for v in points.normals[p, : points.faces[p]]}
        assert normals == {tuple(np.array(v) + 0.0) for v in inward}
        assert not points.normals[p, points.faces[p] :].any()
    assert points.weight.sum() == pytest.approx(6.0, abs=1e-12)


@pytest.mark.parametrize(("angle", "faces"), [(10, 1), (29, 1), (31, 2), (60, 2), (90, 2)])
def test_contact_points_faces_split_above_30_degrees(angle: float, faces: int) -> None:
    """Two half planes that meet at an angle: one averaged normal below 30 degrees, two above."""
    t = np.deg2rad(angle)
    up = np.array([-np.cos(t), 0.0, -np.sin(t)])
    triangles = patch([0, 0, 0], [1, 0, 0], [0, 1, 0], 2) + patch([0, 0, 0], up, [0, 1, 0], 2)
    facets, _ = between(triangles, [0, 0.5, 1])
    points, _ = contact_points(facets, NOTHING_HELD, ["a"], {})
    ridge = np.abs(points.x[:, 0]) + np.abs(points.x[:, 2]) < 1e-9
    assert (points.faces[ridge] == faces).all()
    assert (points.faces[~ridge] == 1).all()
    n = points.normals[ridge]
    if faces == 1:
        half = t / 2
        exact = np.array([-np.sin(half), 0, np.cos(half)])
        assert np.abs(n[:, 0] - exact).max() < 1e-12
    else:
        cosines = np.einsum("pi,pi->p", n[:, 0], n[:, 1])
        np.testing.assert_allclose(cosines, np.cos(t), atol=1e-12)


@pytest.mark.parametrize(("angle", "faces"), [(31, 1), (59, 1), (61, 2)])
def test_contact_points_faces_join_at_rounded_edges(angle: float, faces: int) -> None:
    """Up to the angle that a geometry with rounded edges gives."""
    t = np.deg2rad(angle)
    up = np.array([-np.cos(t), 0.0, -np.sin(t)])
    triangles = patch([0, 0, 0], [1, 0, 0], [0, 1, 0], 2) + patch([0, 0, 0], up, [0, 1, 0], 2)
    n = len(triangles)
    inside = [np.array([0.0, 0.5, 1.0])] * n
    facets, _ = facets_of(
        triangles, [0] * n, [0] * n, [1] * n, inside, rounded_angle=np.deg2rad(60)
    )
    points, _ = contact_points(facets, NOTHING_HELD, ["a"], {})
    ridge = np.abs(points.x[:, 0]) + np.abs(points.x[:, 2]) < 1e-9
    assert (points.faces[ridge] == faces).all()


def test_contact_points_have_at_most_three_faces() -> None:
    """The tip of a pyramid has four: the closest are merged, and all the area is kept."""
    rim = [np.array([np.cos(a), np.sin(a), 0]) for a in np.pi / 2 * np.arange(4)]
    tip = np.array([0, 0, 1.0])
    triangles = [np.array([tip, rim[k], rim[(k + 1) % 4]]) for k in range(4)]
    facets, _ = between(triangles, [0, 0, 0])
    points, _ = contact_points(facets, NOTHING_HELD, ["a"], {})
    at = np.abs(points.x - tip).max(axis=1) < 1e-9
    assert points.faces[at] == [3]
    assert points.weight[at] == pytest.approx(facets.area.sum() / 3)
    n = points.normals[at][0]
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1)
    assert np.linalg.det(n @ n.T) > 0.05


@pytest.mark.parametrize("Q", [ROTATION, np.diag([1.0, -1.0, 1.0])], ids=["turned", "mirrored"])
def test_contact_points_faces_are_independent_of_axes(Q: Floats) -> None:
    """The order of the faces decides which bears the force of a point that sticks."""
    facets, _ = box_in_a_box()
    turned = replace(facets, nodes=facets.nodes @ Q.T, normal=facets.normal @ Q.T)
    one, other = (contact_points(f, NOTHING_HELD, ["a"], {})[0] for f in (facets, turned))
    assert set(one.faces.tolist()) == {1, 2, 3}
    np.testing.assert_allclose(other.normals, one.normals @ Q.T, atol=1e-12)


# Motion of bodies with jumps


def moves(entries: Entries, dof: int, bodies: int, jumps: int) -> Floats:
    """Matrix (3 bodies, 3 jumps): what the jumps add to each body at a vertex."""
    B = np.zeros((3 * bodies, 3 * jumps))
    here = entries.row // 3 == dof
    for body, row, column, value in zip(
        *(v[here] for v in (entries.body, entries.row, entries.column, entries.value)), strict=True
    ):
        B[3 * body + row % 3, column] += value
    return B


def check_jumps(points: ContactPoints, entries: Entries, bodies: int) -> None:
    """At every vertex the slave minus the master moves by exactly the jump of the point."""
    n = len(points.x)
    for p in range(n):
        B = moves(entries, int(points.dof[p]), bodies, n).reshape(bodies, 3, 3 * n)
        master, slave = points.bodies[p]
        jump = np.zeros((3, 3 * n))
        jump[:, 3 * p : 3 * p + 3] = np.eye(3)
        free = ~points.is_prescribed[p]
        np.testing.assert_allclose((B[slave] - B[master])[free], jump[free], atol=1e-14)


def check_mean_jumps(points: ContactPoints, entries: Entries, bodies: int) -> None:
    """At every corner of an interface the slave moves against the master by the true jump.

    The jump of a point is the mean of its corner and its part of the dependent ones.
    """
    surface, n = points.surface, len(points.x)
    of = surface.dependence
    every = surface.true_jumps(np.zeros((n, 3)))
    true = np.eye(3 * n) if of is None else of.jumps.toarray()
    assert len(every) == len(surface.x)
    for c in range(len(surface.x)):
        B = moves(entries, int(surface.dof[c]), bodies, n).reshape(bodies, 3, 3 * n)
        master, slave = surface.bodies[c]
        free = ~points.is_prescribed[points.vertex == surface.vertex[c]].any(axis=0)
        jump = true[3 * c : 3 * c + 3]
        np.testing.assert_allclose((B[slave] - B[master])[free], jump[free], atol=1e-12)
    if of is not None:  # forces on points do the same work on all corners
        areas = np.repeat(surface.weight, 3), np.repeat(points.weight, 3)
        work = (of.forces.toarray().T * areas[0]) @ true / areas[1][:, None]
        free = ~points.is_prescribed.ravel()
        np.testing.assert_allclose(work[free], np.eye(3 * n)[free], atol=1e-12)


def three_on_a_line(*moduli: float) -> tuple[InterfaceFacets, Floats]:
    """Three bodies around the z axis, each in a third of space; three interfaces meet on it."""
    triangles, interface, master, slave, inside = [], [], [], [], []
    for k, (m, s) in enumerate([(0, 1), (1, 2), (0, 2)]):
        a = 2 * np.pi / 3 * (k + 1)
        new = patch([0, 0, 0], [np.cos(a), np.sin(a), 0], [0, 0, 1], 2)
        middle = (2 * s + 1) * np.pi / 3
        triangles += new
        interface += [k] * len(new)
        master += [m] * len(new)
        slave += [s] * len(new)
        inside += [np.array([np.cos(middle), np.sin(middle), 0.5])] * len(new)
    of = np.array(moduli or (1.0, 1.0, 1.0))[np.stack([master, slave], axis=1)]
    return facets_of(triangles, interface, master, slave, inside, of)


def test_contact_points_stiffest_body_is_the_base() -> None:
    """It is the field u itself wherever no support holds another one."""
    facets, _ = three_on_a_line(2.0, 1.0, 3.0)
    points, entries = contact_points(facets, NOTHING_HELD, ["a", "b", "c"], {})
    for p in range(len(points.x)):
        B = moves(entries, int(points.dof[p]), 3, len(points.x)).reshape(3, 3, -1)
        moved = {body for body in range(3) if B[body].any()}
        here = set(points.bodies[points.vertex == points.vertex[p]].ravel())
        assert moved == here - {max(here, key=[2, 1, 3].__getitem__)}
    check_mean_jumps(points, entries, 3)


def test_contact_points_of_three_bodies_have_two_jumps() -> None:
    """Bodies minus one; interfaces that are alike are taken by name, the last one is dependent."""
    facets, x = three_on_a_line()
    points, entries = contact_points(facets, NOTHING_HELD, ["a", "b", "c"], {})
    line = np.flatnonzero(np.hypot(x[:, 0], x[:, 1]) < 1e-9)
    assert len(line) == 3
    for v in range(len(x)):
        here = points.vertex == v
        assert here.sum() == (2 if v in line else 1)
        if v in line:
            assert sorted(points.interface[here]) == [0, 1]
            B = moves(entries, int(points.dof[here][0]), 3, len(points.x))
            # With u itself all three bodies move freely of each other.
            with_u = np.column_stack([np.tile(np.eye(3), (3, 1)), B])
            assert np.linalg.matrix_rank(with_u) == 9
    check_mean_jumps(points, entries, 3)
    # No facet and no area is lost.
    assert sum(map(len, points.triangles)) == len(facets.area)
    assert points.weight.sum() == pytest.approx(facets.area.sum(), rel=1e-14)
    for i in range(3):
        area = points.weight[points.interface == i].sum()
        assert area == pytest.approx(facets.area[facets.interface == i].sum(), rel=1e-14)


def hold(where: NDArray, bodies: Sequence[int], component: int) -> VertexConstraints:
    """Support 0 holds a component of some bodies at some vertices."""
    vertex = np.flatnonzero(where).astype(np.int64)
    support = np.full((len(vertex) * len(bodies), 3), -1, dtype=np.int64)
    support[:, component] = 0
    rigid = np.zeros(len(support), dtype=bool)
    return VertexConstraints(
        np.tile(vertex, len(bodies)), np.repeat(bodies, len(vertex)), support, rigid
    )


def flat(slope: float = 0.0) -> tuple[InterfaceFacets, Floats]:
    """A plane interface: body 1, the slave, on top of body 0."""
    return between(patch([0, 0, 0], [1, 0, 0], [0, 1, slope], 2), [0.5, 0.5, 1])


def test_contact_points_held_slave_is_the_base() -> None:
    """Where only the slave is held it is the field u itself, and the master moves by minus q."""
    facets, x = flat()
    points, entries = contact_points(facets, hold(x[:, 0] < 1e-9, [1], 0), ["a"], {})
    assert not points.is_prescribed.any()
    assert (points.faces == 1).all()
    for p in range(len(points.x)):
        B = moves(entries, int(points.dof[p]), 2, len(points.x))[:, 3 * p : 3 * p + 3]
        base = 1.0 if points.x[p, 0] < 1e-9 else 0.0
        np.testing.assert_array_equal(B[:3], -np.diag([base, 0, 0]))
        np.testing.assert_array_equal(B[3:], np.diag([1 - base, 1, 1]))
    check_jumps(points, entries, 2)


def test_contact_points_jump_is_prescribed_where_both_sides_are_held() -> None:
    """The jump of a component that both sides hold is given, and normals drop the component."""
    facets, x = flat(0.2)
    points, _ = contact_points(facets, hold(x[:, 1] < 1e-9, [0, 1], 1), ["a"], {})
    held = points.x[:, 1] < 1e-9
    np.testing.assert_array_equal(points.is_prescribed, np.outer(held, [False, True, False]))
    assert (points.prescribing_support[held, 1] == 0).all()
    exact = np.where(held[:, None], [0, 0, 1], np.array([0, -0.2, 1]) / np.hypot(0.2, 1))
    np.testing.assert_allclose(points.normals[:, 0], exact, atol=1e-12)
    assert points.weight.sum() == pytest.approx(facets.area.sum())
    # Along the normal: the contact law has nothing to say there.
    facets, x = flat()
    points, _ = contact_points(facets, hold(x[:, 1] < 1e-9, [0, 1], 2), ["a"], {})
    np.testing.assert_array_equal(points.faces, np.where(points.x[:, 1] < 1e-9, 0, 1))


def test_contact_points_of_a_chain_between_held_bodies() -> None:
    """The outer two of a chain held: both jumps in that direction are given.

    Where the two are in contact as well their jump alone is, and the third body moves freely.
    """
    facets, x = three_on_a_line()
    holds = hold(np.hypot(x[:, 0], x[:, 1]) < 1e-9, [0, 2], 2)
    chain = facets.interface < 2
    apart = InterfaceFacets(*(v[chain] for v in vars(facets).values()))
    points, entries = contact_points(apart, holds, ["a", "b"], {})
    line = np.hypot(points.x[:, 0], points.x[:, 1]) < 1e-9
    np.testing.assert_array_equal(points.is_prescribed, np.outer(line, [False, False, True]))
    check_mean_jumps(points, entries, 3)
    for names in (["a", "b", "c"], ["c", "b", "a"]):
        points, entries = contact_points(facets, holds, names, {})
        line = np.hypot(points.x[:, 0], points.x[:, 1]) < 1e-9
        given = line & (points.interface == 2)
        assert given.sum() == 3
        np.testing.assert_array_equal(points.is_prescribed, np.outer(given, [False, False, True]))
        check_mean_jumps(points, entries, 3)


# On real meshes

CYLINDERS = """
geometry:
  kind: cylinders
  stem_radius: 7 mm
  cement_thickness: 3 mm
  bone_thickness: 4 mm
  length: 8 mm
  taper: {taper} deg
  sector: {sector}
mesh: {{size: {size} mm, far_size: 4 mm}}
regions:
  stem: {{youngs_modulus: 110 GPa, poisson_ratio: 0.3}}
  cement: {{youngs_modulus: 2200 MPa, poisson_ratio: 0.3}}
  bone: {{youngs_modulus: 17 GPa, poisson_ratio: 0.3}}
interfaces:
  stem_cement: {{kind: contact, friction_coefficient: 0}}
  cement_bone: {{kind: contact, friction_coefficient: 0}}
supports:
  outer: {{kind: fixed, boundary: bone_surface}}
"""


def cylinder_points(**values: object) -> ContactPoints:
    case = support.case(CYLINDERS.format(**values))
    return support.assemble(case)[0].contact.points


@pytest.mark.parametrize("taper", [0, 3])
@pytest.mark.parametrize("size", [4.0, 1.5])
def test_smooth_normals_of_cylinders_and_cones_are_exact(size: float, taper: float) -> None:
    """At every node, rims among them, from the stiffer to the softer side."""
    text = CYLINDERS.format(size=size, taper=taper, sector="quarter")
    points = support.assemble(support.case(text, "mesh.order=1"))[0].contact.points
    slope = np.tan(np.deg2rad(taper))
    assert (points.faces == 1).all() and points.normal_error.max() < 1e-9
    radial = points.x[:, :2] / np.linalg.norm(points.x[:, :2], axis=1, keepdims=True)
    n = np.column_stack([radial, np.full(len(radial), -slope)]) / np.hypot(1, slope)
    # Stem to cement is outwards, bone to cement inwards.
    n[points.interface == 1] *= -1
    assert np.abs(points.normals[:, 0] - n).max() < 1e-9
    for i, radius in enumerate((7.0, 10.0)):
        exact = np.pi / 2 * radius * 8 / np.cos(np.deg2rad(taper))
        assert points.weight[points.interface == i].sum() == pytest.approx(exact, rel=0.05)


def bump(n: int) -> tuple[InterfaceFacets, Floats]:
    """A surface of no low degree as irregular triangles, and its normals at the vertices."""
    rng = np.random.default_rng(5)
    u = np.stack(np.meshgrid(*[np.linspace(0, 1, n + 1)] * 2, indexing="ij"), axis=-1)
    inner = (slice(1, -1), slice(1, -1))
    u[inner] += rng.uniform(-0.25, 0.25, u[inner].shape) / n
    a, b = u.reshape(-1, 2).T
    x = np.column_stack([a, b, 0.2 * np.sin(2 * a + b) + 0.1 * np.exp(a * b)])
    k = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    first = np.stack([k[:-1, :-1], k[1:, :-1], k[1:, 1:]], axis=-1).reshape(-1, 3)
    second = np.stack([k[:-1, :-1], k[1:, 1:], k[:-1, 1:]], axis=-1).reshape(-1, 3)
    facets, at = between([*x[first], *x[second]], [0.5, 0.5, 9.0])
    a, b = at[:, :2].T
    slopes = [0.4 * np.cos(2 * a + b) + 0.1 * b * np.exp(a * b)]
    slopes.append(0.2 * np.cos(2 * a + b) + 0.1 * a * np.exp(a * b))
    n_ = np.column_stack([-slopes[0], -slopes[1], np.ones(len(at))])
    return facets, n_ / np.linalg.norm(n_, axis=1, keepdims=True)


def test_smooth_normals_converge_at_second_order() -> None:
    errors, sizes = [], [1 / 8, 1 / 16, 1 / 32]
    for size in sizes:
        facets, exact = bump(round(1 / size))
        points, _ = contact_points(facets, NOTHING_HELD, ["a"], {})
        off = np.linalg.norm(points.normals[:, 0] - exact[points.vertex], axis=1)
        errors.append(float(np.sqrt(np.mean(off**2))))
    assert fitted_order(sizes, errors) > 1.7, errors
    assert errors[-1] < 1e-3, errors


def test_smooth_normals_error_is_estimated() -> None:
    """None on cylinders of straight facets; curved facets differ a little; noise is estimated."""
    text = CYLINDERS.format(size=3.0, taper=3, sector="quarter")
    curved = support.assemble(support.case(text, "mesh.order=2", "mesh.curved=true"))[0].contact
    assert 0 < curved.points.normal_error.max() < 4e-3
    rng, noise = np.random.default_rng(3), 1e-3
    case = support.case(text, "mesh.order=1", "mesh.size=1.5 mm")
    data = meshes.build(case.geometry, case.mesh, None)
    data = replace(data, points=data.points + rng.uniform(-noise, noise, data.points.shape))
    points = support.assemble(case, distribute(data, MPI.COMM_WORLD))[0].contact.points
    outer, slope = points.interface == 0, np.tan(np.deg2rad(3.0))
    x = points.x[outer]
    radial = x[:, :2] / np.linalg.norm(x[:, :2], axis=1, keepdims=True)
    n = np.column_stack([radial, np.full(len(radial), -slope)]) / np.hypot(1, slope)
    off = np.linalg.norm(points.normals[outer, 0] - n, axis=1)
    assert 0.3 < np.sqrt(np.mean(off**2) / np.mean(points.normal_error[outer] ** 2)) < 3
    assert 1e-5 < np.mean(off) < 1e-2


def quadric(half: Floats, tilt: float) -> tuple[InterfaceFacets, Floats]:
    """A cap of an ellipsoid of these half axes as irregular triangles, and its normals."""
    rng, n = np.random.default_rng(7), 8
    u = np.stack(np.meshgrid(*[np.linspace(-0.6, 0.6, n + 1)] * 2, indexing="ij"), axis=-1)
    u[1:-1, 1:-1] += rng.uniform(-0.03, 0.03, u[1:-1, 1:-1].shape)
    a, b = u.reshape(-1, 2).T
    unit = np.column_stack([a, b, np.sqrt(1 - a**2 - b**2)])
    c, s = np.cos(tilt), np.sin(tilt)
    R = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    x, normal = (unit * half) @ R.T, (unit / half) @ R.T
    k = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    first = np.stack([k[:-1, :-1], k[1:, :-1], k[1:, 1:]], axis=-1).reshape(-1, 3)
    second = np.stack([k[:-1, :-1], k[1:, 1:], k[:-1, 1:]], axis=-1).reshape(-1, 3)
    facets, at = between([*x[first], *x[second]], (99 * R[:, 2]).tolist())
    known = {tuple(np.round(p, 9)): v for p, v in zip(x, normal, strict=True)}
    exact = np.array([known[tuple(np.round(p, 9))] for p in at])
    return facets, exact / np.linalg.norm(exact, axis=1, keepdims=True)


@pytest.mark.parametrize("half", [(7, 7, 7), (9, 6, 4), (5, 5, 8)])
@pytest.mark.parametrize("tilt", [0.0, 0.4])
def test_smooth_normals_of_spheres_and_ellipsoids_are_exact(
    half: tuple[float, float, float], tilt: float
) -> None:
    facets, exact = quadric(np.array(half, dtype=float), tilt)
    points, _ = contact_points(facets, NOTHING_HELD, ["a"], {})
    assert np.abs(points.normals[:, 0] - exact[points.vertex]).max() < 1e-9
    assert points.normal_error.max() < 1e-9


@pytest.mark.parametrize("degrees", [35, 50, 90])
def test_smooth_normals_keep_creases(degrees: float) -> None:
    """Two planes at an angle keep both normals at their edge, and one elsewhere."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    corners = patch([0, 0, 0], [4, 0, 0], [0, 4, 0], 4)
    corners += patch([0, 0, 0], [-4 * c, 0, -4 * s], [0, 4, 0], 4)
    facets, at = between(corners, [0.5, 2.0, 99.0])
    points, _ = contact_points(facets, NOTHING_HELD, ["a"], {})
    edge = np.abs(at[points.vertex][:, [0, 2]]).max(axis=1) < 1e-9
    assert (points.faces == np.where(edge, 2, 1)).all()
    for normal in ([0, 0, 1], [-s, 0, c]):
        nearest = np.abs(points.normals[edge] @ normal).max(axis=1)
        np.testing.assert_allclose(nearest, 1.0, atol=1e-12)
    assert points.normal_error.max() < 1e-12


def test_smooth_normals_with_noise_allow_rotation_about_the_axis() -> None:
    """And along a cylinder; a slope of half a degree along the axis stays."""
    rng = np.random.default_rng(4)
    angle, z = rng.uniform(0, 2 * np.pi, 300), rng.uniform(0, 20, 300)
    slope = np.deg2rad(0.5)
    for taper in (0.0, slope):
        x = np.column_stack([7 * np.cos(angle), 7 * np.sin(angle), z])
        n = np.column_stack([np.cos(angle), np.sin(angle), np.full(300, -np.tan(taper))])
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        rough = n + rng.normal(size=n.shape) * 2e-3
        rough /= np.linalg.norm(rough, axis=1, keepdims=True)
        smoothed = slid_along(x, rough, np.full(300, 3e-3), np.ones(300))
        assert np.abs(smoothed - n).max() < 0.01
        # Of all rigid motions one or two meet no normal at all.
        turns = np.cross(x - x.mean(axis=0), smoothed) / 10
        slopes = np.hstack([smoothed, turns])
        sizes = np.linalg.svd(slopes, compute_uv=False) / np.sqrt(300)
        assert (sizes < 1e-10).sum() == (1 if taper else 2), sizes
        along = np.mean(smoothed[:, 2])
        assert along == pytest.approx(-np.sin(taper), abs=3e-4)


SAVE = """
import sys
import numpy as np
from mpi4py import MPI
sys.path.insert(0, {root!r})
from tests.interfaces.test_contact_points import cylinder_points
p = cylinder_points(size=2.5, taper=2, sector="half")
names = ("interface", "vertex", "x", "bodies", "faces", "normals", "weight", "prescribing_support")
arrays = {{name: getattr(p, name) for name in names}}
arrays |= {{f"triangles{{i}}": t for i, t in enumerate(p.triangles)}}
everywhere = MPI.COMM_WORLD.allgather({{k: v.tobytes() for k, v in arrays.items()}})
assert all(other == everywhere[0] for other in everywhere), "ranks differ"
if MPI.COMM_WORLD.rank == 0:
    np.savez({path!r}, **arrays)
"""


@pytest.mark.parallel
def test_contact_points_are_independent_of_the_partition(tmp_path: Path) -> None:
    """The replicated arrays are the same, bit by bit, on all ranks of 1 and 3."""
    results = []
    for ranks in (1, 3):
        path = tmp_path / f"{ranks}.npz"
        program = tmp_path / f"{ranks}.py"
        program.write_text(SAVE.format(root=str(support.ROOT), path=str(path)))
        support.on_ranks(ranks, program)
        results.append(dict(np.load(path)))
    np.testing.assert_equal(*results)
