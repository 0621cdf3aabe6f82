"""A dolfinx mesh on all ranks with names for its tags, from arrays on rank 0 or given; and back."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from mpi4py import MPI

import dolfinx
import numpy as np
from dolfinx.graph import adjacencylist
from dolfinx.io.utils import distribute_entity_data
from dolfinx.mesh import (
    CellType,
    GhostMode,
    MeshTags,
    locate_entities,
    locate_entities_boundary,
    meshtags,
    meshtags_from_entities,
)

from app.foundation import dolfinx_features
from app.foundation.arrays import Bools, Floats
from app.foundation.dolfinx_features import Entities, cell_perm_array, ufl_mesh
from app.foundation.errors import InputError
from meshes.data import MeshData, faces_of

THREADS = "SCOTCH_PTHREAD_NUMBER"
ARRAYS = ("points", "cells", "facets", "facet_tags")  # that the other ranks get by parts
NO_ENTITIES = np.zeros(0, dtype=np.int32)
MOST_TAGS = 20  # tags that a message lists
# Returns True for points (3, n) [mm] of a part of the mesh.
Marker = Callable[[Floats], Bools]


@dataclass(frozen=True)
class TaggedMesh:
    """A distributed mesh; names and notes as in `MeshData`.

    `from_tags` makes one of a dolfinx mesh with tags, `from_markers` of a dolfinx mesh alone.

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

    @classmethod
    def from_tags(
        cls,
        mesh: dolfinx.mesh.Mesh,
        cell_tags: MeshTags,
        facet_tags: MeshTags,
        regions: Mapping[str, int],
        boundaries: Mapping[str, int | tuple[int, ...]],
    ) -> TaggedMesh:
        """Name the tags of a dolfinx mesh; collective.

        Args:
            mesh: Tetrahedra, ghosted across shared facets as those of `dolfinx.mesh.create_box`.
            cell_tags: Region of every cell, ghosts included.
            facet_tags: Patches of the exterior facets.
            regions: Tag of each region.
            boundaries: Tags of each boundary.

        Raises:
            InputError: The mesh has other cells, cells without a region, or nothing of a name.
        """
        connect(mesh)
        patches = {n: (t,) if isinstance(t, int) else tuple(t) for n, t in boundaries.items()}
        tags_of_regions = {name: (tag,) for name, tag in regions.items()}
        _check_names(mesh.comm, "regions", tags_of_regions, cell_tags)
        _check_names(mesh.comm, "boundaries", patches, facet_tags)
        cells = mesh.topology.index_map(3)
        tagged = np.isin(cell_tags.values, list(regions.values())).sum()
        missing = cells.size_local + cells.num_ghosts - int(tagged)
        if mesh.topology.cell_type != CellType.tetrahedron:
            raise InputError(
                f"cells are of type {mesh.topology.cell_type.name}; expected tetrahedron"
            )
        if mesh.comm.allreduce(missing):
            raise InputError("cells without a region; tag every cell, ghosts too")
        return cls(mesh, cell_tags, facet_tags, dict(regions), patches, {})

    @classmethod
    def from_markers(
        cls,
        mesh: dolfinx.mesh.Mesh,
        regions: Mapping[str, Marker],
        boundaries: Mapping[str, Marker],
    ) -> TaggedMesh:
        """Name parts of a dolfinx mesh by place; collective.

        A marker returns True for points (3, n) [mm]. Cells belong to the first region that has
        all their vertices, and exterior facets to the first such boundary.

        Raises:
            InputError: As `from_tags`.
        """
        connect(mesh)
        cells = [locate_entities(mesh, 3, marker) for marker in regions.values()]
        facets = [locate_entities_boundary(mesh, 2, marker) for marker in boundaries.values()]
        for kind, found_sets in (("regions", cells), ("boundaries", facets)):
            names = regions if kind == "regions" else boundaries
            sizes = [mesh.comm.allreduce(len(found)) for found in found_sets]
            _raise_missing(kind, dict(zip(names, sizes, strict=True)), _extent(mesh))
        numbers = {name: k for k, name in enumerate(regions, 1)}
        patches = {name: k for k, name in enumerate(boundaries, 1)}
        return cls.from_tags(mesh, _tags(mesh, 3, cells), _tags(mesh, 2, facets), numbers, patches)


def _extent(mesh: dolfinx.mesh.Mesh) -> str:
    """Ranges of the coordinates of a mesh, in words; collective."""
    x = mesh.geometry.x
    far = np.full(3, np.inf)
    low = [mesh.comm.allreduce(float(v), MPI.MIN) for v in (x.min(axis=0) if len(x) else far)]
    high = [mesh.comm.allreduce(float(v), MPI.MAX) for v in (x.max(axis=0) if len(x) else -far)]
    ranges = ", ".join(f"{a} {b:g} to {c:g}" for a, b, c in zip("xyz", low, high, strict=True))
    return f"the mesh has {ranges} mm"


def _check_names(
    comm: MPI.Comm, kind: str, tags: Mapping[str, tuple[int, ...]], found: MeshTags
) -> None:
    """Raise InputError if none of the tags of a name exists; collective."""
    sizes = {
        name: comm.allreduce(int(np.isin(found.values, list(numbers)).sum()))
        for name, numbers in tags.items()
    }
    known = sorted(set().union(*comm.allgather({int(tag) for tag in found.values})))
    tag_list = ", ".join(map(str, known[:MOST_TAGS])) + (", ..." if known[MOST_TAGS:] else "")
    _raise_missing(kind, sizes, f"the tags are {tag_list}" if known else "there are no tags")


