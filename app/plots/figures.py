"""Style of all pictures: a figure without a screen, colours, markers, grid, legend, files."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Literal

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

# Colours of lines by number; they differ in lightness, too.
COLOURS = ("#1f5fa8", "#d1682c", "#3a8f4d", "#8b4fa0", "#b8922a", "#4d4d4d", "#c2457a", "#2a9d9d")
# Markers of lines by number.
MARKERS = "osD^vP*X"
# Colour maps: of values from zero, of loads and damage, of temperature, of values with a sign.
SEQUENTIAL = "YlGnBu"
LOADED = "YlOrRd"
HEAT_COLOURS = "inferno"
SIGNED = "RdBu"
# Formats of a picture: for pages, for editing, and for papers.
SUFFIXES = (".png", ".svg", ".pdf")
# The format of a picture of the manual.
PNG = SUFFIXES[:1]
# Margin around a figure [inch], so that no letter of a title is cut.
PAD = 0.1
# Height of the legend below panels [inch].
LEGEND = 0.7
# Font size of the title of a panel.
TITLE = 11


def new(width: float, height: float) -> Figure:
    """Return an empty figure of this size [inch] by the object interface."""
    # A file of options in the working folder, which may be another's, can start LaTeX.
    mpl.rcdefaults()
    layout = ConstrainedLayoutEngine(w_pad=PAD, h_pad=PAD)
    figure = Figure(figsize=(width, height), layout=layout)
    FigureCanvasAgg(figure)
    return figure


def figure_of_panels(
    number: int, columns: int, width: float, height: float, legend: float = LEGEND
) -> tuple[Figure, list[Axes]]:
    """Return a figure of panels, at most ``columns`` side by side.

    Args:
        number: Number of panels.
        columns: Largest number of panels in a row.
        width: Width of a panel [inch].
        height: Height of a panel [inch].
        legend: Height of the room below the panels [inch].
    """
    columns = min(columns, number)
    rows = math.ceil(number / columns)
    figure = new(width * columns, height * rows + legend)
    all_axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in all_axes[number:]:
        axes.set_visible(False)
    return figure, list(all_axes[:number])


def set_title(axes: Axes, text: str) -> None:
    """Write the title of a panel."""
    axes.set_title(text, fontsize=TITLE, loc="left")


def grid(axes: Axes, axis: Literal["both", "x", "y"] = "both") -> None:
    """Draw a light grid behind the data, along both axes or one."""
    axes.grid(True, which="major", axis=axis, color="0.9")
    axes.set_axisbelow(True)


def colour(k: int) -> str:
    """Return the colour of the k-th line."""
    return COLOURS[k % len(COLOURS)]


def marker(k: int) -> str:
    """Return the marker of the k-th line."""
    return MARKERS[k % len(MARKERS)]


def handles(every: Iterable[Axes]) -> dict[str, Artist]:
    """Return the legend handles of several panels, by label."""
    by_label: dict[str, Artist] = {}
    for axes in every:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            by_label.setdefault(label, handle)
    return by_label


def legend_below(figure: Figure, columns: int, last: str = "") -> None:
    """Draw one legend for all panels below them; the entry ``last`` comes last."""
    entries = handles(figure.axes)
    if last in entries:
        entries[last] = entries.pop(last)
    if entries:
        figure.legend(
            list(entries.values()),
            list(entries),
            loc="outside lower center",
            ncols=max(1, min(columns, len(entries))),
            frameon=False,
            fontsize=9,
        )


def save_figure(
    figure: Figure, path: Path, dpi: int, suffixes: Sequence[str] = SUFFIXES
) -> list[Path]:
    """Write a figure in each format, in place of the suffix of a path; return the files."""
    files = [path.with_suffix(suffix) for suffix in suffixes]
    for file in files:
        figure.savefig(file, dpi=dpi)
        # The layout is computed once: it takes longer than drawing.
        figure.set_layout_engine("none")
    return files
