r"""Contact on curved cells: the jump turns with the surface between its nodes.

Lamé's shrink fit of a solid core in a ring (plane strain, no friction) has the same pressure
everywhere; flat facets and jumps that are linear component by component scatter it at first and
second order.
"""

from __future__ import annotations

import numpy as np
import pytest

from app import closed_forms
from tests import support

SHRINK_FIT = """
geometry:
  kind: cylinders
  stem_radius: 7 mm
  cement_thickness: 3 mm
  bone_thickness: 2 mm
  length: {length} mm
  taper: {taper} deg
  sector: quarter
mesh: {{size: {size} mm, far_size: {size} mm, order: 2, curved: true}}
regions:
  stem: {{youngs_modulus: 110 GPa, poisson_ratio: 0.3}}
  cement: {{youngs_modulus: 2200 MPa, poisson_ratio: 0.3}}
  bone: {{youngs_modulus: 2200 MPa, poisson_ratio: 0.3}}
interfaces:
  stem_cement: {{kind: contact, friction_coefficient: 0, gap: -0.01 mm}}
supports:
  symmetry_x: {{kind: roller, boundary: symmetry_x, axis: x}}
  symmetry_y: {{kind: roller, boundary: symmetry_y, axis: y}}
  bottom: {{kind: roller, boundary: bottom, axis: z}}
  top: {{kind: roller, boundary: top, axis: z}}
"""


@pytest.mark.parametrize(("size", "off", "scatter"), [(2.0, 1e-3, 0.02), (1.0, 1e-4, 0.005)])
def test_a_shrink_fit_is_even_on_a_coarse_mesh(size: float, off: float, scatter: float) -> None:
    exact = closed_forms.lame_pressure(0.01, 7, 12, (110e3, 0.3), (2200, 0.3))
    result = support.solve(SHRINK_FIT.format(size=size, length=1, taper=0), balances=True)
    s = result.last
    assert np.average(s.pressure, weights=s.weight) == pytest.approx(exact, rel=off)
    assert np.abs(s.pressure / exact - 1).max() < scatter
    assert result.interfaces["stem_cement"]["area"] == pytest.approx(7 * np.pi / 2, rel=1e-5)
    assert result.balances.max() < 1e-8


def test_a_corner_of_a_fine_surface_is_no_corner() -> None:
    """A circle of three facets is one face, where flat facets would meet at 30 degrees."""
    result = support.solve(SHRINK_FIT.format(size=6.0, length=4, taper=1), balances=True)
    (j,) = result.problem.jumps
    assert (j.faces == 1).all()
    assert result.balances.max() < 1e-8
