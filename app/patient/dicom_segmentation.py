"""Segmentations as DICOM objects (SEG), as 3D Slicer and AI tools in hospitals write them.

Each frame is the mask of one segment in one plane. Planes without a voxel are left out by most
programs. Source: DICOM PS3.3, A.51 and C.8.20.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from app.foundation.arrays import Bools, Floats, Numbers
from app.foundation.errors import InputError
from app.patient import dicom_series
from app.patient.voxels import LabelSegment, Voxels

STORAGE = "1.2.840.10008.5.1.4.1.1.66.4"
PLANE_TOLERANCE = 0.1  # largest distance of a frame from its place, as a part of the step


def is_segmentation(header: Any) -> bool:
    """Return True if the header of a file is that of a segmentation."""
    return str(header.get("SOPClassUID", "")) == STORAGE


def read(path: Path, header: Any, left_out: Sequence[str]) -> Voxels:
    """Read the segments of a file as numbers in layers.

    Segments that do not overlap are in one layer, with the numbers of the segments.

    Args:
        path: The file, or its folder, for messages.
        header: Header of the file.
        left_out: Notes on other files of its folder.

    Raises:
        InputError: The masks are fractions, or their planes are not parallel at multiples of one
            step.
    """
    if str(header.get("SegmentationType", "BINARY")) != "BINARY":
        raise InputError(
            f"{path}: its masks are fractional (SegmentationType {header.SegmentationType});"
            " export binary masks or a labelmap"
        )
    frames = dicom_series.frames_of_file(header)
    dicom_series.check_equal(path, frames)
    plane_of_frame, affine = _planes(path, frames)
    masks = dicom_series.pixels(header).astype(bool)
    shape = int(header.Columns), int(header.Rows), int(plane_of_frame.max()) + 1
    layers: list[Numbers] = []
    segments = dict[str, LabelSegment]()
    for segment_header in header.get("SegmentSequence") or ():
        number = int(segment_header.SegmentNumber)
        mask = np.zeros(shape, dtype=bool)
        for frame, plane, pixels in zip(frames, plane_of_frame, masks, strict=True):
            if int(frame.get("ReferencedSegmentNumber", 0)) == number:
                mask[:, :, plane] |= pixels.T
        name = str(segment_header.get("SegmentLabel") or f"segment {number}")
        name = f"{name} ({number})" if name in segments else name
        segments[name] = LabelSegment(number, _put_into_layer(layers, mask, number))
    named = {segment.value for segment in segments.values()}
    unnamed = sum(int(frame.get("ReferencedSegmentNumber", 0)) not in named for frame in frames)
    if unnamed or not segments:
        raise InputError(f"{path}: {unnamed} frames belong to no segment; is the file damaged?")
    kind = f"{len(frames)} DICOM frames of {len(segments)} segments (SEG)"
    values = np.stack(layers, axis=-1)
    return Voxels(values, affine, kind, tuple(left_out), segments=segments)


def _put_into_layer(layers: list[Numbers], mask: Bools, number: int) -> int:
    """Write a mask into the first layer where its voxels are free; return the layer."""
    for k, layer in enumerate(layers):
        if not layer[mask].any():
            layer[mask] = number
            return k
    layers.append(np.where(mask, number, 0).astype(np.uint16))
    return len(layers) - 1


def _planes(path: Path, frames: Sequence[Any]) -> tuple[Any, Floats]:
    """Return the number of the plane of each frame (n,), and the affine to mm.

    Raises:
        InputError: The planes are not at multiples of one step.
    """
    row_direction, column_direction = np.split(
        np.mean([f.ImageOrientationPatient for f in frames], axis=0), 2
    )
    normal = np.cross(row_direction, column_direction)
    positions = np.array([f.ImagePositionPatient for f in frames], dtype=float)
    heights = positions @ normal
    levels = np.unique(heights)
    gaps = np.diff(levels)
    gaps = gaps[gaps > dicom_series.SAME_PLACE]
    if not len(gaps):
        fault = f"has only one slice, {dicom_series.name_of_slice(frames[0])}"
        raise InputError(f"{path}: {fault}; expected several")
    origin = positions[heights.argmin()]
    step = float(gaps.min())
    plane_of_frame = np.round((heights - levels[0]) / step).astype(int)
    # The mean step: rounding of each gap has no effect on it.
    step = float((levels[-1] - levels[0]) / plane_of_frame.max())
    plane_of_frame = np.round((heights - levels[0]) / step).astype(int)
    distances = np.linalg.norm(positions - origin - step * plane_of_frame[:, None] * normal, axis=1)
    if distances.max() > PLANE_TOLERANCE * step:
        farthest_frame = dicom_series.name_of_slice(frames[int(distances.argmax())])
        fault = f"its planes are {gaps.min():.3g} to {gaps.max():.3g} mm apart"
        raise InputError(
            f"{path}: {fault}; {farthest_frame} is not at a multiple of one step. Resample it"
        )
    spacing = np.array(frames[0].PixelSpacing, dtype=float)
    affine = np.eye(4)
    columns = row_direction * spacing[1], column_direction * spacing[0], step * normal, origin
    affine[:3] = np.stack(columns, axis=1)
    affine[:2] *= -1
    return plane_of_frame, affine
