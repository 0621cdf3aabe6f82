"""A head that rotates in its cup by prescribed angles, with finite sliding."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

from mpi4py import MPI

import numpy as np

import meshes
from app.foundation.arrays import Floats
from app.mechanics.contact import TrialState
from app.numerics.rigid_motions import rotation_vector
from app.stepping.load_steps import LoadStep
from meshes.data import MeshData
from meshes.distribute import TaggedMesh, distribute
from tests import support

R = 14.0  # radius of the head [mm]
MU = 0.06  # friction coefficient
FORCE = np.array([300.0, 100.0, 2000.0])  # on the head [N]

CUP = support.HEAD_CUP.replace("inclination: 0 deg, version: 0", "inclination: 20 deg, version: 10")
CUP = CUP.replace("size: 5 mm, far_size: 8", "size: 4.5 mm, far_size: 7")
CUP += f"""
loads:
  hip: {{kind: force, boundary: head_bore, force: {support.vector(FORCE, " N")}}}
solver: {{tolerance: 1e-12}}
output: {{fields: false, report: false}}
"""
FRICTION = "interfaces.bearing.friction_coefficient"


def cycle_table(column: str, rows: Sequence[Sequence[float]]) -> list[str]:
    """The lines of a cycle table: three components at equal times."""
    lines = [[f"{v:.17g}" for v in (k, *row)] for k, row in enumerate(rows)]
    return [", ".join(line) for line in [["time [s]", *map(column.format, "xyz")], *lines]]


def turning(*angles: tuple[float, float, float], axes: str = "yxz", **more: str) -> str:
    """Override by which the head turns through angles about x, y, z [deg] at equal times."""
    keys = "".join(f", {key}: {value}" for key, value in more.items())
    rotation = (
        f"rotation: {{axes: {axes}, cycle_table: {cycle_table('rotation {} [deg]', angles)}}}"
    )
    return f"motions.ball={{region: head, about: head_centre, {rotation}{keys}}}"


def stages(increments: int, cycles: int = 1, press: int = 1) -> str:
    """Override for two stages: the head is pressed in, then turned."""
    first = f"{{name: press, increments: {press}}}, " if press else ""
    return f"stages=[{first}{{name: turn, increments: {increments}, cycles: {cycles}}}]"


QUARTER = turning((0, 0, 0), (0, 25, 0))
# To and fro, with stops at both ends.
SWING = turning((0, 0, 0), (0, 25, 0), (0, 0, 0), (0, -25, 0), (0, 0, 0), largest_step="25 deg")


class Step(NamedTuple):
    """A step of a rotation, with n points."""

    iterations: int
    load: Floats  # normal forces of the points (n,) [N]
    normal: Floats  # out of the head (n, 3)
    force: Floats  # of the head on the liner (3,) [N]
    torque: Floats  # of friction on the head about its centre, on arms R n (3,) [N mm]
    turn: Floats  # rotation vector of the step (3,)
    dissipated: float  # so far [N mm]
    place: Floats  # way of the head's centre (3,) [mm]

    @property
    def spends(self) -> float:
        """Work of the torque in the step [N mm]."""
        return float(-self.torque @ self.turn)


@cache
def built() -> MeshData:
    case = support.case(CUP)
    return meshes.build(case.geometry, case.mesh, None)


@cache
def cup() -> TaggedMesh:
    return distribute(built(), MPI.COMM_WORLD)


def solve(*overrides: str, tagged: TaggedMesh | None = None) -> list[Step]:
    """The steps of a case, on the mesh of the cup or on the mesh of the case."""
    analysis = support.analysis(support.case(CUP, *overrides), tagged or cup())
    problem = analysis.problem
    assert problem is not None
    cells = problem.tagged.cell_tags.find(problem.tagged.regions["head"])
    node = problem.space.dofmap.list[cells[0], 0]
    steps, before = list[Step](), [np.eye(3)]

    def keep(step: LoadStep, trial: TrialState | None) -> None:
        assert trial is not None
        local, state, scene = trial.contact.local, trial.contact.state, problem.scene
        normal, turned = local.normals[:, 0].copy(), scene.rotation(scene.motions[0], step.time)
        moved = problem.displacements()[problem.bodies.body_of_region["head"]].x.array
        friction = local.weight[:, None] * state.friction
        steps.append(
            Step(
                step.outcome.iterations,
                local.weight * trial.forces.pressures[:, 0],
                normal,
                local.weight @ -state.force,
                np.cross(R * normal, friction).sum(axis=0),
                rotation_vector(turned @ before.pop().T),
                float(state.dissipation.sum()),
                moved.reshape(-1, 3)[node].copy(),
            )
        )
        before.append(turned)

    analysis.run(keep, on_trouble=print)
    return steps


# A deformable head, and the quarter turn that is given at its bore.
COCR = "regions.head={youngs_modulus: 210 GPa, poisson_ratio: 0.3}"
DRIVEN = turning((0, 0, 0), (0, 25, 0), boundary="head_bore")
