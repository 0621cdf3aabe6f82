"""Refinement of swept meshes: every new node is put on the surfaces by its own coordinates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from app.arrays import Floats, Ints
from meshes.curving import untangle
from meshes.data import EDGES, FACES, FACES_QUADRATIC, cell_faces, corners, distinct, match_faces
from meshes.layers import Nodes, Swept, lines_of, place
from meshes.quality import straight

SURER = 1e-6  # a diagonal is taken instead of the usual one if it is better by this much
# How much of the larger thickness a mid-edge node keeps beside a layer's end: else cells invert.
KEPT = 0.8


# The octahedron that is left when the four corners of a cell are cut off, divided around each of
# its diagonals; nodes 4 to 9 are the middles of `EDGES`. All are as positive as the cell.
CORNERS = ((0, 4, 6, 7), (4, 1, 5, 9), (6, 5, 2, 8), (7, 9, 8, 3))
AROUND = {
    (4, 8): (6, 7, 9, 5),
    (5, 7): (9, 8, 6, 4),
    (6, 9): (4, 5, 8, 7),
}
_CHILDREN = np.array(
    [
        (*CORNERS, *((p, q, ring[k], ring[(k + 1) % 4]) for k in range(4)))
        for (p, q), ring in AROUND.items()
    ]
)
# For each diagonal: the partners of the children's faces (32,), -1 for those on the cell's; and
# which of these is in the middle of each of the cell's faces (4,), not at a corner.
_INNER = np.array([match_faces(children) for children in _CHILDREN])
_CENTRES = np.array(
    [
        [
            next(r for r, nodes in enumerate(cell_faces(children)) if np.isin(nodes, middles).all())
            for middles in FACES_QUADRATIC[:, 3:]
        ]
        for children in _CHILDREN
    ]
)


def refined(made: Swept) -> Swept:
    """Divide each cell into eight: four corners, and four around the octahedron's best diagonal."""
    ends, of = _edges(made.cells)
    nodes = _joined(made.nodes, _middles(made, ends))
    local = np.hstack([made.cells, of + len(made.nodes)])
    best = _best(nodes.x, local)
    children = _CHILDREN[best].reshape(-1, 32) + 10 * np.arange(len(local))[:, None]
    cells = local.ravel().take(children).reshape(-1, 4)
    return replace(
        made,
        nodes=nodes,
        cells=cells,
        layer=np.repeat(made.layer, 8),
        slab=np.repeat(made.slab, 8),
        partner=_partners(made, best),
    )


def _best(points: Floats, local: Ints) -> Ints:
    """Diagonal with the best least quality around it: numbers of `AROUND`, shape (m,)."""
    best = []
    for middles in corners(points, local[:, 4:]):
        x = dict(enumerate(middles, start=4))
        chosen = np.zeros(middles[0].shape[1], dtype=np.int64)
        worth = np.full(len(chosen), -np.inf)
        for way, ((p, q), ring) in enumerate(AROUND.items()):
            own = [x[k] - x[p] for k in (q, *ring, ring[0])]
            other = np.min([straight(own[0], *own[k : k + 2]) for k in range(1, 5)], axis=0)
            better = other > worth + SURER
            chosen[better], worth[better] = way, other[better]
        best.append(chosen)
    return np.concatenate(best)


def _partners(made: Swept, best: Ints) -> Ints:
    """Partners of the children, as of `match_faces`, around the diagonals `best` (m,)."""
    first = 32 * np.arange(len(best))
    inner = _INNER[best]
    partner = np.where(inner < 0, -1, inner + first[:, None]).ravel()
    row = np.flatnonzero(made.partner > np.arange(len(made.partner)))
    cell, face = np.divmod(row, 4)
    other, behind = np.divmod(made.partner[row], 4)
    pairs = [(_CENTRES[best[cell], face], _CENTRES[best[other], behind])]
    nodes = made.cells[other]
    for corner in FACES[face].T:
        # The child at a corner has the same faces as its parent.
        same = nodes == made.cells[cell, corner][:, None]
        pairs.append((4 * corner + face, 4 * same.argmax(axis=1) + behind))
    for here, there in pairs:
        here, there = here + first[cell], there + first[other]
        partner[here], partner[there] = there, here
    return partner


