"""Images of bones: numbers on a lattice of voxels, read from files and interpolated."""

from __future__ import annotations

import hashlib
from collections import Counter
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_array, diags_array

from app.arrays import Floats, Ints
from app.errors import InputError
from app.files import parts

TILT = 0.01  # cosine of the angle between edges of voxels, at most
UNEVEN = 0.1  # of the step between slices: how far one may be from its place, at most
# Steps of Taubin's smoothing, and how often both: it leaves what is wider than a dozen of voxels.
SHRINK, GROW, SMOOTHINGS = 0.5, -0.53, 10


@dataclass(frozen=True)
class Image:
    """An image: numbers of voxels (i, j, k), the matrix from (i, j, k, 1) to their middles [mm]."""

    values: Any
    affine: Floats

    @cached_property
    def sha256(self) -> str:
        """Hash of numbers and places."""
        digest = hashlib.sha256(np.round(self.affine, 6).tobytes())
        digest.update(np.ascontiguousarray(self.values))
        return digest.hexdigest()

    @cached_property
    def dense(self) -> float:
        """Number that is exceeded in one voxel of a thousand."""
        return float(np.percentile(self.values, 99.9))

    def at(self, x: Floats) -> Floats:
        """Values at points (n, 3) [mm], linear between voxels (n,); none of them may be outside."""
        index = (x - self.affine[:3, 3]) @ np.linalg.inv(self.affine[:3, :3]).T
        values = ndimage.map_coordinates(self.values, index.T, float, order=1, cval=np.nan)
        if (lost := ~np.isfinite(values)).any():
            text = f"{int(lost.sum()):,} of {len(x):,} points are outside of the image, as "
            text += "({:.0f}, {:.0f}, {:.0f}) mm".format(*x[lost][0])
            raise InputError(f"{text}: is it in other axes? See the key `axes`")
        return np.asarray(values)


def read(path: Path) -> Image:
    """Read NIfTI, a folder of DICOM, or ``values`` and ``affine`` in an ``.npz``; or InputError."""
    return _read(path, max(file.stat().st_mtime_ns for file in (path, *parts(path))))


@lru_cache(maxsize=2)
def _read(path: Path, _changed: int) -> Image:
    try:
        reader = _dicom if path.is_dir() else _npz if path.suffix == ".npz" else _nifti
        values, affine = reader(path)
        values, affine = np.squeeze(values), np.asarray(affine, dtype=float).reshape(4, 4)
    except InputError:
        raise
    except Exception as error:  # damaged files let readers fail in any way
        raise InputError(f"{path}: is no image that can be read: {error}") from error
    if values.ndim != 3 or values.dtype.kind not in "iuf":
        raise InputError(f"{path}: is {values.dtype} in {values.ndim} dimensions, not numbers in 3")
    edges = np.linalg.norm(affine[:3, :3], axis=0)
    if not (np.isfinite(affine).all() and edges.all()):
        raise InputError(f"{path}: has no spacing of its voxels: {edges} mm")
    u = affine[:3, :3] / edges
    if np.abs(u.T @ u - np.eye(3)).max() > TILT:
        raise InputError(f"{path}: its axes are not square, of a tilted gantry? Resample it")
    return Image(values, affine)


def _module(name: str, path: Path) -> Any:
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        text = f"{path}: needs {error.name}, which `mantle setup --images` installs"
        raise InputError(text) from None


def _npz(path: Path) -> tuple[Any, Any]:
    with np.load(path) as arrays:
        return arrays["values"], arrays["affine"]


def _nifti(path: Path) -> tuple[Any, Any]:
    image = _module("nibabel", path).load(path)
    values, header = np.asanyarray(image.dataobj), image.header
    if not (header["sform_code"] or header["qform_code"]):
        raise ValueError("its header has neither qform nor sform: no spacing, no axes")
    if (unit := header.get_xyzt_units()[0]) not in ("mm", "unknown"):
        raise ValueError(f"it is in {unit}; expected mm")
    return values, image.affine


