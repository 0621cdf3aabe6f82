"""How the stem moves: against the bone around it, and at its ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from app.arrays import Floats, Ints
from app.case.case import Case
from app.mechanics.problem import Problem
from app.scene.bodies import (
    FACET_VERTICES,
    FacetCells,
    cell_tags,
    facet_coordinates,
    facets_between,
)

# Nodes at an end of the stem are within this part of its length [-].
END = 1e-6
ENDS = ("tip_displacement", "top_displacement")
# Derivatives by displacements: bodies, nodes of each (n,), and derivatives there (n, 3).
Gradient = list[tuple[int, Ints, Floats]]


def stem_motion(problem: Problem, case: Case) -> dict[str, Any]:
    """Motion of the implant; nothing without implant or bone; collective.

    ``subsidence`` [mm] (distal, -z), ``retroversion`` and ``varus`` [deg] are the rigid motion that
    fits best, by area, how the surface of the stem that faces cement or bone moves against the
    nearest surface of bone that faces cement or stem. The neck has no part in them, nor have the
    rigid motion and the bending of the femur. Retroversion turns the medial side towards posterior,
    varus tilts the top towards medial; `Case.side` says where medial is.

    ``tip_displacement`` and ``top_displacement`` (3,) [mm] are those of the stem's lowest and
    highest nodes in the frame of the model, with the bending of the femur.
    """
    comm = problem.comm
    u = [f.x.array.reshape(-1, 3) for f in problem.displacements()]

    def value(gradient: Gradient) -> float:
        own = sum(float((g * u[body][nodes]).sum()) for body, nodes, g in gradient)
        return float(comm.allreduce(own))

    found: dict[str, Any] = {key: value(g) for key, g in _relative(problem, case).items()}
    if ends := _ends(problem, case):
        found |= {end: [value(g) for g in ends[end]] for end in ENDS}
    return found


def _tissues(problem: Problem, case: Case) -> list[list[str]]:
    """Regions of implant, bone and cement that are deformed."""
    known = problem.tagged.regions
    return [[r for r in case.of_tissue(t) if r in known] for t in ("implant", "bone", "cement")]


def _relative(problem: Problem, case: Case) -> dict[str, Gradient]:
    """Gradients of the motions against the bone; none where stem or bone touches nothing."""
    comm = problem.comm
    implant, bone, cement = _tissues(problem, case)
    own = (
        _surface(problem, implant, [*cement, *bone]),
        _surface(problem, bone, [*cement, *implant]),
    )
    # All facets on every rank: they are few.
    (x, w), (y, a) = ((np.concatenate(comm.allgather(p)) for p in (s.x, s.area)) for s in own)
    if not len(x) or not len(y):
        return {}
    from scipy.spatial import cKDTree  # imported late: few runs need it

    nearest = cKDTree(y).query(x)[1]
    medial = 1.0 if case.side == "left" else -1.0
    t, ω = np.eye(6)[:3], np.rad2deg(np.eye(6)[3:])
    rows = {"subsidence": -t[2], "retroversion": -medial * ω[2], "varus": medial * ω[1]}
    by_stem, by_bone = _fit(x, w), _fit(y, a)[3:]
    begins = [sum(comm.allgather(len(s.x))[: comm.rank]) for s in own]
    found: dict[str, Gradient] = {}
    for key, row in rows.items():
        of_stem = np.einsum("k,kpi->pi", row, by_stem)
        of_bone = np.zeros(y.shape)
        np.add.at(of_bone, nearest, -of_stem)
        # The rigid motion of all bone moves stem and bone differently where they are apart: it is
        # taken out. What is left, the bone's deformation, is that of the nearest point.
        turn = np.cross(y[nearest] - x, of_stem).sum(axis=0)
        of_bone += np.einsum("k,kpi->pi", turn, by_bone)
        found[key] = []
        for surface, of_facet, begin in zip(own, (of_stem, of_bone), begins, strict=True):
            mine = of_facet[begin : begin + len(surface.x)] / 3
            for body in np.unique(surface.body):
                here = surface.body == body
                nodes = surface.dofs[here].ravel()
                found[key].append((int(body), nodes, np.repeat(mine[here], 3, axis=0)))
    return found


def _fit(x: Floats, w: Floats) -> Floats:
    """Rigid motion (translation of the centre, rotation) that fits displacements of points best.

    Args:
        x: The points (n, 3) [mm].
        w: Their weights (n,).

    Returns:
        Its derivatives by the displacements (6, n, 3).
    """
    ξ = x - np.average(x, axis=0, weights=w)
    second = np.einsum("p,pi,pj->ij", w, ξ, ξ)
    turning = np.linalg.inv(np.trace(second) * np.eye(3) - second)
    translation = np.eye(3)[:, None, :] * (w / w.sum())[None, :, None]
    rotation = np.cross(turning[:, None, :], ξ[None]) * w[None, :, None]
    return np.concatenate([translation, rotation])


def _ends(problem: Problem, case: Case) -> dict[str, list[Gradient]]:
    """Gradients of the displacement of both ends, by component; none without implant or bone."""
    implant, bone, _ = _tissues(problem, case)
    if not implant or not bone:
        return {}
    comm = problem.comm
    pairs = [
        (np.full(len(dofs), problem.bodies.of_region[region]), dofs)
        for region in implant
        for dofs in [np.unique(corner_dofs(problem, problem.mechanics.region_cells(region)))]
    ]
    body, dofs = (np.concatenate(part) for part in zip(*pairs, strict=True))
    x = problem.space.tabulate_dof_coordinates()[dofs]
    low = comm.allreduce(float(x[:, 2].min(initial=np.inf)), MPI.MIN)
    high = comm.allreduce(float(x[:, 2].max(initial=-np.inf)), MPI.MAX)
    within = END * (high - low)
    found = {}
    for end, z in zip(ENDS, (low, high), strict=True):
        here = np.flatnonzero(np.abs(x[:, 2] - z) <= within)
        # Ranks share nodes: the first of them counts.
        places = comm.allgather(x[here])
        _, first = np.unique(np.round(np.concatenate(places) / within), axis=0, return_index=True)
        begin = sum(map(len, places[: comm.rank]))
        mine = here[first[(first >= begin) & (first < begin + len(here))] - begin]
        found[end] = [
            [
                (int(b), nodes, np.tile(component / len(first), (len(nodes), 1)))
                for b in np.unique(body[mine])
                for nodes in [dofs[mine[body[mine] == b]]]
            ]
            for component in np.eye(3)
        ]
    return found


@dataclass(frozen=True)
class _Surface:
    """Own facets between regions.

    Attributes:
        x: Centres (f, 3) [mm].
        dofs: Rows of the displacement at their corners (f, 3).
        body: Body that they are seen from (f,).
        area: Areas (f,) [mm2].
    """

    x: Floats
    dofs: Ints
    body: Ints
    area: Floats


def _surface(problem: Problem, inside: Sequence[str], outside: Sequence[str]) -> _Surface:
    """Own facets between regions, as seen from those inside."""
    f: FacetCells = facets_between(problem.tagged, inside, outside)
    corners = facet_coordinates(problem.tagged, f)[0][:, :3]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    dofs = corner_dofs(problem, f.cells)
    dofs = np.take_along_axis(dofs, np.array(FACET_VERTICES)[f.local].reshape(-1, 3), axis=1)
    body = problem.bodies.of_tag[cell_tags(problem.tagged)[f.cells]]
    return _Surface(corners.mean(axis=1), dofs, body, np.linalg.norm(normal, axis=1) / 2)


def corner_dofs(problem: Problem, cells: NDArray[Any]) -> Ints:
    """Rows of the displacement at the corners of cells (c, 4)."""
    layout = problem.space.dofmap.dof_layout
    corner = [layout.entity_dofs(0, v)[0] for v in range(4)]
    return np.asarray(problem.space.dofmap.list[cells][:, corner], dtype=np.int64)
