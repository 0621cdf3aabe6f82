"""Supports that would make jumps impossible: refused."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from app.errors import InputError
from app.laws.supports import Support
from app.scene.bodies import Bodies
from app.scene.scene import Scene
from meshes.contact_points import ContactPoints, Entries, Holds


def refuse_released(supports: Sequence[Support], points: ContactPoints) -> None:
    """Refuse supports that give jumps in some stages only: what is unknown may not change.

    Raises:
        InputError: One holds a body where another one holds what it touches.
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
