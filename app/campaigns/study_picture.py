"""Pictures of a study: error against run time, and quantities over a number that varies."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from app.campaigns.study_report import Measured, Report, exponent_text
from app.campaigns.work_precision import NOT_CONVERGING
from app.case.quantities import in_words, titled
from app.plots import curves, figures
from app.plots.figures import COLOURS, MARKERS
from app.system.layout import percent

NAMES = ("study.png", "study_parameters.png")
MOST_PANELS = 6
EXACT = 1e-16  # drawn in place of an error of zero
# Largest over smallest value from which an axis is logarithmic.
DECADES = 30.0
# Values smaller than the largest by this factor are zero to rounding.
ROUNDING = 1e-9
# Sides of a point where its label may stand, the best first: to the right and above is (1, 1).
SIDES = ((1, 1), (1, -1), (-1, -1), (-1, 1), (0, 1), (0, -1), (1, 0), (-1, 0))
# Horizontal alignment of a label by its side: 0, 1 or -1.
ACROSS = ("center", "left", "right")
# Vertical alignment.
ALONG = ("center", "bottom", "top")
# Half the width of a marker [pixels].
MARKER = 5.0


def draw(report: Report, folder: Path) -> list[str]:
    """Draw the first six quantities of each kind; return the names of the files."""
    compared = [m for m in report.quantities if m.compared][:MOST_PANELS]
    columns = 2 if len(compared) in (1, 2, 4) else 3
    found = []
    if compared:
        _draw(folder / NAMES[0], compared, partial(_against_time, report), columns, (5.2, 4.2))
        found.append(NAMES[0])
    lines = varying_lines(report)
    if lines:
        shown = report.quantities[:MOST_PANELS]
        _draw(folder / NAMES[1], shown, partial(_over_number, report, lines), 2, (4.6, 2.9))
        found.append(NAMES[1])
    return found


def varying_lines(report: Report) -> dict[str, list[int]]:
    """Lines that vary a number other than the mesh, with the indices of their runs."""
    runs, lines = report.runs, dict.fromkeys(r.line for r in report.runs)
    found = {name: [i for i, r in enumerate(runs) if r.line == name] for name in lines}
    return {
        name: own
        for name, own in found.items()
        if all(runs[i].x and not runs[i].key.startswith("mesh.") for i in own)
    }


def _draw(
    path: Path,
    shown: Sequence[Measured],
    panel: Callable[[Any, Measured], None],
    columns: int,
    size: tuple[float, float],
) -> None:
    figure, every = figures.panels(len(shown), columns, *size)
    for axes, m in zip(every, shown, strict=True):
        figures.grid(axes)
        panel(axes, m)
    handles = figures.handles(every)
    if "failed" in handles:
        handles["failed"] = handles.pop("failed")  # last
    columns = min(len(handles), 5)
    place = {"loc": "outside lower center", "ncols": columns, "frameon": False}
    figure.legend(handles.values(), handles, **place)
    figure.draw_without_rendering()  # the axes have their places
    for axes in every:
        _place(axes)
    figure.savefig(path, dpi=130)


def _place(axes: Any) -> None:
    """Move the labels of points to where they cover nothing; hide those without room."""
    from matplotlib.text import Annotation
    from matplotlib.transforms import Bbox

    curves = [line.get_transform().transform_path(line.get_path()) for line in axes.lines]
    notes = [text for text in axes.texts if isinstance(text, Annotation)]
    taken = [text.get_window_extent() for text in axes.texts if text not in notes]
    for note in notes:
        at = axes.transData.transform(note.xy)
        taken.append(Bbox.from_extents(*(at - MARKER), *(at + MARKER)))
    for note in notes:
        found = []
        for side, (x, y) in enumerate(SIDES):
            note.set(position=(5 * x, 5 * y), ha=ACROSS[x], va=ALONG[y])
            box = note.get_window_extent()
            outside = len(box.corners()) - axes.bbox.count_contains(box.corners())
            crossed = sum(path.intersects_bbox(box, filled=False) for path in curves)
            found.append((box.count_overlaps(taken) + outside, crossed, side, box))
        covered, _, side, box = min(found)
        x, y = SIDES[side]
        note.set(position=(5 * x, 5 * y), ha=ACROSS[x], va=ALONG[y], visible=not covered)
        taken.append(box)


def _against_time(report: Report, axes: Any, m: Measured) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axes.set_title(in_words(m.name)[0], fontsize=11, loc="left")
    axes.set(xscale="log", yscale="log", xlabel="run time (s)", ylabel="error")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda t, _: f"{t:g}"))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda e, _: f"{100 * e:g} %"))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_minor_formatter(NullFormatter())
    axes.grid(True, which="minor", color="0.96")
    error = [None if e is None else max(e, EXACT) for e in m.errors]
    for k, name in enumerate(m.exponents):
        _line(axes, report, m, error, name, k)
    if m.front:  # as steps: least error reached by a time
        band = {"color": "#f2c14e", "lw": 6, "alpha": 0.55, "zorder": 1, "label": "Pareto front"}
        time = [report.runs[i].time for i in m.front]
        axes.step(time, [error[i] for i in m.front], where="post", **band)
    _limits(axes, report, error)
    target = f"target {percent(report.target)}"
    axes.axhline(report.target, color="0.3", lw=1, ls=(0, (5, 3)), label=target)
    if m.own:
        below = {"color": "0.88", "lw": 0, "zorder": 0.9, "label": "uncertainty of the reference"}
        axes.axhspan(axes.get_ylim()[0], m.own, **below)
    if all(e is None for e in error):
        axes.text(0.5, 0.5, "no known error", transform=axes.transAxes, ha="center", color="0.4")


def _line(
    axes: Any, report: Report, m: Measured, error: list[float | None], name: str, k: int
) -> None:
    """Draw the k-th line with labels; failed runs are crosses at the top, orders at the bottom."""
    from matplotlib.patheffects import withStroke

    colour, marker = COLOURS[k % len(COLOURS)], MARKERS[k % len(MARKERS)]
    own = [i for i, r in enumerate(report.runs) if r.line == name]
    good = {}
    for i in own:
        e = error[i]
        time = report.runs[i].time
        if e is not None and time is not None:
            good[i] = (time, e)
    curves.curve(axes, [t for t, _ in good.values()], [e for _, e in good.values()], k, name)
    halo = [withStroke(linewidth=2.0, foreground="white")]
    look = {"textcoords": "offset points", "fontsize": 7, "path_effects": halo, "zorder": 5}
    for i, at in good.items():
        if not m.points[i].trusted:
            axes.plot(*at, marker, mfc="white", mec=colour, ms=6, zorder=4)
        label = report.runs[i].label
        axes.annotate(label, at, xytext=(5, 5), color=colour, in_layout=False, **look)
    text = exponent_text(report, m, name)
    if text:
        letter = "h" if report.runs[own[0]].key == "mesh.size" else "x"
        order = text if text == NOT_CONVERGING else rf"$\sim {letter}^{{{text}}}$"
        row = 0.02 + 0.055 * (len(m.exponents) - 1 - k)
        told = f"{name.replace('_', ' ')}: {order}"
        axes.text(0.02, row, told, transform=axes.transAxes, color=colour, fontsize=8)
    failed = [r.result for r in (report.runs[i] for i in own) if r.result.exit_code]
    curves.crosses(axes, [max(result.seconds, 1e-2) for result in failed], k, 0.97)


def _limits(axes: Any, report: Report, error: list[float | None]) -> None:
    """Show at least a decade of error, with room for labels, crosses and orders."""
    known = [report.target, *(e for e in error if e is not None)]
    low, high = min(known), max(*known, 10 * min(known))
    room = (high / low) ** 0.12
    axes.set_ylim(low / room**3, high * room)
    times = [max(r.time or r.result.seconds, 1e-2) for r in report.runs]
    room = max(max(times) / min(times), 10.0) ** 0.1
    axes.set_xlim(min(times) / room, max(times) * room)


def _over_number(report: Report, lines: dict[str, list[int]], axes: Any, m: Measured) -> None:
    factor = m.quantity.factor
    axes.set_title(titled(m.name), fontsize=11, loc="left")
    axes.set(xscale="log", xlabel=_label(report, lines))
    drawn = []
    if m.reference is not None:
        value = factor * m.reference.value
        drawn.append(value)
        label, band = f"reference ± {percent(report.target)}", report.target * abs(value)
        axes.axhspan(value - band, value + band, color="0.88", lw=0, zorder=0, label=label)
        axes.axhline(value, color="0.45", lw=1, zorder=1, label=label)
    for k, (name, own) in enumerate(lines.items()):
        values = {i: m.points[i].value for i in own}
        known = {i: factor * v for i, v in values.items() if v is not None}
        drawn += known.values()
        curves.curve(axes, [report.runs[i].x for i in known], list(known.values()), k, name)
        failed = [report.runs[i].x for i in own if report.runs[i].result.exit_code]
        curves.crosses(axes, failed, k, 0.93 - 0.08 * k)  # two lines may fail at the same number
    set_scale(axes, drawn)


def set_scale(axes: Any, values: Sequence[float]) -> None:
    """Make the axis logarithmic where values span decades; zero to rounding is drawn at zero."""
    largest = max(map(abs, values), default=0.0)
    positive = [v for v in values if v > ROUNDING * largest]
    if not positive or min(values) < -ROUNDING * largest or largest < DECADES * min(positive):
        return
    if len(positive) == len(values):
        axes.set_yscale("log")
    else:
        axes.set_yscale("symlog", linthresh=min(positive))
        axes.set_ylim(bottom=-0.3 * min(positive))


def _label(report: Report, lines: dict[str, list[int]]) -> str:
    """Names and units of the varied numbers: ``penalty, augmentation (MPa/mm)``."""
    names: dict[str, dict[str, None]] = {}
    for run in (report.runs[own[0]] for own in lines.values()):
        names.setdefault(run.unit, {})[re.sub(r".*\.", "", run.key)] = None
    return ", ".join(", ".join(n) + (f" ({unit})" if unit else "") for unit, n in names.items())
