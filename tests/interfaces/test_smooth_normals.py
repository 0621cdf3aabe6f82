"""Smooth normals of curved interfaces: exact on cylinders, cones, spheres and ellipsoids."""

from __future__ import annotations

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest

import meshes
from app.campaigns.work_precision import fitted_order
from app.foundation.arrays import Floats
from app.interfaces.contact_points import contact_points
from app.interfaces.interface_facets import InterfaceFacets
from app.interfaces.smooth_normals import slid_along
from meshes.distribute import distribute
from tests import support
from tests.interfaces.patches import CYLINDERS, NOTHING_HELD, between, patch


@pytest.mark.parametrize("taper", [0, 3])
@pytest.mark.parametrize("size", [4.0, 1.5])
def test_smooth_normals_of_cylinders_and_cones_are_exact(size: float, taper: float) -> None:
    """Normals are exact at every node, rims included, from the stiffer to the softer side."""
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
    """An irregular triangulation of a surface of high degree, and its normals at the vertices."""
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
    """Cylinders of straight facets have no error, curved facets a small one.

    Noise has its estimated error.
    """
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
    """Slip along a cylinder is free too. A slope of half a degree along the axis stays."""
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
