"""Loads on a box of one cuboid: resultant, moment, and work in rigid and linear motions.

A load does the work F·a + M·b in the rigid motion v = a + b × x. F is its resultant and M its
moment about the origin.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from ufl.core.expr import Expr

from app.foundation.arrays import Floats
from forms import loads

SIZE = np.array([2.0, 3.0, 4.0])  # edges of the box [mm], its corner at the origin
CENTRE = SIZE / 2
VOLUME = SIZE.prod()
TOP_AREA = SIZE[0] * SIZE[1]
TOP_CENTROID = np.array([1.0, 1.5, 4.0])
TOP = 1  # tag of the face z = 4 mm


class Box:
    """A box, its measures, and the work of loads in motions of the box."""

    def __init__(self) -> None:
        cube = mesh.create_box(MPI.COMM_SELF, [np.zeros(3), SIZE], [1, 1, 1])
        top = mesh.locate_entities_boundary(cube, 2, lambda x: np.isclose(x[2], SIZE[2]))
        tags = mesh.meshtags(cube, 2, np.sort(top), np.full(len(top), TOP, dtype=np.int32))
        self.mesh = cube
        self.x = ufl.SpatialCoordinate(cube)
        self.n = ufl.FacetNormal(cube)
        self.dx = ufl.dx(cube)
        self.surface = ufl.ds(cube)
        self.top = ufl.ds(cube, subdomain_data=tags)(TOP)

    def constant(self, value: Any) -> fem.Constant:
        return fem.Constant(self.mesh, np.asarray(value, dtype=float))

    def resultants(self, work: Callable[[Expr], Any]) -> tuple[Floats, Floats]:
        """Force [N], and moment about the origin [N mm], from the work in six rigid motions."""
        a = self.constant(np.zeros(3))
        b = self.constant(np.zeros(3))
        form = fem.form(work(a + ufl.cross(b, self.x)))
        works = []
        for motion in np.eye(6):
            a.value[:] = motion[:3]
            b.value[:] = motion[3:]
            works.append(fem.assemble_scalar(form))
        return np.array(works[:3]), np.array(works[3:])

    def integral(self, integrand: Any) -> float:
        return float(fem.assemble_scalar(fem.form(integrand)))


@pytest.fixture(scope="module")
def box() -> Box:
    return Box()


def test_loads_uniform_traction_acts_at_the_centroid(box: Box) -> None:
    t = np.array([0.5, -2.0, 3.0])
    force, moment = box.resultants(lambda v: loads.traction_work(box.constant(t), v) * box.top)
    assert force == pytest.approx(t * TOP_AREA)
    assert moment == pytest.approx(np.cross(TOP_CENTROID, t * TOP_AREA))


def test_loads_linear_traction_has_force_and_moment(box: Box) -> None:
    """F = t A and M = J ω; J of a rectangle of edges a, b: A/12 diag(b², a², a² + b²)."""
    t = np.array([0.5, -2.0, 3.0])
    ω = np.array([0.3, -0.2, 0.7])
    a, b, _ = SIZE
    J = TOP_AREA / 12 * np.diag([b**2, a**2, a**2 + b**2])

    def work(v: Expr) -> Any:
        density = loads.linear_traction_work(
            box.constant(t), box.constant(ω), box.x, box.constant(TOP_CENTROID), v
        )
        return density * box.top

    force, moment = box.resultants(work)
    assert force == pytest.approx(t * TOP_AREA)
    assert moment - np.cross(TOP_CENTROID, force) == pytest.approx(J @ ω)


def test_loads_pressure_compresses_one_face(box: Box) -> None:
    p = 1.7
    force, moment = box.resultants(
        lambda v: loads.pressure_work(box.constant(p), box.n, v) * box.top
    )
    assert force == pytest.approx([0, 0, -p * TOP_AREA])
    assert moment == pytest.approx(np.cross(TOP_CENTROID, force))


def test_loads_pressure_all_around_is_in_equilibrium(box: Box) -> None:
    """The work in v = x is -p times the growth of the volume, 3 V."""
    p = 1.7
    force, moment = box.resultants(
        lambda v: loads.pressure_work(box.constant(p), box.n, v) * box.surface
    )
    assert force == pytest.approx(np.zeros(3), abs=1e-12)
    assert moment == pytest.approx(np.zeros(3), abs=1e-12)
    expansion = loads.pressure_work(box.constant(p), box.n, box.x) * box.surface
    assert box.integral(expansion) == pytest.approx(-3 * p * VOLUME)


def test_loads_fluid_pressure_gives_buoyancy(box: Box) -> None:
    """The pressure γ (h - z) lifts by the weight of the fluid, at the centre of the box."""
    γ = 0.2
    p = γ * (10.0 - box.x[2])
    force, moment = box.resultants(lambda v: loads.pressure_work(p, box.n, v) * box.surface)
    lift = np.array([0, 0, γ * VOLUME])
    assert force == pytest.approx(lift, abs=1e-12)
    assert moment == pytest.approx(np.cross(CENTRE, lift), abs=1e-12)


def test_loads_body_force_acts_at_the_centre(box: Box) -> None:
    b = np.array([0.1, 0.2, -0.4])
    force, moment = box.resultants(lambda v: loads.body_force_work(box.constant(b), v) * box.dx)
    assert force == pytest.approx(b * VOLUME)
    assert moment == pytest.approx(np.cross(CENTRE, b * VOLUME))


def test_loads_body_force_linear_in_x(box: Box) -> None:
    """The body force c x e_z has the resultant c V a/2 and the lever 2/3 a along x."""
    c = 0.3
    b = c * box.x[0] * ufl.as_vector([0, 0, 1])
    force, moment = box.resultants(lambda v: loads.body_force_work(b, v) * box.dx)
    size = c * VOLUME * SIZE[0] / 2
    assert force == pytest.approx([0, 0, size])
    assert moment == pytest.approx([CENTRE[1] * size, -2 / 3 * SIZE[0] * size, 0])


def test_loads_foundation_energy(box: Box) -> None:
    """A translation has the energy of springs, and the force -k v A is its slope."""
    k = np.array([1.0, 20.0, 300.0])
    a = box.constant([0.1, -0.2, 0.05])
    energy = fem.form(loads.foundation_energy(box.constant(k), a) * box.top)
    assert fem.assemble_scalar(energy) == pytest.approx((k * a.value**2).sum() / 2 * TOP_AREA)
    before = fem.assemble_scalar(energy)
    for axis in range(3):
        a.value[axis] += 1e-3
        mean = a.value[axis] - 0.5e-3
        slope = (fem.assemble_scalar(energy) - before) / 1e-3
        assert slope == pytest.approx(k[axis] * mean * TOP_AREA)
        a.value[axis] -= 1e-3


def test_loads_stress_does_no_work_in_a_rigid_motion(box: Box) -> None:
    """The work is zero in rotations too, because σ : ε has the symmetric gradient alone."""
    σ = np.array([[1.0, 2.0, 3.0], [2.0, -4.0, 5.0], [3.0, 5.0, 6.0]])
    force, moment = box.resultants(
        lambda v: loads.mechanical_work(box.constant(σ), ufl.grad(v)) * box.dx
    )
    assert force == pytest.approx(np.zeros(3), abs=1e-12)
    assert moment == pytest.approx(np.zeros(3), abs=1e-12)
    ε = np.array([[0.1, 0.0, 0.2], [0.0, 0.3, 0.0], [0.2, 0.0, -0.1]])
    work = loads.mechanical_work(box.constant(σ), box.constant(ε)) * box.dx
    assert box.integral(work) == pytest.approx((σ * ε).sum() * VOLUME)
