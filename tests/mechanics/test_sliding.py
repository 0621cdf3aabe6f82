"""Large slip over rigid surfaces: a head that turns in its cup as it is told."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

from mpi4py import MPI

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import meshes
from app.arrays import Floats
from app.mechanics.contact import TrialState
from app.numerics.rigid_motions import rotation_vector
from app.simulation.model import Model
from app.stepping.load_steps import LoadStep
from app.system.timing import Timing
from app.verification.changed_meshes import ROTATION
from meshes.data import MeshData
from meshes.distribute import TaggedMesh, distribute
from tests import restarted, support
from tests.mechanics.test_oblique import vector

R, MU, FORCE = 14.0, 0.06, (300.0, 100.0, 2000.0)
CUP = f"""
geometry: {{kind: head_cup, head_diameter: {2 * R} mm, radial_clearance: 0.1 mm,
  liner_thickness: 8 mm, inclination: 20 deg, version: 10 deg}}
mesh: {{size: 4.5 mm, far_size: 7 mm, order: 1}}
regions:
  head: {{rigid: true}}
  liner: {{youngs_modulus: 1 GPa, poisson_ratio: 0.4}}
interfaces:
  bearing: {{kind: contact, friction_coefficient: {MU}, sliding: finite}}
supports:
  outer: {{kind: fixed, boundary: liner_outer}}
loads:
  hip: {{kind: force, boundary: head_bore, force: {vector(FORCE, " N")}}}
solver: {{tolerance: 1e-12}}
"""
SMOOTH = "interfaces.bearing.friction_coefficient=0"
# To and fro about y, between 25 degrees either way.
SWING = ("0, 0, 0, 0", "1, 0, 25, 0", "3, 0, -25, 0", "4, 0, 0, 0")


def motion(*rows: str, axes: str = "yxz", **more: str) -> str:
    """An override: the head turns by rows of time and angles about x, y, z [deg]."""
    head = "time [s], rotation x [deg], rotation y [deg], rotation z [deg]"
    course = ", ".join(f"'{row}'" for row in (head, *rows))
    keys = "".join(f", {key}: {value}" for key, value in more.items())
    rotation = f"rotation: {{axes: {axes}, course: [{course}]}}"
    return f"motions.ball={{region: head, about: head_centre, {rotation}{keys}}}"


def stages(increments: int, cycles: int = 1, press: int = 1) -> str:
    first = f"{{name: press, increments: {press}}}, " if press else ""
    return f"stages=[{first}{{name: turn, increments: {increments}, cycles: {cycles}}}]"


@cache
def built() -> MeshData:
    case = support.case(CUP)
    return meshes.build(case.geometry, case.mesh, None)


@cache
def cup() -> TaggedMesh:
    return distribute(built(), MPI.COMM_WORLD)


@dataclass(frozen=True)
class Step:
    """A step of a turn.

    Attributes:
        iterations: Of Newton.
        load: Normal force of the points (n,) [N].
        normal: Out of the head (n, 3).
        force: Of the head on the liner (3,) [N].
        torque: Of friction on the head about its centre, by its radius (3,) [N mm].
        turn: Rotation vector of the step (3,).
        dissipated: So far [N mm].
        place: Way of the head's centre (3,) [mm].
    """

    iterations: int
    load: Floats
    normal: Floats
    force: Floats
    torque: Floats
    turn: Floats
    dissipated: float
    place: Floats


class Runs:
    """Runs that share what they can; their steps."""

    model: Model | None = None

    def steps(self, *overrides: str, tagged: TaggedMesh | None = None) -> list[Step]:
        case, found = support.case(CUP, *overrides), list[Step]()
        model = Model(case, MPI.COMM_WORLD, {}, Timing(), str, self.model, judged=False)
        self.model = model
        problem, before = model.mechanics.problem, [np.eye(3)]
        cells = problem.tagged.cell_tags.find(problem.tagged.regions["head"])
        node = problem.space.dofmap.list[cells[0], 0]

        def keep(step: LoadStep, trial: TrialState | None) -> None:
            assert trial is not None
            own, state, scene = trial.contact.own, trial.contact.state, problem.scene
            turned = scene.rotation(scene.motions[0], step.time)
            normal = own.normals[:, 0].copy()
            moved = problem.displacements()[problem.bodies.of_region["head"]].x.array
            friction = own.weight[:, None] * state.friction
            found.append(
                Step(
                    step.outcome.iterations,
                    own.weight * trial.law.pressures[:, 0],
                    normal,
                    own.weight @ -state.force,
                    np.cross(R * normal, -friction).sum(axis=0),
                    rotation_vector(turned @ before.pop().T),
                    state.dissipation.sum(),
                    moved.reshape(-1, 3)[node].copy(),
                )
            )
            before.append(turned)

        model.go(keep, on_trouble=print)
        return found


def solve(*overrides: str) -> list[Step]:
    return Runs().steps(*overrides)

if __name__ == "__main__":
    import sys, time
    np.set_printoptions(precision=12)
    for sets in ([SMOOTH, motion("0,0,0,0", "1,0,25,0"), stages(1,press=3)],
        [motion("0,0,0,0", "1,0,25,0"), stages(5)],
        [motion("0,0,0,0", "1,0,25,0"), stages(5,press=0)],
        [motion("0,0,0,0", "1,0,25,0", translation="held"), stages(5), "interfaces.bearing.gap=-0.15 mm", "interfaces.bearing.gap_history=[1, 1]"],
        [motion(*SWING, largest_step="25 deg"), stages(4,3)],
        [motion(*SWING, largest_step="25 deg"), stages(8)],
        [motion(*SWING, largest_step="25 deg"), stages(20)],
        ):
        t=time.time()
        print(sets)
        for s in solve(*sets):
            print(s.iterations, s.load.max(), s.force, s.torque, s.dissipated, s.place)
        print(time.time()-t)