def curved(made: Swept) -> Swept:
    """Give each edge a middle node on the surfaces; cells that bend too far are straightened."""
    ends, of = _edges(made.cells)
    nodes = _joined(made.nodes, _middles(made, ends, beside_ends=True))
    cells = np.hstack([made.cells, of + len(made.nodes)])
    return replace(made, nodes=replace(nodes, x=untangle(nodes.x, cells)), cells=cells)


def _middles(made: Swept, ends: Ints, beside_ends: bool = False) -> Nodes:
    """Nodes in the middle of edges, given by their ends (e, 2).

    ``beside_ends`` keeps layers from getting too thin beside their end: curved cells invert.
    """
    nodes, turn = made.nodes, made.surfaces.spokes * made.unit
    a, b = ends.T
    apart = nodes.phi[b] - nodes.phi[a]
    apart = (apart + turn // 2) % turn - turn // 2  # the short way around
    both = nodes.merged[a] & nodes.merged[b]
    rho = [nodes.rho[k].copy() for k in (a, b)]
    for own, other in ((0, 1), (1, 0)):
        # A merged node is on mantle and endosteum: it takes whichever the other is nearer to.
        alone = nodes.merged[(a, b)[own]] & ~both
        rho[own][alone] = np.clip(rho[other][alone], 2 * made.unit, 3 * made.unit)
    inner = (nodes.rho[a] <= 0) | (nodes.rho[b] <= 0)
    shell = inner & (np.minimum(np.abs(nodes.rho[a]), np.abs(nodes.rho[b])) >= 3 * made.unit)
    across = np.where(both, 3 * made.unit, (rho[0] + rho[1]) // 2)
    middle = Nodes(
        phi=np.where(inner, 0, (nodes.phi[a] + apart // 2) % turn),
        rho=np.where(inner, np.where(shell, -3 * made.unit, 0), across),
        s=(nodes.s[a] + nodes.s[b]) // 2,
        merged=both & ~inner,
        error=np.where(inner, 0.0, 0.5 * (nodes.error[a] + nodes.error[b])),
        floor=np.where(inner, 0.0, 0.5 * (nodes.floor[a] + nodes.floor[b])),
        x=0.5 * (nodes.x[a] + nodes.x[b]),
    )
    if beside_ends:
        middle = replace(middle, floor=np.maximum(middle.floor, _steep(made, a, b)))
    middle.x[shell] = made.surfaces.arc(nodes.x[a[shell]], nodes.x[b[shell]])
    return place(made.surfaces, middle, made.unit)


def _steep(made: Swept, a: Ints, b: Ints) -> Floats:
    """Least thickness in the middle of edges between a thin and a thick end of a layer [mm]."""
    gap = _thickness(made)
    thin, thick = np.minimum(gap[a], gap[b]), np.maximum(gap[a], gap[b])
    return np.where(2 * thin < thick, KEPT * 0.5 * (thin + thick), 0.0)


def _thickness(made: Swept) -> Floats:
    nodes = made.nodes
    lines, line = lines_of(made.surfaces, nodes.phi, nodes.s, made.unit)
    return np.where(nodes.rho <= 0, 0.0, np.maximum(lines.gap[line] + nodes.error, 0.0))


def _edges(cells: Ints) -> tuple[Ints, Ints]:
    """Edges of the cells (e, 2), and the six of each cell as rows of them (m, 6)."""
    a, b = (cells[:, k].ravel() for k in np.array(EDGES).T)
    n = int(cells.max()) + 1
    keys, of = distinct(np.minimum(a, b) * n + np.maximum(a, b))
    return np.stack([keys // n, keys % n], axis=1), of.reshape(-1, 6)


def _joined(a: Nodes, b: Nodes) -> Nodes:
    return Nodes(**{name: np.concatenate([v, vars(b)[name]]) for name, v in vars(a).items()})
