"""Surfaces of bones as STL files: the parametric femur in triangles, and a measured one."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pydicom

from app.case.femurs import IntactFemur
from app.case.shapes import MeshOptions
from app.foundation.arrays import Bools, Floats
from app.patient.bone_surface import BoneSurface
from meshes import femur_bone, femur_intact
from meshes.data import exterior_facets

LINES = 24  # around the parametric femur here: a polygon within its sections
VERSION = 15.0  # deg: anteversion of the parametric femur here
MEASURED = Path("/work/shared/data/femur_right_mm.stl")
MEASURED_CANAL = MEASURED.with_name("femur_right_canal_mm.stl")


@cache
def parametric_femur(version: float = VERSION, around: int = LINES) -> BoneSurface:
    """The parametric intact femur, cells of 3 mm: left, in its axes, closed, without condyles."""
    geometry = IntactFemur.model_validate(
        {"anteversion": f"{version} deg", "distal_cut_z": "-260 mm"}
    )
    mesh = MeshOptions.model_validate({"size": "3 mm", "order": 1, "around": around})
    data = femur_intact.build(geometry, mesh.model_copy(update={"curved": False}))
    facets, _ = exterior_facets(data.cells)
    used, triangles = np.unique(facets, return_inverse=True)
    return BoneSurface(data.points[used], triangles.reshape(-1, 3))


def tube(rings: Floats) -> BoneSurface:
    """A surface through rings from below (n, k, 3), with flat ends."""
    n, k = rings.shape[:2]
    points = np.concatenate([rings.reshape(-1, 3), rings[[0, -1]].mean(axis=1)])
    i, j = (v.ravel() for v in np.meshgrid(np.arange(n - 1), np.arange(k), indexing="ij"))
    a, b = k * i + j, k * i + (j + 1) % k
    j, after, top = np.arange(k), (np.arange(k) + 1) % k, (n - 1) * k
    low, high = np.full(k, n * k), np.full(k, n * k + 1)
    sides = [np.stack([a, b, b + k], 1), np.stack([a, b + k, a + k], 1)]
    caps = [np.stack([after, j, low], 1), np.stack([top + j, top + after, high], 1)]
    return BoneSurface(points, np.concatenate(sides + caps))


def parametric_canal() -> BoneSurface:
    """The canal of mantle's femur, between two levels, with flat ends."""
    theta, z = np.meshgrid(2 * np.pi * np.arange(48) / 48, np.linspace(-250.0, -25.0, 80))
    radius = femur_bone.Tube(femur_bone.CANAL).radius(theta, z)
    return tube(np.stack([radius * np.cos(theta), radius * np.sin(theta), z], axis=2))


def moved(surface: BoneSurface, turn: Floats, shift: Floats) -> BoneSurface:
    """A surface after rotation or reflection and shift, with outward normals."""
    triangles = surface.triangles[:, :: 1 if np.linalg.det(turn) > 0 else -1]
    return replace(surface, points=surface.points @ turn.T + shift, triangles=triangles)


def opened(surface: BoneSurface, low: float) -> BoneSurface:
    """The part above a level, open at the level."""
    above = (surface.points[surface.triangles, 2] > low).all(axis=1)
    used, triangles = np.unique(surface.triangles[above], return_inverse=True)
    return BoneSurface(surface.points[used], triangles.reshape(-1, 3))


