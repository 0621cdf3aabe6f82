r"""Coarse motions of bodies past each other: what contact holds weakly no local method finds.

A body that slides on its interfaces, or bends away from them, meets little resistance, and a
preconditioner that treats displacement and jumps in turn leaves such motions almost as they were:
Krylov methods stall until they have found each of them. With Z the motions and A the Jacobian, a
preconditioner M becomes (A-DEF1, Tang et al. 2009, https://doi.org/10.1007/s10915-009-9272-6)

.. math:: Q + M (1 - A Q), \qquad Q = Z (Z^T A Z)^{-1} Z^T.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from dolfinx import fem, la
from numpy.typing import NDArray

from app.bodies import cell_tags
from app.reduction import rigid_modes
from app.sparse import block_diagonal, fill, from_triplets, matrix_sum

if TYPE_CHECKING:
    from app.problem import Problem

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

# A direction of which a law resists less than this is free.
RESISTED = 0.5
# Boxes about the interfaces over the cube root of the number of contact points: the dense matrix of
# the motions costs their number cubed, what it saves is in proportion to the points.
BOXES = 1.5
# Steps in which they get smaller.
SMALLER = 0.95
# Motions that this part of the strongest resistance holds are left to the Krylov method.
NOTHING = 1e-10


class Deflated:
    """Context of a PCPYTHON on matrices of blocks: another preconditioner, deflated.

    Attributes:
        inner: The other preconditioner.
    """

    def __init__(
        self,
        inner: PETSc.PC,
        blocks: Sequence[str],
        motions: Callable[[], Sequence[PETSc.Mat]],
        version: Callable[[], int],
    ) -> None:
        """Take what is to be deflated.

        Args:
            inner: The preconditioner.
            blocks: Names of the blocks, "displacement" and "jump" among them; others rest.
            motions: Gives the rows of Z of these two at the current Jacobian, in a fixed pattern.
            version: Counts how often the stiffness or the motions of the displacement changed.
        """
        self.inner, self._motions, self._version = inner, motions, version
        self._moving = [blocks.index("displacement"), blocks.index("jump")]
        self._rows = range(len(blocks))
        self._made: int | None = None
        self._rest: PETSc.Vec | None = None

    def setUp(self, pc: PETSc.PC) -> None:
        """Take in a Jacobian; collective."""
        A = pc.getOperators()[0]
        self.inner.setOperators(A)
        self.inner.setUp()
        self._Z = dict(zip(self._moving, self._motions(), strict=True))
        first = self._made != self._version()
        if first:
            self._made = self._version()
            self._AZ: dict[tuple[int, int], PETSc.Mat] = defaultdict(PETSc.Mat)
            self._small: dict[tuple[int, int], PETSc.Mat] = defaultdict(PETSc.Mat)
            self._Zt = {k: Z.transpose(PETSc.Mat()) for k, Z in self._Z.items()}
        u, q = self._moving
        self._Z[q].transpose(self._Zt[q])
        for i in self._rows:
            for k, Z in self._Z.items():
                block = A.getNestSubMatrix(i, k)
                if block.handle and (first or (i, k) != (u, u)):
                    block.matMult(Z, result=self._AZ[i, k])
        for (i, k), product in self._AZ.items():
            if i in self._moving and (first or (i, k) != (u, u)):
                self._Zt[i].matMult(product, result=self._small[i, k])
        self._invert(A.comm.tompi4py(), self._Z[u].createVecRight())

    def _invert(self, comm: MPI.Comm, weights: PETSc.Vec) -> None:
        """Make the own rows of the inverse of Z^T A Z."""
        galerkin = np.sum([_dense(A) for A in self._small.values()], axis=0)
        start, end = weights.getOwnershipRange()
        self._inverse = _inverse(np.vstack(comm.allgather(galerkin)))[start:end]
        self._comm, self._weights, self._part = comm, weights, weights.duplicate()

    def apply(self, pc: PETSc.PC, r: PETSc.Vec, z: PETSc.Vec) -> None:
        """The motions first, then the other preconditioner on what they leave."""
        if self._rest is None:
            self._rest = r.duplicate()
        weights, part, given = self._weights, self._part, r.getNestSubVecs()
        part.zeroEntries()
        for k, Z in self._Z.items():
            Z.multTransposeAdd(given[k], part, part)
        whole = np.concatenate(self._comm.allgather(part.array_r))
        weights.array[:] = -(self._inverse @ whole)
        r.copy(self._rest)
        rest = self._rest.getNestSubVecs()
        for (i, _), product in self._AZ.items():
            product.multAdd(weights, rest[i], rest[i])
        self._rest.stateIncrease()
        self.inner.apply(self._rest, z)
        found = z.getNestSubVecs()
        weights.scale(-1.0)
        for k, Z in self._Z.items():
            Z.multAdd(weights, found[k], found[k])
        # A vector of blocks does not see that these have changed, and remembers its norm.
        z.stateIncrease()


def _dense(A: PETSc.Mat) -> Floats:
    """Own rows of a small matrix."""
    start, columns, values = A.getValuesCSR()
    own = np.zeros((len(start) - 1, A.getSize()[1]))
    own[np.repeat(np.arange(len(own)), np.diff(start)), columns] = values
    return own


def _inverse(matrix: Floats) -> Floats:
    """Inverse of a small matrix; motions without resistance stay out."""
    diagonal = np.abs(matrix.diagonal())
    empty = diagonal <= NOTHING * diagonal.max(initial=0.0)
    matrix[empty], matrix[:, empty] = 0.0, 0.0
    np.fill_diagonal(matrix, np.where(empty, 1.0, matrix.diagonal() + NOTHING * diagonal))
    found = np.linalg.inv(matrix)
    found[empty] = 0.0
    return np.asarray(found)


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
        size: How many functions there are.
    """

    def __init__(self, x: Floats) -> None:
        """Lay boxes about the points x (n, 3) [mm]."""
        low, high = x.min(axis=0), x.max(axis=0)
        longest = np.max(high - low) or 1.0
        # The smallest boxes that are not too many.
        edges = longest * SMALLER ** np.arange(100)
        counts = np.maximum(1, np.ceil((high - low) / edges[:, None])).astype(int)
        last = np.flatnonzero(counts.prod(axis=1) <= max(BOXES * np.cbrt(len(x)), 1))[-1]
        self._edge, self._count = edges[last], counts[last]
        self._low = (low + high - self._count * self._edge) / 2
        self.size = int((self._count + 1).prod())

    def __call__(self, x: Floats) -> tuple[Ints, Floats]:
        """Functions that are not zero at points x (n, 3), and their values (n, 4)."""
        y = np.clip((x - self._low) / self._edge, 0, self._count - 1e-9)
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

    def hats(self, at: tuple[Ints, Floats], place: Ints, factor: Floats) -> None:
        """Each function along each axis, from column ``place`` on; times a factor (n, 3)."""
        functions, values = at
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

    def matrix(self, columns: int) -> PETSc.Mat:
        """The matrix, so many columns on this rank; collective."""
        i, j, v = (np.concatenate(parts) for parts in zip(*self._found, strict=True))
        return from_triplets(self._comm, self._rows, columns, i, j, v)


