r"""Parts of an interface, and fields on its facets.

Borders of the parts are zero lines of level functions, which are linear on each facet. A facet
across a border is cut into pieces. Maxima, percentiles, means, areas and fractions of a part all
use the same pieces, so that a percentile is never above the maximum.

The force of a point over its area is the mean of the traction t, weighted by the shape function of
the point,

.. math:: m_i = \int N_i t \, dA / \int N_i \, dA = (A t)_i .

As a value at the point it is of first order where the gradient of t jumps, and too small at a
maximum. `Surface.sharpened` takes two steps of :math:`t \leftarrow t + m - A t` from t = m towards
the linear field with these means. More steps amplify the noise of the means (docs/verification.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from app.case.hips import ON_CUT
from app.foundation.arrays import Bools, Floats, Ints
from app.interfaces.corners import ContactSurface
from app.results.percentiles import SurfaceField
from meshes.gruen import SHOULDER

# Steps from means towards point values.
STEPS = 2
# Fraction of the area of a point below which one of its faces is a sliver: the force along its
# normal belongs to the surroundings, and over its area it is no pressure.
SLIVER = 0.05
# Fraction of a facet below which a piece is rounding.
ROUNDING_OF_PIECES = 1e-12
# Fraction of an interface below which a part of it is rounding.
LEAST_PART = 1e-6


@dataclass(frozen=True)
class Pieces:
    """Triangles cut out of facets.

    Attributes:
        facet: Facet of each piece (t,).
        corners: Barycentric coordinates of its corners in the facet (t, 3, 3).
    """

    facet: Ints
    corners: Floats

    @property
    def share(self) -> Floats:
        """Fraction of the area of the facet (t,)."""
        a, b, c = np.moveaxis(self.corners, 1, 0)
        return np.asarray(np.abs((a * np.cross(b, c)).sum(axis=1)))

    def values(self, corners: Floats) -> Floats:
        """Linear field at the corners (t, 3, ...) from its values on facets (f, 3, ...)."""
        return np.asarray(np.einsum("tcb,tb...->tc...", self.corners, corners[self.facet]))

    def beyond(self, level: Floats) -> Pieces:
        """Parts of the pieces with a positive level, given at corners of facets (f, 3)."""
        level = self.values(level)
        positive = level > 0
        is_whole = positive.all(axis=1)
        cuts = [(self.facet[is_whole], self.corners[is_whole])]
        for positive_count in (1, 2):
            rows = np.flatnonzero(positive.sum(axis=1) == positive_count)
            # The corner that is the only one on its side comes first.
            lone_corner = np.argmax(positive[rows] == (positive_count == 1), axis=1)
            order = (lone_corner[:, None] + np.arange(3)) % 3
            corner_levels = np.take_along_axis(level[rows], order, axis=1)
            x = np.take_along_axis(self.corners[rows], order[:, :, None], axis=1)
            # Points at which the two edges from this corner cross the border.
            crossing_fraction = corner_levels[:, :1] / (corner_levels[:, :1] - corner_levels[:, 1:])
            p, q = (
                x[:, 0] + crossing_fraction[:, k, None] * (x[:, k + 1] - x[:, 0]) for k in (0, 1)
            )
            if positive_count == 1:
                kept_and_cut = [(x[:, 0], p, q)]
            else:
                kept_and_cut = [(p, x[:, 1], x[:, 2]), (p, x[:, 2], q)]
            cuts += [(self.facet[rows], np.stack(corners, axis=1)) for corners in kept_and_cut]
        facet, barycentric = (np.concatenate(column) for column in zip(*cuts, strict=True))
        pieces = Pieces(facet, barycentric)
        has_area = pieces.share > ROUNDING_OF_PIECES
        return Pieces(facet[has_area], barycentric[has_area])


def pieces_by_part(levels: Mapping[str, Floats], facets: int) -> dict[str, Pieces]:
    """Divide facets into pieces by part.

    Args:
        levels: Level function of each part at the corners of facets (f, 3), not positive in the
            part. Where several are not positive, the first part is taken.
        facets: Number of facets.

    Returns:
        The pieces of each part. The first part, with an empty name, is outside all others.
    """
    remaining = Pieces(np.arange(facets), np.tile(np.eye(3), (facets, 1, 1)))
    pieces = {}
    for part, level in levels.items():
        pieces[part], remaining = remaining.beyond(-level), remaining.beyond(level)
    return {"": remaining} | pieces


def in_parts(
    points: ContactSurface, names: Sequence[str], borders: Mapping[str, Floats]
) -> list[Surface]:
    """Return the surfaces of interfaces in parts; an interface on the neck cut is undivided.

    Args:
        points: Points of all interfaces.
        names: Names of the interfaces.
        borders: Level function of each part, as in `Surface`.
    """
    surfaces = []
    for i, name in enumerate(names):
        surfaces.append(Surface(points, i, {} if name == ON_CUT else borders))
    return surfaces


class Surface:
    """Facets of an interface in parts.

    Attributes:
        points: Mask of its points (n,) among those of all interfaces.
        triangles: Points at the corners of each facet (f, 3).
        corners: Positions of these points (f, 3, 3) [mm].
        area: Area of each facet (f,) [mm2].
        borders: The argument.
        weight: Area of each point within a part (n,) [mm2], by part.

    Args:
        points: Points of all interfaces.
        i: Number of the interface.
        borders: Level function of each part at all points (n,), not positive in the part. Where
            several are not positive, the first part is taken.
    """

    def __init__(self, points: ContactSurface, i: int, borders: Mapping[str, Floats]) -> None:
        self.borders = borders
        self.points: Bools = points.interface == i
        self.triangles: Ints = points.triangles[i]
        x = self.corners = points.x[self.triangles]
        flat_normals = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
        flat_area = np.linalg.norm(flat_normals, axis=1) / 2
        # Curved facets have a little more than their corners span.
        total = points.weight[self.points].sum()
        self.area = flat_area * (total / flat_area.sum()) if len(flat_area) else flat_area
        # Face of the point at each corner to which the facet belongs.
        alignment = np.abs(np.einsum("fi,fcki->fck", flat_normals, points.normals[self.triangles]))
        self._face: Ints = np.argmax(alignment, axis=2)
        self._face_area = self._sums(np.repeat(self.area[:, None] / 3, 3, axis=1))
        levels = {part: level[self.triangles] for part, level in borders.items()}
        self._pieces = pieces_by_part(levels, len(x))
        self._sharp = points.faces[self.triangles].min(axis=1) > 0
        hat_integrals = {part: self._hats(pieces) for part, pieces in self._pieces.items()}
        total = np.maximum(sum(hat_integrals.values()), np.finfo(float).tiny)
        self.weight = {
            part: points.weight * hat_integral / total
            for part, hat_integral in hat_integrals.items()
        }

    @property
    def parts(self) -> list[str]:
        """Names of the reported parts; the part outside all others has an empty name.

        It is always there. The shoulder, which no bone touches, is not reported. A part smaller
        than `LEAST_PART` is rounding at its border, such as the tip of a stem whose end faces a
        void.
        """
        least_area = LEAST_PART * self.area.sum()
        reported_parts = [p for p in self._pieces if p and p != SHOULDER]
        return ["", *(p for p in reported_parts if self.weight[p].sum() > least_area)]

    def _hats(self, pieces: Pieces) -> Floats:
        """Return the integrals of the points' shape functions over pieces (n,) [mm2]."""
        corner_areas = (
            pieces.corners.mean(axis=1) * (self.area[pieces.facet] * pieces.share)[:, None]
        )
        sums = np.bincount(
            self.triangles[pieces.facet].ravel(), corner_areas.ravel(), len(self.points)
        )
        return np.asarray(sums, dtype=float)

    def _at_corners(self, values: Floats) -> Floats:
        """Values at the corners of facets (f, 3) from those of points (n,) or faces (n, 3)."""
        corners = values[self.triangles]
        if values.ndim == 2:
            corners = np.take_along_axis(corners, self._face[:, :, None], axis=2)[:, :, 0]
        return np.asarray(corners)

    def field(self, values: Floats, part: str) -> SurfaceField:
        """Return values at points (n,) or at faces of points (n, 3) as a field on a part."""
        pieces = self._pieces[part]
        area = self.area[pieces.facet] * pieces.share
        corners = pieces.values(self._at_corners(values))
        return SurfaceField(corners, area, pieces.values(self.corners))

    def of_faces(self, values: Floats) -> Floats:
        """Means over the areas of faces (n, 3), from values over the areas of their points (n, 3).

        A face that no facet of this interface belongs to has none. A sliver keeps the value over
        the area of its point.
        """
        area = self._face_area
        over_point = np.where(area > 0, values, 0.0)
        forces = values * area.sum(axis=1, keepdims=True)
        return np.divide(forces, area, where=self._is_wide, out=over_point)

    @property
    def _is_wide(self) -> Bools:
        """True for faces of points (n, 3) that are no slivers, and that the interface has."""
        area = self._face_area
        return np.asarray(area > SLIVER * area.sum(axis=1, keepdims=True))

    def _sums(self, corners: Floats) -> Floats:
        """Sum values at the corners of facets (f, 3) over the facets of each face (n, 3)."""
        node = 3 * self.triangles + self._face
        sums = np.bincount(node.ravel(), corners.ravel(), 3 * len(self.points))
        return np.asarray(sums.reshape(-1, 3))

    def sharpened(self, means: Floats) -> Floats:
        """Return point values (n, 3) at the faces of points from means over their areas (n, 3).

        Values have the sign of their means, and zeros remain. On slivers, and next to a point that
        supports hold, which has no reported traction, the means are returned.
        """
        area = self._face_area
        sharp_sums = self._sums(np.repeat(~self._sharp[:, None], 3, axis=1).astype(float))
        has_smooth_part = self._is_wide & (sharp_sums == 0)
        values = means.copy()
        for _ in range(STEPS):
            corners = self._at_corners(values)
            integrals = self.area[:, None] / 12 * (corners + corners.sum(axis=1, keepdims=True))
            values[has_smooth_part] += (
                means[has_smooth_part]
                - self._sums(integrals)[has_smooth_part] / area[has_smooth_part]
            )
        return np.where(values * means > 0, values, 0.0)
