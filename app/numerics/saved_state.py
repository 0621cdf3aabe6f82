"""Saved state of a run: plain values, and rows of arrays that do not depend on ranks.

A state is a nesting of mappings and lists of what JSON knows, the same on every rank, and of
`Rows`: values that ranks share, each with a key by which any number of ranks finds it again. Keys
come from the numbers of vertices and cells in the mesh file.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import basix
import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from app.arrays import Ints

Array = NDArray[Any]
State = dict[str, Any]

# Vertices of each node of a tetrahedron in basix's order: itself, or the ends of its edge.
ENDS = np.array(
    [*((v, v) for v in range(4)), *basix.topology(basix.CellType.tetrahedron)[1]], dtype=np.int64
)


@dataclass(frozen=True)
class Rows:
    """Values with their keys.

    Attributes:
        keys: One for each row (n,): in a state that was read rising, and those of all ranks.
        values: Rows (n, ...).
    """

    keys: Ints
    values: Array

    def of(self, keys: Ints) -> Array:
        """The rows of some keys, of a state that was read."""
        return np.array(self.values[np.searchsorted(self.keys, keys)])

    def has(self, keys: Ints) -> bool:
        """Whether there is a row for each of some keys, in a state that was read."""
        place = np.minimum(np.searchsorted(self.keys, keys), max(len(self.keys) - 1, 0))
        return not len(keys) or bool(len(self.keys) and (self.keys[place] == keys).all())


def keyed(keys: Ints, values: Array) -> Rows:
    """A copy of values as rows; several to a key where there are more."""
    values = np.array(values)
    return Rows(keys, values if len(values) == len(keys) else values.reshape(len(keys), -1))


def node_keys(space: fem.FunctionSpace) -> Ints:
    """Keys of the own nodes of a space of first or second order (n,): of which vertices it is."""
    geometry, index_map = space.mesh.geometry, space.dofmap.index_map
    dofs = space.dofmap.list
    vertices = geometry.input_global_indices[geometry.dofmap[:, :4]]
    ends = vertices[:, ENDS[: dofs.shape[1]]]
    stride = geometry.index_map().size_global
    keys = np.zeros(index_map.size_local + index_map.num_ghosts, dtype=np.int64)
    keys[dofs] = ends.min(axis=2) * stride + ends.max(axis=2)
    return keys[: index_map.size_local]
