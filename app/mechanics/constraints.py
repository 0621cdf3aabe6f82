r"""Constraints: from nodal displacements to independent unknowns.

The displacement of all nodes is U = P ũ. Mostly P is the identity. The nodes of a rigid region move
by :math:`t + ω × (x - c)`. Its six parameters are rotated so that the parameters determined by
supports come first. These are then held like any supported component. Nodes that supports hold
along other directions than x, y, z have unknowns along local axes (`scene.frames`).
"""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from dolfinx import fem

from app.foundation.arrays import Bools, Floats, Ints
from app.foundation.collective import everywhere
from app.foundation.errors import InputError
from app.interfaces.interface_facets import gathered_arrays
from app.mechanics.body_forms import BodyForms
from app.mechanics.followers import Followers
from app.numerics.rigid_motions import rigid_modes
from app.numerics.sparse import from_rows
from app.scene.bodies import boundary_facets, cell_tags, nodes_on, touched_nodes
from app.scene.frames import Frames
from app.scene.scene import Scene

# A motion of a rigid region is constrained if its supports resist it by more than this fraction of
# the motion they resist most.
HELD_RESISTANCE = 1e-9
# In place of the number of a rigid region: the node moves freely.
FREE_NODE = -1
# In place of the number of a rigid region: the node follows other nodes.
FOLLOWING_NODE = -2


def _support_of_dofs(body_forms: BodyForms, stage: int, frames: Frames | None) -> Ints:
    """Support that holds each owned component in a stage, -1 where none does (nodes, 3).

    Components are along the axes of the node. Where supports on several bodies hold a node, the
    body of lowest number wins: it is the base of that node (see `app.interfaces.contact_points`).
    """
    scene, tagged, bodies = body_forms.scene, body_forms.tagged, body_forms.bodies
    space, index_map = body_forms.space, body_forms.space.dofmap.index_map
    support = np.full((index_map.size_local + index_map.num_ghosts, 3), -1, dtype=np.int64)
    rows, frame_rows = frames.owned(index_map) if frames else (np.zeros(0, dtype=np.int64),) * 2
    support_of_frames = support[rows]
    active_supports = [s for s, term in enumerate(scene.supports) if scene.is_active(term, stage)]
    tags = cell_tags(tagged)
    patches = [boundary_facets(tagged, s.boundary) for s in scene.supports]
    rigid = {r.region for r in scene.rigid}
    for body in reversed(range(len(bodies.names))):
        # Supports of other bodies do not hold the nodes of a rigid region: they give jumps.
        for region in sorted(rigid.intersection(bodies.names[body].split(" + "))):
            rigid_nodes = touched_nodes(space, tags == tagged.regions[region])
            support[: len(rigid_nodes)][rigid_nodes] = -1
            support_of_frames[rigid_nodes[rows]] = -1
        for s in active_supports:
            patch = patches[s]
            facets_of_body = patch.facets[bodies.body_of_tag[tags[patch.cells]] == body]
            nodes = fem.locate_dofs_topological(space, 2, facets_of_body.astype(np.int32))
            for c in np.flatnonzero(scene.supports[s].components):
                support[nodes, c] = s
        if frames:
            support_of_body = frames.support(frame_rows, body, active_supports)
            support_of_frames = np.where(support_of_body >= 0, support_of_body, support_of_frames)
    support[rows] = support_of_frames
    return support[: index_map.size_local]


def _prescribed_values(
    scene: Scene, space: fem.FunctionSpace, support_of: Ints, axes: Floats | None
) -> Floats:
    """Displacement of owned nodes by each support at full amplitude (s, n, 3) [mm]; collective.

    Args:
        scene: The scene.
        space: Space of the displacement.
        support_of: Support of each owned component (n, 3).
        axes: Axes of the components (n, 3, 3), None for x, y, z.
    """
    x = space.tabulate_dof_coordinates()[: len(support_of)]

    def values() -> Floats:
        displacements = np.zeros((len(scene.supports), *support_of.shape))
        for s, support in enumerate(scene.supports):
            rows = np.flatnonzero((support_of == s).any(axis=1))
            components = support.values(x[rows])
            if axes is not None:
                components = np.einsum("nic,ni->nc", axes[rows], components)
            displacements[s, rows] = np.where(support_of[rows] == s, components, 0.0)
        return displacements

    return everywhere(space.mesh.comm, values)


