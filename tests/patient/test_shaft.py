"""The shaft of a femur that ends with its scan: its end, its axis, its continuation."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from app.case.shapes import MeshOptions
from app.foundation.arrays import Floats, unit_vectors
from app.foundation.errors import GeometryError
from app.patient import landmarks, shaft, welding
from app.patient.bone_surface import BoneSurface
from app.patient.geometry import Patient
from app.patient.measured_layers import MeasuredLayers
from meshes import femur_bone
from meshes.plane_sections import centroid, exits, lines_at_height
from tests.patient.bones import parametric_canal, parametric_femur, tube, write
from tests.patient.patients import made, patient

# A cylinder: radius, ends [mm].
RADIUS = 14.0
TOP_RADIUS = 10.0  # of its upper end, which is smaller
ENDS = (-80.0, 60.0)


def cylinder() -> BoneSurface:
    """A cylinder along z, narrower at its upper end."""
    turn, z = 2 * np.pi * np.arange(48) / 48, np.linspace(*ENDS, 30)
    radii = np.where(np.arange(30) < 29, RADIUS, TOP_RADIUS)[:, None, None]
    rings = radii * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    levels = np.broadcast_to(z[:, None, None], (30, 48, 1))
    return tube(np.concatenate([rings, levels], axis=2))


def scanned(surface: BoneSurface, point: Floats, normal: Floats) -> BoneSurface:
    """The part of a surface on the side to which a plane's normal points, closed at the plane."""
    n = unit_vectors(np.asarray(normal, dtype=float))
    a = unit_vectors(np.cross([0.0, 1.0, 0.0], n))
    axes = np.stack([a, np.cross(n, a), n])
    x = (surface.points - point) @ axes.T
    kept = shaft.clipped(replace(surface, points=x), 0.0)
    lines = lines_at_height(x[:, :2], x[:, 2], surface.triangles)
    edge = np.concatenate([lines, np.zeros((len(lines), 2, 1))], axis=2)
    middle = np.broadcast_to(edge.reshape(-1, 3).mean(axis=0), edge[:, 0].shape)
    cap = np.stack([middle, edge[:, 1], edge[:, 0]], axis=1)
    welded = welding.weld(np.concatenate([kept, cap]))
    return BoneSurface(welded.points @ axes + point, welded.triangles)


def below_head(surface: BoneSurface, below: float, tilt: float = 0.0) -> BoneSurface:
    """A surface that ends with a scan below the centre of mantle's femoral head [mm, rad]."""
    head = landmarks.find_landmarks(parametric_femur()).head
    return scanned(surface, head - [0.0, 0.0, below], np.array([math.sin(tilt), 0, math.cos(tilt)]))


@pytest.mark.parametrize("tilt", [0.0, 10.0, 20.0])
def test_shaft_end_of_a_cylinder(tilt: float) -> None:
    """The plane of an oblique end reaches r tan(tilt) above its middle."""
    angle = math.radians(tilt)
    normal = np.array([math.sin(angle), 0.0, math.cos(angle)])
    surface = scanned(cylinder(), np.array([0.0, 0.0, -30.0]), normal)
    assert shaft.flat_end(surface) == pytest.approx(normal, abs=1e-6)
    end = -30.0 + RADIUS * math.tan(angle) + shaft.EDGE_ROUNDING
    assert shaft.end_level(surface, np.array([0.0, 0.0, 1.0])) == pytest.approx(end, abs=0.05)


def test_shaft_clipped_keeps_the_area_above() -> None:
    """Two levels of a cylinder differ by the wall between them."""

    def area(level: float) -> float:
        a, b, c = shaft.clipped(cylinder(), level).transpose(1, 0, 2)
        assert min(v[:, 2].min() for v in (a, b, c)) >= level - 1e-9
        return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())

    chord = 2 * 48 * RADIUS * math.sin(math.pi / 48)
    assert area(-33.3) - area(21.7) == pytest.approx(chord * 55.0, rel=1e-9)


