"""Initial overlap and rim coverage of surfaces with finite sliding, and tipping bodies."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from app.foundation.arrays import Floats, Ints
from app.foundation.errors import InputError
from app.foundation.layout import point_text, two_digits
from app.foundation.verdict import Verdict
from app.interfaces.interface_facets import gathered_arrays
from app.mechanics.contact import TrialState
from app.mechanics.problem import Problem
from app.numerics.rigid_motions import rigid_modes
from app.scene.bodies import cell_tags, touched_nodes
from app.scene.scene import Interface

# A point is beyond the rim of a surface if its distance exceeds this fraction of an edge.
OFF = 0.25
# Largest tilt of an elastic body without a prescribed motion [rad]. Contact forces do not rotate
# with its surface. Their error is about the load times the tilt (measured: 150 N instead of 155.5 N
# under a load of 500 N).
TIPPED = 0.01


class Cover:
    """Surfaces with finite sliding on their mesh; made collectively.

    Raises:
        InputError: Bodies overlap by more than a facet.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        scene, bodies = problem.scene, problem.bodies
        sliding_sides = [
            side for c in scene.parting_interfaces if c.between for side in (c.master, c.slave)
        ]
        free_bodies = {
            bodies.body_of_region[side[0]] for side in sliding_sides if not scene.motion_of(side)
        }
        cells = {
            body: bodies.body_of_tag[cell_tags(problem.tagged)] == body
            for body in sorted(free_bodies)
        }
        nodes = {body: touched_nodes(problem.space, marked) for body, marked in cells.items()}
        self._rotations = {
            body: self._fit(np.flatnonzero(marked)) for body, marked in nodes.items()
        }
        for c, point_rows, rim_distance, surface_distance, facet_size in self._points():
            depth, location = self._largest(
                point_rows, np.where(rim_distance > 0, 0.0, -surface_distance)
            )
            if depth > facet_size:
                message = (
                    f"its bodies overlap by {depth:.3g} mm at {location}, more than a facet "
                    f"({facet_size:.3g} mm)"
                )
                remedy = "move them apart; for an interference use `gap`"
                raise InputError(Verdict(message, f"interfaces.{c.name}", remedy))

    def _fit(self, nodes: Ints) -> tuple[Ints, Floats]:
        """Owned nodes, and the best-fit rotation by their displacement (3, 3 nodes); collective."""
        R = rigid_modes(self._problem.space.tabulate_dof_coordinates()[nodes]).reshape(-1, 6)
        return nodes, np.linalg.solve(self._problem.comm.allreduce(R.T @ R), R.T)[3:]

    def tipped(self) -> Verdict | None:
        """Return an error on an elastic body that has tipped; collective."""
        problem, u = self._problem, self._problem.displacements()
        for body, (nodes, fit) in self._rotations.items():
            rigid_motion = fit @ u[body].x.array.reshape(-1, 3)[nodes].ravel()
            angle = float(np.linalg.norm(problem.comm.allreduce(rigid_motion)))
            if angle > TIPPED:
                message = (
                    f"body '{problem.bodies.names[body]}' has tipped by"
                    f" {two_digits(np.degrees(angle))} degrees; with finite sliding its surface"
                    " does not rotate with it"
                )
                remedy = "add supports that keep it upright, or a motion of the master"
                return Verdict(message, remedy=remedy)
        return None

    def pressed_beyond_rim(self, trial: TrialState) -> Verdict | None:
        """Return an error on contact beyond the rim of a surface; collective."""
        for c, points, rim_distance, *_ in self._points(trial.jump):
            is_pressed = trial.forces.pressures[points, 0] > 0
            furthest, place = self._largest(points, np.where(is_pressed, rim_distance, 0.0))
            if furthest > 0:
                master, slave = c.between or ("", "")
                message = (
                    f"on interface '{c.name}' the point {place} of '{slave}' has slid off "
                    f"'{master}', {furthest:.3g} mm beyond its rim"
                )
                remedy = f"use a larger '{master}', a smaller '{slave}', or less sliding"
                return Verdict(message, remedy=remedy)
        return None

    def _points(
        self, jump: Floats | float = 0.0
    ) -> Iterator[tuple[Interface, Ints, Floats, Floats, float]]:
        """Yield the interfaces with finite sliding at jumps of all local points (n, 3) [mm].

        Yields:
            The interface, its points (m,), their distance beyond the rim (m,) [mm], which is 0 on
            the surface, their distance from the surface (m,) [mm], and the size of a facet [mm].
        """
        contact = self._problem.contact
        sliding = contact.finite_sliding if contact else None
        if contact is None or sliding is None:
            return
        positions = sliding.positions_on_masters(contact.local.x * 0.0 + jump)
        for i, (master, _) in sliding.followers.sides.items():
            surface = master.smooth
            edge_length = contact.edge_lengths[i]
            at_interface = sliding.interface_of_point == i
            x = positions[at_interface]
            facet, barycentric, distance = surface.closest(x)
            rim_distance = surface.distance_beyond_rim(x, facet, barycentric)
            rim_distance = np.where(rim_distance > OFF * edge_length, rim_distance, 0.0)
            yield (
                self._problem.scene.parting_interfaces[i],
                sliding.rows[at_interface],
                rim_distance,
                distance,
                edge_length,
            )

    def _largest(self, points: Ints, values: Floats) -> tuple[float, str]:
        """The largest of values at some local points, and its place; collective."""
        assert self._problem.contact is not None
        all_values, x = gathered_arrays(
            self._problem.comm, values, self._problem.contact.local.x[points]
        )
        return float(all_values.max()), point_text(x[int(np.argmax(all_values))])
