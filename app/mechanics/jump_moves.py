"""How jumps move the bodies on either side."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
from dolfinx import fem

from app.arrays import Ints
from app.mechanics.body_forms import BodyForms
from app.numerics.sparse import from_triplets
from meshes.contact_points import Entries


def jump_moves(
    mechanics: BodyForms, entries: Entries, place: Ints, points: int
) -> tuple[dict[int, PETSc.Mat], dict[int, fem.Form]]:
    """Displacement of bodies by jumps, and the stiffness of the cells that move; collective.

    Args:
        mechanics: The bonded bodies.
        entries: Of the displacement of all bodies by all jumps.
        place: Number of each contact point among those of all ranks.
        points: How many of them this rank owns.

    Returns:
        By body the matrix (displacements, jumps), and the form of its stiffness.
    """
    comm, index_map = mechanics.space.mesh.comm, mechanics.space.dofmap.index_map
    start, end = (3 * k for k in index_map.local_range)
    n_u, n_q = 3 * index_map.size_local, 3 * points
    moves: dict[int, PETSc.Mat] = {}
    strips: dict[int, fem.Form] = {}
    ghosts = index_map.ghosts
    for body in map(int, np.unique(entries.body)):
        here = entries.body == body
        row, column, value = entries.row[here], entries.column[here], entries.value[here]
        column = 3 * place[column // 3] + column % 3
        own = (row >= start) & (row < end)
        B = from_triplets(comm, n_u, n_q, row[own] - start, column[own], value[own])
        moves[body] = B
        marked = np.zeros(index_map.size_local + index_map.num_ghosts, dtype=bool)
        nodes = np.unique(row // 3)
        marked[: index_map.size_local] = np.isin(
            np.arange(start // 3, end // 3, dtype=np.int64), nodes
        )
        marked[index_map.size_local :] = np.isin(ghosts, nodes)
        strips[body] = mechanics.strip_stiffness(body, marked)
    return moves, strips
