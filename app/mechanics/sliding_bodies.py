"""Bodies that slide far on deformable ones: their state, as they turn and are paired anew.

Nodes of a slave follow the master (`mechanics.followers`): in other pairs the same displacement has
other unknowns and jumps. A step begins at the committed displacements, in the pairs of now.
"""

from __future__ import annotations

from collections.abc import Mapping

from petsc4py import PETSc

import numpy as np
from dolfinx import fem

from app.foundation.arrays import Floats
from app.mechanics.body_forms import BodyForms
from app.mechanics.contact import ContactInterfaces, TrialState
from app.mechanics.followers import Followers
from app.mechanics.stiffness import Stiffness
from app.scene.scene import Scene

# Displacements of own nodes without the translations of bodies that turn, and these by motion.
Moved = tuple[Floats, dict[str, Floats]]


class SlidingBodies:
    """State of bodies that slide far on deformable ones; made collectively.

    Attributes:
        work: Work of contact at own nodes so far, that of whole bodies on rank 0 [N mm].

    Args:
        moved: Displacement of each body that jumps move.
    """

    saved = ("work",)

    def __init__(
        self,
        mechanics: BodyForms,
        stiffness: Stiffness,
        contact: ContactInterfaces,
        followers: Followers,
        moved: Mapping[int, fem.Function],
    ) -> None:
        self._mechanics, self._stiffness, self._contact = mechanics, stiffness, contact
        self._followers, self._moved = followers, moved
        self.begin(mechanics.scene)

    def begin(self, scene: Scene) -> None:
        """Begin a run at rest; collective."""
        self._followers.begin(scene)
        self._committed = self._pressed = self._followers.without_motion(self._nodal * 0.0)
        self.work = 0.0

    @property
    def _nodal(self) -> Floats:
        """Displacement of own nodes (n, 3) [mm]."""
        nodes = self._mechanics.space.dofmap.index_map.size_local
        return np.asarray(self._mechanics.u.x.array[: 3 * nodes].reshape(-1, 3))

    def _by_body(self) -> Moved:
        """Displacement of own nodes, each as its body moves, as of `Followers.without_motion`."""
        found = self._nodal.copy()
        for body, nodes in self._followers.slaves:
            found[nodes] = self._moved[body].x.array.reshape(-1, 3)[nodes]
        return self._followers.without_motion(found)

    def _contact_forces(self, trial: TrialState) -> Moved:
        """Forces on own nodes where surfaces slide far [N], and their sums on bodies that turn."""
        sliding, on_slaves = self._contact.finite_sliding, np.zeros_like(self._nodal)
        assert sliding is not None
        on_slaves[sliding.nodes] = trial.equilibrium[sliding.rows]
        forces = on_slaves - self._followers.handed(on_slaves)
        return forces, self._followers.totals(forces)

    def _express(self, moved: Moved, u: PETSc.Vec, q: PETSc.Vec) -> None:
        """Set unknowns and jumps to displacements, as turned and paired now; collective."""
        constraints, nodal = self._stiffness.constraints, self._followers.with_motion(*moved)
        constraints.contract(nodal).copy(u)
        sliding, apart = (
            self._contact.finite_sliding,
            nodal - constraints.expand(u).array.reshape(-1, 3),
        )
        assert sliding is not None
        q.array.reshape(-1, 3)[sliding.rows] = apart[sliding.nodes]

    def taken_up(self) -> Floats:
        """Pair surfaces as in the restored state; its displacement at own nodes (n, 3) [mm]."""
        jump = self._contact.committed_at
        if jump is not None:
            self._contact.pair_at(jump)
            self.follow()
        return self._nodal

    def begin_at(self, trial: TrialState) -> None:
        """Begin at a restored state with updated displacements; collective."""
        self._committed, self._pressed = self._by_body(), self._contact_forces(trial)

    def follow(self) -> None:
        """Let nodes follow the surfaces that they are paired with now; collective."""
        if not self._followers.changed:
            return
        stiffness, coupling = self._stiffness, self._contact.coupling
        stiffness.constraints.follow()
        stiffness.update(paired=True)
        coupling.update(stiffness.constraints, paired=True)
        u, q = stiffness.K.createVecRight(), coupling.D.createVecRight()
        q.array[:] = self._contact.state.jump.ravel()
        self.carry(u, q)
        self._contact.carried = q.array.reshape(-1, 3).copy()

    def carry(self, u: PETSc.Vec, q: PETSc.Vec) -> None:
        """Start from the committed displacements, whatever surfaces face each other now."""
        self._express(self._committed, u, q)

    def pair(self, trial: TrialState, u: PETSc.Vec, q: PETSc.Vec) -> bool:
        """As `ContactInterfaces.pair`; updated displacements are kept, in u and q; collective."""
        moved = self._by_body()
        if not self._contact.pair(trial):
            return False
        self.follow()
        self._express(moved, u, q)
        return True

    def commit(self, trial: TrialState) -> None:
        """Commit a converged state with updated displacements; collective."""
        (f0, F0), (u0, t0) = self._pressed, self._committed
        self.begin_at(trial)
        (f1, F1), (u1, t1) = self._pressed, self._committed
        work = float(((f0 + f1) * (u1 - u0)).sum())
        if self._mechanics.mesh.comm.rank == 0:
            work += sum(float((F0[k] + F1[k]) @ (t1[k] - t0[k])) for k in F1)
        self.work -= work / 2
