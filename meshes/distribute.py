"""From arrays on rank 0 to a dolfinx mesh on all ranks."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from mpi4py import MPI

import dolfinx
import numpy as np
from dolfinx.graph import adjacencylist
from dolfinx.io.utils import distribute_entity_data
from dolfinx.mesh import CellType, GhostMode, MeshTags, meshtags, meshtags_from_entities

from app.foundation import dolfinx_features
from app.foundation.dolfinx_features import cell_perm_array, ufl_mesh
from meshes.data import MeshData

THREADS = "SCOTCH_PTHREAD_NUMBER"
ARRAYS = ("points", "cells", "facets", "facet_tags")  # that the other ranks get by parts


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
    without = {name: getattr(data, name)[:0] for name in ARRAYS} if data is not None else {}
    known: MeshData = comm.bcast(data and replace(data, behind=None, **without))
    own = known if data is None else data
    corners, width = own.cells.shape[1], own.facets.shape[1]
    given = os.environ.get(THREADS)
    os.environ[THREADS] = given or "1"  # several part a mesh in another way each time
    try:
        mesh = dolfinx.mesh.create_mesh(
            comm,
            own.cells[:, cell_perm_array(CellType.tetrahedron, corners)].copy(),
            x=own.points,
            e=ufl_mesh(11 if own.curved else 4, 3, np.float64),
            partitioner=dolfinx_features.partitioner(GhostMode.shared_facet),
        )
    finally:
        if given is None:
            del os.environ[THREADS]
    mesh.topology.create_connectivity(3, 0)
    mesh.topology.create_entities(2)
    mesh.topology.create_connectivity(2, 3)
    original = mesh.topology.original_cell_index
    cells = np.arange(len(original), dtype=np.int32)
    regions = meshtags(mesh, 3, cells, known.cell_tags[original])
    regions.name = "regions"
    facets = own.facets[:, cell_perm_array(CellType.triangle, width)].copy()
    local, values = distribute_entity_data(mesh, 2, facets, own.facet_tags)
    patches = meshtags_from_entities(
        mesh, 2, adjacencylist(local), values.astype(np.int32, copy=False)
    )
    patches.name = "boundaries"
    names = (known.regions, known.boundaries, known.interfaces, known.notes)
    return TaggedMesh(mesh, regions, patches, *names)
