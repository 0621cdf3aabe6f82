"""The medullary canal of a femur by the CT numbers inside its label."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import ndimage

from app.foundation.arrays import Floats
from app.foundation.errors import GeometryError, InputError
from app.patient import images, label_surface, shaft, welding
from app.patient.bone_surface import BoneSurface, outward
from app.patient.label_surface import LabelBody
from app.patient.landmarks import Frame
from meshes.plane_sections import centroid, mean_width

# Thickness of the wall that is bone whatever its CT numbers are [mm]: voxels there are partly
# outside.
WALL_THICKNESS = 1.5
# Typical change of CT numbers across the endosteum [1/mm].
GRADIENT = 500.0
# Thickness of the layer below this wall that is cortex in a shaft [mm].
CORTEX_LAYER = 1.0
# Least part of this layer that is above the threshold. Less is that of a CT that is mirrored or
# moved, and has a note.
NOTED_CORTEX_FRACTION = 0.75
# Less is refused: the canal would be the whole bone.
LEAST_CORTEX_FRACTION = 0.15
# CT number at the surface of cortical bone.
CORTEX_NUMBER = 600.0
# Mean thickness of the cortex in a shaft [mm]: beyond, a note is given.
USUAL_CORTEX = (2.0, 8.0)
# Number that some programs add to all CT numbers.
ADDED_NUMBER = 1024.0
# Spread of the filter against noise [mm].
NOISE_FILTER = 0.5
# Change of the threshold whose effect on the cortex is reported.
THRESHOLD_CHANGE = 100.0
# Distance of the canal's upper end below the lesser trochanter, in radii of the head [-].
BELOW_TROCHANTER = 0.6
# Shortest canal that is used [mm].
SHORTEST_CANAL = 12.0
# Distance between sections of which the thickness of the cortex is the mean [mm].
SECTION_STEP = 5.0


def contains_canal(frame: Frame) -> bool:
    """Return True if a scan contains enough of the shaft for its canal."""
    return -BELOW_TROCHANTER * frame.radius - frame.end >= SHORTEST_CANAL


def read(
    path: Path, body: LabelBody, threshold: float, frame: Frame, bone: BoneSurface
) -> BoneSurface:
    """Return the surface of the canal, in the model's axes.

    It is where CT numbers are below a threshold, from the end of the scan up to below the lesser
    trochanter. Above, cancellous bone has the same numbers.

    Args:
        path: The CT. Its voxels may be others than those of the label.
        body: Voxels of the femur.
        threshold: CT number at the endosteum.
        frame: Landmarks of the femur.
        bone: Its outer surface, in the model's axes.

    Raises:
        InputError: The CT cannot be read, or does not contain the femur.
        GeometryError: There is no canal by this threshold, or too short a part of it.
    """
    depth = ndimage.distance_transform_edt(body.solid, sampling=body.spacing)
    inner_voxels = np.argwhere(depth > WALL_THICKNESS)
    numbers = np.full(body.solid.shape, np.inf, dtype=float)
    ct = images.read(path)
    try:
        numbers[tuple(inner_voxels.T)] = ct.values_at(body.places(inner_voxels))
    except images.OutsideImageError as error:
        raise InputError(
            f"{path}: {error}. The CT does not contain the labelled femur: use the CT from which"
            " the labels were made"
        ) from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    height = frame.to_model(body.places(inner_voxels))[:, 2]
    top_level = -BELOW_TROCHANTER * frame.radius
    numbers[tuple(inner_voxels[height > top_level + 2.0 * WALL_THICKNESS].T)] = np.inf
    if not contains_canal(frame):
        raise GeometryError(
            f"geometry.canal.ct: the scan has {-frame.end:.0f} mm of complete shaft below the"
            " lesser trochanter;"
            f" its canal needs {SHORTEST_CANAL - top_level:.0f} mm. Leave out canal.ct:"
            " the canal then has the ratios of the parametric femur"
        )
    outermost = inner_voxels[
        (height < top_level) & (depth[tuple(inner_voxels.T)] < WALL_THICKNESS + CORTEX_LAYER)
    ]
    doubts = [*ct.notes, *_cortex_doubts(path, numbers[tuple(outermost.T)], threshold)]
    canal_voxels = inner_voxels[height < top_level + 2.0 * WALL_THICKNESS]
    box = tuple(
        slice(max(a - 2, 0), b + 3)
        for a, b in zip(canal_voxels.min(0), canal_voxels.max(0), strict=True)
    )
    translation = np.eye(4)
    translation[:3, 3] = [s.start for s in box]
    canal_body = LabelBody(body.solid[box], body.level[box], body.affine @ translation, ())
    canals = [
        _canal(path, numbers[box], depth[box], canal_body, threshold, change)
        for change in (-THRESHOLD_CHANGE, 0.0, THRESHOLD_CHANGE)
    ]
    surfaces = [_part_below(frame.surface(level), top_level) for level in canals]
    at_lower_threshold, mean_thickness, at_higher_threshold = (
        _cortex(bone, surface, frame.end, top_level) for surface in surfaces
    )
    least, largest = USUAL_CORTEX
    if not least <= mean_thickness <= largest:
        doubts.append(
            f"{path.name}: with geometry.canal.threshold: {threshold:g} the cortex of the shaft is"
            f" {mean_thickness:.1f} mm thick on average; expected {least:g} to {largest:g} mm. Is"
            " this threshold right for this CT? Cortical bone has 600 HU or more, marrow -100 to"
            " 100 HU"
        )
    top = float(surfaces[1].points[:, 2].max())
    return replace(
        surfaces[1],
        doubts=tuple(doubts),
        notes=(
            f"CT numbers below {threshold:g} in the bone, up to z = {top:.0f} mm; cortex"
            f" {mean_thickness:.1f} mm thick on average ({at_lower_threshold:.1f} with"
            f" {threshold - THRESHOLD_CHANGE:g},"
            f" {at_higher_threshold:.1f} with {threshold + THRESHOLD_CHANGE:g})",
        ),
    )


def _cortex_doubts(path: Path, numbers: Floats, threshold: float) -> list[str]:
    """Return a note if little of the cortex is above the threshold.

    Args:
        path: The CT.
        numbers: CT numbers in the layer below the wall of the shaft (n,).
        threshold: CT number at the endosteum.

    Raises:
        InputError: The CT is not that of the labels.
        GeometryError: The threshold is too high.
    """
    fraction, usual_fraction = (
        float((numbers >= number).mean()) for number in (threshold, CORTEX_NUMBER)
    )
    if fraction >= NOTED_CORTEX_FRACTION:
        return []
    fault = (
        f"only {math.floor(100 * fraction)} % of the shaft {WALL_THICKNESS:g} to"
        f" {WALL_THICKNESS + CORTEX_LAYER:g} mm below its surface have CT numbers above"
        f" {threshold:g}; expected at least {100 * NOTED_CORTEX_FRACTION:.0f} %"
    )
    usual_text = f"{100 * usual_fraction:.0f} % are above {CORTEX_NUMBER:g}"
    is_too_high = usual_fraction >= NOTED_CORTEX_FRACTION
    if fraction >= LEAST_CORTEX_FRACTION:
        cause = "Is the CT mirrored or moved against the labels, or the cortex thinner than this?"
        if is_too_high:
            cause = f"Is geometry.canal.threshold too high? {usual_text}"
        return [f"{path.name}: {fault}. {cause}"]
    if is_too_high:
        raise GeometryError(
            f"geometry.canal.threshold: is too high for {path.name}: {fault}. {usual_text}"
        )
    raise InputError(
        f"{path}: {fault}. The CT and the labels do not match: the CT may be mirrored or moved, or"
        " that of another patient, or the image is not a CT. Use the CT from which the labels were"
        " made"
    )


def _no_marrow(path: Path, numbers: Floats, threshold: float, change: float) -> GeometryError:
    """Return the error on CT numbers inside a shaft (n,) of which none is below a threshold."""
    limit = f"{threshold:g}"
    if numbers.min() < threshold:
        limit = f"{threshold + change:g}, the threshold of {threshold:g} less {-change:g}"
    message = f"geometry.canal.threshold: {path.name}: no CT number inside the bone is below"
    message += f" {limit}; they are {numbers.min():.0f} to {numbers.max():.0f}."
    usual_numbers = "Cortical bone has 600 HU or more, marrow -100 to 100 HU"
    if numbers.min() < CORTEX_NUMBER <= numbers.max():
        cause = f"The threshold is too low; use about {CORTEX_NUMBER:g}."
        return GeometryError(f"{message} {cause} {usual_numbers}")
    if numbers.min() > ADDED_NUMBER - 2.0 * THRESHOLD_CHANGE:
        cause = f"Was {ADDED_NUMBER:g} added to all numbers? Then subtract it in the image, or add"
        return GeometryError(f"{message} {cause} it to canal.threshold")
    return GeometryError(f"{message} Is the image a CT? {usual_numbers}")


def _canal(
    path: Path,
    numbers: Floats,
    depth: Floats,
    body: LabelBody,
    given_threshold: float,
    change: float,
) -> BoneSurface:
    """Return the surface of the largest region of numbers below a threshold, in the file's axes.

    The threshold is the given one with a change.

    Raises:
        GeometryError: No number is below the threshold.
    """
    threshold = given_threshold + change
    is_finite = np.isfinite(numbers)
    weight = ndimage.gaussian_filter(is_finite.astype(np.float32), NOISE_FILTER / body.spacing)
    filtered_sum = ndimage.gaussian_filter(
        np.where(is_finite, numbers, 0.0), NOISE_FILTER / body.spacing
    )
    filtered = np.where(is_finite, filtered_sum / np.maximum(weight, 1e-6), threshold + GRADIENT)
    # The lesser of two distances [mm]: from the endosteum, and from the wall.
    level = np.minimum((threshold - filtered) / GRADIENT, depth - WALL_THICKNESS)
    region_labels, region_count = ndimage.label(level > 0)
    if not region_count:
        raise _no_marrow(path, filtered[is_finite], given_threshold, change)
    largest = region_labels == np.bincount(region_labels.ravel())[1:].argmax() + 1
    solid = ndimage.binary_fill_holes(largest)
    level = np.where(solid, np.maximum(level, 0.01), np.minimum(level, -0.01))
    level = np.pad(level, 1, constant_values=-1.0)
    translation = np.eye(4)
    translation[:3, 3] = -1.0
    padded = LabelBody(level > 0, level, body.affine @ translation, ())
    welded = welding.weld(label_surface.triangles_of_level(level, padded))
    return BoneSurface(welded.points, outward(welded.points, welded.triangles))


def _part_below(surface: BoneSurface, top_level: float) -> BoneSurface:
    """Return the part of a surface below a level, with a flat end there if it reaches it."""
    mirror = np.array([1.0, 1.0, -1.0])
    mirrored = BoneSurface(surface.points * mirror, surface.triangles[:, ::-1])
    kept_triangles = shaft.clipped(mirrored, -top_level)[:, ::-1] * mirror
    lines = surface.level(top_level)
    if not len(lines):
        return surface
    middle = np.r_[centroid(lines)[0], top_level]
    end_lines = np.concatenate([lines, np.full((*lines.shape[:2], 1), top_level)], axis=2)
    end_triangles = np.stack(
        [np.broadcast_to(middle, end_lines[:, 0].shape), end_lines[:, 0], end_lines[:, 1]], axis=1
    )
    welded = welding.weld(np.concatenate([kept_triangles, end_triangles]))
    return BoneSurface(welded.points, welded.triangles)


def _cortex(bone: BoneSurface, canal: BoneSurface, lowest_level: float, top_level: float) -> float:
    """Return the mean thickness of the cortex between two levels [mm]."""
    levels = np.arange(top_level - SECTION_STEP, lowest_level, -SECTION_STEP).tolist()
    widths = np.array([[mean_width(s.level(z)) for s in (bone, canal)] for z in levels])
    return float((widths[:, 0] - widths[:, 1]).mean() / 2.0)
