"""Bone under cement whose temperatures are functions of place and time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx import fem, mesh

from app.heat.heat_forms import HeatForms
from app.heat.nodes import ProbePoint
from app.results.thermal_record import ThermalRecord
from app.scene.bodies import Bodies
from app.system.timing import Timing
from meshes.distribute import TaggedMesh

ZERO = 273.15  # of the Celsius scale [K]

BODIES = Bodies(("bone", "cement"), {"bone": 0, "cement": 1}, np.array([-1, 0, 1]))

SIDES = {"bone_cement": (("bone",), ("cement",))}

State = Callable[[np.ndarray, float], np.ndarray]


def two_blocks(comm: MPI.Comm) -> TaggedMesh:
    """Bone under cement, each 4 x 4 x 2 mm, nodes every half millimetre."""
    box = mesh.create_box(comm, [[0, 0, 0], [4, 4, 4]], [8, 8, 8])
    marks = {"bone": lambda x: x[2] <= 2, "cement": lambda x: x[2] >= 2}
    return replace(TaggedMesh.from_markers(box, marks, {}), interfaces=SIDES)


class Play:
    """Gives temperatures in degC, functions of place (n, 3) and time, to a record."""

    def __init__(
        self, tagged: TaggedMesh, bone: State, cement: State, **probes: ProbePoint
    ) -> None:
        forms = HeatForms(tagged, BODIES, Timing())
        self.space = forms.space
        self.states = (bone, cement)
        self.functions = [fem.Function(self.space) for _ in self.states]
        self.record = ThermalRecord(tagged, forms, BODIES.body_of_region, SIDES, ("bone",), probes)
        self.record.start(self.at(0.0))

    def at(self, time: float) -> list[fem.Function]:
        x = self.space.tabulate_dof_coordinates()
        for function, state in zip(self.functions, self.states, strict=True):
            function.x.array[:] = state(x, time) + ZERO
        return self.functions

    def through(self, *times: float) -> dict[str, Any]:
        for time in times:
            self.record.update(time, self.at(time))
        return self.record.summary()


def constant(value: float) -> State:
    return lambda x, t: np.full(len(x), value)
