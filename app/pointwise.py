"""UFL expressions at points that belong to no mesh: arrays in, arrays out.

A law of `forms` that holds at every point for itself is compiled on a mesh whose cells are the
points (unconnected intervals on this rank alone) with one value of each input per cell.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from mpi4py import MPI

import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import create_mesh
from numpy.typing import NDArray
from ufl.core.expr import Expr

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Pointwise:
    """Compiled expressions of named inputs at the points of one rank."""

    def __init__(
        self,
        comm: MPI.Comm,
        n: int,
        sizes: Mapping[str, int],
        build: Callable[[dict[str, Expr]], Sequence[Expr]],
    ) -> None:
        """Compile; collective, and a rank without points takes part.

        Args:
            comm: Communicator on which the expressions are compiled once and shared.
            n: Number of points of this rank.
            sizes: Inputs by name: 1 for a scalar, 3 for a vector.
            build: Gives the expressions, from the inputs by name.
        """
        cells = max(n, 1)
        self._mesh = create_mesh(
            MPI.COMM_SELF,
            np.arange(2 * cells, dtype=np.int64).reshape(-1, 2),
            np.arange(2 * cells, dtype=np.float64).reshape(-1, 1),
            ufl.Mesh(basix.ufl.element("Lagrange", "interval", 1, shape=(1,))),
        )
        self._cell_of_point = np.argsort(self._mesh.topology.original_cell_index)[:n]
        self._cell_of_point = self._cell_of_point.astype(np.int32)
        spaces = {
            size: fem.functionspace(self._mesh, ("DG", 0, (size,) if size > 1 else ()))
            for size in sorted(set(sizes.values()))
        }
        self._inputs = {name: fem.Function(spaces[size]) for name, size in sizes.items()}
        for function in self._inputs.values():
            function.x.array[:] = 1
        every = build(dict(self._inputs))
        self._shapes = [e.ufl_shape for e in every]
        # One kernel gives all of them: what they have in common is evaluated once.
        components = [c for e in every for c in _components(e)]
        self._size = len(components)
        self._together = fem.Expression(ufl.as_vector(components), np.array([[0.5]]), comm=comm)

    def set(self, rows: Ints | None = None, **values: Floats) -> None:
        """Set inputs: (n,) or (n, size) each, of the points or of some; others keep theirs."""
        cells = self._cell_of_point if rows is None else self._cell_of_point[rows]
        for name, value in values.items():
            function = self._inputs[name]
            space = function.function_space
            size = space.dofmap.index_map_bs
            array = function.x.array.reshape(-1, size)
            array[space.dofmap.list[cells, 0]] = value.reshape(len(cells), size)

    def __call__(self, rows: Ints | None = None, **values: Floats) -> list[Floats]:
        """Values of the expressions (n, ...), of the points or of some, after setting inputs."""
        self.set(rows, **values)
        cells = self._cell_of_point if rows is None else self._cell_of_point[rows]
        found = np.zeros((len(cells), self._size))
        if len(cells):
            found = self._together.eval(self._mesh, cells).reshape(found.shape)
        parts, begin = [], 0
        for shape in self._shapes:
            end = begin + math.prod(shape)
            parts.append(found[:, begin:end].reshape(len(cells), *shape))
            begin = end
        return parts


def _components(e: Expr) -> list[Expr]:
    """Its scalar components, the last index fastest."""
    return [e[i] for i in np.ndindex(*e.ufl_shape)] if e.ufl_shape else [e]
