"""Rigid motions that nothing resists: bonds count as long as a share of them is left."""

from __future__ import annotations

import math

import pytest

from app.soundness.floating_bodies_of_state import warnings_of_floating_bodies
from tests import support

STIFFNESS = 1000.0  # MPa/mm
STRENGTH = 10.0  # MPa
ENERGY = 1.0  # N/mm
BONDED = f"""
geometry:
  kind: blocks
  blocks:
    - {{name: lower, size: [4 mm, 4 mm, 4 mm]}}
    - {{name: upper, size: [4 mm, 4 mm, 4 mm]}}
mesh: {{size: 2 mm}}
regions:
  lower: {{youngs_modulus: 200 GPa, poisson_ratio: 0}}
  upper: {{youngs_modulus: 200 GPa, poisson_ratio: 0}}
interfaces:
  lower_upper: {{kind: cohesive, friction_coefficient: 0, stiffness: {STIFFNESS} MPa/mm,
    tensile_strength: {STRENGTH} MPa, shear_strength: {STRENGTH} MPa,
    tensile_energy: {ENERGY} N/mm, shear_energy: {ENERGY} N/mm}}
supports:
  base: {{kind: fixed, boundary: bottom}}
"""


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_contact_motions_of_a_body_that_hangs_on_a_damaged_bond(friction: float) -> None:
    """A block is pulled up, and hangs on what is left of the bond while a force shears it."""
    pull, shear, area = 0.1, 10.0, 16.0  # mm, N, mm2
    solved = support.solve(
        f"{BONDED}  pull: {{kind: displacement, boundary: top, z: {pull} mm}}\n"
        f"loads:\n  shear: {{kind: force, boundary: top, force: [{shear} N, 0 N, 0 N]}}\n"
        "stages:\n  - {name: pull, increments: 4}\n",
        f"interfaces.lower_upper.friction_coefficient={friction}",
    )
    # Bilinear law in the length of the opening: equal strengths and energies in both modes.
    first, last = STRENGTH / STIFFNESS, 2 * ENERGY / STRENGTH
    length = pull
    for _ in range(50):
        traction = STRENGTH * (last - length) / (last - first)
        length = math.hypot(pull, length * shear / area / traction)
    contact = solved.problem.contact
    assert contact is not None
    force = (contact.state.force * contact.local.weight[:, None]).sum(axis=0)
    assert force == pytest.approx((shear, 0.0, area * traction * pull / length), rel=0.01, abs=1e-6)
    trial = solved.problem.trial(*solved.solver.u_and_q())
    assert not contact.unresisted_motions(trial.forces).size
    assert not warnings_of_floating_bodies(solved.problem, trial)


@pytest.mark.parametrize(
    ("law", "count"),
    [
        ("interfaces.lower_upper.unbonded=1", 3),
        ("interfaces.lower_upper={kind: contact, friction_coefficient: 0}", 3),
        ("interfaces.lower_upper.unbonded=0.5", 0),
        ("interfaces.lower_upper={kind: contact, friction_coefficient: 0.3}", 0),
    ],
)
def test_contact_motions_of_a_pressed_block(law: str, count: int) -> None:
    """It slides freely, twice in the plane and about its normal, if nothing bonds or rubs it."""
    solved = support.solve(
        f"{BONDED}loads:\n  press: {{kind: force, boundary: top, force: [0 N, 0 N, -10 N]}}\n"
        "stages:\n  - {name: press}\n",
        law,
    )
    contact = solved.problem.contact
    assert contact is not None
    trial = solved.problem.trial(*solved.solver.u_and_q())
    assert contact.unresisted_motions(trial.forces).shape[1] == count
    assert trial.forces.pressures.max() == pytest.approx(10.0 / 16.0, rel=0.01)
