"""Style of all pictures: size, colours, markers, grid."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from app import figures

COLOURS = ("#1f5fa8", "#d1682c", "#3a8f4d", "#8b4fa0", "#b8922a", "#4d4d4d", "#c2457a", "#2a9d9d")
MARKERS = "osD^vP*X"


def grid(axes: Any, axis: str = "both") -> None:
    """Draw a light grid behind the data, along both axes or one."""
    axes.grid(True, which="major", axis=axis, color="0.9")
    axes.set_axisbelow(True)


def panels(number: int, columns: int, width: float, height: float) -> tuple[Any, list[Any]]:
    """A figure of panels, at most ``columns`` side by side, with room for a legend below.

    ``width`` and ``height`` are those of a panel [inch].
    """
    columns = min(columns, number)
    rows = math.ceil(number / columns)
    figure = figures.new(width * columns, height * rows + 0.7)
    every = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in every[number:]:
        axes.set_visible(False)
    return figure, list(every[:number])


def handles(every: Iterable[Any]) -> dict[str, Any]:
    """Legend handles of several panels, by label."""
    found: dict[str, Any] = {}
    for axes in every:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    return found


def curve(axes: Any, x: Sequence[Any], y: Sequence[Any], k: int, label: str) -> None:
    """Draw the k-th curve; its label, the name of a line, in words."""
    label = label.replace("_", " ")
    colour, marker = COLOURS[k % len(COLOURS)], MARKERS[k % len(MARKERS)]
    axes.plot(x, y, color=colour, marker=marker, ms=5.5, lw=1.5, label=label, zorder=3)


def crosses(axes: Any, x: Sequence[Any], k: int, height: float) -> None:
    """Draw the failed points of the k-th curve at a fraction of the axes' height."""
    axes.plot(
        x,
        [height] * len(x),
        "x",
        transform=axes.get_xaxis_transform(),
        color=COLOURS[k % len(COLOURS)],
        ms=8.5,
        mew=2.1,
        label="failed" if len(x) else None,
        zorder=5,
    )
