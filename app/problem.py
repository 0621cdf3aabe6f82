"""The discrete problem of a scene: residual and Jacobian of the coupled min-max problem.

Unknowns are blocks: the continuous displacement, and the jumps where the scene has contact. The
displacement block is assembled once; see `app.jumps` for the equations of the jump block.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import default_scalar_type, fem
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from app.bodies import bodies_of, boundary_facets, cell_tags
from app.jumps import Jumps
from app.mechanics import Mechanics
from app.points import PointForces
from app.terms import Scene, amplitude
from app.timing import Timing
from meshes.distribute import TaggedMesh

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Trial:
    """The jump block at a trial state: equilibrium (n, 3) [N], jumps (n, 3) [mm], the law."""

    equilibrium: Floats
    jump: Floats
    law: PointForces


class Problem:
    """Operators and state of a scene.

    Attributes:
        jumps: The jump block, or an empty tuple.
        u: Displacement, the continuous field.
        time: Current time: stage k runs from k to k + 1.
    """

    def __init__(self, scene: Scene, tagged: TaggedMesh, augmentation_factor: float, timing: Timing) -> None:
        """Assemble everything that does not change; collective.

        Raises:
            InputError: The scene does not fit the mesh.
        """
        self.scene, self.tagged = scene, tagged
        self.comm = tagged.mesh.comm
        self.bodies = bodies_of(tagged, scene.contacts)
        self.mechanics = Mechanics(scene, tagged, self.bodies, timing)
        self.space = self.mechanics.space
        self.u = self.mechanics.u
        index_map = self.space.dofmap.index_map
        self._owned = 3 * index_map.size_local
        self.support_of = self._support_of_dofs()
        self._bcs = self._dirichlet()
        self.K = self.mechanics.stiffness(self._bcs)
        self.K.setBlockSize(3)
        self.K.setNearNullSpace(self._rigid_modes())
        self.jumps: tuple[Jumps, ...] = (
            (Jumps(scene, tagged, self.bodies, self.mechanics, augmentation_factor, timing),)
            if scene.contacts
            else ()
        )
        self.moved = {
            b: fem.Function(self.space, name=f"displacement {self.bodies.names[b]}")
            for j in self.jumps
            for b in j.moves
        }
        self._assemble_loads()
        self.set_time(0.0)

    # Construction

    def _support_of_dofs(self) -> NDArray[np.int64]:
        """Support that holds each local dof, -1 where none does (3 dofs per node).

        Where supports on several bodies hold a node, the body of lowest number wins: it is the
        base of that node (see `meshes.interfaces`).
        """
        index_map = self.space.dofmap.index_map
        support = np.full(3 * (index_map.size_local + index_map.num_ghosts), -1, dtype=np.int64)
        tags = cell_tags(self.tagged)
        for body in reversed(range(len(self.bodies.names))):
            for s, term in enumerate(self.scene.supports):
                f = boundary_facets(self.tagged, term.boundary)
                mine = f.facets[self.bodies.of_tag[tags[f.cells]] == body]
                nodes = fem.locate_dofs_topological(self.space, 2, mine.astype(np.int32))
                for c in np.flatnonzero(term.components):
                    support[3 * nodes + c] = s
        return support

    def _dirichlet(self) -> list[fem.DirichletBC]:
        held = self.support_of >= 0
        bcs = []
        for c in range(3):
            nodes = np.flatnonzero(held[c::3])
            dofs = (3 * nodes + c).astype(np.int32)
            bcs.append(fem.dirichletbc(default_scalar_type(0), dofs, self.space.sub(c)))
        return bcs

    def _rigid_modes(self) -> PETSc.NullSpace:
        """The six rigid modes, orthonormal, for algebraic multigrid."""
        modes = []
        x = self.space.tabulate_dof_coordinates()[: self._owned // 3]
        for k in range(6):
            mode = self.K.createVecLeft()
            values = mode.array.reshape(-1, 3)
            axis = np.eye(3)[k % 3]
            values[:] = axis if k < 3 else np.cross(axis, x)
            modes.append(mode)
        for i, mode in enumerate(modes):
            for other in modes[:i]:
                mode.axpy(-mode.dot(other), other)
            mode.normalize()
        return PETSc.NullSpace().create(vectors=modes, comm=self.comm)

    def _assemble_loads(self) -> None:
        """One vector per load, eigenstrain and prescribed displacement, at full amplitude."""
        mechanics, v = self.mechanics, ufl.TestFunction(self.space)
        dx = mechanics.cells()
        n_q = [j.C.getLocalSize()[1] for j in self.jumps]
        self._unit_u: list[tuple[tuple[float, ...], PETSc.Vec]] = []
        self._unit_q: list[Floats] = []

        def add(history: tuple[float, ...], parts: dict[int, PETSc.Vec]) -> None:
            total = self.K.createVecLeft()
            jump = [np.zeros(n) for n in n_q]
            for body, part in parts.items():
                total.array[:] += part.array[: self._owned]
                for j, values in zip(self.jumps, jump, strict=True):
                    if body in j.moves:
                        moved = j.moves[body].createVecRight()
                        whole = self.K.createVecLeft()
                        whole.array[:] = part.array[: self._owned]
                        j.moves[body].multTranspose(whole, moved)
                        values += moved.array
            self._unit_u.append((history, total))
            self._unit_q.append(jump[0] if jump else np.zeros(0))

        bodies = range(len(self.bodies.names))
        for load in self.scene.loads:
            parts = {}
            for b in bodies:
                work = mechanics.load_work(load, b, v, dx)
                if work != 0:
                    parts[b] = mechanics.assemble(work)
            add(load.history, parts)
        for e in self.scene.elastic:
            for k, strain in enumerate(e.eigenstrains):
                mechanics.set_amplitudes({(e.region, k): 1.0})
                body = self.bodies.of_region[e.region]
                form = ufl.derivative(mechanics.body_energy(body, self.u, dx), self.u, v)
                part = mechanics.assemble(form)
                part.scale(-1)
                add(strain.history, {body: part})
        mechanics.set_amplitudes({})
        for s, support in enumerate(self.scene.supports):
            if not any(support.values):
                continue
            self.u.x.array[:] = self._unit_displacement(s)
            energy = sum(mechanics.body_energy(b, self.u, dx) for b in bodies)
            part = mechanics.assemble(ufl.derivative(energy, self.u, v))
            self.u.x.array[:] = 0
            lift = self.K.createVecLeft()
            lift.array[:] = -part.array[: self._owned]
            self._unit_u.append((support.history, lift))
            self._unit_q.append(np.zeros(n_q[0] if n_q else 0))

    def _unit_displacement(self, s: int) -> Floats:
        values = np.array(self.scene.supports[s].values)
        held = self.support_of == s
        return np.where(held, np.tile(values, len(held) // 3), 0.0)

    def bodies_at(self, boundary: str) -> set[int]:
        """Bodies that have facets on a boundary; collective."""
        f = boundary_facets(self.tagged, boundary)
        here = set(self.bodies.of_tag[cell_tags(self.tagged)[f.cells]].tolist())
        return set().union(*self.comm.allgather(here))

    # State in time

    def set_time(self, time: float) -> None:
        """Set loads, supports and gaps to a time; the state itself does not move."""
        self.time = time
        self.f = self.K.createVecLeft()
        self.f_q = np.zeros_like(self._unit_q[0]) if self._unit_q else np.zeros(0)
        for (history, vector), jump in zip(self._unit_u, self._unit_q, strict=True):
            a = amplitude(history, time)
            self.f.axpy(a, vector)
            self.f_q = self.f_q + a * jump
        held = self.support_of[: self._owned]
        given = np.zeros(len(held))
        for s, support in enumerate(self.scene.supports):
            a = amplitude(support.history, time)
            component = np.arange(len(held)) % 3
            given = np.where(held == s, a * np.array(support.values)[component], given)
        self._held, self._given = held >= 0, given
        for j in self.jumps:
            j.set_time(time)
            if not len(self.f_q):
                self.f_q = np.zeros(3 * len(j.mine))
        self.mechanics.set_amplitudes(
            {
                (e.region, k): amplitude(s.history, time)
                for e in self.scene.elastic
                for k, s in enumerate(e.eigenstrains)
            }
        )

    def impose(self, u: PETSc.Vec) -> None:
        """Set the supported components of a displacement to their current values."""
        u.array[self._held] = self._given[self._held]

    # Residual and Jacobian

    def trial(self, u: PETSc.Vec, q: PETSc.Vec) -> Trial:
        """The jump block at a trial state; only for scenes with contact."""
        (j,) = self.jumps
        e = j.equilibrium(u, q, self.f_q).copy()
        jump = q.array.reshape(-1, 3).copy()
        return Trial(e, jump, j.law(e, jump))

    def residual_u(self, u: PETSc.Vec, q: PETSc.Vec | None, out: PETSc.Vec) -> None:
        """K u + C q - f, zero in supported rows [N]."""
        self.K.mult(u, out)
        for j in self.jumps:
            j.C.multAdd(q, out, out)
        out.axpy(-1.0, self.f)
        out.array[self._held] = 0

    def supported_rows(self) -> NDArray[np.int32]:
        """Global rows that supports hold, of this rank."""
        start = self.K.getOwnershipRange()[0]
        return (start + np.flatnonzero(self._held)).astype(np.int32)

    def force_scale(self) -> float:
        """Size of the forces now acting: loads, and interface forces so far [N]."""
        scale = self.f.norm()
        for j in self.jumps:
            local = float(np.sum((j.weight[:, None] * j.history.force) ** 2))
            scale += float(np.sqrt(self.comm.allreduce(local, MPI.SUM)))
            scale += float(np.sqrt(self.comm.allreduce(float(np.sum(self.f_q**2)), MPI.SUM)))
        return scale

    # State

    def spread(self, u: PETSc.Vec, q: PETSc.Vec | None) -> None:
        """Put a state into the displacement functions of all bodies."""
        self.u.x.petsc_vec.array[: self._owned] = u.array
        self.u.x.scatter_forward()
        for j in self.jumps:
            extra = self.K.createVecLeft()
            for body, B in j.moves.items():
                B.mult(q, extra)
                function = self.moved[body]
                function.x.petsc_vec.array[: self._owned] = u.array + extra.array
                function.x.scatter_forward()

    def displacements(self) -> list[fem.Function]:
        """Displacement of each body, as last spread."""
        return self.mechanics.displacements(self.moved)

    @property
    def held_mask(self) -> NDArray[np.bool_]:
        """Own displacement dofs that supports hold."""
        return self._held

    def applied(self) -> tuple[Floats, Floats]:
        """Loads now acting on own displacement dofs and jumps [N]; no eigenstrains, no supports."""
        u = np.zeros(self._owned)
        q = np.zeros_like(self.f_q)
        for k in range(len(self.scene.loads)):
            history, vector = self._unit_u[k]
            a = amplitude(history, self.time)
            u += a * vector.array
            q = q + a * self._unit_q[k]
        return u, q

    def resultants(self) -> list[Floats]:
        """Resultant of each load now acting [N]."""
        sums = []
        for k in range(len(self.scene.loads)):
            history, vector = self._unit_u[k]
            local = vector.array.reshape(-1, 3).sum(axis=0) * amplitude(history, self.time)
            sums.append(self.comm.allreduce(local, MPI.SUM))
        return sums

    @property
    def augmented(self) -> bool:
        """Whether any interface has an augmentation to lower."""
        return any(c.augmented for c in self.scene.contacts)

    def scale_augmentation(self, factor: float) -> None:
        """Set the augmentation to a multiple of its default; penalties stay."""
        for j in self.jumps:
            j.scale_augmentation(factor)

    def augmentation(self) -> dict[str, float]:
        """Augmentation or penalty in force on each interface [MPa/mm]; collective."""
        values = {}
        for j in self.jumps:
            for i, c in enumerate(self.scene.contacts):
                local = float(j.stiffness[j.interface == i].max(initial=0.0))
                values[c.name] = float(self.comm.allreduce(local, MPI.MAX))
        return values

    def commit(self, trial: Trial | None) -> None:
        """Make a converged state the history."""
        for j in self.jumps:
            if trial is not None:
                j.commit(trial.equilibrium, trial.jump, trial.law)