class Motions:
    """Smooth motions of each body while all others stay, of displacement and jumps.

    A body that deforms has those of hat functions on boxes about the interfaces, or, where
    ``few`` are wanted, the six of a rigid one.
    """

    def __init__(self, problem: Problem, few: bool) -> None:
        """Find who moves where; collective."""
        (j,) = problem.jumps
        comm, space, reduction = problem.comm, problem.space, problem.reduction
        self._held = j.held
        nodes = space.dofmap.index_map.size_local
        x, y = space.tabulate_dof_coordinates()[:nodes], j.points.x[j.mine]
        boxes = Boxes(j.points.x)
        at_nodes, at_points = boxes(x), boxes(y)
        frame = _frame(j.points.x)
        rigid = {r.region for r in problem.scene.rigid}
        nodal, others = _Entries(comm, 3 * nodes), _Entries(comm, len(problem.held))
        jumps = _Entries(comm, 3 * len(y))
        first = 0
        for body, name in enumerate(problem.bodies.names):
            own = _components(problem, body)
            master, slave = (j.points.bodies[j.mine] == body).T
            sign = slave.astype(float) - master
            if few or rigid.issuperset(name.split(" + ")):
                moves = _unknowns(problem, own)[:, None]
                others.dense(moves * (reduction.modes.T @ frame), first)
                jumps.dense((sign[:, None, None] * (rigid_modes(y) @ frame)).reshape(-1, 6), first)
                first += 6
            else:
                here = at_nodes[0][own.any(axis=1)].ravel()
                used = comm.allreduce(np.bincount(here, minlength=boxes.size)) > 0
                place = first + 3 * (np.cumsum(used) - 1)
                nodal.hats(at_nodes, place, own.astype(float))
                jumps.hats(at_points, place, np.repeat(sign[:, None], 3, axis=1))
                first += 3 * int(used.sum())
        columns = first // comm.size + (comm.rank < first % comm.size)
        self._displacement = matrix_sum(
            [reduction.rows(nodal.matrix(columns)), others.matrix(columns)]
        )
        self._displacement.zeroRows(problem.supported_rows(), diag=0.0)
        self._jump = jumps.matrix(columns)
        self._free = block_diagonal(comm, len(y))
        self._along = self._free.matMult(self._jump)

    def at(self, slope: Floats) -> list[PETSc.Mat]:
        """Motions of displacement, and of the jumps that a law lets go; collective.

        Args:
            slope: Generalized derivative P' of the law at own points (n, 3, 3).
        """
        free = free_directions(slope)
        free[self._held[:, :, None] | self._held[:, None, :]] = 0
        fill(self._free, free)
        self._free.matMult(self._jump, result=self._along)
        return [self._displacement, self._along]


def _frame(x: Floats) -> Floats:
    """Rigid motions about the middle of points x, turns as large as shifts: well conditioned."""
    frame = np.eye(6)
    frame[:3, 3:] = -rigid_modes(x.mean(axis=0)[None])[0, :, 3:]
    frame[:, 3:] /= np.linalg.norm(np.ptp(x, axis=0)) or 1.0
    return frame


def _components(problem: Problem, body: int) -> Bools:
    """Own nodal components of a body, those that jumps move left out (n, 3); collective."""
    space = problem.space
    cells = np.flatnonzero(problem.bodies.of_tag[cell_tags(problem.tagged)] == body)
    marks = fem.Function(space)
    marks.x.array.reshape(-1, 3)[np.unique(space.dofmap.list[cells])] = 1
    marks.x.scatter_reverse(la.InsertMode.add)
    own = np.asarray(marks.x.array[: 3 * space.dofmap.index_map.size_local] > 0)
    (j,) = problem.jumps
    if body in j.moves:
        # There nodes are those of the other bodies.
        own &= np.diff(j.moves[body].getValuesCSR()[0]) == 0
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
