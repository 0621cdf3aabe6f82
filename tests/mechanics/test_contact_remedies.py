"""Changes of contact by remedies: constrained or opened points, given pressures."""

from __future__ import annotations

import numpy as np
import pytest

from tests.cases.blocks import contact_of_blocks

FRICTIONLESS = "interfaces.lower_upper.friction_coefficient=0"


def test_contact_remedies_constrain_interfaces_that_are_open_everywhere() -> None:
    """All points of blocks with a gap are constrained, and none where the blocks touch."""
    contact = contact_of_blocks()
    remedies = contact.remedies
    contact.set_time(1.0)
    with remedies.constraining() as has_constrained:
        assert has_constrained and remedies.switches.stuck.all()
    assert not remedies.switches.stuck.any()
    touching = contact_of_blocks("interfaces.lower_upper.gap=0 mm").remedies
    with touching.constraining() as has_constrained:
        assert not has_constrained and not touching.switches.stuck.any()


def test_contact_remedies_constrain_interfaces_that_opened_in_an_earlier_step() -> None:
    """Without a gap at rest, the block has been lifted by 0.1 mm and has to come back."""
    contact = contact_of_blocks("interfaces.lower_upper.gap=0 mm")
    contact.set_time(1.0)
    contact.state.jump = 0.1 * contact.local.normals[:, 0]
    contact.set_time(2.0)
    assert contact.is_apart()
    with contact.remedies.constraining() as has_constrained:
        assert has_constrained and contact.remedies.switches.stuck.all()


def test_contact_remedies_open_contact_until_it_may_close() -> None:
    remedies = contact_of_blocks().remedies
    with remedies.opening() as has_opened:
        assert has_opened and remedies.switches.opened.all()
    assert not remedies.switches.opened.any()
    # Contact has no internal variables to freeze.
    with remedies.freezing() as has_variables:
        assert not has_variables


def test_contact_remedies_relax_given_pressures_only_while_they_limit_friction() -> None:
    remedies = contact_of_blocks().remedies
    for _ in range(2):
        with pytest.raises(ValueError, match="friction is not limited by given pressures"):
            remedies.relax_tresca_friction(0.5)
        with remedies.tresca_friction() as has_friction:
            assert has_friction
            # Nothing acts yet: given and last pressures are zero.
            assert remedies.relax_tresca_friction(0.5) == 0.0
    with contact_of_blocks(FRICTIONLESS).remedies.tresca_friction() as has_friction:
        assert not has_friction


def test_contact_remedies_move_given_pressures_by_shares() -> None:
    """At a constant state a share s leaves (1 - s)^k of the difference after k updates."""
    contact = contact_of_blocks()
    remedies, n = contact.remedies, len(contact.local)
    e = np.tile([0.3, 0.0, 1.0], (n, 1)) * contact.local.weight[:, None]  # N
    with remedies.tresca_friction() as has_friction:
        assert has_friction
        trial_force = contact.evaluate(e, contact.state.jump).trial_force
        for k in range(4):
            given = remedies.switches.tresca_trial_force
            assert given is not None
            np.testing.assert_allclose(given, (1 - 0.75**k) * trial_force, rtol=1e-12, atol=1e-15)
            assert remedies.relax_tresca_friction(0.25) == pytest.approx(0.75**k)


def test_contact_remedies_end_a_change_after_an_error() -> None:
    remedies = contact_of_blocks().remedies
    before = remedies.switches
    with pytest.raises(KeyError), remedies.opening(), remedies.tresca_friction():
        raise KeyError
    assert remedies.switches is before
