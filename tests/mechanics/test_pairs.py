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

R = 14.0
TURN = Rotation.from_euler("yxz", (40, -25, 70), degrees=True).as_matrix()
V = Rotation.random(2000, random_state=7).apply([0, 0, 1])


def plane(parts: int, seed: int, up: int = 1, size: float = 20.0) -> SmoothSurface:
    """A square about the origin, inner nodes moved at random; outside is ``up``."""
    x = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, parts + 1)] * 2), -1).reshape(-1, 2)
    moved = np.random.default_rng(seed).uniform(-0.2, 0.2, x.shape) / parts
    x += np.where(np.abs(x) < 0.49, moved, 0.0)
    x, t = np.pad(size * x, ((0, 0), (0, 1))), Delaunay(x).simplices
    return SmoothSurface(x, t, np.tile([0.0, 0.0, up], (len(t), 1)))


def sphere(n: int, radius: float = R, out: int = 1, lowest: float = -1.0) -> SmoothSurface:
    """A sphere from a height on, nodes on a jittered spiral; the body is inside (1) or around."""
    k = np.arange(n) + 0.5
    z, φ = 1 - 2 * k / n, np.pi * (1 + np.sqrt(5)) * k
    x = np.stack([np.sqrt(1 - z**2) * np.cos(φ), np.sqrt(1 - z**2) * np.sin(φ), z], axis=1)
    x += 0.3 / np.sqrt(n) * np.random.default_rng(n).uniform(-1, 1, x.shape)
    x /= np.linalg.norm(x, axis=1)[:, None]
    t = ConvexHull(x).simplices
    used, kept = np.unique(t[(x[t, 2] >= lowest).all(axis=1)], return_inverse=True)
    x, t = radius * x[used], kept.reshape(-1, 3)
    return SmoothSurface(x, t, out * x[t].mean(axis=1))


def matrix(pairs: Pairs) -> Floats:
    return coo_array((pairs.values, (pairs.rows, pairs.columns))).toarray()


def test_pairs_quadrature_is_exact_to_degree_6() -> None:
    at, weight = triangle_rule(48)
    for i, j in product(range(4), repeat=2):
        exact = 2 * factorial(i) * factorial(j) / factorial(i + j + 2)
        assert weight @ (at[:, 0] ** i * at[:, 1] ** j) == pytest.approx(exact, rel=1e-13)


@pytest.mark.parametrize(("quadrature", "error"), [(12, 0.014), (48, 0.003)])
def test_pairs_transmit_uniform_pressure_between_unlike_meshes(
    quadrature: int, error: float
) -> None:
    """In parts of the pressure; linear fields pass whatever the points."""
    for seed in range(4):
        slave, master = plane(7, seed), plane(5, seed + 10, up=-1)
        pairs = mortar(slave.x, slave.triangles, master, quadrature)
        Π, inner = matrix(pairs), np.abs(master.x).max(axis=1) < 9.9  # rim: tiny areas
        assert pairs.mortar.all() and pairs.covered == pytest.approx(1, abs=1e-13)
        assert Π.sum(axis=1) == pytest.approx(1, abs=1e-14)
        assert Π @ master.x == pytest.approx(slave.x, abs=1e-12)
        assert (Π.T @ slave.areas)[inner] == pytest.approx(master.areas[inner], rel=error)


def test_pairs_mortar_rows_of_a_partly_covered_slave() -> None:
    """Wider than its master: inside dual rows, at the rim shape functions, outside none."""
    slave, master = plane(12, 1, size=30.0), plane(8, 2, up=-1)
    pairs = mortar(slave.x, slave.triangles, master)
    assert pairs.mortar.sum() > 30 and pairs.covered[pairs.mortar] == pytest.approx(1)
    assert pairs.covered @ slave.areas == pytest.approx(400, rel=0.01)
    assert matrix(pairs) @ master.x == pytest.approx(np.clip(slave.x, -10, 10), abs=1e-12)
    high = mortar(slave.x + np.array([0, 0, 0.5]), slave.triangles, master, reach=0.4)
    assert not high.mortar.any() and high.covered == pytest.approx(pairs.covered)
    ball, base = sphere(400), plane(9, 3, size=40.0)
    covered, down = mortar(ball.x, ball.triangles, base).covered, -ball.x[:, 2] / R
    assert covered[down > 0.7] == pytest.approx(1) and not covered[down < 0.3].any()


