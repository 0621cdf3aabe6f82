"""Surfaces of bones from files, and the landmarks detected on them."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from app.foundation.errors import GeometryError
from app.patient import bone_surface, landmarks
from app.patient.bone_surface import BoneSurface
from tests.patient.bones import MEASURED, moved, opened, parametric_canal, parametric_femur
from tests.patient.patients import measured
from tests.patient.surface_text import judged, stl


def angle(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arccos(min(1.0, a @ b))))


def test_landmarks_of_the_parametric_femur() -> None:
    """Head and neck are those of the keys.

    A bump on a flare has its peak above its middle, at 0.
    """
    marks = landmarks.find_landmarks(parametric_femur())
    turn = np.radians(15.0)
    assert marks.head == pytest.approx([43 * np.cos(turn), 43 * np.sin(turn), 54.0], abs=0.3)
    assert marks.radius == pytest.approx(23.0, abs=0.5)  # triangles are within the sphere
    assert marks.axes[2] == pytest.approx([0.0, 0.0, 1.0], abs=0.01)
    assert marks.axes[0] == pytest.approx([np.cos(turn), np.sin(turn), 0.0], abs=0.01)
    assert np.degrees(np.arccos(-marks.neck @ marks.axes[2])) == pytest.approx(130.0, abs=1.5)
    assert 0.0 < marks.origin[2] < 4.0
    assert marks.side == "left"
    assert marks.version is None  # it has no condyles
    assert "unknown without condyles" in marks.details["version"]


def test_landmarks_uses_given_landmarks() -> None:
    given = {"head_centre": (40.0, 10.0, 50.0), "lesser_trochanter": (19.0, 7.0, 0.0)}
    marks = landmarks.find_landmarks(
        parametric_femur(), given | {"shaft": ((0, 0, -99), (0, 0, -9)), "side": "right"}
    )
    assert marks.head.tolist() == [40.0, 10.0, 50.0]
    assert marks.origin == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
    assert np.linalg.det(marks.axes) == pytest.approx(-1.0)
    with_condyles = landmarks.find_landmarks(
        parametric_femur(), {"condyles": ((20, 0, -250), (-20, 0, -250))}
    )
    assert np.degrees(with_condyles.version) == pytest.approx(15.0, abs=1.0)


def copies(surface: BoneSurface, seed: int, number: int) -> list[tuple[Any, ...]]:
    """Copies, rotated, mirrored, shifted, every other one open, with their motions and sides."""
    rng, top = np.random.default_rng(seed), surface.points[:, 2].max()
    sides = ("left", "right") if surface is parametric_femur() else ("right", "left")
    made = []
    for k in range(number):
        turn = Rotation.random(random_state=rng).as_matrix() @ np.diag([(-1) ** k, 1, 1])
        part = opened(surface, top - rng.uniform(120, 200)) if k % 4 > 1 else surface
        shift = 100 * rng.normal(size=3)
        made.append((moved(part, turn, shift), turn, shift, sides[k % 2]))
    return made


def check_copies(surface: BoneSurface, number: int) -> None:
    """Repeatability is 0.1 mm, 0.5 and 0.1 deg, 1 mm; the side is always right."""
    first = landmarks.find_landmarks(surface)
    for copy, turn, shift, side in copies(surface, 1, number):
        marks = landmarks.find_landmarks(copy)
        assert marks.side == side
        assert angle(marks.axes[2], turn @ first.axes[2]) < 0.5
        assert angle(marks.neck, turn @ first.neck) < 0.1
        apart = (marks.head - marks.trochanter) - turn @ (first.head - first.trochanter)
        assert np.linalg.norm(apart) < 1.0
        assert marks.radius == pytest.approx(first.radius, abs=0.1)
        assert np.linalg.norm(marks.head - shift - turn @ first.head) < 0.1
        if marks.version is not None and first.version is not None:
            assert np.degrees(marks.version - first.version) == pytest.approx(0.0, abs=0.2)


def test_landmarks_moves_with_the_bone() -> None:
    check_copies(parametric_femur(), 4)


@measured
def test_landmarks_of_a_measured_femur() -> None:
    """Landmarks agree with the description (`data/README.md`), and with those of copies."""
    surface = bone_surface.read(MEASURED)
    marks = landmarks.find_landmarks(surface)
    assert np.linalg.norm(marks.head) < 0.6
    assert marks.radius == pytest.approx(21.66, abs=0.4)
    assert marks.side == "right"
    assert np.degrees(np.arccos(-marks.neck @ marks.axes[2])) == pytest.approx(120.0, abs=1.5)
    assert marks.trochanter == pytest.approx([6.0, -30.0, -38.0], abs=5.0)
    assert np.degrees(marks.version) == pytest.approx(26.0, abs=1.0)


@measured
@pytest.mark.slow
def test_landmarks_of_twenty_copies_of_a_measured_femur() -> None:
    check_copies(bone_surface.read(MEASURED), 20)


def bumps(surface: BoneSurface, rms: float, seed: int) -> BoneSurface:
    """The surface displaced along its normals by waves of about 9 mm."""
    rng = np.random.default_rng(seed)
    k = rng.normal(size=(200, 3))
    k *= 2 * np.pi / 9.0 * rng.uniform(0.7, 1.3, (200, 1)) / np.linalg.norm(k, axis=1)[:, None]
    height = np.cos(surface.points @ k.T + rng.uniform(0, 2 * np.pi, 200)).sum(axis=1)
    a, b, c = surface.corners.transpose(1, 0, 2)
    normal = np.zeros_like(surface.points)
    for j in range(3):
        np.add.at(normal, surface.triangles[:, j], np.cross(b - a, c - a))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    far = rms * height / np.sqrt((height**2).mean())
    return BoneSurface(surface.points + far[:, None] * normal, surface.triangles)


@measured
@pytest.mark.slow
@pytest.mark.parametrize(("rms", "head", "neck", "version"), [(0.3, 0.3, 1, 1), (0.7, 1.2, 2, 3)])
def test_landmarks_with_bumps_is_within_its_interval(
    rms: float, head: float, neck: float, version: float
) -> None:
    """Deviations are those of the waves, and the interval covers 90 % of them."""
    surface = bone_surface.read(MEASURED)
    first, covered = landmarks.find_landmarks(surface), []
    for seed in range(20):
        marks = landmarks.find_landmarks(bumps(surface, rms, seed))
        off = [
            float(np.linalg.norm(marks.head - first.head)),
            angle(marks.neck, first.neck),
            abs(float(np.degrees(marks.version - first.version))),
        ]
        assert (np.array(off) <= [head, neck, version]).all(), seed
        intervals = [
            marks.spread["head"],
            *(np.degrees(marks.spread[k]) for k in ("neck", "version")),
        ]
        covered += [o <= t for o, t in zip(off, intervals, strict=True)]
    assert np.mean(covered) >= 0.9


def test_landmarks_refuse_the_wall_of_the_canal(tmp_path: Path) -> None:
    """Bone and canal are one body, joined by a narrow passage at the end of the shaft."""
    bone, canal = parametric_femur().corners, parametric_canal().corners[:, ::-1]
    lowest = [int(c.mean(axis=1)[:, 2].argmin()) for c in (bone, canal)]
    (a, b, c), (p, r, q) = bone[lowest[0]], canal[lowest[1]]
    sides = [(a, b, q, p), (b, c, r, q), (c, a, p, r)]
    passage = [t for i, j, k, m in sides for t in ((i, j, k), (i, k, m))]
    parts = [np.delete(bone, lowest[0], 0), np.delete(canal, lowest[1], 0), np.array(passage)]
    surface = bone_surface.read(stl(tmp_path, np.concatenate(parts)))
    with pytest.raises(GeometryError, match="its shaft is hollow: the surface includes"):
        landmarks.find_landmarks(surface)


@pytest.mark.parametrize(
    ("scale", "note"),
    [
        ([1.6, 1.6, 1.6], r"the head's radius is 36\.3 mm; expected 18 to 30"),
        ([0.7, 0.7, 0.7], r"the head's radius is 15\.9 mm; expected 18 to 30"),
        ([1, 1, 1.25], r"neck-shaft angle is 14\d\.\d deg; expected 110 to 140 deg. Is the bone"),
        ([1, 1, 1], ""),
    ],
)
def test_landmarks_note_on_rare_size_or_shape(
    scale: list[float], note: str, tmp_path: Path
) -> None:
    surface, frame = judged(stl(tmp_path, parametric_femur().corners * scale))
    notes = frame.doubts(surface)
    assert len(notes) == bool(note)
    assert re.search(note, " ".join(notes))


def test_landmarks_note_on_length_over_head() -> None:
    """A femur with condyles usually has 15 to 25 radii of the head.

    Without them any length is allowed.
    """
    frame = landmarks.find_landmarks(parametric_femur())
    whole = replace(frame, version=0.2, length=18 * frame.radius)
    assert whole.doubts(parametric_femur()) == []
    (note,) = replace(whole, length=27 * frame.radius).doubts(parametric_femur())
    assert "it is 613 mm long with its condyles; expected 341 to 568" in note
    assert replace(whole, length=9 * frame.radius, version=None).doubts(parametric_femur()) == []


def test_landmarks_note_where_the_image_cuts_the_bone() -> None:
    """The lowest side of the image is the end of the scan.

    Other sides cut off a part of the bone.
    """
    bone = parametric_femur()
    low, top = bone.points[:, 2].min(), bone.points[:, 2].max()
    end = bone.points[bone.points[:, 2] < low + 1.0]
    head = bone.points[bone.points[:, 2] > top - 1.0]
    side = np.tile([20.0, 0.0, -120.0], (9, 1))
    frame = landmarks.find_landmarks(bone)
    assert frame.doubts(replace(bone, borders=(end,))) == []
    above, beside = frame.doubts(replace(bone, borders=(head, end, side), doubts=()))
    assert "the bone is cut by the border of the image at (4" in above
    assert "(20, 0, -120) mm in the file (9 voxels); is a part of it missing?" in beside
    assert frame.doubts(replace(bone, doubts=("one",))) == ["one"]
