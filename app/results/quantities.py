"""The numbers that people publish: interfaces, stresses by region, motion of the stem.

All functions are collective and return the same plain values on every rank. Percentiles are
weighted by area or volume; maxima are reported beside them because peaks at edges grow with
refinement.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

import basix
import numpy as np
from numpy.typing import NDArray

from mantle.arrays import Floats
from mantle.forms.contact import OPEN, SLIP, STICK
from mantle.mechanics.problem import Problem, TrialState
from mantle.results.percentiles import percentile
from mantle.results.stresses import volumes_and_centres
from mantle.schema.quantities import computed

MICROMOTION = 0.030  # mm: where biology reacts


def _pressure(pressures: Floats, normals: Floats) -> Floats:
    """Normal force per area (n,) [MPa], from those of the faces of each point (n, 3).

    Negative is tension, which laws that cannot open may have.
    """
    size = np.linalg.norm(np.einsum("pk,pki->pi", pressures, normals), axis=1)
    return np.where(pressures.sum(axis=1) < 0, -size, size)


def face_average(values: Floats, area: Floats) -> float:
    """Mean of what belongs to the faces of points (n, 3), by their areas (n, 3)."""
    return float(np.average(values[area > 0], weights=area[area > 0]))


class Samples:
    """Contact points of all ranks, in canonical order, on every rank.

    One row per point for vectors, one per point and face for what belongs to a face.

    Attributes:
        interface: Interface of each point (n,).
        x: Position (n, 3) [mm].
        weight: Area (n,) [mm2].
        area: Area of each face (n, 3) [mm2]; 0 beyond the point's faces.
        gap: Opening of each face (n, 3) [mm].
        slip: Tangential part of the jump on each face (n, 3) [mm].
        accumulated: Sum of slip increments on each face (n, 3) [mm].
        pressure: Normal force per area, positive in compression (n,) [MPa].
        shear: Friction per area (n,) [MPa].
        force: Force of the master on the slave per area (n, 3) [MPa].
        status: State (n,).
        jump: Jump with the initial gap (n, 3) [mm].
        dissipation: Dissipated by friction (n,) [N mm].
        least: Smallest dissipation of any step, 0 at most (n,) [N mm].
        contact_work: Work of the pressures in the opening (n,) [N mm].
        found: What `interface` has found of them, by interface.
    """

    def __init__(self, problem: Problem, trial: TrialState) -> None:
        """Gather a committed state; collective."""
        self.found: dict[int, dict[str, Any]] = {}
        (j,) = problem.jumps
        history = j.history
        normal = np.einsum("pi,pki->pk", trial.jump, j.normals)
        tangential = trial.jump[:, None, :] - normal[:, :, None] * j.normals
        opening = np.einsum("pi,pki->pk", trial.jump + j.gap, j.normals)
        used = np.arange(3)[None, :] < j.faces[:, None]
        local = {
            "row": j.mine,
            "gap": np.where(used, opening, 0.0),
            "slip": np.where(used, np.linalg.norm(tangential, axis=2), 0.0),
            "accumulated": np.where(used, history.accumulated, 0.0),
            "pressure": _pressure(trial.law.pressures, j.normals),
            "shear": np.linalg.norm(history.friction, axis=1),
            "force": -history.force,
            "status": np.where(j.faces > 0, trial.law.status, STICK),
            "jump": trial.jump + j.gap,
            "dissipation": history.dissipation,
            "least": history.least,
            "contact_work": history.contact_work,
        }
        pieces = problem.comm.allgather(local)
        whole = {key: np.concatenate([p[key] for p in pieces]) for key in local}
        order = np.argsort(whole.pop("row"))
        points = j.points
        self.points = points
        self.interface, self.x, self.weight = points.interface, points.x, points.weight
        faces = np.arange(3)[None, :] < points.faces[:, None]
        self.area = np.where(faces, points.areas, 0.0)
        self.gap, self.slip, self.accumulated, self.pressure = (
            whole[k][order] for k in ("gap", "slip", "accumulated", "pressure")
        )
        self.shear, self.force, self.status, self.jump = (
            whole[k][order] for k in ("shear", "force", "status", "jump")
        )
        self.dissipation, self.least, self.contact_work = (
            whole[k][order] for k in ("dissipation", "least", "contact_work")
        )


def interface(problem: Problem, samples: Samples, i: int) -> dict[str, Any]:
    """Motion, tractions and states of one interface; computed once for each state."""
    if i not in samples.found:
        samples.found[i] = _interface(problem, samples, i)
    return dict(samples.found[i])


def _interface(problem: Problem, s: Samples, i: int) -> dict[str, Any]:
    at = s.interface == i
    area, weight = s.area[at], s.weight[at]
    total = float(weight.sum())
    x = np.repeat(s.x[at][:, None, :], 3, axis=1)

    def largest(values: Floats) -> tuple[float, list[float]]:
        flat = np.where(area > 0, values, -np.inf).ravel()
        k = int(np.argmax(flat))
        return float(max(flat[k], 0.0)), [float(c) for c in x.reshape(-1, 3)[k]]

    def p99(values: Floats) -> float:
        return percentile(values[area > 0], area[area > 0])

    gap, slip = np.maximum(s.gap[at], 0.0), s.slip[at]
    pressure, shear = s.pressure[at], s.shear[at]
    gap_max, gap_at = largest(gap)
    slip_max, slip_at = largest(slip)
    faces = area > 0

    def fraction(state: int) -> float:
        return float(weight[s.status[at] == state].sum()) / total

    return {
        "gap_max": gap_max,
        "gap_p99": p99(gap),
        "gap_mean": face_average(gap, area),
        "gap_max_at": gap_at,
        "slip_max": slip_max,
        "slip_p99": p99(slip),
        "slip_mean": face_average(slip, area),
        "slip_max_at": slip_at,
        "slip_accumulated_max": float(s.accumulated[at].max(initial=0.0)),
        "pressure_max": float(pressure.max(initial=0.0)),
        "pressure_p99": percentile(pressure, weight),
        "pressure_mean": float(np.average(pressure, weights=weight)),
        "shear_max": float(shear.max(initial=0.0)),
        "shear_p99": percentile(shear, weight),
        "shear_mean": float(np.average(shear, weights=weight)),
        "penetration_max": float(np.maximum(-s.gap[at][faces], 0.0).max(initial=0.0)),
        "penetration_sampled": _sampled_penetration(problem, s, i),
        "open_fraction": fraction(OPEN),
        "stick_fraction": fraction(STICK),
        "slip_fraction": fraction(SLIP),
        "area": total,
        "facet_size": problem.jumps[0].edge_lengths[i],
        "area_slip_over_30um": float(area[faces & (slip > MICROMOTION)].sum()),
        "area_gap_over_30um": float(area[faces & (gap > MICROMOTION)].sum()),
        "force": [float(c) for c in (weight[:, None] * s.force[at]).sum(axis=0)],
        "dissipation": float(s.dissipation[at].sum()),
        "dissipation_min": float(s.least[at].min()),
        "contact_work": float(s.contact_work[at].sum()),
        **computed("interfaces", s, at),
    }


def _sampled_penetration(problem: Problem, s: Samples, i: int) -> float:
    """Largest penetration between the nodes: jump and normal interpolated on the facets [mm]."""
    triangles = s.points.triangles[i]
    if not len(triangles):
        return 0.0
    x = s.x[triangles]
    flat = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    normals = s.points.normals[triangles]
    # At each corner the face of the point that this facet belongs to.
    face = np.argmax(np.abs(np.einsum("fi,fcki->fck", flat, normals)), axis=2)
    n = np.take_along_axis(normals, face[:, :, None, None], axis=2)[:, :, 0]
    points = np.asarray(basix.make_quadrature(basix.CellType.triangle, 4)[0])
    N = np.column_stack([1 - points.sum(axis=1), points])
    d = np.einsum("qc,fci->fqi", N, s.jump[triangles])
    n = np.einsum("qc,fci->fqi", N, n)
    size = np.linalg.norm(n, axis=2)
    gap = np.einsum("fqi,fqi->fq", d, n) / np.where(size > 0, size, 1.0)
    return float(np.maximum(-gap, 0.0).max())


def stem_motion(problem: Problem, implant: Sequence[str], bone: Sequence[str]) -> dict[str, float]:
    """Rigid motion of the implant against the bone (best fits over their volumes).

    Subsidence [mm] is distal (-z), retroversion [deg] turns the medial side (x) towards posterior
    (-y), varus [deg] tilts the top of the stem towards medial.

    Args:
        problem: The problem, solved.
        implant: Regions of the implant.
        bone: Regions of bone; without these or those there is no such motion.
    """
    if not implant or not bone:
        return {}
    stem_t, stem_ω, centre = _rigid_fit(problem, implant)
    bone_t, bone_ω, bone_centre = _rigid_fit(problem, bone)
    t = stem_t - bone_t - np.cross(bone_ω, centre - bone_centre)
    ω = np.rad2deg(stem_ω - bone_ω)
    return {
        "subsidence": float(-t[2]),
        "retroversion": float(-ω[2]),
        "varus": float(ω[1]),
    }


def _rigid_fit(problem: Problem, regions: Sequence[str]) -> tuple[Floats, Floats, Floats]:
    """Least-squares rigid motion of regions, weighted by volume: translation, rotation, centre."""
    comm, displacements = problem.comm, problem.displacements()
    xs: list[Floats] = []
    us: list[Floats] = []
    ws: list[Floats] = []
    layout = problem.space.dofmap.dof_layout
    corner = [layout.entity_dofs(0, v)[0] for v in range(4)]
    for r in regions:
        cells = problem.mechanics.region_cells(r)
        volumes, centres = volumes_and_centres(problem, cells)
        v = displacements[problem.bodies.of_region[r]].x.array.reshape(-1, 3)
        us.append(v[problem.space.dofmap.list[cells][:, corner]].mean(axis=1))
        xs.append(centres)
        ws.append(volumes)
    x, u, w = np.concatenate(xs), np.concatenate(us), np.concatenate(ws)

    def total(values: NDArray[np.floating[Any]]) -> Floats:
        return np.asarray(comm.allreduce(np.einsum("p,p...->...", w, values), MPI.SUM))

    volume = total(np.ones(len(w)))
    centre, t = total(x) / volume, total(u) / volume
    ξ, η = x - centre, u - t
    second = total(np.einsum("pi,pj->pij", ξ, ξ))
    inertia = np.trace(second) * np.eye(3) - second
    return t, np.linalg.solve(inertia, total(np.cross(ξ, η))), centre
