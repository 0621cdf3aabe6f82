"""Refinement of swept meshes: every new node is put on the surfaces by its own coordinates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .curving import untangle
from .data import EDGES, Floats, Ints
from .layers import Nodes, Swept, lines_of, place
from .quality import sicn

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


def refined(made: Swept) -> Swept:
    """Divide each cell into eight: four corners, and four around the octahedron's best diagonal."""
    ends, of = _edges(made.cells)
    nodes = _joined(made.nodes, _middles(made, ends))
    local = np.hstack([made.cells, of + len(made.nodes)])
    choices = []
    for (p, q), ring in AROUND.items():
        ways = [(p, q, ring[k], ring[(k + 1) % 4]) for k in range(4)]
        choices.append(local[:, ways])
    best = choices[0]
    worth = sicn(nodes.x, best.reshape(-1, 4)).reshape(-1, 4).min(axis=1)
    for cells in choices[1:]:
        other = sicn(nodes.x, cells.reshape(-1, 4)).reshape(-1, 4).min(axis=1)
        better = other > worth + SURER
        best = np.where(better[:, None, None], cells, best)
        worth = np.where(better, other, worth)
    corners = local[:, np.array(CORNERS)]
    cells = np.concatenate([corners, best], axis=1).reshape(-1, 4)
    return replace(
        made,
        nodes=nodes,
        cells=cells,
        layer=np.repeat(made.layer, 8),
        slab=np.repeat(made.slab, 8),
    )


def curved(made: Swept) -> Swept:
    """Give each edge a middle node on the surfaces; cells that bend too far are straightened."""
    ends, of = _edges(made.cells)
    nodes = _joined(made.nodes, _middles(made, ends, beside_ends=True))
    cells = np.hstack([made.cells, of + len(made.nodes)])
    return replace(made, nodes=replace(nodes, x=untangle(nodes.x, cells)), cells=cells)


def _middles(made: Swept, ends: Ints, beside_ends: bool = False) -> Nodes:
    """Nodes in the middle of edges.

    Args:
        made: The mesh.
        ends: Both ends of each edge (e, 2).
        beside_ends: Whether a layer that ends must not get too thin beside it: curved cells invert.
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
    inner = (nodes.rho[a] == 0) | (nodes.rho[b] == 0)
    middle = Nodes(
        phi=np.where(inner, 0, (nodes.phi[a] + apart // 2) % turn),
        rho=np.where(inner, 0, np.where(both, 3 * made.unit, (rho[0] + rho[1]) // 2)),
        s=(nodes.s[a] + nodes.s[b]) // 2,
        merged=both & ~inner,
        error=np.where(inner, 0.0, 0.5 * (nodes.error[a] + nodes.error[b])),
        floor=np.where(inner, 0.0, 0.5 * (nodes.floor[a] + nodes.floor[b])),
        x=0.5 * (nodes.x[a] + nodes.x[b]),
    )
    if beside_ends:
        middle = replace(middle, floor=np.maximum(middle.floor, _steep(made, a, b)))
    x = middle.x
    x[inner] = made.surfaces.inside(x[inner], middle.s[inner] / made.unit)
    return place(made.surfaces, replace(middle, x=x), made.unit)


def _steep(made: Swept, a: Ints, b: Ints) -> Floats:
    """Least thickness in the middle of edges between a thin and a thick end of a layer [mm]."""
    gap = _thickness(made)
    thin, thick = np.minimum(gap[a], gap[b]), np.maximum(gap[a], gap[b])
    return np.where(2 * thin < thick, KEPT * 0.5 * (thin + thick), 0.0)


def _thickness(made: Swept) -> Floats:
    """Used thickness of the layer between mantle and endosteum at each node [mm]."""
    nodes = made.nodes
    lines, line = lines_of(made.surfaces, nodes.phi, nodes.s, made.unit)
    return np.where(nodes.rho == 0, 0.0, np.maximum(lines.gap[line] + nodes.error, 0.0))


def _edges(cells: Ints) -> tuple[Ints, Ints]:
    """Edges of the cells (e, 2), and the six of each cell as rows of them (m, 6)."""
    ends = np.sort(cells[:, :4][:, np.array(EDGES)].reshape(-1, 2), axis=1)
    n = int(cells.max()) + 1
    keys, of = np.unique(ends[:, 0] * n + ends[:, 1], return_inverse=True)
    return np.stack([keys // n, keys % n], axis=1), of.reshape(-1, 6)


def _joined(a: Nodes, b: Nodes) -> Nodes:
    return Nodes(**{name: np.concatenate([v, vars(b)[name]]) for name, v in vars(a).items()})
