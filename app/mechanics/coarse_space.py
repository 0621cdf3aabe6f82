"""Coarse space of contact: motions of bodies past each other, which no local method finds.

`numerics.deflation` says what they are for.
"""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from dolfinx import fem, la

from app.arrays import Bools, Floats, Ints
from app.mechanics.contact import ContactInterfaces
from app.mechanics.problem import Problem
from app.numerics.rigid_motions import rigid_modes
from app.numerics.sparse import block_diagonal, fill, from_triplets, matrix_sum
from app.scene.bodies import cell_tags

# A direction of which a law resists less than this is free.
RESISTED = 0.5
# Large boxes about the interfaces over the cube root of the number of contact points.
BOXES = 1.5
# Small ones: their edge over that of the mesh, by the order of the displacement.
SMALL = {1: 5.0, 2: 2.5}
# Steps in which they get smaller.
SMALLER = 0.95
# A point lets other directions go if a projector differs by this; a part of the points that do may
# be overlooked.
DIFFERENT, STALE = 0.5, 0.03


def free_directions(slope: Floats) -> Floats:
    """Projectors on the jumps that a contact law does not resist.

    Args:
        slope: Generalized derivative P' of the law at each point (n, 3, 3).

    Returns:
        Orthogonal projectors on what P' all but maps to zero (n, 3, 3).
    """
    values, vectors = np.linalg.eigh(slope.transpose(0, 2, 1) @ slope)
    free = np.where(values < RESISTED**2, 1.0, 0.0)
    return np.asarray(np.einsum("pik,pk,pjk->pij", vectors, free, vectors))


class Boxes:
    """Hat functions on boxes about points, each cut into six tetrahedra; constant outside.

    Attributes:
        edge: Length of the edges of the boxes [mm].
        size: How many functions there are.
    """

    def __init__(self, x: Floats, edge: float = 0.0) -> None:
        """Lay boxes about the points x (n, 3) [mm], by default the smallest that are few."""
        low, high = x.min(axis=0), x.max(axis=0)
        longest = np.max(high - low) or 1.0
        edges = longest * SMALLER ** np.arange(100)
        counts = np.maximum(1, np.ceil((high - low) / edges[:, None])).astype(int)
        last = np.flatnonzero(counts.prod(axis=1) <= max(BOXES * np.cbrt(len(x)), 1))[-1]
        self.edge = edge or edges[last]
        self._count = np.maximum(1, np.ceil((high - low) / self.edge)).astype(int)
        self._low = (low + high - self._count * self.edge) / 2
        self.size = int((self._count + 1).prod())

    def __call__(self, x: Floats) -> tuple[Ints, Floats]:
        """Functions that are not zero at points x (n, 3), and their values (n, 4)."""
        y = np.clip((x - self._low) / self.edge, 0, self._count - 1e-9)
        corner = y.astype(np.int64)
        # From the low corner to the high one along the edges, the longest part first (Kuhn).
        order = np.argsort(corner - y, axis=1)
        part = np.take_along_axis(y - corner, order, axis=1)
        values = -np.diff(part, axis=1, prepend=1.0, append=0.0)
        steps = np.cumsum(np.eye(3, dtype=np.int64)[order], axis=1)
        corners = corner[:, None] + np.insert(steps, 0, 0, axis=1)
        return np.ravel_multi_index(tuple(np.moveaxis(corners, 2, 0)), self._count + 1), values


