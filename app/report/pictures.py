"""Pictures of interfaces: unrolled maps, and the surfaces from three sides without WebGL."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from app import figures
from app.arrays import Floats, Ints
from app.case.case import read_geometry
from app.errors import MantleError
from app.report.page import Figure
from app.report.sweep_results import QUANTITIES, WORDS, SweepResults, SweptCase, named
from app.report.viewer import INTERFACE, lengths, outsides
from app.results import unrolled
from app.results.reading import Run
from app.results.unrolled import MapRow, Sheet

Chosen = list[tuple[str, SweptCase]]
Column = tuple[str, Run, Sheet]

SHOWN = {"gap": "YlGnBu", "slip": "YlGnBu", "motion": "YlGnBu", "pressure": "YlOrRd"}
SIDES = "interfaces"  # name of the picture from three sides
# Directions to the eye and to the right: anterior is +y, medial +x, proximal +z.
VIEWS = {
    "lateral": ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0)),
    "anterior": ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)),
    "medial": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
}
ON_SIDES = {"slip": "viridis", "gap": "viridis", "pressure": "cividis"}
LIGHT = 0.35  # how much darker facets are that are seen from the side


def ends(sweep: SweepResults) -> list[Chosen]:
    """The first and the last case with fields, as one group to draw."""
    done = [c for c in sweep.cases if c.done and (c.folder / "fields.vtkhdf").exists()]
    return [[(c.name, c) for c in (*done[:1], *done[1:][-1:])]] if done else []


def maps(groups: Sequence[Chosen], folder: Path) -> tuple[list[Figure], list[str]]:
    """Draw the maps of each group, a picture for each interface.

    Returns:
        The figures, and reasons for cases without one.
    """
    drawn: list[Figure] = []
    missing: list[str] = []
    for number, group in enumerate(groups, 1):
        opened = []
        for title, case in group:
            if not (case.folder / "fields.vtkhdf").exists():
                missing.append(f"no map of {case.name}: it wrote no fields")
                continue
            try:
                run, geometry = Run(case.folder), read_geometry(case.data, case.folder)
            except (OSError, KeyError, ValueError, MantleError) as error:
                missing.append(f"no map of {case.name}: {str(error).partition(chr(10))[0]}")
                continue
            if geometry:
                opened.append((title, run, geometry))
        for name in dict.fromkeys(name for *_, g in opened for name in g.interface_sides):
            columns = [
                (title, run, sheet)
                for title, run, g in opened
                if name in g.interface_sides
                and (sheet := unrolled.sheet(run, g.kind, g.interface_sides[name], g.region_names))
            ]
            if not columns:
                missing.append(f"no map of {name}: it neither surrounds a stem nor is flat")
                continue
            file = f"map{number}_{name}.png"
            if labels := unrolled.draw(folder / file, columns, _rows(name, columns)):
                drawn.append(_figure(file, name, columns, labels))
    return drawn, missing


def _rows(name: str, columns: Sequence[Column]) -> list[MapRow]:
    rows = []
    for quantity, colours in SHOWN.items():
        unit, factor = QUANTITIES[quantity]
        values = [
            factor * lengths(run, f"{name}_{quantity}") if name in run.contacts else None
            for _, run, _ in columns
        ]
        rows.append(MapRow(f"{WORDS[quantity]} ({unit})", colours, values))
    hottest = [_hottest(run, sheet) for _, run, sheet in columns]
    return [*rows, MapRow("temperature (°C)", "inferno", hottest, False)]


def _hottest(run: Run, sheet: Sheet) -> Floats | None:
    """Temperature [degC] at the written step at which an interface is hottest."""
    steps = [run.temperature(k) for k in range(len(run.times))] if run.hot else []
    return max(steps, key=lambda T: float(T[sheet.nodes].max())) if steps else None


def _figure(file: str, name: str, columns: Sequence[Column], labels: Sequence[str]) -> Figure:
    titles = [title for title, _, _ in columns if title]
    common = "are common to all cases and " if len(columns) > 1 else ""
    caption = f"The colours of a row {common}end at the 99.5th percentile. "
    if all(s.round for _, _, s in columns):
        caption += (
            "Unrolled about the stem's axis, cut open posteriorly; end faces are left out, grey is "
            "beyond the resection."
        )
    if any(label.startswith("temperature") for label in labels):
        caption += " Temperature: of the second body, at the hottest step that was written."
    place = f"{named(name)} interface"
    of, to = (f"{word}{'; '.join(titles)}" if titles else "" for word in (" of ", ": "))
    return Figure(file, place + to, caption, f"{', '.join(labels)} on the {place}{of}")


def sides(run: Run, folder: Path) -> list[Figure]:
    """Draw slip, gap and pressure of every interface on its inner body; nothing without contact."""
    bodies = outsides(run, curved=True)
    found = {name: _side(run, name, bodies) for name in sorted(run.contacts, reverse=True)}
    shown = {name: side for name, side in found.items() if side is not None}
    if not shown:
        return []
    figure = figures.new(10.0, 4.2 * len(shown))
    axes = figure.subplots(len(shown), len(ON_SIDES), squeeze=False)
    for row, (name, (body, triangles)) in zip(axes, shown.items(), strict=True):
        for ax, (quantity, colours) in zip(row, ON_SIDES.items(), strict=True):
            label, unit, factor = INTERFACE[quantity]
            values = factor * lengths(run, f"{name}_{quantity}")
            scale = _three(ax, run.points, triangles, values, colours)
            bar = figure.colorbar(scale, ax=ax, orientation="horizontal", pad=0.02)
            bar.set_label(f"{label} on the {body.replace('_', ' ')} ({unit})")
    for suffix in ("png", "pdf"):
        figure.savefig(folder / f"{SIDES}.{suffix}", dpi=130)
    names = " and ".join(name.replace("_", "-") for name in shown)
    caption = (
        "Net slip in contact, opening and contact pressure at the end, on the inner body of each "
        "interface."
    )
    text = f"Slip, gap and pressure of {names}, drawn on the surface from three sides."
    return [Figure(f"{SIDES}.png", "The interfaces from three sides", caption, text)]


def _side(run: Run, contact: str, bodies: Mapping[str, Ints]) -> tuple[str, Ints] | None:
    """The first body with facets on an interface, and these facets (t, 3)."""
    on = run.at_interface(contact, "status") >= 0
    for body, triangles in bodies.items():
        here = triangles[on[triangles].all(axis=1)]
        if len(here):
            return body, here
    return None


def _three(ax: Any, x: Floats, triangles: Ints, values: Floats, colours: str) -> Any:
    """Draw facets that face the eye on each side, farthest first; return their colours."""
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
