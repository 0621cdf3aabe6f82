"""Rules of ``contact_points``: normals, edges, bodies that meet on a line, supports."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from app.foundation.arrays import Floats
from app.interfaces.contact_points import contact_points
from app.interfaces.corners import ContactPoints, Entries, VertexConstraints
from app.interfaces.interface_facets import InterfaceFacets
from app.verification.changed_meshes import ROTATION
from tests import support
from tests.interfaces.patches import NOTHING_HELD, between, facets_of, patch


def box_in_a_box(n: int = 3) -> tuple[InterfaceFacets, Floats]:
    """The unit cube (body 1, the slave) in its container (body 0)."""
    triangles = []
    for k in range(3):
        a, b = np.eye(3)[(k + 1) % 3], np.eye(3)[(k + 2) % 3]
        triangles += patch([0, 0, 0], a, b, n) + patch(np.eye(3)[k], a, b, n)
    return between(triangles, [0.5, 0.5, 0.5])


def test_contact_points_of_a_box_in_a_box() -> None:
    """Points have one face inside a side, two on its edges, three at its corners.

    Each face has its normal.
    """
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
    """Two half planes meet at an angle.

    Below 30 degrees they have one averaged normal, above it two.
    """
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
    """Faces join up to the angle that a geometry with rounded edges gives."""
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
    """The tip of a pyramid has four faces. The closest two are merged, and the area stays."""
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
    """The order of the faces decides which face bears the force of a sticking point."""
    facets, _ = box_in_a_box()
    turned = replace(facets, nodes=facets.nodes @ Q.T, normal=facets.normal @ Q.T)
    one, other = (contact_points(f, NOTHING_HELD, ["a"], {})[0] for f in (facets, turned))
    assert set(one.faces.tolist()) == {1, 2, 3}
    np.testing.assert_allclose(other.normals, one.normals @ Q.T, atol=1e-12)


# Motion of bodies with jumps


def moves(entries: Entries, dof: int, bodies: int, jumps: int) -> Floats:
    """Matrix (3 bodies, 3 jumps): displacements of each body at a vertex by the jumps."""
    B = np.zeros((3 * bodies, 3 * jumps))
    here = entries.row // 3 == dof
    for body, row, column, value in zip(
        *(v[here] for v in (entries.body, entries.row, entries.column, entries.value)), strict=True
    ):
        B[3 * body + row % 3, column] += value
    return B


def check_jumps(points: ContactPoints, entries: Entries, bodies: int) -> None:
    """At every vertex the slave moves relative to the master by exactly the jump of the point."""
    n = len(points.x)
    for p in range(n):
        B = moves(entries, int(points.dof[p]), bodies, n).reshape(bodies, 3, 3 * n)
        master, slave = points.bodies[p]
        jump = np.zeros((3, 3 * n))
        jump[:, 3 * p : 3 * p + 3] = np.eye(3)
        free = ~points.is_prescribed[p]
        np.testing.assert_allclose((B[slave] - B[master])[free], jump[free], atol=1e-14)


def check_mean_jumps(points: ContactPoints, entries: Entries, bodies: int) -> None:
    """At every corner of an interface the slave moves relative to the master by the true jump.

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
    """The stiffest body has the field u itself, unless a support holds another one."""
    facets, _ = three_on_a_line(2.0, 1.0, 3.0)
    points, entries = contact_points(facets, NOTHING_HELD, ["a", "b", "c"], {})
    for p in range(len(points.x)):
        B = moves(entries, int(points.dof[p]), 3, len(points.x)).reshape(3, 3, -1)
        moved = {body for body in range(3) if B[body].any()}
        here = set(points.bodies[points.vertex == points.vertex[p]].ravel())
        assert moved == here - {max(here, key=[2, 1, 3].__getitem__)}
    check_mean_jumps(points, entries, 3)


def test_contact_points_of_three_bodies_have_two_jumps() -> None:
    """There is one jump fewer than bodies.

    Equal interfaces are taken by name, and the last one is dependent.
    """
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
    """If only the slave is held, it has the field u, and the master moves by minus q."""
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
    """If supports hold a component of both sides, its jump is given, and normals omit it."""
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
    """The outer two bodies of a chain are held, so both jumps in that direction are given.

    If the outer two are in contact as well, only their jump is given, and the third body moves
    freely.
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


SAVE = """
import sys
import numpy as np
from mpi4py import MPI
sys.path.insert(0, {root!r})
from tests.interfaces.patches import cylinder_points
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
    """The replicated arrays are identical, bit by bit, on all ranks of 1 and 3."""
    results = []
    for ranks in (1, 3):
        path = tmp_path / f"{ranks}.npz"
        program = tmp_path / f"{ranks}.py"
        program.write_text(SAVE.format(root=str(support.ROOT), path=str(path)))
        support.on_ranks(ranks, program)
        results.append(dict(np.load(path)))
    np.testing.assert_equal(*results)
