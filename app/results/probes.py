"""Displacements at named points."""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

from app.arrays import Floats, Ints
from app.heat.nodes import ProbedPoint, locate
from app.mechanics.problem import Problem


class DisplacementProbes:
    """Displacements of a problem at points, by the shape functions of the cells that hold them.

    Raises:
        InputError: A point is not in its region.
    """

    def __init__(self, problem: Problem, probes: Sequence[ProbedPoint]) -> None:
        self._problem = problem
        self._names = tuple(p.name for p in probes)
        self._mine: list[tuple[int, int, Ints, Floats]] = []
        space = problem.space
        for k, probe in enumerate(probes):
            if (found := locate(problem.tagged, probe)) is not None:
                cell, region, share = found
                table = space.element.basix_element.tabulate(0, share[None, 1:])
                shape = table.reshape(-1)[: len(space.dofmap.list[cell])]
                dofs = space.dofmap.list[cell].astype(np.int64)
                self._mine.append((k, problem.bodies.of_region[region], dofs, shape))

    def values(self) -> dict[str, list[float]]:
        """Displacement (3,) at each point [mm], as last updated; collective."""
        local = np.zeros((len(self._names), 3))
        moved = self._problem.displacements()
        for k, body, dofs, shape in self._mine:
            local[k] = shape @ moved[body].x.array.reshape(-1, 3)[dofs]
        whole = self._problem.comm.allreduce(local, MPI.SUM)
        return {name: u.tolist() for name, u in zip(self._names, whole, strict=True)}
