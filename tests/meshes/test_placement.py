"""Positions of a stem relative to the neck cut."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from meshes.placement import shoulder_level
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


@pytest.mark.parametrize("depth", [2.0, 6.0])
def test_placement_shoulder_is_between_its_section_and_the_cut(depth: float) -> None:
    """The section through the lateral edge is parallel to the cut; above it is the shoulder.

    A shoulder less than 2.5 mm below the cut counts as at the cut.
    """
    placement = CUT.put(IMPLANT, replace(START, depth=depth), False)
    half_width = IMPLANT.half_width
    lateral, anterior = np.array([-half_width, 0.0]), np.array([0.0, 1.0])
    edge = placement.top - depth  # height of the section at the axis

    def on_plane(place: np.ndarray, above: float) -> np.ndarray:
        height = edge - place @ np.array(placement.slopes) + above
        return placement.to_model([*place, height])

    points = np.array(
        [
            on_plane(lateral, 0.1),
            on_plane(lateral, -0.1),
            on_plane(anterior, 0.1),
            on_plane(anterior, -0.1),
            on_plane(-lateral + [5.0, 0.0], 0.1),  # medial of the shaft
        ]
    )
    on_shoulder = shoulder_level(IMPLANT, placement, points) <= 0.0
    expected = [True, False, True, False, False] if depth > 2.5 else [False] * 5
    assert on_shoulder.tolist() == expected
