"""Triangles around the voxels of a label in an image."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_array, diags_array

from app.foundation.arrays import Bools, Floats, Ints
from app.foundation.errors import InputError
from app.patient import images, label_image

# Steps of Taubin's smoothing. It keeps shapes that are wider than a dozen of voxels.
SHRINK = 0.5
GROW = -0.53
SMOOTHINGS = 10  # number of pairs of both steps
# Volume of the second body of a label, over that of the largest, from which they are two bones.
SECOND_BONE = 0.5
# Volume of left out pieces, over that of the largest body, from which they are a doubt.
DOUBTFUL_PIECES = 0.02


@dataclass(frozen=True)
class LabelBody:
    """The largest body of a label, without holes, in a box with an empty layer around it.

    Attributes:
        solid: True in its voxels (i, j, k).
        level: Distance from its surface, positive inside (i, j, k) [voxels].
        affine: Matrix from (i, j, k, 1) to the middle of a voxel (4, 4) [mm].
        notes: What was read and left out, in words.
        doubts: Doubts about the image.
        borders: Places of its voxels in the outermost layers of the image, for each of the layers
            that has some (n, 3) [mm].
    """

    solid: Bools
    level: NDArray[np.float32]
    affine: Floats
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    borders: tuple[Floats, ...] = ()

    @property
    def spacing(self) -> Floats:
        """Edges of a voxel (3,) [mm]."""
        return np.asarray(np.linalg.norm(self.affine[:3, :3], axis=0))

    def places(self, index: Ints | Floats) -> Floats:
        """Return places of voxels (n, 3) [mm]."""
        return np.asarray(index @ self.affine[:3, :3].T + self.affine[:3, 3])


def read(path: Path, label: int) -> tuple[Floats, LabelBody]:
    """Return triangles (m, 3, 3) [mm] around the largest body of a label, and the body.

    Holes in the body are filled, and the steps of voxels are smoothed.

    Raises:
        InputError: The image cannot be read, is no image of labels, or does not have this one.
    """
    whole_body = body(path, label)
    return triangles_of_level(whole_body.level, whole_body), whole_body


def triangles_of_level(level: Floats | NDArray[np.float32], label_body: LabelBody) -> Floats:
    """Return triangles (m, 3, 3) [mm] on which a level of the voxels of a body is zero."""
    from skimage import measure

    points, triangles, *_ = measure.marching_cubes(level, 0.0)
    return label_body.places(_smoothed(points, triangles))[triangles]


def body(path: Path, label: int) -> LabelBody:
    """Return the largest body of a label, read once unless its files change.

    Slices that are thicker than their voxels are wide are interpolated by the distance from the
    outline in each slice. Source: Raya and Udupa, IEEE Trans. Med. Imaging 9 (1990) 32.

    Raises:
        InputError: The image cannot be read, is no image of labels, does not have this one, or has
            two bodies of it.
    """
    return _body(path, label, images.modification_time(path))


@lru_cache(maxsize=2)
def _body(path: Path, label: int, _changed: int) -> LabelBody:
    labels = label_image.read(path)
    notes, doubts = [*labels.notes], [*labels.doubts]
    try:
        import skimage  # noqa: F401
    except ModuleNotFoundError as error:
        raise images.missing(path, error) from None
    inside = labels.inside(label)
    (box,) = ndimage.find_objects(inside.view(np.int8))
    piece_labels, piece_count = ndimage.label(np.pad(inside[box], 1))
    sizes = np.bincount(piece_labels.ravel())[1:]
    solid = piece_labels == sizes.argmax() + 1
    if piece_count > 1:
        second, largest = np.sort(sizes)[-2:] * abs(np.linalg.det(labels.affine[:3, :3]))
        if second > SECOND_BONE * largest:
            raise InputError(
                f"{path}: label {label} has two bodies, of {largest / 1e3:.0f} and"
                f" {second / 1e3:.0f} cm3; expected one bone. Separate left and right into two"
                " labels (Split islands to segments in 3D Slicer)"
            )
        lost_voxels = sizes.sum() - sizes.max()
        note = f"{lost_voxels:,} voxels in {piece_count - 1} other pieces left out"
        (doubts if lost_voxels > DOUBTFUL_PIECES * sizes.max() else notes).append(note)
    # A canal is a hole that is open at the end of a scan: the first or last layer of the box.
    for axis, layer in product(range(3), (1, -2)):
        face = np.moveaxis(solid, axis, 0)[layer]
        face |= ndimage.binary_fill_holes(face)
    outside, _ = ndimage.label(~solid)
    solid = outside != outside[0, 0, 0]
    affine = labels.affine.copy()
    affine[:3, 3] += affine[:3, :3] @ [s.start - 1.0 for s in box]
    borders = tuple(_border_places(solid, box, inside.shape, affine))
    level = solid.astype(np.float32) - 0.5
    edges = np.linalg.norm(affine[:3, :3], axis=0)
    axis = int(edges.argmax())
    slice_factor = round(float(edges[axis] / np.median(edges)))
    if slice_factor > 1:
        level = _between_slices(solid, axis, slice_factor)
        affine[:3, axis] /= slice_factor
        notes.append(f"slices of {edges[axis]:g} mm interpolated {slice_factor}-fold")
    return LabelBody(level > 0, level, affine, tuple(notes), tuple(doubts), borders)


def _border_places(
    solid: Bools, box: Sequence[slice], shape: Sequence[int], affine: Floats
) -> Iterator[Floats]:
    """Places of the voxels of a body in each outermost layer that it reaches (n, 3) [mm].

    Args:
        solid: The body in its box with an empty layer around it (i, j, k).
        box: Place of the box in the image.
        shape: Number of voxels of the image (3,).
        affine: Matrix from voxels of `solid` to their places (4, 4) [mm].
    """
    index = np.argwhere(solid)
    for axis, extent in enumerate(box):
        for is_reached, layer in ((extent.start == 0, 1), (extent.stop == shape[axis], -2)):
            if is_reached:
                in_layer = index[index[:, axis] == layer % solid.shape[axis]]
                if len(in_layer):  # another piece may have been in the layer
                    yield in_layer @ affine[:3, :3].T + affine[:3, 3]


def _between_slices(solid: Bools, axis: int, slice_factor: int) -> NDArray[np.float32]:
    """Return distances from the outlines of slices, inside positive, with slices between them.

    Args:
        solid: The body (i, j, k), without voxels in its first and last slice.
        axis: Axis across the slices.
        slice_factor: Number of slices for each of the given ones.
    """
    slices: Bools = np.moveaxis(solid, axis, 0)
    outside = np.where(slices, 0, 1)
    distance = np.zeros(slices.shape, dtype=np.float32)
    is_filled = np.array([inside.any() for inside in slices])
    for k in np.flatnonzero(is_filled):
        distance[k] = ndimage.distance_transform_edt(slices[k])
        distance[k] -= ndimage.distance_transform_edt(outside[k])
    # Beside an end the body reaches half a slice: the negative distances of the last one.
    for empty in np.flatnonzero(~is_filled):
        neighbours = [k for k in (empty - 1, empty + 1) if 0 <= k < len(slices) and is_filled[k]]
        distance[empty] = -np.abs(distance[neighbours[0]]) if neighbours else -1.0
    slice_count = (len(slices) - 1) * slice_factor + 1
    lower_slice, remainder = np.divmod(np.arange(slice_count), slice_factor)
    upper_slice = np.minimum(lower_slice + 1, len(slices) - 1)
    weight = (remainder / slice_factor).astype(np.float32)[:, None, None]
    level = (1 - weight) * distance[lower_slice] + weight * distance[upper_slice]
    return np.asarray(np.moveaxis(np.clip(level, -2.0, 2.0), 0, axis))


def _smoothed(points: Floats, triangles: Ints) -> Floats:
    """Return corners (n, 3) without the steps of voxels, by Taubin's smoothing."""
    edge_ends, count = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).T, len(points)
    averaging = coo_array((np.ones(len(edge_ends[0])), edge_ends), (count, count)).tocsr()
    averaging = diags_array(1 / averaging.sum(axis=1)) @ averaging
    for step in (SHRINK, GROW) * SMOOTHINGS:
        points = points + step * (averaging @ points - points)
    return points
