"""Changes of the contact that remedies of Newton's method ask for, one after another.

`numerics.remedies` makes each change by a `with` statement, which ends it. The changes at a time
are one value, `mechanics.switches.Switches`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

from mpi4py import MPI

import numpy as np

from app.foundation.arrays import Bools, Floats
from app.interfaces.corners import ContactPoints
from app.mechanics.contact_motions import ContactMotions
from app.mechanics.contact_state import LocalPoints
from app.mechanics.point_laws import PointLaws
from app.mechanics.switches import Switches


class ContactRemedies:
    """Changes of the laws at the contact points of this rank (n of them).

    Attributes:
        switches: The changes at present.
        last_trial_force: Trial forces of the last evaluation of the laws (n, 3) [MPa].

    Args:
        comm: All ranks.
        points: All contact points.
        local: The points of this rank.
        laws: Laws at the points of this rank.
        motions: Rigid motions of the bodies at the points.
        held_points: Returns masks of the points that touch or are bonded, and of those that resist
            any jump (n,).
    """

    def __init__(
        self,
        comm: MPI.Comm,
        points: ContactPoints,
        local: LocalPoints,
        laws: PointLaws,
        motions: ContactMotions,
        held_points: Callable[[], tuple[Bools, Bools]],
    ) -> None:
        self._comm, self._points, self._local = comm, points, local
        self._laws, self._motions, self._held_points = laws, motions, held_points
        self.begin()

    def begin(self) -> None:
        """Begin a run without changes."""
        self.switches = Switches.off(len(self._local))
        self.last_trial_force: Floats = np.zeros((len(self._local), 3))

    @contextmanager
    def _switched(self, switches: Switches) -> Iterator[None]:
        """Set switches, and the former ones at the end."""
        before, self.switches = self.switches, switches
        try:
            yield
        finally:
            self.switches = before

    @contextmanager
    def constraining(self) -> Iterator[bool]:
        """Constrain interfaces that have to close to hold a body; collective.

        Two kinds of interfaces are constrained: those without a touching point, and those with open
        points whose body neither supports nor touching points hold. Their sides then touch and
        stick, which moves the body into contact.

        Yields:
            True if interfaces are constrained.
        """
        stuck = self._points_to_stick()
        with self._switched(replace(self.switches, stuck=stuck)):
            yield bool(self._comm.allreduce(bool(stuck.any()), MPI.LOR))

    def _points_to_stick(self) -> Bools:
        stuck = np.zeros(len(self._local), dtype=bool)
        touching, sticking = self._held_points()
        floating: set[int] | None = None
        for i in np.unique(self._points.interface):
            at_interface = self._local.interface == i
            has_touching, has_open = (
                bool(self._comm.allreduce(int(mask[at_interface].sum()), MPI.SUM))
                for mask in (touching, ~touching)
            )
            if has_touching and not has_open:
                continue
            if has_touching:
                if floating is None:
                    floating = self._motions.numbers_of_floating_bodies(touching, sticking)
                bodies = np.unique(self._points.bodies[self._points.interface == i])
                if floating.isdisjoint(bodies.tolist()):
                    continue
            stuck |= at_interface
        return stuck

    @contextmanager
    def opening(self) -> Iterator[bool]:
        """Open all interfaces that can open; collective.

        Laws other than contact keep their forces.

        Yields:
            True if interfaces are opened.
        """
        opened = self._laws.has_contact & self._laws.can_open
        with self._switched(replace(self.switches, opened=opened)):
            yield bool(self._comm.allreduce(bool(opened.any()), MPI.LOR))

    @contextmanager
    def freezing(self) -> Iterator[bool]:
        """Freeze the internal variables; yield True if there are any."""
        has_variables = bool(self._laws.internal_variables)
        with self._switched(replace(self.switches, freezes_variables=has_variables)):
            yield has_variables

    @contextmanager
    def tresca_friction(self) -> Iterator[bool]:
        """Limit friction by pressures that are given, not by those of the state; collective.

        They begin at zero, so the first solve has no friction.

        The problem with given pressures is that of Tresca: it is convex, and has one solution.
        Friction of the debonded area of a cohesive law stays as it is.

        Yields:
            True if there is contact with friction.
        """
        has_local_friction = bool((self._laws.has_friction & self._laws.is_contact).any())
        has_friction = bool(self._comm.allreduce(has_local_friction, MPI.LOR))
        given = np.zeros((len(self._local), 3)) if has_friction else None
        with self._switched(replace(self.switches, tresca_trial_force=given)):
            yield has_friction

    def relax_tresca_friction(self, share: float) -> float:
        """Move the given trial forces by a share towards those of the last evaluation; collective.

        Returns:
            Size of the difference before the move, over the size of the last trial forces [-].

        Raises:
            ValueError: Friction is not limited by given pressures.
        """
        given, last = self.switches.tresca_trial_force, self.last_trial_force
        if given is None:
            raise ValueError("friction is not limited by given pressures")
        difference = last - given
        moved = given + share * difference
        self.switches = replace(self.switches, tresca_trial_force=moved)
        squares = np.array([(difference**2).sum(), (last**2).sum()])
        change, size = np.sqrt(self._comm.allreduce(squares, MPI.SUM))
        return float(change / size) if size else 0.0
