"""Figures without a screen, independent of matplotlib's files of options."""

from __future__ import annotations

from typing import Any

import numpy as np

from app.arrays import Floats


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


def shaded(axes: Any, x: Floats, values: Floats, colours: str, limits: tuple[float, float]) -> Any:
    """Shade triangles of corners (m, 3, 2) by values there (m, 3); those without area are left."""
    from matplotlib.tri import Triangulation

    a, b = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]
    solid = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) > 1e-9
    x, y = x[solid].reshape(-1, 2).T
    mesh = Triangulation(x, y, np.arange(x.size).reshape(-1, 3))
    options = {"shading": "gouraud", "cmap": colours, "vmin": limits[0], "vmax": limits[1]}
    return axes.tripcolor(mesh, values[solid].ravel(), rasterized=True, **options)
