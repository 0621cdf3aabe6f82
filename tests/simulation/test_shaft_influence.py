"""Change of a run's numbers by more of a shaft that is continued below a scan."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from app.simulation import shaft_influence
from tests import support
from tests.patient.bones import opened, parametric_canal, parametric_femur, write


def test_shaft_influence_of_a_scan_that_ends_beside_the_stem(tmp_path: Path) -> None:
    """By Saint-Venant's principle the support, 70 mm below the plug, changes little.

    A wider canal leaves a thinner cortex, which bends more.
    """
    write(tmp_path / "bone.stl", opened(parametric_femur(), -60.0))
    write(tmp_path / "canal.stl", opened(parametric_canal(), -60.0))
    case = {
        "base": "stance",
        "geometry": {
            "kind": "patient",
            "bone": {"surface": "bone.stl", "unit": "mm"},
            "canal": {"surface": "canal.stl", "ream": "broach"},
        },
        "mesh": {"size": "12 mm", "order": 1},
        "loads": {"library": "one_leg_stance"},
        "output": {"error": False, "report": False},
    }
    summary = support.run(json.dumps(case), tmp_path).summary
    influence = summary["continued_shaft"]
    assert -60.0 < influence["end"] < -45.0
    longer, wider = influence["changes"]
    assert (longer, wider) == ("40 mm more of it", "a canal 2 mm wider in it")
    first, second = np.array(influence["changes"][longer]["stem.subsidence"])
    assert first > 0.0
    assert abs(second - first) < 0.05 * first
    first, second = np.array(influence["changes"][wider]["cortical_bone.von_mises_p99"])
    assert second > 1.005 * first
    assert any(influence["sentence"] in v["what"] for v in summary["verdicts"])


def test_shaft_influence_without_main_numbers_is_empty() -> None:
    """Bonded interfaces have none of the numbers by which runs are compared."""
    assert shaft_influence._changes({"interfaces": {}}, {"interfaces": {}}) == ({}, "")
