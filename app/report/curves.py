"""Curves of a report: panels of numbers with their errors.

Of sweeps they are pictures; of the history of a run drawings inside its page, and pictures.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from app import figures
from app.case.quantities import FACTORS, STRESSED, TABLE, printed
from app.foundation.arrays import Floats
from app.report import page
from app.report.page import Blocks
from app.report.sweep_results import Number
from app.system import style
from app.system.layout import plain
from app.system.style import COLOURS, MARKERS

# Largest over smallest value from which an axis is logarithmic.
DECADE = 12.0
CURVE = {"ms": 5.5, "lw": 1.6, "capsize": 3, "zorder": 3}
ROUNDED = {"µm": 1e-6, "MPa": 1e-8}  # below which a contact quantity is zero
# Quantities drawn, by key in history.csv: title, unit for people.
_INTERFACE = {
    key: (q.label, q.shown)
    for key, q in TABLE["interfaces"].items()
    if q.history and ((q.headline and not q.exact) or key == "dissipation")
}
SHOWN = {
    "temperature_max": ("highest temperature", "degC"),
    "temperature_max_second": ("highest temperature, second side", "degC"),
    "degree_min": ("least degree of cure", "%"),
    "": ("temperature at probes", "degC"),
    **_INTERFACE,
    "torque_along": ("friction torque along the motion", "N mm"),
    **{f"force.{axis}": (f"force in {axis}", "N") for axis in "xyz"},
    "eccentricity": ("shift of the centre", "um"),
    "subsidence": ("subsidence", "um"),
    "retroversion": ("retroversion", "deg"),
    **{f"displacement.{axis}": (f"displacement in {axis} at probes", "um") for axis in "xyz"},
}
SECONDS, TIME = "seconds [s]", "time [-]"
SOLVER = (SECONDS, TIME, "step", "newton", "krylov", "residual", "augmentation", "wall")
ROUNDING = 1e-9
History = Mapping[str, Floats]


@dataclass(frozen=True)
class Line:
    """A curve of numbers with errors over x, in a numbered style."""

    label: str
    style: int
    numbers: dict[float, Number]


@dataclass(frozen=True)
class Panel:
    """Axes with curves."""

    title: str
    y: str
    lines: Sequence[Line]


def draw(path: Path, panels: Sequence[Panel], x: str, columns: int) -> list[Path]:
    """Draw panels over x in rows of some columns with a common legend: a PNG, an SVG and a PDF."""
    columns = min(columns, len(panels))
    figure, every = style.panels(len(panels), columns, 4.7, 3.2)
    for axes, panel in zip(every, panels, strict=True):
        _draw(axes, panel)
        axes.set_xlabel(x)
    handles = style.handles(every)
    if len(handles) > 1:
        room = 95 * columns // 2 // (max(map(len, handles)) + 8)  # names in a row
        figure.legend(
            handles.values(),
            handles.keys(),
            loc="outside lower center",
            ncols=max(1, min(len(handles), room)),
            frameon=False,
            fontsize=9,
        )
    return figures.save(figure, path, 120)


def _draw(axes: Any, panel: Panel) -> None:
    axes.set_title(panel.title, fontsize=11, loc="left")
    axes.set_ylabel(panel.y)
    style.grid(axes)
    xs = sorted({x for line in panel.lines for x in line.numbers})
    apart = 0.012 * (xs[-1] - xs[0]) if len(xs) > 1 else 0.0
    for k, line in enumerate(panel.lines):
        # Side by side, so that bars of equal numbers can both be seen.
        _line(axes, line, apart * (k - 0.5 * (len(panel.lines) - 1)))
    values = [n.value for of in panel.lines for n in of.numbers.values()]
    if values and panel.y in ROUNDED and max(map(abs, values)) < ROUNDED[panel.y]:
        axes.set_ylim(-0.05, 1)
        axes.text(0.5, 0.5, "zero to rounding", transform=axes.transAxes, ha="center", color="0.4")
    elif values and min(values) > 0 and max(values) > DECADE * min(values):
        from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

        axes.set_yscale("log")
        axes.set_ylabel(f"{panel.y}, log. scale")
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
    elif values and min(values) >= 0 and panel.y != "°C":
        # From zero, so that differences within the noise of the mesh look small.
        axes.set_ylim(0, 1.05 * axes.get_ylim()[1])
    if not xs:
        axes.text(0.5, 0.5, "no results", transform=axes.transAxes, ha="center", color="0.4")
    elif len(xs) < 9:
        axes.set_xticks(xs, [f"{x:g}" for x in xs])


def _line(axes: Any, line: Line, shift: float) -> None:
    own: dict[str, Any] = {"color": COLOURS[line.style % len(COLOURS)], "label": line.label}
    own["marker"] = MARKERS[line.style % len(MARKERS)]
    x, y = [x + shift for x in line.numbers], [n.value for n in line.numbers.values()]
    errors = [n.error or 0.0 for n in line.numbers.values()]
    axes.errorbar(x, y, yerr=errors, **own, **CURVE)


# Of history.csv


def of_history(history: History) -> tuple[list[Panel], str]:
    """Panels of the quantities that change, and the label of their x axis.

    Loads come at no time of a history of heat: then all is drawn over stages.
    """
    seconds = history.get(SECONDS, np.empty(0))
    x = SECONDS if 0 < len(seconds) == len(np.unique(seconds)) else TIME
    times = history.get(x, np.empty(0))
    if len(times) < 2:
        return [], ""
    lines: dict[str, dict[str, dict[float, Number]]] = {}
    for column, values in history.items():
        place, key, unit = _parts(column)
        if key not in SHOWN or not place or (not key and unit != "degC"):
            continue
        shown = SHOWN[key][1]
        factor = FACTORS[shown] if shown in FACTORS else 1.0
        known = np.isfinite(values)
        if np.abs(factor * values[known]).max(initial=0.0) > ROUNDING:
            points = zip(times[known].tolist(), (factor * values[known]).tolist(), strict=True)
            lines.setdefault(key, {})[place] = {t: Number(v) for t, v in points}
    places = list(dict.fromkeys(p for own in lines.values() for p in own))
    found = [
        Panel(
            SHOWN[key][0],
            printed(SHOWN[key][1]),
            [Line(p.replace("_", " "), places.index(p), own) for p, own in lines[key].items()],
        )
        for key in SHOWN
        if key in lines
    ]
    return found, "time (s)" if x == SECONDS else "time (each stage takes 1)"


def of_tension(summary: Mapping[str, Any]) -> list[Panel]:
    """Volume of cement over levels of tension, where any exceeds the first."""
    lines: list[Line] = []
    for region, q in summary.get("regions", {}).items():
        keys = {float(level): f"volume_over_{level}_MPa" for level in STRESSED}
        if q.get(keys[STRESSED[0]]):
            own = {x: Number(q[key], q.get(f"{key}_error")) for x, key in keys.items()}
            lines.append(Line(region, len(lines), own))
    return [Panel("volume over a tension", printed("mm^3"), lines)] if lines else []


def _parts(column: str) -> tuple[str, str, str]:
    """Place, key and unit of a column; no place for numbers of the whole run."""
    head, _, unit = column.removesuffix("]").partition(" [")
    place, _, key = head.partition(" ")
    whole = column.startswith(SOLVER) or key in ("balance",)
    return ("" if whole else place), key, unit


def of_solver(history: History) -> Blocks:
    """A table of the columns on the solver, by step."""
    own = {c: v for c, v in history.items() if not _parts(c)[0] and np.isfinite(v).any()}
    rows = page.sparse([*zip(*own.values(), strict=True)])
    return page.table([*own], [[plain(float(f"{v:.3g}")) for v in row] for row in rows])


def drawing(panel: Panel, x: str, from_zero: bool = False) -> dict[str, Any]:
    """A panel as `page.html` draws it: ticks, points and bars as fractions of the axes."""
    xs = [t for line in panel.lines for t in line.numbers]
    numbers = [n for line in panel.lines for n in line.numbers.values()]
    ys = [n.value + sign * (n.error or 0.0) for n in numbers for sign in (-1, 1)]
    far = from_zero or min(ys) < 0 or max(ys) > 2 * min(ys)
    zero = [0.0] if far and panel.y != "°C" else []
    across, up = ticks(min(xs), max(xs)), ticks(min(ys + zero), max(ys + zero))

    def part(v: float, of: Sequence[float]) -> float:
        return (v - of[0]) / (of[-1] - of[0])

    lines = [
        (
            line.label,
            COLOURS[line.style % len(COLOURS)],
            [
                (part(t, across), *(part(n.value + k * (n.error or 0.0), up) for k in (0, -1, 1)))
                for t, n in page.sparse([*line.numbers.items()])
            ],
        )
        for line in panel.lines
    ]
    return {
        "title": f"{panel.title} ({panel.y})" if panel.y else panel.title,
        "x": x,
        "columns": 2 if max(len(line.label) for line in panel.lines) < 18 else 1,
        "lines": lines,
        "across": [(part(v, across), f"{v:g}") for v in across],
        "up": [(part(v, up), f"{v:g}") for v in up],
    }


def ticks(low: float, high: float) -> list[float]:
    """Four to eight round numbers that enclose an interval."""
    span = high - low if high - low > 1e-9 * max(abs(low), abs(high)) else max(abs(high), 1.0)
    size = 10.0 ** math.floor(math.log10(span / 4))
    step = next(size * k for k in (1, 2, 5, 10) if span / (size * k) <= 6)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [float(f"{step * k:.12g}") for k in range(first, max(last, first + 1) + 1)]
