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
from meshes.picture import AXES, cut, middle_plane, outlines

# Triangles thinner than this part of a section show only as shading.
_THIN = 1e-3
DEADLY = 47.0  # degC


def section(path: Path, operators: HeatOperators, record: ThermalRecord) -> None:
    """Draw a PNG of the temperature when the bone was hottest; collective.

    The planes are y = 0 and the transverse one of the hottest place.

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
    """Triangles of a section (k, 3, 4) [mm, degC], and the edges of its regions (s, 2, 3) [mm]."""
    cells = np.arange(4 * len(corners)).reshape(-1, 4)
    polygons = [(x, tags[cell]) for x, cell in cut(corners.reshape(-1, 4), cells, axis, level)]
    triangles = [x[:, [0, k, k + 1]] for x, _ in polygons for k in range(1, x.shape[1] - 1)]
    return np.concatenate(triangles), outlines([(x[..., :3], of) for x, of in polygons])[0]


def _draw(
    path: Path,
    planes: Sequence[tuple[int, float]],
    pieces: Sequence[tuple[Floats, Floats]],
    record: ThermalRecord,
) -> None:
    at = record.hottest_at
    T = np.concatenate([triangles[:, :, 3].ravel() for triangles, _ in pieces])
    low, high = float(T.min()), max(float(T.max()), float(T.min()) + 0.1)
    wide, tall = np.transpose(
        [
            np.ptp(outline[:, :, _others(axis)].reshape(-1, 2), axis=0)
            for (axis, _), (_, outline) in zip(planes, pieces, strict=True)
        ]
    )
    widths = np.maximum(wide, 0.25 * tall.max())
    figure = figures.new(float(np.clip(7 * widths.sum() / tall.max() + 3, 8, 16)), 7.0)
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

    u, v = _others(axis)
    x, T, lines = triangles[:, :, [u, v]], triangles[:, :, 3], outline[:, :, [u, v]]
    a, b = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]
    longest = np.max([np.linalg.norm(e, axis=1) for e in (a, b, b - a)], axis=0)
    thin = _THIN * np.ptp(lines.reshape(-1, 2), axis=0).max() * longest
    shade, mesh, values = figures.shaded(ax, x, T, "inferno", limits, thin)
    if values.min() < DEADLY < values.max():
        ax.tricontour(mesh, values, levels=[DEADLY], colors="white", linewidths=1.2)
    ax.add_collection(LineCollection(list(lines), colors="0.6", linewidths=0.8))
    ax.set_aspect("equal")
    ax.set_facecolor("0.95")
    ax.set(xlabel=f"{AXES[u]} (mm)", ylabel=f"{AXES[v]} (mm)")
    return shade
