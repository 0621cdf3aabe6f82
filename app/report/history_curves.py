"""Numbers of ``history.csv`` over time: drawings inside a page, and pictures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from app.case.quantities import FACTORS, TABLE, printed
from app.report import page
from app.report.curves import Line, Panel
from app.report.curves import draw as draw_panels
from app.report.page import Blocks
from app.report.sweep_results import Number
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
MARKED = 30  # so many points are marked one by one
WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 340, 216, 52, 18, 24, 40
Rows = Sequence[Mapping[str, str]]


def panels(history: Rows) -> tuple[list[Panel], str]:
    """Panels of the quantities that change, and the label of their x axis."""
    if len(history) < 2:
        return [], ""
    seconds = SECONDS in history[0]
    x = SECONDS if seconds else TIME
    lines: dict[str, dict[str, dict[float, Number]]] = {}
    for column in history[0]:
        place, key, unit = _parts(column)
        if key not in SHOWN or not place or (not key and unit != "degC"):
            continue
        shown = SHOWN[key][1]
        factor = FACTORS[shown] if shown in FACTORS else 1.0
        known = ((float(r[x]), float(r[column] or "nan")) for r in history)
        values = {t: Number(factor * v) for t, v in known if math.isfinite(v)}
        if max((abs(n.value) for n in values.values()), default=0.0) > ROUNDING:
            lines.setdefault(key, {})[place] = values
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
    return found, "time (s)" if seconds else "time (each stage takes 1)"


def _parts(column: str) -> tuple[str, str, str]:
    """Place, key and unit of a column; no place for numbers of the whole run."""
    head, _, unit = column.removesuffix("]").partition(" [")
    place, _, key = head.partition(" ")
    whole = column.startswith(SOLVER) or key in ("balance",)
    return ("" if whole else place), key, unit


def of_solver(history: Rows) -> list[dict[str, float]]:
    """Columns on the solver, by step."""
    own = [c for c in (history[0] if history else ()) if not _parts(c)[0]]
    return [{c: float(f"{float(r[c]):.3g}") for c in own if r[c]} for r in history]


def draw(folder: Path, of: Sequence[Panel], x: str) -> list[Path]:
    """Draw the panels as files, for publications."""
    if not of:
        return []
    draw_panels(folder / "curves.png", of, x, 3)
    return [folder / f"curves.{kind}" for kind in ("png", "svg", "pdf")]


def blocks(of: Sequence[Panel], x: str) -> Blocks:
    """The panels as drawings inside a page."""
    return page.drawings([svg(panel, x) for panel in of])


def svg(panel: Panel, x: str) -> str:
    """A panel as SVG for HTML: no name space, no ids."""
    xs = [t for line in panel.lines for t in line.numbers]
    ys = [n.value for line in panel.lines for n in line.numbers.values()]
    zero = [0.0] if panel.y != "°C" and (min(ys) < 0 or max(ys) > 2 * min(ys)) else []
    across, up = ticks(min(xs), max(xs)), ticks(min(ys + zero), max(ys + zero))
    wide, high = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM
    rows = math.ceil(len(panel.lines) / 2)

    def at(t: float, y: float) -> tuple[float, float]:
        a, b = (t - across[0]) / (across[-1] - across[0]), (y - up[0]) / (up[-1] - up[0])
        return LEFT + wide * a, TOP + high * (1 - b)

    title = f"{panel.title} ({panel.y})" if panel.y else panel.title
    size, bold = f"0 0 {WIDTH} {HEIGHT + 15 * rows}", ' font-size="12" font-weight="600"'
    out = [
        f'<svg viewBox="{size}" font-size="11" role="img" aria-label="{escape(title)}">',
        _text(4, 14, title, more=bold),
        _text(LEFT + wide / 2, TOP + high + 30, x, "middle"),
    ]
    for y in up:
        h = at(across[0], y)[1]
        out.append(f'<path stroke="#dde3e7" d="M{LEFT} {h:.1f}h{wide}"/>')
        out.append(_text(LEFT - 5, h + 4, f"{y:g}", "end"))
    for t in across:
        v = at(t, up[0])[0]
        out.append(f'<path stroke="#dde3e7" d="M{v:.1f} {TOP}v{high}"/>')
        out.append(_text(v, TOP + high + 14, f"{t:g}", "middle"))
    for k, line in enumerate(panel.lines):
        points = [at(t, n.value) for t, n in page.sparse(list(line.numbers.items()))]
        path, stroke = " ".join(f"{a:.1f},{b:.1f}" for a, b in points), f'stroke="{line.colour}"'
        out.append(f'<polyline points="{path}" fill="none" {stroke} stroke-width="1.6"/>')
        if len(points) < MARKED:
            dots = (f'<circle cx="{a:.1f}" cy="{b:.1f}" r="2.6"/>' for a, b in points)
            out.append(f'<g fill="{line.colour}">{"".join(dots)}</g>')
        a, b = LEFT + (k % 2) * wide / 2, HEIGHT + 15 * (k // 2)
        out.append(f'<path d="M{a} {b}h16" {stroke} stroke-width="3"/>')
        out.append(_text(a + 21, b + 4, line.label))
    return "".join([*out, "</svg>"])


def _text(x: float, y: float, words: str, anchor: str = "start", more: str = "") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"{more}>{escape(words)}</text>'


def ticks(low: float, high: float) -> list[float]:
    """Four to eight round numbers that enclose an interval."""
    span = high - low if high - low > 1e-9 * max(abs(low), abs(high)) else max(abs(high), 1.0)
    size = 10.0 ** math.floor(math.log10(span / 4))
    step = next(size * k for k in (1, 2, 5, 10) if span / (size * k) <= 6)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [float(f"{step * k:.12g}") for k in range(first, max(last, first + 1) + 1)]