@pytest.mark.parametrize("below", [75.0, 100.0, 150.0])
def test_shaft_continued_is_that_of_the_whole_femur(tmp_path: Path, below: float) -> None:
    """Mean radius and axis below the end of the scan are within the interval of the axis."""
    write(tmp_path / "bone.stl", below_head(parametric_femur(), below))
    geometry = patient(
        tmp_path, bone={"surface": "bone.stl", "unit": "mm"}, canal={"ream": "broach"}
    )
    femur, whole = geometry.femur, landmarks.find_landmarks(parametric_femur())
    end = geometry.continued_below
    assert end is not None
    assert end == pytest.approx(54.0 - below - whole.origin[2] + shaft.EDGE_ROUNDING, abs=3.0)
    lean = math.acos(min(1.0, femur.frame.axes[2] @ whole.axes[2]))
    assert lean <= max(femur.frame.spread["shaft"], math.radians(0.5))
    for z in (end - 20.0, end - 50.0):
        middle, area = centroid(femur.surface.level(z))
        expected = centroid(parametric_femur().level(z + whole.origin[2]))[1]
        assert math.sqrt(area / expected) == pytest.approx(1.0, abs=0.06)
        place = middle @ femur.frame.axes[:2] + z * femur.frame.axes[2] + femur.frame.origin
        aside = math.hypot(*place[:2])
        assert aside < 1.5 + (end - z + 40.0) * math.tan(max(lean, 0.01))


def test_shaft_continued_carries_canal_and_mesh(tmp_path: Path) -> None:
    """A canal that ends with the scan continues with the bone. The mesh has the required length."""
    write(tmp_path / "bone.stl", below_head(parametric_femur(), 150.0))
    write(tmp_path / "canal.stl", below_head(parametric_canal(), 150.0))
    geometry = patient(
        tmp_path,
        bone={"surface": "bone.stl", "unit": "mm"},
        canal={"surface": "canal.stl", "ream": "broach"},
    )
    data = made(geometry)
    assert data.points[:, 2].min() == pytest.approx(geometry.level, abs=1e-3)
    assert geometry.level < geometry.continued_below - 80.0
    assert "where the scan ends" in geometry.details["continued shaft"]
    inner = centroid(geometry.femur.canal.level(geometry.continued_below - 15.0))[1]
    radius = femur_bone.Tube(femur_bone.CANAL).radius(np.linspace(0, 6, 24), np.full(24, -111.0))
    assert math.sqrt(inner / math.pi) == pytest.approx(radius.mean(), rel=0.05)


def wide_canal(scale: float) -> BoneSurface:
    """The canal of mantle's femur, widened above the diaphysis by a factor at its top."""
    canal = parametric_canal()
    x = canal.points.copy()
    x[:, :2] *= (1.0 + (scale - 1.0) * np.clip((x[:, 2] + 55.0) / 20.0, 0.0, 1.0))[:, None]
    return replace(canal, points=x)


def mean_width(surface: BoneSurface, z: float) -> float:
    """Diameter of a circle with the area of a section [mm]."""
    return 2.0 * math.sqrt(centroid(surface.level(z))[1] / math.pi)


@pytest.mark.parametrize(("below", "most_wide"), [(85.0, 0.2), (150.0, 0.02)])
def test_shaft_canal_below_a_wide_metaphysis_is_that_of_a_shaft(
    tmp_path: Path, below: float, most_wide: float
) -> None:
    """The thin cortex of the metaphysis is not continued into the diaphysis."""
    write(tmp_path / "bone.stl", below_head(parametric_femur(), below))
    write(tmp_path / "canal.stl", below_head(wide_canal(1.4), below))
    keys = {"surface": "canal.stl", "ream": "broach"}
    geometry = patient(tmp_path, bone={"surface": "bone.stl", "unit": "mm"}, canal=keys)
    femur = geometry.femur
    expected = 2 * 6.2  # of the parametric isthmus
    assert mean_width(femur.canal, -125.0) == pytest.approx(expected, rel=most_wide)
    assert femur.continuation.canal.isthmus == pytest.approx(
        mean_width(femur.canal, -125.0), rel=0.01
    )
    assert femur.assumed_isthmus == femur.continuation.canal.isthmus
    assert "wide at its isthmus, assumed" in geometry.details["canal"]
    given = patient(
        tmp_path, bone={"surface": "bone.stl", "unit": "mm"}, canal=keys | {"isthmus": "15 mm"}
    )
    assert mean_width(given.femur.canal, -125.0) == pytest.approx(15.0, rel=0.01)
    assert geometry.femur.canal.points[:, 2].min() == given.femur.canal.points[:, 2].min()
    with pytest.raises(ValidationError, match=r"leaves less than 1\.5 mm of cortex"):
        patient(
            tmp_path, bone={"surface": "bone.stl", "unit": "mm"}, canal=keys | {"isthmus": "26 mm"}
        )


