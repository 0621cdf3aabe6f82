"""Surfaces of bones from files, and the landmarks detected on them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from app.foundation.errors import GeometryError
from app.patient import bone_surface, landmarks
from app.patient.bone_surface import BoneSurface
from tests.patient.bones import MEASURED, moved, opened, parametric_femur, write
from tests.patient.patients import measured


def angle(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arccos(min(1.0, a @ b))))


def test_landmarks_of_the_parametric_femur() -> None:
    """Head and neck are those of its keys; a bump on a flare peaks above its middle, at 0."""
    marks = landmarks.find(parametric_femur())
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
    marks = landmarks.find(
        parametric_femur(), given | {"shaft": ((0, 0, -99), (0, 0, -9)), "side": "right"}
    )
    assert marks.head.tolist() == [40.0, 10.0, 50.0]
    assert marks.origin == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
    assert np.linalg.det(marks.axes) == pytest.approx(-1.0)
    with_condyles = landmarks.find(
        parametric_femur(), {"condyles": ((20, 0, -250), (-20, 0, -250))}
    )
    assert np.degrees(with_condyles.version) == pytest.approx(15.0, abs=1.0)


def copies(surface: BoneSurface, seed: int, number: int) -> list[tuple[Any, ...]]:
    """Turned, mirrored and shifted, every other one open; how they were moved, and their side."""
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
    """Repeatability: 0.1 mm, 0.5 and 0.1 deg, 1 mm, and the side always."""
    first = landmarks.find(surface)
    for copy, turn, shift, side in copies(surface, 1, number):
        marks = landmarks.find(copy)
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
    """Against those of its description (`data/README.md`), and of copies."""
    surface = bone_surface.read(MEASURED)
    marks = landmarks.find(surface)
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
    """The surface moved along its normals by waves of about 9 mm."""
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
    """The deviations asked for, and a spread that covers 90 % of them."""
    surface = bone_surface.read(MEASURED)
    first, covered = landmarks.find(surface), []
    for seed in range(20):
        marks = landmarks.find(bumps(surface, rms, seed))
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


def bytes_of(
    tmp_path: Path, change: Callable[[BoneSurface], BoneSurface], scale: float = 1.0
) -> Path:
    return write(tmp_path / "bone.stl", change(parametric_femur()), scale)


def test_bone_surface_unit_is_found_and_reported(tmp_path: Path) -> None:
    path = bytes_of(tmp_path, lambda s: s, 1e-3)
    surface = bone_surface.read(path)
    assert np.ptp(surface.points[:, 2]) == pytest.approx(
        np.ptp(parametric_femur().points[:, 2]), rel=1e-5
    )
    read, unit = surface.notes
    assert read == "5,056 triangles of a binary STL file"
    assert unit == "unit: m, as the surface is 0.337 long"
    with pytest.raises(
        GeometryError, match=r"0\.337 mm long, but a proximal femur is 65 to 600 mm"
    ):
        bone_surface.read(path, "mm")


def test_bone_surface_flipped_triangles_are_reversed_with_note(tmp_path: Path) -> None:
    def flip(s: BoneSurface) -> BoneSurface:
        triangles = s.triangles.copy()
        triangles[100:130] = triangles[100:130, ::-1]
        return BoneSurface(s.points, triangles)

    surface = bone_surface.read(bytes_of(tmp_path, flip))
    assert "30 triangles with the wrong orientation turned over" in surface.notes
    a, b, c = surface.corners.transpose(1, 0, 2)
    x, y, z = parametric_femur().corners.transpose(1, 0, 2)
    assert (np.cross(a, b) * c).sum() == pytest.approx((np.cross(x, y) * z).sum(), rel=1e-5)


@pytest.mark.parametrize(
    ("suffix", "message"),
    [("ply", "is cut short or damaged"), ("obj", r"line \d+: .* a vertex has three numbers")],
)
def test_bone_surface_of_other_formats_is_equal(suffix: str, message: str, tmp_path: Path) -> None:
    path, stl = tmp_path / f"bone.{suffix}", bone_surface.read(bytes_of(tmp_path, lambda s: s))
    meshio.Mesh(parametric_femur().points, [("triangle", parametric_femur().triangles)]).write(path)
    assert bone_surface.read(path).corners == pytest.approx(stl.corners, abs=1e-4)
    whole = path.read_bytes()  # cut in a line on a vertex
    path.write_bytes(whole[: whole.index(b"\n", 20_000) + 5])
    with pytest.raises(GeometryError, match=message):
        bone_surface.read(path)


def test_bone_surface_open_distal_end_is_reported(tmp_path: Path) -> None:
    surface = bone_surface.read(bytes_of(tmp_path, lambda s: opened(s, -150.0)))
    assert any(line.startswith("open at an end") for line in surface.notes)


def test_bone_surface_many_triangles_are_thinned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bone_surface, "MOST_TRIANGLES", 1000)
    monkeypatch.setattr(bone_surface, "THINNING_SIZE", 6.0)
    surface = bone_surface.read(bytes_of(tmp_path, lambda s: s))
    assert len(surface.triangles) < 0.7 * len(parametric_femur().triangles)
    assert "of 5,056 triangles left after merging corners within 6.0 mm" in " ".join(surface.notes)
