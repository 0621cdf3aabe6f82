"""What must not matter: the augmentation, the size of the load, the orientation of the model."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from forms.contact import OPEN, SLIP, STICK
from tests import support
from tests.support import Solved

# A tapered stem pushed in and sideways and partly back, with fixed steps.
STEM = """
geometry:
  kind: cylinders
  stem_radius: 7 mm
  cement_thickness: 4 mm
  bone_thickness: 5 mm
  length: 24 mm
  taper: 1.5 deg
mesh: {order: 1, size: 3.5 mm, far_size: 5 mm}
regions:
  stem: {youngs_modulus: 110 GPa, poisson_ratio: 0.3}
  cement: {youngs_modulus: 2200 MPa, poisson_ratio: 0.35}
  bone: {youngs_modulus: 17 GPa, poisson_ratio: 0.3}
interfaces:
  stem_cement: {kind: contact, friction_coefficient: 0.4}
  cement_bone: {kind: contact, friction_coefficient: 1.0}
supports:
  outer: {kind: fixed, boundary: bone_surface}
loads:
  push: {kind: force, boundary: stem_top, force: [0 N, 0 N, -900 N], history: [1, 0.7]}
  lateral: {kind: force, boundary: stem_top, force: [300 N, 200 N, 0 N], history: [1, -0.3]}
stages:
  - {name: load, increments: 2, adaptive: false}
  - {name: back, increments: 2, adaptive: false}
solver: {tolerance: 1.0e-12, max_iterations: 80}
"""


@pytest.fixture(scope="module")
def reference() -> Solved:
    return support.solve(STEM, balances=True)


def assert_same(one: Solved, other: Solved, tolerance: float = 1e-6) -> None:
    """Gap, slip and tractions of every point after every step, to a fraction of their maximum."""
    assert len(one.samples) == len(other.samples)
    for a, b in zip(one.samples, other.samples, strict=True):
        for i in np.unique(a.interface):
            on = a.interface == i
            pressure = float(a.pressure[on].max())
            for name in ("gap", "slip", "path", "motion", "pressure", "shear", "force"):
                x, y = getattr(a, name)[on], getattr(b, name)[on]
                scale = pressure if name == "shear" else float(np.abs(x).max())
                assert np.abs(x - y).max() < tolerance * scale, (i, name)


def test_the_case_says_something(reference: Solved) -> None:
    """Points of all kinds, or the comparisons below would be of little worth."""
    share = [
        np.mean([s.weight[s.status == k].sum() / s.weight.sum() for s in reference.samples])
        for k in (OPEN, STICK, SLIP)
    ]
    assert min(share) > 0.03, share


@pytest.mark.parametrize("factor", [1e-2, 1e-1, 10.0, 100.0])
def test_augmentation_changes_no_answer(reference: Solved, factor: float) -> None:
    """r from 1e-2 to 100 times its default; where it is too large it is lowered by itself."""
    r = reference.case.solver.augmentation_factor * factor
    other = support.solve(
        STEM, f"solver.augmentation_factor={r!r}", tagged=reference.tagged, balances=True
    )
    assert_same(reference, other)
    assert other.balances.max() < 1e-8
    # The value used is reported.
    before, after = reference.problem.augmentation(), other.problem.augmentation()
    for name, value in after.items():
        level = other.steps[-1].augmentation / reference.steps[-1].augmentation
        assert value == pytest.approx(before[name] * factor * level)


def test_given_augmentation_is_used() -> None:
    case = support.case(STEM, "interfaces.stem_cement.augmentation=37 MPa/mm")
    problem, _ = support.assemble(case)
    assert problem.augmentation()["stem_cement"] == pytest.approx(37)


def test_balances_close(reference: Solved) -> None:
    """Force, moment and energy after every step, the energy with friction there and back."""
    assert reference.balances.shape == (4, 3)
    assert reference.balances.max() < 1e-8
    for q in reference.interfaces.values():
        assert q["penetration_max"] < 1e-12
        assert q["dissipation"] > 0


@pytest.mark.parametrize("factor", [1e-3, 50.0])
def test_results_scale_with_the_load(reference: Solved, factor: float) -> None:
    """Linear bodies, no initial gap, Coulomb: everything is proportional to the load."""
    overrides = [
        f"loads.push.force=[0 N, 0 N, {-900 * factor!r} N]",
        f"loads.lateral.force=[{300 * factor!r} N, {200 * factor!r} N, 0 N]",
    ]
    other = support.solve(STEM, *overrides, tagged=reference.tagged)
    for a, b in zip(reference.samples, other.samples, strict=True):
        for name in ("gap", "slip", "pressure", "shear"):
            x, y = getattr(a, name), getattr(b, name) / factor
            assert np.abs(x - y).max() < 1e-6 * np.abs(x).max(), name
        np.testing.assert_array_equal(a.status, b.status)


def test_units_do_not_matter(reference: Solved) -> None:
    """The same case said in metres and pascals."""
    text = (
        STEM.replace("2200 MPa", "2.2e9 Pa").replace("7 mm", "0.7 cm").replace("-900 N", "-0.9 kN")
    )
    other = support.solve(text)
    assert_same(reference, other)


def test_results_turn_with_the_load() -> None:
    """A lateral force a quarter turn on turns the results; nearly, as the mesh does not."""
    text = STEM.replace("size: 3.5 mm", "size: 2.2 mm")
    x, y = (
        support.solve(text, f"loads.lateral.force={force}", "solver.tolerance=1e-10")
        for force in ("[400 N, 0 N, 0 N]", "[0 N, 400 N, 0 N]")
    )
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    for name, q in x.interfaces.items():
        other: dict[str, Any] = y.interfaces[name]
        np.testing.assert_allclose(turn @ q["force"], other["force"], atol=1e-6 * 900)
        for key in ("slip_p99", "pressure_p99"):
            assert other[key] == pytest.approx(q[key], rel=0.1), (name, key)


# Two stages on two blocks with supports, springs, eigenstrain and pressure: every kind of work.
WORK = """
geometry:
  kind: blocks
  blocks:
    - {name: lower, size: [8 mm, 6 mm, 4 mm]}
    - {name: upper, size: [8 mm, 6 mm, 4 mm]}