class _Entries:
    """Entries of a matrix (components of nodes or points x motions), as they are found."""

    def __init__(self, comm: MPI.Comm, rows: int) -> None:
        self._comm, self._rows = comm, rows
        self._found: list[tuple[Ints, Ints, Floats]] = []
        self.dense(np.zeros((0, 0)), 0)

    def hats(self, at: tuple[Ints, Floats], place: Ints, used: Bools, factor: Floats) -> None:
        """Each used function along each axis, from column ``place`` on; times a factor (n, 3)."""
        functions, values = at
        values = np.where(used[functions], values, 0.0)
        shape = (*functions.shape, 3)
        axes = np.arange(3)
        rows = np.broadcast_to((3 * np.arange(len(values)))[:, None, None] + axes, shape)
        columns = place[functions][:, :, None] + axes
        entries = values[:, :, None] * factor[:, None, :]
        keep = entries != 0
        self._found.append((rows[keep], columns[keep], entries[keep]))

    def dense(self, values: Floats, first: int) -> None:
        """Columns of values (rows, m) from a column on."""
        rows, columns = np.nonzero(values)
        self._found.append((rows, first + columns, values[rows, columns]))

    def votes(self, columns: int) -> Ints:
        """Entries of this rank in each of so many columns."""
        return np.bincount(np.concatenate([j for _, j, _ in self._found]), minlength=columns)

    def matrix(self, owner: Ints) -> PETSc.Mat:
        """The matrix, its columns in the order of the ranks that own them; collective."""
        number = np.empty_like(owner)
        number[np.argsort(owner, kind="stable")] = np.arange(len(owner))
        i, j, v = (np.concatenate(parts) for parts in zip(*self._found, strict=True))
        columns = int((owner == self._comm.rank).sum())
        return from_triplets(self._comm, self._rows, columns, i, number[j], v)


class SlidingMotions:
    """Smooth motions of each body while all others stay, of displacement and jumps.

    A body that deforms has those of hat functions on boxes about the interfaces: large boxes with
    all that is in them, and small ones along the interfaces of all bodies but the stiffest (where
    all move together nothing slides). A rigid one has six.

    Attributes:
        displacement: The rows of the displacement.
        jump: Those of the jumps that the law lets go, as of `version`.
        version: Counts how often they have followed the law; 0 as long as it lets nothing go.
    """

    displacement: PETSc.Mat
    jump: PETSc.Mat
    version: int

    def __init__(self, problem: Problem) -> None:
        """Find who moves where; collective."""
        contact = problem.contact
        assert contact is not None
        comm, space, reduction = problem.comm, problem.space, problem.reduction
        self._comm, self._allowing = comm, np.eye(3) - contact.held
        nodes = space.dofmap.index_map.size_local
        x, y = space.tabulate_dof_coordinates()[:nodes], contact.points.x[contact.mine]
        large = Boxes(contact.points.x)
        small = Boxes(
            contact.points.x, SMALL[problem.scene.order] * float(np.mean(contact.edge_lengths))
        )
        grids = [(b, b(x), b(y)) for b in (large, small) if b is large or b.edge < large.edge]
        frame = _frame(contact.points.x)
        rigid = {r.region for r in problem.scene.rigid}
        nodal, others = _Entries(comm, 3 * nodes), _Entries(comm, len(problem.held))
        jumps = _Entries(comm, 3 * len(y))
        first, stiffest = 0, _stiffest(problem)
        for body, name in enumerate(problem.bodies.names):
            own = _components(problem, contact, body)
            master, slave = (contact.points.bodies[contact.mine] == body).T
            sign = slave.astype(float) - master
            if rigid.issuperset(name.split(" + ")):
                moves = _unknowns(problem, own)[:, None]
                others.dense(moves * (reduction.modes.T @ frame), first)
                jumps.dense((sign[:, None, None] * (rigid_modes(y) @ frame)).reshape(-1, 6), first)
                first += 6
                continue
            for boxes, at_nodes, at_points in grids[: 1 if body == stiffest else None]:
                inside = at_nodes[0][own.any(axis=1)] if boxes is large else at_points[0][sign != 0]
                used = comm.allreduce(np.bincount(inside.ravel(), minlength=boxes.size)) > 0
                place = first + 3 * (np.cumsum(used) - 1)
                nodal.hats(at_nodes, place, used, own.astype(float))
                jumps.hats(at_points, place, used, np.repeat(sign[:, None], 3, axis=1))
                first += 3 * int(used.sum())
        # A motion belongs to the rank that has most of it.
        votes = sum(entries.votes(first) for entries in (nodal, others, jumps))
        owner = np.argmax(comm.allgather(votes), axis=0)
        self.displacement = matrix_sum([reduction.rows(nodal.matrix(owner)), others.matrix(owner)])
        self.displacement.zeroRows(problem.supports.rows, diag=0.0)
        self._jump = jumps.matrix(owner)
        self._free = block_diagonal(comm, len(y))
        self.jump = self._free.matMult(self._jump)
        self._let, self._allowed = self._jump.createVecLeft(), self._jump.createVecLeft()
        self._known: Floats = np.zeros((len(y), 3, 3))
        self.version = 0

    def follow(self, slope: Floats) -> None:
        """Let go what a law lets go, if that is much different from before; collective.

        Args:
            slope: Generalized derivative P' of the law at own points (n, 3, 3).
        """
        free = free_directions(slope)
        free = self._allowing @ free @ self._allowing
        changed = (np.abs(free - self._known).max(axis=(1, 2)) > DIFFERENT).sum()
        changed, points = self._comm.allreduce(np.array([changed, len(free)]))
        if changed <= STALE * points and (self.version or not changed):
            return
        self.let_go(free)

    def let_go(self, free: Floats) -> None:
        """Let directions go, whatever the law; collective.

        Args:
            free: Projectors on them at own points (n, 3, 3).
        """
        self._known = free
        self.version += 1
        fill(self._free, free)
        self._free.matMult(self._jump, result=self.jump)

    def work(self, u: PETSc.Vec, q: PETSc.Vec, out: PETSc.Vec) -> None:
        """Work of forces on displacement and jumps in each motion: Z^T r."""
        self._free.mult(q, self._let)
        self._jump.multTranspose(self._let, out)
        self.displacement.multTransposeAdd(u, out, out)

    def moved(self, weights: PETSc.Vec, u: PETSc.Vec, q: PETSc.Vec) -> None:
        """Displacement and jumps of motions together: Z w."""
        self.displacement.mult(weights, u)
        self._jump.mult(weights, self._allowed)
        self._free.mult(self._allowed, q)


