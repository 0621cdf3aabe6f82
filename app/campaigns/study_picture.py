"""Pictures of a study: error against run time, and quantities over a number that varies."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from app.campaigns.study_results import Measured, Report, exponent_text
from app.campaigns.work_precision import NOT_CONVERGING
from app.case.number_text import with_brackets
from app.case.quantities import label_and_unit, label_with_unit
from app.foundation.layout import percent
from app.plots import curves, figures, labels
from app.plots.curves import Line
from app.plots.figures import PNG

# Files of errors against time, and of quantities over a number that varies.
PICTURE_FILES = ("study.png", "study_parameters.png")
# Largest number of panels in a picture.
MOST_PANELS = 6
# Entries of the legend in a row.
ENTRIES = 5
# Error that is drawn in place of zero [-].
EXACT = 1e-16


def draw(report: Report, folder: Path) -> list[str]:
    """Draw the first `MOST_PANELS` quantities of each kind; return the names of the files."""
    compared = [m for m in report.quantities if m.compared][:MOST_PANELS]
    columns = 2 if len(compared) in (1, 2, 4) else 3
    panel_names = []
    if compared:
        _draw(
            folder / PICTURE_FILES[0], compared, partial(_against_time, report), columns, (5.2, 4.2)
        )
        panel_names.append(PICTURE_FILES[0])
    lines = varying_lines(report)
    if lines:
        shown_quantities = report.quantities[:MOST_PANELS]
        _draw(
            folder / PICTURE_FILES[1],
            shown_quantities,
            partial(_over_number, report, lines),
            2,
            (4.6, 2.9),
        )
        panel_names.append(PICTURE_FILES[1])
    return panel_names


def varying_lines(report: Report) -> dict[str, list[int]]:
    """Lines that vary a number other than the mesh size, with the indices of their runs."""
    by_line: dict[str, list[int]] = {}
    for i, run in enumerate(report.runs):
        by_line.setdefault(run.line, []).append(i)
    varying = {}
    for name, indices in by_line.items():
        runs = [report.runs[i] for i in indices]
        if all(run.x and not run.key.startswith("mesh.") for run in runs):
            varying[name] = indices
    return varying


def _draw(
    path: Path,
    shown_quantities: Sequence[Measured],
    panel: Callable[[Axes, Measured], None],
    columns: int,
    size: tuple[float, float],
) -> None:
    figure, all_axes = figures.figure_of_panels(len(shown_quantities), columns, *size)
    for axes, m in zip(all_axes, shown_quantities, strict=True):
        figures.grid(axes)
        panel(axes, m)
    figures.legend_below(figure, ENTRIES, last=curves.FAILED_ENTRY)
    figure.draw_without_rendering()  # so that the axes have their final positions
    for axes in all_axes:
        labels.place_labels(axes)
    figures.save_figure(figure, path, 130, PNG)


def _against_time(report: Report, axes: Axes, m: Measured) -> None:
    figures.set_title(axes, label_and_unit(m.name)[0])
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
    if m.front:  # drawn as steps: the least error up to a time
        times = [report.runs[i].time or 0.0 for i in m.front]
        curves.front(axes, times, [error[i] or EXACT for i in m.front], "Pareto front")
    _limits(axes, report, error)
    curves.level(axes, report.target, f"target {percent(report.target)}")
    if m.uncertainty:
        curves.draw_band(axes, axes.get_ylim()[0], m.uncertainty, "uncertainty of the reference")
    if all(e is None for e in error):
        curves.remark(axes, "no known error")


def _line(
    axes: Axes, report: Report, m: Measured, error: list[float | None], name: str, k: int
) -> None:
    """Draw the k-th line with labels, failed runs as crosses at the top, orders at the bottom."""
    line_title = name.replace("_", " ")
    indices = [i for i, r in enumerate(report.runs) if r.line == name]
    known_points = {}
    for i in indices:
        e = error[i]
        time = report.runs[i].time
        if e is not None and time is not None:
            known_points[i] = (time, e)
    times = [time for time, _ in known_points.values()]
    errors = [e for _, e in known_points.values()]
    curves.draw_line(axes, Line(line_title, k, times, errors))
    labels.label(axes, [report.runs[i].label for i in known_points], times, errors, k)
    for i, (time, e) in known_points.items():
        if not m.points[i].trusted:
            curves.hollow(axes, time, e, k)
    order_text = exponent_text(report, m, name)
    if order_text:
        letter = "h" if report.runs[indices[0]].key == "mesh.size" else "x"
        order = order_text if order_text == NOT_CONVERGING else rf"$\sim {letter}^{{{order_text}}}$"
        row = 0.02 + 0.055 * (len(m.exponents) - 1 - k)
        order_text = f"{line_title}: {order}"
        colour = figures.colour(k)
        axes.text(0.02, row, order_text, transform=axes.transAxes, color=colour, fontsize=8)
    failed_times = []
    for i in indices:
        result = report.runs[i].result
        if result.exit_code:
            failed_times.append(max(result.seconds, 1e-2))
    curves.crosses(axes, failed_times, k, 0.97)


def _limits(axes: Axes, report: Report, error: list[float | None]) -> None:
    """Set limits of at least a decade of error, with room for labels, crosses and orders."""
    known_errors = [report.target, *(e for e in error if e is not None)]
    lowest, highest = min(known_errors), max(*known_errors, 10 * min(known_errors))
    room = (highest / lowest) ** 0.12
    axes.set_ylim(lowest / room**3, highest * room)
    times = [max(r.time or r.result.seconds, 1e-2) for r in report.runs]
    room = max(max(times) / min(times), 10.0) ** 0.1
    axes.set_xlim(min(times) / room, max(times) * room)


def _over_number(report: Report, lines: dict[str, list[int]], axes: Axes, m: Measured) -> None:
    factor = m.quantity.factor
    figures.set_title(axes, label_with_unit(m.name))
    axes.set(xscale="log", xlabel=_label(report, lines))
    drawn_rows = []
    if m.reference is not None:
        value = factor * m.reference.value
        drawn_rows.append(value)
        away = report.target * abs(value)
        label = f"reference ± {percent(report.target)}"
        curves.draw_band(axes, value - away, value + away, label)
    for k, (name, indices) in enumerate(lines.items()):
        values = {i: m.points[i].value for i in indices}
        known_values = {i: factor * v for i, v in values.items() if v is not None}
        drawn_rows += known_values.values()
        x = [report.runs[i].x or 0.0 for i in known_values]
        curves.draw_line(axes, Line(name.replace("_", " "), k, x, list(known_values.values())))
        failed_places = [
            report.runs[i].x or 0.0 for i in indices if report.runs[i].result.exit_code
        ]
        # The crosses of each line have another height: two lines may fail at the same number.
        curves.crosses(axes, failed_places, k, 0.93 - 0.08 * k)
    curves.span_decades(axes, drawn_rows)


def _label(report: Report, lines: dict[str, list[int]]) -> str:
    """Names and units of the varied numbers: ``penalty, augmentation (MPa/mm)``."""
    levels_of_key: dict[str, dict[str, None]] = {}
    for indices in lines.values():
        first_run = report.runs[indices[0]]
        levels_of_key.setdefault(first_run.unit, {})[re.sub(r".*\.", "", first_run.key)] = None
    labels_by_unit = []
    for unit, names_of_unit in levels_of_key.items():
        label = ", ".join(names_of_unit)
        labels_by_unit.append(with_brackets(label, unit))
    return ", ".join(labels_by_unit)
