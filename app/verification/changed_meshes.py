"""Meshes changed on purpose: turned, scaled, mirrored, badly shaped; for ``mantle stress``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import meshes
from app.case.case import Case
from app.system import folders
from meshes.data import MeshData
from meshes.quality import BAD, sicn

# About (1, 2, 3) by 40 degrees: no axis goes to an axis.
ROTATION = Rotation.from_rotvec(np.radians(40.0) / np.sqrt(14.0) * np.arange(1, 4)).as_matrix()
ROUNDS = 8


def flattened(data: MeshData, worst: float) -> MeshData:
    """Move nodes at random within the planes they lie in, wherever that makes cells worse.

    ``data`` is a stack of blocks, ``worst`` the least quality of cells in the end (signed inverse
    condition number).
    """
    random = np.random.default_rng(1)
    x = data.points.copy()
    is_free = np.ones(x.shape, dtype=bool)
    lower_corner = x.min(axis=0)
    upper_corner = x.max(axis=0)
    is_free[np.isclose(x, lower_corner) | np.isclose(x, upper_corner)] = False
    nodes = [np.unique(data.cells[data.cell_tags == tag]) for tag in data.regions.values()]
    is_shared = np.bincount(np.concatenate(nodes), minlength=len(x)) > 1
    is_free[is_shared, 2] = False
    size = np.cbrt(6 * np.sqrt(2) * np.prod(upper_corner - lower_corner) / len(data.cells))
    touching: list[list[int]] = [[] for _ in x]
    for (c, _), n in np.ndenumerate(data.cells):
        touching[n].append(c)
    for n in np.tile(np.flatnonzero(is_free.any(axis=1)), ROUNDS):
        cells = data.cells[touching[n]]
        old_position = x[n].copy()
        quality_before = sicn(x, cells).min()
        x[n] += 0.5 * size * random.standard_normal(3) * is_free[n]
        if not worst <= sicn(x, cells).min() < quality_before:
            x[n] = old_position
    return replace(data, points=x)


def mirrored(data: MeshData) -> MeshData:
    """Mirror a quarter about x = 0 and y = 0 to the whole."""
    x = data.points
    cells = data.cells
    tags = data.cell_tags
    facets = data.facets
    marks = data.facet_tags
    planes = [data.boundaries[f"symmetry_{a}"][0] for a in "xy"]
    for axis in (0, 1):
        mirrored_points = x * np.where(np.arange(3) == axis, -1.0, 1.0)
        on_plane = np.abs(x[:, axis]) < 1e-9
        number = np.where(on_plane, np.arange(len(x)), len(x) + np.cumsum(~on_plane) - 1)
        x = np.concatenate([x, mirrored_points[~on_plane]])
        cells = np.concatenate([cells, number[cells][:, [1, 0, 2, 3]]])
        facets = np.concatenate([facets, number[facets][:, [1, 0, 2]]])
        tags = np.tile(tags, 2)
        marks = np.tile(marks, 2)
    is_kept = ~np.isin(marks, planes)
    boundaries = {n: t for n, t in data.boundaries.items() if not n.startswith("symmetry")}
    return replace(
        data,
        points=x,
        cells=cells,
        cell_tags=tags,
        facets=facets[is_kept],
        facet_tags=marks[is_kept],
        boundaries=boundaries,
    )


CHANGES: dict[str, Callable[[MeshData], MeshData]] = {
    "turned": lambda data: replace(data, points=data.points @ ROTATION.T),
    "mirrored": mirrored,
    "bad": lambda data: flattened(data, 0.1),
    "worst": lambda data: flattened(data, 1.2 * BAD),
    "metres": lambda data: replace(data, points=1e-3 * data.points),
    "micrometres": lambda data: replace(data, points=1e3 * data.points),
}


def change(case: Case, name: str, folder: Path) -> tuple[str, ...]:
    """Write a changed mesh of a case, and return the overrides that make it its geometry."""
    data = meshes.build(case.geometry, case.mesh, folders.cache("meshes"))
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{data.notes['quality']['cells']}_{name}.msh"
    meshes.write_msh(CHANGES[name](data), path)
    sides = {n: [list(a), list(b)] for n, (a, b) in data.interfaces.items()}
    geometry = f"geometry={{kind: file, path: {path.resolve()}, interfaces: {sides}}}"
    return geometry, *(f"regions.{n}.tissue={r.tissue}" for n, r in case.regions.items())
