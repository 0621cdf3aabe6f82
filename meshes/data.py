"""The mesh as plain arrays: output of a mesher, input of the solver's mesh.

A mesher works with names; dolfinx wants one integer per cell and per facet. Regions count from 1.
A boundary is a union of *patches*, disjoint sets of facets with one tag each.

Local numbering is gmsh's: the vertices, then the mid-side nodes of quadratic cells and facets in
the order of `GMSH_TETRAHEDRON` and `GMSH_TRIANGLE` (`meshes.shape_functions`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from app.foundation.arrays import Bools, Floats, Ints
from meshes.shape_functions import GMSH_TETRAHEDRON, GMSH_TRIANGLE, Edges, slopes_of_shape_functions

Tags = npt.NDArray[np.integer]
# Names of the regions on the two sides of an interface.
Sides = tuple[tuple[str, ...], tuple[str, ...]]
CHUNK_CELLS = 1 << 13  # cells, of which all intermediate numbers fit a cache

# The nodes of each face of a quadratic tetrahedron as a facet's, outward for positive volume.
FACES = np.array([(0, 2, 1, 6, 5, 4), (0, 1, 3, 4, 9, 7), (0, 3, 2, 7, 8, 6), (1, 2, 3, 5, 8, 9)])


class StepKeys(Protocol):
    """Steps along a stem."""

    def steps(self, length: float) -> int:
        """Number of equal steps along a stem in a length, each about `step_along`."""


@dataclass(frozen=True)
class MeshData:
    """A tetrahedral mesh with named regions and boundaries.

    Attributes:
        points: Nodes [mm], shape (n, 3).
        cells: Nodes of each tetrahedron in gmsh's order, shape (m, 4) straight or (m, 10) curved.
        cell_tags: Region tag of each cell, shape (m,).
        facets: Nodes of the tagged exterior facets, shape (k, 3) or (k, 6).
        facet_tags: Patch tag of each of ``facets``, shape (k,); a facet is listed once.
        regions: Region name to cell tag.
        boundaries: Boundary name to its patch tags; patches are disjoint, names may share them.
        interfaces: Interface name to the region names on either side.
        notes: Notes of the mesher (quality, achieved thickness); JSON-able.
        given_neighbours: `neighbours`, if the mesher knows them (m, 4); else None.
    """

    points: Floats
    cells: Ints
    cell_tags: npt.NDArray[np.int32]
    facets: Ints
    facet_tags: npt.NDArray[np.int32]
    regions: Mapping[str, int]
    boundaries: Mapping[str, tuple[int, ...]]
    interfaces: Mapping[str, Sides]
    notes: Mapping[str, Any] = field(default_factory=dict)
    given_neighbours: Ints | None = None

    @property
    def curved(self) -> bool:
        """Return True if cells are quadratic (ten nodes)."""
        return self.cells.shape[1] == 10

    @cached_property
    def neighbours(self) -> Ints:
        """The cell behind each face of each cell, -1 outside; shape (m, 4)."""
        if self.given_neighbours is not None:
            return self.given_neighbours
        return match_faces(self.cells).reshape(-1, 4) // 4

    @cached_property
    def facets_between_regions(self) -> tuple[Ints, Ints, Ints]:
        """Facets between regions: cells, local faces, cells behind; each of shape (k,).

        Each facet occurs twice, as seen from either side.
        """
        behind = self.neighbours
        is_other = self.cell_tags[behind] != self.cell_tags[:, None]
        cell, face = np.nonzero(is_other & (behind >= 0))
        return cell, face, behind[cell, face]

    @cached_property
    def faces_of_facets(self) -> Ints:
        """Row of `cell_faces` of each tagged facet, -1 if the facet is not exterior; shape (k,)."""
        outside = np.flatnonzero(self.neighbours < 0)
        keys, tagged_keys = same_triangles(
            faces_of(self.cells, outside // 4, outside % 4)[:, :3], self.facets[:, :3]
        )
        order = np.argsort(keys)
        rows = order[np.searchsorted(keys, tagged_keys, sorter=order).clip(max=len(keys) - 1)]
        return np.where(keys[rows] == tagged_keys, outside[rows], -1)


def cell_faces(cells: Ints) -> Ints:
    """The faces of every cell, outward, shape (4 m, 3 or 6); face f of cell c is row 4 c + f."""
    return faces_of(cells, *np.divmod(np.arange(4 * len(cells)), 4))


def faces_of(cells: Ints, cell: Ints, face: Ints) -> Ints:
    """Nodes (k, 3 or 6) of the faces `face` (k,) of the cells `cell` (k,)."""
    return cells[cell[:, None], FACES[face, : 3 if cells.shape[1] == 4 else 6]]


def match_faces(cells: Ints) -> Ints:
    """Row of ``cell_faces`` of the same face seen from the other cell, or -1; shape (4 m,).

    Raises:
        ValueError: A face belongs to more than two cells.
    """
    a, b, c = (cells[:, corner].ravel() for corner in FACES[:, :3].T)
    low, high = np.minimum(a, b), np.maximum(a, b)
    middle = np.maximum(low, np.minimum(high, c))
    low, high = np.minimum(low, c), np.maximum(high, c)
    keys = low * (int(cells.max()) + 1) + middle
    rows = np.lexsort((high, keys))
    keys, high = keys[rows], high[rows]
    is_same = (keys[1:] == keys[:-1]) & (high[1:] == high[:-1])
    if np.any(is_same[1:] & is_same[:-1]):
        raise ValueError("a face belongs to more than two cells")
    partner = np.full(len(rows), -1, dtype=np.int64)
    first_rows = np.flatnonzero(is_same)
    partner[rows[first_rows]] = rows[first_rows + 1]
    partner[rows[first_rows + 1]] = rows[first_rows]
    return partner


def same_triangles(a: Ints, b: Ints) -> tuple[Ints, Ints]:
    """Return numbers of the triangles of two lists; equal for equal triangles.

    The order of the corners does not matter.
    """
    low, middle, high = np.sort(np.concatenate([a, b]), axis=1).T
    n = int(high.max(initial=0)) + 1
    label = np.unique(low * n + middle, return_inverse=True)[1] * n + high
    return label[: len(a)], label[len(a) :]


def exterior_facets(cells: Ints) -> tuple[Ints, Ints]:
    """Facets that belong to one cell only: nodes, outward (k, 3 or 6), and cells (k,)."""
    rows = np.flatnonzero(match_faces(cells) < 0)
    return faces_of(cells, rows // 4, rows % 4), rows // 4


def connected(n: int, a: Ints, b: Ints) -> Ints:
    """Number of the connected component of each of n nodes that pairs (a, b) join (n,).

    Components are numbered from 0 in the order of their first nodes.
    """
    node = np.arange(n)
    label: Ints = node.copy()
    while len(a):
        # Replace the greater label of each pair by the lesser one, then labels by their labels.
        label[np.maximum(a, b)] = np.minimum(a, b)
        while not np.array_equal(further := label[label], label):
            label = further
        a, b = label[a], label[b]
        differs = a != b
        a, b = a[differs], b[differs]
    return np.asarray((np.cumsum(label == node) - 1)[label])


def connected_components(neighbours: Ints, labels: npt.NDArray[np.int32]) -> Ints:
    """Connected component of each cell, joined by faces between cells of equal label (m,).

    ``neighbours`` are the cells behind the faces (m, 4), as in `MeshData`.
    """
    # Pairs of neighbours of one label, each once.
    once = (neighbours >= 0) & (neighbours < np.arange(len(neighbours))[:, None])
    a, face = np.nonzero(once & (labels[neighbours] == labels[:, None]))
    return connected(len(neighbours), a, neighbours[a, face])


# Quadrature that is exact for the volume of a quadratic tetrahedron. Its Jacobian is cubic, so
# degree 3 is needed. For the area of a quadratic facet the relative error is about 1e-6.
_TET_POINTS = np.vstack([np.full((1, 4), 1 / 4), np.where(np.eye(4), 1 / 2, 1 / 6)])
_TET_WEIGHTS = np.array([-4 / 5] + [9 / 20] * 4)
_A = (6 - np.sqrt(15)) / 21
_B = (6 + np.sqrt(15)) / 21
_TRI_POINTS = np.vstack(
    [np.full((1, 3), 1 / 3), *(np.where(np.eye(3), 1 - 2 * a, a) for a in (_A, _B))]
)
_TRI_WEIGHTS = np.repeat([9 / 40, *((155 + s * np.sqrt(15)) / 1200 for s in (-1, 1))], [1, 3, 3])


def tangents(x: Floats, barycentric: Floats, edges: Edges) -> Floats:
    """Derivatives dx/dLk - dx/dL0, k > 0, of cells or facets; shape (k, 3, m, q).

    Args:
        x: Nodes of the cells or facets (m, v + e, 3).
        barycentric: Coordinates of the points (q, v).
        edges: The e pairs of vertices with a node in the middle; none for straight cells or facets.
    """
    slopes = slopes_of_shape_functions(barycentric, edges)
    # By BLAS, which takes a fifteenth of the time of sums by numpy.
    return np.asarray(np.einsum("qak,maj->kjmq", slopes, x, optimize=True))


def edge_vectors(points: Floats, cells: Ints) -> Iterator[list[Floats]]:
    """Edges from the first corner of straight cells (3, k), in chunks that fit a cache."""
    x = np.ascontiguousarray(points.T)
    for start in range(0, max(len(cells), 1), CHUNK_CELLS):
        first_node, *other_nodes = (x[:, nodes] for nodes in cells[start : start + CHUNK_CELLS].T)
        yield [other_node - first_node for other_node in other_nodes]


def dot(a: npt.NDArray[np.floating], b: npt.NDArray[np.floating]) -> Floats:
    """Scalar products of vectors (3, ...)."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def cell_volumes(points: Floats, cells: Ints) -> Floats:
    """Volumes of the cells [mm^3], negative when inverted; shape (m,)."""
    if cells.shape[1] == 4:
        chunks = edge_vectors(points, cells)
        return np.concatenate([dot(a, np.cross(b, c, axis=0)) for a, b, c in chunks]) / 6
    a, b, c = tangents(points[cells], _TET_POINTS, GMSH_TETRAHEDRON)
    return dot(a, np.cross(b, c, axis=0)) @ _TET_WEIGHTS / 6


