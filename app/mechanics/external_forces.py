"""External forces on the bodies of a scene: nodal forces, and forces on the jumps.

Loads and eigenstrains are assembled once at full amplitude; the forces of free strains (heat, cure)
are handed in as they change.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import ufl

from app.foundation.arrays import Floats
from app.laws.loads import Load
from app.laws.materials import Elastic
from app.laws.values import amplitude
from app.mechanics.body_forms import BodyForms, OnBody, assemble_form_vector
from app.mechanics.contact import ContactInterfaces
from app.scene.scene import Scene


@dataclass(frozen=True)
class Action:
    """Forces on owned nodal components (3 nodes,) and on owned jumps (3 points,) [N]."""

    nodal: Floats
    jump: Floats


class Forces:
    """Loads, eigenstrains and free strains of a scene; made collectively.

    Args:
        reuse: Forces of the same problem, whose assembled vectors are reused.
    """

    def __init__(
        self,
        scene: Scene,
        body_forms: BodyForms,
        contact: ContactInterfaces | None,
        reuse: Forces | None = None,
    ) -> None:
        self._body_forms, self._bodies, self._contact = body_forms, body_forms.bodies, contact
        self.comm, self._scene_loads = body_forms.mesh.comm, scene.loads
        actions: dict[Load, Action] = reuse._actions if reuse else {}
        self._actions: dict[Load, Action] = {
            at_full_amplitude(load): actions.get(at_full_amplitude(load))
            or self.action(nodal_forces(load, body_forms).items())
            for load in scene.loads
        }
        self._loads = [(load, self._actions[at_full_amplitude(load)]) for load in scene.loads]
        strains = [(e, k, s.history) for e in scene.elastic for k, s in enumerate(e.eigenstrains)]
        self._eigenstrains: list[tuple[tuple[float, ...] | None, Action]]
        self._eigenstrains = (
            reuse._eigenstrains
            if reuse
            else [(h, self._eigenstrain_action(e, k)) for e, k, h in strains]
        )
        self._free_strain_actions: dict[str, Action] = {}

    def _eigenstrain_action(self, e: Elastic, k: int) -> Action:
        """Nodal forces of an eigenstrain at full amplitude."""
        body_forms, v = self._body_forms, ufl.TestFunction(self._body_forms.space)
        body_forms.set_amplitudes({(e.region, k): 1.0})
        body = self._bodies.body_of_region[e.region]
        energy = body_forms.body_energy(body, body_forms.u, body_forms.cells())
        part = assemble_form_vector(body_forms.form(ufl.derivative(energy, body_forms.u, v)))
        part.scale(-1)
        return self.action([(body, part)])

    def action(self, forces_on_bodies: Iterable[tuple[int, PETSc.Vec]]) -> Action:
        """Forces on displacement and jumps, of nodal forces on bodies by number; collective."""
        total = self._sum([])
        for body, nodal_vector in forces_on_bodies:
            nodal = nodal_vector.array_r[: len(total.nodal)].copy()
            total.nodal[:] += nodal
            if self._contact and body in self._contact.coupling.jump_to_displacement:
                B = self._contact.coupling.jump_to_displacement[body]
                on_jumps = B.createVecRight()
                B.multTranspose(PETSc.Vec().createWithArray(nodal, comm=self.comm), on_jumps)
                total.jump[:] += on_jumps.array_r
        return total

    def _sum(self, acting: Iterable[tuple[float, Action]]) -> Action:
        points = len(self._contact.local) if self._contact else 0
        nodes = self._body_forms.space.dofmap.index_map.size_local
        total = Action(np.zeros(3 * nodes), np.zeros(3 * points))
        for factor, action in acting:
            total.nodal[:] += factor * action.nodal
            total.jump[:] += factor * action.jump
        return total

    def set_eigenforces(self, cause: str, forces_on_bodies: Mapping[int, PETSc.Vec]) -> None:
        """Set the forces of the free strains of one cause: nodal forces on each body [N]."""
        self._free_strain_actions[cause] = self.action(forces_on_bodies.items())

    def total_at(self, time: float) -> Action:
        """All forces at a time [N]."""
        acting = [(load.amplitude(time), a) for load, a in self._loads]
        acting += [(amplitude(h, time), a) for h, a in self._eigenstrains]
        return self._sum([*acting, *((1.0, a) for a in self._free_strain_actions.values())])

    def applied(self, time: float) -> Action:
        """Loads alone [N]."""
        return self._sum((load.amplitude(time), a) for load, a in self._loads)

    def resultants(self, time: float) -> list[Floats]:
        """Resultant of each load [N]; collective."""
        return [
            self.comm.allreduce(action.nodal.reshape(-1, 3).sum(axis=0), MPI.SUM)
            * load.amplitude(time)
            for load, action in self._loads
        ]

    def work_on_bodies(self, time: float, motions: Floats) -> Floats:
        """Work of the loads in motions (n, 3, k) of owned nodes, (bodies, k); collective."""
        work = np.zeros((len(self._bodies.names), motions.shape[2]))
        motion_rows = motions.reshape(-1, motions.shape[2])
        for load in self._scene_loads:
            for body, nodal in nodal_forces(at_full_amplitude(load), self._body_forms).items():
                work[body] += load.amplitude(time) * (
                    nodal.array_r[: len(motion_rows)] @ motion_rows
                )
        return np.asarray(self.comm.allreduce(work))

    def work_bound(self, time: float, motion: Floats) -> float:
        """Work of the loads if each acted along a motion of owned nodes [N mm]; collective.

        Nothing cancels: the rounding of the work is a part of it. The motion of each body
        (bodies, n, 3) is in mm.
        """
        work = 0.0
        for load in self._scene_loads:
            for body, nodal in nodal_forces(at_full_amplitude(load), self._body_forms).items():
                force = nodal.array_r[: motion[body].size].reshape(-1, 3)
                size = np.linalg.norm(force, axis=1) @ np.linalg.norm(motion[body], axis=1)
                work += abs(load.amplitude(time)) * size
        return float(self.comm.allreduce(work))

    def free_work(self, time: float, nodal: Floats, jump: Floats) -> float:
        """Half the works of the forces of free strains in a motion [N mm]; collective.

        Nothing cancels: the sum is that of their sizes. Displacement (3 nodes,), jumps (3 points,).
        """
        acting = [(amplitude(h, time), a) for h, a in self._eigenstrains]
        acting += [(1.0, a) for a in self._free_strain_actions.values()]
        works = [factor * (a.nodal @ nodal + a.jump @ jump) / 2 for factor, a in acting]
        return float(np.abs(self.comm.allreduce(np.array(works), MPI.SUM)).sum())


def nodal_forces(load: Load, body_forms: BodyForms) -> dict[int, PETSc.Vec]:
    """Forces of a load at full amplitude on the nodes of each body by number [N]; collective."""
    v = ufl.TestFunction(body_forms.space)
    works = {b: load.work(v, OnBody(body_forms, b)) for b in range(len(body_forms.bodies.names))}
    forms = {b: body_forms.form(w) for b, w in works.items() if w != 0}
    return {b: assemble_form_vector(form) for b, form in forms.items()}


def at_full_amplitude(load: Load) -> Load:
    """The load at full amplitude and without a name: the key of its assembled vector."""
    return load.named("", history=None)