def _dicom(path: Path) -> tuple[Any, Any]:
    """Of a series of slices; its axes, to left and posterior, are turned to right and anterior."""
    dicom = _module("pydicom", path)
    slices = [dicom.dcmread(f) for f in parts(path) if dicom.misc.is_dicom(f)]
    kinds = Counter(
        (s.SeriesInstanceUID, *np.round([*s.ImageOrientationPatient, *s.PixelSpacing], 4))
        for s in slices
    )
    if len(kinds) != 1 or len(slices) < 2:
        counts = ", ".join(str(n) for n in kinds.values()) or "no"
        raise InputError(f"{path}: has {counts} slices; expected those of one series, in one plane")
    ((_, *given),) = kinds
    across, down, spacing = np.split(np.array(given), [3, 6])
    normal = np.cross(across, down)
    slices.sort(key=lambda s: float(normal @ s.ImagePositionPatient))
    at = np.array([s.ImagePositionPatient for s in slices], dtype=float)
    step = (at[-1] - at[0]) / (len(at) - 1)
    gaps = np.linalg.norm(np.diff(at, axis=0), axis=1)
    off = np.linalg.norm(at - at[0] - np.outer(range(len(at)), step), axis=1)
    if not off.max() < UNEVEN * np.linalg.norm(step):
        text = f"{path}: its slices are {gaps.min():.3g} to {gaps.max():.3g} mm apart"
        after = Path(slices[gaps.argmax()].filename).name
        raise InputError(f"{text}; is one missing after {after}? Resample them evenly")
    line = [(s.get("RescaleSlope", 1), s.get("RescaleIntercept", 0)) for s in slices]
    lines = zip(np.array(line, "f4"), slices, strict=True)
    affine = np.eye(4)
    affine[:3] = np.stack([across * spacing[1], down * spacing[0], step, at[0]], axis=1)
    affine[:2] *= -1
    return np.stack([a * s.pixel_array + b for (a, b), s in lines]).T, affine


def surface(path: Path, label: int) -> tuple[Floats, list[str]]:
    """Triangles (m, 3, 3) [mm] around the largest body of a label, and what was left out.

    Holes in it are filled, and steps of voxels smoothed.
    """
    image, measure, told = read(path), _module("skimage.measure", path), []
    inside = image.values == label
    if not inside.any():
        labels = ", ".join(f"{v:g}" for v in np.unique(image.values)[:9])
        raise InputError(f"{path}: has no label {label}; it has {labels}")
    (box,) = ndimage.find_objects(inside.view(np.int8))
    pieces, count = ndimage.label(np.pad(inside[box], 1))
    sizes = np.bincount(pieces.ravel())[1:]
    body = pieces == sizes.argmax() + 1
    if count > 1:
        told.append(f"{sizes.sum() - sizes.max():,} voxels in {count - 1} other pieces left out")
    for axis, end in np.ndindex(3, 2):  # a canal is a hole that a scan's end leaves open
        face = np.moveaxis(body, axis, 0)[1 - 3 * end]
        face |= ndimage.binary_fill_holes(face)
    around, _ = ndimage.label(~body)
    solid = (around != around[0, 0, 0]).astype(np.float32)
    points, triangles, *_ = measure.marching_cubes(solid, 0.5)
    points = _smoothed(points - 1.0 + [s.start for s in box], triangles)
    matrix, origin = image.affine[:3, :3], image.affine[:3, 3]
    return (points @ matrix.T + origin)[triangles], told


def _smoothed(points: Floats, triangles: Ints) -> Floats:
    """Corners (n, 3) without the steps of voxels, by Taubin: shrinking steps and growing ones."""
    ends, n = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).T, len(points)
    near = coo_array((np.ones(len(ends[0])), ends), (n, n)).tocsr()
    near = diags_array(1 / near.sum(axis=1)) @ near
    for step in (SHRINK, GROW) * SMOOTHINGS:
        points = points + step * (near @ points - points)
    return points
