"""Contact points of one rank, their committed state, and supports that are refused there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from app.arrays import Bools, Floats, Ints
from app.errors import InputError
from app.laws.supports import Support
from app.scene.bodies import Bodies
from app.scene.scene import Scene
from meshes.contact_facets import projectors
from meshes.contact_points import ContactPoints, Entries, Holds


@dataclass(frozen=True)
class OwnPoints:
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
        along: Projectors on the part of it that is tangential to all faces (n, 3, 3).
    """

    rows: Ints
    interface: Ints
    x: Floats
    bodies: Ints
    faces: Ints
    normals: Floats
    weight: Floats
    projector: Floats
    along: Floats

    @classmethod
    def of(cls, points: ContactPoints, rows: Ints) -> OwnPoints:
        """Select the points that a rank owns."""
        names = ("interface", "x", "bodies", "faces", "normals", "weight", "along")
        kept = {name: getattr(points, name)[rows] for name in names}
        return cls(rows=rows, projector=projectors(points.axes, points.held)[rows], **kept)

    def __len__(self) -> int:
        """Number of points."""
        return len(self.rows)

    def project_free(self, vectors: Floats) -> Floats:
        """Remove prescribed components from vectors (n, 3)."""
        return vectors - np.einsum("pij,pj->pi", self.projector, vectors)

    def tangential_held(self, vectors: Floats) -> Floats:
        """Prescribed components of vectors (n, 3) along which friction acts."""
        return np.asarray(np.einsum("pij,pj->pi", self.along, vectors))

    def acting(self, vectors: Floats) -> Floats:
        """Remove prescribed components in which the law has no say from vectors (n, 3)."""
        return self.project_free(vectors) + self.tangential_held(vectors)

    def tangential(self, vectors: Floats, faces: Bools) -> Floats:
        """Part of vectors (n, 3) tangential to some of the faces (n, 3)."""
        n = np.where(faces[:, :, None], self.normals, 0.0)
        return vectors - np.einsum("pik,pkj,pj->pi", np.linalg.pinv(n), n, vectors)


@dataclass
class ContactState:
    """Converged state of the contact points of this rank: committed, never half-updated.

    Attributes:
        jump: Jump (n, 3) [mm].
        force: Interface force per area, conjugate to the jump (n, 3) [MPa].
        friction: Friction part of the force (n, 3) [MPa].
        opening: Jump plus initial gap (n, 3) [mm].
        slip: Irreversible tangential motion, 0 where open (n, 3) [mm].
        path: Length of the path of sliding in contact (n,) [mm].
        stored: Energy stored by laws of interfaces (n,) [N mm].
        dissipation: Dissipation so far (n,) [N mm].
        least: Smallest dissipation of any step so far, 0 at most (n,) [N mm].
        contact_work: Work of the pressures in the opening so far (n,) [N mm].
        work: Work of the whole interface force in the jump so far (n,) [N mm].
        own: History of the laws of the interfaces, by name: (n, ...).
    """

    jump: Floats
    force: Floats
    friction: Floats
    opening: Floats
    slip: Floats
    path: Floats
    stored: Floats
    dissipation: Floats
    least: Floats
    contact_work: Floats
    work: Floats
    own: Mapping[str, Floats]

    @classmethod
    def at_rest(cls, gap: Floats, history: Mapping[str, tuple[int, ...]]) -> ContactState:
        """Unloaded state, for a gap (n, 3) and the shapes of the laws' history."""
        zero, none = np.zeros_like(gap), np.zeros(len(gap))
        own = {name: np.zeros((len(gap), *shape)) for name, shape in history.items()}
        return cls(zero, zero, zero, gap, zero, none, none, none, none, none, none, own)


def prescribed_jump(points: ContactPoints, number: int, support: Support) -> Floats:
    """Jump prescribed by a support at full amplitude, at all points (n, 3) [mm]."""
    master, slave = points.given[:, :, 0] == number, points.given[:, :, 1] == number
    sign = slave.astype(float) - master
    rows = np.flatnonzero(sign.any(axis=1))
    jump, axes = np.zeros(sign.shape), points.axes[rows]
    values = np.einsum("pic,pi->pc", axes, support.values(points.x[rows]))
    jump[rows] = np.einsum("pic,pc->pi", axes, sign[rows] * values)
    return jump


def refuse_supports(
    scene: Scene, bodies: Bodies, holds: Holds, points: ContactPoints, entries: Entries
) -> None:
    """Refuse supports that prescribe jumps in some stages only, or would move a rigid region.

    Raises:
        InputError: A support that is let go of holds a body where another one holds its neighbour,
            or one holds an elastic side where none holds the rigid one.
    """
    for s, support in enumerate(scene.supports):
        if support.stages is not None and (points.given == s).any():
            raise InputError(
                f"supports.{support.name}: it is let go of, but holds its body on an interface "
                "where the other side is held too; allowed: a boundary away from such edges, the "
                "same stages for both, or an elastic foundation instead of one of them"
            )
    # The nodes of a rigid region have no displacement of their own.
    rigid = {r.region for r in scene.rigid}
    for body in np.unique(entries.body):
        if rigid.issuperset(bodies.names[body].split(" + ")):
            point, component = np.divmod(entries.column[entries.body == body][0], 3)
            there = (holds.vertex == points.vertex[point]) & (holds.body != body)
            # Where a vertex has its own axes, entries are not those of one component.
            oblique = not np.array_equal(points.axes[point], np.eye(3))
            held = holds.support[there] if oblique else holds.support[there, component]
            support = scene.supports[held.max()]
            along = "" if oblique else f"along {'xyz'[component]} "
            x, y, z = points.x[point]
            raise InputError(
                f"supports.{support.name}: holds {along}what touches the rigid "
                f"region '{bodies.names[body]}' where none holds the region, at ({x:.4g}, {y:.4g}, "
                f"{z:.4g}) mm; allowed: the same components of both, e.g. a roller on the side of "
                "the region too"
            )
