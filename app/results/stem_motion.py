"""Motion of the stem: against the bone around it, and at its ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np

from app.arrays import Floats
from app.case.case import Case
from app.mechanics.problem import Problem
from app.scene import bodies

# Nodes at an end of the stem are within this part of its length [-].
END = 1e-6
ENDS = ("tip_displacement", "top_displacement")


def stem_motion(problem: Problem, case: Case) -> dict[str, Any]:
    """Motion of the implant; nothing without implant or bone; collective.

    ``subsidence`` [mm] (distal, -z), ``retroversion`` and ``varus`` [deg] are the rigid motion that
    fits best, by area, the motion of the stem's surface facing cement or bone against the nearest
    surface of bone that faces cement or stem. The neck has no part in them, nor have the rigid
    motion and the bending of the femur. Retroversion turns the medial side towards posterior, varus
    tilts the top towards medial; `Case.side` says where medial is.

    ``tip_displacement`` and ``top_displacement`` (3,) [mm] are those of the stem's lowest and
    highest nodes in the frame of the model, with the bending of the femur.
    """
    known = problem.tagged.regions
    implant, bone, cement = (
        [r for r in case.of_tissue(t) if r in known] for t in ("implant", "bone", "cement")
    )
    if not implant or not bone:
        return {}
    found = _ends(problem, implant)
    stem = _surface(problem, implant, [*cement, *bone])
    facing = _surface(problem, bone, [*cement, *implant])
    if len(stem.x) and len(facing.x):
        t, ω = _against(stem, facing)
        ω = np.rad2deg(ω) * (1 if case.side == "left" else -1)
        motion = {"subsidence": -t[2], "retroversion": -ω[2], "varus": ω[1]}
        return {key: float(value) for key, value in motion.items()} | found
    return found


@dataclass(frozen=True)
class _Surface:
    """Facets between regions, of all ranks: centres (f, 3) [mm], displacements, and areas (f,)."""

    x: Floats
    u: Floats
    area: Floats

    def rotation(self, u: Floats) -> Floats:
        """Small rotation (3,) that fits displacements of the centres best, by area."""
        ξ = self.x - np.average(self.x, axis=0, weights=self.area)
        second = np.einsum("p,pi,pj->ij", self.area, ξ, ξ)
        inertia = np.trace(second) * np.eye(3) - second
        return np.linalg.solve(inertia, self.area @ np.cross(ξ, u))


def _surface(problem: Problem, inside: Sequence[str], outside: Sequence[str]) -> _Surface:
    """Facets between regions, as seen from those inside: few enough for every rank."""
    f: bodies.FacetCells = bodies.facets_between(problem.tagged, inside, outside)
    corners = bodies.facet_coordinates(problem.tagged, f)[0][:, :3]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    dofs = problem.space.dofmap.list[f.cells][:, :4]
    dofs = np.take_along_axis(dofs, bodies.FACET_NODES[f.local, :3], axis=1)
    body = problem.bodies.of_tag[bodies.cell_tags(problem.tagged)[f.cells]]
    u = _displacements(problem)[body[:, None], dofs].mean(axis=1)
    own = corners.mean(axis=1), u, np.linalg.norm(normal, axis=1) / 2
    return _Surface(*(np.concatenate(problem.comm.allgather(part)) for part in own))


def _against(stem: _Surface, bone: _Surface) -> tuple[Floats, Floats]:
    """Translation [mm] and rotation of the stem against the bone.

    The rigid motion of all bone is subtracted, as it moves stem and bone differently where they are
    apart. The rest, the bone's deformation, is taken at the nearest point.
    """
    from scipy.spatial import cKDTree  # imported late: few runs need it

    nearest = cKDTree(bone.x).query(stem.x)[1]
    ω = bone.rotation(bone.u)
    v = stem.u - bone.u[nearest] - np.cross(ω, stem.x - bone.x[nearest])
    return np.average(v, axis=0, weights=stem.area), stem.rotation(v)


def _ends(problem: Problem, implant: Sequence[str]) -> dict[str, Any]:
    comm, u = problem.comm, _displacements(problem)
    cells = {r: problem.mechanics.region_cells(r) for r in implant}
    dofs_of = {r: np.unique(problem.space.dofmap.list[c][:, :4]) for r, c in cells.items()}
    dofs = np.concatenate(list(dofs_of.values()))
    body = problem.bodies.of_region
    moved = np.concatenate([u[body[r], rows] for r, rows in dofs_of.items()])
    x = problem.space.tabulate_dof_coordinates()[dofs]
    low = comm.allreduce(float(x[:, 2].min(initial=np.inf)), MPI.MIN)
    high = comm.allreduce(float(x[:, 2].max(initial=-np.inf)), MPI.MAX)
    within = END * (high - low)
    found = {}
    for end, z in zip(ENDS, (low, high), strict=True):
        here = np.abs(x[:, 2] - z) <= within
        places, own = (np.concatenate(comm.allgather(part[here])) for part in (x, moved))
        # Ranks and regions share nodes: each counts once.
        first = np.unique(np.round(places / within), axis=0, return_index=True)[1]
        found[end] = [float(c) for c in own[first].mean(axis=0)]
    return found


def _displacements(problem: Problem) -> Floats:
    """Of all bodies at all nodes of this rank (bodies, n, 3) [mm]."""
    return np.stack([f.x.array.reshape(-1, 3) for f in problem.displacements()])
