"""Rollers in any direction on several ranks, and on others than those that saved a state."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from app.verification.changed_meshes import ROTATION, change
from tests import support
from tests.mechanics.test_oblique import QUARTER, vector
from tests.restarted import assert_same, whole


def test_a_turned_quarter_from_a_file_on_two_ranks(tmp_path: Path) -> None:
    """One side by its normal, one by that of its face, in one stage more than in the other."""
    text = QUARTER.replace("solver: ", "output: {fields: false}\nsolver: ")
    normals = [vector(np.pi * ROTATION[:, k]) for k in range(3)]
    straight = support.case(text)
    overrides = [
        *change(straight, "turned", tmp_path),
        "supports.symmetry_x={kind: roller, boundary: symmetry_x, normal: face}",
        f"supports.symmetry_y={{kind: roller, boundary: symmetry_y, normal: {normals[1]}}}",
        f"supports.under_bone={{kind: roller, boundary: bone_bottom, normal: {normals[2]}}}",
        f"supports.under_cement={{kind: roller, boundary: cement_bottom, normal: {normals[2]}}}",
        "supports.hand={kind: roller, boundary: bone_surface, normal: face, stages: [press_fit]}",
        f"loads.push.force={vector(ROTATION @ [0, 0, -900], ' N')}",
    ]
    case, saved = whole(text, tmp_path, *overrides)
    words = [word for o in overrides for word in ("--set", o)]
    output = tmp_path / "two"
    support.on_ranks(2, "-m", "mantle", "run", case, "-o", output, *words, "--restart", saved[0])
    assert_same(output, tmp_path / "whole")