@pytest.mark.parametrize("below", [None, 76.0])
def test_shaft_canal_by_ratios_has_a_given_isthmus(tmp_path: Path, below: float | None) -> None:
    """The default isthmus is as wide as the parametric one, on a whole bone and on a scan of it."""
    surface = parametric_femur()
    write(tmp_path / "bone.stl", surface if below is None else below_head(surface, below))
    bone = {"surface": "bone.stl", "unit": "mm"}
    assumed = patient(tmp_path, bone=bone, canal={})
    isthmus = 12.4  # mean of 12.3 and 12.5 mm of the parametric femur
    assert assumed.femur.assumed_isthmus == pytest.approx(isthmus, rel=0.02)
    assert "wide at its isthmus, assumed" in assumed.details["canal"]
    given = patient(tmp_path, bone=bone, canal={"isthmus": "15 mm"})
    assert given.details["canal"] == "15.0 mm wide at its isthmus, given"

    def width(geometry: Patient, z: float) -> float:
        """Mean width of the canal at a level."""
        layers = geometry.surfaces(MeshOptions.model_validate({"size": "8 mm"})).bone
        assert isinstance(layers, MeasuredLayers)
        angles, zeta = np.linspace(0.0, 2.0 * math.pi, 48, endpoint=False), np.full(48, 0.0)
        for _ in range(5):  # sections lean
            zeta += z - geometry.placement.to_model(layers.canal(angles, zeta))[:, 2]
        x, y, _ = geometry.placement.to_model(layers.canal(angles, zeta)).T
        area = 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
        return 2.0 * math.sqrt(area / math.pi)

    assert width(assumed, -113.0) == pytest.approx(assumed.femur.assumed_isthmus, rel=0.01)
    assert width(given, -113.0) == pytest.approx(15.0, rel=0.01)
    assert width(given, 5.0) == pytest.approx(width(assumed, 5.0), rel=1e-3)
    with pytest.raises(ValidationError, match=r"leaves less than 1\.5 mm of cortex"):
        patient(tmp_path, bone=bone, canal={"isthmus": "26 mm"})


def test_shaft_points_below_the_end_have_places_in_the_scan(tmp_path: Path) -> None:
    """A point of the continued wall has the modulus at its relative depth in the last section."""
    write(tmp_path / "bone.stl", below_head(parametric_femur(), 100.0))
    femur = patient(tmp_path, bone={"surface": "bone.stl", "unit": "mm"}).femur
    continued, end = femur.continuation, femur.continuation.end
    wall = femur.surface.level(end)[:, 0]
    top = np.column_stack([wall, np.full(len(wall), end)])
    z = end - 60.0
    at = (
        continued.centre
        + (z - end) * continued.slope
        + continued.width(z) * (wall - continued.centre)
    )
    low = np.column_stack([at, np.full(len(at), z)])
    assert continued.scanned(low) == pytest.approx(top, abs=1e-9)
    above = top + np.array([0.0, 0.0, 5.0])
    assert continued.scanned(above) == pytest.approx(above, abs=1e-9)


