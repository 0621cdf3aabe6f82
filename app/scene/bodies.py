"""Bodies of a scene on its mesh: regions that move together, and the facets between them.

A body is a set of regions that no contact interface separates. The functions here read the
distributed mesh (regions, boundaries, facets between regions); `app.interfaces.contact_points` then
works on the gathered facets.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import basix
import numpy as np
from dolfinx import fem, la
from numpy.typing import NDArray

from app.foundation.arrays import Bools, Ints
from app.foundation.errors import InputError
from app.interfaces.interface_facets import InterfaceFacets, gather, sorted_facets
from app.laws.materials import Rigid
from app.scene.scene import Interface
from meshes.distribute import TaggedMesh

# Nodes of each facet of a tetrahedron: vertices, then the middles of the edges opposite them.
FACET_NODES = np.array(
    [
        [*vertices, *(4 + edge for edge in parts[1])]
        for vertices, parts in zip(
            basix.topology(basix.CellType.tetrahedron)[2],
            basix.cell.sub_entity_connectivity(basix.CellType.tetrahedron)[2],
            strict=True,
        )
    ]
)


@dataclass(frozen=True)
class Bodies:
    """Bodies of a scene.

    Attributes:
        names: Name of each body: its regions joined by " + ".
        of_region: Body of each region name.
        of_tag: Body of each cell tag (length: largest tag + 1), -1 where there is no region.
    """

    names: tuple[str, ...]
    of_region: dict[str, int]
    of_tag: Ints


@dataclass(frozen=True)
class FacetCells:
    """Facets (n,) of cells that this rank owns, with their local numbers in those cells.

    Attributes:
        outside: Cells on the other side, -1 where there is none (n,).
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


def bodies_of(tagged: TaggedMesh, contacts: Sequence[Interface], rigid: Sequence[Rigid]) -> Bodies:
    """Join regions that touch without a contact interface; collective.

    Raises:
        InputError: The sides of a contact interface are joined elsewhere.
    """
    names = {tag: name for name, tag in tagged.regions.items()}
    separated = _separated(tagged, contacts)
    group = {tag: tag for tag in names}
    for a, b in _touching(tagged):
        if frozenset((a, b)) not in separated:
            group = _joined(group, a, b)
    # Where supports hold both sides of a jump the first body is the base: the rigid one, if any.
    stiff = {group[tagged.regions[r.region]] for r in rigid}

    def rigid_first(label: int) -> tuple[bool, int]:
        return label not in stiff, min(t for t in group if group[t] == label)

    labels = sorted(set(group.values()), key=rigid_first)
    number = {g: k for k, g in enumerate(labels)}
    of_region = {name: number[group[tag]] for tag, name in sorted(names.items())}
    for c in contacts:
        shared = {of_region[r] for r in c.master} & {of_region[r] for r in c.slave}
        if shared:
            raise InputError(
                f"interfaces.{c.name}: its two sides are joined by other regions that are bonded "
                "to both; allowed: an interface that separates two bodies"
            )
    of_tag = np.full(max(names) + 1, -1, dtype=np.int64)
    for tag, name in names.items():
        of_tag[tag] = of_region[name]
    return Bodies(
        tuple(" + ".join(r for r, b in of_region.items() if b == k) for k in range(len(labels))),
        of_region,
        of_tag,
    )


def pieces_of(
    tagged: TaggedMesh, interfaces: Sequence[Interface]
) -> tuple[Bodies, list[tuple[str, str]]]:
    """Parts that all interfaces, also bonds, separate, as bodies; collective.

    Returns:
        The bodies, without names, and pairs of regions that touch without an interface but belong
        to two bodies. Together they would join the two sides of an interface.
    """
    names = {tag: name for name, tag in tagged.regions.items()}
    separated = _separated(tagged, interfaces)
    group, others = {tag: tag for tag in names}, []
    for a, b in _touching(tagged):
        if frozenset((a, b)) in separated:
            continue
        joined = _joined(group, a, b)
        if any(len({joined[tag] for tag in pair}) == 1 for pair in separated):
            others.append((names[a], names[b]))
        else:
            group = joined
    labels = sorted(set(group.values()))
    of_tag = np.full(max(names) + 1, -1, dtype=np.int64)
    for tag, label in group.items():
        of_tag[tag] = labels.index(label)
    of_region = {name: int(of_tag[tag]) for tag, name in names.items()}
    return Bodies(("",) * len(labels), of_region, of_tag), others


def _touching(tagged: TaggedMesh) -> list[tuple[int, int]]:
    """Pairs of tags of regions that share facets, rising; collective."""
    between = np.sort(cell_tags(tagged)[_interior(tagged)[1]], axis=1)
    pairs = {(int(a), int(b)) for a, b in np.unique(between, axis=0) if a != b}
    return sorted(set().union(*tagged.mesh.comm.allgather(pairs)))


def _separated(tagged: TaggedMesh, interfaces: Sequence[Interface]) -> set[frozenset[int]]:
    """Pairs of tags of regions on the two sides of an interface."""
    return {
        frozenset((tagged.regions[a], tagged.regions[b]))
        for c in interfaces
        for a in c.master
        for b in c.slave
    }


def _joined(group: Mapping[int, int], a: int, b: int) -> dict[int, int]:
    """Return the group of each tag after the groups of two tags are joined."""
    return {t: group[a] if g == group[b] else g for t, g in group.items()}


