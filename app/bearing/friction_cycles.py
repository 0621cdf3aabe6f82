r"""Friction of finite sliding through its cycles: torque, position, slid distance, wear and power.

Wear follows Archard's law, a depth :math:`k \int p\,ds` on either side. This is k/μ times the
energy dissipated per area, with the friction coefficient μ of the point. It is known at the slave's
points. The nodes of the master receive it in the master's axes, where both sides touch in the
middle of each step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.bearing.laws import wear_coefficient_of
from app.case.case import Case
from app.case.quantities import TABLE
from app.case.summary import Summary
from app.foundation.arrays import Floats, Ints
from app.mechanics.contact import TrialState
from app.mechanics.pairs import SmoothSurface
from app.mechanics.problem import Problem
from app.numerics.rigid_motions import rotation_vector
from app.results.interface_numbers import normal_pressure
from app.results.percentiles import percentile
from app.results.records import Record, SurfaceFields
from app.scene.scene import Stage
from app.stepping.load_steps import LoadStep, OnStep

# Cycles for which wear is reported.
MILLION = 1e6
# Watts per unit of power [N mm/s].
MILLIWATT = 1e-3
# Points per facet from which slid distance, energy and wear are handed to the master.
SAMPLES = 12

# Published numbers of an interface: scalars, and vectors as lists.
Numbers = dict[str, float | list[float]]


@dataclass(frozen=True)
class Samples:
    """Contact points of all ranks after a step (n of them), on every rank.

    Attributes:
        x: Position (n, 3) [mm].
        arm: From the centre of the master's rotation to the point of its surface touched
            (n, 3) [mm].
        pressure: Normal force per area, positive in compression (n,) [MPa].
        friction: Friction on the master per area (n, 3) [MPa].
        force: Force of the first side on the second, as declared, per area (n, 3) [MPa].
        dissipation: Energy dissipated since the beginning (n,) [N mm].
        path: Length of the path of sliding in contact since the beginning (n,) [mm].
    """

    x: Floats
    arm: Floats
    pressure: Floats
    friction: Floats
    force: Floats
    dissipation: Floats
    path: Floats

    @classmethod
    def of(cls, trial: TrialState, swapped: Sequence[bool]) -> Samples:
        """Sample a committed state; collective.

        ``swapped`` is True for interfaces whose master is the second side as declared.
        """
        contact, state, local = trial.contact, trial.contact.state, trial.contact.local
        sliding = contact.finite_sliding
        assert sliding is not None
        arm = np.zeros_like(local.x)
        arm[sliding.rows] = sliding.paired.arm
        sign = np.where(np.array(swapped)[local.interface], 1.0, -1.0)[:, None]
        return cls(
            x=contact.points.x,
            arm=contact.gather(arm),
            pressure=contact.gather(normal_pressure(trial.forces.pressures, local.normals)),
            friction=contact.gather(state.friction),
            force=contact.gather(sign * state.force),
            dissipation=contact.gather(state.dissipation),
            path=contact.gather(state.path),
        )


class Bearings(Record):
    """Interfaces with finite sliding of a run; made collectively.

    Attributes:
        bearings: The interfaces, by name.
        stage: Name of the stage of the last step.
    """

    saved = ("bearings", "stage")

    def __init__(self, problem: Problem, case: Case) -> None:
        self._scene = problem.scene
        self.bearings = {
            c.name: Bearing(problem, case, i)
            for i, c in enumerate(problem.scene.parting_interfaces)
            if c.slides_finitely
        }
        self.stage = ""

    def before(self, on_step: OnStep) -> OnStep:
        """Return a hook that records each step of the mechanics, then calls ``on_step``.

        While heat flows, the numbers of the last cycle stay.
        """
        swapped = [c.swapped for c in self._scene.parting_interfaces]

        def record_step(step: LoadStep, trial: TrialState | None) -> None:
            stage = self._scene.stages[math.ceil(step.time) - 1]
            if trial is not None and not stage.takes_time:
                self.stage = stage.name
                samples = Samples.of(trial, swapped)
                for bearing in self.bearings.values():
                    bearing.update(samples, stage, step.time, step.ends_increment)
            on_step(step, trial)

        return record_step

    def numbers(self) -> Summary:
        """Numbers of the interfaces, and the change from cycle to cycle in a stage."""
        with_numbers = {name: b for name, b in self.bearings.items() if b.numbers}
        changes = {name: bearing.change() for name, bearing in with_numbers.items()}
        nonempty_changes = {name: change for name, change in changes.items() if change}
        numbers: Summary = {
            "interfaces": {name: {**b.numbers, **b.cycle()} for name, b in with_numbers.items()}
        }
        if nonempty_changes:
            numbers["cycles"] = {self.stage: {"change": nonempty_changes}}
        return numbers

    def step_record(self) -> dict[str, float]:
        """Columns of ``history.csv``."""
        row: dict[str, float] = {}
        for name, bearing in self.bearings.items():
            for key, value in bearing.numbers.items():
                q = TABLE["interfaces"][key]
                values = value if isinstance(value, list) else [value]
                titles = (f"{name} {title} [{q.unit}]" for title in q.names)
                row |= dict(zip(titles, values, strict=True))
        return row

    def surface_fields(self) -> dict[str, SurfaceFields]:
        """Slid distance and wear on both sides, by interface."""
        return {name: SurfaceFields(b, b.fields()) for name, b in self.bearings.items()}


class Bearing:
    """An interface with finite sliding, through its cycles.

    A cycle ends where cycle tables do, else at each peak of the loads and at the end of a stage.

    Attributes:
        surface: The master's surface, in its axes. `dof`, `bodies`, `interface` and `triangles`
            are those of its nodes (`results.records.NodalSurface`).
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
        contact, c = problem.contact, problem.scene.parting_interfaces[i]
        assert contact is not None and contact.finite_sliding is not None
        self._problem, self._interface = problem, c
        self._body = problem.bodies.body_of_region[c.master[0]]
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
        friction_at = c.constants.get("μ")
        x = points.x[self._rows]
        self._friction: Floats = np.zeros(len(x)) if friction_at is None else friction_at(x)
        self.numbers: Numbers = {}
        self.time = self.cycle_start = 0.0
        self._centre = np.array(self._motion.about if self._motion else np.zeros(3))
        # Part of the cycle, torque, position and energy of each step: of this cycle, and of the
        # last two.
        self.cycle_rows: list[list[float]] = []
        self.last_cycles: list[list[list[float]]] = []
        # Energy [N mm], slid distance times area [mm3], normal force times slid distance [N mm]: at
        # points after the last step, before the cycle, and of the last cycle; at the master's nodes
        # of this cycle, and of the last.
        self.slave_amounts = np.zeros((len(self._rows), 3, 3))
        self.master_amounts = np.zeros((len(self.dof), 2, 3))
        # True at points that have faced no master after some step.
        self.uncovered = np.zeros(len(self._rows), dtype=bool)

    @property
    def row_keys(self) -> dict[str, Ints]:
        """Keys of contact points and of the master's nodes, which every rank has."""
        points, nodes = np.arange(len(self._rows)), np.arange(len(self.dof))
        return {"uncovered": points, "slave_amounts": points, "master_amounts": nodes}

    def update(self, samples: Samples, stage: Stage, time: float, ends_increment: bool) -> None:
        """Record a step at its end, ``ends_increment`` if an increment ends, too; collective."""
        scene, rows, motion = self._problem.scene, self._rows, self._motion
        if math.ceil(time) > math.ceil(self.time):
            self.cycle_start, self.cycle_rows, self.last_cycles = 0.0, [], []
        rotation_before, mid_rotation, rotation = (
            scene.rotation(motion, t) for t in (self.time, (self.time + time) / 2, time)
        )
        arm, rotated = samples.arm[rows], rotation_vector(rotation @ rotation_before.T)
        torque = np.cross(arm, self._weight[:, None] * samples.friction[rows]).sum(axis=0)
        centre, peak = self._translation(), rows[int(np.argmax(samples.pressure[rows]))]
        if motion and np.isfinite(scene.moduli[motion.region]):  # deforms in the axes of the body
            centre = rotation @ centre
        amounts = self._amounts(samples)
        dose = (amounts - self.slave_amounts[:, 0]) / self._slave.areas[:, None]
        slave_samples = self._slave.sample_density(dose, SAMPLES, arm @ mid_rotation + self._centre)
        self.master_amounts[:, 0] += self.surface.deposit(*slave_samples)
        feet = arm @ rotation + self._centre
        facet, barycentric, _ = self.surface.closest(feet)
        self.uncovered |= ~self.surface.faces(
            feet, self._slave.normals @ rotation, facet, barycentric
        )
        self.slave_amounts[:, 0], self.time = amounts, time
        self.numbers = {
            "centre": [float(v) for v in centre],
            "eccentricity": float(np.linalg.norm(centre)),
            "force": [float(v) for v in self._weight @ samples.force[rows]],
            "pressure_max_at": [float(v) for v in samples.x[peak]],
        }
        if motion:
            axis = rotated / (np.linalg.norm(rotated) or 1.0)
            self.numbers |= {
                "torque": [float(v) for v in torque],
                "torque_size": float(np.linalg.norm(torque)),
                "torque_along": float(torque @ axis),
            }
        phase = stage.load_segments * (time - math.ceil(time) + 1)
        energy = self.master_amounts[:, 0, 0].sum()
        row = (phase - self.cycle_start, *torque, *centre, energy)
        self.cycle_rows.append([float(v) for v in row])
        if ends_increment and stage.is_peak(time):
            self.slave_amounts[:, 2] = amounts - self.slave_amounts[:, 1]
            self.slave_amounts[:, 1] = amounts
            self.master_amounts[:, 1] = self.master_amounts[:, 0]
            self.master_amounts[:, 0] = 0.0
            self.last_cycles = [*self.last_cycles[-1:], self.cycle_rows]
            self.cycle_rows = []
            self.cycle_start = phase

    def _amounts(self, samples: Samples) -> Floats:
        """The columns of `slave_amounts` at points after a step (n, 3)."""
        rows, before = self._rows, self.slave_amounts[:, 0]
        energy, slid = samples.dissipation[rows], self._weight * samples.path[rows]
        # Energy over μ is this amount. Without friction it is summed over the steps.
        force_times_slid = before[:, 2] + samples.pressure[rows] * (slid - before[:, 1])
        has_friction = self._friction > 0
        np.divide(energy, self._friction, out=force_times_slid, where=has_friction)
        return np.column_stack([energy, slid, force_times_slid])

    def _translation(self) -> Floats:
        """Displacement of the master: the mean over its surface (3,) [mm]; collective."""
        u = self._problem.displacements()[self._body].x.array.reshape(-1, 3)
        start, end = self._problem.space.dofmap.index_map.local_range
        owned = (self.dof >= start) & (self.dof < end)
        displacements = np.zeros((len(self.dof), 3))
        displacements[owned] = u[self.dof[owned] - start]
        displacements = self._problem.comm.allreduce(displacements)
        return np.asarray(self.surface.areas @ displacements / self.surface.areas.sum())

    # Of a cycle

    def _per_area(self) -> tuple[Floats, Floats]:
        """Amounts per area of a cycle at points (n, 3) and nodes (m, 3).

        They are the energy [N/mm], the slid distance [mm], and pressure times slid distance [N/mm],
        of the last whole cycle of the stage; of the first so far.
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
        slave, master = self._per_area()
        fields = {"slid": (slave[:, 1], master[:, 1])}
        k = wear_coefficient_of(self._interface.law)
        if k is not None:
            fields["wear"] = k * slave[:, 2], k * master[:, 2]
        return fields

    def cycle(self) -> dict[str, float]:
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
            wear_slave, wear_master = fields["wear"]
            wear = {
                "wear_volume": float(self._weight @ wear_slave),
                "wear_depth_max": float(wear_slave.max()),
                "wear_depth_p99": percentile(wear_slave, self._weight),
                "wear_depth_max_master": float(wear_master.max()),
                "wear_depth_p99_master": percentile(wear_master, self.surface.areas),
            }
            numbers |= wear | {f"{key}_million": MILLION * v for key, v in wear.items()}
        if self._period:
            numbers["friction_power"] = MILLIWATT * numbers["dissipation_cycle"] / self._period
            if self._effusivity:
                swing = 2 * flux.max() / self._period * math.sqrt(self._period / 2 / math.pi)
                numbers["temperature_swing"] = float(swing / self._effusivity)
        return numbers

    def change(self) -> dict[str, float]:
        """Difference of the last two cycles of a stage; empty before the second one.

        Largest difference of the torque over the largest torque, and of the position of the centre
        [mm], both at the same part of the cycle. Difference of the dissipation over the last one.
        """
        if len(self.last_cycles) < 2:
            return {}
        previous_cycle, last_cycle = map(np.array, self.last_cycles)
        previous_at_last = np.column_stack(
            [np.interp(last_cycle[:, 0], previous_cycle[:, 0], v) for v in previous_cycle.T]
        )
        torque, offset, largest = (
            float(np.linalg.norm(v, axis=1).max())
            for v in (
                (last_cycle - previous_at_last)[:, 1:4],
                (last_cycle - previous_at_last)[:, 4:7],
                last_cycle[:, 1:4],
            )
        )
        last_dissipation = float(last_cycle[-1, 7]) or 1.0
        previous_dissipation = float(previous_cycle[-1, 7])
        numbers = {"torque": torque / (largest or 1.0)} if self._motion else {}
        return numbers | {
            "centre": offset,
            "dissipation": abs(last_dissipation - previous_dissipation) / last_dissipation,
        }


def _effusivity(case: Case, sides: Sequence[Sequence[str]]) -> float:
    """Sum of both sides' effusivities [N/(mm K s^1/2)]; 0 where one has no thermal properties."""
    thermals_of_sides = [[case.regions[region].thermal for region in side] for side in sides]
    effusivities = [
        [thermal.effusivity for thermal in side if thermal] for side in thermals_of_sides
    ]
    return sum(sum(side) / len(side) for side in effusivities) if all(effusivities) else 0.0
