"""Motion of a stem in its bone."""

from __future__ import annotations

import numpy as np
import pytest

from app.results.hip import StemMotion
from tests import support

BONDED = (
    "interfaces.stem_cement={kind: bonded}",
    "interfaces.cement_bone={kind: bonded}",
)
# The bone stands on its lower end, and bends and is squeezed.
BENT = (
    *("supports={foot: {kind: fixed, boundary: bone_bottom}}", "geometry.length=60 mm"),
    "loads={hip: {kind: force, boundary: bone_top, force: [300 N, 0 N, -900 N]}}",
)


def test_hip_motion_of_a_bonded_stem_is_small() -> None:
    """The bone bends a lot: its top moves a hundred times as far as the stem in the bone."""
    solved = support.solve(support.STEM, *BONDED, *BENT)
    motion = StemMotion(solved.problem, solved.case)(solved.case.side)
    top = float(np.linalg.norm(motion["top_displacement"]))
    assert top > 0.03
    assert abs(motion["subsidence"]) < 0.01 * top
    assert np.linalg.norm(motion["tip_displacement"]) < 0.1 * top


def test_hip_motion_is_zero_in_a_rigid_rotation() -> None:
    """A rotation by 0.01 rad about an oblique axis keeps the relative place of stem and bone."""
    turn = "outer: {kind: displacement, boundary: bone_surface, x: 0.004 * z - 0.008 * y, "
    turn += "y: 0.008 * x - 0.005 * z, z: 0.005 * y - 0.004 * x}"
    solved = support.solve(support.STEM, *BONDED, f"supports={{{turn}}}", "loads={}")
    motion = StemMotion(solved.problem, solved.case)(solved.case.side)
    assert max(abs(motion[k]) for k in ("subsidence", "retroversion", "varus")) < 1e-9
    assert np.linalg.norm(motion["top_displacement"]) > 0.01


def test_hip_motion_of_a_right_hip_is_mirrored() -> None:
    """One load acts towards +x, the other towards -x, with a torque about the axis."""
    motions = []
    for side, sign in (("left", 1), ("right", -1)):
        solved = support.solve(
            support.STEM,
            *BONDED,
            "mesh.order=2",
            f"side={side}",
            f"loads.hip.force=[{sign * 300} N, 100 N, -900 N]",
            f"loads.torque={{kind: body_force, regions: [stem], density: "
            f"['{sign * 0.05} * y', '{-sign * 0.05} * x', 0 N/mm^3]}}",
        )
        motions.append(StemMotion(solved.problem, solved.case)(solved.case.side))
    left, right = motions
    for key in ("subsidence", "retroversion", "varus"):
        assert abs(left[key]) > 1e-5
        # The meshes are not mirror images of each other.
        assert right[key] == pytest.approx(left[key], rel=0.02), (key, left, right)
