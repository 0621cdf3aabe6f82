"""Stiffness of the bodies with the supports of a stage: constrained rows, reactions, inverse.

`support_resistance` is the resistance of these supports to rigid motions of the bodies.
"""

from __future__ import annotations

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np
from dolfinx import fem
from dolfinx.common import IndexMap

from app.foundation.arrays import Floats, Ints
from app.interfaces.faces import projectors
from app.mechanics.body_forms import BodyForms, assemble_form_matrix
from app.mechanics.constraints import Constraints
from app.mechanics.followers import Followers
from app.numerics.preconditioners import CoarseOrder, Inverse, near_null_space, stiffness_options
from app.numerics.rigid_motions import rigid_modes
from app.numerics.sparse import renew
from app.scene.bodies import facets_by_body
from app.scene.frames import frames_of

# Rounding of K u in units of eps |diag(K) u|: about the root of the entries of a row.
ROUNDING_OF_STIFFNESS_ROWS = 2.0


class Stiffness:
    """The stiffness matrix of a scene, its constraints and its inverse; made collectively.

    Attributes:
        K: The matrix, constrained rows and columns set to a diagonal.
        version: Number of its changes, which outdate preconditioners.
        pairings: Number of these by new pairs of surfaces alone.
        stage: The stage whose supports are active.
        followers: Nodes of surfaces with finite sliding, if there are any.
        frames: Nodes with local axes, if a support needs them.
        constraints: Map from unknowns to nodal displacements.
        rows: Global numbers of the constrained rows of this rank.
        reactions: These rows before they are constrained: the reactions to displacements.
        diagonal: Diagonal of the matrix.
        mean_diagonal: Mean diagonal of the stiffness, set in constrained rows to keep scales alike.
        inverse: Approximate inverse of K.

    Args:
        reuse: Stiffness with the same constant matrix, whose inverse is shared.
    """

    saved = ("stage",)

    inverse: Inverse

    def __init__(
        self,
        body_forms: BodyForms,
        reuse: Stiffness | None,
        followers: Followers | None,
    ) -> None:
        scene, space = body_forms.scene, body_forms.space
        self._body_forms, self.stage, self.version, self.pairings = body_forms, 0, 0, 0
        self.frames = frames_of(scene, body_forms.tagged, body_forms.bodies, space)
        self._form = body_forms.stiffness()
        self.followers = followers
        self.constraints = Constraints(body_forms, self.stage, self.frames, followers)
        self.K = self._assemble_constrained()
        self.K.setBlockSize(3)
        self.K.setOption(PETSc.Mat.Option.SPD, True)
        self.K.setNearNullSpace(near_null_space(self.K, self.constraints.modes))
        if reuse and not self.constraints.follows:
            self.inverse = reuse.inverse
            return
        nodal = scene.order > 1 and not self.constraints.transforms
        coarse_order = CoarseOrder(space, lambda: self.constraints.constrained) if nodal else None
        options = stiffness_options("auto", self.K, coarse_order)
        self.inverse = Inverse(self.K, lambda: self.version, options, coarse_order)

    def constraints_of_stages(self) -> list[Constraints]:
        """Constraints of all stages whose supports differ; collective."""
        forms, scene = self._body_forms, self._body_forms.scene
        stages: dict[tuple[bool, ...], int] = {}
        for k in range(len(scene.stages)):
            stages.setdefault(tuple(scene.is_active(s, k) for s in scene.supports), k)
        return [Constraints(forms, k, self.frames, self.followers) for k in stages.values()]

    def _assemble_constrained(self, paired: bool = False) -> PETSc.Mat:
        if not paired:
            self._nodal_matrix = assemble_form_matrix(self._form)
        K = self.constraints.matrix(self._nodal_matrix)
        K.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self.rows = K.getOwnershipRange()[0] + np.flatnonzero(self.constraints.constrained)
        self.rows = self.rows.astype(PETSc.IntType)
        self.reactions = K.createSubMatrix(PETSc.IS().createGeneral(self.rows, comm=K.comm))
        self._support_forces = []
        for unit in self.constraints.unit:
            unit_vector, forces = K.createVecs()
            unit_vector.array[:] = unit
            K.mult(unit_vector, forces)
            self._support_forces.append(forces)
        diagonal = K.getDiagonal()
        self.mean_diagonal = float(diagonal.sum()) / diagonal.getSize()
        K.zeroRowsColumns(self.rows, diag=self.mean_diagonal)
        self.diagonal = K.getDiagonal()
        return K

    def update(self, paired: bool = False) -> None:
        """Reassemble in the same matrix, or if surfaces are paired anew that alone; collective."""
        K = self._assemble_constrained(paired)
        renew(self.K, K, self.constraints.follows)
        self.K.setOption(PETSc.Mat.Option.SPD, True)
        self.version += 1
        self.pairings += paired

    def set_stage(self, stage: int, u: PETSc.Vec) -> bool:
        """Activate the supports of a stage; reassemble and return True if they changed; collective.

        The displacement of the unknowns u is kept.
        """
        stage_before, self.stage = self.stage, stage
        scene = self._body_forms.scene
        if all(
            scene.is_active(s, stage_before) == scene.is_active(s, stage) for s in scene.supports
        ):
            return False
        old_constraints = self.constraints
        self.constraints = Constraints(self._body_forms, stage, self.frames, self.followers)
        self.constraints.transfer_rotated_axes(u, old_constraints)
        self.update()
        self.K.setNearNullSpace(near_null_space(self.K, self.constraints.modes))
        return True

    def prescribed(self, f: PETSc.Vec, amplitudes: Sequence[float]) -> Floats:
        """Prescribed displacements at amplitudes (n,); their forces are taken from f [N]."""
        displacement = np.zeros(len(f.array_r))
        for a, unit, support_force in zip(
            amplitudes, self.constraints.unit, self._support_forces, strict=True
        ):
            displacement += a * unit
            f.axpy(-a, support_force)
        return displacement


