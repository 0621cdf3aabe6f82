"""Heat as a load of the mechanics: temperatures, degrees of cure and the free strain of cement."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from mpi4py import MPI

import numpy as np
from dolfinx import fem

from app.arrays import Floats, Ints
from app.heat.curing import FreeStrain, since_gelation
from app.heat.operators import HeatOperators
from app.mechanics.problem import Problem
from app.numerics.saved_state import node_keys
from app.scene.scene import Scene

# Rounding error of a complete fraction of a step.
SAME = 1e-9


@dataclass(frozen=True)
class ThermalState:
    """Temperatures [K], degrees of cure and free strains, by body or region, ghosts included.

    Attributes:
        temperatures: At the nodes of each thermal body [K].
        degrees: At the nodes of each curing region.
        strains: Its free strain since gelation.
    """

    temperatures: list[Floats]
    degrees: list[Floats]
    strains: list[Floats]


class ThermalLoading:
    """Thermal load of the mechanics, and the free strain accumulated so far."""

    saved = ("_strains",)

    def __init__(self, scene: Scene, operators: HeatOperators) -> None:
        assert scene.time is not None
        self._operators, self._step = operators, scene.time.mechanical_step
        n = len(operators.bodies.names)
        self._temperatures = [fem.Function(operators.forms.space) for _ in range(n)]
        self._curing = operators.cure.nodes if operators.cure else []
        self._degrees = [fem.Function(operators.forms.space) for _ in self._curing]
        self._strains = [fem.Function(operators.forms.space) for _ in self._curing]
        expansion = {x.region: x.expansion for x in scene.expansions}
        self._free = [
            FreeStrain(operators.comm, c, expansion.get(c.region, 0.0), n)
            for c, n in zip(scene.cures, (len(node.dof) for node in self._curing), strict=True)
        ]

    @cached_property
    def row_keys(self) -> Ints:
        """Keys of nodes, ghosts included."""
        return node_keys(self._operators.forms.space)

    def _put(self, function: fem.Function, own: Floats) -> None:
        """Set own values of a function and update its ghosts; collective."""
        function.x.array[: self._operators.forms.owned] = own
        function.x.scatter_forward()

    # In time

    def strain(
        self,
        before: tuple[Sequence[Floats], Sequence[Floats]],
        after: tuple[Sequence[Floats], Sequence[Floats]],
    ) -> None:
        """Add the free strain of a step; collective.

        Args:
            before: Temperatures of own nodes of each body [K], and degrees of cure of own nodes of
                each region that sets, at its start.
            after: The same at its end.
        """
        (T_old, old), (T, new) = before, after
        for k, c in enumerate(self._curing):
            self._strains[k].x.array[c.dof] += self._free[k].increment(
                old[k], T_old[c.body][c.dof], new[k], T[c.body][c.dof]
            )
            self._strains[k].x.scatter_forward()

    def at(self, T: Sequence[Floats], degrees: Sequence[Floats]) -> ThermalState:
        """Thermal state with the current free strains; collective.

        Args:
            T: Temperatures of own nodes of each body [K].
            degrees: Degrees of cure of own nodes of each curing region.
        """
        for function, values in zip(self._temperatures, T, strict=True):
            self._put(function, values)
        for function, c, values in zip(self._degrees, self._curing, degrees, strict=True):
            function.x.array[c.dof] = values
            function.x.scatter_forward()
        return ThermalState(
            *(
                [f.x.array.copy() for f in functions]
                for functions in (self._temperatures, self._degrees, self._strains)
            )
        )

    def distance(self, a: ThermalState, b: ThermalState) -> float:
        """Largest difference [K], of cure as the temperature it releases; collective."""
        sizes = [
            float(np.abs(s - t).max()) for s, t in zip(a.temperatures, b.temperatures, strict=True)
        ]
        sizes += [
            node.adiabatic_rise * float(np.abs(s - t).max())
            for node, s, t in zip(self._curing, a.degrees, b.degrees, strict=True)
        ]
        return float(self._operators.comm.allreduce(max(sizes), MPI.MAX))

    def largest_step(self, a: ThermalState, b: ThermalState) -> float:
        """Largest step of the mechanics between two states, as a part of the way; collective."""
        return 1.0 / max(math.ceil(self.distance(a, b) / self._step - SAME), 1)

    def restore(self, problem: Problem, state: ThermalState) -> None:
        """Load restored mechanics with the thermal state of their last solve; collective."""
        self.interpolate(problem, state, state, 1.0)
        if problem.setting:
            problem.setting.begin_at(problem.displacements())

    def interpolate(self, problem: Problem, a: ThermalState, b: ThermalState, s: float) -> None:
        """Load the mechanics with a state between two others: a at s = 0, b at s = 1.

        Free strain grows from gelation on, temperature and cure all the way.
        """
        strains = [f.x.array.copy() for f in self._strains]
        for functions, before, after in (
            (self._temperatures, a.temperatures, b.temperatures),
            (self._degrees, a.degrees, b.degrees),
        ):
            for function, x, y in zip(functions, before, after, strict=True):
                function.x.array[:] = (1 - s) * x + s * y
        for k, cure in enumerate(self._operators.scene.cures):
            share = since_gelation(cure.gel, a.degrees[k], b.degrees[k], s)
            self._strains[k].x.array[:] = (1 - share) * a.strains[k] + share * b.strains[k]
        of_region = self._operators.bodies.of_region
        expanding = [x.region for x in self._operators.scene.expansions]
        problem.set_temperature({r: self._temperatures[of_region[r]] for r in expanding})
        if problem.setting:
            names = [c.region for c in self._curing]
            degrees = dict(zip(names, self._degrees, strict=True))
            problem.setting.set(degrees, dict(zip(names, self._strains, strict=True)))
        # The sum of the free strain continues from the state of the heat.
        for function, values in zip(self._strains, strains, strict=True):
            function.x.array[:] = values
