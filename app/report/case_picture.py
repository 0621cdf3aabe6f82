"""A case in one picture: bodies, contact, supports and loads, from the front and from the side.

Each view shows the outside in pale colours and a section in full colours. A load is an arrow with a
dot at its point of application. The arrow begins at the dot if it points away from the middle of
the model; otherwise it ends there.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from scipy.optimize import isotonic_regression

from app.case.case import Case
from app.foundation.arrays import Floats, Ints
from app.foundation.layout import plain_text
from app.laws.heat_conditions import HeatCondition
from app.laws.supports import AnySupport
from app.plots import figures, sections, surface_views
from app.plots.figures import COLOURS, PNG, handles
from app.plots.surface_views import AXES
from app.soundness import preview
from meshes.data import (
    MeshData,
    cell_volumes,
    exterior_facets,
    interface_facets,
    nodes_of_boundary_facets,
)

# Anatomical names of the negative and positive ends of the axes x, y, z of a femur.
AXIS_ENDS = (("lateral", "medial"), ("posterior", "anterior"), ("distal", "proximal"))
# Colours of loads, supports and heat conditions.
LOAD = "#b2182b"
SUPPORT = "#1b7837"
HEAT_COLOUR = "#d9660a"
# Colour of a shaft that is continued below a scan.
CONTINUED = "#6a3d9a"
# Colours of the interfaces, one after the other.
INTERFACE_COLOURS = tuple(COLOURS[k] for k in (0, 3, 7, 5)) * 9
# Largest height and width of the body [inch].
MAX_HEIGHT = 5.0
MAX_WIDTH = 3.4
# Room on each side of the body [inch].
SIDE_MARGIN = 2.2
# Room above the body, with a title of two lines [inch].
TOP_MARGIN = 2.2
# Room below the body, with a legend of two lines [inch].
BOTTOM_MARGIN = 1.45
# Height of a further line of the title or legend [inch].
LINE_HEIGHT = 0.23
# Letters of a title per inch.
LETTERS_PER_INCH = 9.5
# Entries of the legend per line.
LEGEND_COLUMNS = 2
# Font size of labels and legends: legible where a view is as wide as a phone.
FONT_SIZE = 10
# Letters of a line of a label.
LABEL_LETTERS = 16
# Length of the longest and the shortest arrow [inch].
LONGEST_ARROW = 0.95
SHORTEST_ARROW = 0.35
# Height of a line of a label [inch].
LABEL_LINE_HEIGHT = 0.17
# Distance between labels [inch].
LABEL_SPACING = 0.08
# Distance of labels from the body [inch].
LABEL_DISTANCE = 0.55
# Number of arrows of a pressure.
PRESSURE_ARROWS = 5
# Text, places (n, 3) [mm], and the force of each arrow (n, 3) [N].
Force = tuple[str, Floats, Floats]


@dataclass
class View:
    """A view of the model with its section.

    Attributes:
        ax: Axes of the view.
        across: Number of the coordinate from left to right.
        toward: Number of the coordinate towards the viewer.
        section_at: Coordinate of the section plane along `toward` [mm].
        low: Lowest coordinates of the model (3,) [mm].
        high: Highest coordinates of the model (3,) [mm].
        inch: Length in the model of one inch on paper [mm].
        labels: Text, colour and labelled place (2,) [mm] of each label.
    """

    ax: Axes
    across: int
    toward: int
    section_at: float
    low: Floats
    high: Floats
    inch: float
    labels: list[tuple[str, str, Floats]] = field(default_factory=list)

    def lines(
        self,
        x: Floats,
        colour: str,
        label: str,
        width: float = 2.2,
        style: str = "-",
        alpha: float = 1.0,
    ) -> Floats:
        """Draw the section of triangles (n, 3, 3) [mm]; return the middles of its lines (k, 2)."""
        section_lines = sections.section_lines(x, self.toward, self.section_at)[
            ..., [self.across, 2]
        ]
        lines = LineCollection(
            list(section_lines), colors=colour, lw=width, ls=style, alpha=alpha, label=label
        )
        self.ax.add_collection(lines)
        return section_lines.mean(axis=1)


def draw(case: Case, data: MeshData, path: Path) -> None:
    """Write the PNG of a case on its mesh: two views of equal width, each with its legend."""
    lowest, highest = data.points.min(axis=0), data.points.max(axis=0)
    size, clinical = highest - lowest, case.geometry.has_gruen_zones
    inch = max(size[2] / MAX_HEIGHT, size[:2].max() / MAX_WIDTH)
    view_width = size[:2].max() / inch + 2 * SIDE_MARGIN
    forces = [*_forces(case, data)]
    title = textwrap.wrap(case.title or path.stem, int(LETTERS_PER_INCH * view_width))
    if case.geometry.is_mirrored:
        title += [surface_views.MIRRORED]
    is_continued = case.geometry.continued_below is not None
    more_entries = (bool(case.supports), bool(case.heat), bool(forces), is_continued)
    entry_count = max(len(data.regions), len(case.interfaces) + sum(more_entries))
    more_title = LINE_HEIGHT * max(0, len(title) - 1)
    top = TOP_MARGIN + more_title
    bottom = BOTTOM_MARGIN + LINE_HEIGHT * max(0, math.ceil(entry_count / LEGEND_COLUMNS) - 2)
    picture_height = size[2] / inch + top + bottom
    figure = figures.new(2 * view_width, picture_height)
    figure.set_layout_engine("none")
    outside = exterior_facets(data.cells)
    for k, name in enumerate(surface_views.FRONT_AND_SIDE):
        across, leftward, toward = surface_views.VIEWS[name]
        ax = figure.add_axes((0.5 * k, 0.0, 0.5, 1.0))
        section_at = sections.middle_plane(lowest[toward], highest[toward])
        if case.geometry.is_around_z and lowest[toward] > -1e-6 * size[toward]:
            section_at = lowest[toward] + 1e-6 * size[toward]  # a sector: its plane of symmetry
        view = View(ax, across, toward, section_at, lowest, highest, inch)
        _bodies(view, data, name, *outside)
        _lines(view, case, data)
        _continued(view, case.geometry.continued_below)
        _arrows(view, forces)
        _labels(view)
        _scale(view, AXIS_ENDS if clinical else [("", axis) for axis in AXES])
        view_title = f"from {name if clinical else f'+{AXES[toward]}'}"
        view_title += f", section {AXES[toward]} = {round(section_at, 3):g} mm"
        middle = (lowest + highest)[across] / 2
        ax.text(
            middle,
            highest[2] + (TOP_MARGIN - 1.0) * inch,
            view_title,
            ha="center",
            fontsize=FONT_SIZE,
        )
        half_width = 0.5 * view_width * inch
        x_limits = [middle - half_width, middle + half_width][:: -1 if leftward else 1]
        ax.set(xlim=x_limits, ylim=(lowest[2] - bottom * inch, highest[2] + top * inch))
        ax.set_axis_off()
    write = partial(figure.text, ha="center", va="top", parse_math=False)
    heading = "\n".join([*title, f"{len(data.cells):,} cells"])
    write(0.25, 1 - 0.1 / picture_height, heading, fontsize=12)
    if len(forces) > 1:
        heading = f"{len(forces)} loads, {next(preview.resultant(case), '')}"
        write(
            0.25, 1 - (0.62 + more_title) / picture_height, heading, color=LOAD, fontsize=FONT_SIZE
        )
    other_handles = handles(figure.axes)
    region_labels = [region.replace("_", " ") for region in data.regions]
    bodies = {label: other_handles.pop(label) for label in region_labels}
    for middle, legend_handles in ((0.25, bodies), (0.75, other_handles)):
        figure.legend(
            legend_handles.values(),
            legend_handles,
            loc="lower center",
            bbox_to_anchor=(middle, 0.0),
            ncols=LEGEND_COLUMNS,
            frameon=False,
            fontsize=FONT_SIZE,
        )
    figures.save_figure(figure, path, 110, PNG)


def _bodies(view: View, data: MeshData, name: str, facets: Ints, cells: Ints) -> None:
    """Draw the outside and the section.

    Args:
        view: The view.
        data: The mesh.
        name: Side from which the view looks, as in `surface_views.VIEWS`.
        facets: Nodes of the facets of the outside (n, k).
        cells: Cells of these facets (n,).
    """
    colours = sections.colours_of(data.regions)
    for region, colour in colours.items():
        view.ax.plot([], [], color=colour, lw=7.0, label=region.replace("_", " "))
    pale = 0.5 + 0.5 * np.array([(0, 0, 0), *map(to_rgb, colours.values())])
    x = data.points[facets]
    grey = np.full((len(x), 3), 0.7)
    surface_views.draw_surface(view.ax, x, x[:, :3], pale[data.cell_tags[cells]], grey, name)
    sections.draw_section(view.ax, data, view.toward, view.section_at)


def _lines(view: View, case: Case, data: MeshData) -> None:
    """Draw sections of interfaces, supports and heat conditions."""
    for (name, law), colour in zip(case.interfaces.items(), INTERFACE_COLOURS, strict=False):
        law_text = law.kind
        for (*zone, _), friction in law.frictions.items():
            if zone:
                law_text += f", {zone[-1].replace('_', ' ')} {plain_text(friction)}"
            elif friction:
                law_text += f", friction {plain_text(friction)}"
        triangles_of_interface = [data.points[interface_facets(data, name)[0][:, :3]]]
        triangles_of_interface += [
            _boundary(data, face) for face in case.sliding_boundaries.get(name, ())
        ]
        label = f"{name.replace('_', '-')}: {law_text}"
        style = "-" if law.can_part else "--"
        view.lines(np.concatenate(triangles_of_interface), colour, label, style=style)
    conditions: list[tuple[str, str, str, AnySupport | HeatCondition]] = []
    conditions += [
        ("support", SUPPORT, name, condition) for name, condition in case.supports.items()
    ]
    conditions += [("heat", HEAT_COLOUR, name, condition) for name, condition in case.heat.items()]
    for kind_label, colour, name, condition in conditions:
        facets = _boundary(data, condition.boundary or "")
        middles = view.lines(facets, colour, kind_label, width=4.0, alpha=0.8)
        keys = condition.model_dump(mode="json", exclude_none=True)
        held_values = [f"{k} {plain_text(keys[k])}" for k in ("axis", "x", "y", "z") if k in keys]
        if len(middles):
            outwardness = np.abs(middles - middles.mean(axis=0)) @ (1.0, -0.3)
            label_text = f"{name.replace('_', ' ')}\n{', '.join([keys['kind'], *held_values])}"
            view.labels.append((label_text, colour, middles[outwardness.argmax()]))


def _continued(view: View, level: float | None) -> None:
    """Hatch the part of the bone that is continued below the end of a scan."""
    if level is None:
        return
    x_range = view.low[view.across], view.high[view.across]
    view.ax.fill_between(
        x_range,
        view.low[2],
        level,
        facecolor="none",
        edgecolor=CONTINUED,
        hatch="///",
        lw=0.0,
        label="continued shaft",
    )
    view.ax.plot(x_range, [level, level], color=CONTINUED, ls="--", lw=1.5)
    middle = np.array([0.5 * sum(x_range), level])
    view.labels.append((f"continued below\nz = {level:.0f} mm", CONTINUED, middle))


def _boundary(data: MeshData, name: str) -> Floats:
    """Triangles of a boundary (n, 3, 3) [mm]."""
    return data.points[nodes_of_boundary_facets(data, name)[:, :3]]


def _forces(case: Case, data: MeshData) -> Iterator[Force]:
    """Return the loads at full amplitude, each with its text, places and forces."""
    for name, load in case.loads.items():
        x = _boundary(data, next(iter(load.boundaries), ""))
        area_vectors, places = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]) / 2, x.mean(axis=1)
        facet_sizes = np.linalg.norm(area_vectors, axis=1, keepdims=True)
        label_text = f"{name.replace('_', ' ')}\n"
        history_text = f" × {plain_text(load.history)}" if load.history else ""
        if load.normal_pressure is not None:
            facet_forces = -load.normal_pressure * facet_sizes.sum() * area_vectors / facet_sizes
            yield (
                f"{label_text}{plain_text(load.normal_pressure)} MPa{history_text}",
                places,
                facet_forces,
            )
            continue
        force = load.resultant
        if load.volume_regions is not None:
            regions = load.volume_regions or data.regions
            cells = data.cells[np.isin(data.cell_tags, [data.regions[r] for r in regions])]
            places = data.points[cells[:, :4]].mean(axis=1)
            facet_sizes = cell_volumes(data.points, cells)[:, None]
            force = (facet_sizes * load.density_at(places)).sum(axis=0)
        if force is not None and np.any(force):
            arrow_place = load.point or (facet_sizes * places).sum(axis=0) / facet_sizes.sum()
            label_text += f"{float(f'{np.linalg.norm(force):.3g}'):,g} N{history_text}"
            yield label_text, np.array([arrow_place]), np.array([force])


def _arrows(view: View, forces: Sequence[Force]) -> None:
    """Draw loads as arrows; a pressure is drawn by arrows at some of its facets."""
    plane_axes = [view.across, 2]
    largest = max((np.abs(force[2]).max() for force in forces), default=0.0)
    for label_text, places, force_vectors in forces:
        plane_positions = places[:, view.across]
        rows = np.abs(
            plane_positions[:, None]
            - np.linspace(plane_positions.min(), plane_positions.max(), PRESSURE_ARROWS)
        )
        for row in np.unique(rows.argmin(axis=0)):
            size = np.linalg.norm(force_vectors[row])
            arrow_length = view.inch * max(
                SHORTEST_ARROW, LONGEST_ARROW * math.sqrt(size / largest)
            )
            start_point = places[row, plane_axes]
            step = arrow_length * force_vectors[row, plane_axes] / size
            points_outwards = (2 * places[row] - view.low - view.high) @ force_vectors[row] > 0
            arrow_tail, arrow_head = start_point - step, start_point
            if points_outwards:
                arrow_tail, arrow_head = start_point, start_point + step
            style = {"arrowstyle": "-|>", "color": LOAD, "lw": 1.6, "shrinkA": 0, "shrinkB": 0}
            view.ax.annotate(
                "", (arrow_head[0], arrow_head[1]), (arrow_tail[0], arrow_tail[1]), arrowprops=style
            )
            view.ax.plot(*start_point, "o", color=LOAD, ms=3.5, label="load")
        view.labels.append((label_text, LOAD, arrow_head if points_outwards else arrow_tail))


def _labels(view: View) -> None:
    """Write labels in a column on either side, one above the other, with lines to their places."""
    middle = (view.low + view.high)[view.across] / 2
    for side, box_corner in ((-1, view.low), (1, view.high)):
        by_height = sorted(view.labels, key=lambda label: float(label[2][1]))
        labels = [label for label in by_height if (label[2][0] > middle) == (side > 0)]
        if not labels:
            continue
        wrapped_labels = [_wrapped(label_text) for label_text, *_ in labels]
        x = box_corner[view.across] + side * LABEL_DISTANCE * view.inch
        label_heights = np.array(
            [
                LABEL_LINE_HEIGHT * (1 + label_text.count("\n")) + LABEL_SPACING
                for label_text in wrapped_labels
            ]
        )
        # Heights of the middles of labels that touch, from the first one.
        steps = view.inch * (np.cumsum(label_heights) - label_heights / 2)
        # As near to their places as their heights allow.
        y = np.array([place[1] for *_, place in labels]) - steps
        spread_heights = isotonic_regression(y).x + steps
        # Below the title of the view.
        highest = view.high[2] + (TOP_MARGIN - 1.0 - LABEL_SPACING) * view.inch
        spread_heights -= max(
            0.0, spread_heights[-1] + 0.5 * label_heights[-1] * view.inch - highest
        )
        is_at_right = (side < 0) == view.ax.xaxis_inverted()
        for label_text, (_, colour, place), height in zip(
            wrapped_labels, labels, spread_heights, strict=True
        ):
            line = {"arrowstyle": "-", "color": colour, "lw": 0.6, "relpos": (1 - is_at_right, 0.5)}
            view.ax.annotate(
                label_text,
                (place[0], place[1]),
                (x, height),
                fontsize=FONT_SIZE,
                arrowprops=line,
                va="center",
                ha="left" if is_at_right else "right",
                color=colour,
            )


def _wrapped(label: str) -> str:
    """Break the long lines of a label."""
    lines: list[str] = []
    for line in label.split("\n"):
        lines += textwrap.wrap(line, LABEL_LETTERS)
    return "\n".join(lines)


def _scale(view: View, names: Sequence[tuple[str, str]]) -> None:
    """Draw a bar of a round length, and the names of the axes' ends."""
    width = (view.high - view.low)[view.across]
    size = 10.0 ** math.floor(math.log10(width))
    bar_length = max(size * k for k in (0.2, 0.5, 1, 2, 5) if size * k <= 0.6 * width)
    x, z = (view.low + view.high)[view.across] / 2, view.low[2] - 0.3 * view.inch
    view.ax.plot([x - bar_length / 2, x + bar_length / 2], [z, z], "k", lw=3, solid_capstyle="butt")
    end_names = names[view.across]
    direction = " ← ".join(end_names[::-1]) if view.ax.xaxis_inverted() else " → ".join(end_names)
    view.ax.text(
        x,
        z - 0.1 * view.inch,
        f"{bar_length:g} mm\n{direction}",
        ha="center",
        va="top",
        fontsize=FONT_SIZE,
    )
    label_position = view.low[view.across] - 0.4 * view.inch, view.low[2] + 0.9 * view.inch
    view.ax.text(
        *label_position,
        " → ".join(names[2]),
        ha="center",
        va="center",
        rotation=90,
        fontsize=FONT_SIZE,
    )
