"""The stimulus of bone: strain energy per mass at the vertices, the mean over load cases.

Arrays are by vertex of this rank, ghosts too, and region (n, r).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from petsc4py import PETSc

import numpy as np
import ufl

from app.foundation.arrays import Floats
from app.mechanics.body_forms import assemble_form_matrix
from app.numerics.newton import NewtonResult
from app.numerics.preconditioners import Inverse
from app.numerics.remedies import solve
from app.remodelling.bone import BoneMass
from app.remodelling.laws import Remodelling
from app.stepping.load_steps import LoadStepper

# Stands for zero as a divisor.
TINY = 1e-300


class Stimulus:
    """Strain energy per mass of the bone that remodels; made and called collectively.

    Attributes:
        outcome: Outcome of the last solve.
    """

    outcome: NewtonResult

    def __init__(self, law: Remodelling, bone: BoneMass, stepper: LoadStepper) -> None:
        self.bone = bone
        self._stepper = stepper
        self._filters = [self._filter(r, law.filter) for r in bone.forms.density_regions]
        self._states: dict[float, PETSc.Vec] = {}

    def _filter(self, region: str, length: float | None) -> Callable[[Floats], Floats]:
        """Filter of values S of a region, S - l^2 div grad S = given, if it has a length l."""
        if length is None:
            return lambda given: given
        forms = self.bone.forms
        owned = forms.scalars.dofmap.index_map.size_local
        slopes = [ufl.grad(f(forms.scalars)) for f in (ufl.TrialFunction, ufl.TestFunction)]
        dx = forms.cells()(forms.tagged.regions[region])
        A = assemble_form_matrix(forms.form(forms.constant(length**2) * ufl.inner(*slopes) * dx))
        # Vertices of other regions have no entries yet.
        A.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        volume = self.bone.volume[:, forms.density_regions.index(region)]
        volume = np.where(volume > 0, volume, 1.0)
        A.setDiagonal(A.getDiagonal() + PETSc.Vec().createWithArray(volume[:owned], comm=A.comm))
        inverse = Inverse(A, lambda: 0, {"pc_type": "jacobi"})

        def filtered(given: Floats) -> Floats:
            b, x = A.createVecs()
            b.array[:] = (volume * given)[:owned]
            inverse.solve(b, x, 1e-10)
            return forms.vertex_sums(np.arange(owned, dtype=np.int32), x.array_r)

        return filtered

    def of(self, cases: Sequence[tuple[int, float]]) -> Floats | None:
        """Stimulus [J/g], the mean over load cases; None if one cannot be solved.

        The energy density at a vertex is its mean weighted with the vertex's hat function. A case
        is the stage whose supports hold and the time of its loads; each begins in the committed
        state of the interfaces.
        """
        bone, solver = self.bone, self._stepper.solver
        problem = bone.problem
        self.follow_density()
        energy = 0.0 * bone.volume
        for k, time in cases:
            self._states.get(time, solver.x).copy(solver.x)
            problem.set_stage(k, solver.u_and_q()[0])
            problem.set_time(time)
            problem.update_stiffness()
            self.outcome = solve(solver)
            self._stepper.total.count(self.outcome)
            if not self.outcome.converged:
                return None
            self._states[time] = solver.x.copy()
            problem.update_displacements(*solver.u_and_q())
            energy += bone.integrals(bone.stresses.energy_density)
        S = energy / np.maximum(len(cases) * bone.volume * bone.forms.density, TINY)
        return np.array([f(values) for f, values in zip(self._filters, S.T, strict=True)]).T

    def follow_density(self) -> None:
        """Take the stiffness from the density."""
        self.bone.problem.follow_density()
        self.bone.stresses.follow_density()
