"""The problems of the suites: their names, cases and runs; experiments that are not reproduced.

Their answers are tested by `app/verification/problems`.
"""

from __future__ import annotations

import json
import logging
import re
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from app.campaigns.batch import Options
from app.case.case import PlannedRun, load
from app.verification import suite
from app.verification.problem import within
from tests.support import CONFIGS
from tests.verification.made_runs import judged

# Experiments that mantle does not reproduce, as published in docs/verification.md.
OUTSIDE = {
    "validation_rods",
    "validation_disc_ptfe_rise",
    "validation_disc_foam_rise",
    "validation_disc_ptfe_time",
    "validation_disc_foam_time",
}


def test_problems_of_verify_are_well_posed() -> None:
    """Unique short names; cases that exist and say how to run them; sizes that fall."""
    everything = suite.planned("verify", "long")
    names = [planned.row.name for planned in everything]
    assert len(set(names)) == len(names) == 163
    assert max(map(len, names)) <= 26
    for planned in (*everything, *suite.planned("verify")):
        row = planned.row
        assert row.tolerance is not None
        assert row.quantity
        assert row.source
        assert row.refusal is None
        assert planned.runs or row.name == "klarbring"
        for run in planned.runs:
            assert f"run configs/{run.case}" in (CONFIGS / run.case).read_text("utf-8")
            load(CONFIGS / run.case, run.overrides)
        if row.order is not None:
            sizes = list(row.sizes)
            assert sizes == sorted(sizes, reverse=True)
            assert len(set(sizes)) == len(sizes) == len(planned.runs) >= 3
    cases = {run.case for planned in everything for run in planned.runs}
    folders = ("verification", "validation")
    assert cases == {f"{f}/{p.name}" for f in folders for p in CONFIGS.glob(f"{f}/*.yaml")}


def test_problems_of_stress_are_well_posed(tmp_path: Path) -> None:
    """Names are unique, cases resolve, each subject has its share."""
    everything = suite.planned("stress", "long")
    small = [planned for planned in everything if within(planned.row.tier, "default")]
    groups = Counter(planned.row.group for planned in small)
    assert {"augmentation", "penalty", "modulus", "poisson", "friction", "thin mantle"} < set(
        groups
    )
    assert {"loads", "units", "floating", "taper", "cycles", "increments"} < set(groups)
    assert {"symmetry", "bad cells", "heat", "layer", "creep", "cohesion"} < set(groups)
    assert len(small) == 257
    assert len(everything) == 579
    assert len({planned.row.name for planned in everything}) == len(everything)
    chosen = {p.row.name for p in small if p.row.name.startswith("augmentation_E_50:1_mu_0.4")}
    assert {name.split("_")[-1] for name in chosen} == {f"{10.0**k:.2g}" for k in range(-4, 5) if k}
    for planned in everything:
        row = planned.row
        assert re.fullmatch(r"[^\s/]+", row.name)
        assert row.source
        assert (row.tolerance is not None and row.tolerance > 0) or row.refusal
        assert all((CONFIGS / run.case).is_file() for run in planned.runs)
    for name in ("stem", "taper"):
        text = (CONFIGS / "stress" / f"{name}.yaml").read_text(encoding="utf-8")
        assert f"run configs/stress/{name}.yaml" in text
    # Every override is one: what is refused at once is meant to be.
    some = [planned for planned in small if not any(run.mesh for run in planned.runs)]
    suite.plan(some, tmp_path, alone=False)
    refused = [p.row for p in some if not all(isinstance(r, PlannedRun) for r in p.planned)]
    assert len(some) > 150
    assert len(refused) == 3
    assert all(row.group == "floating" and row.tolerance is None for row in refused)


@pytest.mark.slow
def test_problems_of_validation_miss_published_values(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """From end to end; nothing is run twice."""
    caplog.set_level(logging.INFO, "mantle")
    options = Options(tmp_path, 2, "validation")
    assert suite.run("verify", options)
    entries = json.loads((tmp_path / "verify-validation.json").read_text())
    missed = {e["name"]: e["message"] for e in entries if e["outcome"] == "missed"}
    assert missed.keys() == OUTSIDE
    assert len(entries) == 10
    assert (tmp_path / "verify-validation.png").stat().st_size > 5_000
    assert suite.run("verify", options)
    assert "10 problems: 5 passed, 5 missed" in caplog.text
    assert re.search(r"(\d+) runs: \1 done already", caplog.text)


def test_problems_of_validation_name_sources_and_ranges(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Published means lie within their ranges; notes name the source, the mesh and the range."""
    name = "validation_disc_foam_peak"
    others = 4 * [(0.0, 0.0)]

    def note(*peaks: tuple[float, float]) -> str:
        runs: list[Any] = [
            SimpleNamespace(step_record={"centre [degC]": np.array([23.0, peak])})
            for pair in (*peaks, *others)
            for peak in pair
        ]
        row = judged(monkeypatch, "verify", name, runs[:12], tmp_path)
        assert row.group == "validation"
        assert row.comparison is not None
        inside = row.comparison.error < (row.tolerance or 0)
        assert inside == (row.outcome == "passed")
        return f"{row.comparison.error:.3g}: {row.comparison.note}"

    near = note((95, 46), (95, 47), (90, 60))
    assert near.startswith("0.02: 49 ± 1 by mesh, inside the measured 40 to 60; seed 1e-4 30; ")
    assert "abstract of" in near
    far = note((95, 34), (95, 34))
    assert far.startswith("0.22: 61 ± 0 by mesh, OUTSIDE the measured 40 to 60; ")
