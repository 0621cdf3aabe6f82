r"""Contact in the heat equation: pressures, friction power, and their derivatives.

Friction heats by its dissipation (`TrialState.friction_and_slip`): the work w = F_T · s per area
since the time step began. The slip s = Δq + (F - F_T)/r excludes the stretch of penalty springs. An
implicit stage of length h that starts from the work w* has the power (w - w*)/h. The integrator
treats w as one more unknown, so that the sum over the stages is the work of the whole step.

The law of a contact point is F = P(S), S = -e/W + r (q + g), with the generalized derivative P'.
The pressure p is the sum of those of the faces: p_k = -F·m_k, with m_k the dual vectors of the
normals that are pressed. Pressures and friction work change by

.. math:: dp_k = -m_k·P' dS, \qquad dw = s·P' dS + F_T·(dq - (de/W + P' dS)/r),
          \qquad dS = -de/W + r\,dq

with e the equilibrium in the rows of the contact points. Only a share of the multiplier -e/W enters
S and s (`PointLaws.multiplier_share`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from app.foundation.arrays import Floats, Ints
from app.heat.operators import HeatOperators
from app.heat.temperature_jumps import TemperatureJumps
from app.interfaces.faces import dual_vectors
from app.mechanics.contact import ContactInterfaces, TrialState
from app.mechanics.problem import Problem
from app.mechanics.stiffness import ROUNDING_OF_STIFFNESS_ROWS
from app.numerics.sparse import from_triplets, owners
from app.scene.bodies import facets_of_interfaces
from app.scene.scene import Scene
from forms import interface_heat


class ContactHeat:
    """Input of the heat from the contact points: pressures and the power of friction.

    Attributes:
        nodal_heat: Matrices from friction power per area at the contact points to heat at the nodes
            of each thermal body (nodes x points) [mm2].
        pressure_interpolation: Matrix from the pressures of the faces of contact points to
            pressures at points of finite conductance, if there are any.
        value_interpolation: The same for values at contact points.
        is_rubbing: True for local contact points whose friction heats (n,).
        friction_work: Friction work per area since the time step began, as heat [N/mm].
        expanding_regions: Regions whose expansion follows temperature. The expansion of curing
            regions is a part of the stress history.
    """

    def __init__(self, scene: Scene, problem: Problem, operators: HeatOperators) -> None:
        self._problem, self._operators = problem, operators
        self.expanding_regions = set(problem.body_forms.free_strain)
        assert problem.contact is not None
        contact = self._contact = problem.contact
        index_map = problem.space.dofmap.index_map
        column_of_point = owners(problem.comm, index_map, contact.points.dof)[1]
        self._point_count = len(contact.local)
        self.begin(np.inf, self.zero_work())
        self.friction_work: Floats = self.zero_work()
        self.nodal_heat = _friction_heat_matrices(
            scene, problem, contact, operators, column_of_point
        )
        heated_interfaces = {f.name for f in scene.friction_heat}
        names = [c.name for c in scene.parting_interfaces]
        self.is_rubbing = np.isin(
            contact.local.interface,
            [i for i, name in enumerate(names) if name in heated_interfaces],
        )
        self.pressure_interpolation: PETSc.Mat | None = None
        self.value_interpolation: PETSc.Mat | None = None
        if operators.jumps is not None:
            self.value_interpolation, self.pressure_interpolation = _interpolations(
                scene, contact, operators.jumps, column_of_point
            )

    def to_mechanics(self, heat: Sequence[PETSc.Vec]) -> None:
        """Set the temperatures of the mechanics."""
        if self.expanding_regions:
            self._operators.temperatures(heat)
            regions = {r: self._operators.of_region(r) for r in self.expanding_regions}
            self._problem.set_temperature(regions)

    def zero_work(self) -> Floats:
        """Zero friction work per area at the start of a step (n,)."""
        return np.zeros(self._point_count)

    def begin(self, h: float, work: Floats) -> None:
        """Begin an implicit stage of a time step.

        Args:
            h: Length of the stage [s]; infinite for a steady state, in which friction has no power.
            work: Initial friction work per area (n,) [N/mm].
        """
        self._stage_length, self._initial_work = h, work

    def to_heat(self, trial: TrialState) -> None:
        """Set the pressures and the friction heat of the heat equation."""
        contact = self._contact
        self.friction_work = np.where(
            self.is_rubbing, np.einsum("pi,pi->p", *trial.friction_and_slip()), 0.0
        )
        power = np.asarray(
            (self.friction_work - self._initial_work) / self._stage_length, dtype=np.float64
        )
        jumps, friction = self._operators.jumps, self._operators.friction
        if jumps is not None and self.pressure_interpolation is not None:
            jumps.pressure = _multiply(self.pressure_interpolation, trial.forces.pressures.ravel())
        if friction is not None:
            friction.nodal = np.array([_multiply(H, power) for H in self.nodal_heat])
            for i, c in enumerate(self._problem.scene.parting_interfaces):
                if f"friction {c.name}" in friction.flows:
                    local_power = float(
                        (contact.local.weight * power)[contact.local.interface == i].sum()
                    )
                    friction.flows[f"friction {c.name}"] = self._problem.comm.allreduce(local_power)

    def report(self, seconds: float) -> None:
        """Set the reported friction heat: its mean per area over a step of given length [s]."""
        power = np.asarray(self.friction_work / seconds, dtype=np.float64)
        if self.value_interpolation is not None and self._operators.jumps is not None:
            self._operators.jumps.friction = _multiply(self.value_interpolation, power)

    def rounding(self, trial: TrialState) -> float:
        """Rounding error of the friction power by long slips [N mm/s]; collective."""
        contact, laws = self._contact, self._contact.laws
        slip = np.linalg.norm(trial.jump - contact.state.jump, axis=1)
        # Rounding of equilibrium grows with the displacements of the bodies.
        largest_stiffness = contact.coupling.D.getDiagonal().array.reshape(-1, 3).max(axis=1)
        stiffness = largest_stiffness + laws.augmentation * contact.local.weight
        force = stiffness * np.linalg.norm(trial.jump, axis=1)
        power = np.where(self.is_rubbing, force * slip, 0.0) / self._stage_length
        total = self._problem.comm.allreduce(float(np.sum(power**2)), MPI.SUM)
        return ROUNDING_OF_STIFFNESS_ROWS * float(np.finfo(float).eps) * math.sqrt(total)

    def pressure_rows(self, trial: TrialState) -> tuple[Floats, Floats]:
        """Derivatives of the pressures of owned faces: by equilibrium, by the jump (n, 3, 3)."""
        is_pressed = (trial.forces.pressures != 0)[:, :, None]
        return self._rows(-dual_vectors(is_pressed * self._contact.local.normals), trial)

    def power_rows(self, trial: TrialState) -> tuple[Floats, Floats]:
        """Derivatives of the friction power: by equilibrium, by the jump (n, 1, 3)."""
        contact = self._contact
        force, slip = trial.friction_and_slip()
        spring_slip = force / contact.laws.augmentation[:, None]
        by_equilibrium, by_jump = self._rows((slip - spring_slip)[:, None], trial)
        scale = np.where(self.is_rubbing, 1 / self._stage_length, 0.0)[:, None, None]
        multiplier_share = contact.laws.multiplier_share / contact.local.weight[:, None, None]
        by_spring_slip = np.einsum("pi,pij->pj", spring_slip, multiplier_share)
        by_equilibrium -= by_spring_slip[:, None]
        return scale * by_equilibrium, scale * (by_jump + force[:, None])

    def _rows(self, directions: Floats, trial: TrialState) -> tuple[Floats, Floats]:
        """Derivatives of the force along directions (n, k, 3): by equilibrium, by the jump."""
        by_force = directions @ trial.forces.by_multiplier
        multiplier_share = (
            self._contact.laws.multiplier_share / self._contact.local.weight[:, None, None]
        )
        return -by_force @ multiplier_share, directions @ trial.forces.by_jump


def _interpolations(
    scene: Scene, contact: ContactInterfaces, jumps: TemperatureJumps, column_of_point: Ints
) -> tuple[PETSc.Mat, PETSc.Mat]:
    """Matrices from contact points, and from their faces, to owned points of temperature jumps.

    A row is zero where an interface of finite conductance has no contact.
    """
    surface, comm, point_count = contact.points.surface, contact.comm, len(contact.local)
    names = [c.name for c in scene.parting_interfaces]
    corner_of_vertex = {
        (names[i], vertex): corner
        for corner, (i, vertex) in enumerate(zip(surface.interface, surface.vertex, strict=True))
    }
    interface_names = [scene.thermal_contacts[i].name for i in jumps.interface]
    keys = zip(interface_names, jumps.points.vertex[jumps.owned_rows], strict=True)
    corners = np.array([corner_of_vertex.get(key, -1) for key in keys], dtype=np.int64)
    rows = np.flatnonzero(corners >= 0)
    corner = corners[rows]
    row_of_face = np.repeat(rows, 3)
    face = (3 * corner[:, None] + np.arange(3)).ravel()
    by_value = rows, corner, np.ones(len(rows))
    by_face = row_of_face, face, np.ones(len(face))
    if surface.dependence is not None:
        values = surface.dependence.values[corner].tocoo()
        by_value = rows[values.row], values.col, values.data
        pressures = surface.dependence.pressures[face].tocoo()
        by_face = row_of_face[pressures.row], pressures.col, pressures.data
    row, point, value = by_value
    value_interpolation = from_triplets(
        comm, len(corners), point_count, row, column_of_point[point], value
    )
    row, face, value = by_face
    column = 3 * column_of_point[face // 3] + face % 3
    pressure_interpolation = from_triplets(comm, len(corners), 3 * point_count, row, column, value)
    return value_interpolation, pressure_interpolation


def _friction_heat_matrices(
    scene: Scene,
    problem: Problem,
    contact: ContactInterfaces,
    operators: HeatOperators,
    column_of_point: Ints,
) -> list[PETSc.Mat]:
    """Matrices from friction power per area at contact points to nodal heat by body [mm2]."""
    points, space = contact.points, operators.forms.space
    interfaces = scene.parting_interfaces
    facets = facets_of_interfaces(problem.tagged, problem.bodies, space, interfaces, {})
    vertices, first_rows = np.unique(facets.vertices, return_index=True)
    dof = facets.dofs[:, :3].ravel()[first_rows][np.searchsorted(vertices, points.vertex)]
    start, end = space.dofmap.index_map.local_range
    owned = (dof >= start) & (dof < end)
    slave_shares = {f.name: f.slave_share for f in scene.friction_heat}
    β = np.array([slave_shares.get(c.name, 0.0) for c in interfaces])[points.interface]
    body_of = operators.bodies.body_of_region
    master = np.array([body_of[c.master[0]] for c in interfaces])
    slave = np.array([body_of[c.slave[0]] for c in interfaces])
    sides = list(zip((master, slave), interface_heat.friction_heat(1.0, β), strict=True))
    sizes = problem.comm, operators.forms.owned, len(contact.local)
    heats = []
    for body_index in range(len(operators.bodies.names)):
        heat_share = sum(
            np.where(body[points.interface] == body_index, side_share, 0.0)
            for body, side_share in sides
        )
        values = (points.weight * heat_share)[owned]
        heats.append(from_triplets(*sizes, dof[owned] - start, column_of_point[owned], values))
    return heats


def _multiply(A: PETSc.Mat, values: Floats) -> Floats:
    factor_vector, product_vector = A.createVecs()
    factor_vector.array[:] = values
    A.mult(factor_vector, product_vector)
    return np.asarray(product_vector.array.copy())
