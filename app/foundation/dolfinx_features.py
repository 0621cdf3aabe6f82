"""Calls of DOLFINx that differ between 0.9, 0.10 and 0.11; no other module asks for them.

The code tests for a feature (a module, an argument, a kind of attribute), never for a version. A
later release then runs unchanged as long as it keeps the features.

| feature | 0.9 | 0.10 | 0.11 |
|---|---|---|---|
| module that reads meshes of gmsh | `io.gmshio` | `io.gmsh` | `io.gmsh` |
| `compute_integration_domains` has a dimension | yes | no | no |
| points of interpolation are a property | no | yes | yes |
| `create_submesh` returns an object that maps entities | no | yes | yes |
| a compiled expression evaluates itself | yes | no | no |
| a compiled expression takes maps of entities | no | either | yes |
| a partitioner takes the cells that share a facet | no | either | yes |
"""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from mpi4py import MPI  # noqa: F401  (libraries of wheels find MPI by it: it is loaded first)

import numpy as np
from dolfinx import fem, mesh
from dolfinx.cpp import fem as cpp
from numpy.typing import NDArray

from app.foundation.arrays import Floats, Ints

Entities = NDArray[np.int32]


def _takes(function: object, argument: str) -> bool:
    """Return True if a function of DOLFINx, written in Python or in C++, has an argument."""
    if inspect.isfunction(function):
        return argument in inspect.signature(function).parameters
    return f"{argument}:" in (function.__doc__ or "")  # which begins with its signature


gmsh = import_module("dolfinx.io.gmsh" if find_spec("dolfinx.io.gmsh") else "dolfinx.io.gmshio")
cell_perm_array = gmsh.cell_perm_array
ufl_mesh = gmsh.ufl_mesh

# A manifold: two cells share a facet.
_CELLS_OF_A_FACET = (2,) if _takes(mesh.create_cell_partitioner, "max_facet_to_cell_links") else ()
_DIMENSION_OF_FACETS = (2,) if _takes(fem.compute_integration_domains, "dim") else ()
_NO_ENTITY_MAPS: Any = ([],) if _takes(cpp.create_expression_float64, "entity_maps") else ()


def partitioner(ghosts: mesh.GhostMode) -> Any:
    """Partitioner of cells, with ghosts across facets or without."""
    return mesh.create_cell_partitioner(ghosts, *_CELLS_OF_A_FACET)


def facet_domain(kind: fem.IntegralType, topology: mesh.Topology, facets: Entities) -> Entities:
    """Integration entities of owned facets: a cell and a local number for each side, flat."""
    domain = fem.compute_integration_domains(kind, topology, facets, *_DIMENSION_OF_FACETS)
    return np.asarray(domain, dtype=np.int32)


def exterior_facet_entities(topology: mesh.Topology, facets: Entities) -> Entities:
    """Integration entities of owned exterior facets: a cell and a local number each, flat."""
    return facet_domain(fem.IntegralType.exterior_facet, topology, facets)


def interpolation_points(space: fem.FunctionSpace) -> Floats:
    """Points of the reference cell that determine an interpolant (p, 3)."""
    points = space.element.interpolation_points
    return np.asarray(points() if callable(points) else points)


def submesh(domain: mesh.Mesh, dim: int, entities: Entities) -> tuple[Any, Any, Entities, Any]:
    """Submesh of entities of a dimension.

    Returns:
        The submesh; its map as DOLFINx returns it; the entity of the mesh for each of its cells;
        the node of the mesh for each of its nodes.
    """
    part, cell_map, _, nodes = mesh.create_submesh(domain, dim, entities)
    parents = cell_map
    if hasattr(cell_map, "sub_topology_to_topology"):
        cells = part.topology.index_map(dim)
        all_cells = np.arange(cells.size_local + cells.num_ghosts, dtype=np.int32)
        parents = cell_map.sub_topology_to_topology(all_cells, False)
    return part, cell_map, parents, nodes


def entity_maps(parts: Sequence[tuple[mesh.Mesh, Any, Entities]]) -> Any:
    """Argument ``entity_maps`` of a form over a mesh and submeshes of it.

    Args:
        parts: Each submesh, its map by `submesh`, and its cell for each entity of the mesh or -1.
    """
    if all(hasattr(cell_map, "sub_topology_to_topology") for _, cell_map, _ in parts):
        return [cell_map for _, cell_map, _ in parts]
    return {part: inverse for part, _, inverse in parts}


class CompiledExpression:
    """Compiled code of an expression without constants, at one point of each cell.

    Args:
        ffi: Foreign function interface of the compiled module.
        code: Expression in the module.
        coefficients: Functions in the order of the code, as in C++.
    """

    def __init__(self, ffi: Any, code: Any, coefficients: Sequence[object]) -> None:
        self._ffi, self._code, self._expression = ffi, code, None
        if coefficients:
            address = ffi.cast("uintptr_t", ffi.addressof(code))
            arguments = (address, [*coefficients], [], *_NO_ENTITY_MAPS, None)
            self._expression = cpp.create_expression_float64(*arguments)

    def evaluate(self, domain: mesh.Mesh, cells: Ints, values: Floats) -> None:
        """Set the values (n, size) at some cells of a mesh."""
        expression, cpp_mesh = self._expression, domain._cpp_object
        if expression is None:
            values[:] = self._constant(values.shape[1])
        elif hasattr(expression, "eval"):
            expression.eval(cpp_mesh, cells, values)
        else:
            packed = cpp.pack_coefficients(expression, cpp_mesh, cells)
            at_points = values.reshape(len(cells), 1, -1)
            cpp.tabulate_expression(at_points, expression, np.zeros(0), packed, cpp_mesh, cells)

    def _constant(self, size: int) -> Floats:
        """Values (size,) of an expression that depends on nothing.

        Later releases of DOLFINx take the mesh from the coefficients and refuse an expression
        without any. Its code reads none of the other arguments.
        """
        values = np.zeros(size)
        kernel = self._code.tabulate_tensor_float64
        unused_arguments = [self._ffi.NULL] * (len(self._ffi.typeof(kernel).args) - 1)
        kernel(self._ffi.cast("double *", values.ctypes.data), *unused_arguments)
        return values
