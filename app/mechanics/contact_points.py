"""Contact points of one rank; supports that make their jumps impossible are refused."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.arrays import Bools, Floats, Ints
from app.errors import InputError
from app.laws.supports import Support
from app.scene.bodies import Bodies
from app.scene.scene import Scene
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
    """

    rows: Ints
    interface: Ints
    x: Floats
    bodies: Ints
    faces: Ints
    normals: Floats
    weight: Floats
    projector: Floats

    @classmethod
    def of(cls, points: ContactPoints, rows: Ints) -> OwnPoints:
        """Select the points that a rank owns."""
        return cls(
            rows=rows,
            interface=points.interface[rows],
            x=points.x[rows],
            bodies=points.bodies[rows],
            faces=points.faces[rows],
            normals=points.normals[rows],
            weight=points.weight[rows],
            projector=points.held_part[rows],
        )

    def __len__(self) -> int:
        """Number of points."""
        return len(self.rows)

    def project_free(self, vectors: Floats) -> Floats:
        """Remove prescribed components from vectors (n, 3)."""
        return vectors - np.einsum("pij,pj->pi", self.projector, vectors)

    def tangential(self, vectors: Floats, faces: Bools) -> Floats:
        """Part of vectors (n, 3) tangential to some of the faces (n, 3)."""
        n = np.where(faces[:, :, None], self.normals, 0.0)
        return vectors - np.einsum("pik,pkj,pj->pi", np.linalg.pinv(n), n, vectors)


def prescribed_jump(points: ContactPoints, number: int, support: Support) -> Floats:
    """Jump prescribed by a support at full amplitude, at all points (n, 3) [mm]."""
    master, slave = points.given[:, :, 0] == number, points.given[:, :, 1] == number
    sign = slave.astype(float) - master
    rows = np.flatnonzero(sign.any(axis=1))
    jump, axes = np.zeros(sign.shape), points.axes[rows]
    values = np.einsum("pic,pi->pc", axes, support.values(points.x[rows]))
    jump[rows] = np.einsum("pic,pc->pi", axes, sign[rows] * values)
    return jump


def refuse_released(supports: Sequence[Support], points: ContactPoints) -> None:
    """Refuse supports that prescribe jumps in some stages only: unknowns may not change.

    Raises:
        InputError: A support holds a body where another one holds its neighbour.
    """
    for s, support in enumerate(supports):
        if support.stages is not None and (points.given == s).any():
            raise InputError(
                f"supports.{support.name}: it is let go of, but holds its body on an interface "
                "where the other side is held too; allowed: a boundary away from such edges, the "
                "same stages for both, or an elastic foundation instead of one of them"
            )


def refuse_moving_rigid(
    scene: Scene, bodies: Bodies, holds: Holds, points: ContactPoints, entries: Entries
) -> None:
    """Refuse jumps that would move a rigid region: its nodes have no displacement of their own.

    Raises:
        InputError: A support holds an elastic side where it does not hold the rigid one.
    """
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