def write(path: Path, surface: BoneSurface, scale: float = 1.0) -> Path:
    """Write a binary STL file."""
    kind = np.dtype([("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    rows = np.zeros(len(surface.triangles), dtype=kind)
    rows["v"] = scale * surface.corners
    path.write_bytes(b"\0" * 80 + np.uint32(len(rows)).tobytes() + rows.tobytes())
    return path


def slices(folder: Path, values: Any, affine: Floats, series: str = "1.2") -> Path:
    """Write numbers (i, j, k), multiples of 1/2, as DICOM slices of (i, j), out of order by names.

    The standard is C.7.6.2. The affine to mm is that of NIfTI: right, anterior, superior positive.
    """
    folder.mkdir(exist_ok=True, parents=True)
    s = pydicom.dcmread(pydicom.data.get_testdata_file("CT_small.dcm"))
    lps, n = np.diag([-1.0, -1.0, 1.0]) @ affine[:3], values.shape[2]
    edge = np.linalg.norm(lps[:, :2], axis=0)
    s.SeriesInstanceUID, s.RescaleSlope, s.RescaleIntercept = series, 0.5, -1000
    s.Columns, s.Rows = values.shape[:2]
    s.PixelSpacing = np.round(edge[::-1], 6).tolist()
    s.ImageOrientationPatient = np.round(lps[:, :2] / edge, 6).T.ravel().tolist()
    for k in range(n):
        s.ImagePositionPatient = np.round(lps @ [0, 0, k, 1], 6).tolist()
        s.PixelData = (2 * values[:, :, k].T + 2000).astype("<i2").tobytes()
        s.save_as(folder / f"{series}.{7 * k % n}")
    return folder


def enhanced(path: Path, values: Any, affine: Floats) -> Path:
    """Write numbers as one DICOM file of many frames, an enhanced CT, its frames out of order.

    The standard is C.7.6.16: one group has the shared attributes of frames, others their places.
    Each frame has an intercept.
    """
    one = slices(path.parent / "slices", values, affine)
    files = [pydicom.dcmread(file) for file in sorted(one.iterdir())]
    whole = files[0]
    whole.SOPClassUID = whole.file_meta.MediaStorageSOPClassUID = "1.2.840.10008.5.1.4.1.1.2.1"
    shared = pydicom.Dataset()
    shared.PixelMeasuresSequence = [part(whole, "PixelSpacing")]
    shared.PlaneOrientationSequence = [part(whole, "ImageOrientationPatient")]
    whole.SharedFunctionalGroupsSequence, groups = [shared], []
    for k, file in enumerate(files):
        group = pydicom.Dataset()
        group.PlanePositionSequence = [part(file, "ImagePositionPatient")]
        file.PixelData = (file.pixel_array + 2 * k).astype("<i2").tobytes()
        file.RescaleIntercept -= k
        group.PixelValueTransformationSequence = [part(file, "RescaleSlope", "RescaleIntercept")]
        group.FrameContentSequence = [pydicom.Dataset()]
        group.FrameContentSequence[0].StackID = "1"
        groups.append(group)
    whole.PerFrameFunctionalGroupsSequence = groups
    whole.NumberOfFrames = len(files)
    whole.PixelData = b"".join(file.PixelData for file in files)
    for tag in ("ImagePositionPatient", "ImageOrientationPatient", "PixelSpacing"):
        delattr(whole, tag)
    del whole.RescaleSlope, whole.RescaleIntercept
    whole.save_as(path)
    return path


def part(data: Any, *tags: str) -> Any:
    """A data set of some tags of another one."""
    made = pydicom.Dataset()
    made.update({data[tag].tag: data[tag] for tag in tags})
    return made


def inside(surface: BoneSurface, x: Floats, y: Floats, z: Floats) -> Bools:
    """True at lattice points inside of a surface (x, y, z), by parity along rows of x."""
    times = np.zeros((len(x) + 1, len(y), len(z)), dtype=np.int8)
    for a, b, c in surface.corners:
        low, high = np.minimum(a, np.minimum(b, c)), np.maximum(a, np.maximum(b, c))
        j, k = (np.arange(*np.searchsorted(g, (low[i], high[i]))) for i, g in ((1, y), (2, z)))
        u, v = np.meshgrid(y[j] - a[1], z[k] - a[2], indexing="ij")
        (p, q), (r, s) = (b - a)[1:], (c - a)[1:]
        area = p * s - q * r
        if not u.size or not area:
            continue
        one, two = (u * s - v * r) / area, (v * p - u * q) / area
        met = (one >= 0) & (two >= 0) & (one + two <= 1)
        at = a[0] + one * (b - a)[0] + two * (c - a)[0]
        row, column = np.nonzero(met)
        times[np.searchsorted(x, at[met]), j[row], k[column]] ^= 1
    return np.asarray(np.bitwise_xor.accumulate(times, axis=0)[:-1], dtype=bool)


def turned(x: Floats, angle: float) -> Floats:
    """Points (n, 3) turned about z, from x towards y [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return np.asarray(x @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]))


def cut(geometry: Any) -> tuple[Floats, float]:
    """Unit normal n and level c of the parametric femur's cut, in axes that turn with its neck."""
    angle, height = geometry.resection.angle, geometry.resection.height
    normal = np.array([math.sin(angle), 0.0, math.cos(angle)])
    edge = femur_bone.PERIOSTEUM.radius(np.array(geometry.anteversion), np.array(height))
    return normal, float(normal @ [float(edge), 0.0, height])
