"""Closest points, dual mortar rows and smooth gaps of unlike triangulations."""

from __future__ import annotations

from itertools import product
from math import factorial

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.spatial import ConvexHull, Delaunay
from scipy.spatial.transform import Rotation

from app.foundation.arrays import Floats
from app.mechanics.pairs import Pairs, SmoothSurface, mortar, triangle_rule

RADIUS = 14.0  # of spheres [mm]
ROTATION = Rotation.from_euler("yxz", (40, -25, 70), degrees=True).as_matrix()
# Random directions (2000, 3).
DIRECTIONS = Rotation.random(2000, random_state=7).apply([0, 0, 1])


def plane(parts: int, seed: int, normal_z: int = 1, size: float = 20.0) -> SmoothSurface:
    """A square about the origin with normal ``normal_z`` e_z. Inner nodes are moved at random."""
    x = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, parts + 1)] * 2), -1).reshape(-1, 2)
    moved = np.random.default_rng(seed).uniform(-0.2, 0.2, x.shape) / parts
    x += np.where(np.abs(x) < 0.49, moved, 0.0)
    x, triangles = np.pad(size * x, ((0, 0), (0, 1))), Delaunay(x).simplices
    return SmoothSurface(x, triangles, np.tile([0.0, 0.0, normal_z], (len(triangles), 1)))


def sphere(n: int, radius: float = RADIUS, outward: int = 1, lowest: float = -1.0) -> SmoothSurface:
    """A sphere above the height ``lowest`` times its radius, with nodes on a jittered spiral.

    The body is inside (``outward`` 1) or around (-1).
    """
    k = np.arange(n) + 0.5
    z, φ = 1 - 2 * k / n, np.pi * (1 + np.sqrt(5)) * k
    x = np.stack([np.sqrt(1 - z**2) * np.cos(φ), np.sqrt(1 - z**2) * np.sin(φ), z], axis=1)
    x += 0.3 / np.sqrt(n) * np.random.default_rng(n).uniform(-1, 1, x.shape)
    x /= np.linalg.norm(x, axis=1)[:, None]
    triangles = ConvexHull(x).simplices
    is_kept = (x[triangles, 2] >= lowest).all(axis=1)
    used, kept = np.unique(triangles[is_kept], return_inverse=True)
    x, triangles = radius * x[used], kept.reshape(-1, 3)
    return SmoothSurface(x, triangles, outward * x[triangles].mean(axis=1))


def matrix(pairs: Pairs) -> Floats:
    return coo_array((pairs.values, (pairs.rows, pairs.columns))).toarray()


def test_pairs_quadrature_is_exact_to_degree_6() -> None:
    points, weight = triangle_rule(48)
    for i, j in product(range(4), repeat=2):
        exact = 2 * factorial(i) * factorial(j) / factorial(i + j + 2)
        assert weight @ (points[:, 0] ** i * points[:, 1] ** j) == pytest.approx(exact, rel=1e-13)


# Largest relative errors over the four seeds: 0.0098 with 12 points, 0.0017 with 48.
@pytest.mark.parametrize(("quadrature", "error"), [(12, 0.014), (48, 0.003)])
def test_pairs_transmit_uniform_pressure_between_unlike_meshes(
    quadrature: int, error: float
) -> None:
    """A uniform pressure has the master's nodal areas as forces, to the error of the quadrature.

    Any quadrature reproduces linear fields of the master exactly.
    """
    for seed in range(4):
        slave, master = plane(7, seed), plane(5, seed + 10, normal_z=-1)
        pairs = mortar(slave.x, slave.triangles, master, quadrature)
        Π = matrix(pairs)
        is_inner = np.abs(master.x).max(axis=1) < 9.9  # nodes at the rim have tiny areas
        assert pairs.mortar.all()
        assert pairs.covered == pytest.approx(1, abs=1e-13)
        assert Π.sum(axis=1) == pytest.approx(1, abs=1e-14)
        assert Π @ master.x == pytest.approx(slave.x, abs=1e-12)
        forces = Π.T @ slave.areas
        assert forces[is_inner] == pytest.approx(master.areas[is_inner], rel=error)


def test_pairs_mortar_rows_of_a_partly_covered_slave() -> None:
    """A slave wider than its master has dual rows inside, and shape functions at the master's rim.

    Nodes outside the rim, or beyond the reach, have no dual row.
    """
    slave, master = plane(12, 1, size=30.0), plane(8, 2, normal_z=-1)
    pairs = mortar(slave.x, slave.triangles, master)
    assert pairs.mortar.sum() > 30  # 42
    assert pairs.covered[pairs.mortar] == pytest.approx(1)
    # Area of the master: 20 mm squared; the error is 0.0053.
    assert pairs.covered @ slave.areas == pytest.approx(400, rel=0.01)
    assert matrix(pairs) @ master.x == pytest.approx(np.clip(slave.x, -10, 10), abs=1e-12)

    out_of_reach = mortar(slave.x + np.array([0, 0, 0.5]), slave.triangles, master, reach=0.4)
    assert not out_of_reach.mortar.any()
    assert out_of_reach.covered == pytest.approx(pairs.covered)

    ball, base = sphere(400), plane(9, 3, size=40.0)
    covered = mortar(ball.x, ball.triangles, base).covered
    downward = -ball.x[:, 2] / RADIUS
    assert covered[downward > 0.7] == pytest.approx(1)
    assert not covered[downward < 0.3].any()


