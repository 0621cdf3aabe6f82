"""Plane sections of triangulated surfaces: rays that leave them."""

from __future__ import annotations

import numpy as np

from meshes import plane_sections


def test_plane_sections_rays_cross_bridged_gaps() -> None:
    """Walls at 3, 5, 20 mm, as in a pit of 2 mm; at 3, 8, 10, 12, 20 mm, with a bay of 5 mm."""
    for walls, expected in (((3.0, 5.0, 20.0), 20.0), ((3.0, 8.0, 10.0, 12.0, 20.0), 3.0)):
        lines = np.array([[(x, -1.0), (x, 1.0)] for x in walls])
        radii, times = plane_sections.exits(lines, np.array([0.0]), 4.0)
        assert (radii[0], times[0]) == (expected, len(walls))
