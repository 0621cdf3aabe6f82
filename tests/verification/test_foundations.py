"""Contact that elastic foundations alone hold."""

from __future__ import annotations

import numpy as np
import pytest

from tests import support

STACK = """
geometry:
  kind: blocks
  blocks:
    - {name: base, size: [4 mm, 4 mm, 2 mm]}
    - {name: lid, size: [4 mm, 4 mm, 2 mm]}
mesh: {order: 1, size: 1 mm, far_size: 2 mm}
regions:
  base: {youngs_modulus: 1000 MPa, poisson_ratio: 0}
  lid: {youngs_modulus: 500 MPa, poisson_ratio: 0}
interfaces:
  base_lid: {kind: contact, friction_coefficient: 0.3}
supports:
  bed: {kind: foundation, boundary: bottom, stiffness: [10 MPa/mm, 10 MPa/mm, 20 MPa/mm]}
loads:
  weight: {kind: pressure, boundary: top, pressure: 3 MPa}
"""


def test_contact_on_a_bed_of_springs() -> None:
    """The bed gives way by p/k, the blocks shorten by p h/E each, and p is what they bear."""
    solved = support.solve(STACK)
    assert solved.last.pressure == pytest.approx(3.0)
    bed, base, lid = 3 / 20, 2 * 3 / 1000, 2 * 3 / 500
    for region, at, down in (("base", 0.0, bed), ("lid", 4.0, bed + base + lid)):
        x, u = solved.displacement(region)
        level = np.isclose(x[:, 2], at)
        assert u[level] == pytest.approx(np.tile([0.0, 0.0, -down], (level.sum(), 1)), abs=1e-9)
