"""The systems of mechanics: displacement alone, or displacement and jumps."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from app.foundation.arrays import Floats, Ints
from app.mechanics.coarse_space import displacement_by_motions, free_directions, sliding_motions
from app.mechanics.contact import ContactInterfaces, TrialState
from app.mechanics.point_forces import PointForces
from app.mechanics.problem import Problem
from app.numerics.choice import SolverChoice
from app.numerics.deflation import CoarseSpace
from app.numerics.preconditioners import SWEEP, Options, stiffness_options
from app.numerics.sparse import block_diagonal, fill_blocks, renew
from app.numerics.system import SPRING_STIFFNESS, Measure, System, block_norm

if TYPE_CHECKING:
    from app.numerics.condensed import Condensed

log = logging.getLogger("mantle")

# Motions that nothing resists are rounding below this fraction of the jumps of a step.
MOTION_ROUNDING = 1e-12
# Forces are in balance if their work in motions of unit size is below this fraction of their size.
UNBALANCED_WORK = 1e-8
# Shear counts as an effect of uncertain normals up to this multiple of their uncertainty.
UNCERTAINTY_FACTOR = 3.0


def mechanical_system(
    problem: Problem, solves: float = 1.0, memory: float = math.inf
) -> BondedSystem | ContactSystem:
    """Return the system of a mechanical problem.

    Args:
        problem: The problem.
        solves: Expected number of solves; decides on condensation.
        memory: Memory of a rank [byte].
    """
    return ContactSystem(problem, solves, memory) if problem.contact else BondedSystem(problem)


class BondedSystem(System):
    """Displacement alone: no interface can move."""

    prefix = "mantle_"
    # The equations are linear: one linear solve, to the limit of the solver.
    newton: Mapping[str, str | float] = MappingProxyType({"ksp_rtol": 1e-14})

    def __init__(self, problem: Problem) -> None:
        self._problem, self.comm = problem, problem.comm
        self.inverses = {"displacement": problem.stiffness.inverse}

    @property
    def version(self) -> int:
        """Number of changes of the stiffness."""
        return self._problem.stiffness.version

    def blocks(self) -> dict[str, PETSc.Vec]:
        """The displacement."""
        return {"displacement": self._problem.stiffness.K.createVecLeft()}

    def matrices(self) -> list[list[PETSc.Mat | None]]:
        """The stiffness."""
        return [[self._problem.stiffness.K]]

    def options(self, linear: str) -> dict[str, Options]:
        """Direct or multigrid."""
        stiffness = self._problem.stiffness
        return {
            "displacement": stiffness_options(linear, stiffness.K, stiffness.inverse.coarse_order)
        }

    def impose(self, x: list[PETSc.Vec]) -> None:
        """Put prescribed displacements into a state."""
        self._problem.impose(x[0])

    def residual(self, x: list[PETSc.Vec], f: list[PETSc.Vec]) -> None:
        """Residual K u - f."""
        self._problem.residual(x[0], None, f[0])

    def measure(self, x: list[PETSc.Vec], f: list[PETSc.Vec]) -> list[Measure]:
        """Out-of-balance forces, with their scale [N]."""
        problem, (u, *q) = self._problem, x
        scale = problem.size_of_forces(u, q[0] if q else None)
        return [Measure(block_norm(f), scale, problem.rounding(u, *q))]


class ContactSystem(BondedSystem):
    """Displacement and jumps.

    Attributes:
        contact: Contact of the interfaces.
        trial: Contact at the state of the last residual or Jacobian.
        factors: Blocks of the last Jacobian in the rows of the jumps: factors of the equilibrium,
            and blocks added to it (`ContactInterfaces.row_factors`).
        law_forces: Forces of the laws at the last Jacobian or call of `law`.

    Args:
        solves: Expected number of solves; 0 if it is not to be condensed.
        memory: Memory of a rank [byte].
    """

    contact: ContactInterfaces
    trial: TrialState
    factors: tuple[Floats, Floats]
    law_forces: PointForces
    newton: Mapping[str, str | float] = MappingProxyType({})

    def __init__(self, problem: Problem, solves: float = 0.0, memory: float = math.inf) -> None:
        super().__init__(problem)
        assert problem.contact is not None
        self._solves, self._memory = solves, memory
        contact = self.contact = problem.contact
        self._C = contact.coupling.C.copy()
        self._C.zeroRows(problem.stiffness.rows, diag=0.0)
        self._coupling_version = problem.stiffness.version
        self.equilibrium_factors = block_diagonal(contact.comm, len(contact.local))
        self._A_qu = self.equilibrium_factors.matMult(contact.coupling.Ct)
        self._A_qq = self.equilibrium_factors.matMult(contact.coupling.D)
        self._added_blocks = block_diagonal(contact.comm, len(contact.local))
        self._coarse_version = -1

    def blocks(self) -> dict[str, PETSc.Vec]:
        """Displacement and jumps."""
        return super().blocks() | {"jump": self.contact.coupling.D.createVecLeft()}

    def matrices(self) -> list[list[PETSc.Mat | None]]:
        """The stiffness, the coupling, and the rows of the jumps."""
        return [[self._problem.stiffness.K, self._C], [self._A_qu, self._A_qq]]

    def options(self, linear: str) -> dict[str, Options]:
        """Direct or multigrid for the displacement, a sweep for the jumps."""
        return super().options(linear) | {"jump": SWEEP}

    def impose(self, x: list[PETSc.Vec]) -> None:
        """Put prescribed displacements and jumps into a state."""
        super().impose(x)
        x[1].array[:] = self.contact.with_prescribed(x[1].array_r.reshape(-1, 3)).ravel()

    def residual(self, x: list[PETSc.Vec], f: list[PETSc.Vec]) -> None:
        """Equilibrium of the bodies, and of the contact points with their law."""
        trial = self._problem.residual(x[0], x[1], f[0], f[1])
        assert trial is not None
        self.trial = trial
        r = f[1].array_r.reshape(-1, 3)
        f[1].array[:] = self._without_uncertain_loads(r, trial.equilibrium, trial.forces)

    def _without_uncertain_loads(self, r: Floats, e: Floats, law: PointForces) -> Floats:
        """Residual of contact (3 n,) [N] without small loads along free motions; collective.

        If normals are uncertain, so is the axis of their surface, and the moment of the loads about
        it. Nothing resists this moment. If it is within the uncertainty of the normals, the contact
        points bear it.
        """
        contact, problem = self.contact, self._problem
        normal_error = contact.points.normal_error[contact.local.rows]
        if not contact.points.normal_error.any():
            return r.ravel()
        motions = contact.unresisted_motions(law)
        if not motions.shape[1]:
            return r.ravel()
        jumps, w = contact.motions.relative(motions), contact.local.weight
        # Products of the motions, the same weighted by the squared uncertainty, squared forces.
        local_sums = (
            np.einsum("p,pik,pil->kl", w, jumps, jumps),
            np.einsum("p,pik,pik,p->", w, jumps, jumps, normal_error**2),
            np.einsum("pi,pi->", e, e),
        )
        products, weighted_error, forces = (self.comm.allreduce(v) for v in local_sums)
        work = self._work(motions, problem.f_q.reshape(-1, 3))
        # Forces at the points that do the work of the loads in these motions.
        borne_forces = w[:, None] * (jumps @ np.linalg.lstsq(products, work, rcond=None)[0])
        squared = self.comm.allreduce(np.einsum("pi,pi->", borne_forces, borne_forces))
        largest_squared = UNCERTAINTY_FACTOR**2 * weighted_error / np.trace(products) * forces
        return (r + borne_forces if squared <= largest_squared else r).ravel()

    def jacobian(self, x: list[PETSc.Vec]) -> None:
        """The generalized Jacobian of the contact points."""
        contact = self.contact
        self.uncondensed_matrices()
        self.trial = self._problem.trial(*x)
        factors, added_blocks = contact.row_factors(self.trial.forces)
        self.law_forces = self.trial.forces
        if self._moves_floating_bodies():
            springs = SPRING_STIFFNESS * contact.coupling.D.getDiagonal().array_r.reshape(-1, 3)
            added_blocks = added_blocks + springs[:, :, None] * np.eye(3)
        self.factors = factors, added_blocks
        fill_blocks(self.equilibrium_factors, factors)
        fill_blocks(self._added_blocks, added_blocks)
        for product, A in ((self._A_qu, contact.coupling.Ct), (self._A_qq, contact.coupling.D)):
            if self._problem.stiffness.constraints.follows:
                # On several ranks a product keeps the pattern of its former factors.
                renew(product, self.equilibrium_factors.matMult(A), new_pattern=True)
            else:
                self.equilibrium_factors.matMult(A, result=product)
        self._A_qq.axpy(
            1.0, self._added_blocks, structure=PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN
        )

    def _moves_floating_bodies(self) -> bool:
        """Return True if forces move bodies that only open points resist; collective."""
        contact, law = self.contact, self.trial.forces
        motions = contact.motions_resisted_by_open_points(law)
        if not motions.shape[1]:
            return False
        forces = self._problem.f_q.reshape(-1, 3) - contact.local.weight[:, None] * law.force
        work = self._work(motions, forces)
        return bool(
            np.abs(work).max()
            > UNBALANCED_WORK * self._problem.size_of_loads_and_interface_forces(forces)
        )

    def _work(self, motions: Floats, forces: Floats) -> Floats:
        """Work of the loads, and of forces on jumps (n, 3) [N], in motions (k,); collective.

        ``motions`` are rigid motions of all bodies (6 bodies, k).
        """
        jumps = self.contact.motions.relative(motions)
        loads = [displacement_by_motions(self._problem, m).dot(self._problem.f) for m in motions.T]
        return np.asarray(self.comm.allreduce(np.einsum("pik,pi->k", jumps, forces)) + loads)

    def condensed(self, linear: str) -> Condensed | None:
        """Condensed onto the jumps, if that is asked for or takes less time; collective."""
        problem, comm = self._problem, self.comm
        if not self._solves or linear not in ("auto", "condensed"):
            return None
        sizes = problem.stiffness.K.getSize()[0], self.contact.coupling.D.getSize()[0]
        expected_solves = self._solves, problem.scene.stiffness_varies, self._memory, comm.size
        choice = SolverChoice(problem.scene.order, *sizes, *expected_solves)
        condensed: Condensed | None = None
        if choice.condenses(linear):
            from app.numerics.condensed import Condensed, has_factor_library  # scipy: few need it

            if has_factor_library(comm):
                condensed = Condensed(self)
                choice = replace(choice, entries=condensed.entries)
                if not choice.fits:
                    condensed = None
        log.info("solver: %s", choice.description(linear, condensed is not None))
        return condensed

    def uncondensed_matrices(self) -> tuple[PETSc.Mat, PETSc.Mat, PETSc.Mat]:
        """Stiffness, coupling without constrained rows, stiffness of the jumps."""
        if self._coupling_version != self._problem.stiffness.version:
            self._coupling_version = self._problem.stiffness.version
            renew(self._C, self.contact.coupling.C, new_pattern=True)
            self._C.zeroRows(self._problem.stiffness.rows, diag=0.0)
        return self._problem.stiffness.K, self._C, self.contact.coupling.D

    @property
    def pairings(self) -> int:
        """Number of changes of the stiffness by new pairs of surfaces alone."""
        return self._problem.stiffness.pairings

    def pair_matrices(self) -> tuple[PETSc.Mat, PETSc.Mat] | None:
        """Two matrices: from current master unknowns to the points, from all to the masters.

        None without deformable masters.
        """
        sliding = self.contact.finite_sliding
        if sliding is None or not sliding.followers.deformable:
            return None
        constraints, points = self._problem.stiffness.constraints, self.contact.points
        first_owned = self._problem.space.dofmap.index_map.local_range[0]
        Q = constraints.rows_of(points.dof[self.contact.local.rows] - first_owned)
        follows = Q.createVecLeft()
        follows.array.reshape(-1, 3)[sliding.rows[sliding.on_deformable]] = 1.0
        Q.diagonalScale(follows)
        return Q, constraints.rows_of(sliding.followers.masters)

    def forces(self, x: list[PETSc.Vec]) -> tuple[Floats, Floats, float]:
        """Residual of displacement and jumps without the law, and size of the forces [N]."""
        residual = x[0].duplicate()
        self._problem.residual(x[0], x[1], residual)
        e = self.contact.coupling.equilibrium(x[0], x[1], self._problem.f_q)
        return residual.array, e.ravel(), self._problem.size_of_loads_and_interface_forces(e)

    def law(self, e: Floats, q: Floats) -> tuple[Floats, float]:
        """Residual of the law at equilibrium e and jumps q, and size of the forces [N]."""
        contact, e, q = self.contact, e.reshape(-1, 3), q.reshape(-1, 3)
        law = contact.evaluate(e, q)
        self.factors, self.law_forces = contact.row_factors(law), law
        r = self._without_uncertain_loads(contact.residual(e, q, law), e, law)
        return r, self._problem.size_of_loads_and_interface_forces(e)

    @property
    def law_status(self) -> Ints:
        """States of local points at the last Jacobian or call of `law` (n,)."""
        return self.law_forces.status

    def free_jumps(self) -> Floats:
        """Jumps of rigid motions that nothing resists at the last state (n, 3, k); collective."""
        return self.contact.motions.relative(self.contact.unresisted_motions(self.law_forces))

    def remove_free_motions(self, x: list[PETSc.Vec]) -> bool:
        """Remove rigid motions that nothing resists from the last step of a state; collective.

        The jumps since the last converged state are then orthogonal to such motions, by area.

        Returns:
            True if the state changes.
        """
        contact, problem = self.contact, self._problem
        motions = contact.unresisted_motions(self.trial.forces)
        if not motions.shape[1]:
            return False
        jumps, w = contact.motions.relative(motions), contact.local.weight
        step_jumps = x[1].array_r.reshape(-1, 3) - contact.gaps.reference
        gram = np.einsum("p,pik,pil->kl", w, jumps, jumps)
        work = np.einsum("p,pik,pi->k", w, jumps, step_jumps)
        step_square = np.einsum("p,pi,pi->", w, step_jumps, step_jumps)
        gram, work, step_square = (self.comm.allreduce(v) for v in (gram, work, step_square))
        amplitudes = np.linalg.lstsq(gram, work, rcond=None)[0]
        if work @ amplitudes <= MOTION_ROUNDING**2 * step_square:
            return False
        x[1].array[:] -= (jumps @ amplitudes).ravel()
        x[0].axpy(-1.0, displacement_by_motions(problem, motions @ amplitudes))
        ContactSystem.impose(self, x)  # a system with heat has more blocks
        return True

    def runs_away(self, x: list[PETSc.Vec]) -> bool:
        """Return True if bodies have moved past each other by the size of the model; collective.

        The rounding error of K u grows with u: far away any forces would seem balanced.
        """
        prescribed = float(np.abs(self._problem.prescribed).max(initial=0.0))
        limit = self._problem.size + self.comm.allreduce(prescribed, MPI.MAX)
        is_far = not np.abs(x[-1].array_r).max(initial=0.0) <= limit  # True if it is not finite
        return bool(self.comm.allreduce(is_far, MPI.LOR))

    def coarse_space(self) -> CoarseSpace:
        """Motions of bodies that slide, lift off or bend away."""
        version = self._problem.stiffness.version
        if self._coarse_version != version:
            self._coarse_motions, self._coarse_version = sliding_motions(self._problem), version
        free_projector, law = self.contact.local.free_projector, self.trial.forces
        resisted = law.resisted @ self.contact.laws.layer_share
        free_directions_of_points = free_projector @ free_directions(resisted) @ free_projector
        self._coarse_motions.update(
            free_directions_of_points, np.linalg.norm(law.traction_stiffness, axis=(1, 2))
        )
        return self._coarse_motions

    @property
    def status(self) -> Ints:
        """States of the contact points of this rank at the last residual (n,)."""
        return self.trial.forces.status
