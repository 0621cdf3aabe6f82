"""Positions of a stem relative to the neck cut."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.meshes.canals import CUT, IMPLANT, START


def test_placement_flexion_moves_the_tip_to_posterior() -> None:
    """The tip of a straight stem is its distance from the cut times the sine behind the axis."""
    angle = math.radians(3.0)
    placement = CUT.put(IMPLANT, replace(START, flexion=angle), False)
    tip = placement.to_model([0.0, 0.0, IMPLANT.tip_z])
    below = placement.top - IMPLANT.tip_z
    assert tip == pytest.approx(
        placement.foot - below * np.array([0.0, math.sin(angle), math.cos(angle)])
    )
    assert placement.rotation.T @ placement.rotation == pytest.approx(np.eye(3), abs=1e-14)
