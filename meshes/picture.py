"""A mesh as pictures: sections through it, and both interfaces of a cemented stem's mantle."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from app import figures
from app.arrays import Bools, Floats, Ints
from meshes.data import EDGES, MeshData, interface_facets

# The straight cells that share the nodes of a curved one: its corners, and four around a diagonal.
PIECES = (
    *((0, 4, 6, 7), (4, 1, 5, 9), (6, 5, 2, 8), (7, 9, 8, 3)),
    *((4, 8, 6, 7), (4, 8, 7, 9), (4, 8, 9, 5), (4, 8, 5, 6)),
)
COLOURS = {
    "stem": "#7f8fa6",
    "cement": "#e8a0a8",
    "cortical_bone": "#e6cf8b",
    "cancellous_bone": "#f5eed2",
    "bone": "#e6cf8b",
}
OTHERS = ("#8fb7d9", "#f2b880", "#a8cf9b", "#c7a7d8", "#d9d07c", "#88c9c3")
AXES = "xyz"
INTERFACES = ("stem_cement", "cement_bone")
INSIDE = 1.0  # mm of the sections from the tip and from the lowest point of the neck cut
# The horizontal axis, whether it points to the left, and the axis towards the viewer.
VIEWS = {"anterior": (0, True, 1), "medial": (1, False, 0)}
LIGHT = np.array([-0.5, 0.4, 0.77])  # from the left, from above, from the viewer
DARKEST = 0.45
METAL, PLUG, CORTEX = "#b8c0cc", "0.85", "#d62728"  # the last: the line around what touches it
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


def cut(points: Floats, cells: Ints, axis: int, at: float) -> list[tuple[Floats, Ints]]:
    """Cut tetrahedra by the plane x_axis = at [mm], exactly (curved cells: their corners).

    Nodes on the plane count as above. Returns, for triangles and for quadrilaterals, corners
    (k, 3 or 4, 3) and their cells (k,).
    """
    height = points[cells[:, :4], axis] - at
    code = (height >= 0) @ (1 << np.arange(4))
    sections: dict[int, list[tuple[Floats, Ints]]] = {3: [], 4: []}
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


def section(data: MeshData, axis: int, at: float) -> tuple[list[tuple[Floats, Ints]], Floats, Ints]:
    """Cut cells by a plane as `cut`, curved ones as the eight straight ones that share their nodes.

    Returns:
        Corners of polygons and their cells; the edges of the cells' sections (n, 2, 3) and the cell
        of each (n,).
    """
    pieces = PIECES if data.curved else ((0, 1, 2, 3),)
    parts = cut(data.points, data.cells[:, np.array(pieces)].reshape(-1, 4), axis, at)
    polygons = [(corners, piece // len(pieces)) for corners, piece in parts]
    return polygons, *outlines(polygons)


def outlines(polygons: Iterable[tuple[Floats, Ints]]) -> tuple[Floats, Ints]:
    """Edges (n, 2, 3) around the polygons (k, corners, 3) of each owner (k,), and their owners."""
    edges = [np.stack([x, np.roll(x, -1, axis=1)], axis=2).reshape(-1, 2, 3) for x, _ in polygons]
    ends = np.concatenate(edges)
    owner = np.concatenate([np.repeat(of, x.shape[1]) for x, of in polygons])
    # An edge that two polygons share is inside.
    span = np.abs(ends[:, 1] - ends[:, 0])
    keys = np.column_stack([owner, np.round(ends.sum(axis=1), 6), np.round(span, 6)])
    _, first, times = np.unique(keys, axis=0, return_index=True, return_counts=True)
    outer = first[times == 1]
    return ends[outer], owner[outer]


def picture(data: MeshData, path: Path) -> None:
    """Write a PNG with the sections y = 0, x = 0 (through the mesh's middle) and one transverse."""
    low, high = data.points.min(axis=0), data.points.max(axis=0)
    levels = [middle_plane(low[i], high[i]) for i in range(3)]
    extent = high - low
    widths = [extent[0], extent[1], max(extent[0], extent[1])]
    height = 9.0
    scale = (height - 1.5) / max(extent[2], 0.4 * max(extent[:2]))
    figure = figures.new(float(np.clip(scale * sum(widths) + 4.0, 9.0, 24.0)), height)
    axes = figure.subplots(1, 3, width_ratios=np.maximum(widths, 0.15 * max(widths)))
    planes = [("", axis, levels[axis]) for axis in (1, 0, 2)]
    figure.suptitle(f"{len(data.cells)} cells, {len(data.points)} nodes")
    _sections(data, figure, axes, planes)
    figure.savefig(path, dpi=130, format="png")


def sections(data: MeshData, path: Path) -> None:
    """Write a PNG with sections near the neck cut, in the middle of the stem and above its tip."""
    stem = data.points[interface_facets(data, "stem_cement")[0], 2]
    top = stem.max()
    if tags := data.boundaries.get("resection"):
        top = data.points[data.facets[np.isin(data.facet_tags, tags)], 2].min()
    high, low = top - INSIDE, stem.min() + INSIDE
    planes = [
        ("near the neck cut, ", 2, float(np.floor(high))),
        ("middle of the stem, ", 2, float(np.round(0.5 * (high + low)))),
        ("above the tip, ", 2, float(np.ceil(low))),
    ]
    figure = figures.new(12.0, 4.0)
    _sections(data, figure, figure.subplots(1, 3, sharex=True, sharey=True), planes)
    figure.savefig(path, dpi=110, format="png")


def _sections(
    data: MeshData, figure: Any, axes: Iterable[Any], planes: Iterable[tuple[str, int, float]]
) -> None:
    """Draw sections side by side, filled cells and outlines, with the names of regions below."""
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.patches import Patch

    colours = colours_of(data.regions)
    shown = {tag: colours[name] for name, tag in data.regions.items()}
    for ax, (place, axis, at) in zip(axes, planes, strict=True):
        u, v = (i for i in range(3) if i != axis)
        polygons, outlines, _ = section(data, axis, at)
        for x, cell in polygons:
            face = [shown[int(tag)] for tag in data.cell_tags[cell]]
            flat = list(x[:, :, [u, v]])
            ax.add_collection(
                PolyCollection(flat, facecolors=face, edgecolors=face, linewidths=0.3)
            )
        lines = list(outlines[:, :, [u, v]])
        ax.add_collection(LineCollection(lines, colors="k", linewidths=0.25))
        ax.set_aspect("equal")
        ax.autoscale_view()
        ax.set(xlabel=f"{AXES[u]} (mm)", ylabel=f"{AXES[v]} (mm)")
        ax.set_title(f"{place}{AXES[axis]} = {at:.4g} mm")
    handles = [Patch(facecolor=c, edgecolor="k", label=n) for n, c in colours.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=min(6, len(handles)))


def middle_plane(low: float, high: float) -> float:
    """The coordinate plane (0) where it passes inside, else the middle."""
    if low < -0.1 * (high - low) and high > 0.1 * (high - low):
        return 0.0
    return 0.5 * (low + high)


def colours_of(names: Iterable[str]) -> dict[str, str]:
    """Colour of each region."""
    free = (c for _ in names for c in OTHERS)
    return {name: COLOURS.get(name) or next(free) for name in names}


def interfaces(data: MeshData, path: Path) -> None:
    """Write a PNG of both interfaces, seen from anterior and from medial.

    The bone interface is coloured by the thickness of the cement, which is undefined below the tip,
    where the plug is.
    """
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize, to_rgb
    from matplotlib.lines import Line2D

    from meshes.mantle import distance, triangles  # imports scipy

    stem, bone = (interface_facets(data, name) for name in INTERFACES)
    patches = [triangles(data.points, facets) for facets, _, _ in (stem, bone)]
    middle = patches[1].mean(axis=1)
    thickness = distance(middle, patches[0])
    beside = middle[:, 2] > patches[0][:, :, 2].min()
    shown = ScalarMappable(
        Normalize(np.floor(thickness.min()), np.ceil(thickness[beside].max())),
        colormaps["viridis"],
    )
    grey = np.tile(to_rgb(METAL), (len(patches[0]), 1))
    tinted = np.where(beside[:, None], shown.to_rgba(thickness)[:, :3], to_rgb(PLUG))

    widths = [np.ptp(p[:, :, VIEWS[view][0]]) for p in patches for view in VIEWS]
    figure = figures.new(8.5, 10.5)
    axes = figure.subplots(1, 4, sharey=True, width_ratios=widths).reshape(2, 2)
    cortex = data.cell_tags[bone[2]] == data.regions.get("cortical_bone")
    for row, name, (facets, _, _), pieces, colours in zip(
        axes, INTERFACES, (stem, bone), patches, (grey, tinted), strict=True
    ):
        for ax, view in zip(row, VIEWS, strict=True):
            _surface(ax, data.points, facets, pieces, colours, view)
            if name == "cement_bone":
                _outline(ax, data.points, facets, cortex, view)
            ax.set_title(f"{name}\nfrom {view}")
    axes[0, 0].set_ylabel("z (mm)")
    figure.colorbar(shown, ax=list(axes.flat), label="thickness of the cement (mm)", shrink=0.5)
    if cortex.any() and not cortex.all():
        line = Line2D(
            [], [], color=CORTEX, label="between cement on cancellous and on cortical bone"
        )
        figure.legend(handles=[line], loc="outside lower center")
    figure.savefig(path, dpi=95, format="png")


def _normals(corners: Floats) -> Floats:
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(across / np.linalg.norm(across, axis=1)[:, None])


def _surface(
    ax: Any, points: Floats, facets: Ints, pieces: Floats, colours: Floats, view: str
) -> None:
    """Draw the side of a surface that faces the viewer, lit from the upper left, with facet edges.

    Args:
        ax: Axes to draw in.
        points: Nodes [mm].
        facets: The surface's facets, outward (k, 3 or 6).
        pieces: Their flat triangles (n, 3, 3), equally many for each.
        colours: Red, green and blue of each triangle (n, 3).
        view: One of `VIEWS`.
    """
    from matplotlib.collections import PolyCollection

    across, leftward, toward = VIEWS[view]
    normals = _normals(pieces)
    normals[normals[:, toward] < 0] *= -1  # seen from inside, through the open top
    right = -normals[:, across] if leftward else normals[:, across]
    light = np.stack([right, normals[:, 2], normals[:, toward]], axis=1) @ LIGHT
    lit = colours * (DARKEST + (1 - DARKEST) * np.clip(light, 0.0, 1.0))[:, None]
    order = np.argsort(pieces[:, :, toward].mean(axis=1))
    flat = pieces[order][:, :, [across, 2]]
    ax.add_collection(
        PolyCollection(list(flat), facecolors=lit[order], edgecolors=lit[order], linewidths=0.3)
    )
    near = _normals(points[facets[:, :3]])[:, toward] > 0
    ring = [0, 3, 1, 4, 2, 5] if facets.shape[1] == 6 else [0, 1, 2]
    rings = points[facets[near][:, ring]][:, :, [across, 2]]
    ax.add_collection(
        PolyCollection(list(rings), facecolors="none", edgecolors="k", linewidths=0.2)
    )
    ax.set_aspect("equal")
    ax.autoscale_view()
    if leftward:
        ax.invert_xaxis()
    ax.set_xlabel(f"{AXES[across]} (mm)")


def _outline(ax: Any, points: Floats, facets: Ints, chosen: Bools, view: str) -> None:
    """Draw the outline of chosen facets of a surface, where it faces the viewer."""
    from matplotlib.collections import LineCollection

    across, _, toward = VIEWS[view]
    ends = facets[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, edge, times = np.unique(
        np.sort(ends, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    owned = np.bincount(edge.ravel(), weights=np.repeat(chosen, 3))
    near = np.repeat(_normals(points[facets[:, :3]])[:, toward] > 0, 3)
    drawn = near & (owned == 1)[edge.ravel()] & (times == 2)[edge.ravel()]
    lines = points[ends[drawn]][:, :, [across, 2]]
    ax.add_collection(LineCollection(list(lines), colors=CORTEX, linewidths=1.6))
