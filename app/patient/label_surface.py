"""Triangles around the voxels of a label in an image."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_array, diags_array

from app.foundation.arrays import Floats, Ints
from app.foundation.errors import InputError
from app.patient import images

NEARLY = 0.05  # largest difference of a label from a whole number
# Steps of Taubin's smoothing. It keeps shapes that are wider than a dozen of voxels.
SHRINK = 0.5
GROW = -0.53
SMOOTHINGS = 10  # number of pairs of both steps


def read(path: Path, label: int) -> tuple[Floats, list[str]]:
    """Return triangles (m, 3, 3) [mm] around the largest body of a label, and notes.

    Holes in the body are filled, and the steps of voxels are smoothed.

    Raises:
        InputError: The image cannot be read, is no image of labels, or does not have this one.
    """
    image = images.read(path)
    values, rounded = whole(path, image.values)
    notes = [*image.summary, *rounded]
    try:
        from skimage import measure
    except ModuleNotFoundError as error:
        raise images.missing(path, error) from None
    inside = values == label
    if not inside.any():
        labels = ", ".join(f"{v:g}" for v in np.unique(values)[:9])
        raise InputError(f"{path}: has no label {label}; it has {labels}")
    (box,) = ndimage.find_objects(inside.view(np.int8))
    pieces, count = ndimage.label(np.pad(inside[box], 1))
    sizes = np.bincount(pieces.ravel())[1:]
    body = pieces == sizes.argmax() + 1
    if count > 1:
        notes.append(f"{sizes.sum() - sizes.max():,} voxels in {count - 1} other pieces left out")
    # A canal is a hole that is open at the end of a scan: the first or last layer of the box.
    for axis, layer in product(range(3), (1, -2)):
        face = np.moveaxis(body, axis, 0)[layer]
        face |= ndimage.binary_fill_holes(face)
    around, _ = ndimage.label(~body)
    solid = (around != around[0, 0, 0]).astype(np.float32)
    points, triangles, *_ = measure.marching_cubes(solid, 0.5)
    points = _smoothed(points - 1.0 + [s.start for s in box], triangles)
    matrix, origin = image.affine[:3, :3], image.affine[:3, 3]
    return (points @ matrix.T + origin)[triangles], notes


def whole(path: Path, values: Any) -> tuple[Any, list[str]]:
    """Return labels as whole numbers, and notes on those that were rounded.

    Raises:
        InputError: There are values between whole numbers, as interpolation makes them.
    """
    if values.dtype.kind != "f":
        return values, []
    finite = np.isfinite(values)
    known = np.where(finite, values, 0.0)
    rounded = np.round(known)
    off = np.abs(known - rounded)
    between = off > NEARLY
    if between.any():
        raise InputError(
            f"{path}: {int(between.sum()):,} voxels have values between whole numbers, as"
            f" {known[between][0]:.4g}: no labels; resample the segmentation by nearest neighbour"
        )
    notes = []
    if off.any():
        notes.append(f"labels rounded by up to {off.max():.2g}")
    lost = int((~finite).sum())
    if lost:
        notes.append(f"{lost:,} voxels are no numbers: taken as 0")
    return rounded, notes


def _smoothed(points: Floats, triangles: Ints) -> Floats:
    """Return corners (n, 3) without the steps of voxels, by Taubin's smoothing."""
    ends, n = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).T, len(points)
    near = coo_array((np.ones(len(ends[0])), ends), (n, n)).tocsr()
    near = diags_array(1 / near.sum(axis=1)) @ near
    for step in (SHRINK, GROW) * SMOOTHINGS:
        points = points + step * (near @ points - points)
    return points
