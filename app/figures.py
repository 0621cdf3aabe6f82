"""Figures that need no screen and look alike whatever files of options there are."""

from __future__ import annotations

from typing import Any


def new(width: float, height: float) -> Any:
    """An empty figure, by the object interface.

    Args:
        width: Inches.
        height: Inches.
    """
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    # A file in the working folder, which may be another's, can have it start LaTeX.
    mpl.rcdefaults()
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure
