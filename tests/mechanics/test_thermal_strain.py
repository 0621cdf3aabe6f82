"""Thermal expansion: forces, stresses and energy of bodies with given temperatures."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest
from dolfinx import fem

from app.results.bond_forces import BondForces
from tests import support
from tests.cases.heated import BAR, CLAMPS, CYLINDERS, ORDERS, UNILATERAL, Heated, expanding


@ORDERS
def test_thermal_strain_free_expansion_has_no_stress(order: int) -> None:
    """Displacements are α ΔT x at uniform temperature, without stress."""
    bar = Heated.make(BAR, expanding(one=8e-5, two=8e-5), f"mesh.order={order}")
    bar.solve({"one": 340.0, "two": 340.0})
    x = bar.problem.space.tabulate_dof_coordinates()
    u = bar.problem.u.x.array.reshape(-1, 3)
    assert np.abs(u - 8e-5 * 40 * x).max() < 1e-10 * 8e-5 * 40 * 9
    scale = 2200 * 8e-5 * 40
    for region in ("one", "two"):
        assert np.abs(bar.stress(region)).max() < 1e-10 * scale
    assert abs(bar.problem.size_of_forces(*bar.solver.u_and_q())) > scale
    assert max(bar.balance.force, bar.balance.moment, bar.balance.energy) < 1e-10


@ORDERS
def test_thermal_strain_of_a_clamped_bar(order: int) -> None:
    """The stress along the bar is -E α ΔT for any temperatures of its parts. The energy closes."""
    E, dT = 2200.0, 40.0
    soft = "regions.two={youngs_modulus: 2200 MPa, poisson_ratio: 0.3}"
    bar = Heated.make(BAR, expanding(one=8e-5, two=8e-5), f"mesh.order={order}", CLAMPS, soft)
    bar.solve({"one": 300 + dT, "two": 300 + dT}, 0.5)
    expected = np.zeros((3, 3))
    expected[2, 2] = -E * 8e-5 * dT
    for region in ("one", "two"):
        assert np.abs(bar.stress(region) - expected).max() < 1e-10 * abs(expected[2, 2])
    # Separate temperatures, although the two regions are one body.
    bar.solve({"one": 300 + dT, "two": 300.0 - dT})
    assert max(bar.balance.force, bar.balance.moment, bar.balance.energy) < 1e-10


def test_thermal_strain_of_linear_temperature_bends_a_free_bar() -> None:
    """A strain α (T - T_ref) I is compatible if T is linear. P2 has it exactly, without stress."""
    rate = 8e-5 * 5.0
    floor = (
        f"supports.floor={{kind: displacement, boundary: bottom, z: -{rate} * (x**2 + y**2) / 2}}"
    )
    bar = Heated.make(BAR, expanding(one=8e-5, two=8e-5), "mesh.order=2", floor)
    bar.solve(dict.fromkeys(("one", "two"), lambda x: 300 + 5.0 * x[2]))
    x, y, z = bar.problem.space.tabulate_dof_coordinates().T
    exact = rate * np.column_stack([x * z, y * z, (z**2 - x**2 - y**2) / 2])
    u = bar.problem.u.x.array.reshape(-1, 3)
    assert np.abs(u - exact).max() < 1e-10 * np.abs(exact).max()
    for region in ("one", "two"):
        assert np.abs(bar.stress(region)).max() < 1e-10 * 17e3 * rate * 9
    assert bar.balance.energy < 1e-10


def test_thermal_strain_stiffness_is_the_derivative_of_forces() -> None:
    """Forces are linear in temperature.

    The matrices times T - T_ref equal the forces of set_temperature. A temperature jump that warms
    the cement alone equals that temperature of the cement alone.
    """
    cold = Heated.make(CYLINDERS, expanding(cement=80e-6, bone=1e-5), *UNILATERAL)
    problem, scalars = cold.problem, cold.problem.body_forms.scalars
    f, f_q = problem.f.copy(), problem.f_q.copy()
    free = ~problem.stiffness.constraints.constrained

    def stiffness(moves: dict[str, PETSc.Mat]) -> list[list[PETSc.Mat | None]]:
        return problem.thermal_strain.stiffness(moves, problem.stiffness, problem.contact)

    (on_u, none), (on_q, also_none) = stiffness({})
    assert none is None and also_none is None and on_u is not None and on_q is not None
    T = cold.scalar(lambda x: 300 + 7 * x[0] - 3 * x[1])
    θ = on_u.createVecRight()
    θ.array[:] = T.x.array[: len(θ.array)] - 300
    nodes = fem.locate_dofs_geometrical(
        scalars, lambda x: np.isclose(np.hypot(x[0], x[1]), 10, atol=1e-6)
    )
    n = scalars.dofmap.index_map.size_local
    B = PETSc.Mat().createAIJ((n, len(nodes)), nnz=1, comm=problem.comm)
    for k, node in enumerate(nodes):
        B.setValue(node, k, 1.0)
    B.assemble()
    τ, warm = B.createVecRight(), cold.scalar(300.0)
    τ.array[:] = np.linspace(1, 2, len(nodes))
    warm.x.array[nodes] += τ.array
    (_, by_τ), (_, q_by_τ) = stiffness({"cement": B})
    for cement, bone, u, q in (
        (T, T, on_u * θ, on_q * θ),
        (warm, cold.scalar(300.0), by_τ * τ, q_by_τ * τ),
    ):
        problem.set_temperature({"cement": cement, "bone": bone})
        changed = (problem.f - f).array * free
        assert np.linalg.norm(u.array - changed) < 1e-12 * np.linalg.norm(changed)
        assert support.difference(q.array, problem.f_q - f_q) < 1e-12


@pytest.mark.parametrize(("curved", "tolerance"), [("true", 0.01), ("false", 0.07)])
def test_thermal_strain_tractions_of_cooled_bonded_cylinders(curved: str, tolerance: float) -> None:
    """The manual gives σ_rr 5.696 and 7.884 MPa on the stem and the bone (physics.md 3.2).

    No bond bears that, and each bears an eighth of it.
    """
    strong = "{kind: bonded, strength: {tension: 1.35 MPa, shear: 2.25 MPa}}"
    laws = (f"interfaces.{name}={strong}" for name in ("stem_cement", "cement_bone"))
    cold = Heated.make(CYLINDERS, expanding(cement=80e-6), f"mesh.curved={curved}", *laws)
    forces = BondForces(cold.problem, cold.stresses, None).numbers
    for fall, fraction in ((40.0, 1.0), (5.0, 0.0)):
        cold.solve({"cement": 300.0 - fall})
        by_interface = forces()
        assert cold.balance.energy < 1e-10
        for name, full in (("stem_cement", 5.696), ("cement_bone", 7.884)):
            numbers, exact = by_interface[name], full * fall / 40
            for key in ("normal_mean", "normal_max"):
                assert numbers[key] == pytest.approx(exact, rel=0.6 * tolerance)
            assert numbers["shear_max"] < 0.1 * exact
            assert numbers["strength_fraction"] == pytest.approx(fraction)
            for key in ("failure_index_max", "failure_index_p99"):
                assert numbers[key] == pytest.approx(exact / 1.35, rel=0.6 * tolerance)
    assert by_interface["stem_cement"]["area"] == pytest.approx(np.pi * 3 * 0.5, rel=2e-2)


@pytest.mark.parametrize(
    ("pull", "shear"), [(1.3, 0.0), (1.4, 0.0), (-9.0, 2.2), (-9.0, 2.3), (1.0, 1.4), (1.0, 1.6)]
)
def test_thermal_strain_bonded_tractions_of_a_pulled_and_sheared_bar(
    pull: float, shear: float
) -> None:
    """Without heat the strain is uniform and given at the surface.

    The strengths 1.35 and 2.25 MPa form an ellipse. Held points have no traction.
    """
    E, ν = 2200.0, 0.3
    ε, γ = pull / E, shear * 2 * (1 + ν) / E
    given = f"x: {γ} * z - {ν * ε} * x, y: -{ν * ε} * y, z: {ε} * z".replace("--", "")
    faces = ("bottom", "top", "x_min", "x_max", "y_min", "y_max")
    held = [f"{f}: {{kind: displacement, boundary: {f}, {given}}}" for f in faces]
    one = f"{{youngs_modulus: {E} MPa, poisson_ratio: {ν}}}"
    changes = (f"regions={{one: {one}, two: {one}}}", f"supports={{{', '.join(held)}}}")
    bar = Heated.make(BAR, lambda scene: scene, *changes)
    bar.solve({})
    (numbers,) = BondForces(bar.problem, bar.stresses, None).numbers().values()
    assert numbers["normal_max"] == pytest.approx(max(pull, 0.0), abs=1e-8)
    assert numbers["shear_max"] == pytest.approx(shear, abs=1e-8)
    fails = (max(pull, 0.0) / 1.35) ** 2 + (shear / 2.25) ** 2 > 1
    assert (numbers["strength_fraction"] > 0) == fails


def test_thermal_strain_every_bonded_interface_is_checked() -> None:
    cold = Heated.make(CYLINDERS, expanding())
    assert [*BondForces(cold.problem, cold.stresses, None).numbers()] == [
        "stem_cement",
        "cement_bone",
    ]
    parting = Heated.make(CYLINDERS, expanding(cement=80e-6), UNILATERAL[0])
    assert [*BondForces(parting.problem, parting.stresses, None).numbers()] == ["cement_bone"]
    rigid = Heated.make(CYLINDERS, expanding(cement=80e-6), "regions.stem={rigid: true}")
    assert [*BondForces(rigid.problem, rigid.stresses, None).numbers()] == [
        "stem_cement",
        "cement_bone",
    ]
