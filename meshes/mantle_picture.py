"""A cemented stem's mantle as pictures: three cross-sections, and both of its interfaces."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from app import figures
from app.arrays import Floats, Ints
from meshes.data import MeshData, interface_facets
from meshes.mantle import distance, triangles
from meshes.picture import add_legend, colours_of, cut
from meshes.refine import AROUND, CORNERS

INTERFACES = ("stem_cement", "cement_bone")
INSIDE = 1.0  # mm of the sections from the tip and from the lowest point of the neck cut
# The horizontal axis, whether it points to the left, and the axis towards the viewer.
VIEWS = {"anterior": (0, True, 1), "medial": (1, False, 0)}
LIGHT = np.array([-0.5, 0.4, 0.77])  # from the left, from above, from the viewer
DARKEST = 0.45
METAL, CORTEX = "#b8c0cc", "#d62728"  # the stem; the line around what touches the cortex


def sections(data: MeshData, path: Path) -> None:
    """Write a PNG with sections near the neck cut, in the middle of the stem and above its tip.

    Args:
        data: The mesh.
        path: The file to write.
    """
    colours = colours_of(data.regions)
    figure = figures.new(12.0, 4.0)
    axes = figure.subplots(1, 3, sharex=True, sharey=True)
    places = ("near the neck cut", "middle of the stem", "above the tip")
    for ax, place, at in zip(axes, places, _heights(data), strict=True):
        _draw(ax, data, at, colours)
        ax.set_title(f"{place}, z = {at:.4g} mm")
    add_legend(figure, colours)
    figure.savefig(path, dpi=110, format="png")


def interfaces(data: MeshData, path: Path) -> None:
    """Write a PNG with both interfaces as they look from anterior and from medial.

    The one at the bone is coloured by the thickness of the cement; below the tip, where the plug
    is, it has none.

    Args:
        data: The mesh.
        path: The file to write.
    """
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize, to_rgb
    from matplotlib.lines import Line2D

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
    tinted = np.where(beside[:, None], shown.to_rgba(thickness)[:, :3], to_rgb("0.85"))

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


def _heights(data: MeshData) -> tuple[float, float, float]:
    """Levels of the sections [mm], from proximal to distal."""
    stem = data.points[interface_facets(data, "stem_cement")[0], 2]
    top = stem.max()
    if tags := data.boundaries.get("resection"):
        top = data.points[data.facets[np.isin(data.facet_tags, tags)], 2].min()
    high, low = top - INSIDE, stem.min() + INSIDE
    return float(np.floor(high)), float(np.round(0.5 * (high + low))), float(np.ceil(low))


def section(
    data: MeshData, at: float
) -> tuple[list[tuple[Floats, npt.NDArray[np.int64]]], Floats, npt.NDArray[np.int64]]:
    """Cut cells by the plane z = at, curved ones as the eight straight ones that share their nodes.

    Returns:
        As `picture.cut`, corners of polygons and their cells; the edges of the cells' sections
        (n, 2, 2) and the cell of each (n,).
    """
    pieces = [(0, 1, 2, 3)]
    if data.curved:
        (p, q), ring = next(iter(AROUND.items()))
        pieces = [*CORNERS, *((p, q, ring[k], ring[(k + 1) % 4]) for k in range(4))]
    parts = cut(data.points, data.cells[:, pieces].reshape(-1, 4), 2, at)
    polygons = [(corners, piece // len(pieces)) for corners, piece in parts]
    edges = [np.stack([x, np.roll(x, -1, axis=1)], axis=2).reshape(-1, 2, 3) for x, _ in polygons]
    ends = np.concatenate(edges)[:, :, :2]
    owner = np.concatenate([np.repeat(cell, x.shape[1]) for x, cell in polygons])
    # What two pieces of a cell share is inside it.
    span = np.abs(ends[:, 1] - ends[:, 0])
    keys = np.column_stack([owner, np.round(ends.sum(axis=1), 6), np.round(span, 6)])
    _, first, times = np.unique(keys, axis=0, return_index=True, return_counts=True)
    outer = first[times == 1]
    return polygons, ends[outer], owner[outer]


def _draw(ax: Any, data: MeshData, at: float, colours: dict[str, str]) -> None:
    """Draw one section: cells filled, and their outlines."""
    from matplotlib.collections import LineCollection, PolyCollection

    shown = {tag: colours[name] for name, tag in data.regions.items()}
    polygons, outlines, _ = section(data, at)
    for x, cell in polygons:
        face = [shown[int(tag)] for tag in data.cell_tags[cell]]
        ax.add_collection(
            PolyCollection(list(x[:, :, :2]), facecolors=face, edgecolors=face, linewidths=0.3)
        )
    ax.add_collection(LineCollection(list(outlines), colors="k", linewidths=0.25))
    ax.set_aspect("equal")
    ax.autoscale_view()
    ax.set(xlabel="x (mm)", ylabel="y (mm)")


def _normals(corners: Floats) -> Floats:
    """Unit normals of triangles (n, 3, 3)."""
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(across / np.linalg.norm(across, axis=1)[:, None])


def _surface(
    ax: Any, points: Floats, facets: Ints, pieces: Floats, colours: Floats, view: str
) -> None:
    """Draw what faces the viewer of a surface, lit from the upper left, and its facets' edges.

    Args:
        ax: Where to draw.
        points: Nodes [mm].
        facets: The surface's facets, outward (k, 3 or 6).
        pieces: Flat triangles that they consist of (n, 3, 3), as many for each.
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
    ax.set_xlabel(f"{'xyz'[across]} (mm)")


def _outline(
    ax: Any, points: Floats, facets: Ints, chosen: npt.NDArray[np.bool_], view: str
) -> None:
    """Draw the line around some facets of a surface, where it faces the viewer."""
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