def boundary_facets(tagged: TaggedMesh, boundary: str) -> FacetCells:
    """Facets of a named boundary that this rank owns, each with its one cell.

    Raises:
        InputError: It is no boundary of this mesh: a surface inside it, or an empty one.
    """
    mesh = tagged.mesh
    if boundary not in tagged.boundaries:
        raise InputError(
            f"boundary '{boundary}' is not part of the surface of this mesh; it has "
            f"{', '.join(tagged.boundaries)}"
        )
    facets = np.concatenate([tagged.facet_tags.find(t) for t in tagged.boundaries[boundary]])
    facets = np.unique(facets[facets < mesh.topology.index_map(2).size_local]).astype(np.int64)
    link = mesh.topology.connectivity(2, 3)
    cells = link.array[link.offsets[facets]].astype(np.int64)
    outside = np.full(len(facets), -1)
    return FacetCells(facets, cells, _local_numbers(tagged, facets, cells), outside)


def facets_by_body(
    tagged: TaggedMesh, bodies: Bodies, boundary: str
) -> dict[int, NDArray[np.int32]]:
    """Owned facets of a boundary by body, the same bodies on all ranks; collective."""
    f = boundary_facets(tagged, boundary)
    body = bodies.of_tag[cell_tags(tagged)[f.cells]]
    present = set().union(*tagged.mesh.comm.allgather({int(b) for b in np.unique(body)}))
    return {b: f.facets[body == b].astype(np.int32) for b in sorted(present)}


def _interior(tagged: TaggedMesh) -> tuple[Ints, Ints]:
    """Facets of this rank with two cells (n,), and both cells (n, 2)."""
    link = tagged.mesh.topology.connectivity(2, 3)
    inside = np.flatnonzero(np.diff(link.offsets) == 2)
    return inside, link.array[link.offsets[inside][:, None] + np.arange(2)].astype(np.int64)


def _local_numbers(tagged: TaggedMesh, facets: Ints, cells: Ints) -> Ints:
    link = tagged.mesh.topology.connectivity(3, 2).array.reshape(-1, 4)
    return np.argmax(link[cells] == facets[:, None], axis=1)


def contact_facets(
    tagged: TaggedMesh,
    bodies: Bodies,
    space: fem.FunctionSpace,
    contacts: Sequence[Interface],
    moduli: Mapping[str, float],
) -> InterfaceFacets:
    """Facets of all contact interfaces, replicated in canonical order; collective.

    Jumps move the softer side, by moduli of regions, 0 if absent.

    Raises:
        InputError: An interface has no facets on this mesh.
    """
    tags, comm = cell_tags(tagged), tagged.mesh.comm
    stiffness = np.zeros(len(bodies.of_tag))
    for region, modulus in moduli.items():
        stiffness[tagged.regions[region]] = modulus
    rows = []
    for i, c in enumerate(contacts):
        f = facets_between(tagged, c.slave, c.master)
        if comm.allreduce(len(f.cells)) == 0 and not c.between:
            raise InputError(
                f"interfaces.{c.name}: its two sides share no facet of the mesh; allowed: regions "
                "that touch on a conforming mesh, or `sliding: finite` between two boundaries"
            )
        sides = tags[np.column_stack([f.outside, f.cells])]
        if c.between:
            f = boundary_facets(tagged, c.between[1])
            sides = np.column_stack(
                [np.full_like(f.cells, tagged.regions[c.master[0]]), tags[f.cells]]
            )
        numbers, dofs, x, inside = facet_nodes(tagged, space, f)
        columns = np.full(len(numbers), i), numbers, bodies.of_tag[sides], dofs, x, inside
        rows.append((*columns, stiffness[sides]))
    return sorted_facets(*gather(comm, *map(np.concatenate, zip(*rows, strict=True))))


def _at_facets(values: NDArray, f: FacetCells) -> NDArray:
    """Values at the nodes of facets (f, 3 or 6), from values by cell (cells, 4 or 10)."""
    nodes = FACET_NODES[f.local, : 3 if values.shape[1] == 4 else 6]
    return np.take_along_axis(values[f.cells], nodes, axis=1)


def facet_nodes(
    tagged: TaggedMesh, space: fem.FunctionSpace, f: FacetCells
) -> tuple[Ints, Ints, NDArray, NDArray]:
    """Vertex numbers (f, 3), global dofs (f, 3 or 6) and `facet_coordinates` of facets."""
    local = np.ascontiguousarray(_at_facets(space.dofmap.list, f), dtype=np.int32)
    dofs = space.dofmap.index_map.local_to_global(local.ravel()).reshape(local.shape)
    geometry = tagged.mesh.geometry
    nodes = _at_facets(geometry.dofmap, f)[:, :3]
    numbers = np.asarray(geometry.input_global_indices)[nodes].astype(np.int64)
    return numbers, dofs.astype(np.int64), *facet_coordinates(tagged, f)


def facets_between(tagged: TaggedMesh, inside: Sequence[str], outside: Sequence[str]) -> FacetCells:
    """Facets between regions, with the cell inside, which this rank owns."""
    facets, pairs = _interior(tagged)
    tags = cell_tags(tagged)[pairs]
    near, far = (np.isin(tags, [tagged.regions[r] for r in side]) for side in (inside, outside))
    owned = near & far[:, ::-1] & (pairs < tagged.mesh.topology.index_map(3).size_local)
    rows, side = np.nonzero(owned)
    facets, cells = facets[rows], pairs[rows, side]
    return FacetCells(facets, cells, _local_numbers(tagged, facets, cells), pairs[rows, 1 - side])


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
    """Mask of the owned nodes that belong to such cells of any rank (n,); collective."""
    marks = fem.Function(space)
    marks.x.array.reshape(-1, 3)[np.unique(space.dofmap.list[np.flatnonzero(cells)])] = 1
    marks.x.scatter_reverse(la.InsertMode.add)
    return np.asarray(marks.x.array[: 3 * space.dofmap.index_map.size_local : 3] > 0)
