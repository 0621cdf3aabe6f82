"""Pictures of the interfaces from three sides, for paper and for browsers without WebGL."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from app import figures
from app.arrays import Floats, Ints
from app.report.curves import Figure
from app.report.viewer import INTERFACE, outsides
from app.results.reading import Run

NAME = "interfaces"
QUANTITIES = ("slip", "gap", "pressure")
# Directions to the eye and to the right: anterior is +y, medial +x, proximal +z.
VIEWS = {
    "lateral": ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0)),
    "anterior": ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)),
    "medial": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
}
MAPS = {"slip": "viridis", "gap": "viridis", "pressure": "cividis"}
LIGHT = 0.35  # how much darker facets are that are seen from the side


def draw(run: Run, folder: Path, formats: tuple[str, ...] = ("png",)) -> Figure | None:
    """Draw slip, gap and pressure of every interface on its inner body; nothing without contact.

    Args:
        run: The run.
        folder: Where the pictures are written.
        formats: Of the files: png, svg, pdf.
    """
    bodies = outsides(run, curved=True)
    found = {name: _side(run, name, bodies) for name in sorted(run.contacts, reverse=True)}
    sides = {name: side for name, side in found.items() if side is not None}
    if not sides:
        return None
    figure = figures.new(10.0, 4.2 * len(sides))
    axes = figure.subplots(len(sides), len(QUANTITIES), squeeze=False)
    for row, (name, (body, triangles)) in zip(axes, sides.items(), strict=True):
        for ax, quantity in zip(row, QUANTITIES, strict=True):
            label, unit, factor = INTERFACE[quantity]
            values = factor * run.at_interface(name, quantity)
            values = np.linalg.norm(values, axis=1) if values.ndim == 2 else values
            shown = _three(ax, run.points, triangles, values, MAPS[quantity])
            bar = figure.colorbar(shown, ax=ax, orientation="horizontal", pad=0.02)
            bar.set_label(f"{label} on the {body.replace('_', ' ')} ({unit})")
    for suffix in formats:
        figure.savefig(folder / f"{NAME}.{suffix}", dpi=130)
    names = " and ".join(name.replace("_", "-") for name in sides)
    return Figure(
        f"{NAME}.{formats[0]}",
        "The interfaces from three sides",
        "Net slip in contact, opening and contact pressure at the end, on the inner body of each "
        "interface.",
        f"Slip, gap and pressure of {names}, drawn on the surface from three sides.",
    )


def _side(run: Run, contact: str, bodies: Mapping[str, Ints]) -> tuple[str, Ints] | None:
    """The first body with facets on an interface, and these facets (t, 3)."""
    on = run.at_interface(contact, "status") >= 0
    for body, triangles in bodies.items():
        here = triangles[on[triangles].all(axis=1)]
        if len(here):
            return body, here
    return None


def _three(ax: Any, x: Floats, triangles: Ints, values: Floats, colours: str) -> Any:
    """Draw the facets that face the eye on each side, the farthest first; return their colours."""
    from matplotlib import cm, colors
    from matplotlib.collections import PolyCollection

    scale = cm.ScalarMappable(colors.Normalize(0.0, float(values.max()) or 1.0), colours)
    corners = x[triangles]
    rgba = scale.to_rgba(values[triangles].mean(axis=1))
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    high, left = corners[:, :, 2].max(), 0.0
    room = 0.13 * np.ptp(corners[:, :, 2])  # for the word above each
    for view, ways in VIEWS.items():
        eye, right = (np.array(w) for w in ways)
        light = normal @ eye
        order = np.argsort((corners @ eye).mean(axis=1))
        order = order[light[order] > 0]
        if not len(order):
            continue
        flat = np.stack([corners @ right, corners[:, :, 2]], axis=2)[order]
        low, wide = flat[:, :, 0].min(), np.ptp(flat[:, :, 0])
        flat[:, :, 0] += left - low
        shade = np.column_stack([*[1 - LIGHT * (1 - light[order])] * 3, np.ones(len(order))])
        paint = rgba[order] * shade
        drawn = PolyCollection(list(flat), facecolors=paint, edgecolors=paint, linewidths=0.2)
        drawn.set_rasterized(True)  # in files of lines: there are thousands
        ax.add_collection(drawn)
        ax.text(left + wide / 2, high + 2, view, ha="center", va="bottom", fontsize=8)
        left += max(1.3 * wide, room)
    ax.autoscale_view()
    ax.set_aspect("equal")
    ax.set_axis_off()
    return scale