class Constraints:
    """Unknowns ũ of the displacement U = P ũ of all nodes, with the supports of a stage.

    P is a matrix where nodes have local axes or regions are rigid, else the identity. A rigid
    region has six unknowns on rank 0 in place of its nodes.

    Attributes:
        transforms: True if P is not the identity.
        follows: True if the pattern of P changes as surfaces slide on each other.
        constrained: Owned unknowns that supports hold (n,).
        unit: Values of the owned unknowns by each support at full amplitude (s, n).
        reacting: Owned nodal components through which supports act (3 owned nodes,).
        modes: The six rigid modes of the whole model in owned unknowns (6, n).

    Raises:
        InputError: Supports of a rigid region contradict each other.
    """

    def __init__(
        self, body_forms: BodyForms, stage: int, frames: Frames | None, followers: Followers | None
    ) -> None:
        scene, space = body_forms.scene, body_forms.space
        support_of = _support_of_dofs(body_forms, stage, frames)
        self._rigid_bases: dict[int, Floats] = {}
        self._P: PETSc.Mat | None = None
        self._P_without_followers: PETSc.Mat | None = None
        self._comm = body_forms.mesh.comm
        self._followers = followers
        self.follows = bool(followers and followers.deformable)
        self.transforms = bool(scene.rigid or frames or followers)
        if self.transforms:
            self._build_transformation(body_forms, support_of, frames)
            self._P_without_followers = self._P
            self.update_followers()
            return
        self.constrained: Bools = support_of.ravel() >= 0
        prescribed = _prescribed_values(scene, space, support_of, None)
        self.unit = prescribed.reshape(len(prescribed), support_of.size)
        self.reacting: Bools = self.constrained
        x = space.tabulate_dof_coordinates()[: len(support_of)]
        self.modes: Floats = rigid_modes(x).reshape(-1, 6).T

    def _build_transformation(
        self, body_forms: BodyForms, support_of: Ints, frames: Frames | None
    ) -> None:
        """Build P, from the supports that hold owned components (nodes, 3); collective.

        The unknowns of a rank are three for each free node. Rank 0 has six more for each region
        that moves as a rigid body.
        """
        scene, space = body_forms.scene, body_forms.space
        comm, nodes = body_forms.mesh.comm, len(support_of)
        x = space.tabulate_dof_coordinates()[:nodes]
        region = self._rigid_region_of(body_forms, nodes)
        moving = [r.region for r in scene.rigid] + [m.region for m in scene.driven]
        free_nodes = np.flatnonzero(region == FREE_NODE)
        free_unknowns = 3 * len(free_nodes)
        unknowns = free_unknowns + (6 * len(moving) if comm.rank == 0 else 0)
        start, first_rigid = comm.exscan(unknowns) or 0, comm.bcast(free_unknowns)

        axes: Floats = np.tile(np.eye(3), (nodes, 1, 1))
        oblique = np.zeros(nodes, dtype=bool)
        if frames:
            rows, frame_rows = frames.owned(space.dofmap.index_map)
            axes[rows], oblique[rows] = frames.axes[frame_rows], region[rows] == FREE_NODE

        prescribed = _prescribed_values(scene, space, support_of, axes)
        self._set_free_nodes(
            unknowns,
            x[free_nodes],
            axes[free_nodes],
            support_of[free_nodes],
            prescribed[:, free_nodes],
        )
        reacting = (support_of >= 0) & (region == FREE_NODE)[:, None]
        reacting[oblique] = reacting[oblique].any(axis=1, keepdims=True)

        # Entries of P by node and component: one, three with local axes, six in a rigid region.
        columns = np.full((nodes, 3, 6), -1, dtype=np.int64)
        entries = np.zeros((nodes, 3, 6))
        columns[free_nodes, :, 0] = start + np.arange(free_unknowns).reshape(-1, 3)
        entries[free_nodes, :, 0] = 1
        columns[oblique, :, :3] = columns[oblique, :, 0][:, None]
        entries[oblique, :, :3] = axes[oblique]
        for k, name in enumerate(moving):
            nodes_of_region, first_unknown = np.flatnonzero(region == k), first_rigid + 6 * k
            columns[nodes_of_region] = first_unknown + np.arange(6)
            entries[nodes_of_region], constrained_count = self._add_rigid(
                comm,
                scene,
                name,
                first_unknown,
                x[nodes_of_region],
                axes[nodes_of_region],
                support_of[nodes_of_region],
                prescribed[:, nodes_of_region],
            )
            reacting[nodes_of_region] |= constrained_count > 0
        self.reacting = reacting.ravel()

        is_entry = columns.reshape(-1, 6) >= 0
        pointer = np.concatenate([[0], np.cumsum(is_entry.sum(axis=1))])
        entry_columns, values = columns.reshape(-1, 6)[is_entry], entries.reshape(-1, 6)[is_entry]
        self._P = from_rows(comm, (3 * nodes, unknowns), pointer, entry_columns, values)

    def _set_free_nodes(
        self, unknowns: int, x: Floats, axes: Floats, support_of: Ints, prescribed: Floats
    ) -> None:
        """Set supports, prescribed values and rigid modes of the n free nodes of this rank.

        Their 3 n unknowns are the first ones. Those of rigid regions after them stay zero.

        Args:
            unknowns: Number of owned unknowns.
            x: Positions of the nodes (n, 3) [mm].
            axes: Axes of their components (n, 3, 3).
            support_of: Support of each component (n, 3).
            prescribed: Displacement by each support (s, n, 3) [mm].
        """
        free_unknowns = 3 * len(x)
        self.constrained = np.zeros(unknowns, dtype=bool)
        self.constrained[:free_unknowns] = (support_of >= 0).ravel()
        self.unit = np.zeros((len(prescribed), unknowns))
        self.unit[:, :free_unknowns] = prescribed.reshape(len(prescribed), free_unknowns)
        self.modes = np.zeros((6, unknowns))
        modes = axes.swapaxes(1, 2) @ rigid_modes(x)
        self.modes[:, :free_unknowns] = modes.reshape(-1, 6).T

    def _rigid_region_of(self, body_forms: BodyForms, nodes: int) -> Ints:
        """Number of the rigid region or driven boundary of owned nodes (nodes,).

        It is `FREE_NODE` or `FOLLOWING_NODE` for other nodes.
        """
        scene, tagged, space = body_forms.scene, body_forms.tagged, body_forms.space
        region = np.full(nodes, FREE_NODE, dtype=np.int64)
        for k, body in enumerate(scene.rigid):
            region[touched_nodes(space, cell_tags(tagged) == tagged.regions[body.region])] = k
        for k, motion in enumerate(scene.driven, len(scene.rigid)):
            driven_nodes = nodes_on(tagged, space, str(motion.boundary))
            region[driven_nodes[driven_nodes < nodes]] = k
        if self._followers:
            region[self._followers.owned_followers] = FOLLOWING_NODE
        return region

    def _add_rigid(
        self,
        comm: MPI.Comm,
        scene: Scene,
        region: str,
        first_unknown: int,
        x: Floats,
        axes: Floats,
        support_of: Ints,
        prescribed: Floats,
    ) -> tuple[Floats, int]:
        """Set the unknowns of a rigid region, from its n owned nodes; collective.

        Args:
            comm: Communicator of the mesh.
            scene: The scene.
            region: Name of the region.
            first_unknown: Number of the first of the six unknowns.
            x: Positions of the nodes (n, 3) [mm].
            axes: Axes of their components (n, 3, 3).
            support_of: Support of each component (n, 3).
            prescribed: Displacement by each support (s, n, 3) [mm].

        Returns:
            Displacement of the nodes by the unknowns (n, 3, 6), and the number of constrained
            unknowns, which come first.
        """
        points = gathered_arrays(comm, x)[0]
        centre, scale = points.mean(axis=0), np.ptp(points, axis=0).max() or 1.0
        local = rigid_modes((x - centre) / scale)
        is_held = support_of >= 0
        held_rows = (axes.swapaxes(1, 2) @ local)[is_held]
        rows, *prescribed_values = gathered_arrays(
            comm, held_rows, *(values[is_held] for values in prescribed)
        )
        motion = scene.motion_of((region,))
        if motion:
            # The rotation is prescribed, and so is the translation if `translation: held`.
            prescribed_motions = np.eye(6)[3:]
            if motion.translation != "free":
                about = (np.array(motion.about) - centre) / scale
                prescribed_motions = np.vstack([rigid_modes(about[None])[0], prescribed_motions])
            rows = np.vstack([rows, prescribed_motions])
            prescribed_values = [
                np.concatenate([w, np.zeros(len(prescribed_motions))]) for w in prescribed_values
            ]
        basis, constrained_count, amounts = _constrained_motions(
            scene, region, rows, prescribed_values
        )
        if comm.rank == 0:
            self._rigid_bases[first_unknown] = basis
            constrained = slice(first_unknown, first_unknown + constrained_count)
            self.constrained[constrained] = True
            self.unit[:, constrained] = amounts[:, :constrained_count]
            # A rigid mode of the model in terms of this body: t + w x c, and w * scale.
            model_modes = np.eye(6)
            model_modes[:3, 3:] = rigid_modes(centre[None])[0, :, 3:]
            model_modes[3:] *= scale
            self.modes[:, first_unknown : first_unknown + 6] = (basis.T @ model_modes).T
        return local @ basis, constrained_count

    def update_followers(self) -> None:
        """Let nodes follow the current pairs of their surfaces; collective."""
        if self._followers:
            self._P = self._followers.matrix().matMult(self._P_without_followers)

    def rigid_motion_along(self, f: PETSc.Vec) -> PETSc.Vec:
        """Motion of the rigid regions alone, along forces f on the unknowns, where free.

        Deformable bodies that rotate move like their driven boundaries; collective.
        """
        u = f.duplicate()
        for first_unknown in self._rigid_bases:
            six_unknowns = slice(first_unknown, first_unknown + 6)
            u.array[six_unknowns] = np.where(
                self.constrained[six_unknowns], 0.0, f.array_r[six_unknowns]
            )
        if self._followers:
            nodal = self.expand(u).array_r.reshape(-1, 3)
            u = self.contract(self._followers.move_with_boundaries(nodal))
        return u

    def matrix(self, K: PETSc.Mat) -> PETSc.Mat:
        """P^T K P."""
        return self._P.transposeMatMult(K.matMult(self._P)) if self._P else K

    def rows(self, C: PETSc.Mat) -> PETSc.Mat:
        """P^T C."""
        return self._P.transposeMatMult(C) if self._P else C

    def rows_of(self, nodes: Ints) -> PETSc.Mat:
        """Rows of P of owned nodes, zero in constrained columns; collective."""
        assert self._P
        rows = self._P.getOwnershipRange()[0] + 3 * nodes[:, None] + np.arange(3)
        rows = rows.ravel().astype(PETSc.IntType)
        rows_of_P = self._P.createSubMatrix(PETSc.IS().createGeneral(rows, comm=self._P.comm))
        free = rows_of_P.createVecRight()
        free.array[:] = ~self.constrained
        rows_of_P.diagonalScale(None, free)
        return rows_of_P

    def prescribed_components(self, nodes: Ints, axes: Floats) -> Bools:
        """Mask of the components of owned nodes that supports prescribe (n, 3); collective.

        Args:
            nodes: Owned nodes (n,).
            axes: Axes of the components, as columns (n, 3, 3).
        """
        if not self._P:
            return self.constrained.reshape(-1, 3)[nodes]
        from scipy.sparse import bsr_array, csr_array  # few cases have rigid regions or local axes

        start, columns, values = self.rows_of(nodes).getValuesCSR()
        shape = 3 * len(nodes), int(columns.max(initial=0)) + 1
        rows = csr_array((values, columns, start), shape=shape)
        blocks = axes.swapaxes(1, 2), np.arange(len(nodes)), np.arange(len(nodes) + 1)
        to_axes = bsr_array(blocks, shape=(shape[0], shape[0])).tocsr()
        sizes = abs(to_axes @ rows).max(axis=1).toarray()
        return np.asarray(sizes.reshape(-1, 3) < HELD_RESISTANCE)

    def vector(self, f: PETSc.Vec) -> PETSc.Vec:
        """P^T f, a new vector."""
        if not self._P:
            return f.copy()
        out = self._P.createVecRight()
        self._P.multTranspose(f, out)
        return out

    def expand(self, u: PETSc.Vec) -> PETSc.Vec:
        """P ũ, a new vector."""
        return self._P * u if self._P else u.copy()

    def transfer_rotated_axes(self, u: PETSc.Vec, old_constraints: Constraints) -> None:
        """Transform the unknowns of rigid regions from the old bases to these."""
        for first_unknown, basis in self._rigid_bases.items():
            six_unknowns = slice(first_unknown, first_unknown + 6)
            old_basis = old_constraints._rigid_bases[first_unknown]
            u.array[six_unknowns] = basis.T @ old_basis @ u.array[six_unknowns]

    def contract(self, nodal: Floats) -> PETSc.Vec:
        """Find ũ from U = P ũ at owned nodes (3 nodes) by the normal equations; collective.

        Nodes that follow others do not count. P^T P is then the identity except for a 6 x 6 block
        for each rigid region. All these blocks are on rank 0: block Jacobi is exact.
        """
        nodal_vector = PETSc.Vec().createWithArray(nodal.ravel(), comm=self._comm)
        P = self._P_without_followers
        if not P:
            return nodal_vector.copy()
        solver = PETSc.KSP().create(P.comm)
        solver.setOperators(P.transposeMatMult(P))
        solver.setType("preonly")
        solver.getPC().setType("bjacobi")
        u, right_side = P.createVecRight(), P.createVecRight()
        P.multTranspose(nodal_vector, right_side)
        solver.solve(right_side, u)
        return u