def test_shaft_points_of_a_continued_wall_are_not_in_the_canal_of_the_scan(
    tmp_path: Path,
) -> None:
    """The middle of the wall is moved up to the middle of the wall of the last section.

    That wall is thinner, because its canal is that of the metaphysis.
    """
    write(tmp_path / "bone.stl", below_head(parametric_femur(), 85.0))
    write(tmp_path / "canal.stl", below_head(wide_canal(1.4), 85.0))
    keys = {"surface": "canal.stl", "ream": "broach"}
    femur = patient(tmp_path, bone={"surface": "bone.stl", "unit": "mm"}, canal=keys).femur
    continued, end = femur.continuation, femur.continuation.end
    angles = np.linspace(0.0, 6.0, 7)
    z = end - 70.0

    def middle_of_wall(level: float) -> Floats:
        centre = continued.centre + (level - end) * continued.slope
        inner, outer = (
            exits(surface.level(level) - centre, angles)[0]
            for surface in (femur.canal, femur.surface)
        )
        directions = np.column_stack([np.cos(angles), np.sin(angles)])
        x = centre + (0.5 * (inner + outer))[:, None] * directions
        return np.column_stack([x, np.full(7, level)])

    assert continued.scanned(middle_of_wall(z)) == pytest.approx(middle_of_wall(end), abs=0.05)
    above = middle_of_wall(end) + np.array([0.0, 0.0, 5.0])
    assert continued.scanned(above) == pytest.approx(above, abs=1e-9)


@pytest.mark.parametrize(
    ("below", "changes", "message"),
    [
        (60.0, {}, "no lesser trochanter|direction of the shaft needs"),
        (45.0, {}, "ends 4[45] mm below"),
        (120.0, {"extend": False}, "mm of bone are missing; set geometry.bone.extend: true"),
    ],
)
def test_shaft_refuses_a_scan_that_ends_too_high(
    tmp_path: Path, below: float, changes: dict[str, Any], message: str
) -> None:
    """The scan ends at the lesser trochanter, above it, or next to the stem.

    No continuation is possible there.
    """
    write(tmp_path / "bone.stl", below_head(parametric_femur(), below))
    with pytest.raises((ValidationError, GeometryError), match=message):
        patient(tmp_path, bone={"surface": "bone.stl", "unit": "mm"} | changes)


@pytest.mark.parametrize("below", [24.0, 34.0, 45.0, 50.0, 58.0])
def test_shaft_missing_length_is_that_of_a_scan_that_is_accepted(
    tmp_path: Path, below: float
) -> None:
    """The scan lacks the way to the lesser trochanter and 0.75 head radii of shaft below it.

    3 mm at the end of a surface do not count, since its edge may be round.
    """
    frame = landmarks.find_landmarks(parametric_femur())
    trochanter = float(frame.head[2] - frame.trochanter[2])
    surface = below_head(parametric_femur(), below)
    with pytest.raises(GeometryError, match=r"ends about \d+ mm lower") as caught:
        landmarks.find_landmarks(surface)
    found = re.search(r"about (\d+) mm lower", str(caught.value))
    assert found
    assert float(found[1]) == pytest.approx(trochanter + 0.75 * frame.radius + 3.0 - below, abs=2)
    lower = landmarks.find_landmarks(below_head(parametric_femur(), below + float(found[1]) + 2.0))
    assert lower.trochanter == pytest.approx(frame.trochanter, abs=2.0)


def test_shaft_cut_below_a_continued_shaft_names_the_end_of_the_scan(tmp_path: Path) -> None:
    """The scan ends 150 mm below the head; the shaft is continued to below the isthmus."""
    write(tmp_path / "bone.stl", below_head(parametric_femur(), 150.0))
    keys = {"bone": {"surface": "bone.stl", "unit": "mm"}}
    whole = patient(tmp_path, **keys).femur
    end = float(whole.frame.to_model(whole.frame.head)[2]) - 150.0
    with pytest.raises(ValidationError) as caught:
        patient(tmp_path, **keys, distal_cut_z="-400 mm")
    found = re.search(r"surface, (-\d+) mm and continued to (-\d+) mm", str(caught.value))
    assert found
    assert float(found[1]) == pytest.approx(end, abs=1.0)
    assert float(found[2]) == pytest.approx(whole.lowest, abs=1.0)
