r"""Surfaces that follow deformable ones they slide on: rows of displacements in terms of others.

The slave's nodes of a sliding interface follow the master's surface,

.. math:: u_s = Π R u_m + q, \qquad U = G P_0 ũ + B q,

with Π the dual mortar matrix of the current pairs (`mechanics.pairs`), R the rotation of the
master, in whose own axes u_m is, and G the identity but for nodes that follow. Both surfaces are
linear between vertices: the middle of an edge follows its ends. Displacements, those of a driven
boundary too, are along the axes of their body.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from petsc4py import PETSc

import numpy as np
from dolfinx import fem

from app.foundation.arrays import Floats, Ints
from app.foundation.errors import InputError
from app.mechanics.body_forms import BodyForms
from app.mechanics.pairs import Pairs, SmoothSurface, mortar, oriented
from app.numerics.sparse import from_triplets
from app.scene.bodies import (
    boundary_facets,
    cell_tags,
    facet_nodes,
    facets_by_body,
    nodes_on,
    touched_nodes,
)
from app.scene.scene import Interface, Scene
from meshes.contact_facets import bends, gather
from meshes.distribute import TaggedMesh

# Points further from the master than this part of an edge have rows of shape functions.
REACH = 0.1


@dataclass(frozen=True)
class Side:
    """Surface of a body at a sliding interface, replicated.

    Attributes:
        dofs: Global blocked dofs of its vertices (n,), which are in the order of their numbers.
        x: Their positions (n, 3) [mm].
        triangles: Vertices of its facets, counterclockwise seen from outside (f, 3).
        outward: A vector out of the body for each facet (f, 3).
        edges: Dof of the middle of each edge, and its two vertices (e, 3); none at first order.
        halves: What the middles take of the displacements of their vertices (2, e, 3, 3).
    """

    dofs: Ints
    x: Floats
    triangles: Ints
    outward: Floats
    edges: Ints
    halves: Floats

    @classmethod
    def of(cls, tagged: TaggedMesh, space: fem.FunctionSpace, boundary: str) -> Side:
        """Gather a boundary on every rank; collective."""
        f = facet_nodes(tagged, space, boundary_facets(tagged, boundary))
        numbers, dofs, x, inside = gather(tagged.mesh.comm, *f)
        # The same on any number of ranks.
        order = np.lexsort(np.sort(numbers, axis=1).T)
        numbers, dofs, x, inside = numbers[order], dofs[order], x[order], inside[order]
        _, first, of = np.unique(numbers, return_index=True, return_inverse=True)
        vertices, triangles = dofs[:, :3].ravel()[first], of.reshape(-1, 3)
        # The middle of an edge of a facet is opposite its vertex of the same number.
        ends = triangles[:, [[1, 2], [2, 0], [0, 1]]]
        edges = np.concatenate([dofs[:, 3:, None], ends[:, : dofs.shape[1] - 3]], axis=2)
        _, one = np.unique(edges[..., 0], return_index=True)
        edges, middle = edges.reshape(-1, 3)[one], x[:, 3:].reshape(-1, 3)
        outward, x = x[:, 0] - inside, x[:, :3].reshape(-1, 3)[first]
        a, b = x[edges[:, 1:]].transpose(1, 0, 2)
        bend = bends(a, b, middle[one] if len(middle) else (a + b) / 2)
        halves = np.eye(3) / 2 + np.stack([-bend, bend])
        return cls(vertices, x, oriented(x, triangles, outward), outward, edges, halves)

    @cached_property
    def smooth(self) -> SmoothSurface:
        """The smooth surface that it approximates."""
        return SmoothSurface(self.x, self.triangles, self.outward)


def soft(scene: Scene) -> dict[int, Interface]:
    """Interfaces that slide far on deformable bodies, by number."""
    contacts = enumerate(scene.contacts)
    return {i: c for i, c in contacts if c.between and not scene.is_rigid(c)}


def refuse_motions(mechanics: BodyForms) -> None:
    """Refuse motions of elastic regions that nothing follows, and loads that would turn with them.

    Raises:
        InputError: There is one; collective.
    """
    scene, bodies = mechanics.scene, mechanics.bodies
    for m in scene.driven:
        if not any(m.region in c.master for c in soft(scene).values()):
            raise InputError(
                f"motions.{m.name}.region: {m.region} is elastic, and nothing softer slides far on "
                "it; expected the stiffer side of an interface with `sliding: finite`"
            )
        body = bodies.of_region[m.region]
        for load in scene.loads:
            on: set[int] = set()
            if load.volume_regions is not None:
                on |= {bodies.of_region[r] for r in load.volume_regions or bodies.of_region}
            for boundary in load.boundaries:
                if boundary != m.boundary:
                    on |= set(facets_by_body(mechanics.tagged, bodies, boundary))
            if load.fixed_in_space and body in on:
                raise InputError(
                    f"loads.{load.name}: acts on {m.region}, which turns; expected forces on "
                    f"'{m.boundary}' alone, or pressures"
                )


class Followers:
    """Slaves of interfaces that slide far on deformable bodies; made collectively.

    Attributes:
        sides: Master and slave of each such interface, by its number.
        slaves: Body and own nodes of the slave of each interface.
        masters: Own vertices of the masters.
        following: Global dofs without unknowns of their own, rising (n,).
        turning: Own nodes of each body that turns, and those of its driven boundary, by motion.
        rotations: Rotation of each of them (3, 3).
        pairs: Rows of Π of each interface.
        changed: Whether they have changed since `matrix`.
    """

    def __init__(self, mechanics: BodyForms) -> None:
        scene, tagged, bodies = mechanics.scene, mechanics.tagged, mechanics.bodies
        space, interfaces = mechanics.space, soft(scene)
        self._scene, nodes = scene, space.dofmap.index_map.size_local
        self._comm, self._map = tagged.mesh.comm, space.dofmap.index_map
        self.sides: dict[int, tuple[Side, Side]] = {}
        for i, c in interfaces.items():
            assert c.between is not None
            master, slave = (Side.of(tagged, space, name) for name in c.between)
            self.sides[i] = master, slave
        parts = [(s.dofs, s.edges[:, 0], m.edges[:, 0]) for m, s in self.sides.values()]
        self.following = np.unique(np.concatenate([dofs for part in parts for dofs in part]))
        self.slaves = [
            (bodies.of_region[c.slave[0]], self._own(np.concatenate([s.dofs, s.edges[:, 0]])))
            for c, (_, s) in zip(interfaces.values(), self.sides.values(), strict=True)
        ]
        self.masters = self._own(np.concatenate([m.dofs for m, _ in self.sides.values()]))
        self.changed = True
        self.turning: dict[str, tuple[Ints, Ints]] = {}
        for m in scene.driven:
            of_body = bodies.of_tag[cell_tags(tagged)] == bodies.of_region[m.region]
            own = np.flatnonzero(touched_nodes(space, of_body))
            driven = nodes_on(tagged, space, str(m.boundary))
            self.turning[m.name] = own, driven[driven < nodes]
        motions = {i: scene.motion_of(c.master) for i, c in interfaces.items()}
        self._motions = {i: m.name if m else "" for i, m in motions.items()}
        self.rotations: dict[str, Floats] = dict.fromkeys(("", *self.turning), np.eye(3))
        self.pairs: dict[int, Pairs] = {}
        for i, (_, slave) in self.sides.items():
            self.pair(i, slave.x)

    def begin(self, scene: Scene) -> None:
        """Set the motions of a run."""
        self._scene = scene

    def pair(self, i: int, x: Floats) -> None:
        """Pair an interface, its slave's vertices at x in the master's axes (n, 3) [mm]."""
        master, slave = self.sides[i]
        edge = np.linalg.norm(np.diff(slave.x[slave.triangles[:, :2]], axis=1), axis=2).mean()
        points = getattr(self._scene.contacts[i].law, "quadrature", None) or 12
        found = mortar(x, slave.triangles, master.smooth, points, REACH * float(edge))
        before = self.pairs.get(i)
        if before:
            parts = zip(found[:3], before[:3], strict=True)
            self.changed |= not all(np.array_equal(a, b) for a, b in parts)
        self.pairs[i] = found

    def _own(self, dofs: Ints) -> Ints:
        """Local numbers of the own nodes among global dofs."""
        low, high = self._map.local_range
        return dofs[(dofs >= low) & (dofs < high)] - low

    @property
    def own_following(self) -> Ints:
        """Local own nodes that follow others."""
        return self._own(self.following)

    def set_time(self, time: float) -> None:
        """Turn the bodies to a time."""
        for m in self._scene.driven:
            R, before = self._scene.rotation(m, time), self.rotations[m.name]
            self.changed |= not np.array_equal(R, before)
            self.rotations[m.name] = R

    def without_motion(self, nodal: Floats) -> tuple[Floats, dict[str, Floats]]:
        """Displacements of own nodes (n, 3) less their bodies' translations, and these (3,) [mm].

        The translations are in space; collective.
        """
        rest, ways = nodal.copy(), {}
        for name, (own, driven) in self.turning.items():
            R = self.rotations[name]
            total = self._comm.allreduce(np.append(nodal[driven].sum(axis=0), len(driven)))
            ways[name] = R @ total[:3] / total[3]
            rest[own] -= R.T @ ways[name]
        return rest, ways

    def totals(self, forces: Floats) -> dict[str, Floats]:
        """Sum of forces on nodes of each body that turns (3,), along axes of space; collective."""
        return {
            name: self._comm.allreduce(self.rotations[name] @ forces[own].sum(axis=0))
            for name, (own, _) in self.turning.items()
        }

    def with_motion(self, rest: Floats, ways: Mapping[str, Floats]) -> Floats:
        """Displacements of own nodes (n, 3) with translations as of `without_motion`."""
        nodal = rest.copy()
        for name, (own, _) in self.turning.items():
            nodal[own] += self.rotations[name].T @ ways[name]
        return nodal

    def following_driven(self, nodal: Floats) -> Floats:
        """Displacements (n, 3) [mm] with bodies that turn moved as their driven boundaries."""
        rest, ways = nodal.copy(), self.without_motion(nodal)[1]
        for own, _ in self.turning.values():
            rest[own] = 0
        return self.with_motion(rest, ways)

    def only(self, nodal: Floats) -> Floats:
        """Vectors at own nodes (3 nodes), zero but where they follow others."""
        rows, found = self.own_following, np.zeros_like(nodal)
        found.reshape(-1, 3)[rows] = nodal.reshape(-1, 3)[rows]
        return found

    def handed(self, nodal: Floats) -> Floats:
        """Forces (3 nodes) [N] that own nodes hand to those that they follow; collective."""
        sums = self._G.createVecLeft()
        only = PETSc.Vec().createWithArray(self.only(nodal).ravel(), comm=self._comm)
        self._G.multTranspose(only, sums)
        return np.asarray(sums.array_r.reshape(nodal.shape))

    def in_space(self, nodal: Floats) -> Floats:
        """Vectors at own nodes (3 nodes), from the axes of their bodies to those of space."""
        found = nodal.copy()
        vectors = found.reshape(-1, 3)
        for name, (own, _) in self.turning.items():
            vectors[own] = vectors[own] @ self.rotations[name].T
        return found

    def places(self, x: Floats) -> Floats:
        """Positions of own nodes (n, 3) [mm], turned."""
        found = x.copy()
        for m in self._scene.driven:
            own, about = self.turning[m.name][0], np.array(m.about)
            found[own] = about + (x[own] - about) @ self.rotations[m.name].T
        return found

    def matrix(self) -> PETSc.Mat:
        """G, from displacements of nodes that follow none to those of all; collective."""
        self.changed = False
        low, high = self._map.local_range
        own = np.setdiff1d(np.arange(low, high), self.following)
        rows, columns, blocks = [own], [own], [np.broadcast_to(np.eye(3), (len(own), 3, 3))]

        def add(row: Ints, column: Ints, block: Floats) -> None:
            here = (row >= low) & (row < high)
            for part, values in zip((rows, columns, blocks), (row, column, block), strict=True):
                part.append(values[here])

        for i, (master, slave) in self.sides.items():
            pairs, R = self.pairs[i], self.rotations[self._motions[i]]
            blocks_of = pairs.values[:, None, None] * R
            at = master.dofs[pairs.columns]
            add(slave.dofs[pairs.rows], at, blocks_of)
            # Middles of the slave's edges: half of the rows of either end, about.
            count = np.bincount(pairs.rows, minlength=len(slave.dofs))
            begin = np.cumsum(count) - count
            for end in (1, 2):
                add(master.edges[:, 0], master.dofs[master.edges[:, end]], master.halves[end - 1])
                of = slave.edges[:, end]
                edge = np.repeat(np.arange(len(of)), count[of])
                entry = np.arange(len(edge)) + np.repeat(
                    begin[of] - (np.cumsum(count[of]) - count[of]), count[of]
                )
                half = slave.halves[end - 1, edge]
                add(slave.edges[edge, 0], at[entry], half @ blocks_of[entry])
        row, column = np.concatenate(rows), np.concatenate(columns)
        block: Floats = np.concatenate(blocks)
        k, i3, j3 = np.nonzero(block)  # most blocks are multiples of the identity
        size = 3 * (high - low)
        self._G = from_triplets(
            self._comm, size, size, 3 * (row[k] - low) + i3, 3 * column[k] + j3, block[k, i3, j3]
        )
        return self._G