def facet_areas(points: Floats, facets: Ints) -> Floats:
    """Areas of facets [mm^2]; shape (k,)."""
    x = points[facets]
    if facets.shape[1] == 3:
        return np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1) / 2
    a, b = tangents(x, _TRI_POINTS, GMSH_TRIANGLE)
    return np.linalg.norm(np.cross(a, b, axis=0), axis=0) @ _TRI_WEIGHTS / 2


def region_volumes(data: MeshData) -> dict[str, float]:
    """Volume of each region [mm^3]."""
    volumes = cell_volumes(data.points, data.cells)
    return {name: float(volumes[data.cell_tags == tag].sum()) for name, tag in data.regions.items()}


def boundary_areas(data: MeshData) -> dict[str, float]:
    """Area of each named boundary [mm^2]."""
    areas = facet_areas(data.points, data.facets)
    return {
        name: float(areas[np.isin(data.facet_tags, tags)].sum())
        for name, tags in data.boundaries.items()
    }


def interface_facets(data: MeshData, name: str) -> tuple[Ints, Ints, Ints]:
    """Facets of an interface: nodes (outward from the first side), cells on either side."""
    first_tags, second_tags = ([data.regions[r] for r in side] for side in data.interfaces[name])
    cell, face, behind = data.facets_between_regions
    is_between = np.isin(data.cell_tags[cell], first_tags) & np.isin(
        data.cell_tags[behind], second_tags
    )
    return (
        faces_of(data.cells, cell[is_between], face[is_between]),
        cell[is_between],
        behind[is_between],
    )


