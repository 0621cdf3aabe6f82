"""Numbers of ``history.csv`` over time: drawings inside a page, and pictures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from app.arrays import Floats
from app.case.quantities import FACTORS, TABLE, printed
from app.report import page
from app.report.curves import Line, Panel
from app.report.curves import draw as draw_panels
from app.report.page import Blocks
from app.report.sweep_results import Number
from app.system.layout import plain
from app.system.style import COLOURS, MARKERS

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
    **{f"displacement.{axis}": (f"displacement in {axis} at probes", "um") for axis in "xyz"},
}
SECONDS, TIME = "seconds [s]", "time [-]"
SOLVER = (SECONDS, TIME, "step", "newton", "krylov", "residual", "augmentation", "wall")
ROUNDING = 1e-9
History = Mapping[str, Floats]


def panels(history: History) -> tuple[list[Panel], str]:
    """Panels of the quantities that change, and the label of their x axis."""
    x = SECONDS if SECONDS in history else TIME
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
    styles = {p: (COLOURS[k % 8], MARKERS[k % 8]) for k, p in enumerate(places)}
    found = [
        Panel(
            SHOWN[key][0],
            printed(SHOWN[key][1]),
            [Line(p.replace("_", " "), *styles[p], own, {}) for p, own in lines[key].items()],
        )
        for key in SHOWN
        if key in lines
    ]
    return found, "time (s)" if x == SECONDS else "time (each stage takes 1)"


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


def draw(folder: Path, of: Sequence[Panel], x: str) -> list[Path]:
    """Draw the panels as files, for publications."""
    if not of:
        return []
    folder.mkdir(exist_ok=True)
    draw_panels(folder / "curves.png", of, x, 3)
    return [folder / f"curves.{kind}" for kind in ("png", "svg", "pdf")]


def blocks(of: Sequence[Panel], x: str) -> Blocks:
    """The panels as drawings inside a page."""
    return page.drawings([_drawing(panel, x) for panel in of])


def _drawing(panel: Panel, x: str) -> dict[str, Any]:
    """A panel as `page.html` draws it: ticks and points as fractions of the axes."""
    xs = [t for line in panel.lines for t in line.numbers]
    ys = [n.value for line in panel.lines for n in line.numbers.values()]
    zero = [0.0] if panel.y != "°C" and (min(ys) < 0 or max(ys) > 2 * min(ys)) else []
    across, up = ticks(min(xs), max(xs)), ticks(min(ys + zero), max(ys + zero))

    def part(v: float, of: Sequence[float]) -> float:
        return (v - of[0]) / (of[-1] - of[0])

    lines = [
        (
            line.label,
            line.colour,
            [(part(t, across), part(n.value, up)) for t, n in page.sparse([*line.numbers.items()])],
        )
        for line in panel.lines
    ]
    title = f"{panel.title} ({panel.y})" if panel.y else panel.title
    ends = ([(part(v, of), f"{v:g}") for v in of] for of in (across, up))
    return {
        "title": title,
        "x": x,
        "lines": lines,
        **dict(zip(("across", "up"), ends, strict=True)),
    }


def ticks(low: float, high: float) -> list[float]:
    """Four to eight round numbers that enclose an interval."""
    span = high - low if high - low > 1e-9 * max(abs(low), abs(high)) else max(abs(high), 1.0)
    size = 10.0 ** math.floor(math.log10(span / 4))
    step = next(size * k for k in (1, 2, 5, 10) if span / (size * k) <= 6)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [float(f"{step * k:.12g}") for k in range(first, max(last, first + 1) + 1)]
