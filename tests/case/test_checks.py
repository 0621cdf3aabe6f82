"""Checks of one part of a case against another."""

from __future__ import annotations

import pytest

from app.foundation.errors import InputError
from app.soundness import preview
from tests import support
from tests.soundness.judged import TWO, judged

MOTION = """
motions:
  turn:
    {region: metal, boundary: top, about: [5 mm, 5 mm, 5 mm], translation: held,
     rotation: {axes: xyz, cycle_table: ["time [s], rotation z [deg]", "0, 0", "1, 0.4"]}}
"""


def test_checks_supports_of_a_region_with_a_motion() -> None:
    notes = [v.text for v in preview.input_notes(support.case(TWO + MOTION))]
    text = (
        "motions.turn.rotation.cycle_table: all angles are below 0.5 degrees; are they in radians?"
    )
    assert notes == [text]
    (note,) = judged(TWO + MOTION)
    assert (
        note
        == "motions.turn.translation: metal does not move under press: its motion is prescribed"
    )
    with pytest.raises(InputError) as caught:
        judged(TWO + MOTION.replace("metal, boundary: top", "bone, boundary: bottom"))
    assert caught.value.messages[0].startswith(
        "motions.turn.region: bone rotates, but supports hold it (floor)"
    )


def test_checks_hip_force_of_a_set_on_a_femur_without_a_stem() -> None:
    """The message lists the boundaries, of which the head is one."""
    case = f"base: {support.CONFIGS / 'intact.yaml'}\nloads: {{library: gait}}\n"
    with pytest.raises(InputError) as caught:
        support.case(case)
    (message,) = caught.value.messages
    assert "no boundary 'stem_trunnion'; it has" in message and " head" in message
    assert support.case(case.replace("gait", "gait, hip: {boundary: head}"))
