"""Local axes of nodes on supports along other directions than x, y, z.

Such a node has three local axes, the same in every stage and for every body there; each support
constrains some of them. All other nodes have x, y, z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from dolfinx import fem
from dolfinx.common import IndexMap

from app.foundation.arrays import Bools, Floats, Ints
from app.foundation.errors import InputError
from app.interfaces.corners import VertexConstraints
from app.interfaces.faces import projectors
from app.interfaces.interface_facets import InterfaceFacets, gather
from app.laws.supports import Support
from app.scene.bodies import Bodies, boundary_facets, cell_tags, facet_nodes
from app.scene.scene import Scene
from app.system.layout import point_text
from meshes.distribute import TaggedMesh
from meshes.facets import NODES, nodal_normals, shape_functions

# Directions are equal within about a milliradian: squares of sines below this are zero.
ONE = 1e-6
# Least cosine between the normal of a facet and the nodal mean, on a smooth boundary.
SMOOTH = np.cos(np.radians(40.0))


@dataclass(frozen=True)
class Frames:
    """Nodes with local axes (n), replicated.

    Attributes:
        node: Global blocked dofs, rising (n,).
        axes: Axes as columns (n, 3, 3).
        acts: True where a support acts on a body at the node (n, bodies, supports).
        along: True where a support constrains an axis (n, supports, 3).
    """

    node: Ints
    axes: Floats
    acts: Bools
    along: Bools

    def owned(self, index_map: IndexMap) -> tuple[Ints, Ints]:
        """Local numbers of owned nodes, and their indices here."""
        low, high = index_map.local_range
        places = np.flatnonzero((self.node >= low) & (self.node < high))
        return self.node[places] - low, places

    def support(self, places: Ints, bodies: Ints | int, order: Sequence[int]) -> Ints:
        """Support that constrains each axis of bodies at nodes, -1 where none does (m, 3).

        Args:
            places: Indices of the nodes here (m,).
            bodies: The bodies (m,), or one.
            order: Active supports; later ones override earlier ones.
        """
        supports = np.full((len(places), 3), -1, dtype=np.int64)
        for s in order:
            supports[self.acts[places, bodies, s][:, None] & self.along[places, s]] = s
        return supports


def held_at(
    frames: Frames | None,
    tagged: TaggedMesh,
    bodies: Bodies,
    space: fem.FunctionSpace,
    supports: Sequence[Support],
    facets: InterfaceFacets,
) -> tuple[VertexConstraints, dict[int, Floats]]:
    """Supports at vertices of interfaces, by body, and local axes by vertex; collective."""
    tags = cell_tags(tagged)
    vertices, first = np.unique(facets.vertices, return_index=True)
    none = np.zeros(0, dtype=np.int64)
    entries: list[tuple[Ints, Ints, Ints]] = [(none, none, none)]
    for s, support in enumerate(supports):
        f = boundary_facets(tagged, support.boundary)
        corners = facet_nodes(tagged, space, f)[0].ravel()
        near = np.isin(corners, vertices)
        owners = np.repeat(bodies.of_tag[tags[f.cells]], 3)[near]
        entries.append((corners[near], owners, np.full(len(owners), s)))
    columns = map(np.concatenate, zip(*entries, strict=True))
    number, body, support_of = gather(tagged.mesh.comm, *columns)
    keys, row = np.unique(np.stack([number, body], axis=1), axis=0, return_inverse=True)
    vertex, body = keys.T
    support_of_component = np.full((len(keys), 3), -1, dtype=np.int64)
    # A support active in every stage overrides one that is released.
    order = sorted(range(len(supports)), key=lambda s: supports[s].stages is None)
    for s in order:
        support_of_component[np.ix_(row.ravel()[support_of == s], supports[s].components)] = s
    if frames is None:
        return VertexConstraints(
            vertex, body, support_of_component, np.zeros(len(keys), dtype=bool)
        ), {}
    dof = facets.dofs[:, :3].ravel()[first][np.searchsorted(vertices, vertex)]
    rows = np.flatnonzero(np.isin(dof, frames.node))
    places = np.searchsorted(frames.node, dof[rows])
    support_of_component[rows] = frames.support(places, body[rows], order)
    axes = {int(v): frames.axes[p] for v, p in zip(vertex[rows], places, strict=True)}
    return VertexConstraints(
        vertex, body, support_of_component, np.zeros(len(keys), dtype=bool)
    ), axes


def frames_of(
    scene: Scene, tagged: TaggedMesh, bodies: Bodies, space: fem.FunctionSpace
) -> Frames | None:
    """Find the nodes with local axes; None if there are none; collective.

    Raises:
        InputError: A boundary is not smooth, or supports are incompatible at a node.
    """
    supports = scene.supports
    if not any(s.normal for s in supports):
        return None
    comm, tags = tagged.mesh.comm, cell_tags(tagged)
    at = NODES[: 3 + 3 * (scene.order > 1)]
    facets = []
    for s in supports:
        f = boundary_facets(tagged, s.boundary)
        _, dofs, x, inside = facet_nodes(tagged, space, f)
        body = np.broadcast_to(bodies.of_tag[tags[f.cells]][:, None], dofs.shape)
        place = np.einsum("qn,fni->fqi", shape_functions(at, x.shape[1]), x)
        n = nodal_normals(x, inside, at)
        facets.append((dofs.ravel(), body.ravel(), place.reshape(-1, 3), n.reshape(-1, 3)))
    near = np.concatenate([f[0] for f, s in zip(facets, supports, strict=True) if s.normal])
    node = np.unique(gather(comm, near)[0])
    acts = np.zeros((len(node), len(bodies.names), len(supports)), dtype=bool)
    places = np.zeros((len(node), 3))
    support_projectors = np.zeros((len(node), len(supports), 3, 3))
    for k, (s, rows) in enumerate(zip(supports, facets, strict=True)):
        is_local_axis_node = np.isin(rows[0], node)
        dof, body, x, n = gather(comm, *(r[is_local_axis_node] for r in rows))
        at_node = np.searchsorted(node, dof)
        acts[at_node, body, k] = True
        places[at_node] = x
        support_projectors[at_node, k] = np.diag(s.components)
        if s.normal:
            has_given_direction = isinstance(s.normal, tuple)
            d = (
                np.tile(s.normal, (len(x), 1))
                if has_given_direction
                else _means(s, at_node, n, places)[at_node]
            )
            support_projectors[at_node, k] = np.einsum("ni,nj->nij", d, d)
    axes, along = np.zeros((len(node), 3, 3)), np.zeros((len(node), len(supports), 3), dtype=bool)
    patterns, pattern_of_node = np.unique(acts.reshape(len(node), -1), axis=0, return_inverse=True)
    for p, pattern in enumerate(patterns.reshape(-1, *acts.shape[1:])):
        nodes = np.flatnonzero(pattern_of_node.ravel() == p)
        axes[nodes], along[nodes] = _axes(
            supports, _groups(scene, pattern), support_projectors[nodes], places[nodes]
        )
    return Frames(node, axes, acts, along)


def _means(support: Support, node: Ints, normals: Floats, places: Floats) -> Floats:
    """Mean normals of a boundary at nodes (n, 3), zero off the boundary.

    Args:
        support: Support on the boundary.
        node: Node of each corner of its facets (m,).
        normals: Normals there, weighted by the area of the facet (m, 3).
        places: Coordinates of the nodes (n, 3) [mm].

    Raises:
        InputError: The boundary is not smooth.
    """
    sums = np.zeros(places.shape)
    np.add.at(sums, node, normals)
    sizes = np.linalg.norm(sums, axis=1, keepdims=True)
    mean = np.divide(sums, sizes, out=np.zeros(sums.shape), where=sizes > 0)
    flat = np.einsum("mi,mi->m", normals, mean[node]) < SMOOTH * np.linalg.norm(normals, axis=1)
    if flat.any():
        raise InputError(
            f"supports.{support.name}: boundary '{support.boundary}' has an edge at "
            f"{point_text(places[node[np.argmax(flat)]])}, where it has no unique normal; "
            "`normal: face` needs a smooth boundary, so use a separate support for each face"
        )
    return mean


def _groups(scene: Scene, acts: Bools) -> list[tuple[int, ...]]:
    """Sets of supports active on one body in one stage; `acts` is (bodies, supports)."""
    stages = range(len(scene.stages))
    groups = {
        tuple(int(s) for s in np.flatnonzero(of_body) if scene.holds(scene.supports[s], k))
        for of_body in acts
        for k in stages
    }
    return sorted(groups - {()})


def _axes(
    supports: Sequence[Support],
    groups: list[tuple[int, ...]],
    support_projectors: Floats,
    x: Floats,
) -> tuple[Floats, Bools]:
    """Axes of nodes on the same supports (n, 3, 3), and whether each support constrains them.

    Args:
        supports: All supports.
        groups: Sets of supports active on one body in one stage.
        support_projectors: Projectors on the constrained directions of each support
            (n, supports, 3, 3).
        x: Coordinates of the nodes (n, 3) [mm].

    Raises:
        InputError: There are no common axes, or displacements are incompatible.
    """
    if not groups:
        return np.eye(3)[None], np.zeros((1, 1, 3), dtype=bool)
    spans = []
    for group in groups:
        values, vectors = np.linalg.eigh(support_projectors[:, group].sum(axis=1))
        spans.append(projectors(vectors, values > ONE))
    used = sorted({s for group in groups for s in group})
    of_used = support_projectors[:, used]
    products = np.einsum("nsij,ntjk->nstik", of_used, of_used)
    skew = np.abs(products - products.swapaxes(3, 4)).max(axis=(2, 3, 4)) > np.sqrt(ONE)
    # Any weights that keep the eigenvalues of different axes apart.
    parts = [*spans, *np.where(skew[:, :, None, None], 0.0, of_used).swapaxes(0, 1)]
    golden = (1 + np.sqrt(5)) / 2
    total = sum((1 + (k * golden) % 1) * part for k, part in enumerate(parts, 1))
    _, axes = np.linalg.eigh(total)
    names = "supports." + ", ".join(supports[s].name for s in used)
    for span in spans:
        inside = np.einsum("nic,nij,njd->ncd", axes, span, axes) * (1 - np.eye(3))
        wrong = np.abs(inside).max(axis=(1, 2)) > np.sqrt(ONE)
        if wrong.any():
            raise InputError(
                f"{names}: at {point_text(x[np.argmax(wrong)])} they hold several bodies, or one "
                "in several stages, along directions that are neither the same nor at right "
                "angles; use the same directions"
            )
    along = np.einsum("nic,nsij,njc->nsc", axes, support_projectors, axes) > ONE
    _refuse_unlike(supports, groups, support_projectors, axes, along, x, names)
    return axes, along


def _refuse_unlike(
    supports: Sequence[Support],
    groups: list[tuple[int, ...]],
    support_projectors: Floats,
    axes: Floats,
    along: Bools,
    x: Floats,
    names: str,
) -> None:
    """Refuse incompatible displacements at a node."""
    displacements = {s: supports[s].values(x) for group in groups for s in group}
    size = max(float(np.abs(values).max()) for values in displacements.values())
    for group in groups if size else ():
        for load_history in {supports[s].history for s in group}:
            prescribed = {
                s: displacements[s] * (supports[s].history == load_history) for s in group
            }
            # The last to hold an axis gives its displacement.
            motion: Floats = np.zeros((len(x), 3))
            for s in group:
                motion = np.where(along[:, s], np.einsum("nic,ni->nc", axes, prescribed[s]), motion)
            for s in group:
                mismatch = np.einsum("nic,nc->ni", axes, motion) - prescribed[s]
                wrong = np.abs(np.einsum("nij,nj->ni", support_projectors[:, s], mismatch)).max(
                    axis=1
                )
                if (wrong > ONE * size).any():
                    raise InputError(
                        f"{names}: contradict each other at {point_text(x[np.argmax(wrong)])}; "
                        "prescribe equal displacements, and zero where the directions are not at "
                        "right angles"
                    )
