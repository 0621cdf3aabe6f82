"""UFL expressions at points that belong to no mesh: arrays in, arrays out.

A law of `forms` that holds at each point is compiled on a mesh whose cells are the points (a row of
intervals on this rank alone) with one value of each input per cell. They form one row because
dolfinx takes quadratic time to order cells that do not touch.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from mpi4py import MPI

import basix.ufl
import numpy as np
import ufl
from dolfinx import fem, jit
from dolfinx.cpp.fem import create_expression_float64
from dolfinx.mesh import create_mesh
from ufl.algorithms import extract_coefficients
from ufl.core.expr import Expr

from app.arrays import Floats, Ints
from app.numerics import kernel_cache


class Pointwise:
    """Compiled expressions of named inputs at the points of one rank; made collectively.

    Args:
        comm: Communicator on which the expressions are compiled once and shared.
        n: Number of points of this rank.
        sizes: Inputs by name: 1 for a scalar, 3 for a vector.
        build: Returns the expressions, from the inputs by name.
        note: Path of the note of the compiled code (`kernel_cache`); without one the expressions
            are built at every start.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        n: int,
        sizes: Mapping[str, int],
        build: Callable[[dict[str, Expr]], Sequence[Expr]],
        note: Path | None = None,
    ) -> None:
        cells = max(n, 1)
        self._mesh = create_mesh(
            MPI.COMM_SELF,
            np.arange(cells, dtype=np.int64)[:, None] + np.arange(2),
            np.arange(cells + 1, dtype=np.float64).reshape(-1, 1),
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
        found = kernel_cache.find(comm, note)
        if found is None:
            found = self._compile(comm, build)
            kernel_cache.keep(comm, note, found[0])
        kernel, symbol, self._module = found
        ffi = self._module.ffi
        self._expression = create_expression_float64(
            ffi.cast("uintptr_t", ffi.addressof(symbol)),
            [self._inputs[name]._cpp_object for name in kernel.inputs],
            [],
            None,
        )
        self._shapes = kernel.shapes
        self._size = sum(math.prod(shape) for shape in kernel.shapes)

    def _compile(
        self, comm: MPI.Comm, build: Callable[[dict[str, Expr]], Sequence[Expr]]
    ) -> tuple[kernel_cache.Kernel, Any, ModuleType]:
        """Compile all expressions into one kernel, which evaluates common terms once."""
        every = build(dict(self._inputs))
        together = ufl.as_vector([c for e in every for c in _components(e)])
        options = {"scalar_type": np.float64}
        symbol, module, _ = jit.ffcx_jit(comm, (together, np.array([[0.5]])), options)
        used = extract_coefficients(together)
        names = {function: name for name, function in self._inputs.items()}
        kernel = kernel_cache.Kernel(
            module=module.__name__,
            symbol=next(name for name in dir(module.lib) if name.startswith("expression_")),
            inputs=tuple(
                names[used[symbol.original_coefficient_positions[i]]]
                for i in range(symbol.num_coefficients)
            ),
            shapes=tuple(e.ufl_shape for e in every),
        )
        return kernel, symbol, module

    def set(self, rows: Ints | None = None, **values: Floats) -> None:
        """Set inputs, (n,) or (n, size) each, at all points or some rows; others keep theirs."""
        cells = self._cell_of_point if rows is None else self._cell_of_point[rows]
        for name, value in values.items():
            function = self._inputs[name]
            space = function.function_space
            size = space.dofmap.index_map_bs
            array = function.x.array.reshape(-1, size)
            array[space.dofmap.list[cells, 0]] = value.reshape(len(cells), size)

    def __call__(self, rows: Ints | None = None, **values: Floats) -> list[Floats]:
        """Set inputs; return the values of the expressions (n, ...) at all points or some rows."""
        self.set(rows, **values)
        cells = self._cell_of_point if rows is None else self._cell_of_point[rows]
        found = np.zeros((len(cells), self._size))
        if len(cells):
            self._expression.eval(self._mesh._cpp_object, cells, found)
        parts, begin = [], 0
        for shape in self._shapes:
            end = begin + math.prod(shape)
            parts.append(found[:, begin:end].reshape(len(cells), *shape))
            begin = end
        return parts


def _components(e: Expr) -> list[Expr]:
    return [e[i] for i in np.ndindex(*e.ufl_shape)] if e.ufl_shape else [e]
