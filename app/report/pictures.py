"""Pictures of interfaces: maps in the plane, and surfaces seen from three sides.

The map of an interface around a stem is unrolled about the stem's axis z: abscissa is the angle,
ordinate the height. The angle begins posteriorly, so that the medial and the lateral side are both
inside the picture. End faces would be lines in this map and are left out. Other interfaces are
drawn if they are flat, or if they are part of a sphere such as a cup.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import matplotlib as mpl
import matplotlib.figure
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.image import AxesImage
from numpy.typing import NDArray

from app.case.case import read_geometry
from app.case.geometries import Sides
from app.case.quantities import INTERFACE_FIELDS
from app.foundation.arrays import Floats, Ints
from app.foundation.errors import MantleError
from app.foundation.layout import alternatives
from app.plots import figures
from app.plots import maps as plane
from app.plots.figures import HEAT_COLOURS, LOADED, SEQUENTIAL, SIGNED
from app.plots.surface_views import VIEWS, draw_surface
from app.report import lead
from app.report.page import Figure
from app.report.sweep_results import QUANTITY_LABELS, SweepResults, SweptCase, headlines, named
from app.report.viewer import (
    INTERFACE,
    cells_of,
    interface_fields,
    lengths,
    outsides,
    quartered,
    side_of,
)
from app.results.reading import Run
from meshes.data import FACES

Chosen = list[tuple[str, SweptCase]]

TEMPERATURE = "highest temperature (°C)"
# Colours of the maps by quantity.
SHOWN = {
    "gap": SEQUENTIAL,
    "slip": SEQUENTIAL,
    "motion": SEQUENTIAL,
    "micromotion": SEQUENTIAL,
    "pressure": LOADED,
}
PEAK = "temperature_peak"
# Name of the picture of the surfaces from three sides.
PICTURE_OF_SIDES = "interfaces"
ON_SIDES = {"slip": "viridis", "gap": "viridis", "pressure": "cividis"}
# Quantities of which the picture has means over the area of a node.
TRACTIONS = ("pressure", "shear")
# Angle at the left end of an unrolled map [degrees].
SEAM = -90.0
WAYS = {-90: "posterior", 0: "medial", 90: "anterior", 180: "lateral", 270: "posterior"}
SHORT = {"posterior": "post.", "medial": "med.", "anterior": "ant.", "lateral": "lat."}
# Cosine between normal and vertical above which a facet belongs to an end face.
STEEP = math.cos(math.radians(40.0))
# Deviation from a plane or sphere that is rounding, as a fraction of the size.
ROUNDING_OF_DEPTH = 1e-6
# Errors of runs whose fields or geometry cannot be read.
UNREADABLE = (OSError, KeyError, ValueError, MantleError)
# Percentile of the values drawn at which colours end.
CLIP = 99.5
# Least range of colours, in the printed unit, so that rounding errors have no colour.
LEAST_COLOUR_RANGE = 1e-3


@dataclass(frozen=True)
class Sheet:
    """An interface in the plane.

    Attributes:
        corners: Corners of its triangles (m, 3, 2): angle [degrees] and height [mm] if it is
            unrolled, otherwise coordinates in the plane [mm].
        nodes: Nodes of the run at these corners (m, 3).
        round: True if it is unrolled about the stem's axis.
        cup: True if it is a part of a sphere that is spread out from its pole.
    """

    corners: Floats
    nodes: Ints
    round: bool
    cup: bool = False


Column = tuple[str, Run, Sheet]
# Label, colours, and for each column the values at the nodes of its run (n,); None without values.
Row = tuple[str, str, Sequence[Floats | None]]


def ends(sweep: SweepResults) -> Chosen:
    """Return the cases with the smallest and largest value of the first number that varies.

    If no number varies, they are the first and the last case with fields.
    """
    with_fields = [
        case for case in sweep.cases if case.done and (case.folder / "fields.vtkhdf").exists()
    ]
    first_and_last = [(0.0, case) for case in (*with_fields[:1], *with_fields[1:][-1:])]
    _, cases_at_ends = next(lead.ranges(with_fields, headlines(with_fields)), ("", first_and_last))
    return [(case.name, case) for _, case in cases_at_ends]


def maps(
    chosen: Chosen, folder: Path, suffixes: Sequence[str] = figures.SUFFIXES
) -> tuple[list[Figure], list[str]]:
    """Draw a map of each interface for all cases; return pictures, reasons for missing ones."""
    figures_drawn: list[Figure] = []
    reasons: list[str] = []
    opened = []
    for title, case in chosen:
        try:
            opened.append((title, sheets(case)))
        except UNREADABLE as error:
            reasons.append(f"no map of {case.name}: {str(error).partition(chr(10))[0]}")
    for name in dict.fromkeys(chain.from_iterable(by_name for _, by_name in opened)):
        columns = []
        for title, by_name in opened:
            run_and_sheet = by_name.get(name)
            if run_and_sheet:
                columns.append((title, *run_and_sheet))
        if not columns:
            reasons.append(f"no map of {name}: it does not surround a stem, and is no plane or cup")
            continue
        file = f"map_{name}.png"
        labels = draw(folder / file, columns, _rows(name, columns), suffixes)
        if labels:
            figures_drawn.append(_figure(file, name, columns, labels))
    return figures_drawn, reasons


def sheets(case: SweptCase) -> dict[str, tuple[Run, Sheet] | None]:
    """The interfaces of a run in the plane, by name; None for one that `sheet` does not draw.

    Raises:
        OSError, KeyError, ValueError, MantleError: Fields or geometry cannot be read.
    """
    run = Run(case.folder)
    geometry = read_geometry(case.data, case.folder)
    if geometry is None:
        return {}
    by_name: dict[str, tuple[Run, Sheet] | None] = {}
    for name, sides in geometry.interface_sides.items():
        interface_sheet = sheet(run, geometry.is_around_z, sides, geometry.region_names, name)
        by_name[name] = (run, interface_sheet) if interface_sheet else None
    return by_name


def _rows(name: str, columns: Sequence[Column]) -> list[Row]:
    rows: list[Row] = []
    colours_of_quantity, labels = dict(SHOWN), interface_fields()
    for added_field in INTERFACE_FIELDS.values():
        colours_of_quantity[added_field.name] = LOADED if added_field.loaded else SEQUENTIAL
    for quantity, colours in colours_of_quantity.items():
        (label, unit, factor), field = labels[quantity], f"{name}_{quantity}"
        values = [
            factor * lengths(run, field) if field in run.point_fields else None
            for _, run, _ in columns
        ]
        rows.append((f"{QUANTITY_LABELS.get(quantity, label)} ({unit})", colours, values))
    peaks = [run.on_points(PEAK) if PEAK in run.point_fields else None for _, run, _ in columns]
    return [*rows, (TEMPERATURE, HEAT_COLOURS, peaks)]


def _figure(file: str, name: str, columns: Sequence[Column], labels: Sequence[str]) -> Figure:
    titles = [title for title, _, _ in columns if title]
    caption = f"Colours end at the {CLIP:g}th percentile. "
    if len(columns) > 1:
        caption = f"All cases of a row have the same colours, up to the {CLIP:g}th percentile. "
    if all(s.round for _, _, s in columns):
        caption += (
            "The interface is unrolled around the stem's axis and cut open posteriorly, without "
            "end faces. Grey: above the neck cut."
        )
    elif any(s.cup for _, _, s in columns):
        caption += "The cup is spread out from its pole: distances from there are arcs."
    if TEMPERATURE in labels:
        caption += " Temperature: the highest that each place of the second body reaches."
    interface_title = f"{named(name)} interface"
    title = interface_title
    description = f"{', '.join(labels)} on the {interface_title}"
    if titles:
        title += f": {'; '.join(titles)}"
        description += f" of {'; '.join(titles)}"
    return Figure(file, title, caption, description)


# Maps


def facets(run: Run, side: Sequence[int], other_side: Sequence[int]) -> Ints:
    """Triangles of an interface (m, 3) with nodes of one side; a curved facet is four triangles."""
    faces = _faces(cells_of(run, side))
    other_faces = _faces(cells_of(run, other_side))
    # The sides may have separate nodes at the same places, so faces are compared by their centres.
    is_shared = np.isin(_centres(run, faces), _centres(run, other_faces))
    return quartered(faces[is_shared])


def _faces(cells: Ints) -> Ints:
    """Nodes of the four faces of each cell (4 m, 3), or (4 m, 6) of second order."""
    nodes_of_face = 3 if cells.shape[1] == 4 else 6
    return cells[:, FACES[:, :nodes_of_face]].reshape(4 * len(cells), -1)


def _centres(run: Run, faces: Ints) -> NDArray[np.void]:
    """Centres of faces (m,), each as one comparable value, rounded to 1e-6 mm."""
    centres = np.round(run.points[faces[:, :3]].mean(axis=1), 6)
    return centres.view("f8,f8,f8").ravel()


def unroll(points: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    """Angle about the z axis and height of triangles that surround it.

    Returns:
        Corners (k, 3, 2) [degrees, mm] and nodes (k, 3). A triangle across the seam of the map
        is there twice, once at each end of the map. End faces are left out.
    """
    x = points[triangles]
    normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    size = np.linalg.norm(normal, axis=1)
    is_kept = (size > 0) & (np.abs(normal[:, 2]) <= STEEP * size)
    x, triangles = x[is_kept], triangles[is_kept]
    angle = np.degrees(np.arctan2(x[:, :, 1], x[:, :, 0]))
    angle = SEAM + np.mod(angle - SEAM, 360.0)
    first_angle = angle[:, :1]
    angle = first_angle + np.mod(angle - first_angle + 180.0, 360.0) - 180.0
    corners = np.stack([angle, x[:, :, 2]], axis=2)
    is_below_seam, is_above_seam = angle.min(axis=1) < SEAM, angle.max(axis=1) > SEAM + 360.0
    full_turn = np.array([360.0, 0.0])
    corners = np.concatenate(
        [corners, corners[is_below_seam] + full_turn, corners[is_above_seam] - full_turn]
    )
    return corners, np.concatenate([triangles, triangles[is_below_seam], triangles[is_above_seam]])


def sheet(
    run: Run, around_z: bool, sides: Sides, regions: Sequence[str], name: str = ""
) -> Sheet | None:
    """Return an interface of a run in the plane.

    None if it neither surrounds a stem nor is flat nor part of a sphere. If the sides are meshed
    separately, the side with the contact points is drawn.
    """
    first_tags, second_tags = ([1 + regions.index(r) for r in side] for side in sides)
    triangles = facets(run, second_tags, first_tags)
    if not len(triangles):
        body_and_triangles = side_of(run, name, outsides(run, curved=False)) if name else None
        if not body_and_triangles:
            return None
        triangles = body_and_triangles[1]
        cup = flattened_cup(run.points[triangles])
        if cup is not None:
            return Sheet(cup, triangles, False, True)
    if around_z:
        corners, nodes = unroll(run.points, triangles)
        return Sheet(corners, nodes, True) if len(nodes) else None
    x = run.points[triangles]
    centred = x.reshape(-1, 3) - x.reshape(-1, 3).mean(axis=0)
    _, extent, axes = np.linalg.svd(centred, full_matrices=False)
    if extent[2] > ROUNDING_OF_DEPTH * extent[0]:
        return None
    other_axes = np.delete(np.eye(3), np.abs(axes[2]).argmax(), axis=0)
    plane, signs = np.linalg.qr(np.vstack([axes[2], other_axes]).T)
    return Sheet(x @ (plane * np.sign(np.diag(signs)))[:, 1:], triangles, False)


def flattened_cup(x: Floats) -> Floats | None:
    """Spread the triangles of a cup (m, 3, 3) [mm] into the plane (m, 3, 2) [mm].

    The pole is in the middle, and distances from it are arc lengths. None if the triangles are not
    on a sphere.
    """
    corners = x.reshape(-1, 3)
    linear = np.column_stack([2 * corners, np.ones(len(corners))])
    centre = np.linalg.lstsq(linear, (corners**2).sum(axis=1))[0][:3]
    radial = x - centre
    size = np.linalg.norm(radial, axis=2, keepdims=True)
    if np.ptp(size) > ROUNDING_OF_DEPTH * size.max():
        return None
    pole = radial.mean(axis=(0, 1)) / np.linalg.norm(radial.mean(axis=(0, 1)))
    other_axes = np.delete(np.eye(3), np.abs(pole).argmax(), axis=0)
    plane, signs = np.linalg.qr(np.vstack([pole, other_axes]).T)
    in_plane = radial / size @ (plane * np.sign(np.diag(signs)))
    distance_from_axis = np.linalg.norm(in_plane[..., 1:], axis=2, keepdims=True)
    angle = np.arctan2(distance_from_axis, in_plane[..., :1])
    return np.asarray(size * angle * in_plane[..., 1:] / np.maximum(distance_from_axis, 1e-12))


def draw(
    path: Path,
    columns: Sequence[Column],
    rows: Sequence[Row],
    suffixes: Sequence[str] = figures.SUFFIXES,
) -> list[str]:
    """Draw the maps of an interface: a row for each quantity, a column for each case.

    A single case has two quantities side by side. A quantity has the same colours in all cases, so
    that these can be compared. Return the labels of the quantities drawn; without values there is
    no picture.
    """
    rows = [row for row in rows if not all(values is None for values in row[2])]
    if not rows:
        return []
    round = all(s.round for _, _, s in columns)
    titles = [textwrap.fill(title.replace("_", " "), 30) for title, _, _ in columns]
    figure, grid = _panels(titles, len(rows), round)
    panels = grid.reshape(-1, len(columns))
    for axes_row, (label, colours, fields) in zip(panels, rows, strict=False):
        sheet_values = [(map_sheet, v) for (*_, map_sheet), v in zip(columns, fields, strict=True)]
        all_values = np.concatenate(
            [v[map_sheet.nodes].ravel() for map_sheet, v in sheet_values if v is not None]
        )
        lowest, highest = _limits(all_values[np.isfinite(all_values)], label, colours)
        shades: list[AxesImage] = []
        for axes, (map_sheet, v) in zip(axes_row, sheet_values, strict=True):
            _axes(axes, map_sheet)
            if v is None:
                axes.text(0.5, 0.5, "none", transform=axes.transAxes, ha="center", color="0.4")
                continue
            limits = lowest, highest
            shades.append(
                plane.shaded(axes, map_sheet.corners, v[map_sheet.nodes], colours, limits)
            )
        extend = "neither"
        if np.nanmax(all_values) > highest * (1 + 1e-6):
            extend = "both" if colours == SIGNED else "max"
        figure.colorbar(shades[0], ax=list(axes_row), label=label, extend=extend, pad=0.04)
    for axes, title in zip(grid[0], titles, strict=False):
        axes.set_title(title, fontsize=10)
    for axes in grid[:, 0]:
        axes.set_ylabel("height (mm)" if round else "mm")
    figures.save_figure(figure, path, 160, suffixes)
    return [label for label, *_ in rows]


def _panels(
    titles: Sequence[str], quantities: int, round: bool
) -> tuple[mpl.figure.Figure, NDArray[np.object_]]:
    """Return a figure and its axes (rows, columns) for maps of quantities in cases.

    Args:
        titles: Titles of the cases.
        quantities: Number of quantities.
        round: True for maps of round interfaces, which share their heights.
    """
    is_single = len(titles) == 1
    row_count, column_count = quantities, len(titles)
    if is_single:
        row_count, column_count = math.ceil(quantities / 2), min(2, quantities)
    width, height = (3.0, 2.9) if round else (3.4, 3.0)
    width, height = (width + 0.8 * is_single) * column_count + 1.2, height * row_count + 0.3
    title_height = 0.15 + 0.18 * max(len(title.splitlines()) for title in titles)
    figure = figures.new(width, height + title_height)
    figure.set_layout_engine(None)  # takes a third of the time
    margins = (
        0.75 / width,
        0.4 / (height + title_height),
        1 - 0.45 / width,
        height / (height + title_height),
    )
    figure.subplots_adjust(*margins, wspace=0.2 if is_single else 0.12, hspace=0.16)
    grid = figure.subplots(row_count, column_count, squeeze=False, sharey=round)
    for axes in grid.ravel()[quantities * len(titles) :]:
        axes.set_visible(False)
    return figure, grid


def _limits(values: Floats, label: str, colours: str) -> tuple[float, float]:
    """Return the values at which the colours of a row begin and end."""
    if colours == SIGNED:
        highest = max(float(np.percentile(np.abs(values), CLIP)), LEAST_COLOUR_RANGE)
        return -highest, highest
    lowest = float(values.min()) if label == TEMPERATURE else 0.0
    return lowest, max(float(np.percentile(values, CLIP)), lowest + LEAST_COLOUR_RANGE)


def _axes(axes: Axes, map_sheet: Sheet) -> None:
    axes.set_facecolor("0.93")
    lower_corner = map_sheet.corners.reshape(-1, 2).min(axis=0)
    upper_corner = map_sheet.corners.reshape(-1, 2).max(axis=0)
    axes.set_ylim(lower_corner[1], upper_corner[1])
    if not map_sheet.round:
        axes.set_xlim(lower_corner[0], upper_corner[0])
        axes.set_aspect("equal")
        axes.set_xlabel("mm", fontsize=8)
        return
    axes.set_xlim(max(lower_corner[0], SEAM), min(upper_corner[0], SEAM + 360.0))
    left_limit, right_limit = axes.get_xlim()
    direction_of_angle = {
        angle: name for angle, name in WAYS.items() if left_limit <= angle <= right_limit
    }
    short_names = [SHORT[direction] for direction in direction_of_angle.values()]
    ticks = axes.set_xticks(list(direction_of_angle), short_names, fontsize=8)
    # The outer names stay inside the frame, so that those of the next map have room.
    for tick in ticks[:1]:
        tick.label1.set_horizontalalignment("left")
    for tick in ticks[1:][-1:]:
        tick.label1.set_horizontalalignment("right")
    for angle in (0.0, 90.0, 180.0):
        axes.axvline(angle, color="0.5", lw=0.5, ls=":")


# From three sides


def _on_sides(run: Run, name: str) -> dict[str, str]:
    """Return the colours of the quantities drawn; a press fit has micromotion instead of slip."""
    if f"{name}_micromotion" not in run.point_fields:
        return ON_SIDES
    other_colours = {key: colours for key, colours in ON_SIDES.items() if key != "slip"}
    return {"micromotion": ON_SIDES["slip"], **other_colours}


def sides(run: Run, folder: Path) -> list[Figure]:
    """Draw slip, gap and pressure of every interface on its inner body; nothing without contact."""
    bodies = outsides(run, curved=True)
    with_slip = [
        name for name in sorted(run.contacts, reverse=True) if f"{name}_slip" in run.point_fields
    ]
    possible_sides = {name: side_of(run, name, bodies) for name in with_slip}
    side_of_interface = {name: side for name, side in possible_sides.items() if side is not None}
    if not side_of_interface:
        return []
    figure = figures.new(11.0, 4.2 * len(side_of_interface))
    axes = figure.subplots(len(side_of_interface), len(ON_SIDES) * len(VIEWS), squeeze=False)
    for row, (name, (body, triangles)) in zip(axes, side_of_interface.items(), strict=True):
        panels = iter(row)
        for quantity, colours in _on_sides(run, name).items():
            label, unit, factor = INTERFACE[quantity]
            values = factor * lengths(run, f"{name}_{quantity}")
            highest = float(np.percentile(values[triangles], CLIP)) or 1.0
            scale = ScalarMappable(Normalize(0.0, highest), colours)
            colour = scale.to_rgba(values[triangles].mean(axis=1))[:, :3]
            x, views = run.points[triangles], [next(panels) for _ in VIEWS]
            for ax, view in zip(views, VIEWS, strict=True):
                draw_surface(ax, x, x, colour, None, view)
                ax.set_title(view, fontsize=8)
                ax.set_axis_off()
            extend = "max" if values.max() > highest * (1 + 1e-6) else "neither"
            bar = figure.colorbar(
                scale, ax=views, orientation="horizontal", pad=0.02, extend=extend
            )
            largest = "largest mean at a node" if quantity in TRACTIONS else "largest"
            bar.set_label(f"{label} on the {named(body)} ({unit})\n{largest} {values.max():.3g}")
    figures.save_figure(figure, folder / f"{PICTURE_OF_SIDES}.png", 130)
    interface_names = " and ".join(name.replace("_", "-") for name in side_of_interface)
    motions = dict.fromkeys(next(iter(_on_sides(run, name))) for name in side_of_interface)
    motion_words = alternatives([*motions]).capitalize()
    caption = (
        f"{motion_words}, gap and contact pressure at the end, on the inner body of each "
        f"interface. Colours end at the {CLIP:g}th percentile; the labels have the largest values"
        " in the picture, with rim and tip. Pressures are means over the area of a node, at an"
        " edge over all its faces. The maximum in the table is that at a point, and may be larger."
    )
    description = (
        f"{motion_words}, gap and pressure of {interface_names}, drawn on the surface from three"
        " sides."
    )
    return [Figure(f"{PICTURE_OF_SIDES}.png", "", caption, description)]
