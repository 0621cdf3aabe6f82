r"""Heat and mechanics in one system, where heat depends on contact: pressure or friction.

Blocks are those of both. The residual of heat sees the pressures p and the friction power D of the
trial state, that of the mechanics its temperatures T: the forces of thermal expansion are G T, in
the rows of the contact points too, where equilibrium is e = C^T u + D q - f_q - G_q T. With the law
of a contact point, F = P(S), S = -e/W + r (q + g), and its generalized derivative P', pressure
p = |F_n| and friction power per area F_T · Δq/Δt change by

.. math:: dp = m·P' dS, \qquad d(F_T·Δq)/Δt = (P' dS)_T·Δq/Δt + F_T·dq/Δt,
          \qquad dS = -de/W + r\,dq

with m the direction of the pressure: the products of these rows with C^T, D and G are the blocks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from mantle.arrays import Floats, Ints
from mantle.forms import interface_heat
from mantle.heat.conduction import Conduction
from mantle.heat.system import HeatSystem
from mantle.mechanics.points import PointForces
from mantle.mechanics.problem import ROUNDING, Problem, TrialState
from mantle.mechanics.systems import ContactSystem
from mantle.numerics.deflation import CoarseSpace
from mantle.numerics.newton import NewtonResult, Solver
from mantle.numerics.preconditioners import INTERFACE, Options
from mantle.numerics.sparse import from_triplets, matrix_sum, owners
from mantle.numerics.state import State
from mantle.numerics.system import Measure, System
from mantle.scene.bodies import contact_facets
from mantle.scene.terms import FrictionHeat, Scene

DIFFERENT = PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN
SUBSET = PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN
# Turns of heat and mechanics before giving up.
TURNS = 60


@dataclass(frozen=True)
class PointDerivatives:
    """How a scalar of each own contact point changes: with equilibrium and with the jump (n, 3)."""

    by_equilibrium: Floats
    by_jump: Floats


class ContactHeat:
    """Input of the heat from the contact points: pressures and the power of friction.

    Attributes:
        heats: For each thermal body, nodal heat by friction power per area (nodes x points) [mm2].
        pressed: Pressure at the points of finite conductance by that at contact points, if any.
        expands: Regions that expand.
    """

    def __init__(self, scene: Scene, problem: Problem, conduction: Conduction) -> None:
        """Find who is where; collective."""
        self._problem, self._conduction = problem, conduction
        self.expands = {x.region for x in scene.expansions}
        (j,) = problem.jumps
        comm, points = problem.comm, j.points
        number = owners(comm, problem.space.dofmap.index_map, points.dof)[1]
        self._n = len(j.mine)
        self.heats = _heats(scene, problem, conduction, number)
        self.rubbing = np.isin(
            j.interface, [i for i, c in enumerate(scene.contacts) if c.name in _names(scene)]
        )
        names = [c.name for c in scene.contacts]
        known = {
            (names[i], v): n
            for i, v, n in zip(points.interface, points.vertex, number, strict=True)
        }
        self.pressed: tuple[PETSc.Mat, ...] = ()
        for t in conduction.jumps:
            name = [scene.thermal_contacts[i].name for i in t.interface]
            found = np.array(
                [known.get(key, -1) for key in zip(name, t.points.vertex[t.mine], strict=True)],
                dtype=np.int64,
            )
            on = np.flatnonzero(found >= 0)
            self.pressed = (
                from_triplets(comm, len(found), self._n, on, found[on], np.ones(len(on))),
            )

    def to_mechanics(self, heat: Sequence[PETSc.Vec]) -> None:
        """Set the temperatures that the mechanics use."""
        if self.expands:
            self._conduction.temperatures(heat)
            regions = {r: self._conduction.of_region(r) for r in self.expands}
            self._problem.set_temperature(regions)

    def power(self, trial: TrialState, elapsed: float) -> Floats:
        """Power of friction per area at own contact points (n,) [N/(mm s)]."""
        (j,) = self._problem.jumps
        slip = trial.jump - j.history.jump
        tangential = trial.law.force - _normal(trial.law, j.normals)
        # The rounding of sticking points is no heat, and none cools.
        return np.where(self.rubbing, np.maximum(_dot(tangential, slip), 0.0), 0.0) / elapsed

    def to_heat(self, trial: TrialState, elapsed: float) -> None:
        """Set the pressures and the friction heat that the heat equation uses."""
        (j,) = self._problem.jumps
        pressure = np.linalg.norm(_normal(trial.law, j.normals), axis=1)
        power = self.power(trial, elapsed)
        for P, t in zip(self.pressed, self._conduction.jumps, strict=True):
            t.pressure = _times(P, pressure)
            t.friction = _times(P, power)
        for friction in self._conduction.frictions:
            friction.nodal = [_times(H, power) for _, H in sorted(self.heats.items())]
            for i, c in enumerate(self._problem.scene.contacts):
                if f"friction {c.name}" in friction.flows:
                    mine = float((j.weight * power)[j.interface == i].sum())
                    friction.flows[f"friction {c.name}"] = self._problem.comm.allreduce(mine)

    def rounding(self, trial: TrialState, elapsed: float) -> float:
        """Rounding error of the power of friction by long slips; collective [N mm/s]."""
        (j,) = self._problem.jumps
        slip = np.linalg.norm(trial.jump - j.history.jump, axis=1)
        # Forces are those of equilibrium, of bodies that may be far from where they were.
        met = j.share * j.D.getDiagonal().array.reshape(-1, 3).max(axis=1)
        force = (met + j.stiffness * j.weight) * np.linalg.norm(trial.jump, axis=1)
        power = np.where(self.rubbing, force * slip, 0.0) / elapsed
        total = self._problem.comm.allreduce(float(np.sum(power**2)), MPI.SUM)
        return ROUNDING * float(np.finfo(float).eps) * math.sqrt(total)

    def pressure_rows(self, trial: TrialState) -> PointDerivatives:
        """How the pressure changes."""
        (j,) = self._problem.jumps
        force = _normal(trial.law, j.normals)
        size = np.linalg.norm(force, axis=1)
        direction = force / np.where(size > 0, size, 1.0)[:, None]
        return self._rows(direction, trial)

    def power_rows(self, trial: TrialState, elapsed: float) -> PointDerivatives:
        """How the friction power changes."""
        (j,) = self._problem.jumps
        slip = trial.jump - j.history.jump
        tangential = trial.law.force - _normal(trial.law, j.normals)
        warm = self.rubbing & (_dot(tangential, slip) > 0)
        along = np.einsum("pi,pki->pk", slip, j.normals)
        slides = slip - np.einsum("pk,pki->pi", along, j.normals)
        rows = self._rows(slides, trial)
        scale = np.where(warm, 1 / elapsed, 0.0)[:, None]
        return PointDerivatives(scale * rows.by_equilibrium, scale * (rows.by_jump + tangential))

    def _rows(self, along: Floats, trial: TrialState) -> PointDerivatives:
        """Of the force along directions (n, 3): by -e/W as far as the trial force has it, by q."""
        (j,) = self._problem.jumps
        by_force = np.einsum("pi,pij->pj", along, trial.law.jacobian)
        by_jump = np.einsum("pi,pij->pj", along, trial.law.by_jump)
        return PointDerivatives(-(j.share / j.weight)[:, None] * by_force, by_jump)


class CoupledSystem(System):
    """Heat and mechanics as one system.

    Attributes:
        elapsed: Time since the last committed state of the mechanics [s], set from outside.
    """

    prefix = "mantle_"
    # Watts and newtons in one norm: a step that lowers it may be cut to nothing at a kink of the
    # contact law, where whole steps converge.
    newton: Options = {"snes_linesearch_type": "basic"}  # noqa: RUF012

    def __init__(
        self,
        scene: Scene,
        conduction: Conduction,
        problem: Problem,
        heat: HeatSystem,
        motion: ContactSystem,
    ) -> None:
        """Set up the blocks between the two; collective."""
        self.comm = problem.comm
        self._conduction, self._problem = conduction, problem
        self._heat, self._motion = heat, motion
        self.inverses = motion.inverses
        self.active = motion.active
        self.exchange = ContactHeat(scene, problem, conduction)
        self._n = len(heat.blocks())
        self._forces = self._thermal_forces() if self.exchange.expands else ()
        self.elapsed = 1.0
        # Heat enters the rows of its nodes and of its jumps.
        self._nodes = self._entries()
        fresh = list(self.blocks().values())
        self._up, back = self._from_motion(problem.trial(*fresh[self._n :]), fresh)
        own = heat.matrices()
        # With expansion pressures depend on temperatures directly too.
        self._own = [
            [_joined(a, b) for a, b in zip(row, more, strict=True)]
            for row, more in zip(own, back, strict=False)
        ] or own
        self._down = self._from_heat()

    @property
    def version(self) -> int:
        """Changes of either's matrices."""
        return self._heat.version + self._motion.version

    def blocks(self) -> dict[str, PETSc.Vec]:
        """Those of the heat, then those of the mechanics."""
        return self._heat.blocks() | self._motion.blocks()

    def matrices(self) -> list[list[PETSc.Mat | None]]:
        """Heat, mechanics, and what either does to the other."""
        none: list[PETSc.Mat | None] = [None] * self._n
        down = self._down or [none, none]
        top = [[*a, *b] for a, b in zip(self._own, self._up, strict=True)]
        return [*top, *([*a, *b] for a, b in zip(down, self._motion.matrices(), strict=True))]

    def options(self, linear: str) -> dict[str, Options]:
        """All blocks at once if the heat's are, else those of either."""
        heat = self._heat.options(linear)
        return {"": INTERFACE} if "" in heat else heat | self._motion.options(linear)

    def impose(self, x: list[PETSc.Vec]) -> None:
        """Put given temperatures, displacements and jumps into a state."""
        self._heat.impose(x[: self._n])
        self._motion.impose(x[self._n :])

    def residual(self, x: list[PETSc.Vec], f: list[PETSc.Vec]) -> None:
        """Heat that is lacking with the contact as it is, forces with the heat as it is."""
        self.exchange.to_mechanics(x[: self._n])
        self._motion.residual(x[self._n :], f[self._n :])
        self.exchange.to_heat(self._motion.trial, self.elapsed)
        self._heat.residual(x[: self._n], f[: self._n])

    def jacobian(self, x: list[PETSc.Vec]) -> None:
        """All blocks, of the state whose residual was asked for last."""
        self._motion.jacobian(x[self._n :])
        trial = self._motion.trial
        self.exchange.to_heat(trial, self.elapsed)
        self._heat.jacobian(x[: self._n])
        up, back = self._from_motion(trial, x)
        _copy(up, self._up)
        for total, own, more in zip(self._own, self._heat.matrices(), back, strict=False):
            for S, A, B in zip(total, own, more, strict=True):
                S.zeroEntries()
                S.axpy(1.0, A, structure=SUBSET)
                S.axpy(1.0, B, structure=SUBSET)
        _copy(self._from_heat(), self._down)

    def coarse_space(self) -> CoarseSpace:
        """Sliding motions of the mechanics, at fixed temperatures."""
        return self._motion.coarse_space()

    def measure(self, x: list[PETSc.Vec], f: list[PETSc.Vec]) -> list[Measure]:
        """Heat and forces, each beside its own scale."""
        (heat,) = self._heat.measure(x[: self._n], f[: self._n])
        noise = self.exchange.rounding(self._problem.trial(*x[self._n :]), self.elapsed)
        heat = replace(heat, rounding=heat.rounding + noise)
        return [heat, *self._motion.measure(x[self._n :], f[self._n :])]

    def scale_augmentation(self, factor: float) -> bool:
        """Solve with this multiple of the augmentation in force, if an interface has one."""
        return self._motion.scale_augmentation(factor)

    def augmentation(self) -> dict[str, float]:
        """Augmentation in force on each interface [MPa/mm]; collective."""
        return self._motion.augmentation()

    def usual_augmentation(self) -> float:
        """Multiple of the augmentation asked for that would be chosen; collective."""
        return self._motion.usual_augmentation()

    def scale_friction(self, share: float) -> bool:
        """Solve with this share of all friction coefficients, if there is friction."""
        return self._motion.scale_friction(share)

    def tie(self, on: bool) -> bool:
        """Solve with interfaces tied that were open everywhere so far, if there are any."""
        return self._motion.tie(on)

    def pack(self, x: list[PETSc.Vec]) -> State:
        """Both states."""
        return {
            "heat": self._heat.pack(x[: self._n]),
            "motion": self._motion.pack(x[self._n :]),
        }

    def unpack(self, state: State, x: list[PETSc.Vec]) -> None:
        """Fill x with the saved blocks of heat and mechanics."""
        self._heat.unpack(state["heat"], x[: self._n])
        self._motion.unpack(state["motion"], x[self._n :])

    def _thermal_forces(self) -> tuple[list[list[PETSc.Mat]], ...]:
        """Forces of temperatures and temperature jumps on displacement and jumps, negative."""
        moves = {
            r: j.moves[b]
            for j in self._conduction.jumps
            for r, b in self._conduction.bodies.of_region.items()
            if b in j.moves
        }
        G = self._problem.thermal_stiffness(moves)
        rows = [[G.u_θ, G.u_τ], [G.q_θ, G.q_τ]]
        shapes = [v.getSizes() for v in self.blocks().values()]
        found = []
        for row, height in zip(rows, shapes[self._n :], strict=True):
            blocks = []
            for A, width in zip(row[: self._n], shapes[: self._n], strict=True):
                negative = _empty(self.comm, height, width) if A is None else A.copy()
                negative.scale(-1.0)
                blocks.append(negative)
            found.append(blocks)
        return (found,)

    def _from_heat(self) -> list[list[PETSc.Mat]]:
        """Rows of displacement and jumps, columns of the heat."""
        if not self._forces:
            return []
        by_u, by_q = self._forces[0]
        return [by_u, [self._motion.rows.matMult(A) for A in by_q]]

    def _entries(self) -> list[PETSc.Mat]:
        """Heat by friction power, negative: in the rows of temperature and of jumps."""
        conduction = self._conduction
        total = matrix_sum(list(self.exchange.heats.values()))
        keep = conduction.vectors()
        keep[0].array[:] = np.where(conduction.held, 0.0, -1.0)
        total.diagonalScale(keep[0])
        nodes = [total]
        for j in conduction.jumps:
            parts = [B.transposeMatMult(self.exchange.heats[b]) for b, B in j.moves.items()]
            keep[1].array[:] = np.where(j.held, 0.0, -1.0)
            jumps = matrix_sum(parts)
            jumps.diagonalScale(keep[1])
            nodes.append(jumps)
        return nodes

    def _from_motion(
        self, trial: TrialState, x: list[PETSc.Vec]
    ) -> tuple[list[list[PETSc.Mat]], list[list[PETSc.Mat]]]:
        """Rows of the heat: columns of the mechanics, and what comes back to its own."""
        (j,) = self._problem.jumps
        power = self._matrices(self.exchange.power_rows(trial, self.elapsed))
        rows = [[Z.matMult(R) for R in power] for Z in self._nodes]
        jumps, pressed = self._conduction.jumps, self.exchange.pressed
        for t, P, τ in zip(jumps, pressed, x[1 : self._n], strict=True):
            squeezed = P.copy()
            by_pressure = τ.duplicate()
            growth = t.weight * t.flux(τ.array)[2]
            by_pressure.array[:] = np.where(t.held, 0.0, -growth)
            squeezed.diagonalScale(by_pressure)
            pressure = self._matrices(self.exchange.pressure_rows(trial))
            rows[1] = [
                _plus(A, squeezed.matMult(R)) for A, R in zip(rows[1], pressure, strict=True)
            ]
        up = [[E.matMult(j.Ct), _plus(E.matMult(j.D), Q)] for E, Q in rows]
        back = [[E.matMult(G) for G in forces[1]] for forces in self._forces for E, _ in rows]
        return up, back

    def _matrices(self, rows: PointDerivatives) -> list[PETSc.Mat]:
        """Rows of scalars of the contact points as matrices (points x components)."""
        n = len(rows.by_jump)
        (j,) = self._problem.jumps
        start = j.D.getOwnershipRange()[0]
        i, k = np.divmod(np.arange(3 * n, dtype=np.int64), 3)
        return [
            from_triplets(self.comm, n, 3 * n, i, start + 3 * i + k, values.ravel())
            for values in (rows.by_equilibrium, rows.by_jump)
        ]


class Staggered:
    """Heat and mechanics in turns, until both hold: the same solution by another way.

    Each turn solves the heat with the contact of the turn before and the mechanics with that heat.
    It takes the place of a solver of both.

    Attributes:
        elapsed: Time since the last committed state of the mechanics [s], set from outside.
    """

    def __init__(
        self,
        exchange: ContactHeat,
        conduction: Conduction,
        problem: Problem,
        heat: Solver,
        motion: Solver,
    ) -> None:
        """Join two solvers."""
        self._exchange, self._conduction, self._problem = exchange, conduction, problem
        self._heat, self._motion = heat, motion
        self.elapsed = 1.0

    def named(self) -> dict[str, PETSc.Vec]:
        """Blocks of the current state by name."""
        return self._heat.named() | self._motion.named()

    @property
    def block_sizes(self) -> dict[str, int]:
        """Unknowns by block."""
        return self._heat.block_sizes | self._motion.block_sizes

    def solve(self) -> NewtonResult:
        """Solve from the current state."""
        outcome = NewtonResult(False, 0, 0, (), (), False)
        for _ in range(TURNS):
            self._pass_contact_to_heat()
            outcome = _after(outcome, self._heat.solve())
            if not outcome.converged:
                break
            self._exchange.to_mechanics(self._heat.blocks())
            outcome = _after(outcome, self._motion.solve())
            if not outcome.converged:
                break
            self._pass_contact_to_heat()
            if self._holds():
                return outcome
        return replace(outcome, converged=False)

    def state(self) -> State:
        """That of the solver of the heat; the other one belongs to the mechanics."""
        return self._heat.state()

    def resume(self, state: State) -> None:
        """Restore the state of the solver of the heat; collective."""
        self._heat.resume(state)

    def _pass_contact_to_heat(self) -> None:
        """Set pressures and friction heat from the current state of the mechanics."""
        u, q = self._motion.parts()
        assert q is not None
        self._exchange.to_heat(self._problem.trial(u, q), self.elapsed)

    def _holds(self) -> bool:
        """Whether the heat still balances with the contact that follows from it; collective."""
        x, f = self._heat.blocks(), self._conduction.vectors()
        self._conduction.residual(x, f)
        return self._heat.meets(self._conduction.measure(x, f))


def _after(done: NewtonResult, last: NewtonResult) -> NewtonResult:
    """Two solves as one."""
    return replace(
        last,
        iterations=done.iterations + last.iterations,
        linear_iterations=done.linear_iterations + last.linear_iterations,
    )


def _names(scene: Scene) -> dict[str, FrictionHeat]:
    """Interfaces that friction heats."""
    return {f.interface: f for f in scene.friction_heat}


def _heats(
    scene: Scene, problem: Problem, conduction: Conduction, number: Ints
) -> dict[int, PETSc.Mat]:
    """Nodal heat on each thermal body by friction power per area at the contact points [mm2]."""
    (j,) = problem.jumps
    points, space = j.points, conduction.space
    facets = contact_facets(problem.tagged, problem.bodies, space, scene.contacts, {})
    vertices, first = np.unique(facets.vertices, return_index=True)
    dof = facets.vertex_dofs.ravel()[first][np.searchsorted(vertices, points.vertex)]
    start, end = space.dofmap.index_map.local_range
    own = (dof >= start) & (dof < end)
    shares = [
        _names(scene)[c.name].slave_share if c.name in _names(scene) else 0.0
        for c in scene.contacts
    ]
    β = np.array(shares)[points.interface]
    body_of = conduction.bodies.of_region
    master = np.array([body_of[c.master[0]] for c in scene.contacts])
    slave = np.array([body_of[c.slave[0]] for c in scene.contacts])
    sides = list(zip((master, slave), interface_heat.friction_heat(1.0, β), strict=True))
    found: dict[int, PETSc.Mat] = {}
    for b in range(len(conduction.bodies.names)):
        value = sum(np.where(body[points.interface] == b, share, 0.0) for body, share in sides)
        found[b] = from_triplets(
            problem.comm,
            conduction.owned,
            len(j.mine),
            dof[own] - start,
            number[own],
            (points.weight * value)[own],
        )
    return found


def _normal(law: PointForces, normals: Floats) -> Floats:
    """Normal part of the forces of contact points (n, 3): what presses slave from master."""
    return -np.asarray(np.einsum("pk,pki->pi", law.pressures, normals))


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.einsum("pi,pi->p", a, b))


def _times(A: PETSc.Mat, values: Floats) -> Floats:
    """A matrix times own values."""
    right, left = A.createVecs()
    right.array[:] = values
    A.mult(right, left)
    return np.asarray(left.array.copy())


def _plus(A: PETSc.Mat, B: PETSc.Mat) -> PETSc.Mat:
    A.axpy(1.0, B, structure=DIFFERENT)
    return A


def _joined(A: PETSc.Mat | None, B: PETSc.Mat) -> PETSc.Mat:
    """A new matrix with the patterns of both."""
    assert A is not None
    return matrix_sum((A, B))


def _copy(new: list[list[PETSc.Mat]], kept: list[list[PETSc.Mat]]) -> None:
    """Put the values of matrices of the same pattern into those that are kept."""
    for row, places in zip(new, kept, strict=True):
        for A, place in zip(row, places, strict=True):
            if A is not place:
                A.copy(place, structure=DIFFERENT)


def _empty(comm: PETSc.Comm, height: tuple[int, int], width: tuple[int, int]) -> PETSc.Mat:
    """A matrix without entries."""
    A = PETSc.Mat().createAIJ((height, width), nnz=0, comm=comm)
    A.assemble()
    return A
