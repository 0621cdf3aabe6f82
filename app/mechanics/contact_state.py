"""Contact points of one rank, their committed state, and supports that are refused there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from app.foundation.arrays import Bools, Floats, Ints
from app.foundation.errors import InputError
from app.interfaces.corners import BY_RIGID_REGION, ContactPoints, VertexConstraints
from app.interfaces.faces import projectors
from app.interfaces.interface_facets import InterfaceFacets, gathered_arrays
from app.laws.supports import Support
from app.mechanics.body_forms import BodyForms
from app.mechanics.constraints import Constraints
from app.scene.bodies import Bodies, cell_tags, touched_nodes
from app.scene.scene import Scene


@dataclass(frozen=True)
class LocalPoints:
    """Contact points of this rank (n of them).

    Attributes:
        rows: Their rows among the points of all ranks (n,).
        interface: Index of the interface (n,).
        x: Position (n, 3) [mm].
        bodies: Bodies (master, slave) (n, 2).
        faces: Number of faces (n,).
        normals: Unit normals of the faces, zero beyond ``faces`` (n, 3, 3).
        weight: Area (n,) [mm2].
        projector: Projectors on the part of the jump that supports prescribe (n, 3, 3).
        prescribed_tangents: Projectors on the prescribed part that is tangential to all faces
            (n, 3, 3).
    """

    rows: Ints
    interface: Ints
    x: Floats
    bodies: Ints
    faces: Ints
    normals: Floats
    weight: Floats
    projector: Floats
    prescribed_tangents: Floats

    @classmethod
    def of(cls, points: ContactPoints, rows: Ints) -> LocalPoints:
        """Select the points that a rank owns."""
        attribute_names = (
            "interface",
            "x",
            "bodies",
            "faces",
            "normals",
            "weight",
            "prescribed_tangents",
        )
        attributes = {name: getattr(points, name)[rows] for name in attribute_names}
        return cls(
            rows=rows, projector=projectors(points.axes, points.is_prescribed)[rows], **attributes
        )

    def __len__(self) -> int:
        """Number of points."""
        return len(self.rows)

    @property
    def free_projector(self) -> Floats:
        """Projectors on the part of the jump that no support prescribes (n, 3, 3)."""
        return np.eye(3) - self.projector

    @property
    def is_face(self) -> Bools:
        """True for the faces that a point has (n, 3)."""
        return np.arange(3) < self.faces[:, None]

    def along_normals(self, vectors: Floats) -> Floats:
        """Return the components of vectors (n, 3) along the normals of the faces (n, 3)."""
        return np.asarray(np.einsum("pi,pki->pk", vectors, self.normals))

    def project_free(self, vectors: Floats) -> Floats:
        """Remove prescribed components from vectors (n, 3)."""
        return vectors - np.einsum("pij,pj->pi", self.projector, vectors)

    def prescribed_tangential(self, vectors: Floats) -> Floats:
        """Return the prescribed tangential components of vectors (n, 3): friction acts there."""
        return np.asarray(np.einsum("pij,pj->pi", self.prescribed_tangents, vectors))

    def acting(self, vectors: Floats) -> Floats:
        """Remove prescribed components in which the law does not act from vectors (n, 3)."""
        return self.project_free(vectors) + self.prescribed_tangential(vectors)

    def tangential(self, vectors: Floats, faces: Bools, rows: Ints | slice = slice(None)) -> Floats:
        """Part of vectors (n, 3) tangential to some of the faces (n, 3), at all points or rows."""
        n = np.where(faces[:, :, None], self.normals[rows], 0.0)
        return vectors - np.einsum("pik,pkj,pj->pi", np.linalg.pinv(n), n, vectors)


@dataclass
class ContactState:
    """Converged state of the contact points of this rank.

    Attributes:
        jump: Jump (n, 3) [mm].
        jump_at_insertion: Jump when the gap of press fits last changed (n, 3) [mm].
        force: Interface force per area, conjugate to the jump (n, 3) [MPa].
        friction: Friction part of the force (n, 3) [MPa].
        gap_vector: Gap vector G, the jump plus the initial gap (n, 3) [mm].
        slip: Slip (n, 3) [mm]; `mechanics.contact.TrialState.slip` defines it.
        step_slip: Length of sliding in contact in the last step (n,) [mm].
        path: Length of the path of sliding in contact (n,) [mm].
        stored: Energy stored by laws of interfaces (n,) [N mm].
        dissipation: Dissipation so far (n,) [N mm].
        smallest_dissipation: Smallest dissipation of any step so far, 0 at most (n,) [N mm].
        contact_work: Work of the pressures in the opening so far (n,) [N mm].
        work: Work of the whole interface force in the jump so far (n,) [N mm].
        internal_variables: Internal variables of the laws, by name: (n, ...).
    """

    jump: Floats
    jump_at_insertion: Floats
    force: Floats
    friction: Floats
    gap_vector: Floats
    slip: Floats
    step_slip: Floats
    path: Floats
    stored: Floats
    dissipation: Floats
    smallest_dissipation: Floats
    contact_work: Floats
    work: Floats
    internal_variables: Mapping[str, Floats]

    @classmethod
    def at_rest(cls, n: int, shapes: Mapping[str, tuple[int, ...]]) -> ContactState:
        """Unloaded state of n points without initial gap.

        Args:
            n: Number of points.
            shapes: Shapes of the internal variables of the laws, by name.
        """

        # Each field gets a new array, so that an in-place change of one leaves the others.
        def vectors() -> Floats:
            return np.zeros((n, 3))

        def scalars() -> Floats:
            return np.zeros(n)

        return cls(
            jump=vectors(),
            jump_at_insertion=vectors(),
            force=vectors(),
            friction=vectors(),
            gap_vector=vectors(),
            slip=vectors(),
            step_slip=scalars(),
            path=scalars(),
            stored=scalars(),
            dissipation=scalars(),
            smallest_dissipation=scalars(),
            contact_work=scalars(),
            work=scalars(),
            internal_variables={name: np.zeros((n, *shape)) for name, shape in shapes.items()},
        )


def prescribed_jump(
    points: ContactPoints, rows: Ints, number: int, support: Support, rigid_displacement: Floats
) -> Floats:
    """Jump prescribed by a support at full amplitude, at local points (n, 3) [mm].

    Args:
        points: All points.
        rows: Local points (n,).
        number: Index of the support in the scene.
        support: The support.
        rigid_displacement: Displacement of the nodes of local points on rigid regions, as the
            support prescribes it (n, 3) [mm].
    """
    prescribing_support, x = points.prescribing_support[rows], points.x[rows]
    jump = np.zeros(x.shape)
    for side, sign in ((0, -1.0), (1, 1.0)):  # master, slave
        for index in (number, BY_RIGID_REGION):
            is_prescribed = prescribing_support[:, :, side] == index
            held = np.flatnonzero(is_prescribed.any(axis=1))
            if not len(held):
                continue
            displacement = (
                rigid_displacement[held] if index == BY_RIGID_REGION else support.values(x[held])
            )
            axes = points.axes[rows][held]
            components = np.einsum("pic,pi->pc", axes, displacement)
            components = np.where(is_prescribed[held], components, 0.0)
            jump[held] += sign * np.einsum("pic,pc->pi", axes, components)
    return jump


def with_rigid_regions(
    body_forms: BodyForms,
    constraints: Sequence[Constraints],
    facets: InterfaceFacets,
    holds: VertexConstraints,
    axes: Mapping[int, Floats],
) -> VertexConstraints:
    """Return supports at vertices of interfaces, on rigid regions too; collective.

    A rigid region is held at a vertex if its supports, wherever they are, prescribe the motion of
    the vertex under all constraints.
    """
    scene, bodies, space = body_forms.scene, body_forms.bodies, body_forms.space
    tags, first_owned = cell_tags(body_forms.tagged), space.dofmap.index_map.local_range[0]
    dof, first = np.unique(facets.dofs[:, :3], return_index=True)
    vertex = facets.vertices.ravel()[first]
    all_holds = [(holds.vertex, holds.body, holds.support, holds.rigid)]
    for rigid in scene.rigid:
        region = rigid.region
        region_nodes = np.flatnonzero(
            touched_nodes(space, tags == body_forms.tagged.regions[region])
        )
        rigid_vertices = np.flatnonzero(np.isin(dof, region_nodes + first_owned))
        local_axes = [axes.get(int(v), np.eye(3)) for v in vertex[rigid_vertices]]
        axes_of_vertices = np.array(local_axes).reshape(-1, 3, 3)
        is_prescribed = np.ones((len(rigid_vertices), 3), dtype=bool)
        for stage_constraints in constraints:
            is_prescribed &= stage_constraints.prescribed_components(
                dof[rigid_vertices] - first_owned, axes_of_vertices
            )
        body = np.full(len(rigid_vertices), bodies.body_of_region[region])
        support = np.where(is_prescribed, BY_RIGID_REGION, -1)
        rows = vertex[rigid_vertices], body, support, np.ones(len(rigid_vertices), dtype=bool)
        vertices, body_numbers, supports, is_rigid = gathered_arrays(body_forms.mesh.comm, *rows)
        all_holds.append((vertices, body_numbers, supports, is_rigid))
    # A rigid region replaces supports of its body at the same vertex.
    columns = [np.concatenate(column) for column in zip(*reversed(all_holds), strict=True)]
    sides = np.column_stack(columns[:2])
    first_rows = np.unique(sides, axis=0, return_index=True)[1]
    return VertexConstraints(*(column[first_rows] for column in columns))


def refuse_supports_of_free_regions(
    scene: Scene,
    bodies: Bodies,
    holds: VertexConstraints,
    facets: InterfaceFacets,
    axes: Mapping[int, Floats],
) -> None:
    """Refuse supports of an elastic body at a point of a rigid region that is free there.

    Raises:
        InputError: There is such a support; the message has the first one and its place.
    """
    for row in np.flatnonzero(holds.rigid):
        at_vertex = (holds.vertex == holds.vertex[row]) & ~holds.rigid
        holding_supports = np.where(
            holds.support[row] < 0, holds.support[at_vertex].max(axis=0, initial=-1), -1
        )
        if not (holding_supports >= 0).any():
            continue
        component = int(np.argmax(holding_supports >= 0))
        # At a vertex with local axes components are not along x, y, z.
        oblique = int(holds.vertex[row]) in axes
        direction_text = "" if oblique else f"along {'xyz'[component]} "
        facet_row = np.flatnonzero(facets.vertices.ravel() == holds.vertex[row])[0]
        x, y, z = facets.x.reshape(-1, 3)[facet_row]
        raise InputError(
            f"supports.{scene.supports[holding_supports[component]].name}: "
            f"holds {direction_text}a body that touches "
            f"the rigid region '{bodies.names[holds.body[row]]}' "
            f"at ({x:.4g}, {y:.4g}, {z:.4g}) mm, "
            "where the region is free; hold the region in the same direction in all stages"
        )


def refuse_supports(scene: Scene, points: ContactPoints) -> None:
    """Refuse supports that prescribe jumps in some stages only.

    Raises:
        InputError: A support of some stages holds a body where another one holds its neighbour.
    """
    for s, support in enumerate(scene.supports):
        if support.stages is not None and (points.prescribing_support == s).any():
            raise InputError(
                f"supports.{support.name}: is released in some stages, but holds an interface "
                "whose other side is held too; use a boundary away from the interface, the same "
                "stages for both supports, or an elastic foundation instead of one of them"
            )