def nodes_of_boundary_facets(data: MeshData, name: str) -> Ints:
    """Nodes of the facets of a boundary, if there are any (k, 3 or 6)."""
    return data.facets[np.isin(data.facet_tags, data.boundaries.get(name, ()))]


def interface_nodes(
    data: MeshData, name: str, sliding_boundaries: Mapping[str, tuple[str, str]]
) -> Ints:
    """Corner nodes of an interface (n,); of its second sliding boundary if meshed apart."""
    boundaries = sliding_boundaries.get(name)
    facets = (
        nodes_of_boundary_facets(data, boundaries[1])
        if boundaries
        else interface_facets(data, name)[0]
    )
    return np.unique(facets[:, :3])


def canonical(data: MeshData) -> MeshData:
    """Return the mesh without unused nodes, in an order that depends on the geometry alone.

    Nodes are sorted by z, y, x; cells by region and nodes; facets by tag and nodes.
    """
    is_used = np.zeros(len(data.points), dtype=bool)
    is_used[data.cells] = True
    nodes = np.flatnonzero(is_used)
    nodes = nodes[np.lexsort(np.round(data.points[nodes], 9).T)]
    new_node = np.full(len(data.points), -1, dtype=np.int64)
    new_node[nodes] = np.arange(len(nodes))
    cells, facets = new_node[data.cells], new_node[data.facets]
    a, b, c, d = np.sort(cells[:, :4], axis=1).T
    n = len(nodes)
    by_cell = np.lexsort((c * n + d, (data.cell_tags.astype(np.int64) * n + a) * n + b))
    neighbours = data.given_neighbours
    if neighbours is not None:
        new_cell = np.full(len(cells) + 1, -1, dtype=np.int64)  # the last entry keeps -1
        new_cell[by_cell] = np.arange(len(cells))
        neighbours = new_cell[neighbours.take(by_cell, axis=0)]
    by_facet = np.lexsort((*np.sort(facets[:, :3], axis=1).T[::-1], data.facet_tags))
    return replace(
        data,
        points=data.points[nodes],
        cells=cells.take(by_cell, axis=0),
        cell_tags=data.cell_tags[by_cell].astype(np.int32),
        facets=facets[by_facet],
        facet_tags=data.facet_tags[by_facet].astype(np.int32),
        given_neighbours=neighbours,
    )


