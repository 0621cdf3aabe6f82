"""Interfaces unrolled: fields over the angle about the stem's axis and the height.

Both geometries that have a stem, femur and cylinders, have its axis in z. The angle begins behind
(posterior), so that medial and lateral both lie inside the picture. End faces, seen edge on, are
left out. Other interfaces are drawn if they are flat, in their own plane.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from app import figures
from app.arrays import Floats, Ints
from app.case.geometries import Sides
from app.results.reading import FACES, Run

# The angle runs from here by 360 degrees.
SEAM = -90.0
WAYS = {-90: "posterior", 0: "medial", 90: "anterior", 180: "lateral", 270: "posterior"}
SHORT = {"posterior": "post.", "medial": "med.", "anterior": "ant.", "lateral": "lat."}
# Facets that face up or down more than this (cosine) are end faces.
STEEP = math.cos(math.radians(40.0))
FLAT = 1e-6
# Colours end at this percentile of what is shown.
CLIP = 99.5
LEAST = 1e-3  # of the colours' range, so that rounding has no colour


@dataclass(frozen=True)
class Sheet:
    """An interface in the plane.

    Attributes:
        corners: Of its triangles in the plane (m, 3, 2): degrees and mm, or mm.
        nodes: The run's nodes at these corners (m, 3).
        round: Whether it was unrolled; else it is flat.
    """

    corners: Floats
    nodes: Ints
    round: bool


def facets(run: Run, side: Sequence[int], other: Sequence[int]) -> Ints:
    """Corners of the facets of an interface (m, 3), in the cells of one side."""
    mine, theirs = (
        run.cells[np.isin(run.region, regions)][:, np.array(FACES)].reshape(-1, 3)
        for regions in (side, other)
    )
    # Bodies that can part have nodes of their own at the same places.
    here, there = (
        np.round(run.points[f].mean(axis=1), 6).view("f8,f8,f8").ravel() for f in (mine, theirs)
    )
    return mine[np.isin(here, there)]


def unroll(points: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    """Angle about the z axis and height of triangles that surround it.

    Returns:
        Corners (k, 3, 2) [degrees, mm] of unbroken triangles, those across the seam on both sides
        of it; and their nodes (k, 3). End faces are left out.
    """
    x = points[triangles]
    normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    size = np.linalg.norm(normal, axis=1)
    keep = (size > 0) & (np.abs(normal[:, 2]) <= STEEP * size)
    x, triangles = x[keep], triangles[keep]
    angle = np.degrees(np.arctan2(x[:, :, 1], x[:, :, 0]))
    angle = SEAM + np.mod(angle - SEAM, 360.0)
    first = angle[:, :1]
    angle = first + np.mod(angle - first + 180.0, 360.0) - 180.0
    corners = np.stack([angle, x[:, :, 2]], axis=2)
    low, high = angle.min(axis=1) < SEAM, angle.max(axis=1) > SEAM + 360.0
    turn = np.array([360.0, 0.0])
    corners = np.concatenate([corners, corners[low] + turn, corners[high] - turn])
    return corners, np.concatenate([triangles, triangles[low], triangles[high]])


def sheet(run: Run, kind: str, sides: Sides, regions: Sequence[str]) -> Sheet | None:
    """An interface of a run in the plane; None if it neither surrounds a stem nor is flat."""
    first, second = ([1 + regions.index(r) for r in side] for side in sides)
    triangles = facets(run, second, first)
    if not len(triangles):
        return None
    if kind in ("femur", "cylinders"):
        corners, nodes = unroll(run.points, triangles)
        return Sheet(corners, nodes, True) if len(nodes) else None
    x = run.points[triangles]
    centred = x.reshape(-1, 3) - x.reshape(-1, 3).mean(axis=0)
    _, extent, axes = np.linalg.svd(centred, full_matrices=False)
    if extent[2] > FLAT * extent[0]:
        return None
    plane = [axis * np.sign(axis[np.abs(axis).argmax()]) for axis in axes[:2]]
    plane.sort(key=lambda axis: int(np.abs(axis).argmax()))
    return Sheet(x @ np.stack(plane, axis=1), triangles, False)


@dataclass(frozen=True)
class MapRow:
    """A quantity of a map.

    Attributes:
        values: At the nodes of each column's run, in that unit; None where it has none.
        from_zero: Whether colours begin at zero, else at the smallest value.
    """

    label: str
    colours: str
    values: Sequence[Floats | None]
    from_zero: bool = True


def draw(
    path: Path, columns: Sequence[tuple[str, Run, Sheet]], rows: Sequence[MapRow]
) -> list[str]:
    """Draw quantities of an interface, one below the other, cases side by side.

    The colours of a row are the same in all cases, so that they can be compared.

    Returns:
        The labels of the rows drawn; no picture if there is none.
    """
    found = [row for row in rows if any(v is not None for v in row.values)]
    if not found:
        return []
    round = all(s.round for _, _, s in columns)
    wide, high = (3.0, 2.9) if round else (3.4, 3.0)
    figure = figures.new(wide * len(columns) + 1.6, high * len(found) + 0.5)
    grid = figure.subplots(len(found), len(columns), squeeze=False, sharey=round)
    for axes_row, row in zip(grid, found, strict=True):
        of = [(own, v) for (*_, own), v in zip(columns, row.values, strict=True)]
        shown = [v[own.nodes] for own, v in of if v is not None]
        every = np.concatenate([v.ravel() for v in shown])
        low = 0.0 if row.from_zero else float(every.min())
        top = max(float(np.percentile(every, CLIP)), low + LEAST)
        shade: Any = None
        for axes, (own, v) in zip(axes_row, of, strict=True):
            _axes(axes, own)
            if v is None:
                axes.text(0.5, 0.5, "none", transform=axes.transAxes, ha="center", color="0.4")
                continue
            shade = _shade(axes, own, v, row.colours, (low, top))
        extend = "max" if every.max() > top * (1 + 1e-6) else "neither"
        figure.colorbar(shade, ax=list(axes_row), label=row.label, extend=extend, pad=0.01)
    for axes, (title, _, _) in zip(grid[0], columns, strict=True):
        axes.set_title(title, fontsize=10)
    for axes in grid[:, 0]:
        axes.set_ylabel("height (mm)" if round else "mm")
    figure.savefig(path, dpi=110)
    return [row.label for row in found]


def _shade(axes: Any, own: Sheet, values: Floats, colours: str, limits: tuple[float, float]) -> Any:
    from matplotlib.tri import Triangulation

    x = own.corners
    a, b = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]
    # Triangles of no area in the plane have no inside to shade.
    solid = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) > 1e-9
    x, nodes = x[solid], own.nodes[solid]
    number = np.arange(x.shape[0] * 3).reshape(-1, 3)
    mesh = Triangulation(x[:, :, 0].ravel(), x[:, :, 1].ravel(), number)
    return axes.tripcolor(
        mesh,
        values[nodes].ravel(),
        shading="gouraud",
        cmap=colours,
        vmin=limits[0],
        vmax=limits[1],
        rasterized=True,
    )


def _axes(axes: Any, own: Sheet) -> None:
    axes.set_facecolor("0.93")
    low, high = own.corners.reshape(-1, 2).min(axis=0), own.corners.reshape(-1, 2).max(axis=0)
    axes.set_ylim(low[1], high[1])
    if not own.round:
        axes.set_xlim(low[0], high[0])
        axes.set_aspect("equal")
        axes.set_xlabel("mm", fontsize=8)
        return
    axes.set_xlim(max(low[0], SEAM), min(high[0], SEAM + 360.0))
    shown = {a: w for a, w in WAYS.items() if axes.get_xlim()[0] <= a <= axes.get_xlim()[1]}
    names = [SHORT[way] for way in shown.values()]
    axes.set_xticks(list(shown), names, fontsize=8)
    for angle in (0.0, 90.0, 180.0):
        axes.axvline(angle, color="0.5", lw=0.5, ls=":")
