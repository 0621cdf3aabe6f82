"""Sections through cells and surfaces, surfaces as seen from a side, and pictures of a mesh."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PathCollection, PolyCollection
from matplotlib.colors import Normalize, to_rgb
from matplotlib.patches import Patch
from numpy.typing import NDArray

from app.foundation.arrays import Floats, Ints
from app.plots import figures
from app.plots.figures import PNG
from app.plots.maps import joined
from meshes.data import MeshData, interface_facets, nodes_of_boundary_facets
from meshes.nearest_facets import distance_from_triangles, triangles
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
AXES = "xyz"
INTERFACES = ("stem_cement", "cement_bone")
# Interfaces around a stem, with and without cement.
AROUND_STEM = ("stem_cement", "stem_bone")
# Distance of the sections from the tip and from the lowest point of the neck cut [mm].
END_DISTANCE = 1.0
# The horizontal axis, whether it points to the left, and the axis along which one looks.
VIEWS = {"lateral": (1, True, 0), "anterior": (0, True, 1), "medial": (1, False, 0)}
# Title of pictures of a right femur.
MIRRORED = "a right femur, mirrored"
FRONT_AND_SIDE = ("anterior", "medial")
# Direction to the light: from the left, from above, from the viewer.
LIGHT = np.array([-0.5, 0.4, 0.77])
# Brightness of a facet that faces away from the light.
DARKEST = 0.7
# Width of the outline of a region in a section [points].
OUTLINE = 0.9
# Colour of a stem's surface.
METAL = "#b8c0cc"
# Colour of the cement below the tip.
PLUG = "0.85"
# Colour of the edges of facets on cortical bone.
CORTEX = "#d62728"
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


def interfaces(data: MeshData, path: Path, title: str = "") -> None:
    """Write a PNG of the interfaces around a stem, seen from anterior and from medial.

    The bone interface is coloured by the thickness of the cement, which is undefined below the tip,
    where the plug is; facets on cortical bone have red edges. Without cement the surface of the
    stem is coloured by the distance to the bone's outer surface.
    """
    is_cemented = "stem_bone" not in data.interfaces
    colours, colour_map = _by_cement(data) if is_cemented else _by_bone(data)
    label = "bone between the stem and the outer surface (mm)"
    if is_cemented:
        label = "thickness of the cement (mm)"
    patches = {name: triangles(data.points, interface_facets(data, name)[0]) for name in colours}
    views = [(name, view) for name in colours for view in FRONT_AND_SIDE]
    widths = [np.ptp(patches[name][:, :, VIEWS[view][0]]) for name, view in views]
    figure = figures.new(8.5 if is_cemented else 6.0, 10.5)
    axes = figure.subplots(1, len(views), sharey=True, width_ratios=widths)
    for ax, (name, view) in zip(axes, views, strict=True):
        facets, _, cells = interface_facets(data, name)
        on_cortex = data.cell_tags[cells] == data.regions.get("cortical_bone")
        edges = np.where(on_cortex, CORTEX, "k")
        draw_surface(ax, data.points[facets], patches[name], colours[name], edges, view)
        ax.set_title(f"{name}\nfrom {view}")
    axes[0].set_ylabel("z (mm)")
    figure.colorbar(colour_map, ax=figure.axes, label=label, shrink=0.5)
    patch = Patch(fc="none", ec=CORTEX, label="on cortical bone")
    figure.legend(handles=[patch], loc="outside lower center", frameon=False)
    figure.suptitle(title)
    figures.save_figure(figure, path, 95, PNG)


def _by_cement(data: MeshData) -> tuple[dict[str, Floats], ScalarMappable]:
    """Colours of the triangles of both interfaces, by the thickness of the cement."""
    stem, bone = (triangles(data.points, interface_facets(data, name)[0]) for name in INTERFACES)
    middle = bone.mean(axis=1)
    thickness = distance_from_triangles(middle, stem)
    is_around_stem = middle[:, 2] > stem[:, :, 2].min()
    largest = np.ceil(thickness[is_around_stem].max())
    colour_map = ScalarMappable(Normalize(np.floor(thickness.min()), largest), colormaps["viridis"])
    stem_colours = np.tile(to_rgb(METAL), (len(stem), 1))
    bone_colours = np.where(
        is_around_stem[:, None], colour_map.to_rgba(thickness)[:, :3], to_rgb(PLUG)
    )
    return dict(zip(INTERFACES, (stem_colours, bone_colours), strict=True)), colour_map


def _by_bone(data: MeshData) -> tuple[dict[str, Floats], ScalarMappable]:
    """Colours of the triangles of a stem without cement, by the distance to the outer surface."""
    stem = triangles(data.points, interface_facets(data, "stem_bone")[0])
    outside = triangles(data.points, nodes_of_boundary_facets(data, "bone_surface"))
    thickness = distance_from_triangles(stem.mean(axis=1), outside)
    colour_map = ScalarMappable(Normalize(0.0, np.ceil(thickness.max())), colormaps["viridis"])
    return {"stem_bone": np.asarray(colour_map.to_rgba(thickness)[:, :3])}, colour_map


def draw_surface(
    ax: Axes,
    facets: Floats,
    pieces: Floats,
    colours: Floats,
    edges: NDArray[np.generic] | None,
    view: str,
) -> None:
    """Draw a surface as a viewer sees it, lit from the upper left, with the edges of its facets.

    Args:
        ax: Axes to draw in.
        facets: Nodes of its facets, outward (k, 3 or 6, 3) [mm].
        pieces: Flat triangles of them (n, 3, 3) [mm].
        colours: Red, green and blue of each triangle (n, 3).
        edges: Colour of the edges of each facet (k,) or (k, 3); None draws none.
        view: One of `VIEWS`.
    """
    horizontal_axis, leftward, viewing_axis = VIEWS[view]
    eye = 1 if leftward == (viewing_axis == 1) else -1

    def normals(x: Floats) -> Floats:
        normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
        return np.asarray(normal / np.linalg.norm(normal, axis=1)[:, None])

    normal = normals(pieces)
    normal[eye * normal[:, viewing_axis] < 0] *= -1  # seen from inside, through the open top
    horizontal = -normal[:, horizontal_axis] if leftward else normal[:, horizontal_axis]
    light = np.stack([horizontal, normal[:, 2], eye * normal[:, viewing_axis]], axis=1) @ LIGHT
    lit_colours = colours * (DARKEST + (1 - DARKEST) * np.clip(light, 0.0, 1.0))[:, None]
    order = np.argsort(eye * pieces[:, :, viewing_axis].mean(axis=1))
    # Matplotlib makes paths of arrays in half the time of lists, but its type hints lack arrays.
    projected_triangles: Any = pieces[order][:, :, [horizontal_axis, 2]]
    ax.add_collection(
        PolyCollection(
            projected_triangles, color=lit_colours[order], linewidths=0.3, rasterized=True
        )
    )
    if edges is not None:
        faces_viewer = eye * normals(facets)[:, viewing_axis] > 0
        corner_order = [0, 3, 1, 4, 2, 5] if facets.shape[1] == 6 else [0, 1, 2]
        projected_facets: Any = facets[faces_viewer][:, corner_order][:, :, [horizontal_axis, 2]]
        ax.add_collection(
            PolyCollection(projected_facets, fc="none", ec=edges[faces_viewer], linewidths=0.2)
        )
    ax.autoscale_view()
    ax.set(aspect="equal", xlabel=f"{AXES[horizontal_axis]} (mm)")
    if leftward:
        ax.invert_xaxis()
