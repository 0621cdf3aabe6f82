"""The style that all pictures have: size, colours, markers, grid."""

from __future__ import annotations

from typing import Any

COLOURS = ("#1f5fa8", "#d1682c", "#3a8f4d", "#8b4fa0", "#b8922a", "#4d4d4d", "#c2457a", "#2a9d9d")
MARKERS = "osD^vP*X"


def new(width: float, height: float) -> Any:
    """An empty figure that needs no screen.

    Args:
        width: Inches.
        height: Inches.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def grid(axes: Any) -> None:
    """A light grid behind what is drawn."""
    axes.grid(True, which="major", color="0.9")
    axes.set_axisbelow(True)
