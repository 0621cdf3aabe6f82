"""Contact at a trial state: forces by the laws, what has slid, and the state to be committed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from app.arrays import Bools, Floats
from app.mechanics.contact_law import PointForces
from app.mechanics.contact_points import ContactState
from forms.contact import OPEN, SLIP

if TYPE_CHECKING:
    from app.mechanics.contact import ContactInterfaces

# A face is closed, to separate slip from opening, if its gap is below this fraction of the step.
CLOSED = 1e-6


@dataclass(frozen=True)
class TrialState:
    """Contact at a trial state.

    Attributes:
        equilibrium: Residual e of equilibrium at own points (n, 3) [N].
        jump: Jumps of own points (n, 3) [mm].
        law: Forces by the laws, and their derivatives.
    """

    contact: ContactInterfaces
    equilibrium: Floats
    jump: Floats
    law: PointForces

    def rubbing(self) -> tuple[Floats, Floats]:
        """Friction [MPa] and slip [mm] of a step by the laws, each (n, 3).

        Exactly zero where a point is open or sticks, whatever the solver's tolerance leaves.
        """
        c, law = self.contact, self.law
        force = law.force + np.einsum("pk,pki->pi", law.pressures, c.own.normals)
        missing = c.multiplier(self.equilibrium) - force
        slip = self.jump - c.reference + missing / c.law.stiffness[:, None]
        slides = (c.law.frictional & c.law.slides & (law.status == SLIP))[:, None]
        closed = self._closed(slip)
        force, slip = (np.where(slides, c.own.tangential(v, closed), 0.0) for v in (force, slip))
        return force, slip

    def _closed(self, step: Floats) -> Bools:
        """Faces that are closed after a step (n, 3).

        At an edge the tangential direction is along it: a point that friction on one face holds
        against another has a force across the edge too, but no slip there.
        """
        gap = np.einsum("pi,pki->pk", self.jump + self.contact.gap, self.contact.own.normals)
        nearly = gap <= CLOSED * np.linalg.norm(step, axis=1)[:, None]
        return np.asarray((self.law.pressures > 0) | nearly)

    def slip(self, friction: Floats) -> Floats:
        """Irreversible tangential motion, under friction (n, 3) [MPa]: (n, 3) [mm].

        That of contact, d_T of eq. 3 without what is elastic, is a state: it has no history. Large
        slip is the sum of the steps.
        """
        c = self.contact
        slid = self.sliding(self.jump - self._elastic(friction))
        slip = np.where(c.law.slides[:, None], slid, self.law.told["slip"])
        if c.large is not None:
            rows = c.large.rows
            slip[rows] = c.state.slip[rows] + self.sliding(self.jump - c.reference)[rows]
        return slip

    def _elastic(self, friction: Floats) -> Floats:
        return np.einsum("pij,pj->pi", self.contact.law.compliance, friction)

    def sliding(self, motion: Floats) -> Floats:
        """Tangential part of a motion where points touch, 0 where they are open (n, 3) [mm]."""
        touching = (self.contact.law.can_open & (self.law.status != OPEN))[:, None]
        along = self.contact.own.tangential(motion, self._closed(motion))
        return np.where(touching, along, 0.0)

    def committed(self) -> ContactState:
        """State of the points after a converged step: jump, tractions, path, dissipation.

        A point that ends a step in contact slides by the tangential part of the step: the motion
        for which the law computes its friction. What an open point moves is on no path.

        Dissipation is the implicit sum, new friction times the step's slip, which the incremental
        potential (eq. 55) makes non-negative at each point; the trapezoidal rule is negative when
        friction reverses. Work is trapezoidal, so that the energy balance closes.

        Contact without tension does no work in its total gap (jump and initial gap; a changing gap
        does work in the jump), so ``contact_work`` is the error of load steps in which points close
        or open. In it is the energy of a layer across, which is released when it opens.
        """
        c, law, old, weight = self.contact, self.law, self.contact.state, self.contact.own.weight
        step, opening = self.jump - c.reference, c.opening(self.jump)
        force = c.forces(self.equilibrium)
        normal = np.einsum("pk,pki->pi", law.pressures, c.own.normals)
        friction = force + normal
        told, slip = law.told, self.slip(friction)
        rubbed = np.einsum("pi,pi->p", *self.rubbing())
        dissipated = weight * (told["dissipated"] + rubbed)
        soft = np.einsum("pi,pij,pj->p", force, c.law.compliance, force) / 2
        slid = self.sliding(step - self._elastic(friction - old.friction))
        slid = np.where(c.law.slides[:, None], slid, slip - old.slip)
        pushed = np.einsum("pi,pi->p", old.force - old.friction - normal, opening - old.opening) / 2
        return ContactState(
            jump=self.jump.copy(),
            force=force,
            friction=friction,
            opening=opening,
            slip=slip,
            path=old.path + np.linalg.norm(slid, axis=1),
            stored=weight * (told["stored"] + soft),
            dissipation=old.dissipation + dissipated,
            least=np.minimum(old.least, dissipated),
            contact_work=old.contact_work + weight * pushed,
            work=old.work
            + weight * np.einsum("pi,pi->p", (force + old.force) / 2, self.jump - old.jump),
            own=law.history,
        )
