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
from meshes.plane_sections import centroid

# Thickness of the wall that is bone whatever its CT numbers are [mm]: voxels there are partly
# outside.
WALL_THICKNESS = 1.5
# Typical change of CT numbers across the endosteum [1/mm].
GRADIENT = 500.0
# Thickness of the layer below this wall that is cortex in a shaft [mm], and least part of it above
# the threshold: less is that of a CT that is mirrored or moved.
CORTEX_LAYER = 1.0
LEAST_CORTEX_FRACTION = 0.75
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
    try:
        ct = images.read(path)
        numbers[tuple(inner_voxels.T)] = ct.values_at(body.places(inner_voxels))
    except InputError as error:
        raise InputError(
            f"{path}: {error}. The CT does not contain the labelled femur: use the CT from which"
            " the labels were made"
        ) from error
    height = frame.to_model(body.places(inner_voxels))[:, 2]
    top_level = -BELOW_TROCHANTER * frame.radius
    numbers[tuple(inner_voxels[height > top_level + 2.0 * WALL_THICKNESS].T)] = np.inf
    if not contains_canal(frame):
        raise GeometryError(
            f"geometry.canal.ct: the scan ends {-frame.end:.0f} mm below the lesser trochanter;"
            f" its canal needs {SHORTEST_CANAL - top_level:.0f} mm. Leave out canal.ct:"
            " the canal then has the"
            " ratios of the parametric femur"
        )
    outermost = inner_voxels[
        (height < top_level) & (depth[tuple(inner_voxels.T)] < WALL_THICKNESS + CORTEX_LAYER)
    ]
    cortex_fraction = float((numbers[tuple(outermost.T)] >= threshold).mean())
    doubts = list(ct.notes)
    if cortex_fraction < LEAST_CORTEX_FRACTION:
        doubts.append(
            f"{path.name}: only {100 * cortex_fraction:.0f} % of the shaft"
            f" {WALL_THICKNESS:g} to {WALL_THICKNESS + CORTEX_LAYER:g} mm below its surface have CT"
            f" numbers above {threshold:g}; expected at least {100 * LEAST_CORTEX_FRACTION:.0f} %."
            " Is the CT mirrored or moved against the labels, or the cortex thinner than this?"
        )
    canal_voxels = inner_voxels[height < top_level + 2.0 * WALL_THICKNESS]
    box = tuple(
        slice(max(a - 2, 0), b + 3)
        for a, b in zip(canal_voxels.min(0), canal_voxels.max(0), strict=True)
    )
    translation = np.eye(4)
    translation[:3, 3] = [s.start for s in box]
    canal_body = LabelBody(body.solid[box], body.level[box], body.affine @ translation, ())
    canals = [
        _canal(numbers[box], depth[box], canal_body, threshold + change)
        for change in (-THRESHOLD_CHANGE, 0.0, THRESHOLD_CHANGE)
    ]
    surfaces = [_part_below(frame.surface(level), top_level) for level in canals]
    at_lower_threshold, mean_thickness, at_higher_threshold = (
        _cortex(bone, surface, frame.end, top_level) for surface in surfaces
    )
    return replace(
        surfaces[1],
        doubts=tuple(doubts),
        notes=(
            f"CT numbers below {threshold:g} in the bone, up to z = {top_level:.0f} mm; cortex"
            f" {mean_thickness:.1f} mm thick on average ({at_lower_threshold:.1f} with"
            f" {threshold - THRESHOLD_CHANGE:g},"
            f" {at_higher_threshold:.1f} with {threshold + THRESHOLD_CHANGE:g})",
        ),
    )


def _canal(numbers: Floats, depth: Floats, body: LabelBody, threshold: float) -> BoneSurface:
    """Return the surface of the largest region of numbers below a threshold, in the file's axes.

    Raises:
        GeometryError: No number is below the threshold.
    """
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
        raise GeometryError(
            f"geometry.canal.threshold: no CT number inside the bone is below {threshold:g}; is the"
            " image a CT? Cortical bone has 600 HU or more, marrow -100 to 100 HU"
        )
    largest = region_labels == np.bincount(region_labels.ravel())[1:].argmax() + 1
    solid = ndimage.binary_fill_holes(largest)
    level = np.where(solid, np.maximum(level, 0.01), np.minimum(level, -0.01))
    level = np.pad(level, 1, constant_values=-1.0)
    translation = np.eye(4)
    translation[:3, 3] = -1.0
    padded = LabelBody(level > 0, level, body.affine @ translation, ())
    welded = welding.weld(label_surface.surface(level, padded))
    return BoneSurface(welded.points, outward(welded.points, welded.triangles))


def _part_below(surface: BoneSurface, top_level: float) -> BoneSurface:
    """Return the part of a surface below a level, with a flat end there."""
    mirror = np.array([1.0, 1.0, -1.0])
    mirrored = BoneSurface(surface.points * mirror, surface.triangles[:, ::-1])
    kept_triangles = shaft.clipped(mirrored, -top_level)[:, ::-1] * mirror
    lines = surface.level(top_level)
    middle = np.r_[centroid(lines)[0], top_level]
    end_lines = np.concatenate([lines, np.full((*lines.shape[:2], 1), top_level)], axis=2)
    end_triangles = np.stack(
        [np.broadcast_to(middle, end_lines[:, 0].shape), end_lines[:, 0], end_lines[:, 1]], axis=1
    )
    welded = welding.weld(np.concatenate([kept_triangles, end_triangles]))
    return BoneSurface(welded.points, welded.triangles)


def _cortex(bone: BoneSurface, canal: BoneSurface, lowest_level: float, top_level: float) -> float:
    """Return the mean thickness of the cortex between two levels [mm]."""
    levels = np.arange(top_level - SECTION_STEP, lowest_level, -SECTION_STEP)
    areas = np.array([[centroid(s.level(z))[1] for s in (bone, canal)] for z in levels.tolist()])
    outer, inner = np.sqrt(np.maximum(areas, 0.0) / math.pi).T
    return float((outer - inner).mean())
