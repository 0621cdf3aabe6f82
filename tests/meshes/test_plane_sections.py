"""Plane sections of triangulated surfaces: rays that leave them, and widths."""

from __future__ import annotations

import numpy as np
import pytest

from meshes import plane_sections


def test_plane_sections_rays_cross_bridged_gaps() -> None:
    """Walls are at 3, 5, 20 mm, like a pit of 2 mm; at 3, 8, 10, 12, 20 mm, like a bay of 5 mm."""
    for walls, expected in (((3.0, 5.0, 20.0), 20.0), ((3.0, 8.0, 10.0, 12.0, 20.0), 3.0)):
        lines = np.array([[(x, -1.0), (x, 1.0)] for x in walls])
        radii, times = plane_sections.exits(lines, np.array([0.0]), 4.0)
        assert (radii[0], times[0]) == (expected, len(walls))


def test_plane_sections_width_is_that_of_a_circle_of_equal_area() -> None:
    """The section is a square of 2 mm. An empty section has no width."""
    corners = np.array([(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0)])
    square = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    assert plane_sections.mean_width(square) == pytest.approx(4.0 / np.sqrt(np.pi))
    assert plane_sections.mean_width(square[:0]) == 0.0
