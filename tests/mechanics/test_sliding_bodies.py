"""State of bodies with finite sliding: the approach of a head to its cup."""

from __future__ import annotations

import numpy as np
import pytest

from app.mechanics.sliding_bodies import APPROACH_FACTOR
from tests import support
from tests.cases.turning_head import CUP


def test_sliding_bodies_approach_until_points_overlap_slightly() -> None:
    """A head that moves by 1.25 of the way to the first contact overlaps by 0.25 of the gap there.

    All other points stay further away from contact, relative to their gaps.
    """
    problem, solver = support.assemble(support.case(CUP))
    contact, sliding = problem.contact, problem.sliding_bodies
    assert contact is not None and sliding is not None
    assert contact.finite_sliding is not None
    u, q = solver.u_and_q()
    assert q is not None
    problem.set_time(1.0)
    gap = contact.gaps.gap_at_pairing
    assert (gap > 0).all()
    sliding.approach(problem.f, u, q)
    opening = contact.gaps.openings(q.array.reshape(-1, 3))[:, 0]
    assert (opening / gap).min() == pytest.approx(1 - APPROACH_FACTOR, rel=1e-9)
    # The jumps keep the surface of the liner at its place.
    problem.update_displacements(u, q)
    liner = problem.displacements()[problem.bodies.body_of_region["liner"]].x.array
    assert np.abs(liner.reshape(-1, 3)[contact.finite_sliding.nodes]).max() < 1e-15
    # Bodies in contact stay where they are.
    moved = q.array.copy()
    contact.gaps.set_pairs(moved.reshape(-1, 3))
    sliding.approach(problem.f, u, q)
    np.testing.assert_array_equal(q.array, moved)
