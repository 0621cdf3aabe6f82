"""Paths of a case on its mesh: fields that the run does not have, points outside the bodies."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from app.case.case import Case
from app.case.paths import AnyPath, SectionPath, SidePath
from app.foundation.errors import InputError
from app.foundation.verdict import Verdict, note
from app.scene.path_fields import columns
from app.scene.path_points import path_points
from app.scene.scene import build_scene
from meshes.data import MeshData
from meshes.geometry import is_hip
from meshes.paths import PathPoints
from meshes.pieces import MeshPieces


def misplaced_paths(case: Case, parts: MeshPieces) -> Iterator[Verdict]:
    """Errors on paths without a point in their bodies or without a field, notes on the others."""
    if not case.output.paths:
        return
    data = parts.data
    scene = build_scene(case)
    for name, path in case.output.paths.items():
        key = f"output.paths.{name}"
        try:
            columns(case, scene, name)
        except InputError as error:
            yield from error.verdicts
        contradiction = _contradiction(case, path)
        if contradiction:
            yield Verdict(contradiction, key)
            continue
        points = path_points(case, scene, data, path)
        if not (points.cell >= 0).any():
            yield _outside(case, data, path, key)
        elif points.outside:
            yield _partly_outside(path, points, key)


def _contradiction(case: Case, path: AnyPath) -> str:
    """Reason why a path cannot lie on its interface or stem; empty if it can."""
    geometry, interface = case.geometry, path.interface_name
    if isinstance(path, SidePath) and not (is_hip(geometry) or geometry.is_around_z):
        return (
            f"geometry.kind: {geometry.kind} has no axis of a stem; use `kind: section` at a "
            "height, or `kind: line` between two points"
        )
    region = path.region
    if interface and region:
        sides = geometry.interface_sides[interface]
        regions = [name for side in sides for name in side]
        if region not in regions:
            return (
                f"region '{region}' is not a side of {interface}; expected {' or '.join(regions)}"
            )
    return ""


def _outside(case: Case, data: MeshData, path: AnyPath, key: str) -> Verdict:
    """Error on a path without any point in its bodies."""
    region = path.region
    if isinstance(path, SectionPath | SidePath):
        place_of_path = path.interface_name or f"region '{region}'"
        x = _nodes(case, data, path)
        lowest, highest = x[:, 2].min(), x[:, 2].max()
        if isinstance(path, SidePath):
            return Verdict(f"{place_of_path} has no {path.side} side", key, "choose another side")
        message = f"there is no {place_of_path} at the height {path.height:g} mm"
        return Verdict(message, key, f"expected a height from {lowest:.4g} to {highest:.4g} mm")
    region_text = f"region '{region}'" if region else "every body"
    x = _nodes(case, data, path)
    ranges = ", ".join(
        f"{axis} {lowest:.4g} to {highest:.4g}"
        for axis, lowest, highest in zip("xyz", x.min(axis=0), x.max(axis=0), strict=True)
    )
    model_text = f"region '{region}'" if region else "the model"
    return Verdict(
        f"no point of the path is in {region_text}" if region else "lies outside every body",
        key,
        f"expected points in {model_text}, which fills {ranges} mm",
    )


def _nodes(case: Case, data: MeshData, path: AnyPath) -> np.ndarray:
    """Nodes of the bodies of a path (n, 3) [mm]."""
    region = path.region
    sides = case.geometry.interface_sides.get(path.interface_name, ())
    regions = [region] if region else [name for side in sides[:1] for name in side]
    tags = [data.regions[name] for name in regions] or list(data.regions.values())
    return data.points[np.unique(data.cells[np.isin(data.cell_tags, tags)])]


def _partly_outside(path: AnyPath, points: PathPoints, key: str) -> Verdict:
    """Note on a path with points outside its bodies: how many, and where along it."""
    region = path.region
    is_outside = points.cell < 0
    begins = np.flatnonzero(np.diff(is_outside.astype(int), prepend=0) == 1)
    ends = np.flatnonzero(np.diff(is_outside.astype(int), append=0) == -1)
    stretches = [
        f"{points.arc[a]:.4g} to {points.arc[b]:.4g} mm" for a, b in zip(begins, ends, strict=True)
    ]
    stretch_list = ", ".join(stretches[:3]) + (", ..." if len(stretches) > 3 else "")
    region_text = f"region '{region}'" if region else "every body"
    message = (
        f"{is_outside.sum()} of its {len(is_outside)} points are outside {region_text}"
        f" ({stretch_list} along it); their fields stay empty"
    )
    return note(message, key)
