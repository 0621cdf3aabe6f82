"""External forces on the bodies of a scene: nodal forces, and forces on the jumps.

Loads and eigenstrains are assembled once at full amplitude; the forces of free strains (heat, cure)
are handed in as they change.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import ufl

from app.arrays import Floats
from app.laws.loads import Load
from app.laws.materials import Elastic
from app.laws.values import amplitude
from app.mechanics.body_forms import BodyForms, OnBody
from app.mechanics.contact import ContactInterfaces
from app.scene.bodies import Bodies
from app.scene.scene import Scene


@dataclass(frozen=True)
class Action:
    """Forces: on own nodes and on own jumps [N]."""

    nodal: PETSc.Vec
    jump: Floats


class Forces:
    """Loads, eigenstrains and free strains of a scene; made collectively.

    Args:
        known: Forces of the same problem, whose assembled vectors are reused.
    """

    def __init__(
        self,
        scene: Scene,
        mechanics: BodyForms,
        bodies: Bodies,
        contact: ContactInterfaces | None,
        known: Forces | None = None,
    ) -> None:
        self._mechanics, self._bodies, self._contact = mechanics, bodies, contact
        self.comm = mechanics.mesh.comm
        self._owned = 3 * mechanics.space.dofmap.index_map.size_local
        found: dict[Load, Action] = {} if known is None else known._full
        self._full: dict[Load, Action] = {
            _at_full(s): found.get(_at_full(s)) or self._load(s) for s in scene.loads
        }
        self._loads = [(load.history, self._full[_at_full(load)]) for load in scene.loads]
        self._eigenstrains: list[tuple[tuple[float, ...] | None, Action]] = (
            known._eigenstrains
            if known is not None
            else [
                (s.history, self._eigenstrain(e, k))
                for e in scene.elastic
                for k, s in enumerate(e.eigenstrains)
            ]
        )
        self._free: dict[str, Action] = {}

    def _load(self, load: Load) -> Action:
        v = ufl.TestFunction(self._mechanics.space)
        parts = {}
        for b in range(len(self._bodies.names)):
            work = load.work(v, OnBody(self._mechanics, b))
            if work != 0:
                parts[b] = self._mechanics.assemble(work)
        return self.action(parts)

    def _eigenstrain(self, e: Elastic, k: int) -> Action:
        """Nodal forces of an eigenstrain at full amplitude."""
        mechanics, v = self._mechanics, ufl.TestFunction(self._mechanics.space)
        mechanics.set_amplitudes({(e.region, k): 1.0})
        body = self._bodies.of_region[e.region]
        energy = mechanics.body_energy(body, mechanics.u, mechanics.cells())
        part = mechanics.assemble(ufl.derivative(energy, mechanics.u, v))
        part.scale(-1)
        return self.action({body: part})

    def action(self, parts: Mapping[int, PETSc.Vec]) -> Action:
        """Sum nodal forces on each body, on the displacement and on the jumps."""
        total, jump = self._nothing()
        for body, part in parts.items():
            own = total.duplicate()
            own.array[:] = part.array[: self._owned]
            total.axpy(1.0, own)
            if self._contact and body in self._contact.coupling.jump_to_displacement:
                B = self._contact.coupling.jump_to_displacement[body]
                moved = B.createVecRight()
                B.multTranspose(own, moved)
                jump += moved.array
        return Action(total, jump)

    def _nothing(self) -> tuple[PETSc.Vec, Floats]:
        nodal = PETSc.Vec().createMPI((self._owned, None), comm=self.comm)
        return nodal, np.zeros(3 * len(self._contact.own) if self._contact else 0)

    def set_eigenforces(self, cause: str, parts: Mapping[int, PETSc.Vec]) -> None:
        """Set the forces of the free strains of one cause: nodal forces on each body [N]."""
        self._free[cause] = self.action(parts)

    def at(self, time: float) -> Action:
        """All forces at a time [N]."""
        nodal, jump = self._nothing()
        acting = [(amplitude(h, time), a) for h, a in (*self._loads, *self._eigenstrains)]
        for factor, action in (*acting, *((1.0, a) for a in self._free.values())):
            nodal.axpy(factor, action.nodal)
            jump += factor * action.jump
        return Action(nodal, jump)

    def applied(self, time: float) -> tuple[Floats, Floats]:
        """Loads alone, on own nodes and jumps [N]."""
        nodal, jump = self._nothing()
        for history, action in self._loads:
            nodal.axpy(amplitude(history, time), action.nodal)
            jump += amplitude(history, time) * action.jump
        return nodal.array.copy(), jump

    def resultants(self, time: float) -> list[Floats]:
        """Resultant of each load [N]; collective."""
        return [
            self.comm.allreduce(action.nodal.array.reshape(-1, 3).sum(axis=0), MPI.SUM)
            * amplitude(history, time)
            for history, action in self._loads
        ]

    def free_work(self, nodal: PETSc.Vec) -> float:
        """Half the work of the free strains' forces in a nodal displacement [N mm]; collective."""
        return sum(float(action.nodal.dot(nodal)) / 2 for action in self._free.values())


def _at_full(load: Load) -> Load:
    """The load at full amplitude and without a name: the key of its assembled vector."""
    return load.named("", history=None)
