"""Contact of interfaces: residual and rows of the Jacobian at contact points, by their formulas."""

from __future__ import annotations

import numpy as np

from tests.cases.blocks import contact_of_blocks


def test_contact_residual_is_equilibrium_and_forces_by_area() -> None:
    """At open points P = 0 and the residual is e; at points that stick it is r W G.

    The gap is 0.02 mm, the jump 0.03 mm along the normal and 0.01 mm across: G = q + g.
    """
    contact = contact_of_blocks()
    contact.set_time(1.0)
    normals, weight = contact.local.normals[:, 0], contact.local.weight[:, None]
    jump = 0.03 * normals + 0.01 * np.cross(normals, [1.0, 0.0, 0.0])
    e = 0.7 * weight * normals
    np.testing.assert_allclose(contact.forces(e), -0.7 * normals, rtol=1e-12)
    with contact.remedies.opening():
        residual = contact.residual(e, jump, contact.evaluate(e, jump))
    np.testing.assert_allclose(residual, e, rtol=1e-12)
    with contact.remedies.constraining():
        residual = contact.residual(e, jump, contact.evaluate(e, jump))
    r = contact.laws.augmentation[:, None]
    np.testing.assert_allclose(
        residual, r * weight * (jump + 0.02 * normals), atol=1e-12 * float((r * weight).max())
    )


def test_contact_rows_are_equilibrium_if_open_and_keep_the_jump_if_stuck() -> None:
    """Rows (1 - P') [C^T, D] + r W P', with P' = 0 at open points, P' = 1 at those that stick."""
    contact = contact_of_blocks()
    n, e = len(contact.local), np.zeros((len(contact.local), 3))
    identity = np.tile(np.eye(3), (n, 1, 1))
    with contact.remedies.opening():
        factors, added = contact.row_factors(contact.evaluate(e, e))
    np.testing.assert_allclose(factors, identity)
    assert not added.any()
    with contact.remedies.constraining():
        factors, added = contact.row_factors(contact.evaluate(e, e))
    assert not factors.any()
    r, weight = contact.laws.augmentation, contact.local.weight
    np.testing.assert_allclose(added, (r * weight)[:, None, None] * identity)


def test_contact_is_apart_until_a_point_touches() -> None:
    """The blocks are apart by 0.02 mm at the end of the first stage, and touch without a gap."""
    contact = contact_of_blocks()
    contact.set_time(1.0)
    assert contact.is_apart()
    assert not contact_of_blocks("interfaces.lower_upper.gap=0 mm").is_apart()
