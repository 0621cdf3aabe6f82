"""Sections through cells and surfaces, and pictures of sections of a mesh."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.patches import Patch

from app.foundation.arrays import Floats, Ints
from app.plots import figures
from app.plots.figures import PNG
from app.plots.maps import joined
from meshes.data import MeshData, interface_facets, nodes_of_boundary_facets
from meshes.shape_functions import GMSH_TETRAHEDRON

# The straight cells that share the nodes of a curved one: four at its corners, and four around a
# diagonal.
STRAIGHT_CELLS = (
    *((0, 4, 6, 7), (4, 1, 5, 9), (6, 5, 2, 8), (7, 9, 8, 3)),
    *((4, 8, 6, 7), (4, 8, 7, 9), (4, 8, 9, 5), (4, 8, 5, 6)),
)
# Colour of a region by its name; other regions take the next of `OTHER_COLOURS`.
COLOURS = {
    "stem": "#7f8fa6",
    "cement": "#e8a0a8",
    "cortical_bone": "#e6cf8b",
    "cancellous_bone": "#f5eed2",
    "bone": "#e6cf8b",
}
OTHER_COLOURS = ("#8fb7d9", "#f2b880", "#a8cf9b", "#c7a7d8", "#d9d07c", "#88c9c3")
# Interfaces around a stem, with and without cement.
AROUND_STEM = ("stem_cement", "stem_bone")
# Distance of the sections from the tip and from the lowest point of the neck cut [mm].
END_DISTANCE = 1.0
# Width of the outline of a region in a section [points].
OUTLINE = 0.9
# Edges cut by a plane, in order around the section, by the signs of the four vertices: bit v is
# set where vertex v is on the positive side. Edges are numbered as in GMSH_TETRAHEDRON.
_RINGS = {
    0b0001: (0, 2, 3),
    0b0010: (0, 1, 5),
    0b0100: (1, 2, 4),
    0b1000: (3, 4, 5),
    0b0011: (2, 1, 5, 3),
    0b0101: (0, 1, 4, 3),
    0b0110: (0, 2, 4, 5),
}


def cut_tetrahedra(points: Floats, cells: Ints, axis: int, at: float) -> list[tuple[Floats, Ints]]:
    """Cut tetrahedra by the plane x_axis = at [mm]; curved ones count as straight.

    Nodes on the plane count as above it.

    Returns:
        For triangles, then for quadrilaterals: corners (k, 3 or 4, 3) and their cells (k,).
    """
    height = points[cells[:, :4], axis] - at
    code = (height >= 0) @ (1 << np.arange(4))
    sections: dict[int, list[tuple[Floats, Ints]]] = {3: [], 4: []}
    for signs, ring in _RINGS.items():
        cut_cells = np.flatnonzero((code == signs) | (code == 15 - signs))
        end_vertices = np.array(GMSH_TETRAHEDRON)[list(ring)]
        h = height[cut_cells][:, end_vertices]
        x = points[cells[cut_cells][:, end_vertices]]
        part_of_edge = (h[..., 0] / (h[..., 0] - h[..., 1]))[..., None]
        sections[len(ring)].append(
            (x[:, :, 0] * (1 - part_of_edge) + x[:, :, 1] * part_of_edge, cut_cells)
        )
    return [
        (
            np.concatenate([corners for corners, _ in polygons]),
            np.concatenate([cell for _, cell in polygons]),
        )
        for polygons in sections.values()
    ]


def section_of_cells(
    data: MeshData, axis: int, at: float
) -> tuple[list[tuple[Floats, Ints]], Floats, Ints]:
    """Cut cells by a plane as `cut_tetrahedra`; a curved cell counts as eight straight ones.

    Returns:
        Corners of polygons and their cells; the edges of the cells' sections (n, 2, 3) and the cell
        of each (n,).
    """
    straight_cells = np.array(STRAIGHT_CELLS if data.curved else [(0, 1, 2, 3)])
    cut_polygons = cut_tetrahedra(
        data.points, data.cells[:, straight_cells].reshape(-1, 4), axis, at
    )
    polygons = [(corners, part // len(straight_cells)) for corners, part in cut_polygons]
    return polygons, *outlines(polygons)


def outlines(polygons: Iterable[tuple[Floats, Ints]]) -> tuple[Floats, Ints]:
    """Edges (n, 2, 3) around the polygons (k, corners, 3) of each owner (k,), and their owners."""
    edges = [np.stack([x, np.roll(x, -1, axis=1)], axis=2).reshape(-1, 2, 3) for x, _ in polygons]
    edge_ends = np.concatenate(edges)
    owner = np.concatenate([np.repeat(polygon_owner, x.shape[1]) for x, polygon_owner in polygons])
    # An edge that two polygons share is inside.
    span = np.abs(edge_ends[:, 1] - edge_ends[:, 0])
    keys = np.column_stack([owner, np.round(edge_ends.sum(axis=1), 6), np.round(span, 6)])
    _, first_rows, times = np.unique(keys, axis=0, return_index=True, return_counts=True)
    outer_rows = first_rows[times == 1]
    return edge_ends[outer_rows], owner[outer_rows]


def section_lines(x: Floats, axis: int, at: float) -> Floats:
    """Lines (n, 2, 3) in which the plane x_axis = at [mm] cuts triangles (m, 3, 3)."""
    height = x[:, :, axis] - at
    next_height = np.roll(height, -1, axis=1)
    crossed = (height >= 0) != (next_height >= 0)
    part_of_edge = (height[crossed] / (height[crossed] - next_height[crossed]))[:, None]
    line_ends = (1 - part_of_edge) * x[crossed] + part_of_edge * np.roll(x, -1, axis=1)[crossed]
    return line_ends.reshape(-1, 2, 3)


def draw_sections(data: MeshData, path: Path, title: str = "") -> None:
    """Write a PNG with sections near the neck cut, in the middle of the stem and above its tip."""
    interface_name = next(name for name in AROUND_STEM if name in data.interfaces)
    stem = data.points[interface_facets(data, interface_name)[0], 2]
    top_level = stem.max()
    if "resection" in data.boundaries:
        top_level = data.points[nodes_of_boundary_facets(data, "resection"), 2].min()
    upper_plane, lower_plane = top_level - END_DISTANCE, stem.min() + END_DISTANCE
    planes = {
        "near the neck cut": float(np.floor(upper_plane)),
        "middle of the stem": float(np.round(0.5 * (upper_plane + lower_plane))),
        "above the tip": float(np.ceil(lower_plane)),
    }
    figure = figures.new(12.0, 4.0)
    axes = figure.subplots(1, 3, sharex=True, sharey=True)
    for ax, (place, at) in zip(axes, planes.items(), strict=True):
        draw_section(ax, data, 2, at)
        ax.set(aspect="equal", xlabel="x (mm)", ylabel="y (mm)")
        ax.set_title(f"{place}, z = {at:.4g} mm")
    handles = [Patch(fc=c, ec="k", label=n) for n, c in colours_of(data.regions).items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=6)
    figure.suptitle(title)
    figures.save_figure(figure, path, 110, PNG)


def draw_section(ax: Axes, data: MeshData, axis: int, at: float) -> None:
    """Draw a section: filled cells, their edges, and the outlines of the regions."""
    u, v = (i for i in range(3) if i != axis)
    polygons, edges, _ = section_of_cells(data, axis, at)
    for name, colour in colours_of(data.regions).items():
        region_polygons = [
            x[data.cell_tags[cell] == data.regions[name]][..., [u, v]] for x, cell in polygons
        ]
        area = PathCollection([joined(region_polygons)], color=colour, linewidths=0)
        ax.add_collection(area, autolim=False)
    ax.add_collection(LineCollection(list(edges[..., [u, v]]), colors="#00000060", lw=0.25))
    tags = data.cell_tags.astype(np.int64)
    region_outlines, _ = outlines([(x, tags[cell]) for x, cell in polygons])
    ax.add_collection(
        LineCollection(list(region_outlines[..., [u, v]]), colors="#1d2429", lw=OUTLINE)
    )
    ax.autoscale_view()


def middle_plane(low: float, high: float) -> float:
    """Return 0, the coordinate plane, if it is well inside the range, else the middle."""
    if low < -0.1 * (high - low) and high > 0.1 * (high - low):
        return 0.0
    return 0.5 * (low + high)


def colours_of(names: Iterable[str]) -> dict[str, str]:
    """Colour of each region."""
    other_colours = (c for _ in names for c in OTHER_COLOURS)
    return {name: COLOURS.get(name) or next(other_colours) for name in names}
