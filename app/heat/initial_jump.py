r"""The first instants of regions of different temperature in perfect contact.

Their interface immediately takes the mean of both temperatures, weighted by the effusivities
:math:`e = \sqrt{k c}` (two half-spaces, Carslaw & Jaeger, section 2.15). Nodes there begin at the
mean by capacity instead, which conserves heat, and approach that temperature within some ratios of
the capacity and conduction of a node. Until then their temperature is an artefact of the mesh, and
that of half-spaces is reported.
"""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np
from dolfinx import fem

from app.heat.operators import HeatOperators

# Ratios of capacity and conduction until a node is close. Measured, as parts of the difference of
# the temperatures: 1.1 % after 3, 0.4 % after 6, 0.1 % after 10, for any size of the cells.
TIMES = 10.0


class InitialJump:
    """Nodes at which regions of different initial temperature meet."""

    def __init__(self, operators: HeatOperators) -> None:
        forms, principle = operators.forms, operators.principle
        effusivity, sums = forms.zeros(), forms.zeros()
        low, high = forms.zeros() + np.inf, forms.zeros() - np.inf
        for c in operators.scene.conductors:
            at = operators.bodies.of_region[c.region], forms.volumes(c.region) > 0
            effusivity[at] += c.effusivity
            sums[at] += c.effusivity * c.initial_temperature
            low[at] = np.minimum(low[at], c.initial_temperature)
            high[at] = np.maximum(high[at], c.initial_temperature)
        meet = (low < high) & (operators.fixed.of_body < 0)
        diagonal = np.array([k.getDiagonal().array for k in principle.matrices])
        self._contact = np.divide(sums, effusivity, out=forms.zeros(), where=meet)
        # Zero at all other nodes.
        self._until = np.divide(TIMES * operators.capacity, diagonal, out=forms.zeros(), where=meet)
        self._last = forms.comm.allreduce(float(self._until.max(initial=0.0)), MPI.MAX)

    def put(self, temperatures: Sequence[fem.Function], seconds: float) -> None:
        """Set the reported values in the temperatures of the bodies at a time; collective."""
        if seconds >= self._last:
            return
        for T, contact, until in zip(temperatures, self._contact, self._until, strict=True):
            now = np.flatnonzero(seconds < until)
            T.x.array[now] = contact[now]
            T.x.scatter_forward()
