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

NAMES = ("regions", "boundaries", "interfaces", "notes")


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
    known = None
    if data is not None:
        names = {name: getattr(data, name) for name in NAMES}
        known = data.cell_tags, data.curved, names
    cell_tags, curved, names = comm.bcast(known)
    corners, width = (10, 6) if curved else (4, 3)
    # The arrays are on rank 0; elsewhere empty ones of the same width.
    points: np.ndarray = np.zeros((0, 3))
    cells: np.ndarray = np.zeros((0, corners), dtype=np.int64)
    facets: np.ndarray = np.zeros((0, width), dtype=np.int64)
    facet_tags: np.ndarray = np.zeros(0, dtype=np.int32)
    if data is not None:
        points, cells, facets, facet_tags = data.points, data.cells, data.facets, data.facet_tags
    cells = cells[:, cell_perm_array(CellType.tetrahedron, corners)].copy()
    facets = facets[:, cell_perm_array(CellType.triangle, width)].copy()
    coordinates = basix.ufl.element(
        basix.ElementFamily.P,
        "tetrahedron",
        2 if curved else 1,
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
    original = mesh.topology.original_cell_index
    regions = meshtags(mesh, 3, np.arange(len(original), dtype=np.int32), cell_tags[original])
    regions.name = "regions"
    local, values = distribute_entity_data(mesh, 2, facets, facet_tags)
    patches = meshtags_from_entities(
        mesh, 2, AdjacencyList_int32(local), values.astype(np.int32, copy=False)
    )
    patches.name = "boundaries"
    return TaggedMesh(mesh, regions, patches, **names)
