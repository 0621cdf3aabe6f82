r"""Risk that a region fails: at its largest flaw (Weibull), and by cycles of load (Miner).

.. math:: P = 1 - e^{-R}, \quad
    R = \int \Big\langle \frac{σ_1 - σ_u}{σ_0} \Big\rangle^m \frac{dV}{V_0}, \qquad
    D = \sum_i \frac{n_i}{N(s_i)}

of the stress of the displacement, with that of setting. High powers of stress need many points:
means of cells are 13 % off at a shape of 10, with eight cells over a bent bar. Those here are exact
to degree 9.

Rim and tip of a hip are reported separately, as on interfaces. So are re-entrant edges, where
stress grows with a negative power -p of the distance and has no bound. R has no bound there if m p
is 2 or more: it grows with every refinement.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from itertools import combinations

import numpy as np

from app.case.case import Case
from app.case.summary import Numbers
from app.fatigue.laws import fatigue_of, weibull_of
from app.foundation.arrays import Bools, Floats, Ints
from app.mechanics.contact import TrialState
from app.mechanics.problem import Problem
from app.results.percentiles import percentile
from app.results.records import Borders, Record
from app.results.stresses import Stresses
from app.stepping.load_steps import LoadStep, OnStep
from meshes.distribute import TaggedMesh

# Distance from re-entrant edges within which numbers are reported apart [mm].
NEAR = 1.0
# Angle by which such an edge turns in: more than straight facets of a round stem do.
TURN = math.radians(60)
CORNERS = np.vstack([np.zeros(3), np.eye(3)])
# Vertices of a cell at the ends of each edge, and the two others.
EDGES = np.array([(*e, *({0, 1, 2, 3} - {*e})) for e in combinations(range(4), 2)])


class CementRisk(Record):
    """Weibull's risk of regions, and the damage of one; made collectively.

    Args:
        borders: Functions of points that are not positive in a part of a hip (`Zones.borders`).
    """

    saved = ("valley", "damage")

    def __init__(self, case: Case, problem: Problem, borders: Borders | None) -> None:
        fatigue = fatigue_of(case)
        self._fatigue = fatigue
        self._stages = case.stages
        self._borders = borders
        self._fatigue_region = fatigue.region if fatigue else ""
        self._tagged = problem.tagged
        self._comm = problem.comm
        self._weibull = weibull_of(case)
        self._stresses = Stresses(problem, fine={*self._weibull, self._fatigue_region} - {""})
        self._parts: dict[str, dict[str, Bools]] = {}
        laws = fatigue.laws if fatigue else ()
        original_cells = problem.tagged.mesh.topology.original_cell_index
        cell_numbers = (
            original_cells[self._stresses.cells[self._fatigue_region]]
            if laws
            else np.zeros(0, dtype=np.int64)
        )
        points_per_cell = len(self._stresses.volume_fractions[self._fatigue_region]) if laws else 1
        self.row_keys: Ints = (
            cell_numbers[:, None] * points_per_cell + np.arange(points_per_cell)
        ).ravel()
        # Stress at the points in the last valley, or at the end of the stage before [MPa].
        self.valley = np.zeros((len(self.row_keys), 3, 3))
        # By law: damage a year and largest equivalent stress [MPa] at the points (n, 2).
        self.damage = {name: np.zeros((len(self.row_keys), 2)) for name in laws}

    def numbers(self) -> dict[str, dict[str, Numbers]]:
        """Strength in section ``regions``, and section ``fatigue``; collective."""
        numbers = {"regions": self.weibull()}
        if self.damage:
            numbers["fatigue"] = self.fatigue()
        return numbers

    # Fatigue

    def before(self, on_step: OnStep) -> OnStep:
        """Return a hook that records the fatigue of a step, then calls ``on_step``."""

        def record(step: LoadStep, trial: TrialState | None) -> None:
            stage = self._stages[math.ceil(step.time) - 1]
            is_last = stage.reversal(step.time) == stage.load_segments
            if self._fatigue and (is_last or stage.is_valley(step.time)):
                stress = self._stresses.evaluate(self._fatigue_region).reshape(-1, 3, 3)
                cycles = self._fatigue.spectrum.get(stage.name)
                if is_last and cycles:
                    self._add(cycles, *tensions(stress, self.valley))
                self.valley = stress
            on_step(step, trial)

        return record

    def _add(self, cycles: float, peak_tensions: Floats, valley_tensions: Floats) -> None:
        """Add the damage of cycles between two tensions at the points (n,)."""
        assert self._fatigue
        for name, law in self._fatigue.laws.items():
            equivalent_stress = self._fatigue.equivalent(law, peak_tensions, valley_tensions)
            self.damage[name][:, 0] += cycles * law.damage(equivalent_stress)
            self.damage[name][:, 1] = np.maximum(self.damage[name][:, 1], equivalent_stress)

    def fatigue(self) -> dict[str, Numbers]:
        """Published numbers by law, of activities so far; collective."""
        return {
            name: self._by_part(self._fatigue_region, partial(self._damage_numbers, damage))
            for name, damage in self.damage.items()
        }

    def _damage_numbers(self, damage_and_stress: Floats, is_in_part: Bools) -> Numbers:
        """Damage by a law in a part of the points, from rows of damage and stress (n, 2)."""
        x, volume = self._stresses.points_and_volumes(self._fatigue_region)
        rows = np.column_stack([damage_and_stress, volume.ravel(), x])[is_in_part].T
        damage, stress, weight, *coordinates = self._stresses.gather(rows)
        return {
            "damage_p99": percentile(damage, weight),
            "damage_max": float(damage.max()),
            "damage_max_at": [float(c[damage.argmax()]) for c in coordinates],
            "stress_p99": percentile(stress, weight),
        }

    def cell_fields(self, cells: int) -> dict[str, Floats]:
        """Mean damage a year of the cells of this rank by law (cells,), zero elsewhere."""
        fields: dict[str, Floats] = {}
        for name, damage_and_stress in self.damage.items():
            damage = damage_and_stress[:, 0]
            mean, point_weights = (
                np.zeros(cells),
                self._stresses.volume_fractions[self._fatigue_region],
            )
            mean[self._stresses.cells[self._fatigue_region]] = (
                damage.reshape(-1, len(point_weights)) @ point_weights
            )
            fields[f"damage_{name}"] = mean
        return fields

    # Strength

    def weibull(self) -> dict[str, Numbers]:
        """Published numbers by region; collective."""
        by_region = {}
        for region, law in self._weibull.items():
            principal: Floats = np.linalg.eigvalsh(self._stresses.evaluate(region)).astype(
                np.float64
            )
            tension = principal[..., 2]
            risk = law.risk(tension) * self._stresses.points_and_volumes(region)[1]
            by_region[region] = self._by_part(region, partial(self._strength, region, risk))
        return by_region

    def _strength(self, region: str, risk: Floats, is_in_part: Bools) -> Numbers:
        """Numbers of a part by the risk at points (cells, points), and the place of most of it."""
        risk_in_part = np.where(is_in_part.reshape(risk.shape), risk, 0.0)
        x = self._stresses.points_and_volumes(region)[0].reshape(*risk.shape, 3)
        rows = np.column_stack(
            [risk_in_part.sum(axis=1), np.einsum("cq,cqi->ci", risk_in_part, x)]
        ).T
        cell_risks, *moments = self._stresses.gather(rows)
        k, total = cell_risks.argmax(), float(cell_risks.sum())
        place = {"failure_at": [float(m[k] / cell_risks[k]) for m in moments]} if total else {}
        return {"failure_risk": total, "failure_probability": -math.expm1(-total)} | place

    def _by_part(self, region: str, numbers_of: Callable[[Bools], Numbers]) -> Numbers:
        """Numbers of the points of a region, with sections of its parts; collective."""
        if region not in self._parts:
            x = self._stresses.points_and_volumes(region)[0]
            levels = self._borders(x) if self._borders else {}
            edges = reentrant_edges(self._tagged, region)
            if len(edges):
                levels["edge"] = distance_from_edges(x, edges) - NEAR
            parts = masks_by_level(np.ones(len(x), dtype=bool), levels)
            self._parts[region] = {p: a for p, a in parts.items() if self._comm.allreduce(a.sum())}
        numbers = {part: numbers_of(is_in_part) for part, is_in_part in self._parts[region].items()}
        return numbers.pop("", {}) | numbers


def tensions(peak: Floats, valley: Floats) -> tuple[Floats, Floats]:
    """Largest and least tension (n,) of a cycle on the plane of the largest one [MPa].

    Between two states of stress (n, 3, 3); compression counts as none.
    """
    σ = np.stack([peak, valley])
    values, axes = np.linalg.eigh(σ)
    worse = values[..., 2].argmax(axis=0)
    n = axes[worse, np.arange(len(peak)), :, 2]
    plane_tensions = np.maximum(np.einsum("ni,snij,nj->sn", n, σ, n), 0.0)
    return plane_tensions.max(axis=0), plane_tensions.min(axis=0)


def reentrant_edges(tagged: TaggedMesh, region: str) -> Floats:
    """Edges at which a region turns in by more than `TURN` (e, 2, 3) [mm], on all ranks.

    The angles of the cells around an edge add up to 180 degrees where the surface is smooth, and to
    360 degrees inside.
    """
    mesh = tagged.mesh
    cells = tagged.cell_tags.find(tagged.regions[region])
    owned = cells[cells < mesh.topology.index_map(3).size_local]
    nodes = mesh.geometry.dofmap[owned]
    element = mesh.ufl_domain().ufl_coordinate_element().sub_elements[0]
    _, *dN = element.tabulate(1, CORNERS[EDGES[:, :2]].mean(axis=1))
    J = np.einsum("cni,jen->ceij", mesh.geometry.x[nodes], np.array(dN))
    along, *across = np.einsum("ceij,ekj->keci", J, CORNERS[EDGES[:, 1:]] - CORNERS[EDGES[:, :1]])
    n = np.cross(along, np.array(across))
    n /= np.linalg.norm(n, axis=3, keepdims=True)
    angle = np.arccos(np.clip(np.einsum("eci,eci->ce", n[0], n[1]), -1.0, 1.0)).ravel()
    ends = nodes[:, EDGES[:, :2]].reshape(-1, 2)
    local = angle, mesh.geometry.input_global_indices[ends], mesh.geometry.x[ends]
    angle, pairs, x = (np.concatenate(p) for p in zip(*mesh.comm.allgather(local), strict=True))
    pairs.sort(axis=1)
    _, first_rows, edge = np.unique(pairs, axis=0, return_index=True, return_inverse=True)
    turning_angle = np.bincount(edge.ravel(), angle) - math.pi
    return np.asarray(x[first_rows[(turning_angle > TURN) & (turning_angle < math.pi - 1e-3)]])


def distance_from_edges(x: Floats, edges: Floats) -> Floats:
    """Distance of points (n, 3) from the nearest of some edges (e, 2, 3) (n,) [mm]."""
    smallest_distance = np.full(len(x), np.inf)
    for a, b in edges:
        t = np.clip((x - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        to_edge = np.linalg.norm(x - a - t[:, None] * (b - a), axis=1)
        smallest_distance = np.minimum(smallest_distance, to_edge)
    return smallest_distance


def masks_by_level(whole: Bools, levels: Mapping[str, Floats]) -> dict[str, Bools]:
    """Divide a mask (n,) by levels (n,); the rest has the name "".

    A part is where its level is not positive and the level of no earlier part is.
    """
    parts = {}
    rest = whole
    for part, level in levels.items():
        parts[part] = rest & (level <= 0)
        rest = rest & (level > 0)
    return {"": rest} | parts
