"""Curves: panels of lines with errors, as picture files and as drawings inside a page.

A `Panel` says what is drawn. `draw` makes files of it by matplotlib. `drawing` gives it to
`page.html`, which writes it as SVG. Measurements speak for both: ten panels of a page take 0.02 s
and 20 kB by the template, 0.5 s and 140 kB by matplotlib. A page of a short run takes 1 s in all.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar

from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from app.plots import figures
from app.plots.figures import SUFFIXES

# Largest over smallest value from which an automatic axis is logarithmic.
DECADE = 12.0
# Largest over smallest value from which an axis may be logarithmic although values vanish.
DECADES = 30.0
# Values smaller than the largest by this factor are zero to rounding.
ROUNDING_OF_DRAWN_VALUES = 1e-9
# Entry of the legend of crosses.
FAILED_ENTRY = "failed"
# Values below which a quantity in this unit is zero to rounding.
ROUNDED = {"µm": 1e-6, "MPa": 1e-8}
# Unit of an axis that need not contain zero.
CELSIUS = "°C"
# Shift between lines with error bars, as a fraction of the range of x.
SPACE_OF_CURVES = 0.012
# Most values of x that are all written at the axis.
TICKS = 8
# Letters of legend entries that fit below a panel.
LETTERS = 47
# Letters of a line of a title in a page.
TITLE = 46
# Largest number of points of a line in a page.
MOST_POINTS = 400
# Resolution of a picture [dots per inch].
DPI = 120

Look = Literal["curve", "line", "points", "dotted", "pale", "stars", "bars"]
Log = Literal["auto", "", "x", "y", "xy"]
T = TypeVar("T")

# Keyword arguments of matplotlib for a line.
Style = dict[str, Any]
_LOOKS: dict[Look, Style] = {
    "curve": {"ms": 5.5, "lw": 1.6, "zorder": 3},
    "line": {"marker": "", "lw": 1.6, "zorder": 3},
    "points": {"ls": "", "ms": 6.5, "zorder": 3},
    "dotted": {"marker": "", "lw": 1.3, "ls": ":", "zorder": 2},
    "pale": {"alpha": 0.45, "mfc": "white", "ms": 4.5, "lw": 1, "ls": (0, (3, 2)), "zorder": 2},
    "stars": {"marker": "*", "mec": "0.15", "mew": 0.7, "ms": 12, "ls": "", "zorder": 4},
    "bars": {"marker": "_", "color": "0.2", "ls": "", "ms": 22, "mew": 2, "zorder": 2},
}


@dataclass(frozen=True)
class Line:
    """A curve.

    Attributes:
        label: Its name in the legend; empty for a line without entry.
        style: Number of its colour and marker.
        x: Abscissae of its points.
        y: Values there.
        errors: Half lengths of the error bars; empty if there are none.
        look: How the points are joined and marked.
    """

    label: str
    style: int
    x: Sequence[float]
    y: Sequence[float]
    errors: Sequence[float] = ()
    look: Look = "curve"


@dataclass(frozen=True)
class Panel:
    """Axes with curves.

    Attributes:
        title: Text above the axes.
        y: Label of the ordinate; often a unit alone.
        lines: The curves.
        x: Label of the abscissa.
        log: Logarithmic axes; ``auto`` makes the ordinate so if the values span a decade.
        ticks: Values of x with a name, in place of numbers.
        from_rest: True if the abscissa begins at zero.
    """

    title: str
    y: str
    lines: Sequence[Line]
    x: str = ""
    log: Log = "auto"
    ticks: Mapping[float, str] | None = None
    from_rest: bool = False


def draw(
    path: Path,
    panels: Sequence[Panel],
    columns: int,
    size: tuple[float, float] = (4.7, 3.2),
    suffixes: Sequence[str] = SUFFIXES,
) -> list[Path]:
    """Draw panels in rows of some columns with a common legend; return the files.

    Args:
        path: The file, whose suffix is replaced by each of ``suffixes``.
        panels: The panels.
        columns: Largest number of panels in a row.
        size: Width and height of a panel [inch].
        suffixes: Formats.
    """
    figure, all_axes = figures.figure_of_panels(len(panels), columns, *size)
    for axes, panel in zip(all_axes, panels, strict=True):
        draw_panel(axes, panel)
    longest = max((len(label) for label in figures.handles(all_axes)), default=0)
    if len(figures.handles(all_axes)) > 1:
        letters = LETTERS * min(columns, len(panels))
        figures.legend_below(figure, letters // (longest + 8))
    return figures.save_figure(figure, path, DPI, suffixes)


def draw_panel(axes: Axes, panel: Panel) -> None:
    """Draw a panel into axes."""
    figures.set_title(axes, panel.title)
    figures.grid(axes)
    axes.set_xlabel(panel.x)
    axes.set_ylabel(panel.y)
    abscissas = sorted({x for line in panel.lines for x in line.x})
    # Side by side, so that bars of equal numbers can both be seen.
    styles = sorted({line.style for line in panel.lines})
    has_errors = any(map(any, (line.errors for line in panel.lines)))
    spacing = SPACE_OF_CURVES * (abscissas[-1] - abscissas[0]) if has_errors else 0.0
    for line in panel.lines:
        shift = spacing * (styles.index(line.style) - 0.5 * (len(styles) - 1))
        draw_line(axes, line, shift)
    _scale(axes, panel)
    if panel.from_rest:
        axes.set_xlim(left=0.0)
    if panel.ticks:
        axes.set_xticks(list(panel.ticks), list(panel.ticks.values()), fontsize=8)
    elif not abscissas:
        remark(axes, "no results")
    elif len(abscissas) <= TICKS:
        axes.set_xticks(abscissas, [f"{x:.3g}" for x in abscissas])
        axes.xaxis.minorticks_off()


def draw_line(axes: Axes, line: Line, shift: float = 0.0) -> None:
    """Draw a line, its points moved along x by a shift."""
    style: Style = {
        "color": figures.colour(line.style),
        "marker": figures.marker(line.style),
        "label": line.label or None,
    }
    style |= _LOOKS[line.look]
    x = [x + shift for x in line.x]
    if any(line.errors):
        axes.errorbar(x, line.y, yerr=line.errors, capsize=3, **style)
    else:
        axes.plot(x, line.y, **style)


def _scale(axes: Axes, panel: Panel) -> None:
    """Choose scale and limits of the axes."""
    values = [v for line in panel.lines for v in line.y]
    if "x" in panel.log:
        axes.set_xscale("log")
    if "y" in panel.log and panel.log != "auto":
        axes.set_yscale("log")
        return
    if not values:
        return
    if panel.y in ROUNDED and max(map(abs, values)) < ROUNDED[panel.y]:
        axes.set_ylim(-0.05, 1)
        remark(axes, "zero to rounding")
    elif panel.log == "auto" and min(values) > 0 and max(values) > DECADE * min(values):
        axes.set_yscale("log")
        axes.set_ylabel(f"{panel.y}, log. scale")
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
    elif min(values) >= 0 and CELSIUS not in panel.y:
        # From zero, so that differences within the noise of the mesh look small.
        axes.set_ylim(0, 1.05 * axes.get_ylim()[1])


# Inside a page


class DrawnLine(NamedTuple):
    """A line of a drawing.

    Attributes:
        label: Its entry in the legend; empty for none.
        colour: Its colour.
        points: Abscissa, ordinate, and both ends of the error bar, as fractions of the axes.
    """

    label: str
    colour: str
    points: Sequence[tuple[float, float, float, float]]


@dataclass(frozen=True)
class Drawing:
    """A panel as `page.html` draws it.

    Attributes:
        title: Lines of its title.
        x: Label of the abscissa.
        columns: Columns of the legend.
        lines: The curves.
        across: Ticks of the abscissa: fraction of the axis and text.
        up: Ticks of the ordinate.
    """

    title: Sequence[str]
    x: str
    columns: int
    lines: Sequence[DrawnLine]
    across: Sequence[tuple[float, str]]
    up: Sequence[tuple[float, str]]


def drawing(panel: Panel) -> Drawing:
    """Return a panel for a page; ordinates begin at zero, except temperatures in degrees."""
    abscissas = [x for line in panel.lines for x in line.x]
    ordinates = []
    for line in panel.lines:
        ordinates += [y + sign * e for _, y, e in _points(line) for sign in (-1, 1)]
    if panel.y != CELSIUS:
        ordinates.append(0.0)
    if panel.from_rest:
        abscissas.append(0.0)
    across = ticks(min(abscissas), max(abscissas))
    up = ticks(min(ordinates), max(ordinates))

    def part(v: float, axis_ticks: Sequence[float]) -> float:
        return (v - axis_ticks[0]) / (axis_ticks[-1] - axis_ticks[0])

    lines = []
    for line in panel.lines:
        points = [
            (part(x, across), part(y, up), part(y - e, up), part(y + e, up))
            for x, y, e in sparse(_points(line))
        ]
        lines.append(DrawnLine(line.label, figures.colour(line.style), points))
    return Drawing(
        title=textwrap.wrap(f"{panel.title} ({panel.y})" if panel.y else panel.title, TITLE),
        x=panel.x,
        columns=2 if max(len(line.label) for line in panel.lines) < 18 else 1,
        lines=lines,
        across=[(part(v, across), f"{v:g}") for v in across],
        up=[(part(v, up), f"{v:g}") for v in up],
    )


def _points(line: Line) -> list[tuple[float, float, float]]:
    """Abscissa, value and error of each point."""
    return list(zip(line.x, line.y, line.errors or [0.0] * len(line.x), strict=True))


def sparse(items: Sequence[T]) -> Sequence[T]:
    """Return the first, the last and every n-th item between, so that a page stays small."""
    n = -(-len(items) // MOST_POINTS)
    return items if n < 2 else [*items[:-1:n], items[-1]]


def ticks(low: float, high: float) -> list[float]:
    """Return four to eight round numbers that enclose an interval."""
    span = high - low if high - low > 1e-9 * max(abs(low), abs(high)) else max(abs(high), 1.0)
    size = 10.0 ** math.floor(math.log10(span / 4))
    step = next(size * k for k in (1, 2, 5, 10) if span / (size * k) <= 6)
    first_multiple = math.floor(low / step + 1e-9)
    last_multiple = math.ceil(high / step - 1e-9)
    return [
        float(f"{step * k:.12g}")
        for k in range(first_multiple, max(last_multiple, first_multiple + 1) + 1)
    ]


# Additions to axes


def crosses(axes: Axes, x: Sequence[float], k: int, height: float) -> None:
    """Draw the failed points of the k-th curve at a fraction of the axes' height."""
    axes.plot(
        x,
        [height] * len(x),
        "x",
        transform=axes.get_xaxis_transform(),
        color=figures.colour(k),
        ms=8.5,
        mew=2.1,
        label=FAILED_ENTRY if len(x) else None,
        zorder=5,
    )