def _stiffest(problem: Problem) -> int:
    """The body with the largest modulus, a rigid one before all others."""
    modulus = np.zeros(len(problem.bodies.names))
    for region, value in problem.scene.moduli.items():
        body = problem.bodies.of_region[region]
        modulus[body] = max(modulus[body], value)
    return int(modulus.argmax())


def _frame(x: Floats) -> Floats:
    """Rigid motions about the middle of points x, turns as large as shifts: well conditioned."""
    frame = np.eye(6)
    frame[:3, 3:] = -rigid_modes(x.mean(axis=0)[None])[0, :, 3:]
    frame[:, 3:] /= np.linalg.norm(np.ptp(x, axis=0)) or 1.0
    return frame


def _components(problem: Problem, contact: ContactInterfaces, body: int) -> Bools:
    """Own nodal components of a body, those that jumps move left out (n, 3); collective."""
    space = problem.space
    cells = np.flatnonzero(problem.bodies.of_tag[cell_tags(problem.tagged)] == body)
    marks = fem.Function(space)
    marks.x.array.reshape(-1, 3)[np.unique(space.dofmap.list[cells])] = 1
    marks.x.scatter_reverse(la.InsertMode.add)
    own = np.asarray(marks.x.array[: 3 * space.dofmap.index_map.size_local] > 0)
    if body in contact.moves:
        # There nodes are those of the other bodies.
        own &= np.diff(contact.moves[body].getValuesCSR()[0]) == 0
    return own.reshape(-1, 3)


def _unknowns(problem: Problem, components: Bools) -> Bools:
    """Own unknowns that some of the own nodal components depend on."""
    found = np.zeros(len(problem.held), dtype=bool)
    vector = problem.K.createVecLeft()
    for mode in problem.reduction.modes:
        vector.array[:] = mode
        nodal = problem.reduction.expand(vector)
        nodal.array[~components.ravel()] = 0
        found |= problem.reduction.vector(nodal).array != 0
    return found