def rounding(diagonal: PETSc.Vec, u: PETSc.Vec) -> float:
    """Rounding error of K u, from the terms of the diagonal."""
    return ROUNDING_OF_STIFFNESS_ROWS * float(np.finfo(float).eps) * float((diagonal * u).norm())


def support_resistance(
    body_forms: BodyForms, stiffness: Stiffness, centre: Floats, size: float
) -> dict[int, Floats]:
    """Resistance of active supports to rigid motions, by body (6, 6) [-]; collective.

    The resistance is the square of the held part of each motion, as a mean over the nodes of a
    boundary. A spring counts as a support, however soft it is. A body with a prescribed motion
    resists rotation, and translation if `translation: held`.

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
        if scene.is_active(s, stiffness.stage)
    ]
    conditions += [
        (f.boundary, np.diag(np.sign(f.stiffness)).astype(float), -1) for f in scene.foundations
    ]
    resistance: dict[int, Floats] = {}
    for boundary, directions, k in conditions:
        for body, facets in facets_by_body(body_forms.tagged, bodies, boundary).items():
            nodes = np.asarray(fem.locate_dofs_topological(space, 2, facets), dtype=np.int64)
            P = np.tile(directions, (len(nodes), 1, 1))
            if k >= 0 and frames is not None:
                rows, frame_rows = _rows_with_axes(frames.node, space.dofmap.index_map, nodes)
                P[rows] = projectors(frames.axes[frame_rows], frames.along[frame_rows, k])
            R = rigid_modes((x[nodes] - centre) / size)
            motion_resistance = comm.allreduce(np.einsum("nia,nij,njb->ab", R, P, R))
            resistance[body] = resistance.get(body, 0.0) + motion_resistance / (
                comm.allreduce(len(nodes)) or 1
            )
    for motion in scene.motions:
        body, motion_resistance = bodies.body_of_region[motion.region], np.zeros((6, 6))
        motion_resistance[3:, 3:] = np.eye(3)
        resistance[body] = (
            np.eye(6)
            if motion.translation == "held"
            else resistance.get(body, 0.0) + motion_resistance
        )
    return resistance


def _rows_with_axes(nodes_with_axes: Ints, index_map: IndexMap, nodes: Ints) -> tuple[Ints, Ints]:
    """Rows of the local nodes that have local axes, and their indices in ``nodes_with_axes``.

    ``nodes_with_axes`` are global numbers, rising.
    """
    global_nodes = index_map.local_to_global(nodes.astype(np.int32))
    rows = np.flatnonzero(np.isin(global_nodes, nodes_with_axes))
    return rows, np.searchsorted(nodes_with_axes, global_nodes[rows])
