"""Bodies that slide along a curved surface of straight facets do not climb its facets."""

from __future__ import annotations

import numpy as np
import pytest

from tests import support

# Two rings with a press fit, the inner one pushed along the axis.
PRESS_FIT = """
geometry: {kind: cylinders, stem_radius: 8 mm, cement_thickness: 8 mm, bone_thickness: 8 mm,
           length: 12 mm, sector: quarter}
mesh: {size: 4 mm, far_size: 4 mm, order: 2, curved: false}
regions:
  stem: {youngs_modulus: 1e-3 MPa, poisson_ratio: 0}
  cement: {youngs_modulus: 100 GPa, poisson_ratio: 0.3}
  bone: {youngs_modulus: 100 GPa, poisson_ratio: 0.3}
interfaces:
  cement_bone: {kind: contact, friction_coefficient: 0.1, gap: -0.004 mm, gap_history: [1, 1]}
supports:
  x: {kind: roller, boundary: symmetry_x, axis: x}
  y: {kind: roller, boundary: symmetry_y, axis: y}
  z: {kind: roller, boundary: bone_bottom, axis: z}
  push: {kind: displacement, boundary: cement_top, z: -0.1 mm, history: [0, 1]}
stages: [{name: fit}, {name: push, increments: 2}]
"""


@pytest.mark.parametrize("order", [1, 2])
def test_pressure_of_a_press_fit_does_not_grow_as_it_slides(order: int) -> None:
    """Lame: p = δE / (b ((b² + a²)/(b² - a²) + (c² + b²)/(c² - b²))), a, b, c = 8, 16, 24 mm."""
    solved = support.solve(PRESS_FIT, f"mesh.order={order}")
    a, b, c = 8.0, 16.0, 24.0
    pressure = 0.004 * 100e3 / b / ((b**2 + a**2) / (b**2 - a**2) + (c**2 + b**2) / (c**2 - b**2))
    least, most = [], []
    for s in solved.samples[1:]:
        assert (s.pressure > 0).all()
        mean = np.average(s.pressure, weights=s.weight)
        assert mean == pytest.approx(pressure, rel=0.05 if order == 1 else 0.015)
        # The quarter is pushed by friction along the axis alone.
        area = np.pi / 2 * b * 12.0
        push = abs(s.weight @ s.force[:, 2])
        assert push == pytest.approx(0.1 * pressure * area, rel=0.06 if order == 1 else 0.02)
        least.append(s.pressure.min())
        most.append(s.pressure.max())
    # Another 50 um of slip change nothing: normals have no part along the axis.
    assert least[1] == pytest.approx(least[0], rel=0.02)
    assert most[1] == pytest.approx(most[0], rel=0.02)
