"""Sections through a mesh as a picture: which region is where, and how fine it is."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from app import figures
from app.arrays import Floats, Ints
from meshes.data import EDGES, MeshData

COLOURS = {
    "stem": "#7f8fa6",
    "cement": "#e8a0a8",
    "cortical_bone": "#e6cf8b",
    "cancellous_bone": "#f5eed2",
    "bone": "#e6cf8b",
}
OTHERS = ("#8fb7d9", "#f2b880", "#a8cf9b", "#c7a7d8", "#d9d07c", "#88c9c3")
AXES = "xyz"
# Edges cut by a plane, in order around the section, by the signs of the four vertices: bit v is
# set where vertex v is on the positive side. Edges are numbered as in data.EDGES.
_RINGS = {
    0b0001: (0, 2, 3),
    0b0010: (0, 1, 5),
    0b0100: (1, 2, 4),
    0b1000: (3, 4, 5),
    0b0011: (2, 1, 5, 3),
    0b0101: (0, 1, 4, 3),
    0b0110: (0, 2, 4, 5),
}


def cut(
    points: Floats, cells: Ints, axis: int, at: float
) -> list[tuple[Floats, npt.NDArray[np.int64]]]:
    """Cut tetrahedra by the plane x_axis = at, exactly (curved cells: their corners).

    Args:
        points: Nodes, shape (n, 3).
        cells: Tetrahedra, shape (m, 4 or 10).
        axis: 0, 1 or 2.
        at: Level of the plane [mm]; nodes on it count as above.

    Returns:
        For triangles and for quadrilaterals: corners (k, 3 or 4, 3) and their cells (k,).
    """
    height = points[cells[:, :4], axis] - at
    code = (height >= 0) @ (1 << np.arange(4))
    sections: dict[int, list[tuple[Floats, npt.NDArray[np.int64]]]] = {3: [], 4: []}
    for signs, ring in _RINGS.items():
        own = np.flatnonzero((code == signs) | (code == 15 - signs))
        ends = np.array(EDGES)[list(ring)]
        h = height[own][:, ends]
        x = points[cells[own][:, ends]]
        share = (h[..., 0] / (h[..., 0] - h[..., 1]))[..., None]
        sections[len(ring)].append((x[:, :, 0] * (1 - share) + x[:, :, 1] * share, own))
    return [
        (np.concatenate([c for c, _ in parts]), np.concatenate([o for _, o in parts]))
        for parts in sections.values()
    ]


def picture(data: MeshData, path: Path) -> None:
    """Write a PNG with the sections y = 0, x = 0 (through the mesh's middle) and one transverse.

    Args:
        data: The mesh.
        path: The file to write.
    """
    low, high = data.points.min(axis=0), data.points.max(axis=0)
    levels = [middle_plane(low[i], high[i]) for i in range(3)]
    planes = [(1, levels[1]), (0, levels[0]), (2, levels[2])]
    extent = high - low
    widths = [extent[0], extent[1], max(extent[0], extent[1])]
    height = 9.0
    scale = (height - 1.5) / max(extent[2], 0.4 * max(extent[:2]))
    figure = figures.new(float(np.clip(scale * sum(widths) + 4.0, 9.0, 24.0)), height)
    axes = figure.subplots(1, 3, width_ratios=np.maximum(widths, 0.15 * max(widths)))
    colours = colours_of(data.regions)
    for ax, (axis, at) in zip(axes, planes, strict=True):
        _draw(ax, data, axis, at, colours)
    add_legend(figure, colours)
    figure.suptitle(f"{len(data.cells)} cells, {len(data.points)} nodes")
    figure.savefig(path, dpi=130, format="png")


def add_legend(figure: Any, colours: Mapping[str, str]) -> None:
    """Name the regions below a figure."""
    from matplotlib.patches import Patch

    handles = [Patch(facecolor=c, edgecolor="k", label=n) for n, c in colours.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=min(6, len(handles)))


def middle_plane(low: float, high: float) -> float:
    """The coordinate plane where it passes inside, else the middle."""
    if low < -0.1 * (high - low) and high > 0.1 * (high - low):
        return 0.0
    return 0.5 * (low + high)


def colours_of(names: Iterable[str]) -> dict[str, str]:
    """A colour for each region."""
    free = (c for _ in names for c in OTHERS)
    return {name: COLOURS.get(name) or next(free) for name in names}


def _draw(ax: Any, data: MeshData, axis: int, at: float, colours: dict[str, str]) -> None:
    """One section: filled polygons with thin outlines."""
    from matplotlib.collections import PolyCollection

    u, v = [i for i in range(3) if i != axis]
    shown = {tag: colours[name] for name, tag in data.regions.items()}
    for corners, cell in cut(data.points, data.cells, axis, at):
        face = [shown[int(tag)] for tag in data.cell_tags[cell]]
        ax.add_collection(
            PolyCollection(
                list(corners[:, :, [u, v]]), facecolors=face, edgecolors="k", linewidths=0.15
            )
        )
    ax.set_aspect("equal")
    ax.autoscale_view()
    ax.set_xlabel(f"{AXES[u]} (mm)")
    ax.set_ylabel(f"{AXES[v]} (mm)")
    ax.set_title(f"{AXES[axis]} = {at:.4g} mm")
