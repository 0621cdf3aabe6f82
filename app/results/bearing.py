r"""What surfaces that slide far tell, by cycle: torque, place, wear and heat of friction.

Wear is Archard's, a depth :math:`k \int p\,ds` on either side: k/μ times the energy dissipated per
area. The slave's points know that. It is handed to the nodes of the master in its own axes, where
both touched in the middle of each step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from app.case.case import Case
from app.foundation.arrays import Floats, Ints
from app.mechanics.pairs import SmoothSurface
from app.mechanics.problem import Problem
from app.numerics.rigid_motions import rotation_vector
from app.results.interface_numbers import ContactSamples
from app.results.percentiles import percentile
from app.scene.scene import Stage

MILLION = 1e6  # cycles
MILLIWATT = 1e-3


def bearings(problem: Problem, case: Case) -> dict[str, Bearing]:
    """The interfaces of a case whose sides slide far, by name; collective."""
    far = [(i, c.name) for i, c in enumerate(problem.scene.contacts) if c.between]
    return {name: Bearing(problem, case, i) for i, name in far}


class Bearing:
    """An interface whose sides slide far, through its cycles.

    A cycle ends where cycle tables do, else at each peak of the loads and at the end of a stage.

    Attributes:
        surface: The master's surface, in its own axes; the fields below are its.
        interface: Zeros (m,).
        dof: Global blocked dofs of its nodes (m,).
        bodies: Its body (m, 1).
        triangles: Its facets, as nodes.
        numbers: Numbers of the last step.
    """

    saved = (
        "numbers",
        "time",
        "cycle_start",
        "cycle_rows",
        "last_cycles",
        "uncovered",
        "slave_amounts",
        "master_amounts",
    )

    def __init__(self, problem: Problem, case: Case, i: int) -> None:
        contact, c = problem.contact, problem.scene.contacts[i]
        assert contact is not None and contact.finite_sliding is not None
        self._problem, self._contact = problem, c
        self._body = problem.bodies.of_region[c.master[0]]
        self._motion = problem.scene.motion_of(c.master)
        points = contact.points
        self._rows: Ints = np.flatnonzero(points.interface == i)
        self._weight, triangles = points.weight[self._rows], points.triangles[i]
        self._slave = SmoothSurface(
            points.x[self._rows],
            np.searchsorted(self._rows, triangles),
            -points.normals[triangles[:, 0], 0],
        )
        master = contact.finite_sliding.followers.sides[i][0]
        self.surface, self.dof = master.smooth, master.dofs
        self.interface: Ints = np.zeros(len(self.dof), dtype=np.int64)
        self.bodies = np.full((len(self.dof), 1), self._body)
        self.triangles = (self.surface.triangles,)
        self._period = problem.scene.period
        self._effusivity = _effusivity(case, (c.master, c.slave))
        self.numbers: dict[str, Any] = {}
        self.time = self.cycle_start = 0.0
        self._centre = np.array(self._motion.about if self._motion else np.zeros(3))
        # Part, torque, place and energy of each step of this cycle, and of the last two.
        self.cycle_rows: list[list[float]] = []
        self.last_cycles: list[list[list[float]]] = []
        # Energy [N mm] and slid distance times area [mm3]: at points after the last step, before
        # the cycle, and of the last cycle; at the master's nodes of this cycle, and of the last.
        self.slave_amounts = np.zeros((len(self._rows), 3, 2))
        self.master_amounts = np.zeros((len(self.dof), 2, 2))
        # Which points have faced no master after some step.
        self.uncovered = np.zeros(len(self._rows), dtype=bool)

    @property
    def row_keys(self) -> dict[str, Ints]:
        """Keys of contact points and of the master's nodes, which every rank has."""
        points, nodes = np.arange(len(self._rows)), np.arange(len(self.dof))
        return {"uncovered": points, "slave_amounts": points, "master_amounts": nodes}

    def update(self, s: ContactSamples, stage: Stage, time: float, whole: bool) -> None:
        """Take in a step at its end, which may end an increment of its stage; collective.

        While heat flows the numbers of the last cycle stay.
        """
        if stage.takes_time:
            return
        scene, rows, motion = self._problem.scene, self._rows, self._motion
        if math.ceil(time) > math.ceil(self.time):
            self.cycle_start, self.cycle_rows, self.last_cycles = 0.0, [], []
        before, middle, now = (
            scene.rotation(motion, t) for t in (self.time, (self.time + time) / 2, time)
        )
        arm, turn = s.arm[rows], rotation_vector(now @ before.T)
        torque = np.cross(arm, s.weight[rows, None] * s.friction[rows]).sum(axis=0)
        centre, peak = self._translation(), rows[int(np.argmax(s.pressure[rows]))]
        if motion and np.isfinite(scene.moduli[motion.region]):  # deforms in its own axes
            centre = now @ centre
        spent = np.column_stack([s.dissipation[rows], s.weight[rows] * s.path[rows]])
        dose = (spent - self.slave_amounts[:, 0]) / self._slave.areas[:, None]
        places = self._slave.sampled(dose, 12, arm @ middle + self._centre)
        self.master_amounts[:, 0] += self.surface.deposit(*places)
        feet = arm @ now + self._centre
        on, at, _ = self.surface.closest(feet)
        self.uncovered |= ~self.surface.faces(feet, self._slave.normals @ now, on, at)
        self.slave_amounts[:, 0], self.time = spent, time
        self.numbers = {
            "centre": centre.tolist(),
            "eccentricity": float(np.linalg.norm(centre)),
            "force": (s.weight[rows] @ s.force[rows]).tolist(),
            "pressure_max_at": s.x[peak].tolist(),
        }
        if motion:
            along = turn / (np.linalg.norm(turn) or 1.0)
            self.numbers |= {
                "torque": torque.tolist(),
                "torque_size": float(np.linalg.norm(torque)),
                "torque_along": float(torque @ along),
            }
        way = stage.ways * (time - math.ceil(time) + 1)
        energy = self.master_amounts[:, 0, 0].sum()
        row = (way - self.cycle_start, *torque, *centre, energy)
        self.cycle_rows.append([float(v) for v in row])
        turns = stage.turn(time) if whole else 0
        if turns and (turns % 2 or stage.ways == stage.cycles):
            self.slave_amounts[:, 2] = spent - self.slave_amounts[:, 1]
            self.slave_amounts[:, 1] = spent
            self.master_amounts[:, 1] = self.master_amounts[:, 0]
            self.master_amounts[:, 0] = 0.0
            self.last_cycles = [*self.last_cycles[-1:], self.cycle_rows]
            self.cycle_rows = []
            self.cycle_start = way

    def _translation(self) -> Floats:
        """Displacement of the master: the mean over its surface (3,) [mm]; collective."""
        u = self._problem.displacements()[self._body].x.array.reshape(-1, 3)
        start, end = self._problem.space.dofmap.index_map.local_range
        own = (self.dof >= start) & (self.dof < end)
        moved = np.zeros((len(self.dof), 3))
        moved[own] = u[self.dof[own] - start]
        moved = self._problem.comm.allreduce(moved)
        return np.asarray(self.surface.areas @ moved / self.surface.areas.sum())

    # Of a cycle

    def _per_area(self) -> tuple[Floats, Floats]:
        """Energy [N/mm] and slid distance [mm] of a cycle at points (n, 2) and nodes (m, 2).

        Of the last whole cycle of the stage; of the first so far.
        """
        if self.last_cycles:
            slave, master = self.slave_amounts[:, 2], self.master_amounts[:, 1]
        else:
            slave = self.slave_amounts[:, 0] - self.slave_amounts[:, 1]
            master = self.master_amounts[:, 0]
        return slave / self._weight[:, None], master / self.surface.areas[:, None]

    def fields(self) -> dict[str, tuple[Floats, Floats]]:
        """Slid distance and depth of wear of a cycle at points (n,) and the master's nodes (m,).

        Both in mm.
        """
        (energy, slid), (energy_there, slid_there) = (of.T for of in self._per_area())
        fields, law = {"slid": (slid, slid_there)}, self._contact.law
        k = getattr(law, "wear_coefficient", None)
        if k is not None:
            fields["wear"] = k / law.friction * energy, k / law.friction * energy_there
        return fields

    def cycle(self) -> dict[str, Any]:
        """Numbers of a cycle."""
        flux, fields = self._per_area()[0][:, 0], self.fields()
        numbers = {
            "dissipation_cycle": float(self._weight @ flux),
            "slid_max": float(fields["slid"][0].max()),
            "slid_mean": float(self._weight @ fields["slid"][0] / self._weight.sum()),
            "slid_max_master": float(fields["slid"][1].max()),
        }
        if self.uncovered.any():
            uncovered = self._weight @ self.uncovered
            numbers["uncovered_fraction"] = float(uncovered / self._weight.sum())
        if self._motion:
            track = np.array(self.last_cycles[-1] if self.last_cycles else self.cycle_rows)
            numbers["torque_max"] = float(np.linalg.norm(track[:, 1:4], axis=1).max())
        if "wear" in fields:
            here, there = fields["wear"]
            worn = {
                "wear_volume": float(self._weight @ here),
                "wear_depth_max": float(here.max()),
                "wear_depth_p99": percentile(here, self._weight),
                "wear_depth_max_master": float(there.max()),
                "wear_depth_p99_master": percentile(there, self.surface.areas),
            }
            numbers |= worn | {f"{key}_million": MILLION * v for key, v in worn.items()}
        if self._period:
            numbers["friction_power"] = MILLIWATT * numbers["dissipation_cycle"] / self._period
            if self._effusivity:
                swing = 2 * flux.max() / self._period * math.sqrt(self._period / 2 / math.pi)
                numbers["temperature_swing"] = float(swing / self._effusivity)
        return numbers

    def change(self) -> dict[str, float]:
        """By how much the last two cycles of a stage differ; nothing before there are two.

        Largest difference of the torque over the largest torque, of the place of the centre [mm],
        both at the same part of the cycle; of the dissipation over the last one.
        """
        if len(self.last_cycles) < 2:
            return {}
        before, now = map(np.array, self.last_cycles)
        then = np.column_stack([np.interp(now[:, 0], before[:, 0], v) for v in before.T])
        torque, off, largest = (
            float(np.linalg.norm(v, axis=1).max())
            for v in ((now - then)[:, 1:4], (now - then)[:, 4:7], now[:, 1:4])
        )
        last, first = float(now[-1, 7]) or 1.0, float(before[-1, 7])
        numbers = {"torque": torque / (largest or 1.0)} if self._motion else {}
        return numbers | {"centre": off, "dissipation": abs(last - first) / last}


def _effusivity(case: Case, sides: Sequence[Sequence[str]]) -> float:
    """Sum of both sides' effusivities [N/(mm K s^1/2)]; 0 where one has no thermal properties."""
    every = [[case.regions[region].thermal for region in side] for side in sides]
    known = [[thermal.effusivity for thermal in side if thermal] for side in every]
    return sum(sum(side) / len(side) for side in known) if all(known) else 0.0
