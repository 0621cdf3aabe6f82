"""A stem that is solved several times in one process with other interfaces or loads."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

from app.case.case import Case
from app.foundation.arrays import Floats
from app.mechanics.contact import TrialState
from app.results.interface_numbers import ContactSamples
from app.simulation.model import Model
from app.stepping.load_steps import LoadStep
from app.system.timing import Timing
from tests import support

# A tapered stem pushed down and aside in two steps: the first sticks in part, the second slips.
STEM = (
    """
geometry:
  kind: cylinders
  stem_radius: 7 mm
  cement_thickness: 3 mm
  bone_thickness: 4 mm
  length: 18 mm
  taper: 3 deg
  sector: half
mesh: {order: 1, size: 4 mm, far_size: 4 mm}
"""
    + support.TISSUES
    + """\
supports:
  cut: {kind: roller, boundary: symmetry_y, axis: y}
  foot: {kind: fixed, boundary: bone_bottom}
loads:
  down: {kind: force, boundary: stem_top, force: [0 N, 0 N, -900 N]}
  aside: {kind: force, boundary: stem_top, force: [200 N, 0 N, 0 N], history: [0, 1]}
stages:
  - {name: down}
  - {name: aside, increments: 2}
solver: {tolerance: 1.0e-12}
"""
)


class Runs:
    """Models one after another that share matrices."""

    def __init__(self) -> None:
        self.last: Model | None = None

    def run(self, case: Case) -> tuple[list[Floats], list[int], dict[str, Any]]:
        """Solve a case: displacements of all bodies [mm], Newton iterations, numbers."""
        model = self.last = Model(case, MPI.COMM_WORLD, {}, Timing(), str, self.last)
        last: list[ContactSamples] = []
        iterations = []

        def keep(step: LoadStep, trial: TrialState | None) -> None:
            iterations.append(step.outcome.iterations)
            if trial is not None:
                last[:] = [ContactSamples(model.mechanics.problem, trial)]

        model.run(keep, on_trouble=print)
        moved = model.mechanics.problem.displacements()
        return [u.x.array.copy() for u in moved], iterations, model.numbers(last[0])
