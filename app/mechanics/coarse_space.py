"""Coarse space of contact: motions of bodies past each other, for `numerics.deflation`."""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from app.foundation.arrays import Bools, Floats, Ints
from app.mechanics.contact import ContactInterfaces
from app.mechanics.problem import Problem
from app.numerics.deflation import CoarseSpace
from app.numerics.rigid_motions import rigid_modes
from app.numerics.sparse import from_triplets, matrix_sum
from app.scene.bodies import cell_tags, touched_nodes

# A direction is free if a law resists less than this fraction of it.
FREE_SLOPE = 0.5
# Large boxes about the interfaces over the cube root of the number of contact points.
LARGE_BOXES = 1.5
# Small ones: their edge over that of the mesh, by the order of the displacement.
SMALL_BOX_EDGE = {1: 5.0, 2: 2.5}
# Edge of large boxes over that of the next larger ones, in the search for their size.
BOX_SHRINKAGE = 0.95


def free_directions(slope: Floats) -> Floats:
    """Projectors on the jumps that a law of slope P' does not resist; both (n, 3, 3)."""
    values, vectors = np.linalg.eigh(slope.transpose(0, 2, 1) @ slope)
    is_free = np.where(values < FREE_SLOPE**2, 1.0, 0.0)
    return np.asarray(np.einsum("pik,pk,pjk->pij", vectors, is_free, vectors))


class Boxes:
    """Hat functions on boxes about points, each cut into six tetrahedra; constant outside.

    Attributes:
        edge: Length of the edges of the boxes [mm].
        size: Number of functions.
    """

    def __init__(self, x: Floats, edge: float = 0.0) -> None:
        lower_corner, upper_corner = x.min(axis=0), x.max(axis=0)
        longest = np.max(upper_corner - lower_corner) or 1.0
        edges = longest * BOX_SHRINKAGE ** np.arange(100)
        counts = np.maximum(1, np.ceil((upper_corner - lower_corner) / edges[:, None])).astype(int)
        finest = np.flatnonzero(counts.prod(axis=1) <= max(LARGE_BOXES * np.cbrt(len(x)), 1))[-1]
        self.edge = edge or edges[finest]
        self._count = np.maximum(1, np.ceil((upper_corner - lower_corner) / self.edge)).astype(int)
        self._low = (lower_corner + upper_corner - self._count * self.edge) / 2
        self.size = int((self._count + 1).prod())

    def __call__(self, x: Floats) -> tuple[Ints, Floats]:
        """Nonzero functions at points x (n, 3), and their values (n, 4)."""
        y = np.clip((x - self._low) / self.edge, 0, self._count - 1e-9)
        corner = y.astype(np.int64)
        # From the low corner to the high one along the edges, the longest part first (Kuhn).
        order = np.argsort(corner - y, axis=1)
        part = np.take_along_axis(y - corner, order, axis=1)
        values = -np.diff(part, axis=1, prepend=1.0, append=0.0)
        steps = np.cumsum(np.eye(3, dtype=np.int64)[order], axis=1)
        corners = corner[:, None] + np.insert(steps, 0, 0, axis=1)
        return np.ravel_multi_index(tuple(np.moveaxis(corners, 2, 0)), self._count + 1), values


# Rows, columns and values of entries of a matrix.
Triplets = tuple[Ints, Ints, Floats]


def _hat_entries(
    functions_at_points: tuple[Ints, Floats], first_column: Ints, is_used: Bools, factor: Floats
) -> Triplets:
    """Used functions along each axis at n points, times a factor (n, 3), from a column each."""
    functions, values = functions_at_points
    values = np.where(is_used[functions], values, 0.0)
    shape, axes = (*functions.shape, 3), np.arange(3)
    rows = np.broadcast_to((3 * np.arange(len(values)))[:, None, None] + axes, shape)
    columns = first_column[functions][:, :, None] + axes
    entries = values[:, :, None] * factor[:, None, :]
    nonzero = entries != 0
    return rows[nonzero], columns[nonzero], entries[nonzero]


def _dense_entries(values: Floats, first_column: int) -> Triplets:
    """Triplets of a dense matrix (rows, m), with column numbers shifted by a first column."""
    rows, columns = np.nonzero(values)
    return rows, first_column + columns, values[rows, columns]


