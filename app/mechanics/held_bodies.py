"""Resistance of supports, foundations and given motions to rigid motions of bodies."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem

from app.foundation.arrays import Floats, Ints
from app.numerics.rigid_motions import rigid_modes
from app.scene.bodies import facets_by_body
from meshes.contact_facets import projectors

if TYPE_CHECKING:
    from app.mechanics.body_forms import BodyForms
    from app.mechanics.stiffness import Stiffness


def held_motions(
    body_forms: BodyForms, stiffness: Stiffness, centre: Floats, size: float
) -> dict[int, Floats]:
    """Resistance of active supports to rigid motions, by body (6, 6) [-]; collective.

    It is the square of the held part of each motion, in the mean over the nodes of a boundary. A
    spring counts as a support, however soft it is. A body with a given motion resists rotation, and
    translation if that is held.

    Args:
        body_forms: Supports, foundations and bodies.
        stiffness: Stiffness of the stage whose supports are active.
        centre: Point about which bodies rotate (3,) [mm].
        size: Length by which rotations are divided [mm].
    """
    scene, bodies, space = body_forms.scene, body_forms.bodies, body_forms.space
    frames, comm, x = stiffness.frames, body_forms.mesh.comm, space.tabulate_dof_coordinates()
    conditions = [
        (s.boundary, np.diag(s.components).astype(float), k)
        for k, s in enumerate(scene.supports)
        if scene.holds(s, stiffness.stage)
    ]
    conditions += [
        (f.boundary, np.diag(np.sign(f.stiffness)).astype(float), -1) for f in scene.foundations
    ]
    held: dict[int, Floats] = {}
    for boundary, directions, k in conditions:
        for body, facets in facets_by_body(body_forms.tagged, bodies, boundary).items():
            nodes = np.asarray(fem.locate_dofs_topological(space, 2, facets), dtype=np.int64)
            P = np.tile(directions, (len(nodes), 1, 1))
            if k >= 0 and frames is not None:
                rows, places = _with_axes(frames.node, space.dofmap.index_map, nodes)
                P[rows] = projectors(frames.axes[places], frames.along[places, k])
            R = rigid_modes((x[nodes] - centre) / size)
            part = comm.allreduce(np.einsum("nia,nij,njb->ab", R, P, R))
            held[body] = held.get(body, 0.0) + part / (comm.allreduce(len(nodes)) or 1)
    for motion in scene.motions:
        body, part = bodies.of_region[motion.region], np.zeros((6, 6))
        part[3:, 3:] = np.eye(3)
        held[body] = np.eye(6) if motion.translation == "held" else held.get(body, 0.0) + part
    return held


def _with_axes(with_axes: Ints, index_map: object, nodes: Ints) -> tuple[Ints, Ints]:
    """Rows of the local nodes that have local axes, and their indices in ``with_axes``.

    ``with_axes`` are global numbers, rising.
    """
    every = index_map.local_to_global(nodes.astype(np.int32))  # type: ignore[attr-defined]
    rows = np.flatnonzero(np.isin(every, with_axes))
    return rows, np.searchsorted(with_axes, every[rows])
