"""The temperature in two sections of the model, when the bone was hottest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from app import figures
from app.arrays import Floats, Ints
from app.errors import on_root
from app.heat.operators import HeatOperators
from app.results.necrosis import CELSIUS
from app.results.thermal_record import ThermalRecord
from app.scene.bodies import cell_tags
from meshes.distribute import TaggedMesh
from meshes.picture import AXES, cut, middle_plane

# Triangles thinner than this part of a section show only as shading.
_THIN = 1e-3
DEADLY = 47.0  # degC


def section(path: Path, operators: HeatOperators, record: ThermalRecord) -> None:
    """Draw the temperature in two planes, when the bone was hottest; collective.

    The planes are y = 0 and the transverse one of the hottest place.

    Args:
        path: The PNG that rank 0 writes.
        operators: The heat on the mesh.
        record: Its temperatures.

    Raises:
        OSError: The file cannot be written (on every rank).
    """
    tagged, dofs = operators.tagged, operators.forms.space.dofmap.list
    corners, tags = _corners(tagged, dofs, operators.bodies.of_region, record.hottest)
    comm, x = tagged.mesh.comm, corners[..., :3].reshape(-1, 3)
    ends = comm.allgather((x.min(0, initial=np.inf), x.max(0, initial=-np.inf)))
    low, high = np.min([e[0] for e in ends], axis=0), np.max([e[1] for e in ends], axis=0)
    # At the ends a plane may touch no more than a node.
    inside = 1e-3 * (high[2] - low[2])
    across = float(np.clip(record.hottest_at[2], low[2] + inside, high[2] - inside))
    planes = [(1, middle_plane(low[1], high[1])), (2, across)]
    gathered = []
    for axis, level in planes:
        height = corners[:, :, axis] - level
        near = (height.min(axis=1) <= 0) & (height.max(axis=1) >= 0)
        gathered.append(comm.gather((corners[near], tags[near])))

    def draw() -> None:
        whole = [
            _cut(np.concatenate([c for c, _ in near]), np.concatenate([t for _, t in near]), *plane)
            for near, plane in zip(gathered, planes, strict=True)
        ]
        _draw(path, planes, whole, record)

    on_root(comm, draw, share=False)


def _corners(
    tagged: TaggedMesh, dofs: Ints, body: Mapping[str, int], temperatures: Sequence[Floats]
) -> tuple[Floats, Ints]:
    """Corners of own cells with temperatures appended (m, 4, 4) [mm, degC], and their regions."""
    owned = tagged.mesh.topology.index_map(3).size_local
    tags, geometry = cell_tags(tagged)[:owned], tagged.mesh.geometry
    x = geometry.x[geometry.dofmap[:owned][:, :4]]
    T = np.zeros((owned, 4))
    for region, tag in tagged.regions.items():
        here = tags == tag
        T[here] = temperatures[body[region]][dofs[:owned][here]] - CELSIUS
    return np.concatenate([x, T[:, :, None]], axis=2), tags


def _cut(corners: Floats, tags: Ints, axis: int, level: float) -> tuple[Floats, Floats]:
    """Cut cells by a plane.

    Returns:
        Corners (k, 3, 4) of triangles with temperature [degC] behind the coordinates, and their
        edges between two regions or at the surface (s, 2, 4), from either side.
    """
    cells = np.arange(4 * len(corners)).reshape(-1, 4)
    shapes, outline, of = [], [], []
    for polygons, cell in cut(corners.reshape(-1, 4), cells, axis, level):
        n = polygons.shape[1]
        shapes += [polygons[:, [0, k, k + 1]] for k in range(1, n - 1)]
        outline += [polygons[:, [k, (k + 1) % n]] for k in range(n)]
        of += [tags[cell]] * n
    triangles: Floats = np.concatenate(shapes)
    edges: Floats = np.concatenate(outline)
    regions = np.concatenate(of)
    ends = np.round(edges[:, :, :3], 5)
    swap = np.array([tuple(a) > tuple(b) for a, b in ends], dtype=bool)
    ends[swap] = ends[swap][:, ::-1]
    _, edge = np.unique(ends.reshape(len(ends), 6), axis=0, return_inverse=True)
    edge = edge.ravel()
    first = np.full(edge.max(initial=-1) + 1, np.iinfo(np.int64).max)
    last = np.full(len(first), -1)
    np.minimum.at(first, edge, regions)
    np.maximum.at(last, edge, regions)
    border = (first != last) | (np.bincount(edge, minlength=len(first)) == 1)
    return triangles, edges[border[edge]]


def _draw(
    path: Path,
    planes: Sequence[tuple[int, float]],
    pieces: Sequence[tuple[Floats, Floats]],
    record: ThermalRecord,
) -> None:
    at = record.hottest_at
    T = np.concatenate([triangles[:, :, 3].ravel() for triangles, _ in pieces])
    low, high = float(T.min()), max(float(T.max()), float(T.min()) + 0.1)
    sizes = [
        np.ptp(outline[:, :, _others(axis)].reshape(-1, 2), axis=0)
        for (axis, _), (_, outline) in zip(planes, pieces, strict=True)
    ]
    tall = max(size[1] for size in sizes)
    widths = [max(size[0], 0.25 * tall) for size in sizes]
    height = 7.0
    width = float(np.clip(height * sum(widths) / tall + 3.0, 8.0, 16.0))
    figure = figures.new(width, height)
    axes = figure.subplots(1, len(planes), width_ratios=widths)
    for ax, (axis, level), (triangles, outline) in zip(axes, planes, pieces, strict=True):
        shade = _panel(ax, axis, triangles, outline, (low, high))
        ax.set_title(f"{AXES[axis]} = {level:.4g} mm")
    axes[0].axhline(at[2], color="#35c2ff", lw=1, ls=(0, (5, 3)))
    axes[1].plot(at[0], at[1], "o", mfc="none", mec="#35c2ff", ms=8, mew=1.5)
    figure.colorbar(shade, ax=list(axes), label="temperature (°C)", shrink=0.8)
    line = f"; line: {DEADLY:g} °C" if low < DEADLY < high else ""
    figure.suptitle(f"{record.hottest_time:.4g} s, when the ringed place was hottest{line}")
    figure.savefig(path, dpi=130)


def _others(axis: int) -> list[int]:
    return [i for i in range(3) if i != axis]


def _panel(
    ax: Any, axis: int, triangles: Floats, outline: Floats, limits: tuple[float, float]
) -> Any:
    """One section: shaded temperature, the deadly isotherm, outlines of the regions."""
    from matplotlib.collections import LineCollection
    from matplotlib.tri import Triangulation

    u, v = _others(axis)
    a, b = (triangles[:, k, [u, v]] - triangles[:, 0, [u, v]] for k in (1, 2))
    area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    longest = np.max([np.linalg.norm(e, axis=1) for e in (a, b, b - a)], axis=0)
    size = np.ptp(outline[:, :, [u, v]].reshape(-1, 2), axis=0).max()
    points = triangles[area > _THIN * size * longest].reshape(-1, 4)
    mesh = Triangulation(points[:, u], points[:, v], np.arange(len(points)).reshape(-1, 3))
    shade = ax.tripcolor(
        mesh, points[:, 3], shading="gouraud", cmap="inferno", vmin=limits[0], vmax=limits[1]
    )
    if points[:, 3].min() < DEADLY < points[:, 3].max():
        ax.tricontour(mesh, points[:, 3], levels=[DEADLY], colors="white", linewidths=1.2)
    ax.add_collection(LineCollection(list(outline[:, :, [u, v]]), colors="0.6", linewidths=0.8))
    ax.set_aspect("equal")
    ax.set_facecolor("0.95")
    ax.set_xlabel(f"{AXES[u]} (mm)")
    ax.set_ylabel(f"{AXES[v]} (mm)")
    return shade
