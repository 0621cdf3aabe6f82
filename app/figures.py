"""Figures without a screen, independent of matplotlib's files of options."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from app.foundation.arrays import Floats

PIXELS = 500  # of a shaded surface, along both axes
DIGITS = 6  # decimals to which the places of equal corners agree [mm or degrees]
# Formats of every picture: for pages, for editing, and for papers.
SUFFIXES = (".png", ".svg", ".pdf")
PAD = 0.1  # around a figure [inch], so that no letter of a title is cut


def new(width: float, height: float) -> Any:
    """An empty figure of this size [inch], by the object interface."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    # A file in the working folder, which may be another's, can have it start LaTeX.
    mpl.rcdefaults()
    layout = ConstrainedLayoutEngine(w_pad=PAD, h_pad=PAD)
    figure = Figure(figsize=(width, height), layout=layout)
    FigureCanvasAgg(figure)
    return figure


def save(figure: Any, path: Path, dpi: int, suffixes: Sequence[str] = SUFFIXES) -> list[Path]:
    """Write a figure in each format, in place of the suffix of a path; return the files."""
    files = [path.with_suffix(suffix) for suffix in suffixes]
    for file in files:
        figure.savefig(file, dpi=dpi)
        figure.set_layout_engine("none")  # found once: it takes longer than drawing
    return files


def shaded(axes: Any, x: Floats, values: Floats, colours: str, limits: tuple[float, float]) -> Any:
    """Shade a surface in the plane, of triangles with corners (m, 3, 2), by values there (m, 3).

    Values are linear between the corners. They are drawn as an image: where triangles are thin,
    matplotlib's shading of triangles draws streaks.
    """
    from scipy.interpolate import LinearNDInterpolator

    a, b = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]
    doubled = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    solid = np.abs(doubled) > 1e-9
    corners = np.where(doubled[:, None, None] < 0, x[:, ::-1], x)[solid]
    places = np.round(x[solid].reshape(-1, 2), DIGITS)
    places, first = np.unique(places, axis=0, return_index=True)
    # Unit of length along each axis: the mean extent of an edge.
    unit = np.abs(corners - np.roll(corners, 1, axis=1)).mean(axis=(0, 1))
    between = LinearNDInterpolator(places / unit, values[solid].ravel()[first])
    low, high = places.min(axis=0), places.max(axis=0)
    pixels = (np.arange(PIXELS) + 0.5) / PIXELS
    across, up = ((low + pixels[:, None] * (high - low)) / unit).T
    image = axes.imshow(
        between(across[None, :], up[:, None]),
        cmap=colours,
        vmin=limits[0],
        vmax=limits[1],
        extent=(low[0], high[0], low[1], high[1]),
        origin="lower",
        aspect=axes.get_aspect(),
        interpolation="bilinear",
    )
    image.set_clip_path(joined([corners]), axes.transData)
    return image


def joined(polygons: Sequence[Floats]) -> Any:
    """One path around all polygons (n, corners, 2): faster to draw than n, and without seams.

    They are all turned the same way, as those turned otherwise would be holes.
    """
    from matplotlib.path import Path as Outline

    outlines = []
    for x in polygons:
        after = np.roll(x, -1, axis=1)
        area = (x[..., 0] * after[..., 1] - x[..., 1] * after[..., 0]).sum(axis=1)
        turned = np.where(area[:, None, None] < 0, x[:, ::-1], x)
        closed = np.concatenate([turned, turned[:, :1]], axis=1)
        codes = [Outline.MOVETO, *[Outline.LINETO] * (x.shape[1] - 1), Outline.CLOSEPOLY]
        outlines.append(Outline(closed.reshape(-1, 2), codes * len(x)))
    return Outline.make_compound_path(*outlines)
