"""Maps: values on triangles in the plane, and one path around many polygons."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from matplotlib.path import Path as Outline
from scipy.interpolate import LinearNDInterpolator

from app.foundation.arrays import Floats

# Pixels of a shaded surface along both axes.
PIXELS = 500
# Decimals to which the places of equal corners agree [mm or degrees].
DIGITS = 6


def shaded(
    axes: Axes, x: Floats, values: Floats, colours: str, limits: tuple[float, float]
) -> AxesImage:
    """Shade a surface in the plane, of triangles with corners (m, 3, 2), by values there (m, 3).

    Values are linear between the corners. They are drawn as an image: where triangles are thin,
    matplotlib's shading of triangles draws streaks.
    """
    a = x[:, 1] - x[:, 0]
    b = x[:, 2] - x[:, 0]
    doubled = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    solid = np.abs(doubled) > 1e-9
    corners = np.where(doubled[:, None, None] < 0, x[:, ::-1], x)[solid]
    places = np.round(x[solid].reshape(-1, 2), DIGITS)
    places, first = np.unique(places, axis=0, return_index=True)
    # Unit of length along each axis: the mean extent of an edge.
    unit = np.abs(corners - np.roll(corners, 1, axis=1)).mean(axis=(0, 1))
    between = LinearNDInterpolator(places / unit, values[solid].ravel()[first])
    low = places.min(axis=0)
    high = places.max(axis=0)
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


def joined(polygons: Sequence[Floats]) -> Outline:
    """Return one path around all polygons (n, corners, 2).

    It is faster to draw than n paths, and has no seams. All polygons are turned the same way, as
    those turned otherwise would be holes.
    """
    outlines = []
    for x in polygons:
        after = np.roll(x, -1, axis=1)
        area = (x[..., 0] * after[..., 1] - x[..., 1] * after[..., 0]).sum(axis=1)
        turned = np.where(area[:, None, None] < 0, x[:, ::-1], x)
        closed = np.concatenate([turned, turned[:, :1]], axis=1)
        codes = [Outline.MOVETO, *[Outline.LINETO] * (x.shape[1] - 1), Outline.CLOSEPOLY]
        outlines.append(Outline(closed.reshape(-1, 2), codes * len(x)))
    return Outline.make_compound_path(*outlines)