def sliding_motions(problem: Problem) -> CoarseSpace:
    """Smooth sliding motions of one body past the others, of displacement and jumps; collective.

    A deformable body has the motions of hat functions on boxes about the interfaces. Large boxes
    contain the whole body. Small boxes along the interfaces are for all bodies but the stiffest,
    since nothing slides where all bodies move together. A rigid body has six motions.
    """
    contact = problem.contact
    assert contact is not None
    comm, space, constraints = problem.comm, problem.space, problem.stiffness.constraints
    nodes = space.dofmap.index_map.size_local
    x, y = space.tabulate_dof_coordinates()[:nodes], contact.local.x
    large = Boxes(contact.points.x)
    edge = SMALL_BOX_EDGE[problem.scene.order] * float(np.mean(contact.edge_lengths))
    small = Boxes(contact.points.x, edge)
    grids = [(b, b(x), b(y)) for b in (large, small) if b is large or b.edge < large.edge]
    frame, modes = _scaled_rigid_motions(contact.points.x), constraints.modes
    rigid = {r.region for r in problem.scene.rigid}
    # Rows of nodal components, of owned unknowns and of jumps.
    triplets: list[list[Triplets]] = [[_dense_entries(np.zeros((0, 0)), 0)] for _ in range(3)]
    node_entries, unknown_entries, jump_entries = triplets
    next_column, stiffest = 0, _stiffest_body(problem)
    for body, name in enumerate(problem.bodies.names):
        of_body = _unmoved_components(problem, contact, body)
        master, slave = (contact.local.bodies == body).T
        sign = slave.astype(float) - master
        if rigid.issuperset(name.split(" + ")):
            unknowns = _unknowns_of_components(problem, of_body)
            unknown_entries.append(
                _dense_entries(unknowns[:, None] * (modes.T @ frame), next_column)
            )
            slides = (sign[:, None, None] * (rigid_modes(y) @ frame)).reshape(-1, 6)
            jump_entries.append(_dense_entries(slides, next_column))
            next_column += 6
            continue
        for boxes, at_nodes, at_points in grids[: 1 if body == stiffest else None]:
            inside = at_nodes[0][of_body.any(axis=1)] if boxes is large else at_points[0][sign != 0]
            is_used = comm.allreduce(np.bincount(inside.ravel(), minlength=boxes.size)) > 0
            first_column = next_column + 3 * (np.cumsum(is_used) - 1)
            node_entries.append(
                _hat_entries(at_nodes, first_column, is_used, of_body.astype(float))
            )
            jump_entries.append(
                _hat_entries(at_points, first_column, is_used, np.repeat(sign[:, None], 3, axis=1))
            )
            next_column += 3 * int(is_used.sum())
    entries = [
        tuple(map(np.concatenate, zip(*blocks_of_matrix, strict=True)))
        for blocks_of_matrix in triplets
    ]
    columns, column_number = _distributed(comm, [j for _, j, _ in entries], next_column)
    of_nodes, of_others, of_jumps = (
        from_triplets(comm, rows, columns, i, column_number[j], v)
        for rows, (i, j, v) in zip((3 * nodes, modes.shape[1], 3 * len(y)), entries, strict=True)
    )
    displacement = matrix_sum([constraints.rows(of_nodes), of_others])
    displacement.zeroRows(problem.stiffness.rows, diag=0.0)
    return CoarseSpace(displacement, of_jumps)


def _distributed(
    comm: MPI.Comm, columns_of_entries: Sequence[Ints], count: int
) -> tuple[int, Ints]:
    """Distribute columns over the ranks: each to the rank with most of its entries; collective.

    Args:
        comm: Communicator of the matrices.
        columns_of_entries: Column of each entry of this rank, for each matrix.
        count: Number of columns.

    Returns:
        Number of columns of this rank, and new numbers of all columns in the order of the ranks
        (count,).
    """
    entry_counts = sum(np.bincount(column, minlength=count) for column in columns_of_entries)
    owner = np.argmax(comm.allgather(entry_counts), axis=0)
    column_number = np.argsort(np.argsort(owner, kind="stable"))
    return int((owner == comm.rank).sum()), column_number


def displacement_by_motions(problem: Problem, motions: Floats) -> PETSc.Vec:
    """Displacement by rigid motions of all bodies (6 bodies,), without jumps; collective.

    The motions have the components of `ContactMotions.rigid`.
    """
    contact = problem.contact
    assert contact is not None
    x = problem.space.tabulate_dof_coordinates()[: problem.space.dofmap.index_map.size_local]
    nodal, R = np.zeros(x.shape), contact.motions.rigid(x)
    for body, motion in enumerate(motions.reshape(-1, 6)):
        if motion.any():  # equal on all ranks
            nodal += np.where(_unmoved_components(problem, contact, body), R @ motion, 0.0)
    return problem.stiffness.constraints.contract(nodal)


def _stiffest_body(problem: Problem) -> int:
    """The body with the largest modulus; rigid ones come first."""
    modulus = np.zeros(len(problem.bodies.names))
    for region, value in problem.scene.moduli.items():
        body = problem.bodies.body_of_region[region]
        modulus[body] = max(modulus[body], value)
    return int(modulus.argmax())


def _scaled_rigid_motions(x: Floats) -> Floats:
    """Rigid motions about the centre of points x, rotations scaled as translations."""
    frame = np.eye(6)
    frame[:3, 3:] = -rigid_modes(x.mean(axis=0)[None])[0, :, 3:]
    frame[:, 3:] /= np.linalg.norm(np.ptp(x, axis=0)) or 1.0
    return frame


def _unmoved_components(problem: Problem, contact: ContactInterfaces, body: int) -> Bools:
    """Owned nodal components of a body that no jump moves (n, 3); collective."""
    cells = problem.bodies.body_of_tag[cell_tags(problem.tagged)] == body
    nodes = touched_nodes(problem.space, cells)
    unmoved = np.repeat(nodes[:, None], 3, axis=1)
    if body in contact.coupling.jump_to_displacement:
        # There nodes are those of the other bodies.
        rows = contact.coupling.jump_to_displacement[body].getValuesCSR()[0]
        unmoved &= (np.diff(rows) == 0).reshape(-1, 3)
    return unmoved


def _unknowns_of_components(problem: Problem, components: Bools) -> Bools:
    """Owned unknowns that the given nodal components depend on."""
    is_reached = np.zeros(len(problem.stiffness.constraints.constrained), dtype=bool)
    vector = problem.stiffness.K.createVecLeft()
    for mode in problem.stiffness.constraints.modes:
        vector.array[:] = mode
        nodal = problem.stiffness.constraints.expand(vector)
        nodal.array[~components.ravel()] = 0
        is_reached |= problem.stiffness.constraints.vector(nodal).array != 0
    return is_reached
