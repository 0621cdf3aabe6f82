"""Surfaces that slide far: what they overlap at first, and where they leave what they slide on."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from app.arrays import Bools, Floats
from app.errors import InputError
from app.mechanics.contact import TrialState
from app.mechanics.followers import Side
from app.mechanics.pairs import SmoothSurface
from app.mechanics.problem import Problem
from app.scene.scene import Interface
from app.system.layout import point_text
from meshes.contact_facets import gather

# A point is beyond the rim of a surface by more than this part of an edge.
OFF = 0.25


class Cover:
    """Surfaces that others slide on far, as they are meshed; made collectively.

    Raises:
        InputError: Bodies overlap by more than a facet.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem, self._masters = problem, dict[int, SmoothSurface]()
        for i, c in enumerate(problem.scene.contacts):
            if c.between:
                side = Side.of(problem.tagged, problem.space, c.between[0])
                self._masters[i] = side.smooth()
        for c, here, beyond, apart, facet in self._points():
            depth, where = self._largest(here, np.where(beyond > 0, 0.0, -apart))
            if depth > facet:
                raise InputError(
                    f"interfaces.{c.name}: its bodies overlap by {depth:.3g} mm at {where}, more "
                    f"than a facet ({facet:.3g} mm); expected bodies that touch or are apart, and "
                    "`gap` for an interference"
                )

    def left(self, trial: TrialState) -> str:
        """Sentence on contact beyond the rim of a surface, and what to change; collective."""
        for c, here, beyond, *_ in self._points(trial.jump):
            pressed = trial.law.pressures[here, 0] > 0
            furthest, where = self._largest(here, np.where(pressed, beyond, 0.0))
            if furthest > 0:
                master, slave = c.between or ("", "")
                return (
                    f"on interface '{c.name}' the point {where} of '{slave}' has left '{master}' "
                    f"and presses on nothing, {furthest:.3g} mm beyond its rim\n  what to change: "
                    f"a larger '{master}', a smaller '{slave}', or a shorter way"
                )
        return ""

    def _points(
        self, jump: Floats | float = 0.0
    ) -> Iterator[tuple[Interface, Bools, Floats, Floats, float]]:
        """Interfaces at jumps of all own points (n, 3) [mm].

        With their points (n,), how far each (m,) is beyond the rim, 0 if it is not, and from the
        surface, and the size of a facet [mm].
        """
        contact, scene = self._problem.contact, self._problem.scene
        for i, surface in self._masters.items():
            assert contact is not None and contact.large is not None
            here, c, facet = contact.own.interface == i, scene.contacts[i], contact.edge_lengths[i]
            motion = scene.motion_of(c.master)
            about = np.array(motion.about if motion else np.zeros(3))
            R = contact.large.rotation[here[contact.large.rows]]
            x = about + np.einsum("pji,pj->pi", R, (contact.own.x + jump - about)[here])
            on, at, apart = surface.closest(x)
            away = x - np.einsum("pk,pki->pi", at, surface.x[surface.triangles[on]])
            beside = np.linalg.norm(np.cross(away, surface.normal(on, at)), axis=1)
            yield c, here, np.where(beside > OFF * facet, beside, 0.0), apart, facet

    def _largest(self, here: Bools, values: Floats) -> tuple[float, str]:
        """The largest of values at some own points, and its place; collective."""
        assert self._problem.contact is not None
        every, x = gather(self._problem.comm, values, self._problem.contact.own.x[here])
        return float(every.max()), point_text(x[int(np.argmax(every))])
