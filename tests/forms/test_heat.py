"""Heat in a box of one cuboid: flows of conduction, exchange and heating, and steady states.

Heat flows along z in the steady states. Their temperatures are linear or quadratic in z, which
elements of second order represent exactly.
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
from forms import heat

SIZE = np.array([2.0, 3.0, 4.0])  # edges of the box [mm]
LENGTH = SIZE[2]
VOLUME = SIZE.prod()
TOP_AREA = SIZE[0] * SIZE[1]
CONDUCTIVITY = 0.5  # N/(s K)
COLD = 290.0  # temperature of the face z = 0 [K]
TOP = 1  # tag of the face z = 4 mm


class Box:
    """A box with temperatures of second order."""

    def __init__(self) -> None:
        cube = mesh.create_box(MPI.COMM_SELF, [np.zeros(3), SIZE], [1, 1, 1])
        top = mesh.locate_entities_boundary(cube, 2, lambda x: np.isclose(x[2], LENGTH))
        tags = mesh.meshtags(cube, 2, np.sort(top), np.full(len(top), TOP, dtype=np.int32))
        self.mesh = cube
        self.dx = ufl.dx(cube)
        self.top = ufl.ds(cube, subdomain_data=tags)(TOP)
        self.space = fem.functionspace(cube, ("Lagrange", 2))
        self.z = self.space.tabulate_dof_coordinates()[:, 2]

    def constant(self, value: Any) -> fem.Constant:
        return fem.Constant(self.mesh, np.asarray(value, dtype=float))

    def conducted(self, potential: Callable[[Expr], Expr], g: Floats, h: Floats) -> float:
        """Slope of the potential of conduction at gradient g, along gradient h, per volume."""
        θ = fem.Function(self.space)
        along = fem.Function(self.space)
        θ.interpolate(lambda x: g @ x)
        along.interpolate(lambda x: h @ x)
        energy = potential(ufl.grad(θ)) * self.dx
        slope = fem.form(ufl.derivative(energy, θ, along))
        return float(fem.assemble_scalar(slope)) / VOLUME

    def steady(self, potential: Callable[[Expr], Any], power: Callable[[Expr], Any]) -> Floats:
        """Temperatures of the steady state [K]: the stationary point with the cold face held.

        Args:
            potential: Of all exchange except conduction, from the temperature.
            power: Of all that heats, from the virtual temperature.
        """
        θ = fem.Function(self.space)
        v = ufl.TestFunction(self.space)
        k = self.constant(CONDUCTIVITY)
        conduction = heat.isotropic_conduction(ufl.grad(θ), k) * self.dx
        residual = ufl.derivative(conduction + potential(θ), θ, v) - power(v)
        tangent = ufl.derivative(residual, θ)
        θ.x.array[:] = COLD
        F = fem.assemble_vector(fem.form(residual)).array
        K = fem.assemble_matrix(fem.form(tangent)).to_dense()
        free = self.z > 1e-9
        θ.x.array[free] -= np.linalg.solve(K[np.ix_(free, free)], F[free])
        return θ.x.array.copy()


@pytest.fixture(scope="module")
def box() -> Box:
    return Box()


def test_heat_conduction_is_fouriers_law(box: Box) -> None:
    """The slope of the potential is k g in any direction."""
    g = np.array([3.0, -1.0, 2.0])
    k = box.constant(CONDUCTIVITY)
    for h in np.eye(3):
        flow = box.conducted(lambda grad: heat.isotropic_conduction(grad, k), g, h)
        assert flow == pytest.approx(CONDUCTIVITY * g @ h)


def test_heat_conduction_along_and_across_a_fibre(box: Box) -> None:
    """The slope is K g with K = k_t I + (k_l - k_t) m m: k_l along the fibre, k_t across it."""
    m = np.array([2.0, -1.0, 2.0]) / 3
    along, across = 0.6, 0.4
    K = across * np.eye(3) + (along - across) * np.outer(m, m)

    def potential(grad: Expr) -> Expr:
        k = box.constant(along), box.constant(across)
        return heat.fibre_conduction(grad, box.constant(m), *k)

    g = np.array([3.0, -1.0, 2.0])
    for h in np.eye(3):
        assert box.conducted(potential, g, h) == pytest.approx(h @ K @ g)
    assert box.conducted(potential, m, m) == pytest.approx(along)
    sideways = np.cross(m, [0.0, 0.0, 1.0])
    sideways /= np.linalg.norm(sideways)
    assert box.conducted(potential, sideways, sideways) == pytest.approx(across)
    assert box.conducted(potential, m, sideways) == pytest.approx(0, abs=1e-14)


def nothing(box: Box) -> Callable[[Expr], Any]:
    """No exchange: a potential of zero."""
    return lambda θ: heat.exchange(θ, box.constant(0.0), box.constant(COLD)) * box.top


def test_heat_flux_gives_linear_temperature(box: Box) -> None:
    """A flux q into the top flows to the cold face: T = T_0 + q z / k."""
    q = 0.8
    T = box.steady(nothing(box), lambda v: heat.heating_power(box.constant(q), v) * box.top)
    assert T == pytest.approx(COLD + q * box.z / CONDUCTIVITY, abs=1e-10)


def test_heat_source_gives_quadratic_temperature(box: Box) -> None:
    """A source Q per volume below an insulated top gives T = T_0 + Q z (L - z/2) / k."""
    Q = 0.3
    T = box.steady(nothing(box), lambda v: heat.heating_power(box.constant(Q), v) * box.dx)
    expected = COLD + Q * box.z * (LENGTH - box.z / 2) / CONDUCTIVITY
    assert T == pytest.approx(expected, abs=1e-10)


def test_heat_convection_is_a_resistance_in_series(box: Box) -> None:
    """Heat flows from the surroundings through 1/a and L/k to the cold face."""
    a, ambient = 0.2, 320.0
    flux = (ambient - COLD) / (1 / a + LENGTH / CONDUCTIVITY)

    def convection(θ: Expr) -> Any:
        return heat.exchange(θ, box.constant(a), box.constant(ambient)) * box.top

    T = box.steady(convection, lambda v: heat.heating_power(box.constant(0.0), v) * box.top)
    assert T == pytest.approx(COLD + flux * box.z / CONDUCTIVITY, abs=1e-10)


def test_heat_perfusion_leads_to_blood_temperature(box: Box) -> None:
    """A power of a (T - T_b) per volume leaves.

    A box of uniform temperature loses a (T - T_b) V.
    """
    a, blood = 0.01, 310.0
    θ = fem.Function(box.space)
    θ.x.array[:] = 316.0
    energy = heat.exchange(θ, box.constant(a), box.constant(blood)) * box.dx
    all_over = fem.Function(box.space)
    all_over.x.array[:] = 1.0
    leaves = fem.assemble_scalar(fem.form(ufl.derivative(energy, θ, all_over)))
    assert leaves == pytest.approx(a * 6.0 * VOLUME)


def test_heat_perfusion_of_a_fin(box: Box) -> None:
    """T'' = a (T - T_b) / k with an insulated top has a cosh as solution.

    One element has its error.
    """
    a, blood = 0.002, 310.0
    m = np.sqrt(a / CONDUCTIVITY)

    def perfusion(θ: Expr) -> Any:
        return heat.exchange(θ, box.constant(a), box.constant(blood)) * box.dx

    T = box.steady(perfusion, lambda v: heat.heating_power(box.constant(0.0), v) * box.dx)
    exact = blood + (COLD - blood) * np.cosh(m * (LENGTH - box.z)) / np.cosh(m * LENGTH)
    assert T == pytest.approx(exact, abs=1e-4 * (blood - COLD))
