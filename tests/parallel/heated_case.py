"""A run of the mechanics of heat and cure, its numbers as JSON: started by `test_heated_ranks`.

A stem in cement that sets and swells in a bone that warms, the stem held by hand at first.
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

from petsc4py import PETSc

from app.laws.cure import Prescribed
from app.results.bond_strength import bonds
from app.scene.scene import Scene
from tests import laws
from tests.heated import Heated

CASE = """
geometry: {kind: cylinders, stem_radius: 6 mm, cement_thickness: 4 mm, bone_thickness: 5 mm,
  length: 6 mm}
mesh: {size: 3 mm, far_size: 3 mm, order: 2}
regions:
  stem: {youngs_modulus: 200 GPa, poisson_ratio: 0.3}
  cement: {youngs_modulus: 2200 MPa, poisson_ratio: 0.3}
  bone: {youngs_modulus: 17 GPa, poisson_ratio: 0.3}
interfaces:
  stem_cement: {kind: contact, friction_coefficient: 0.3}
supports:
  outer: {kind: fixed, boundary: bone_surface}
  hand: {kind: fixed, boundary: stem_top}
loads:
  push: {kind: force, boundary: stem_bottom, force: [30 N, 0 N, -50 N], history: [0, 1]}
stages:
  - {name: set}
  - {name: push}
"""


def change(scene: Scene) -> Scene:
    hand = [s.named("hand", stages=("set",)) if s.name == "hand" else s for s in scene.supports]
    return replace(
        scene,
        supports=tuple(hand),
        expansions=(laws.expansion("cement", 8e-5, 300.0), laws.expansion("bone", 1e-5, 310.0)),
        cures=(laws.cure("cement", Prescribed.model_construct(rate=()), 0.8),),
    )


def main(output: Path) -> None:
    model = Heated.make(CASE, change)
    problem = model.problem
    for k in (1, 2, 3, 4):
        problem.set_stage(k // 4, model.solver.u_and_q()[0])
        problem.set_time(k / 3 if k < 4 else 2.0)
        problem.set_temperature({"bone": model.scalar(lambda x: 310 + x[2])})
        s = min(k, 3) / 3
        model.set(
            lambda x, s=s: 0.8 + s * (0.2 - 2e-3 * x[0]),
            lambda x, s=s: 1e-3 * s * (1 + 0.02 * x[1]),
            "cement",
        )
        samples = model.step()
    assert samples is not None and problem.stiffness.version == 5
    scalars = problem.mechanics.scalars
    n = scalars.dofmap.index_map.size_local
    identity = PETSc.Mat().createAIJ(((n, None), (n, None)), nnz=1, comm=problem.comm)
    identity.assemble()
    identity.shift(1.0)
    G = problem.thermal_stiffness({"bone": identity})
    found = {
        "interface": samples.numbers["stem_cement"],
        "cement": model.stresses.region("cement"),
        "bond": bonds(problem, model.stresses),
        "balance": [model.balance.force, model.balance.moment, model.balance.energy],
        "thermal": [A.norm() for A in G[0]],
    }
    if problem.comm.rank == 0:
        output.write_text(json.dumps(found))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
