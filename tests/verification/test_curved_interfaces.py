r"""Contact on curved cells: jumps between the nodes follow the surface and rigid motions.

Lamé's shrink fit of a solid core in a ring (plane strain, no friction) has uniform pressure. Flat
facets scatter it at first order, and jumps linear by component at second order.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from app.results.stresses import Stresses
from app.verification import closed_forms
from tests import support

SHRINK_FIT = """
geometry: {{kind: cylinders, stem_radius: 7 mm, cement_thickness: 3 mm, bone_thickness: 2 mm,
            length: {length} mm, taper: {taper} deg, sector: quarter}}
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


@pytest.mark.parametrize(("size", "off", "scatter"), [(2.0, 1e-3, 0.03), (1.0, 1e-3, 0.005)])
def test_curved_interfaces_shrink_fit_is_uniform(size: float, off: float, scatter: float) -> None:
    exact = closed_forms.lame_pressure(0.01, 7, 12, (110e3, 0.3), (2200, 0.3))
    result = support.solve(SHRINK_FIT.format(size=size, length=1, taper=0), balances=True)
    s = result.last
    assert np.average(s.pressure, weights=s.weight) == pytest.approx(exact, rel=off)
    assert np.abs(s.pressure / exact - 1).max() < scatter
    assert result.interfaces["stem_cement"]["area"] == pytest.approx(7 * np.pi / 2, rel=1e-5)
    # What weighs the stresses are the volumes of curved cells.
    volume = Stresses(result.problem).numbers_of_region("stem")["volume"]
    assert volume == pytest.approx(49 * np.pi / 4, rel=1e-4)
    assert result.balances.max() < 1e-8


def test_curved_interfaces_circle_of_three_facets_is_one_face() -> None:
    """A circle of three facets is one face. Flat facets would meet at 30 degrees."""
    result = support.solve(SHRINK_FIT.format(size=6.0, length=4, taper=1), balances=True)
    j = result.problem.contact
    assert (j.local.faces == 1).all()
    assert result.balances.max() < 1e-8


# Facets bent by half a radius.
COARSE = ("mesh.order=2", "mesh.size=7 mm")


def test_curved_interfaces_force_equals_the_load() -> None:
    """Virtual translations of one side are among the jumps."""
    result = support.solve(support.STEM, *COARSE, balances=True)
    for q in result.interfaces.values():
        assert q["force"] == pytest.approx((300, 0, -900), rel=1e-7, abs=1e-5)
    assert result.balances.max() < 1e-8


def test_curved_interfaces_rigid_motions_and_widening_are_exact() -> None:
    """Jumps are those of a linear field on edges in the plane of motion.

    A widening goes around the stem.
    """
    alone = ("geometry.taper=0 deg", "interfaces.cement_bone={kind: bonded}")
    problem, _ = support.assemble(support.case(support.STEM, *COARSE, *alone))
    j = problem.contact
    (B,) = j.coupling.jump_to_displacement.values()
    x = problem.space.tabulate_dof_coordinates()
    q, u = B.createVecRight(), B.createVecLeft()
    moved = np.abs(_product(B, q, np.ones((len(j.local.rows), 3)), u)).any(axis=1)
    on = moved & (np.abs(np.hypot(x[:, 0], x[:, 1]) - 7) < 0.2)
    level = on & np.isin(np.round(x[:, 2], 6), [0.0, 20.0])
    assert level.sum() > 10
    for field, where in (
        (lambda p: np.broadcast_to([1.0, 2.0, -3.0], p.shape), moved),
        (lambda p: np.column_stack([-p[:, 1], p[:, 0], 0 * p[:, 2]]), level),
        (lambda p: np.column_stack([p[:, 0], p[:, 1], 0 * p[:, 2]]), level),
    ):
        jumps = _product(B, q, field(j.local.x), u)
        np.testing.assert_allclose(jumps[where], field(x)[where], atol=1e-10)


def _product(B: Any, q: Any, values: support.Floats, u: Any) -> support.Floats:
    q.array[:] = values.ravel()
    B.mult(q, u)
    return np.array(u.array).reshape(-1, 3)