def hollow(axes: Axes, x: float, y: float, k: int) -> None:
    """Draw a doubtful point of the k-th curve: its marker is empty."""
    colour = figures.colour(k)
    axes.plot(x, y, figures.marker(k), mfc="white", mec=colour, ms=6, zorder=4)


def front(axes: Axes, x: Sequence[float], y: Sequence[float], label: str) -> None:
    """Draw a broad band of steps behind the curves: the least y that is reached by an x."""
    axes.step(x, y, where="post", color="#f2c14e", lw=6, alpha=0.55, zorder=1, label=label)


def level(axes: Axes, y: float, label: str) -> None:
    """Draw a dashed line at a wanted value."""
    axes.axhline(y, color="0.3", lw=1, ls=(0, (5, 3)), label=label)


def draw_band(axes: Axes, low: float, high: float, label: str) -> None:
    """Draw a grey band of values."""
    axes.axhspan(low, high, color="0.88", lw=0, zorder=0.9, label=label)


def remark(axes: Axes, text: str) -> None:
    """Write a remark into the middle of the axes, where nothing is drawn."""
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", color="0.4")


def span_decades(axes: Axes, values: Sequence[float]) -> None:
    """Make the axis logarithmic where values span decades; zero to rounding is drawn at zero."""
    largest = max(map(abs, values), default=0.0)
    positive = [v for v in values if v > ROUNDING_OF_DRAWN_VALUES * largest]
    if (
        not positive
        or min(values) < -ROUNDING_OF_DRAWN_VALUES * largest
        or largest < DECADES * min(positive)
    ):
        return
    if len(positive) == len(values):
        axes.set_yscale("log")
    else:
        axes.set_yscale("symlog", linthresh=min(positive))
        axes.set_ylim(bottom=-0.3 * min(positive))
