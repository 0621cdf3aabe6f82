"""Joining of loose triangles: polygons, repeated facets, folds, rounding."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from app.foundation.errors import GeometryError
from app.patient import bone_surface, welding
from tests.patient.bones import opened, parametric_femur
from tests.patient.surface_text import judged, obj_faces, obj_vertices, put, quads, stl, volume


def test_welding_concave_polygons_are_divided_inside() -> None:
    """Triangles of a comb of five teeth in any plane keep its sides and its area."""
    comb = [(0.0, 0.0), (9.0, 0.0)]
    for tooth in range(4, -1, -1):
        comb += [(2 * tooth + 1.0, 3.0), (2 * tooth + 0.0, 0.5)][: 2 if tooth else 1]
    xy = np.array(comb)
    area = 0.5 * (xy[:, 0] * np.roll(xy[:, 1], -1) - np.roll(xy[:, 0], -1) * xy[:, 1]).sum()
    for seed in range(6):
        turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
        x = np.column_stack([xy, np.ones(len(xy))]) @ turn.T
        triangles = welding.triangles_of_polygons(x, [list(range(len(x)))])
        a, b, c = np.moveaxis(x[triangles], 1, 0)
        areas = 0.5 * np.cross(b - a, c - a) @ turn[:, 2] * np.linalg.det(turn)
        assert len(triangles) == len(x) - 2
        assert areas.min() > 0 and areas.sum() == pytest.approx(area)


# Triangles of the parametric femur.

HEAD = (41.69, 11.17, 54.13)
RADIUS = 22.71
FAR = np.array([600.0, -800.0, 2100.0])


def test_welding_quads_next_to_a_divided_edge_close_the_surface(tmp_path: Path) -> None:
    """Quads are above two levels, one far from both ends.

    Edges of the rim are divided on one side.
    """
    for level in (60.0, -50.0):
        points, faces = quads(parametric_femur(), level)
        path = put(tmp_path, "bone.obj", obj_vertices(points) + obj_faces(faces))
        surface, frame = judged(path)
        assert not len(surface.rim)
        assert "edges that were divided on one side only" in " ".join(surface.notes)
        assert frame.head == pytest.approx(HEAD, abs=0.1)
        assert frame.radius == pytest.approx(RADIUS, abs=0.1)
        assert frame.doubts(surface) == []


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("doubled", [slice(None), slice(200, 900)])
def test_welding_keeps_repeated_facets_once(doubled: slice, turned: bool, tmp_path: Path) -> None:
    """All or some facets have copies, with equal or opposite orientation."""
    corners = parametric_femur().corners
    copies = corners[doubled, :: -1 if turned else 1]
    surface = bone_surface.read(stl(tmp_path, np.concatenate([corners, copies])))
    assert len(surface.triangles) == len(corners)
    assert f"{len(copies):,} doubled facets left out" in surface.notes
    assert volume(surface.corners) == pytest.approx(volume(corners), rel=1e-5)


def test_welding_keeps_repeated_facets_of_an_open_bone_once(tmp_path: Path) -> None:
    corners = opened(parametric_femur(), -150.0).corners
    surface = bone_surface.read(stl(tmp_path, np.concatenate([corners] * 3)))
    assert len(surface.triangles) == len(corners)
    assert f"{2 * len(corners):,} doubled facets left out" in surface.notes


def test_welding_removes_a_fold_without_thickness(tmp_path: Path) -> None:
    """A fin of two sheets is joined to the bone by an edge."""
    corners = parametric_femur().corners
    a, b = corners[500, 0], corners[500, 1]
    tip = (a + b) / 2 + 3.0 * np.array([0.3, 0.5, 0.1])
    fin = np.array([[a, b, tip], [b, a, tip]])
    surface = bone_surface.read(stl(tmp_path, np.concatenate([corners, fin])))
    assert len(surface.triangles) == len(corners)
    assert "2 triangles of folds without thickness left out" in surface.notes


@pytest.mark.parametrize("noise", [1e-5, 1e-4, 1e-3, 5e-3])
def test_welding_merges_corners_that_differ_in_last_digits(noise: float, tmp_path: Path) -> None:
    rng, corners = np.random.default_rng(4), parametric_femur().corners
    surface = bone_surface.read(stl(tmp_path, corners + rng.normal(0, noise, corners.shape)))
    assert len(surface.triangles) == len(corners) and not len(surface.rim)
    assert len(surface.points) == len(parametric_femur().points)
    assert volume(surface.corners) == pytest.approx(volume(corners), rel=1e-4)
    assert noise < 1e-4 or "merged with it" in " ".join(surface.notes)


def test_welding_joins_a_bone_far_from_the_origin(tmp_path: Path) -> None:
    """Numbers of four bytes have steps of 0.0001 mm at two metres."""
    surface = bone_surface.read(stl(tmp_path, parametric_femur().corners + FAR))
    assert len(surface.triangles) == len(parametric_femur().triangles) and not len(surface.rim)


def test_welding_refuses_loose_corners_with_their_distance(tmp_path: Path) -> None:
    rng, corners = np.random.default_rng(4), parametric_femur().corners
    path = stl(tmp_path, corners + rng.normal(0, 0.1, corners.shape))
    with pytest.raises(GeometryError, match=r"not joined: .* are 0\.1\d mm from the next; merge"):
        bone_surface.read(path)
