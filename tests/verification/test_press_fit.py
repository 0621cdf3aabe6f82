r"""Lamé's shrink fit: a solid core in a hollow cylinder that is too small for it by δ.

Plane strain (rollers on both ends), no friction. With b the radius of the core, c that of the outer
surface, the pressure (physics reference 5.2; Timoshenko & Goodier, Theory of Elasticity, §26) is

.. math:: p = \frac{δ/b}{\frac{1+ν_o}{E_o}\frac{(1-2ν_o) b^2 + c^2}{c^2-b^2}
              + \frac{(1+ν_i)(1-2ν_i)}{E_i}}.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests import support

# Cement and the ring around it are of one material and bonded: the outer radius is 12 mm.
SHRINK_FIT = """
geometry:
  kind: cylinders
  stem_radius: 7 mm
  cement_thickness: 3 mm
  bone_thickness: 2 mm
  length: 1 mm
  sector: quarter
mesh: {{size: {size} mm, far_size: {size} mm}}
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


def lame(
    δ: float, b: float, c: float, inner: tuple[float, float], outer: tuple[float, float]
) -> float:
    (E_i, ν_i), (E_o, ν_o) = inner, outer
    ring = (1 + ν_o) / E_o * ((1 - 2 * ν_o) * b**2 + c**2) / (c**2 - b**2)
    return (δ / b) / (ring + (1 + ν_i) * (1 - 2 * ν_i) / E_i)


def test_formula_against_reference_values() -> None:
    """Plane strain values of the physics reference 5.2 for cement alone, 2 to 7 mm thick."""
    values = [lame(0.01, 7, 7 + t, (110e3, 0.3), (2200, 0.3)) for t in (2, 3, 4, 5, 7)]
    np.testing.assert_allclose(values, [0.76706, 1.02740, 1.23297, 1.39736, 1.63941], atol=6e-6)


def mean_pressure(size: float) -> tuple[float, support.Solved]:
    result = support.solve(SHRINK_FIT.format(size=size))
    s = result.last
    return float(np.average(s.pressure, weights=s.weight)), result


EXACT = lame(0.01, 7, 12, (110e3, 0.3), (2200, 0.3))


def test_mean_pressure_converges_at_second_order() -> None:
    sizes, errors = [2.0, 1.0, 0.5], []
    for size in sizes:
        p, result = mean_pressure(size)
        errors.append(p / EXACT - 1)
        q = result.interfaces["stem_cement"]
        assert q["penetration_max"] < 1e-12
        assert q["open_fraction"] == 0 and q["shear_max"] < 1e-12
    assert support.fitted_order(sizes, errors) == pytest.approx(2, abs=0.4)
    assert abs(errors[-1]) < 0.005
