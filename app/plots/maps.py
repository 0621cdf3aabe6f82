"""Maps: values on triangles in the plane, and one path around many polygons."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from matplotlib.path import Path as Outline
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import KDTree

from app.foundation.arrays import Bools, Floats

# Pixels of a shaded surface along both axes.
PIXELS = 500
# Decimals to which the places of equal corners agree [mm or degrees].
DIGITS_OF_CORNERS = 6


class Interpolation:
    """Values on a surface in the plane, linear between the corners of its triangles.

    Args:
        x: Corners of the triangles (m, 3, 2), in any unit along each axis.
        values: Values there (m, 3), or of several fields (m, 3, k).

    Attributes:
        corners: Corners of the triangles that have an area, all in the same sense (k, 3, 2).
        places: Different places of the corners (n, 2).
        unit: Unit of length along each axis (2,): the mean extent of an edge.
    """

    def __init__(self, x: Floats, values: Floats) -> None:
        a = x[:, 1] - x[:, 0]
        b = x[:, 2] - x[:, 0]
        doubled_area = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        has_area = np.abs(doubled_area) > 1e-9
        self.corners = np.where(doubled_area[:, None, None] < 0, x[:, ::-1], x)[has_area]
        corner_places = np.round(x[has_area].reshape(-1, 2), DIGITS_OF_CORNERS)
        self.places, first_rows = np.unique(corner_places, axis=0, return_index=True)
        edges = self.corners - np.roll(self.corners, 1, axis=1)
        self.unit = np.abs(edges).mean(axis=(0, 1))
        at_places = values[has_area].reshape(-1, *values.shape[2:])[first_rows]
        self._between = LinearNDInterpolator(self.places / self.unit, at_places)

    def __call__(self, places: Floats) -> Floats:
        """Values at places (..., 2): (...) or (..., k); nan outside of the convex hull."""
        return np.asarray(self._between(places / self.unit))

    def on_surface(self, places: Floats) -> Bools:
        """True at places (..., 2) that are on the surface, to the length of an edge (...)."""
        distance, _ = KDTree(self.places / self.unit).query(places / self.unit)
        return np.asarray(distance) < 1.0


def shaded(
    axes: Axes, x: Floats, values: Floats, colours: str, limits: tuple[float, float]
) -> AxesImage:
    """Shade a surface in the plane, of triangles with corners (m, 3, 2), by values there (m, 3).

    Values are linear between the corners. They are drawn as an image: where triangles are thin,
    matplotlib's shading of triangles draws streaks.
    """
    surface = Interpolation(x, values)
    lowest = surface.places.min(axis=0)
    highest = surface.places.max(axis=0)
    pixels = (np.arange(PIXELS) + 0.5) / PIXELS
    x_pixels, y_pixels = (lowest + pixels[:, None] * (highest - lowest)).T
    image = axes.imshow(
        surface(np.stack(np.meshgrid(x_pixels, y_pixels), axis=-1)),
        cmap=colours,
        vmin=limits[0],
        vmax=limits[1],
        extent=(lowest[0], highest[0], lowest[1], highest[1]),
        origin="lower",
        aspect=axes.get_aspect(),
        interpolation="bilinear",
    )
    image.set_clip_path(joined([surface.corners]), axes.transData)
    return image


def joined(polygons: Sequence[Floats]) -> Outline:
    """Return one path around all polygons (n, corners, 2).

    It is faster to draw than n paths, and has no seams. All polygons are turned the same way, as
    those turned otherwise would be holes.
    """
    outlines = []
    for x in polygons:
        next_corner = np.roll(x, -1, axis=1)
        area = (x[..., 0] * next_corner[..., 1] - x[..., 1] * next_corner[..., 0]).sum(axis=1)
        counterclockwise = np.where(area[:, None, None] < 0, x[:, ::-1], x)
        closed = np.concatenate([counterclockwise, counterclockwise[:, :1]], axis=1)
        path_codes = [Outline.MOVETO, *[Outline.LINETO] * (x.shape[1] - 1), Outline.CLOSEPOLY]
        outlines.append(Outline(closed.reshape(-1, 2), path_codes * len(x)))
    return Outline.make_compound_path(*outlines)