mesh: {size: 2 mm, far_size: 2 mm, order: ORDER}
regions:
  lower: {youngs_modulus: 1000 MPa, poisson_ratio: 0.3}
  upper:
    kind: transversely_isotropic
    axial_youngs_modulus: 700 MPa
    transverse_youngs_modulus: 400 MPa
    axial_poisson_ratio: 0.3
    transverse_poisson_ratio: 0.4
    axial_shear_modulus: 200 MPa
    fibre: [1, 0, 2]
    eigenstrains:
      - {strain: 0.001, history: [1, 0.5]}
interfaces:
  lower_upper:
    {kind: KIND, friction_coefficient: 0.3, gap: -0.002 * (1 + x / 8), gap_history: [1, 1]}
supports:
  floor: {kind: foundation, boundary: bottom, stiffness: [200 MPa/mm, 300 MPa/mm, 500 MPa/mm]}
  lid: {kind: displacement, boundary: top, x: 0.01 mm, z: -0.01 mm, history: [0.3, 1]}
  side: {kind: roller, boundary: y_min, axis: y}
loads:
  press: {kind: pressure, boundary: upper_x_max, pressure: 3 MPa, history: [0.5, 1]}
  weight: {kind: body_force, density: [0 N/mm^3, 0.02 N/mm^3, -0.05 N/mm^3]}
  pull:
    kind: force
    boundary: lower_x_min
    force: [10 N, 5 N, 2 N]
    at: [0 mm, 3 mm, 5 mm]
    history: [0, 1]
stages:
  - {name: one, increments: 2}
  - {name: two, increments: 2}
solver: {tolerance: 1.0e-12}
"""


@pytest.mark.parametrize(
    ("kind", "order"),
    [("contact", 1), ("contact", 2), ("penalty, penalty: 3000 MPa/mm", 1)],
    ids=["contact P1", "contact P2", "penalty P1"],
)
def test_balances_with_every_kind_of_load(kind: str, order: int) -> None:
    text = WORK.replace("kind: KIND", f"kind: {kind}").replace("ORDER", str(order))
    result = support.solve(text, balances=True)
    assert result.balances.max() < 1e-8, result.balances


def test_moment_of_a_force_with_its_point() -> None:
    """`at` moves the moment of a force and nothing else: the reactions at the clamp show it."""
    text = """
geometry: {kind: blocks, blocks: [{name: beam, size: [4 mm, 6 mm, 10 mm]}]}
mesh: {order: 1, size: 2 mm}
regions:
  beam: {youngs_modulus: 1000 MPa, poisson_ratio: 0.3}
supports:
  clamp: {kind: fixed, boundary: bottom}
loads:
  tip: {kind: force, boundary: top, force: [3 N, -2 N, 5 N], at: AT}
"""
    centre = np.array([2.0, 3.0, 10.0])
    for at in ([2, 3, 10], [20, -3, 14]):
        place = "[" + ", ".join(f"{v} mm" for v in at) + "]"
        problem, _ = support.assemble(support.case(text.replace("AT", place)))
        problem.set_time(1.0)
        f = problem.forces.applied(problem.time).nodal
        forces = f.reshape(-1, 3)
        x = problem.space.tabulate_dof_coordinates()[: len(forces)]
        load = np.array([3.0, -2, 5])
        np.testing.assert_allclose(forces.sum(axis=0), load, atol=1e-12)
        moment = np.cross(x - centre, forces).sum(axis=0)
        np.testing.assert_allclose(moment, np.cross(np.array(at) - centre, load), atol=1e-10)