def _raise_missing(kind: str, sizes: Mapping[str, int], existing: str) -> None:
    """Raise InputError if a name has no entities: which, and what exists."""
    missing = [name for name, size in sizes.items() if not size]
    if missing:
        entities = "cell" if kind == "regions" else "exterior facet"
        raise InputError(f"{kind}: no {entities} is marked {', '.join(missing)}; {existing}")


def connect(mesh: dolfinx.mesh.Mesh) -> None:
    """Number the facets of a mesh and connect them with its cells; collective."""
    mesh.topology.create_connectivity(3, 0)
    mesh.topology.create_entities(2)
    mesh.topology.create_connectivity(2, 3)


def _tags(mesh: dolfinx.mesh.Mesh, dim: int, sets: Sequence[Entities]) -> MeshTags:
    """Tags of sets of entities, numbered from 1; the first set that has an entity counts."""
    sizes = [len(entities) for entities in sets]
    values = np.repeat(np.arange(1, len(sets) + 1, dtype=np.int32), sizes)
    entities, first_rows = np.unique(np.concatenate([NO_ENTITIES, *sets]), return_index=True)
    return meshtags(mesh, dim, entities, values[first_rows])


def distribute(data: MeshData | None, comm: MPI.Comm) -> TaggedMesh:
    """Distribute the mesh of rank 0 (None on the others) to all ranks; collective."""
    emptied = {name: getattr(data, name)[:0] for name in ARRAYS} if data is not None else {}
    shared: MeshData = comm.bcast(data and replace(data, given_neighbours=None, **emptied))
    source = shared if data is None else data
    corners, width = source.cells.shape[1], source.facets.shape[1]
    threads_before = os.environ.get(THREADS)
    os.environ[THREADS] = threads_before or "1"  # several part a mesh in another way each time
    try:
        mesh = dolfinx.mesh.create_mesh(
            comm,
            source.cells[:, cell_perm_array(CellType.tetrahedron, corners)].copy(),
            x=source.points,
            e=ufl_mesh(11 if source.curved else 4, 3, np.float64),
            partitioner=dolfinx_features.partitioner(GhostMode.shared_facet),
        )
    finally:
        if threads_before is None:
            del os.environ[THREADS]
    connect(mesh)
    original = mesh.topology.original_cell_index
    cells = np.arange(len(original), dtype=np.int32)
    regions = meshtags(mesh, 3, cells, shared.cell_tags[original])
    regions.name = "regions"
    facets = source.facets[:, cell_perm_array(CellType.triangle, width)].copy()
    local, values = distribute_entity_data(mesh, 2, facets, source.facet_tags)
    patches = meshtags_from_entities(
        mesh, 2, adjacencylist(local), values.astype(np.int32, copy=False)
    )
    patches.name = "boundaries"
    names = (shared.regions, shared.boundaries, shared.interfaces, shared.notes)
    return TaggedMesh(mesh, regions, patches, *names)


def gather(tagged: TaggedMesh) -> MeshData | None:
    """Gather a distributed mesh on rank 0 (None on the others); collective.

    Raises:
        InputError: Cells are neither straight nor quadratic.
    """
    mesh, geometry = tagged.mesh, tagged.mesh.geometry
    if geometry.cmap.degree > 2:
        raise InputError(f"cells are of degree {geometry.cmap.degree}; expected 1 or 2")
    comm = mesh.comm
    nodes, cells_map = geometry.index_map(), mesh.topology.index_map(3)
    numbers = nodes.local_to_global(geometry.dofmap.ravel().astype(np.int32))
    numbers = numbers.reshape(geometry.dofmap.shape)
    # Columns in the order of gmsh, whose first four nodes are the vertices.
    cells = np.empty_like(numbers)
    cells[:, cell_perm_array(CellType.tetrahedron, cells.shape[1])] = numbers
    regions = np.zeros(len(cells), dtype=np.int32)
    regions[tagged.cell_tags.indices] = tagged.cell_tags.values
    owned = tagged.facet_tags.indices < mesh.topology.index_map(2).size_local
    tagged_facets = tagged.facet_tags.indices[owned]
    mesh.topology.create_connectivity(3, 2)
    cell_of = mesh.topology.connectivity(2, 3)
    facets_of = mesh.topology.connectivity(3, 2)
    cell_of_facet = np.array([cell_of.links(facet)[0] for facet in tagged_facets], dtype=np.int64)
    opposite = [
        int(np.flatnonzero(facets_of.links(cell) == facet)[0])
        for facet, cell in zip(tagged_facets, cell_of_facet, strict=True)
    ]
    # Facet i of dolfinx is opposite to vertex i; face f of `FACES` is opposite to vertex 3 - f.
    faces = 3 - np.array(opposite, dtype=np.int64)
    local = cells_map.size_local
    rank_arrays = (
        geometry.x[: nodes.size_local],
        cells[:local],
        regions[:local],
        faces_of(cells, cell_of_facet, faces),
        tagged.facet_tags.values[owned],
    )
    parts = comm.gather(rank_arrays)
    if parts is None:
        return None
    points, all_cells, cell_tags, facets, facet_tags = (
        np.concatenate(arrays) for arrays in zip(*parts, strict=True)
    )
    names = (dict(tagged.regions), dict(tagged.boundaries), dict(tagged.interfaces))
    return MeshData(points, all_cells, cell_tags, facets, facet_tags, *names)
