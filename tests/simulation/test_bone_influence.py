"""Influence of unmeasured bone on a run's numbers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from app.case.summary import BoneInfluence
from app.simulation import bone_influence
from tests import support
from tests.patient.bones import opened, parametric_canal, parametric_femur, write


def influence_of(folder: Path, canal: dict[str, str]) -> BoneInfluence:
    """Influence of the part of the bone in `bone.stl` that was not measured; the run reports it."""
    case = {
        "base": "stance",
        "geometry": {
            "kind": "patient",
            "bone": {"surface": "bone.stl", "unit": "mm"},
            "canal": canal | {"ream": "broach"},
        },
        "mesh": {"size": "12 mm", "order": 1},
        "loads": {"library": "one_leg_stance"},
        "output": {"error": False, "report": False},
    }
    summary = support.run(json.dumps(case), folder).summary
    influence = summary["assumed_bone"]
    assert any(influence["sentence"] in v["what"] for v in summary["verdicts"])
    return influence


def assert_wider_bends_more(changes: dict[str, list[float]]) -> None:
    """A wider canal leaves a thinner cortex."""
    first, second = np.array(changes["cortical_bone.von_mises_p99"])
    assert second > 1.005 * first


def test_bone_influence_of_a_scan_that_ends_beside_the_stem(tmp_path: Path) -> None:
    """By Saint-Venant's principle the support, 70 mm below the plug, changes little."""
    write(tmp_path / "bone.stl", opened(parametric_femur(), -60.0))
    write(tmp_path / "canal.stl", opened(parametric_canal(), -60.0))
    influence = influence_of(tmp_path, {"surface": "canal.stl"})
    longer, wider = influence["changes"]
    assert longer == "40 mm more of the continued shaft"
    assert wider == "a canal 2 mm wider in the shaft"
    first, second = np.array(influence["changes"][longer]["stem.subsidence"])
    assert first > 0.0
    assert abs(second - first) < 0.05 * first
    assert_wider_bends_more(influence["changes"][wider])


def test_bone_influence_of_a_canal_that_no_file_has(tmp_path: Path) -> None:
    write(tmp_path / "bone.stl", parametric_femur())
    (changes,) = influence_of(tmp_path, {})["changes"].values()
    assert_wider_bends_more(changes)


def test_bone_influence_without_main_numbers_is_empty() -> None:
    """Bonded interfaces have none of the numbers by which runs are compared."""
    assert bone_influence._changes({"interfaces": {}}, {"interfaces": {}}) == ({}, "")
