"""Contact of interfaces: openings, and given pressures of friction."""

from __future__ import annotations

import numpy as np
import pytest

from app.mechanics.contact import ContactInterfaces
from tests import support

# Contact with a gap that a second stage halves.
BLOCKS = f"""{support.TWO_BLOCKS}regions:
  lower: {{youngs_modulus: 1000 MPa, poisson_ratio: 0.3}}
  upper: {{youngs_modulus: 500 MPa, poisson_ratio: 0.3}}
interfaces:
  lower_upper: {{kind: contact, friction_coefficient: 0.4, gap: 0.02 mm, gap_history: [1, 0.5]}}
supports:
  floor: {{kind: fixed, boundary: bottom}}
  lid: {{kind: fixed, boundary: top}}
stages: [{{name: first}}, {{name: second}}]
"""


def contact_of_blocks() -> ContactInterfaces:
    problem, _ = support.assemble(support.case(BLOCKS))
    assert problem.contact is not None
    return problem.contact


def test_contact_openings_are_normal_jump_and_initial_gap_of_the_time() -> None:
    """A lift of 0.03 mm opens 0.05 mm at the full gap of 0.02 mm, 0.04 mm at half of it."""
    contact = contact_of_blocks()
    normals = contact.local.normals[:, 0]
    shift = np.cross(normals, [1.0, 0.0, 0.0])
    for time, gap in ((1.0, 0.02), (1.5, 0.015), (2.0, 0.01)):
        contact.set_time(time)
        jump = 0.03 * normals + 0.7 * shift
        np.testing.assert_allclose(contact.openings(jump)[:, 0], 0.03 + gap, rtol=1e-12)
        # The gap vector contains the whole jump, not the normal part alone.
        expected = (0.03 + gap) * normals + 0.7 * shift
        np.testing.assert_allclose(contact.gap_vector(jump), expected, atol=1e-15)


def test_contact_relaxes_given_pressures_only_while_they_limit_friction() -> None:
    contact = contact_of_blocks()
    for _ in range(2):
        with pytest.raises(ValueError, match="friction is not limited by given pressures"):
            contact.relax_tresca_friction(0.5)
        assert contact.begin_tresca_friction()
        # Nothing acts yet: given and last pressures are zero.
        assert contact.relax_tresca_friction(0.5) == 0.0
        contact.end_tresca_friction()
