"""From arrays on rank 0 to a dolfinx mesh on all ranks."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from mpi4py import MPI

import basix
import basix.ufl
import dolfinx
import numpy as np
import ufl
from dolfinx.cpp.graph import AdjacencyList_int32
from dolfinx.io.gmshio import cell_perm_array
from dolfinx.io.utils import distribute_entity_data
from dolfinx.mesh import CellType, GhostMode, MeshTags, meshtags, meshtags_from_entities

from meshes.data import MeshData

# Several threads part a mesh in another way each time, and the numbers end with other rounding.
os.environ.setdefault("SCOTCH_PTHREAD_NUMBER", "1")


@dataclass(frozen=True)
class TaggedMesh:
    """A distributed mesh; names and notes as in `MeshData`.

    Attributes:
        mesh: Tetrahedra, ghosted across shared facets (interface integrals need both sides).
            ``mesh.geometry.input_global_indices`` are rows of ``MeshData.points``.
        cell_tags: Region of every cell, ghosts included.
        facet_tags: Patch of the tagged exterior facets; a facet carries one tag.
    """

    mesh: dolfinx.mesh.Mesh
    cell_tags: MeshTags
    facet_tags: MeshTags
    regions: Mapping[str, int]
    boundaries: Mapping[str, tuple[int, ...]]
    interfaces: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]]
    notes: Mapping[str, Any] = field(default_factory=dict)


def distribute(data: MeshData | None, comm: MPI.Comm) -> TaggedMesh:
    """Distribute the mesh of rank 0 (None on the others) to all ranks; collective."""
    names = (
        (dict(data.regions), dict(data.boundaries), dict(data.interfaces), data.cells.shape[1])
        if data is not None
        else None
    )
    regions, boundaries, interfaces, nodes = comm.bcast(names, root=0)
    points, cells, cell_tags, facets, facet_tags = _arrays(data, nodes)
    cells = cells[:, cell_perm_array(CellType.tetrahedron, nodes)].copy()
    facets = facets[:, cell_perm_array(CellType.triangle, 3 if nodes == 4 else 6)].copy()
    coordinates = basix.ufl.element(
        basix.ElementFamily.P,
        "tetrahedron",
        1 if nodes == 4 else 2,
        basix.LagrangeVariant.equispaced,
        shape=(3,),
    )
    mesh = dolfinx.mesh.create_mesh(
        comm,
        cells,
        points,
        ufl.Mesh(coordinates),
        dolfinx.mesh.create_cell_partitioner(GhostMode.shared_facet),
    )
    mesh.topology.create_connectivity(3, 0)
    mesh.topology.create_entities(2)
    mesh.topology.create_connectivity(2, 3)
    return TaggedMesh(
        mesh=mesh,
        cell_tags=_cell_tags(mesh, comm.bcast(cell_tags)),
        facet_tags=_tags(mesh, 2, facets, facet_tags, "boundaries"),
        regions=regions,
        boundaries=boundaries,
        interfaces=interfaces,
        notes=comm.bcast(data.notes if data is not None else None),
    )


def _arrays(data: MeshData | None, nodes: int) -> tuple[np.ndarray, ...]:
    """The arrays on rank 0, empty ones of the same width elsewhere."""
    if data is not None:
        return data.points, data.cells, data.cell_tags, data.facets, data.facet_tags
    none = np.zeros(0, dtype=np.int32)
    width = 3 if nodes == 4 else 6
    return (
        np.zeros((0, 3)),
        np.zeros((0, nodes), dtype=np.int64),
        none,
        np.zeros((0, width), dtype=np.int64),
        none,
    )


def _cell_tags(mesh: dolfinx.mesh.Mesh, values: np.ndarray) -> MeshTags:
    """Mesh tags of all cells, ghosts included, from those of the cells of the file."""
    local = mesh.topology.original_cell_index
    tags = meshtags(mesh, 3, np.arange(len(local), dtype=np.int32), values[local])
    tags.name = "regions"
    return tags


def _tags(
    mesh: dolfinx.mesh.Mesh, dim: int, entities: np.ndarray, values: np.ndarray, name: str
) -> MeshTags:
    """Mesh tags from entities given by their input nodes on rank 0."""
    local, local_values = distribute_entity_data(mesh, dim, entities, values)
    tags = meshtags_from_entities(
        mesh, dim, AdjacencyList_int32(local), local_values.astype(np.int32, copy=False)
    )
    tags.name = name
    return tags
