"""Evidence of a run by factors of credibility, and its methods."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from app.foundation.errors import InputError
from app.report import evidence
from app.results.reading import Run
from tests import support

CHECK = {"outcome": "passed", "value": 1.0, "reference": 1.0, "order": None, "note": ""}
CHECKS = [
    CHECK | {"name": "patch", "group": "patch"},
    CHECK | {"name": "hertz", "group": "contact", "outcome": "failed", "value": 1.2},
    CHECK | {"name": "cook", "group": "bending", "order": 1.8, "expected_order": 2.0},
    CHECK | {"name": "rods", "group": "validation", "note": "pushed out of cement, 1999"},
]


def test_evidence_of_every_factor(stems: tuple[Run, Run], tmp_path: Path) -> None:
    run, checks = tmp_path / "run", tmp_path / "verify"
    shutil.copytree(stems[0].folder, run)
    checks.mkdir()
    (checks / "verify.json").write_text(json.dumps(CHECKS))
    page, file = evidence.write([run, checks])
    written = json.loads(file.read_text())
    factors = {f["number"]: f["evidence"] for f in written["factors"]}
    assert list(factors) == list(range(1, 14)) and all(map(all, factors.values()))
    assert written["question"] == evidence.APPLICANT  # the case has none
    assert factors[2][:2] == [
        "2 of 3 problems with known answers are solved within tolerance",
        "hertz: failed: 1.2, reference 1",
    ]
    assert "90% of the theoretical one" in factors[2][2]
    assert factors[11] == ["rods: passed: 1, reference 1"]
    assert factors[13] == [evidence.APPLICANT]
    text = page.read_text()
    assert all(f["name"] in text for f in written["factors"])


def test_evidence_methods_have_the_numbers_of_the_run(
    stems: tuple[Run, Run], tmp_path: Path
) -> None:
    shutil.copytree(stems[0].folder, tmp_path / "run")
    text = evidence.methods(tmp_path / "run").read_text()
    summary = support.summary(tmp_path / "run")
    for number in (
        f"{summary['solver']['dofs']} unknowns",
        "friction coefficient 0.4",
        "[300, 0, -900] N",
    ):
        assert number in text


def test_evidence_needs_a_finished_run(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no finished run"):
        evidence.write([tmp_path])
