"""Figures without a screen, independent of matplotlib's files of options."""

from __future__ import annotations

from typing import Any


def new(width: float, height: float) -> Any:
    """An empty figure of this size [inch], by the object interface."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    # A file in the working folder, which may be another's, can have it start LaTeX.
    mpl.rcdefaults()
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure
