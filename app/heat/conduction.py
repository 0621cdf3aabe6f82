r"""Heat in a scene on its mesh: one implicit solve of temperature and temperature jumps.

A stage of a time step asks for the state at the end of an interval h that started at T*: with
T_b = θ + B_b τ the temperature of body b (see `heat.temperature_jumps`), the heat its nodes lack is

.. math:: r_b = M_b (T_b - T_b^*)/h + K_b T_b + R_b (T_b - T_a) - f_b

(M lumped capacity, K conduction, R exchange with surroundings at T_a, f what heats). Unknowns are
θ with the rows Σ r_b = 0 and τ with the rows Σ B_b^T r_b - W q = 0. In a steady solve 1/h is zero.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from dolfinx import fem

from app.arrays import Floats, Ints
from app.errors import InputError
from app.heat.cure_heat import CureHeat
from app.heat.evaluation import HeatEvaluation
from app.heat.heat_forms import HeatForms
from app.heat.heat_loads import FixedTemperatures, FrictionHeating, HeatLoads
from app.heat.matrices import HeatMatrices
from app.heat.maximum_principle import Bounds, Extremes, MaximumPrinciple
from app.heat.temperature_jumps import TemperatureJumps, cut_off
from app.numerics.saved_state import node_keys
from app.numerics.system import Measure
from app.scene.bodies import Bodies, bodies_of
from app.scene.scene import Scene
from app.system.timing import Timing
from meshes.distribute import TaggedMesh

# Rounding of a row in units of eps |diagonal| |temperature|: about the root of its entries.
ROUNDING = 2.0


class Conduction:
    """Operators and state of one implicit solve of heat.

    Attributes:
        space: Temperature space, piecewise linear.
        owned: Nodes of this rank.
        reference: Temperature that heat is counted from [K].
        seconds: Time at the end of the solve last begun [s].
        loads: What heats, and what exchanges heat with surroundings.
        fixed: Given temperatures.
        bodies: Thermal bodies: regions joined by all but interfaces of finite conductance.
        jumps: The temperature jumps, or an empty tuple.
        capacity: Heat capacity of own nodes in each body [N mm/K].
        matrix: Blocks of the Jacobian: one, or two by two with jumps.
        version: Counts changes of the matrices other than those from one iteration to the next.
    """

    saved = ("_data", "_monotone")

    def __init__(self, scene: Scene, tagged: TaggedMesh, timing: Timing) -> None:
        """Assemble everything that does not change; collective.

        Args:
            scene: The scene; all of its regions conduct.
            tagged: Its mesh.
            timing: Where the seconds go.

        Raises:
            InputError: The scene does not fit the mesh.
        """
        self.scene, self.tagged = scene, tagged
        self.comm: MPI.Comm = tagged.mesh.comm
        self.bodies: Bodies = bodies_of(tagged, scene.thermal_contacts, ())
        self.forms = HeatForms(tagged, self.bodies, timing)
        self.space = self.forms.space
        self.owned = self.forms.owned
        self.loads = HeatLoads(scene, self.bodies, self.forms)
        self.fixed = FixedTemperatures(scene, self.forms)
        self.jumps: tuple[TemperatureJumps, ...] = (
            (TemperatureJumps(scene, tagged, self.bodies, self.forms, self.fixed.of_body),)
            if scene.thermal_contacts
            else ()
        )
        for j in self.jumps:
            self.fixed.join(j)
        self.held = self.fixed.base >= 0
        self.capacity = self.forms.capacities(scene.conductors)
        # Heat is counted from a temperature that is near all of them: less is lost to rounding.
        self.reference = float(np.mean([c.initial_temperature for c in scene.conductors]))
        self._exchange, self._brought = self.loads.exchanges(self.reference)
        self.cures: tuple[CureHeat, ...] = (
            (CureHeat(scene, self.bodies, self.forms),) if scene.cures else ()
        )
        heated = {f"friction {f.name}": 0.0 for f in scene.friction_heat}
        self.frictions: tuple[FrictionHeating, ...] = (
            (FrictionHeating(self.forms.zeros(), heated),) if heated else ()
        )
        K = self.forms.conduction_by_body(scene.conductors)
        self._monotone = MaximumPrinciple(self.comm, K, self.capacity)
        data = [c.initial_temperature for c in scene.conductors]
        data += [e.outside for e in self.loads.exchange]
        self._data = Extremes(
            self.comm, min(data), max(data), bool(scene.cures or scene.friction_heat)
        )
        self._blocks = HeatMatrices(self._monotone.matrices, self.jumps, self.held)
        self.seconds = 0.0
        self._rate = 1.0
        self._start, self._heats = self.forms.zeros(), self.forms.zeros()
        self._given: list[Floats] = []
        self._last: tuple[HeatEvaluation, ...] = ()
        self._fill()
        self.matrix: list[list[PETSc.Mat]] = self._blocks.matrix
        self._work = [self.matrix[0][0].createVecRight(), self.matrix[0][0].createVecLeft()]
        self._θ = fem.Function(self.space, name="temperature")
        self._moved = {
            b: fem.Function(self.space, name=f"temperature {self.bodies.names[b]}")
            for j in self.jumps
            for b in j.moves
        }

    # State

    def vectors(self) -> list[PETSc.Vec]:
        """New vectors: temperature of own nodes, and with jumps those of own points."""
        return self._blocks.vectors()

    def initial(self) -> list[PETSc.Vec]:
        """The state at the start.

        Where regions share a temperature from the start, though theirs differ, it is the mean by
        capacity: no heat is lost. Given temperatures hold from the start.
        """
        heat = self.forms.zeros()
        for c in self.scene.conductors:
            above = c.initial_temperature - self.reference
            nodal = c.capacity * self.forms.volumes(c.region)
            heat[self.bodies.of_region[c.region]] += nodal * above
        T = [h / np.where(c > 0, c, 1.0) for h, c in zip(heat, self.capacity, strict=True)]
        T = [self.reference + above for above in T]
        for b, condition in self.fixed.of_body.items():
            for s, value in enumerate(self.fixed.values(0.0)):
                T[b] = np.where(condition == s, value, T[b])
        x = self.vectors()
        for j in self.jumps:
            table = np.array(T)
            x[1].array[:] = table[j.bodies[:, 1], j.dof] - table[j.bodies[:, 0], j.dof]
        added = self._added(x[1:])
        total = sum(c * (t - a) for c, t, a in zip(self.capacity, T, added, strict=True))
        x[0].array[:] = total / sum(self.capacity)
        self._set_given(0.0)
        self.impose(x)
        return x

    def _added(self, τ: Sequence[PETSc.Vec]) -> list[Floats]:
        """Temperature of own nodes of each body due to jumps [K]."""
        added = self.forms.zeros()
        for j, vector in zip(self.jumps, τ, strict=True):
            for b, B in j.moves.items():
                B.mult(vector, self._work[1])
                added[b] = self._work[1].array.copy()
        return added

    def nodal(self, x: Sequence[PETSc.Vec]) -> list[Floats]:
        """Temperature of own nodes of each body [K]; what a body has not is without meaning."""
        return [x[0].array_r + added for added in self._added(x[1:])]

    def temperatures(self, x: Sequence[PETSc.Vec]) -> list[fem.Function]:
        """Temperature of each body as a function, overwritten by the next call."""
        T = self.nodal(x)
        moved = [(f, T[b]) for b, f in self._moved.items()]
        for function, nodal in ((self._θ, x[0].array_r), *moved):
            function.x.array[: self.owned] = nodal
            function.x.scatter_forward()
        return [self._moved.get(b, self._θ) for b in range(len(T))]

    def of_region(self, region: str) -> fem.Function:
        """Temperature of a region as last spread by ``temperatures``."""
        return self._moved.get(self.bodies.of_region[region], self._θ)

    @cached_property
    def row_keys(self) -> Ints:
        """Keys of own nodes."""
        return node_keys(self.space)[: self.owned]

    def block_keys(self) -> list[Ints]:
        """Keys of temperatures, jumps and degrees of cure, as far as there are any."""
        curing = [self.row_keys[n.dof] for cure in self.cures for n in cure.nodes]
        return [self.row_keys, *(j.mine for j in self.jumps), *curing]

    def restored(self) -> None:
        """Fill the matrices with restored conduction; collective."""
        self._fill()

    # One implicit solve

    def begin(
        self, start: Sequence[Floats], degrees: Sequence[Floats], h: float, seconds: float
    ) -> bool:
        """Prepare a solve; collective.

        Args:
            start: Temperatures of own nodes, and with jumps those of own points, from which the
                interval starts [K].
            degrees: Degrees of cure from which it starts, of own nodes of each region that sets.
            h: Its length [s]; infinite for a steady state.
            seconds: Time at its end, since the start of the run.

        Returns:
            Whether the degrees are ones to start from; if not, there is nothing to solve.

        Raises:
            InputError: A steady state does not exist: nothing sets the temperature of a body.
        """
        x = self.vectors()
        for vector, values in zip(x, start, strict=True):
            vector.array[:] = values
        self._start = self.nodal(x)
        self.seconds, self._last = seconds, ()
        self._heats = self.loads.heats(seconds)
        self._set_given(seconds)
        if math.isinf(h):
            self._refuse_cut_off()
        rate = 0.0 if math.isinf(h) else 1 / h
        if rate != self._rate:
            self._rate = rate
            self._fill()
        return all([cure.begin(degrees, h, seconds) for cure in self.cures])

    def _refuse_cut_off(self) -> None:
        here = [bool((e > 0).any()) for e in self._exchange]
        for b, condition in self.fixed.of_body.items():
            here[b] = here[b] or bool((condition >= 0).any())
        reached = np.any(self.comm.allgather(here), axis=0)
        lost = cut_off(self.scene.thermal_contacts, self.jumps, list(reached))
        if lost:
            raise InputError(
                f"stages: there is no steady state: nothing sets the temperature of "
                f"'{self.bodies.names[lost[0]]}'; allowed: a given temperature, convection or "
                "perfusion on it, or an interface that conducts"
            )

    def _fill(self) -> None:
        """Set the linear part of the Jacobian."""
        self._last = ()
        added = [m * self._rate + r for m, r in zip(self.capacity, self._exchange, strict=True)]
        self._blocks.fill(self._monotone.matrices, added)

    def _set_given(self, seconds: float) -> None:
        values = self.fixed.values(seconds)
        self._given = [self.fixed.continuous(values)]
        self._given += [self.fixed.jumps(values, j) for j in self.jumps]
        self._data.see(
            *self.fixed.extremes(values),
            min(float(h.min(initial=0.0)) for h in self._heats),
            max(float(h.max(initial=0.0)) for h in self._heats),
        )

    def impose(self, x: Sequence[PETSc.Vec]) -> None:
        """Put given temperatures and jumps into a state."""
        x[0].array[self.held] = self._given[0][self.held]
        for j, τ, given in zip(self.jumps, x[1:], self._given[1:], strict=True):
            τ.array[j.held] = given[j.held]

    def at(self, x: Sequence[PETSc.Vec]) -> HeatEvaluation:
        """Evaluate a state, unless it is the one evaluated last; collective."""
        arrays = [v.array_r for v in x]
        given = [*arrays, *(j.pressure for j in self.jumps)]
        given += [nodal for f in self.frictions for nodal in f.nodal]
        for last in self._last:
            # Together, for what follows is collective: one rank may see a change, another none.
            same = all(map(np.array_equal, given, last.given))
            if self.comm.allreduce(same, MPI.LAND):
                return last
        T = self.nodal(x)
        lacking, parts = [], list[Floats]()
        above, flow = self._work
        for b, K in enumerate(self._monotone.matrices):
            above.array[:] = T[b] - self.reference
            K.mult(above, flow)
            exchanged = self._exchange[b] * above.array_r - self._brought[b]
            stored = self._rate * self.capacity[b] * (T[b] - self._start[b])
            lacking.append(flow.array_r + exchanged + stored - self._heats[b])
            parts += [exchanged, stored, self._heats[b]]
        for source in (*(c.heats(T) for c in self.cures), *(f.nodal for f in self.frictions)):
            lacking = [r - s for r, s in zip(lacking, source, strict=True)]
            parts += source
        flux = [j.flux(τ) for j, τ in zip(self.jumps, arrays[1:], strict=True)]
        found = HeatEvaluation([a.copy() for a in given], T, lacking, parts, flux)
        self._last = (found,)
        return found

    def residual(self, x: Sequence[PETSc.Vec], out: Sequence[PETSc.Vec]) -> None:
        """Heat that is lacking, zero where temperatures are given [N mm/s]."""
        here = self.at(x)
        r = here.lacking
        out[0].array[:] = np.where(self.held, 0.0, sum(r))
        for j, (q, _, _), f in zip(self.jumps, here.flux, out[1:], strict=True):
            total = -j.weight * q
            for b, B in j.moves.items():
                self._work[1].array[:] = r[b]
                moved = f.duplicate()
                B.multTranspose(self._work[1], moved)
                total += moved.array
            f.array[:] = np.where(j.held, 0.0, total)

    def jacobian(self, x: Sequence[PETSc.Vec]) -> None:
        """Set the blocks of the Jacobian to a state."""
        here = self.at(x)
        by_jump = [-j.weight * q_τ for j, (_, q_τ, _) in zip(self.jumps, here.flux, strict=True)]
        self._blocks.set(by_jump, [cure.growth(here.T) for cure in self.cures])

    @property
    def version(self) -> int:
        """Changes of the matrix that outdate its preconditioner."""
        return self._blocks.version

    def degrees(self, x: Sequence[PETSc.Vec]) -> list[Floats]:
        """Degrees of cure in a state, of own nodes of each region that sets."""
        return [d.degree for cure in self.cures for d in cure.at(self.nodal(x))]

    # Extremes

    def bounds(self, x: Sequence[PETSc.Vec]) -> Bounds:
        """Between what the temperatures of a state have to be; collective."""
        return self._data.bounds(x[0].array_r)

    def outside(self, x: Sequence[PETSc.Vec]) -> bool:
        """Whether a state leaves its bounds; collective."""
        return self._monotone.outside(self.nodal(x), self.bounds(x))

    def correct(self, x: Sequence[PETSc.Vec]) -> bool:
        """Correct conduction where a state leaves its bounds; collective.

        Returns:
            Whether that may help: the step is to be done again.
        """
        changed = self._monotone.correct(self.nodal(x), self.bounds(x))
        if changed:
            self._fill()
        return changed

    def settle(self, x: Sequence[PETSc.Vec]) -> None:
        """Take corrections back where an accepted state no longer needs them; collective."""
        if self._monotone.settle(self.nodal(x), self.bounds(x)):
            self._fill()

    # Size of a residual

    def measure(self, x: Sequence[PETSc.Vec], f: Sequence[PETSc.Vec]) -> Measure:
        """How large a residual f of a state x is; collective [N mm/s].

        Its scale is that of the heat stored, brought in and let through, not of what conduction
        alone would move: in a state that hardly changes that is large and cancels.
        """
        here = self.at(x)
        if not here.sizes:
            here.sizes.append(self._sizes(here, x))
        ((scale, rounding),) = here.sizes
        return Measure(math.sqrt(sum(v.norm() ** 2 for v in f)), scale, rounding, lasting=False)

    def _sizes(self, here: HeatEvaluation, x: Sequence[PETSc.Vec]) -> tuple[float, float]:
        """Norm of what balances in a state, and what rounding leaves of it; collective."""
        parts = [np.where(self.held, sum(here.lacking), 0.0), *here.parts]
        parts += [j.weight * q for j, (q, _, _) in zip(self.jumps, here.flux, strict=True)]
        noise = [d * v.array_r for d, v in zip(self._blocks.diagonal(), x, strict=True)]
        local = [float(a @ a) for a in (*parts, *noise)]
        norms = np.sqrt(np.array(self.comm.allreduce(np.array(local), MPI.SUM)))
        rounding = ROUNDING * float(np.finfo(float).eps) * float(norms[len(parts) :].sum())
        return float(norms[: len(parts)].sum()), rounding
