r"""Coarse start: a solve starts from the jumps of a coarse model.

The coarse model is a copy of the case on a mesh twice as coarse. If no coarser mesh exists, the
copy has first order. It is solved load step by load step next to the run. `app.simulation.model`
makes it, and gives a large coarse model a coarse start of its own. The jumps of the coarse model
are interpolated on the interface. The displacement follows from the jumps, K u = f - C q, to a
rough tolerance.

A stance of 94,000 unknowns takes 6 Newton iterations instead of 11. With the coarse model included
it takes a fifth less time. A linear step in displacement, jumps and forces before the solve was
measured too, and saves nothing.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from app.foundation.arrays import Floats, Ints
from app.foundation.errors import MantleError, StoppedError
from app.interfaces.corners import ContactPoints
from app.mechanics.predictors import imbalance
from app.mechanics.problem import Problem
from app.numerics.newton import Solver
from app.numerics.numerical_errors import as_convergence_errors
from app.stepping.load_steps import LoadStepper

if TYPE_CHECKING:
    from scipy.sparse import csr_array

log = logging.getLogger("mantle")

# Relative residual of the displacement from interpolated jumps.
ROUGH_TOLERANCE = 0.1
# A start is good enough if its residual is below this fraction of the unloaded state's.
GOOD_START = 0.1


class CoarseStart:
    """Starts from the jumps of a coarse model; a `Predictor`.

    Args:
        problem: The problem.
        solver: Its solver.
        make_coarse: Makes the coarse model at rest. It is called when a start is first needed.
    """

    def __init__(
        self, problem: Problem, solver: Solver, make_coarse: Callable[[], LoadStepper]
    ) -> None:
        assert problem.contact is not None
        self._contact = problem.contact
        self._problem, self._solver, self._make_coarse = problem, solver, make_coarse
        self._coarse: LoadStepper | None = None
        self._failed = False
        self._passed_times: list[float] = []
        self._computed_jumps: list[tuple[float, Floats]] = []

    def predict(self, time: float) -> None:
        """Start from the state of the coarse model, unless the current start is good."""
        solver = self._solver
        if self._failed:
            return
        residual_of_start = imbalance(solver, solver.x.copy())
        if residual_of_start <= GOOD_START * imbalance(solver, solver.vector()):
            return
        try:
            with as_convergence_errors():
                jump = self._interpolated_jump(time)
        except StoppedError:
            raise
        except MantleError as error:
            self._failed = True
            log.info(
                "     coarse start failed; continuing without it: %s", str(error).splitlines()[0]
            )
            return
        self._start_from(jump)

    def commit(self, time: float) -> None:
        """Note a time up to which the coarse model solves before the next start."""
        self._passed_times.append(time)

    def _interpolated_jump(self, time: float) -> Floats:
        """Jumps of owned points at a time, interpolated (n, 3) [mm]."""
        coarse = self._coarse or self._made_coarse()
        for target in [*self._passed_times, time]:
            while target > self._computed_jumps[-1][0]:
                # The coarse model of a resumed run has not solved earlier stages.
                end_of_stage = math.floor(self._computed_jumps[-1][0]) + 1.0
                self._advance(coarse, min(target, end_of_stage))
        self._passed_times = []
        return jumps_between(self._computed_jumps, time)

    def _made_coarse(self) -> LoadStepper:
        """Make the coarse model at rest, and the matrix that interpolates its jumps."""
        contact, self._coarse = self._contact, self._make_coarse()
        source = self._coarse.problem.contact
        assert source is not None
        self._interpolation = interpolation_matrix(
            source.points, contact.points, contact.local.rows
        )
        self._computed_jumps = [(0.0, np.zeros((len(contact.local), 3)))]
        return self._coarse

    def _advance(self, coarse: LoadStepper, time: float) -> None:
        """Solve the coarse model from its last time to another one in the same stage."""
        start_time = self._computed_jumps[-1][0]
        k = math.ceil(time) - 1
        problem = coarse.problem
        problem.set_stage(k, coarse.solver.u_and_q()[0])

        def set_load(fraction: float) -> None:
            problem.set_time(start_time + fraction * (time - start_time))

        # A start that needs many steps does not pay.
        stage = problem.scene.stages[k].model_copy(update={"adaptive": False})
        coarse.run_path(stage, 1.0, set_load, start_time, time)
        contact = problem.contact
        assert contact is not None
        surface = contact.points.surface
        jump = surface.true_jumps(contact.gather(contact.state.jump))
        self._computed_jumps = [*self._computed_jumps[-1:], (time, self._interpolation @ jump)]

    def _start_from(self, jump: Floats) -> None:
        """Set the start to jumps, and to a displacement in rough equilibrium with them."""
        problem, solver = self._problem, self._solver
        u, q = solver.u_and_q()
        assert q is not None
        q.array[:] = self._contact.with_prescribed(jump).ravel()
        problem.impose(u)
        r, du = u.duplicate(), u.duplicate()
        problem.residual(u, q, r)
        du.zeroEntries()
        problem.stiffness.inverse.solve(r, du, ROUGH_TOLERANCE)
        u.axpy(-1.0, du)


def jumps_between(jumps_at: list[tuple[float, Floats]], time: float) -> Floats:
    """Jumps (n, 3) [mm] at a time, on the line through those at the last two of some times."""
    t1, last_jumps = jumps_at[-1]
    if time == t1 or len(jumps_at) == 1:
        return last_jumps
    t0, jumps_before = jumps_at[-2]
    fraction = (time - t0) / (t1 - t0)
    return (1 - fraction) * jumps_before + fraction * last_jumps


def interpolation_matrix(source: ContactPoints, target: ContactPoints, owned: Ints) -> csr_array:
    """Matrix that interpolates between meshes of the same interfaces; no communication.

    Interpolation is linear on the source's triangles: each point takes the value at the nearest
    point of the nearest triangle. Rows are those of the target points ``owned`` (n,), columns those
    of the source's corners.
    """
    from scipy.sparse import csr_array  # few runs need these imports

    from meshes.nearest_facets import nearest

    no_rows = np.zeros(0, dtype=np.int64)
    entries: list[tuple[Ints, Ints, Floats]] = [(no_rows, no_rows, np.zeros(0))]
    for i, triangles in enumerate(source.triangles):
        points = np.flatnonzero(target.interface[owned] == i)
        if len(points) and len(triangles):
            index, barycentric = nearest(target.x[owned[points]], source.surface.x[triangles])
            entries.append((np.repeat(points, 3), triangles[index].ravel(), barycentric.ravel()))
    rows, columns, values = (np.concatenate(part) for part in zip(*entries, strict=True))
    return csr_array((values, (rows, columns)), shape=(len(owned), len(source.surface.weight)))