def _constrained_motions(
    scene: Scene, region: str, rows: Floats, prescribed_values: list[Floats]
) -> tuple[Floats, int, Floats]:
    """Basis (6, 6) of a body's motions, constrained ones first, their number, and amounts (s, 6).

    ``rows`` are the displacements of the constrained components by the six motions (m, 6),
    ``prescribed_values`` their values at full amplitude by each support (m,).

    Raises:
        InputError: The supports prescribe no rigid motion.
    """
    amounts = np.zeros((len(scene.supports), 6))
    if not len(rows):
        return np.eye(6), 0, amounts
    _, singular, vt = np.linalg.svd(np.linalg.qr(rows, mode="r"))
    rank = int((singular > HELD_RESISTANCE * singular[0]).sum())
    basis = vt.T
    inverse = np.linalg.pinv(rows, rcond=HELD_RESISTANCE)
    # Supports with the same load history count as one: only their sum has to be a rigid motion.
    for load_history in dict.fromkeys(s.history for s in scene.supports):
        same_history = [
            s for s, support in enumerate(scene.supports) if support.history == load_history
        ]
        prescribed_sum = np.sum([prescribed_values[s] for s in same_history], axis=0)
        motion = inverse @ prescribed_sum
        error = np.abs(rows @ motion - prescribed_sum).max()
        if error > 1e-9 * max(np.abs(prescribed_sum).max(), 1.0):
            support_names = ", ".join(
                scene.supports[s].name for s in same_history if prescribed_values[s].any()
            )
            raise InputError(
                f"supports.{support_names}: the rigid region '{region}' cannot satisfy these "
                "values together with its other supports; expected values of one rigid motion"
            )
        amounts[same_history[0]] = basis.T @ motion
    return basis, rank, amounts
