"""Volume in which a level function is not negative, and its depth below a surface.

The level function is linear in cells. A count of nodes would change in large steps, because few
cells are across a hot or dead zone.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from app.foundation.arrays import Floats, Ints
from app.heat.heat_forms import HeatForms
from meshes.nearest_facets import distance_from_triangles

# Corners of the edges and of the faces of a tetrahedron.
_EDGES = np.array([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)])
_FACES = np.array([(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)])


class RegionCells:
    """Cells of a region that this rank owns."""

    def __init__(self, forms: HeatForms, region: str) -> None:
        self._comm = forms.comm
        self._dofs = forms.space.dofmap.list[forms.cells(region)].astype(np.int64)
        self._x = forms.space.tabulate_dof_coordinates()[self._dofs]
        volume = np.abs(np.linalg.det(self._x[:, 1:] - self._x[:, :1])) / 6
        corner_volume, exact_volume = self._comm.allreduce(
            np.array([volume.sum(), forms.volumes(region).sum()]), MPI.SUM
        )
        # Curved cells have a little more than their corners span.
        self._volume = volume * (exact_volume / corner_volume)
        self._spread = fem.Function(forms.space)

    def _at_corners(self, dof: Ints, values: Floats, outside_value: float) -> Floats:
        """Return values of owned nodes at corners of cells (m, 4); others are ``outside_value``."""
        self._spread.x.array[:] = outside_value
        self._spread.x.array[dof] = values
        self._spread.x.scatter_forward()
        return np.asarray(self._spread.x.array[self._dofs])

    def faces(self, dof: Ints) -> Floats:
        """Return faces with owned nodes as corners (f, 3, 3) [mm], on every rank; collective."""
        is_on_nodes = self._at_corners(dof, np.ones(len(dof)), 0.0)[:, _FACES].all(axis=2)
        return np.concatenate(self._comm.allgather(self._x[:, _FACES][is_on_nodes]))

    def volume(self, dof: Ints, level: Floats) -> float:
        """Return the volume with a level (n,), at owned nodes, of at least 0 [mm3]; collective."""
        volume_fraction = positive_fraction(self._at_corners(dof, level, -1.0))
        return float(self._comm.allreduce(float(self._volume @ volume_fraction), MPI.SUM))

    def depth(self, dof: Ints, level: Floats, surface: Floats) -> float:
        """Return the depth to which a level (n,) at owned nodes is not negative [mm]; collective.

        The depth is the distance from the triangles of a surface (f, 3, 3) [mm], at least one.
        """
        corner_levels = self._at_corners(dof, level, -1.0)
        depth = 0.0
        end_levels, x = corner_levels[:, _EDGES], self._x[:, _EDGES]
        # Points at which edges leave the volume.
        is_cut = (end_levels.max(axis=2) >= 0) & (end_levels.min(axis=2) < 0)
        (a, b), (first_end, second_end) = end_levels[is_cut].T, x[is_cut].swapaxes(0, 1)
        points = first_end + (a / (a - b))[:, None] * (second_end - first_end)
        points = np.concatenate([points, self._x[corner_levels >= 0]])
        if len(points):
            depth = float(distance_from_triangles(np.unique(points, axis=0), surface).max())
        return float(self._comm.allreduce(depth, MPI.MAX))


def positive_fraction(f: Floats) -> Floats:
    """Return the fraction (m,) of tetrahedra in which a linear f (m, 4) is not negative.

    A plane that separates one corner from three cuts off a tetrahedron: its fraction is the product
    of those of the three edges. Between two pairs of corners, the wedge is the sum of three
    tetrahedra.
    """
    f = -np.sort(-f, axis=1)
    a, b, c, d = f.T
    count = (f >= 0).sum(axis=1)

    def cut(high: Floats, low: Floats, mask: NDArray[np.bool_]) -> Floats:
        """Return the fraction of an edge from its higher end to the zero."""
        return np.divide(high, high - low, out=np.zeros_like(high), where=mask & (high > low))

    fraction = np.where(count == 4, 1.0, 0.0)
    one_positive, two_positive, three_positive = (count == n for n in (1, 2, 3))
    fraction += np.where(
        one_positive,
        cut(a, b, one_positive) * cut(a, c, one_positive) * cut(a, d, one_positive),
        0.0,
    )
    ac = cut(a, c, two_positive)
    ad = cut(a, d, two_positive)
    bc = cut(b, c, two_positive)
    bd = cut(b, d, two_positive)
    fraction += np.where(two_positive, ac * ad + ac * (1 - ad) * bd + (1 - ac) * bc * bd, 0.0)
    negative_fraction = (
        (1 - cut(a, d, three_positive))
        * (1 - cut(b, d, three_positive))
        * (1 - cut(c, d, three_positive))
    )
    return np.asarray(fraction + np.where(three_positive, 1 - negative_fraction, 0.0))
