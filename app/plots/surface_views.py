"""Surfaces as seen from a side, and pictures of the interfaces around a stem."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize, to_rgb
from matplotlib.patches import Patch
from numpy.typing import NDArray

from app.foundation.arrays import Floats
from app.plots import figures
from app.plots.figures import PNG
from meshes.data import MeshData, interface_facets, nodes_of_boundary_facets
from meshes.nearest_facets import distance_from_triangles, triangles

AXES = "xyz"
# Interfaces whose distance is the thickness of the cement.
INTERFACES = ("stem_cement", "cement_bone")
# The horizontal axis, whether it points to the left, and the axis along which one looks.
VIEWS = {"lateral": (1, True, 0), "anterior": (0, True, 1), "medial": (1, False, 0)}
# Title of pictures of a right femur.
MIRRORED = "a right femur, mirrored"
FRONT_AND_SIDE = ("anterior", "medial")
# Direction to the light: from the left, from above, from the viewer.
LIGHT = np.array([-0.5, 0.4, 0.77])
# Brightness of a facet that faces away from the light.
DARKEST = 0.7
# Colour of a stem's surface.
METAL = "#b8c0cc"
# Colour of the cement below the tip.
PLUG = "0.85"
# Colour of the edges of facets on cortical bone.
CORTEX = "#d62728"


def draw_interfaces(data: MeshData, path: Path, title: str = "") -> None:
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
