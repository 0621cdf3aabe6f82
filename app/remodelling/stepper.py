"""Remodelling of bone in time by Heun's rule.

Arrays are by vertex of this rank, ghosts too, and region (n, r). At the end of a step the density
is limited to its bounds. The mass that this changes is recorded as ``cut``: the mass of bone is its
initial value plus the masses ``added`` and ``cut``.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from mpi4py import MPI

import numpy as np

from app.foundation.arrays import Floats, Ints
from app.foundation.errors import ConvergenceError, InputError, MantleError
from app.laws.values import field
from app.numerics.saved_state import node_keys
from app.remodelling.bone import BoneMass
from app.remodelling.intact_femur import load_cases, stimulus_before
from app.remodelling.laws import Remodelling, remodelling_of
from app.remodelling.stages import STAGES
from app.remodelling.stimulus import TINY, Stimulus
from app.scene.bodies import FACET_NODES, boundary_facets
from app.scene.scene import Stage
from app.simulation.model import Model
from app.soundness.failure import explanation_of_failure
from app.stepping.advance import Growth, Progress, Step, advance
from app.stepping.load_steps import LoadStepper

# Largest change of the density in a step [g/cm3].
LARGEST_CHANGE = 0.3
GROWTH = Growth(safety=0.9, smallest=0.2, largest=2.0, after_failure=0.5)
# Length of a repeated step over the length of the refused one, at most.
SHORTER = 0.9
# Fraction of a stage below which a step is too short.
SHORTEST = 1e-8


def remodeller(model: Model, load_stepper: LoadStepper) -> Remodeller:
    """The stepper of a model whose case remodels; collective."""
    law, bone = remodelling_of(model.case), model.records["bone"]
    assert law is not None and isinstance(bone, BoneMass)

    def reference() -> Floats | None:
        return stimulus_before(law, model, bone.forms) if law.intact else None

    return Remodeller(law, bone, load_stepper, reference)


class Remodeller:
    """Steps through stages in which bone remodels, next to the stepper of loads; made collectively.

    Args:
        reference: Stimulus of the intact femur (n, r), made when it is first needed; None where the
            case gives it.
    """

    saved = ("progress", "density_rate")

    def __init__(
        self,
        law: Remodelling,
        bone: BoneMass,
        stepper: LoadStepper,
        reference: Callable[[], Floats | None],
    ) -> None:
        self._law, self._bone = law, bone
        self._stepper, self._intact = stepper, reference
        self._problem, self._forms = bone.problem, bone.forms
        self._stimulus = Stimulus(law, bone, stepper)
        self.progress = Progress()
        # Change of the density in time at the last step's end [g/(cm3 s)], if it is known.
        self.density_rate: Floats | None = None

    @property
    def row_keys(self) -> dict[str, Ints]:
        """Keys of vertices."""
        return {"density_rate": node_keys(self._forms.scalars)}

    def _largest(self, values: Floats) -> float:
        local = float(np.abs(values).max(initial=0.0))
        return float(self._problem.comm.allreduce(local, MPI.MAX))

    def _begin(self, k: int) -> None:
        """Find load cases, reference, and the bone that is free to remodel; collective."""
        problem, forms, law = self._problem, self._forms, self._law
        self._cases = [(k, i + 1.0) for i in load_cases(law, problem.scene.stages)]
        K = self._intact()
        if K is None:
            given_stimulus = field("remodelling.stimulus", law.stimulus or 0.0)(
                forms.scalars.tabulate_dof_coordinates()
            )
            K = np.broadcast_to(given_stimulus[:, None], self._bone.volume.shape)
        self._reference = K
        smallest = float(K[self._bone.volume > 0].min(initial=np.inf))
        least = problem.comm.allreduce(smallest, MPI.MIN)
        if least <= 0:
            message = f"the smallest value is {least:g} J/g; expected positive values"
            raise InputError(f"remodelling.stimulus: {message}")
        clamps = [s.boundary for s in problem.scene.supports if s.clamps]
        clamps += [boundary for load in problem.scene.loads for boundary in load.boundaries]
        self._free = self._bone.volume > 0
        for name in clamps if law.frozen is None else law.frozen:
            facets = boundary_facets(problem.tagged, name)
            nodes = forms.scalars.dofmap.list[facets.cells[:, None], FACET_NODES[facets.local, :3]]
            self._free &= forms.vertex_sums(nodes, 1.0)[:, None] == 0

    # Steps

    def run_stage(self, k: int, stage: Stage, checkpoint_point: Callable[[], None]) -> None:
        """Remodel bone through a stage.

        Raises:
            ConvergenceError: A load case cannot be solved even after a short time.
        """
        stepper, forms = self._stepper, self._forms
        self._begin(k)
        if not self.progress.step:
            self.progress = Progress(1.0 / stage.increments)
        self._k, self._stage = k, stage
        self._committed = forms.density.copy(), stepper.solver.x.copy()
        try:
            if self.density_rate is None:
                self.density_rate = self._change()
            if self.density_rate is None:
                raise self._failure()
            self._limit(self.density_rate)
            advance(self, self, checkpoint_point)
        except MantleError:
            forms.density[:] = self._committed[0]
            self._committed[1].copy(stepper.solver.x)
            self._stimulus.follow_density()
            self._problem.update_displacements(*stepper.solver.u_and_q())
            raise
        self.progress, self.density_rate = Progress(), None

    def _change(self) -> Floats | None:
        """Change of the density in time [g/(cm3 s)]; None if a load case cannot be solved."""
        S = self._stimulus.of(self._cases)
        return None if S is None else self._free * self._law.speed(S, self._reference)

    @property
    def _duration(self) -> float:
        """Duration of the stage [s]."""
        return STAGES.seconds(self._stage)

    def _limit(self, speed: Floats) -> None:
        """Limit the next step to a change of the density by `LARGEST_CHANGE`; collective."""
        density, (lowest, highest) = self._forms.density, self._law.density
        may_change_much = np.where(speed > 0, highest - density, density - lowest) > LARGEST_CHANGE
        fastest = max(self._largest(speed[may_change_much]) * self._duration, TINY)
        self.progress.step = min(self.progress.step, LARGEST_CHANGE / fastest)

    def _failure(self) -> ConvergenceError:
        progress = self.progress
        cause = explanation_of_failure(self._problem, self._stepper.solver, self._stimulus.outcome)
        return cause.error(self._stage.name, progress.done, [progress.step])

    # Control of the steps

    @property
    def finished(self) -> bool:
        """Return True if the stage is done."""
        return self.progress.done >= 1.0

    def propose(self) -> Step:
        """Return the next step."""
        return self.progress.next(1.0 / self._stage.increments)

    def judge(self, step: Step, error: float) -> bool:
        """Accept a step within its tolerance, and choose the next one."""
        progress, factor = self.progress, GROWTH.factor(error)
        if error > 1.0:
            progress.step = min(factor, SHORTER) * step.length
            return False
        # A step shortened by the end of an increment says little about a longer one.
        progress.step = max(factor * step.length, progress.step if step.ends_increment else 0.0)
        progress.done = step.end
        return True

    # One step

    def try_step(self, step: Step) -> float:
        """Change the density by Heun's rule; return the error over the tolerance; collective."""
        self._old = self._forms.density.copy()
        speed = self.density_rate
        assert speed is not None
        seconds = self._duration * step.length
        euler = self._moved(seconds * speed)
        end_rate = self._change()
        if end_rate is None:
            return math.inf
        self._added = seconds * (speed + end_rate) / 2
        self._heun = self._moved(self._added)
        error = self._largest(self._heun - euler) / self._law.tolerance
        if error <= 1.0:
            self._next = self._change()
            if self._next is None:
                return math.inf
        return error

    def _moved(self, change: Floats) -> Floats:
        """Set the density to that at the start of the step plus a change, within its bounds."""
        lowest, highest = self._law.density
        density = np.where(self._free, np.clip(self._old + change, lowest, highest), self._old)
        self._forms.density[:] = density
        return self._forms.density.copy()

    def refuse(self, step: Step) -> None:
        """Go back to the density at the beginning of a step.

        Raises:
            ConvergenceError: The next step would be too short.
        """
        self._stepper.total.rejected += 1
        self._forms.density[:] = self._old
        if self.progress.step <= SHORTEST:
            raise self._failure()

    def commit(self, step: Step, started: float) -> None:
        """Commit the step last tried; collective."""
        stepper, m = self._stepper, self._forms
        bone = self._bone
        bone.mass["added"] += bone.grams(self._added)
        bone.mass["cut"] += bone.grams(self._heun - self._old - self._added)
        bone.seconds += self._duration * step.length
        bone.steps += 1
        assert self._next is not None
        self.density_rate = self._next
        time = self._k + step.end
        self._problem.set_time(time)
        stepper.commit(self._stage, time, self._stimulus.outcome, started, step.ends_increment)
        self._committed = m.density.copy(), stepper.solver.x.copy()
        self._limit(self.density_rate)
