"""Bodies of a scene on its mesh: regions that move together, and the facets between them.

A body is a set of regions that no parting interface separates. The functions of this module read
the distributed mesh: regions, boundaries, and facets between regions.
`app.interfaces.contact_points` then works on the gathered facets.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import basix
import numpy as np
from dolfinx import fem, la
from numpy.typing import NDArray

from app.foundation.arrays import Bools, Ints
from app.foundation.errors import InputError
from app.interfaces.interface_facets import InterfaceFacets, gathered_arrays, sorted_facets
from app.laws.materials import Rigid
from app.scene.scene import Interface
from meshes.data import connected
from meshes.distribute import TaggedMesh


def _facet_nodes() -> Ints:
    """Nodes of each facet of a tetrahedron (4, 6): vertices, then middles of the opposite edges."""
    vertices_of_facets = basix.topology(basix.CellType.tetrahedron)[2]
    # For each facet, its vertices, edges, itself and the cell.
    entities_of_facets = basix.cell.sub_entity_connectivity(basix.CellType.tetrahedron)[2]
    nodes = []
    for vertices, entities in zip(vertices_of_facets, entities_of_facets, strict=True):
        nodes.append([*vertices, *(4 + edge for edge in entities[1])])
    return np.array(nodes)


# Nodes of each facet of a tetrahedron of second order (4, 6).
FACET_NODES = _facet_nodes()


@dataclass(frozen=True)
class Bodies:
    """Bodies of a scene.

    Attributes:
        names: Name of each body: its regions joined by " + ".
        body_of_region: Body of each region name.
        body_of_tag: Body of each cell tag (length: largest tag + 1), -1 where there is no region.
    """

    names: tuple[str, ...]
    body_of_region: dict[str, int]
    body_of_tag: Ints


@dataclass(frozen=True)
class FacetCells:
    """Facets (n of them), each with a cell that this rank owns.

    Attributes:
        facets: Local facets (n,).
        cells: Cell of each facet (n,).
        local: Number of the facet in its cell, 0 to 3 (n,).
        outside: Cell on the other side of the facet, -1 if there is none (n,).
    """

    facets: Ints
    cells: Ints
    local: Ints
    outside: Ints


def cell_tags(tagged: TaggedMesh) -> Ints:
    """Region tag of every cell of this rank, ghosts included."""
    index_map = tagged.mesh.topology.index_map(3)
    tags = np.zeros(index_map.size_local + index_map.num_ghosts, dtype=np.int64)
    tags[tagged.cell_tags.indices] = tagged.cell_tags.values
    return tags


def bodies_of(
    tagged: TaggedMesh, parting_interfaces: Sequence[Interface], rigid: Sequence[Rigid]
) -> Bodies:
    """Bodies of a scene: regions that touch without a parting interface are joined; collective.

    Raises:
        InputError: The sides of a parting interface are joined by other regions.
    """
    region_of_tag = {tag: region for region, tag in tagged.regions.items()}
    separated = _separated(tagged, parting_interfaces)
    joined = [pair for pair in _touching(tagged) if frozenset(pair) not in separated]
    label_of_tag = _labels(tagged, joined)
    # If supports hold both sides of a jump, the first body is the base. A rigid body comes first.
    rigid_labels = {label_of_tag[tagged.regions[r.region]] for r in rigid}
    other_labels = set(label_of_tag.values()) - rigid_labels
    labels = [*sorted(rigid_labels), *sorted(other_labels)]
    body_of_label = {label: body for body, label in enumerate(labels)}
    body_of_tag = np.full(max(region_of_tag) + 1, -1, dtype=np.int64)
    body_of_region: dict[str, int] = {}
    regions_of_bodies: list[list[str]] = [[] for _ in labels]
    for tag in sorted(region_of_tag):
        region, body = region_of_tag[tag], body_of_label[label_of_tag[tag]]
        body_of_tag[tag] = body
        body_of_region[region] = body
        regions_of_bodies[body].append(region)
    for c in parting_interfaces:
        master_bodies = {body_of_region[region] for region in c.master}
        slave_bodies = {body_of_region[region] for region in c.slave}
        if master_bodies & slave_bodies:
            raise InputError(
                f"interfaces.{c.name}: its two sides are joined by other regions that are bonded "
                "to both; allowed: an interface that separates two bodies"
            )
    names = tuple(" + ".join(regions) for regions in regions_of_bodies)
    return Bodies(names, body_of_region, body_of_tag)


def pieces_of(
    tagged: TaggedMesh, interfaces: Sequence[Interface]
) -> tuple[Bodies, list[tuple[str, str]]]:
    """Parts of the model that interfaces of any kind separate, bonds too, as bodies; collective.

    Returns:
        The bodies, without names, and pairs of regions that touch without an interface but belong
        to two bodies. If they were joined, they would join the two sides of an interface.
    """
    region_of_tag = {tag: region for region, tag in tagged.regions.items()}
    separated = _separated(tagged, interfaces)
    joined: list[tuple[int, int]] = []
    unjoined: list[tuple[str, str]] = []
    for pair in _touching(tagged):
        if frozenset(pair) in separated:
            continue
        label_if_joined = _labels(tagged, [*joined, pair])
        if any(len({label_if_joined[tag] for tag in sides}) == 1 for sides in separated):
            unjoined.append((region_of_tag[pair[0]], region_of_tag[pair[1]]))
        else:
            joined.append(pair)
    label_of_tag = _labels(tagged, joined)
    labels = sorted(set(label_of_tag.values()))
    body_of_tag = np.full(max(region_of_tag) + 1, -1, dtype=np.int64)
    for tag, label in label_of_tag.items():
        body_of_tag[tag] = labels.index(label)
    body_of_region = {region: int(body_of_tag[tag]) for tag, region in region_of_tag.items()}
    return Bodies(("",) * len(labels), body_of_region, body_of_tag), unjoined


def _touching(tagged: TaggedMesh) -> list[tuple[int, int]]:
    """Pairs of tags of regions that share facets, in ascending order; collective."""
    pairs_of_facets = np.sort(cell_tags(tagged)[_interior(tagged)[1]], axis=1)
    pairs = {(int(a), int(b)) for a, b in np.unique(pairs_of_facets, axis=0) if a != b}
    return sorted(set().union(*tagged.mesh.comm.allgather(pairs)))


def _separated(tagged: TaggedMesh, interfaces: Sequence[Interface]) -> set[frozenset[int]]:
    """Pairs of tags of regions on the two sides of an interface."""
    pairs: set[frozenset[int]] = set()
    for c in interfaces:
        for master, slave in product(c.master, c.slave):
            pairs.add(frozenset((tagged.regions[master], tagged.regions[slave])))
    return pairs


def _labels(tagged: TaggedMesh, joined: Sequence[tuple[int, int]]) -> dict[int, int]:
    """Label of each tag of a region; tags that pairs join have the same. Lower ones come first."""
    tags = sorted(tagged.regions.values())
    pairs = np.array(joined, dtype=np.int64).reshape(-1, 2)
    labels = connected(tags[-1] + 1, pairs[:, 0], pairs[:, 1])
    return {tag: int(labels[tag]) for tag in tags}


def boundary_facets(tagged: TaggedMesh, boundary: str) -> FacetCells:
    """Facets of a named boundary that this rank owns, each with its one cell.

    Raises:
        InputError: The mesh has no such boundary: the surface is inside the mesh, or empty.
    """
    mesh = tagged.mesh
    if boundary not in tagged.boundaries:
        raise InputError(
            f"boundary '{boundary}' is not part of the surface of this mesh; it has "
            f"{', '.join(tagged.boundaries)}"
        )
    facets = np.concatenate([tagged.facet_tags.find(tag) for tag in tagged.boundaries[boundary]])
    facets = np.unique(facets[facets < mesh.topology.index_map(2).size_local]).astype(np.int64)
    cells_of_facets = mesh.topology.connectivity(2, 3)
    cells = cells_of_facets.array[cells_of_facets.offsets[facets]].astype(np.int64)
    outside = np.full(len(facets), -1)
    return FacetCells(facets, cells, _local_numbers(tagged, facets, cells), outside)


def facets_by_body(
    tagged: TaggedMesh, bodies: Bodies, boundary: str
) -> dict[int, NDArray[np.int32]]:
    """Owned facets of a boundary, by body; collective.

    Every rank has all bodies at the boundary, also bodies without facets of this rank.
    """
    f = boundary_facets(tagged, boundary)
    body = bodies.body_of_tag[cell_tags(tagged)[f.cells]]
    local_bodies = {int(b) for b in np.unique(body)}
    all_bodies = set().union(*tagged.mesh.comm.allgather(local_bodies))
    return {b: f.facets[body == b].astype(np.int32) for b in sorted(all_bodies)}


def _interior(tagged: TaggedMesh) -> tuple[Ints, Ints]:
    """Facets of this rank with two cells (n,), and both cells (n, 2)."""
    cells_of_facets = tagged.mesh.topology.connectivity(2, 3)
    offsets = cells_of_facets.offsets
    facets = np.flatnonzero(np.diff(offsets) == 2)
    cells = cells_of_facets.array[offsets[facets][:, None] + np.arange(2)]
    return facets, cells.astype(np.int64)


def _local_numbers(tagged: TaggedMesh, facets: Ints, cells: Ints) -> Ints:
    """Numbers of facets in their cells, 0 to 3 (n,)."""
    facets_of_cells = tagged.mesh.topology.connectivity(3, 2).array.reshape(-1, 4)
    return np.argmax(facets_of_cells[cells] == facets[:, None], axis=1)


def facets_of_interfaces(
    tagged: TaggedMesh,
    bodies: Bodies,
    space: fem.FunctionSpace,
    interfaces: Sequence[Interface],
    moduli: Mapping[str, float],
) -> InterfaceFacets:
    """Facets of interfaces, on all ranks in the same order; collective.

    ``moduli`` are the moduli of regions, 0 if absent: jumps move the softer side.

    Raises:
        InputError: An interface has no facets on this mesh.
    """
    tags, comm = cell_tags(tagged), tagged.mesh.comm
    stiffness = np.zeros(len(bodies.body_of_tag))
    for region, modulus in moduli.items():
        stiffness[tagged.regions[region]] = modulus
    columns_of_interfaces = []
    for index, c in enumerate(interfaces):
        f = facets_between(tagged, c.slave, c.master)
        if comm.allreduce(len(f.cells)) == 0 and not c.slides_finitely:
            raise InputError(
                f"interfaces.{c.name}: its two sides share no facet of the mesh; allowed: regions "
                "that touch on a conforming mesh, or `sliding: finite` between two boundaries"
            )
        side_tags = tags[np.column_stack([f.outside, f.cells])]
        if c.between:
            f = boundary_facets(tagged, c.between[1])
            master_tags = np.full_like(f.cells, tagged.regions[c.master[0]])
            side_tags = np.column_stack([master_tags, tags[f.cells]])
        vertices, dofs, x, cell_centres = facet_nodes(tagged, space, f)
        columns_of_interfaces.append(
            (
                np.full(len(vertices), index),
                vertices,
                bodies.body_of_tag[side_tags],
                dofs,
                x,
                cell_centres,
                stiffness[side_tags],
                np.full(len(vertices), c.rounded_angle),
            )
        )
    columns = map(np.concatenate, zip(*columns_of_interfaces, strict=True))
    return sorted_facets(*gathered_arrays(comm, *columns))


def _at_facets(values: NDArray, f: FacetCells) -> NDArray:
    """Values at the nodes of facets (f, 3 or 6), from values by cell (cells, 4 or 10)."""
    nodes = FACET_NODES[f.local, : 3 if values.shape[1] == 4 else 6]
    return np.take_along_axis(values[f.cells], nodes, axis=1)


def facet_nodes(
    tagged: TaggedMesh, space: fem.FunctionSpace, f: FacetCells
) -> tuple[Ints, Ints, NDArray, NDArray]:
    """Vertex numbers (f, 3), global dofs (f, 3 or 6) and `facet_coordinates` of facets."""
    local_dofs = np.ascontiguousarray(_at_facets(space.dofmap.list, f), dtype=np.int32)
    dofs = space.dofmap.index_map.local_to_global(local_dofs.ravel()).reshape(local_dofs.shape)
    geometry = tagged.mesh.geometry
    vertices = _at_facets(geometry.dofmap, f)[:, :3]
    numbers = np.asarray(geometry.input_global_indices)[vertices].astype(np.int64)
    return numbers, dofs.astype(np.int64), *facet_coordinates(tagged, f)


def facets_between(tagged: TaggedMesh, inside: Sequence[str], outside: Sequence[str]) -> FacetCells:
    """Facets between two sets of regions, with their inside cells, which this rank owns."""
    all_facets, cell_pairs = _interior(tagged)
    tags = cell_tags(tagged)[cell_pairs]
    is_inside = np.isin(tags, [tagged.regions[region] for region in inside])
    is_outside = np.isin(tags, [tagged.regions[region] for region in outside])
    is_owned = cell_pairs < tagged.mesh.topology.index_map(3).size_local
    # A column is a cell of the pair; the outside cell is in the other column.
    rows, column = np.nonzero(is_inside & is_outside[:, ::-1] & is_owned)
    facets = all_facets[rows]
    inside_cells = cell_pairs[rows, column]
    outside_cells = cell_pairs[rows, 1 - column]
    local_numbers = _local_numbers(tagged, facets, inside_cells)
    return FacetCells(facets, inside_cells, local_numbers, outside_cells)


def facet_coordinates(tagged: TaggedMesh, f: FacetCells) -> tuple[NDArray, NDArray]:
    """Nodes of facets, vertices first (f, 3 or 6, 3), and centres of their cells (f, 3) [mm]."""
    geometry = tagged.mesh.geometry
    centres = geometry.x[geometry.dofmap[f.cells][:, :4]].mean(axis=1).reshape(-1, 3)
    return geometry.x[_at_facets(geometry.dofmap, f)], centres


def nodes_on(tagged: TaggedMesh, space: fem.FunctionSpace, boundary: str) -> Ints:
    """Local nodes of a boundary; collective."""
    facets = boundary_facets(tagged, boundary).facets.astype(np.int32)
    return np.asarray(fem.locate_dofs_topological(space, 2, facets), dtype=np.int64)


def touched_nodes(space: fem.FunctionSpace, cells: Bools) -> Bools:
    """Mask of the owned nodes of masked ``cells`` of any rank (n,); collective."""
    marks = fem.Function(space)
    marks.x.array.reshape(-1, 3)[np.unique(space.dofmap.list[np.flatnonzero(cells)])] = 1
    marks.x.scatter_reverse(la.InsertMode.add)
    return np.asarray(marks.x.array[: 3 * space.dofmap.index_map.size_local : 3] > 0)
