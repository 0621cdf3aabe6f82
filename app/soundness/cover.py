"""Surfaces that slide far: what they overlap at first, and where they leave what they slide on."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from app.arrays import Floats, Ints
from app.errors import InputError
from app.mechanics.contact import TrialState
from app.mechanics.pairs import SmoothSurface
from app.mechanics.problem import Problem
from app.scene.bodies import boundary_facets, facet_nodes
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
        self._problem, self._masters = problem, list[tuple[int, Interface, SmoothSurface]]()
        for i, c in enumerate(problem.scene.contacts):
            if c.between:
                f = boundary_facets(problem.tagged, c.between[0])
                x, inside = facet_nodes(problem.tagged, problem.space, f)[2:]
                x, inside = gather(problem.comm, x[:, :3], inside)
                nodes, of = np.unique(x.reshape(-1, 3), axis=0, return_inverse=True)
                surface = SmoothSurface(nodes, of.reshape(-1, 3), x[:, 0] - inside)
                self._masters.append((i, c, surface))
        for c, rows, beyond, apart, edge in self._points():
            depth, where = self._largest(rows, np.where(beyond > 0, 0.0, -apart))
            if depth > edge:
                raise InputError(
                    f"interfaces.{c.name}: its bodies overlap by {depth:.3g} mm at {where}, more "
                    f"than a facet ({edge:.3g} mm); expected bodies that touch or are apart, and "
                    "`gap` for an interference"
                )

    def left(self, trial: TrialState) -> str:
        """Sentence on contact beyond the rim of a surface, and what to change; collective."""
        for c, rows, beyond, *_ in self._points(trial.jump):
            pressed = trial.law.pressures[rows, 0] > 0
            furthest, where = self._largest(rows, np.where(pressed, beyond, 0.0))
            if furthest > 0:
                master, slave = c.between or ("", "")
                return (
                    f"on interface '{c.name}' the point {where} of '{slave}' has left '{master}' "
                    f"and presses on nothing, {furthest:.3g} mm beyond its rim\n  what to change: "
                    f"a larger '{master}', a smaller '{slave}', or a shorter way"
                )
        return ""

    def _points(
        self, jump: Floats | None = None
    ) -> Iterator[tuple[Interface, Ints, Floats, Floats, float]]:
        """Own points of each interface at jumps of all own points (n, 3) [mm], none by default.

        With their rows, how far each is beyond the rim, 0 if it is not, and from the surface, and
        the size of a facet [mm].
        """
        contact, scene = self._problem.contact, self._problem.scene
        for i, c, surface in self._masters:
            assert contact is not None and contact.large is not None
            here = contact.own.interface[contact.large.rows] == i
            rows, edge = contact.large.rows[here], contact.edge_lengths[i]
            motion = scene.motion_of(c.master)
            about = np.array(motion.about if motion else np.zeros(3))
            way = contact.own.x[rows] - about + (0.0 if jump is None else jump[rows])
            x = about + np.einsum("pji,pj->pi", contact.large.rotation[here], way)
            facet, at, apart = surface.closest(x)
            away = x - np.einsum("pk,pki->pi", at, surface.x[surface.triangles[facet]])
            beside = np.linalg.norm(np.cross(away, surface.normal(facet, at)), axis=1)
            yield c, rows, np.where(beside > OFF * edge, beside, 0.0), apart, edge

    def _largest(self, rows: Ints, values: Floats) -> tuple[float, str]:
        """The largest of values at own points, and its place; collective."""
        assert self._problem.contact is not None
        x = self._problem.contact.own.x[rows]
        local = [(float(v), tuple(p)) for v, p in zip(values, x, strict=True)]
        value, place = max(v for part in self._problem.comm.allgather(local) for v in part)
        return value, point_text(place)