def test_pairs_closest_points_are_closest() -> None:
    """No sample of the surface is closer. The distance is positive outside."""
    master = sphere(300, lowest=0.0)
    barycentric = np.concatenate([np.eye(3), triangle_rule(192)[0]])
    points = DIRECTIONS[:300] * np.linspace(0.8, 1.3, 300)[:, None] * RADIUS
    samples = np.einsum("qk,fki->fqi", barycentric, master.x[master.triangles]).reshape(-1, 3)
    facet, shares, distance = master.closest(points)
    assert shares.min() >= 0
    assert shares.sum(axis=1) == pytest.approx(1, abs=1e-14)
    arms = points - np.einsum("pk,pki->pi", shares, master.x[master.triangles[facet]])
    assert np.abs(distance) == pytest.approx(np.linalg.norm(arms, axis=1), abs=1e-12)
    sampled = [np.linalg.norm(samples - p, axis=1).min() for p in points]
    assert (np.abs(distance) <= np.array(sampled) + 1e-12).all()
    outside = np.where(points[:, 2] > 2, np.linalg.norm(points, axis=1) - RADIUS, 0.0)
    assert (distance * outside)[np.abs(outside) > 0.2].min() > 0


def bent(directions: Floats, bend: float) -> tuple[Floats, Floats]:
    """Points of a sphere moved by bend x^2 along z, and exact normals, at unit vectors (n, 3)."""
    x = RADIUS * directions
    slope = 2 * bend * RADIUS * directions[:, :1]
    normal = directions - slope * directions[:, 2:] * np.array([1, 0, 0])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    return x + bend * x[:, :1] ** 2 * np.array([0, 0, 1]), normal


# Measured on the coarsest mesh: 8e-14 and 0.186 degrees; 1.2e-4 and 0.0293 sagittas. Measured
# orders of the gap from mesh to mesh: 2.49 and 2.01 on the sphere, 2.83 and 3.08 on the bent one;
# of the normals there: 1.76 and 1.87.
@pytest.mark.parametrize(
    ("bend", "angle", "sagittas", "gap_order"), [(0, 1e-9, 2e-4, 1.8), (0.01, 0.2, 0.03, 2.5)]
)
def test_pairs_gap_and_normals_are_those_of_the_surface(
    bend: float, angle: float, sagittas: float, gap_order: float
) -> None:
    """Normals of a sphere are exact to rounding, those of a surface of degree 4 to 0.2 degrees.

    The error of the gap is a fraction of the sagitta, by which a flat facet is below the sphere.
    """
    errors, (x, normals) = [], bent(DIRECTIONS, bend)
    for n in (500, 2000, 8000):
        ball = sphere(n)
        nodes, exact = bent(ball.x / RADIUS, bend)
        body = SmoothSurface(nodes, ball.triangles, exact[ball.triangles].mean(axis=1))
        sine = np.linalg.norm(np.cross(body.normals, exact), axis=1).max()
        gaps = [(g, *body.gap(x + g * normals)) for g in (-0.05, 0.0, 0.1)]
        errors.append([sine, max(np.abs(gap - g).max() for g, gap, _ in gaps)])
        assert all(normal == pytest.approx(normals, abs=0.01) for *_, normal in gaps)
    edge = RADIUS * np.sqrt(8 * np.pi / np.sqrt(3) / 500)  # of equal facets of the coarsest mesh
    sagitta = edge**2 / (8 * RADIUS)
    assert np.rad2deg(errors[0][0]) < angle
    assert errors[0][1] < sagittas * sagitta
    orders = np.log2(np.array(errors)[:-1] / np.array(errors)[1:])
    assert orders[:, 1].min() > gap_order
    if bend:
        assert orders[:, 0].min() > 1.7


def test_pairs_are_invariant_under_common_rotation() -> None:
    """Rows, gaps and normals do not change if both bodies rotate and facets begin elsewhere."""
    cup, ball = sphere(800, RADIUS + 0.1, outward=-1, lowest=-0.1), sphere(600)
    x, triangles = ball.x @ ROTATION.T, ball.triangles
    rotated = SmoothSurface(x, triangles[:, [1, 0, 2]], x[triangles].mean(axis=1))
    rows = matrix(mortar(cup.x, cup.triangles, ball))
    rotated_rows = matrix(mortar(cup.x @ ROTATION.T, cup.triangles, rotated))
    assert rotated_rows == pytest.approx(rows, abs=1e-11)
    assert (np.abs(rows) > 0.01).sum() > 2000  # 3428
    gap, normal = ball.gap(cup.x)
    rotated_gap, rotated_normal = rotated.gap(cup.x @ ROTATION.T)
    assert rotated_gap == pytest.approx(gap, abs=1e-12)
    assert np.allclose(rotated_normal, normal @ ROTATION.T)


def test_pairs_deposits_conserve_sums() -> None:
    """Deposits keep the sum of the values, and on a plane their first moments.

    A uniform density on a cup deposits the nodal areas of the ball.
    """
    flat, cup, ball = plane(9, 4), sphere(400, RADIUS + 0.1), sphere(500)
    points, values = 9 * DIRECTIONS, np.linspace(0, 1, len(DIRECTIONS))
    nodal = flat.deposit(points, values[:, None])[:, 0]
    assert nodal.sum() == pytest.approx(values.sum(), rel=1e-13)
    assert (nodal @ flat.x)[:2] == pytest.approx((values @ points)[:2], abs=1e-9)
    density = np.full((len(cup.x), 1), (RADIUS / (RADIUS + 0.1)) ** 2)
    uniform = ball.deposit(*cup.sample_density(density, 48))
    assert uniform[:, 0] == pytest.approx(ball.areas, rel=0.1)  # the largest error is 0.0074
