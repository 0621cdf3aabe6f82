"""How the stem moves: against the bone around it, and at its ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from mantle.arrays import Floats, Ints
from mantle.mechanics.problem import Problem
from mantle.scene.bodies import FACET_VERTICES, FacetCells, facet_coordinates, facets_between
from mantle.schema.config import Case

# Nodes at an end of the stem are within this part of its length [-].
END = 1e-6


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
    regions = problem.tagged.regions
    implant, bone, cement = (
        [r for r in case.of_tissue(t) if r in regions] for t in ("implant", "bone", "cement")
    )
    if not implant or not bone:
        return {}
    from scipy.spatial import cKDTree  # imported late: few runs need it

    comm = problem.comm
    x, u, w = _surface(problem, implant, [*cement, *bone])
    z = _corners(problem, implant)[0][:, 2]
    ends = [
        float(comm.allreduce(float(e), how))
        for e, how in ((z.min(initial=np.inf), MPI.MIN), (z.max(initial=-np.inf), MPI.MAX))
    ]
    found: dict[str, Any] = {
        f"{name}_displacement": _at_height(problem, implant, end, END * (ends[1] - ends[0]))
        for name, end in zip(("tip", "top"), ends, strict=True)
    }
    beside = comm.allgather(_surface(problem, bone, [*cement, *implant]))
    y, v, a = (np.concatenate([part[k] for part in beside]) for k in range(3))
    if not len(y) or comm.allreduce(len(w)) == 0:
        return found  # it touches something else
    # The rigid motion of all bone moves stem and bone differently where they are apart: it is taken
    # out first. What is left, the bone's deformation, is that of the nearest point.
    whole = _rigid_fit(MPI.COMM_SELF, y, v, a)
    nearest: Ints = cKDTree(y).query(x)[1] if len(x) else np.zeros(0, dtype=np.int64)
    deformed = (v - whole(y))[nearest]
    motion = _rigid_fit(comm, x, u - whole(x) - deformed, w)
    t, ω = motion.translation, np.rad2deg(motion.rotation)
    medial = 1.0 if case.side == "left" else -1.0
    return {
        "subsidence": float(-t[2]),
        "retroversion": float(-medial * ω[2]),
        "varus": float(medial * ω[1]),
        **found,
    }


def _surface(
    problem: Problem, inside: Sequence[str], outside: Sequence[str]
) -> tuple[Floats, Floats, Floats]:
    """Centres (f, 3) [mm] of own facets between regions, displacement (f, 3), area (f,)."""
    f: FacetCells = facets_between(problem.tagged, inside, outside)
    corners = facet_coordinates(problem.tagged, f)[0][:, :3]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    u = np.zeros((len(corners), 3))
    for region in inside:
        of_region = np.isin(f.cells, problem.mechanics.region_cells(region))
        dofs = _corner_dofs(problem, f.cells[of_region])
        at = np.array(FACET_VERTICES)[f.local[of_region]].reshape(-1, 3)
        dofs = np.take_along_axis(dofs, at, axis=1)
        u[of_region] = _values(problem, region)[dofs].mean(axis=1)
    return corners.mean(axis=1), u, np.linalg.norm(normal, axis=1) / 2


def _corner_dofs(problem: Problem, cells: NDArray[Any]) -> Ints:
    """Rows of the displacement at the corners of cells (c, 4)."""
    layout = problem.space.dofmap.dof_layout
    corner = [layout.entity_dofs(0, v)[0] for v in range(4)]
    return np.asarray(problem.space.dofmap.list[cells][:, corner], dtype=np.int64)


def _values(problem: Problem, region: str) -> Floats:
    """Displacement of a region's body at all nodes of this rank (n, 3) [mm]."""
    function = problem.displacements()[problem.bodies.of_region[region]]
    return np.asarray(function.x.array.reshape(-1, 3))


def _corners(problem: Problem, regions: Sequence[str]) -> tuple[Floats, Floats]:
    """Corners of own cells of regions (n, 3) [mm], and their displacement (n, 3) [mm]."""
    x = problem.space.tabulate_dof_coordinates()
    cells = [problem.mechanics.region_cells(r) for r in regions]
    rows: list[Ints] = [np.unique(_corner_dofs(problem, c)) for c in cells]
    u = [_values(problem, r)[row] for r, row in zip(regions, rows, strict=True)]
    return x[np.concatenate(rows)], np.concatenate(u)


def _at_height(problem: Problem, regions: Sequence[str], z: float, within: float) -> list[float]:
    """Mean displacement of the corners of regions at a height (3,) [mm]; collective."""
    x, u = _corners(problem, regions)
    here = np.abs(x[:, 2] - z) <= within
    pieces = problem.comm.allgather((x[here], u[here]))
    places, values = (np.concatenate([p[k] for p in pieces]) for k in range(2))
    # Ranks share nodes.
    _, first = np.unique(np.round(places / within), axis=0, return_index=True)
    return [float(c) for c in values[first].mean(axis=0)]


@dataclass(frozen=True)
class _Motion:
    """A rigid motion: rotation (3,) [rad] about a centre (3,) [mm], and its translation (3,)."""

    centre: Floats
    translation: Floats
    rotation: Floats

    def __call__(self, x: Floats) -> Floats:
        """Displacement of points (n, 3) [mm]."""
        return np.asarray(self.translation + np.cross(self.rotation, x - self.centre))


def _rigid_fit(comm: MPI.Comm, x: Floats, u: Floats, w: Floats) -> _Motion:
    """Least-squares rigid motion of points; collective.

    Args:
        comm: The ranks.
        x: Own points (n, 3) [mm].
        u: Their displacements (n, 3) [mm].
        w: Their weights (n,).
    """

    def total(values: NDArray[np.floating[Any]]) -> Floats:
        return np.asarray(comm.allreduce(np.einsum("p,p...->...", w, values), MPI.SUM))

    whole = total(np.ones(len(w)))
    centre, t = total(x) / whole, total(u) / whole
    ξ = x - centre
    second = total(np.einsum("pi,pj->pij", ξ, ξ))
    inertia = np.trace(second) * np.eye(3) - second
    return _Motion(centre, t, np.linalg.solve(inertia, total(np.cross(ξ, u - t))))
