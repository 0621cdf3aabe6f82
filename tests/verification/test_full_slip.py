"""Interfaces that slip everywhere carry friction at its limit."""

from __future__ import annotations

import numpy as np
import pytest

from forms.contact import SLIP
from tests import support

# A straight stem and its mantle, both too large for their holes, then pushed down or pulled up by
# more than the bodies can stretch. Springs under the mantle let it lag behind the stem, so that
# both interfaces slip everywhere. No support gives a jump along z.
PUSH = """
geometry: {{kind: cylinders, stem_radius: 7 mm, cement_thickness: 3 mm, bone_thickness: 4 mm,
            length: 10 mm, taper: {taper} deg, sector: quarter}}
mesh: {{order: 1, size: 1.8 mm, far_size: 3 mm}}
regions:
  stem: {{youngs_modulus: 110 GPa, poisson_ratio: 0.3}}
  cement: {{youngs_modulus: 2200 MPa, poisson_ratio: 0.3}}
  bone: {{youngs_modulus: 2300 MPa, poisson_ratio: 0.3}}
interfaces:
  stem_cement: {{{law}, friction_coefficient: 0.4, gap: -0.02 mm, gap_history: [1, 1]}}
  cement_bone: {{kind: contact, friction_coefficient: 0.2, gap: -0.05 mm, gap_history: [1, 1]}}
supports:
  symmetry_x: {{kind: roller, boundary: symmetry_x, axis: x}}
  symmetry_y: {{kind: roller, boundary: symmetry_y, axis: y}}
  table: {{kind: roller, boundary: bone_bottom, axis: z}}
  springs:
    {{kind: foundation, boundary: cement_bottom, stiffness: [0 MPa/mm, 0 MPa/mm, 100 MPa/mm]}}
  push: {{kind: displacement, boundary: stem_top, z: {push} mm, history: [0, 1]}}
stages:
  - {{name: fit}}
  - {{name: push, increments: 2}}
"""

FRICTION = (0.4, 0.2)
AUGMENTED = "kind: contact"
PENALTY = "kind: penalty, penalty: 2.0e4 MPa/mm"


@pytest.mark.parametrize(
    ("push", "taper", "law"),
    [
        pytest.param(-0.09, 0, AUGMENTED, id="push_in"),
        pytest.param(0.09, 0, AUGMENTED, id="pull_out"),
        pytest.param(-0.09, 0.3, AUGMENTED, id="push_in_tapered"),
        pytest.param(-0.09, 0, PENALTY, id="push_in_penalty"),
    ],
)
def test_full_slip_gives_the_friction_coefficient(push: float, taper: float, law: str) -> None:
    """Each slipping point has |shear| / pressure = μ, and the shear resists the motion."""
    result = support.solve(PUSH.format(push=push, taper=taper, law=law), balances=True)
    s = result.last
    down = np.sign(push)
    for i, μ in enumerate(FRICTION):
        on = s.interface == i
        slipping = on & (s.status == SLIP)
        assert s.weight[slipping].sum() > 0.999 * s.weight[on].sum(), (i, slipping.sum(), on.sum())
        ratio = s.shear[slipping] / s.pressure[slipping]
        assert np.abs(ratio / μ - 1).max() < 1e-6
        q = result.interfaces["stem_cement" if i == 0 else "cement_bone"]
        # The stem carries the cement along, and the cement the bone.
        assert np.sign(q["force"][2]) == down
        if taper == 0:
            normal = float((s.weight * s.pressure)[on].sum())
            # Friction is vertical but for what the bulging under the push turns sideways.
            assert abs(q["force"][2]) == pytest.approx(μ * normal, rel=0.02)
        assert q["slip_max"] > 0.01 and q["dissipation"] > 0
    assert result.balances.max() < 1e-8
