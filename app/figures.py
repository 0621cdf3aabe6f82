"""Figures without a screen, independent of matplotlib's files of options."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
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


@contextmanager
def options_kept() -> Iterator[None]:
    """Leave matplotlib's options, which `new` sets, to who calls from Python."""
    loaded = sys.modules.get("matplotlib")
    with loaded.rc_context() if loaded else nullcontext():
        yield
    if not loaded and (own := sys.modules.get("matplotlib")):
        own.rc_file_defaults()


def shaded(
    axes: Any,
    x: Floats,
    values: Floats,
    colours: str,
    limits: tuple[float, float],
    least: Floats | float = 1e-9,
) -> tuple[Any, Any, Floats]:
    """Shade triangles of corners (m, 3, 2) by values there (m, 3).

    Those with no more than twice the ``least`` area are left out. Returns the shading, and the
    triangulation with its values.
    """
    from matplotlib.tri import Triangulation

    a, b = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]
    solid = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) > least
    x, values = x[solid], values[solid].ravel()
    x, y = x.reshape(-1, 2).T
    mesh = Triangulation(x, y, np.arange(values.size).reshape(-1, 3))
    low, high = limits
    options = {"shading": "gouraud", "cmap": colours, "vmin": low, "vmax": high}
    return axes.tripcolor(mesh, values, rasterized=True, **options), mesh, values
