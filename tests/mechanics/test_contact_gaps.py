"""Gaps of contact points: over time, and on a ball on which they slide."""

from __future__ import annotations

import numpy as np
import pytest

from app.mechanics.contact_gaps import initial_gap_vectors
from tests import support
from tests.cases.blocks import contact_of_blocks
from tests.cases.turning_head import CUP, R


def test_contact_gaps_openings_are_normal_jump_and_initial_gap_of_the_time() -> None:
    """A lift of 0.03 mm opens 0.05 mm at the full gap of 0.02 mm, 0.04 mm at half of it."""
    contact = contact_of_blocks()
    normals = contact.local.normals[:, 0]
    shift = np.cross(normals, [1.0, 0.0, 0.0])
    for time, gap in ((1.0, 0.02), (1.5, 0.015), (2.0, 0.01)):
        contact.set_time(time)
        jump = 0.03 * normals + 0.7 * shift
        np.testing.assert_allclose(contact.gaps.openings(jump)[:, 0], 0.03 + gap, rtol=1e-12)
        np.testing.assert_allclose(contact.gaps.gap_at_pairing, gap, rtol=1e-12)
        # The gap vector contains the whole jump, not the normal part alone.
        expected = (0.03 + gap) * normals + 0.7 * shift
        np.testing.assert_allclose(contact.gaps.gap_vector(jump), expected, atol=1e-15)


def test_contact_gaps_initial_vectors_open_every_face() -> None:
    rng = np.random.default_rng(8)
    gap = np.linspace(-1, 1, 50)
    for faces in (0, 1, 2, 3):
        normals = np.zeros((50, 3, 3))
        normals[:, :faces] = np.linalg.qr(rng.standard_normal((50, 3, 3)))[0][:, :faces]
        g = initial_gap_vectors(normals, gap)
        opened = np.einsum("nki,ni->nk", normals[:, :faces], g)
        assert np.abs(opened - gap[:, None]).max(initial=0) < 1e-12
        assert faces or not g.any()


def test_contact_gaps_of_a_press_fit_change_until_its_history_is_constant() -> None:
    """The interference is constant from the end of the second stage on."""
    law = "friction_coefficient: 0.4, interference: 0.01 mm, gap_history: [0.5, 1, 1]"
    contact = contact_of_blocks(
        f"interfaces.lower_upper={{kind: contact, {law}}}",
        "stages=[{name: first}, {name: second}, {name: third}]",
    )
    gaps, jump = contact.gaps, contact.state.jump
    assert gaps.end_of_insertion == pytest.approx(2.0) and not gaps.is_inserting
    for time, is_inserting in ((1.0, True), (2.0, True), (2.5, False)):
        gaps.commit(jump, time)
        assert gaps.is_inserting is is_inserting
    # A gap that is no interference is no press fit.
    assert contact_of_blocks().gaps.end_of_insertion == pytest.approx(0.0, abs=1e-8)


def test_contact_gaps_follow_a_ball_on_which_points_slide() -> None:
    """The distance of a point X + q from a ball of radius R is |X + q| - R.

    The gap is linear in the jump until the points are paired again.
    """
    problem, _ = support.assemble(support.case(CUP))
    contact = problem.contact
    assert contact is not None
    gaps, x = contact.gaps, contact.local.x
    for shift in ([1.0, -2.0, 0.5], [0.0, 3.0, 0.0]):
        jump = np.tile(shift, (len(x), 1))
        gaps.set_pairs(jump)
        distance = np.linalg.norm(x + jump, axis=1) - R
        normals = (x + jump) / np.linalg.norm(x + jump, axis=1)[:, None]
        np.testing.assert_allclose(gaps.gap_at_pairing, distance, atol=1e-9)
        np.testing.assert_allclose(gaps.gap_vector(jump), distance[:, None] * normals, atol=1e-9)
        motion = np.array([0.2, 0.0, -0.1])
        opening = gaps.openings(jump + motion)[:, 0]
        np.testing.assert_allclose(opening, distance + normals @ motion, atol=1e-9)


def test_contact_gaps_are_paired_again_if_their_errors_change_pressures() -> None:
    """A jump of 1 mm has a gap error of about s²/(2 R) = 0.04 mm: too much for small pressures."""
    problem, _ = support.assemble(support.case(CUP))
    contact = problem.contact
    assert contact is not None
    at_rest = contact.state.jump
    pressures = np.zeros((len(at_rest), 3))
    pressures[:, 0] = 1.0  # MPa
    moved = at_rest + np.array([1.0, 0.0, 0.0])
    largest_error = float((contact.laws.softest_stiffness * 1.0 / (2 * R)).max())  # MPa
    assert not contact.gaps.update_pairs(at_rest, pressures)
    assert not contact.gaps.update_pairs(moved, 1e4 * largest_error * pressures)
    assert contact.gaps.update_pairs(moved, largest_error * pressures)
    distance = np.linalg.norm(contact.local.x + moved, axis=1) - R
    np.testing.assert_allclose(contact.gaps.gap_at_pairing, distance, atol=1e-9)