def number(names: Iterable[str]) -> dict[str, int]:
    """Tags 1, 2, ... in the order of the names."""
    return {name: tag for tag, name in enumerate(names, start=1)}


def mesh_data_of(
    points: Floats,
    cells: Ints,
    cell_tags: Tags,
    regions: Mapping[str, int],
    interfaces: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]],
    boundaries: Mapping[str, Bools],
    facets: Ints,
) -> MeshData:
    """Make a mesh from boundaries that may overlap, masks over the exterior ``facets``.

    Facets that belong to the same set of names form one patch, so boundaries may overlap:
    ``gluteus_medius`` is part of ``bone_surface``. Facets without a name are left out.
    """
    masks = np.array([*boundaries.values()], dtype=bool).reshape(-1, len(facets))
    patterns, inverse = np.unique(masks.T, axis=0, return_inverse=True)
    tags = np.cumsum(patterns.any(axis=1), dtype=np.int32) * patterns.any(axis=1)
    has_name = masks.any(axis=0)
    return MeshData(
        points=points,
        cells=cells,
        cell_tags=cell_tags.astype(np.int32),
        facets=facets[has_name],
        facet_tags=tags[inverse.ravel()][has_name],
        regions=dict(regions),
        boundaries={
            name: tuple(tags[pattern].tolist())
            for name, pattern in zip(boundaries, patterns.T, strict=True)
        },
        interfaces=dict(interfaces),
    )
