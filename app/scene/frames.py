"""Local axes of nodes on supports along other directions than x, y, z.

Such a node has three local axes. They are the same in every stage and for every body at the node,
and each support constrains one or more of them. All other nodes have the axes x, y, z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from dolfinx import fem
from dolfinx.common import IndexMap

from app.foundation.arrays import Bools, Floats, Ints
from app.foundation.errors import InputError
from app.foundation.layout import point_text
from app.interfaces.corners import VertexConstraints
from app.interfaces.faces import projectors
from app.interfaces.interface_facets import InterfaceFacets, gathered_arrays
from app.laws.supports import Support
from app.scene.bodies import Bodies, boundary_facets, cell_tags, facet_nodes
from app.scene.scene import Scene
from meshes.distribute import TaggedMesh
from meshes.facets import NODES, facet_shape_functions, nodal_normals

# Directions within about a milliradian are equal: squares of sines below this are zero.
SAME_DIRECTION = 1e-6
# Least cosine between the normal of a facet and the nodal mean, on a smooth boundary.
SMOOTH = np.cos(np.radians(40.0))


@dataclass(frozen=True)
class Frames:
    """Nodes with local axes (n of them), on all ranks.

    Attributes:
        node: Global blocked dofs, ascending (n,).
        axes: Axes as columns (n, 3, 3).
        acts: Mask of the supports that act on a body at a node (n, bodies, supports).
        along: Mask of the axes that a support constrains (n, supports, 3).
    """

    node: Ints
    axes: Floats
    acts: Bools
    along: Bools

    def owned(self, index_map: IndexMap) -> tuple[Ints, Ints]:
        """Local numbers of owned nodes, and their rows in this object."""
        low, high = index_map.local_range
        rows = np.flatnonzero((self.node >= low) & (self.node < high))
        return self.node[rows] - low, rows

    def support(self, rows: Ints, bodies: Ints | int, active: Sequence[int]) -> Ints:
        """Index of the support that constrains each axis of bodies at nodes, or -1 (m, 3).

        Args:
            rows: Rows of the nodes in this object (m,).
            bodies: Body at each node (m,), or one body for all.
            active: Active supports; later ones override earlier ones.
        """
        support_of_axis = np.full((len(rows), 3), -1, dtype=np.int64)
        for index in active:
            acts_on_body = self.acts[rows, bodies, index]
            support_of_axis[acts_on_body[:, None] & self.along[rows, index]] = index
        return support_of_axis


def vertex_constraints(
    frames: Frames | None,
    tagged: TaggedMesh,
    bodies: Bodies,
    space: fem.FunctionSpace,
    supports: Sequence[Support],
    facets: InterfaceFacets,
) -> tuple[VertexConstraints, dict[int, Floats]]:
    """Constraints of the vertices of interfaces by supports, and local axes by vertex; collective.

    Args:
        frames: Nodes with local axes; None if there are none.
        tagged: The mesh.
        bodies: Bodies of the scene.
        space: Space of the displacement.
        supports: All supports.
        facets: Facets of the interfaces.

    Returns:
        The constraints, and the local axes (3, 3) of vertices that have them.
    """
    tags = cell_tags(tagged)
    interface_vertices, first_corner = np.unique(facets.vertices, return_index=True)
    # Vertices, bodies and supports, starting with empty columns for a scene without supports.
    vertex_columns: list[Ints] = [np.zeros(0, dtype=np.int64)]
    body_columns: list[Ints] = [np.zeros(0, dtype=np.int64)]
    support_columns: list[Ints] = [np.zeros(0, dtype=np.int64)]
    for index, support in enumerate(supports):
        f = boundary_facets(tagged, support.boundary)
        corners = facet_nodes(tagged, space, f)[0].ravel()
        is_at_interface = np.isin(corners, interface_vertices)
        vertex_columns.append(corners[is_at_interface])
        body_columns.append(np.repeat(bodies.body_of_tag[tags[f.cells]], 3)[is_at_interface])
        support_columns.append(np.full(np.count_nonzero(is_at_interface), index))
    vertex, body, support_index = gathered_arrays(
        tagged.mesh.comm,
        np.concatenate(vertex_columns),
        np.concatenate(body_columns),
        np.concatenate(support_columns),
    )
    pairs, row = np.unique(np.stack([vertex, body], axis=1), axis=0, return_inverse=True)
    vertex, body = pairs.T
    support_of_component = np.full((len(pairs), 3), -1, dtype=np.int64)
    # A support active in every stage overrides one that is released.
    by_priority = sorted(range(len(supports)), key=lambda index: supports[index].stages is None)
    for index in by_priority:
        rows_of_support = row.ravel()[support_index == index]
        support_of_component[np.ix_(rows_of_support, supports[index].components)] = index
    axes: dict[int, Floats] = {}
    if frames is not None:
        dof_of_vertex = facets.dofs[:, :3].ravel()[first_corner]
        dof = dof_of_vertex[np.searchsorted(interface_vertices, vertex)]
        rows = np.flatnonzero(np.isin(dof, frames.node))
        frame_rows = np.searchsorted(frames.node, dof[rows])
        support_of_component[rows] = frames.support(frame_rows, body[rows], by_priority)
        for v, frame_row in zip(vertex[rows], frame_rows, strict=True):
            axes[int(v)] = frames.axes[frame_row]
    no_rigid = np.zeros(len(pairs), dtype=bool)
    return VertexConstraints(vertex, body, support_of_component, no_rigid), axes


def frames_of(
    scene: Scene, tagged: TaggedMesh, bodies: Bodies, space: fem.FunctionSpace
) -> Frames | None:
    """Nodes with local axes, or None if there are none; collective.

    Raises:
        InputError: A boundary is not smooth, or supports are incompatible at a node.
    """
    supports = scene.supports
    if not any(support.normal for support in supports):
        return None
    comm, tags = tagged.mesh.comm, cell_tags(tagged)
    nodes_of_supports: list[_BoundaryNodes] = []
    dofs_with_axes: list[Ints] = []
    for support in supports:
        nodes = _boundary_nodes(tagged, bodies, space, tags, support.boundary, scene.order)
        nodes_of_supports.append(nodes)
        if support.normal:
            dofs_with_axes.append(nodes.dof)
    node = np.unique(gathered_arrays(comm, np.concatenate(dofs_with_axes))[0])
    acts = np.zeros((len(node), len(bodies.names), len(supports)), dtype=bool)
    positions = np.zeros((len(node), 3))
    support_projectors = np.zeros((len(node), len(supports), 3, 3))
    for index, (support, nodes) in enumerate(zip(supports, nodes_of_supports, strict=True)):
        has_axes = np.isin(nodes.dof, node)
        dof, body, x, normals = gathered_arrays(
            comm,
            nodes.dof[has_axes],
            nodes.body[has_axes],
            nodes.x[has_axes],
            nodes.normals[has_axes],
        )
        row = np.searchsorted(node, dof)
        acts[row, body, index] = True
        positions[row] = x
        support_projectors[row, index] = np.diag(support.components)
        if support.normal:
            if isinstance(support.normal, tuple):
                directions = np.tile(support.normal, (len(x), 1))
            else:
                directions = _mean_normals(support, row, normals, positions)[row]
            support_projectors[row, index] = np.einsum("ni,nj->nij", directions, directions)
    axes = np.zeros((len(node), 3, 3))
    along = np.zeros((len(node), len(supports), 3), dtype=bool)
    # Nodes on the same supports are treated together.
    patterns, pattern_of_node = np.unique(acts.reshape(len(node), -1), axis=0, return_inverse=True)
    for pattern_number, pattern in enumerate(patterns.reshape(-1, *acts.shape[1:])):
        rows = np.flatnonzero(pattern_of_node.ravel() == pattern_number)
        groups = _groups(scene, pattern)
        axes[rows], along[rows] = _axes(supports, groups, support_projectors[rows], positions[rows])
    return Frames(node, axes, acts, along)


@dataclass(frozen=True)
class _BoundaryNodes:
    """Nodes of the facets of a boundary, repeated for each facet (m of them).

    Attributes:
        dof: Global blocked dof (m,).
        body: Body of the facet's cell (m,).
        x: Position (m, 3) [mm].
        normals: Normal of the facet at the node, weighted by the area of the facet (m, 3).
    """

    dof: Ints
    body: Ints
    x: Floats
    normals: Floats


def _boundary_nodes(
    tagged: TaggedMesh,
    bodies: Bodies,
    space: fem.FunctionSpace,
    tags: Ints,
    boundary: str,
    order: int,
) -> _BoundaryNodes:
    """Nodes of a boundary for a polynomial order; ``tags`` are those of all cells."""
    f = boundary_facets(tagged, boundary)
    nodes = NODES if order > 1 else NODES[:3]
    _, dofs, x, cell_centres = facet_nodes(tagged, space, f)
    body = np.broadcast_to(bodies.body_of_tag[tags[f.cells]][:, None], dofs.shape)
    positions = np.einsum("qn,fni->fqi", facet_shape_functions(nodes, x.shape[1]), x)
    normals = nodal_normals(x, cell_centres, nodes)
    return _BoundaryNodes(
        dofs.ravel(), body.ravel(), positions.reshape(-1, 3), normals.reshape(-1, 3)
    )


def _mean_normals(support: Support, row: Ints, normals: Floats, positions: Floats) -> Floats:
    """Mean normals of a boundary at nodes (n, 3), zero off the boundary.

    Args:
        support: Support on the boundary.
        row: Row of the node at each facet node (m,).
        normals: Normals at the facet nodes, weighted by the area of the facet (m, 3).
        positions: Positions of the nodes (n, 3) [mm].

    Raises:
        InputError: The boundary is not smooth.
    """
    sums = np.zeros(positions.shape)
    np.add.at(sums, row, normals)
    sizes = np.linalg.norm(sums, axis=1, keepdims=True)
    mean = np.divide(sums, sizes, out=np.zeros(sums.shape), where=sizes > 0)
    cosine_times_size = np.einsum("mi,mi->m", normals, mean[row])
    is_at_edge = cosine_times_size < SMOOTH * np.linalg.norm(normals, axis=1)
    if is_at_edge.any():
        raise InputError(
            f"supports.{support.name}: boundary '{support.boundary}' has an edge at "
            f"{point_text(positions[row[np.argmax(is_at_edge)]])}, where it has no unique normal; "
            "`normal: face` needs a smooth boundary, so use a separate support for each face"
        )
    return mean


def _groups(scene: Scene, acts: Bools) -> list[tuple[int, ...]]:
    """Sets of supports that are active on one body in one stage.

    ``acts`` is the mask of the supports that act on each body (bodies, supports).
    """
    groups: set[tuple[int, ...]] = set()
    for acts_on_body in acts:
        support_rows = [int(row) for row in np.flatnonzero(acts_on_body)]
        for stage in range(len(scene.stages)):
            active = (row for row in support_rows if scene.is_active(scene.supports[row], stage))
            groups.add(tuple(active))
    return sorted(groups - {()})


def _axes(
    supports: Sequence[Support],
    groups: list[tuple[int, ...]],
    support_projectors: Floats,
    x: Floats,
) -> tuple[Floats, Bools]:
    """Axes of nodes on the same supports (n, 3, 3), and masks of the axes that supports constrain.

    The axes are common eigenvectors of the projectors on all directions that a group constrains.

    Args:
        supports: All supports.
        groups: Sets of supports active on one body in one stage.
        support_projectors: Projectors on the constrained directions of each support
            (n, supports, 3, 3).
        x: Positions of the nodes (n, 3) [mm].

    Raises:
        InputError: There are no common axes, or displacements are incompatible.
    """
    if not groups:
        return np.eye(3)[None], np.zeros((1, 1, 3), dtype=bool)
    group_projectors = []
    for group in groups:
        values, vectors = np.linalg.eigh(support_projectors[:, group].sum(axis=1))
        group_projectors.append(projectors(vectors, values > SAME_DIRECTION))
    used = sorted(set().union(*groups))
    used_projectors = support_projectors[:, used]
    products = np.einsum("nsij,ntjk->nstik", used_projectors, used_projectors)
    asymmetry = np.abs(products - products.swapaxes(3, 4)).max(axis=(2, 3, 4))
    # The direction of a support that is oblique to another one is no axis.
    is_oblique = asymmetry > np.sqrt(SAME_DIRECTION)
    axis_projectors = np.where(is_oblique[:, :, None, None], 0.0, used_projectors)
    # Weights by multiples of the golden ratio keep the eigenvalues of different axes apart.
    golden = (1 + np.sqrt(5)) / 2
    terms = [*group_projectors, *axis_projectors.swapaxes(0, 1)]
    weighted_sum = sum((1 + (k * golden) % 1) * term for k, term in enumerate(terms, 1))
    _, axes = np.linalg.eigh(weighted_sum)
    names = "supports." + ", ".join(supports[row].name for row in used)
    for group_projector in group_projectors:
        in_axes = np.einsum("nic,nij,njd->ncd", axes, group_projector, axes)
        off_diagonal = in_axes * (1 - np.eye(3))
        has_no_axes = np.abs(off_diagonal).max(axis=(1, 2)) > np.sqrt(SAME_DIRECTION)
        if has_no_axes.any():
            raise InputError(
                f"{names}: at {point_text(x[np.argmax(has_no_axes)])} they hold several bodies, "
                "or one in several stages, along directions that are neither the same nor at right "
                "angles; use the same directions"
            )
    along = np.einsum("nic,nsij,njc->nsc", axes, support_projectors, axes) > SAME_DIRECTION
    _refuse_incompatible(supports, groups, support_projectors, axes, along, x, names)
    return axes, along


def _refuse_incompatible(
    supports: Sequence[Support],
    groups: list[tuple[int, ...]],
    support_projectors: Floats,
    axes: Floats,
    along: Bools,
    x: Floats,
    names: str,
) -> None:
    """Refuse incompatible displacements at a node.

    Args:
        supports: All supports.
        groups: Sets of supports active on one body in one stage.
        support_projectors: Projectors on the constrained directions (n, supports, 3, 3).
        axes: Axes of the nodes (n, 3, 3).
        along: Mask of the axes that a support constrains (n, supports, 3).
        x: Positions of the nodes (n, 3) [mm].
        names: Names of the supports for the message.

    Raises:
        InputError: Supports of one group prescribe different displacements along an axis.
    """
    displacements = {row: supports[row].values(x) for row in set().union(*groups)}
    largest = max(float(np.abs(values).max()) for values in displacements.values())
    if largest == 0:
        return
    for group in groups:
        # Displacements must agree at all times, so each load history is compared separately.
        for load_history in {supports[row].history for row in group}:
            prescribed = {
                row: displacements[row] * (supports[row].history == load_history) for row in group
            }
            # The last support along an axis gives its displacement.
            in_axes: Floats = np.zeros((len(x), 3))
            for row in group:
                components = np.einsum("nic,ni->nc", axes, prescribed[row])
                in_axes = np.where(along[:, row], components, in_axes)
            displacement = np.einsum("nic,nc->ni", axes, in_axes)
            for row in group:
                mismatch = np.einsum(
                    "nij,nj->ni", support_projectors[:, row], displacement - prescribed[row]
                )
                largest_mismatch = np.abs(mismatch).max(axis=1)
                if (largest_mismatch > SAME_DIRECTION * largest).any():
                    raise InputError(
                        f"{names}: contradict each other at "
                        f"{point_text(x[np.argmax(largest_mismatch)])}; "
                        "prescribe equal displacements, and zero where the directions are not at "
                        "right angles"
                    )
