"""Heat and mechanics in one system, for heat that depends on contact pressure or friction.

The system has the blocks of both. The residual of heat depends on the pressures p and the friction
power of the trial state. The residual of mechanics depends on temperatures T: the forces of thermal
expansion are G T. They also act in the rows of the contact points. Equilibrium there is
e = C^T u + D q - f_q - G_q T. Pressures and friction power change with e and q
(`stepping.contact_heat`). The products of these derivatives with C^T, D and G are the coupling
blocks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

from petsc4py import PETSc

import numpy as np

from app.foundation.arrays import Floats
from app.heat.implicit_step import ImplicitStep
from app.mechanics.contact import TrialState
from app.mechanics.problem import Problem
from app.mechanics.systems import ContactSystem
from app.numerics.preconditioners import INTERFACE, Options
from app.numerics.sparse import from_triplets, matrix_sum
from app.numerics.system import Measure
from app.scene.scene import Scene, Stage
from app.stepping.contact_heat import ContactHeat

DIFFERENT_PATTERN = PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN
SUBSET_PATTERN = PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN


class CoupledSystem(ContactSystem):
    """Displacement and jumps, preceded by temperature and its jumps.

    Attributes:
        contact_heat: Contact in the heat equation.

    Args:
        committed: Converged displacement and jumps, kept up to date.
    """

    # The norm would mix watts and newtons. At a kink of the contact law a line search by it may cut
    # steps to nothing, where full steps converge.
    newton: Mapping[str, str | float] = MappingProxyType({"snes_linesearch_type": "basic"})

    def __init__(
        self, scene: Scene, heat: ImplicitStep, problem: Problem, committed: list[PETSc.Vec]
    ) -> None:
        super().__init__(problem)
        self._heat, self._committed = heat, committed
        self.contact_heat = ContactHeat(scene, problem, heat.operators)
        self._heat_blocks = len(heat.blocks())
        self._thermal_forces = (
            self._assemble_thermal_forces() if self.contact_heat.expanding_regions else None
        )
        # Heat enters the rows of its nodes and of its jumps.
        self._friction_heat = self._assemble_friction_heat()
        zeros = list(self.blocks().values())
        self._by_motion, corrections = self._derivatives_by_motion(
            problem.trial(*zeros[self._heat_blocks :]), zeros
        )
        # With expansion, pressures also depend on temperatures directly.
        self._thermal_blocks = [
            [matrix_sum(pair) for pair in zip(row, correction, strict=True)]
            for row, correction in zip(heat.matrices(), corrections, strict=False)
        ] or heat.matrices()
        self._by_heat = self._derivatives_by_heat()

    def begin_stage(self, k: int, stage: Stage, start: float) -> None:
        """Begin stage k, which starts at a time [s]."""
        self._stage = k, stage, start

    def begin(self, seconds: float, h: float, work: Floats) -> None:
        """Prepare a solve.

        Args:
            seconds: Time at its end [s].
            h: Its length [s]; infinite for a steady state.
            work: Initial friction work per area (n,) [N/mm].
        """
        k, stage, start = self._stage
        fraction = 1.0 if stage.steady else min((seconds - start) / stage.seconds, 1.0)
        self._problem.set_time(k + fraction)
        self.contact_heat.begin(h, work)

    def restore(self, x: list[PETSc.Vec]) -> None:
        """Set blocks x to the converged state of the mechanics."""
        for committed, v in zip(self._committed, x[self._heat_blocks :], strict=True):
            committed.copy(v)

    def commit(self, x: list[PETSc.Vec]) -> None:
        """Commit blocks x as the converged state of the mechanics."""
        for committed, v in zip(self._committed, x[self._heat_blocks :], strict=True):
            v.copy(committed)

    @property
    def version(self) -> int:
        """Number of changes of the matrices of heat and mechanics."""
        return self._heat.version + super().version

    def blocks(self) -> dict[str, PETSc.Vec]:
        """Blocks of the heat, then blocks of the mechanics."""
        return self._heat.blocks() | super().blocks()

    def matrices(self) -> list[list[PETSc.Mat | None]]:
        """Blocks of heat, of mechanics, and of their coupling."""
        no_blocks: list[PETSc.Mat | None] = [None] * self._heat_blocks
        by_heat = self._by_heat or [no_blocks, no_blocks]
        rows = [[*a, *b] for a, b in zip(self._thermal_blocks, self._by_motion, strict=True)]
        return [*rows, *([*a, *b] for a, b in zip(by_heat, super().matrices(), strict=True))]

    def options(self, linear: str) -> dict[str, Options]:
        """Monolithic options if the thermal block is solved directly, else options by block."""
        heat = self._heat.options(linear)
        return {"": INTERFACE} if "" in heat else heat | super().options(linear)

    def impose(self, x: list[PETSc.Vec]) -> None:
        """Set given temperatures, displacements and jumps in a state."""
        self._heat.impose(x[: self._heat_blocks])
        super().impose(x[self._heat_blocks :])

    def residual(self, x: list[PETSc.Vec], f: list[PETSc.Vec]) -> None:
        """Set the residuals: heat for the current contact, forces for the current temperatures."""
        self.contact_heat.to_mechanics(x[: self._heat_blocks])
        super().residual(x[self._heat_blocks :], f[self._heat_blocks :])
        self.contact_heat.to_heat(self.trial)
        self._heat.residual(x[: self._heat_blocks], f[: self._heat_blocks])

    def jacobian(self, x: list[PETSc.Vec]) -> None:
        """Assemble all blocks at the state of the last residual."""
        super().jacobian(x[self._heat_blocks :])
        trial = self.trial
        self.contact_heat.to_heat(trial)
        self._heat.jacobian(x[: self._heat_blocks])
        by_motion, corrections = self._derivatives_by_motion(trial, x)
        _copy(by_motion, self._by_motion)
        for total, blocks, row_corrections in zip(
            self._thermal_blocks, self._heat.matrices(), corrections, strict=False
        ):
            for S, A, B in zip(total, blocks, row_corrections, strict=True):
                S.zeroEntries()
                S.axpy(1.0, A, structure=SUBSET_PATTERN)
                S.axpy(1.0, B, structure=SUBSET_PATTERN)
        _copy(self._derivatives_by_heat(), self._by_heat)

    def runs_away(self, x: list[PETSc.Vec]) -> bool:
        """Return True if bodies have moved past each other by the size of the model; collective."""
        return super().runs_away(x[self._heat_blocks :])

    def remove_free_motions(self, x: list[PETSc.Vec]) -> bool:
        """Remove rigid motions that nothing resists from the last step of a state; collective."""
        return super().remove_free_motions(x[self._heat_blocks :])

    def measure(self, x: list[PETSc.Vec], f: list[PETSc.Vec]) -> list[Measure]:
        """Sizes of heat and forces, each with its scale."""
        heat = self._heat.measure(x[: self._heat_blocks], f[: self._heat_blocks])[0]
        of_friction = self.contact_heat.rounding(self._problem.trial(*x[self._heat_blocks :]))
        heat = replace(heat, rounding=heat.rounding + of_friction)
        return [heat, *super().measure(x[self._heat_blocks :], f[self._heat_blocks :])]

    def _assemble_thermal_forces(self) -> list[list[PETSc.Mat]]:
        """Minus the thermal forces by temperatures and their jumps, in rows of the mechanics."""
        operators = self._heat.operators
        by_body = operators.jumps.jump_to_temperature if operators.jumps else {}
        body_of_region = operators.bodies.body_of_region
        moves = {r: by_body[b] for r, b in body_of_region.items() if b in by_body}
        problem = self._problem
        sizes = [v.getSizes() for v in self.blocks().values()]
        assert problem.thermal_strain is not None
        rows = problem.thermal_strain.stiffness(moves, problem.stiffness, self.contact)
        blocks: list[list[PETSc.Mat]] = []
        for row, height in zip(rows, sizes[self._heat_blocks :], strict=True):
            blocks.append([])
            for A, width in zip(row, sizes[: self._heat_blocks], strict=False):
                if A is None:
                    A = PETSc.Mat().createAIJ((height, width), nnz=0, comm=self.comm)
                    A.assemble()
                blocks[-1].append(-1.0 * A)
        return blocks

    def _derivatives_by_heat(self) -> list[list[PETSc.Mat]]:
        """Blocks in rows of displacement and jumps and in columns of the heat."""
        if self._thermal_forces is None:
            return []
        by_u, by_q = self._thermal_forces
        return [by_u, [self.equilibrium_factors.matMult(A) for A in by_q]]

    def _assemble_friction_heat(self) -> list[PETSc.Mat]:
        """Minus the heat by friction power, in rows of temperatures and of their jumps."""
        operators, nodal_heat = self._heat.operators, self.contact_heat.nodal_heat
        blocks = [matrix_sum(nodal_heat)]
        is_prescribed = [operators.fixed.base_condition >= 0]
        jumps = operators.jumps
        if jumps is not None:
            at_jumps = [
                B.transposeMatMult(nodal_heat[b]) for b, B in jumps.jump_to_temperature.items()
            ]
            blocks.append(matrix_sum(at_jumps))
            is_prescribed.append(jumps.prescribed)
        for A, scale, is_zero_row in zip(blocks, self._heat.vectors(), is_prescribed, strict=True):
            scale.array[:] = np.where(is_zero_row, 0.0, -1.0)
            A.diagonalScale(scale)
        return blocks

    def _derivatives_by_motion(
        self, trial: TrialState, x: list[PETSc.Vec]
    ) -> tuple[list[list[PETSc.Mat]], list[list[PETSc.Mat]]]:
        """Blocks in the rows of the heat.

        Returns:
            Those in columns of the mechanics, and terms to add to those in columns of the heat.
        """
        power = self._point_rows(self.contact_heat.power_rows(trial))
        rows = [
            [friction_heat.matMult(derivative) for derivative in power]
            for friction_heat in self._friction_heat
        ]
        jumps, interpolation = self._heat.operators.jumps, self.contact_heat.pressure_interpolation
        if jumps is not None and interpolation is not None:
            flux_by_pressure = interpolation.copy()
            by_pressure = x[1].duplicate()
            flux_derivative = jumps.weight * jumps.flux(x[1].array)[2]
            by_pressure.array[:] = np.where(jumps.prescribed, 0.0, -flux_derivative)
            flux_by_pressure.diagonalScale(by_pressure)
            pressure = self._point_rows(self.contact_heat.pressure_rows(trial))
            rows[1] = [
                A + flux_by_pressure.matMult(derivative)
                for A, derivative in zip(rows[1], pressure, strict=True)
            ]
        coupling = self.contact.coupling
        by_motion = [
            [by_equilibrium.matMult(coupling.Ct), by_equilibrium.matMult(coupling.D) + by_jump]
            for by_equilibrium, by_jump in rows
        ]
        if self._thermal_forces is None:
            return by_motion, []
        return by_motion, [
            [by_equilibrium.matMult(G) for G in self._thermal_forces[1]]
            for by_equilibrium, _ in rows
        ]

    def _point_rows(self, rows: tuple[Floats, Floats]) -> list[PETSc.Mat]:
        """Derivatives of k scalars of each contact point (n, k, 3) as matrices (3 n columns)."""
        start = self.contact.coupling.D.getOwnershipRange()[0]
        matrices = []
        for values in rows:
            n, k, _ = values.shape
            row = np.repeat(np.arange(n * k), 3)
            component = start + 3 * np.arange(n)[:, None, None] + np.arange(3)
            column = np.broadcast_to(component, values.shape).ravel()
            matrices.append(from_triplets(self.comm, n * k, 3 * n, row, column, values.ravel()))
        return matrices


def _copy(source: list[list[PETSc.Mat]], target: list[list[PETSc.Mat]]) -> None:
    """Copy values of matrices into others of the same pattern."""
    for row, target_row in zip(source, target, strict=True):
        for block, target_block in zip(row, target_row, strict=True):
            if block is not target_block:
                block.copy(target_block, structure=DIFFERENT_PATTERN)