def test_pairs_closest_points_are_closest() -> None:
    master, at = sphere(300, lowest=0.0), np.concatenate([np.eye(3), triangle_rule(192)[0]])
    points = V[:300] * np.linspace(0.8, 1.3, 300)[:, None] * R
    samples = np.einsum("qk,fki->fqi", at, master.x[master.triangles]).reshape(-1, 3)
    facet, shares, distance = master.closest(points)
    assert shares.min() >= 0 and shares.sum(axis=1) == pytest.approx(1, abs=1e-14)
    off = points - np.einsum("pk,pki->pi", shares, master.x[master.triangles[facet]])
    assert np.abs(distance) == pytest.approx(np.linalg.norm(off, axis=1), abs=1e-12)
    sampled = [np.linalg.norm(samples - p, axis=1).min() for p in points]
    assert (np.abs(distance) <= np.array(sampled) + 1e-12).all()
    out = np.where(points[:, 2] > 2, np.linalg.norm(points, axis=1) - R, 0.0)
    assert (distance * out)[np.abs(out) > 0.2].min() > 0


def bent(n: Floats, bend: float) -> tuple[Floats, Floats]:
    """Points of a sphere moved by bend x^2 along z, and normals there, by its normals."""
    x, normal = R * n, n - 2 * bend * R * n[:, :1] * n[:, 2:] * np.array([1, 0, 0])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    return x + bend * x[:, :1] ** 2 * np.array([0, 0, 1]), normal


@pytest.mark.parametrize(("bend", "angle", "sagittas"), [(0, 1e-9, 2e-4), (0.01, 0.2, 0.03)])
def test_pairs_gap_and_normals_are_those_of_the_surface(
    bend: float, angle: float, sagittas: float
) -> None:
    """Normals of a sphere to rounding, those of a surface of degree 4 within 0.2 degrees."""
    errors, (x, normals) = [], bent(V, bend)
    for n in (500, 2000, 8000):
        of = sphere(n)
        nodes, exact = bent(of.x / R, bend)
        body = SmoothSurface(nodes, of.triangles, exact[of.triangles].mean(axis=1))
        off = np.linalg.norm(np.cross(body.normals, exact), axis=1).max()
        gaps = [(g, *body.gap(x + g * normals)) for g in (-0.05, 0.0, 0.1)]
        errors.append([off, max(np.abs(gap - g).max() for g, gap, _ in gaps)])
        assert all(normal == pytest.approx(normals, abs=0.01) for *_, normal in gaps)
    h = R * np.sqrt(8 * np.pi / np.sqrt(3) / 500)
    assert np.rad2deg(errors[0][0]) < angle and errors[0][1] < sagittas * h**2 / (8 * R)
    orders = np.log2(np.array(errors)[:-1] / np.array(errors)[1:])
    assert orders[:, 1].min() > (2.5 if bend else 1.8) and (orders[:, 0].min() > 1.7 or not bend)


def test_pairs_are_invariant_under_common_rotation() -> None:
    cup, ball = sphere(800, R + 0.1, out=-1, lowest=-0.1), sphere(600)
    x, t = ball.x @ TURN.T, ball.triangles
    turned = SmoothSurface(x, t[:, [1, 0, 2]], x[t].mean(axis=1))
    first = matrix(mortar(cup.x, cup.triangles, ball))
    second = matrix(mortar(cup.x @ TURN.T, cup.triangles, turned))
    assert second == pytest.approx(first, abs=1e-11) and (np.abs(first) > 0.01).sum() > 2000
    (gap, normal), (gap_, normal_) = ball.gap(cup.x), turned.gap(cup.x @ TURN.T)
    assert gap_ == pytest.approx(gap, abs=1e-12) and np.allclose(normal_, normal @ TURN.T)


def test_pairs_deposits_conserve_sums() -> None:
    """The sum; on a plane first moments; even values of a cup give the areas of a ball's nodes."""
    flat, cup, ball = plane(9, 4), sphere(400, R + 0.1), sphere(500)
    points, values = 9 * V, np.linspace(0, 1, len(V))
    nodal = flat.deposit(points, values[:, None])[:, 0]
    assert nodal.sum() == pytest.approx(values.sum(), rel=1e-13)
    assert (nodal @ flat.x)[:2] == pytest.approx((values @ points)[:2], abs=1e-9)
    even = ball.deposit(*cup.sample_density(np.full((len(cup.x), 1), (R / (R + 0.1)) ** 2), 48))
    assert even[:, 0] == pytest.approx(ball.areas, rel=0.1)
