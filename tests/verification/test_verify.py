"""``mantle verify``: what it solves, writes and says."""

from __future__ import annotations

import json
import logging
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import mantle
from app.campaigns.batch import Options
from app.campaigns.runs import Result
from app.case.case import PlannedRun, load
from app.verification import engine
from app.verification.check import CONFIGS
from app.verification.problems import problems

# Experiments that mantle does not reproduce, as published in docs/verification.md.
OUTSIDE = {
    "validation_rods",
    *(f"validation_disc_{n}" for n in ("ptfe_rise", "foam_rise", "ptfe_time", "foam_time")),
}


def test_problems_are_well_posed() -> None:
    """Unique short names; cases that exist and say how to run them; ladders that go down."""
    everything = problems()
    names = [p.name for p in everything]
    assert len(set(names)) == len(names) == 131 + 10 + 18
    assert max(map(len, names)) <= 26
    for tier in ("default", "long"):
        for p in (p.up_to(tier) for p in everything):
            assert p.judge and p.what and p.refusal is None
            assert p.runs or p.name == "klarbring"
            for run in p.runs:
                assert f"run configs/{run.case}" in (CONFIGS / run.case).read_text("utf-8")
                load(CONFIGS / run.case, run.overrides)
            sizes = [run.size for run in p.runs]
            assert sizes == sorted(sizes, reverse=True)
            assert p.order is None or len(set(sizes)) == len(sizes) >= 3
    cases = {run.case for p in everything for run in p.runs}
    folders = ("verification", "validation")
    assert cases == {f"{f}/{p.name}" for f in folders for p in CONFIGS.glob(f"{f}/*.yaml")}


@pytest.mark.slow
def test_all_pass(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """The default suite, some minutes on two cores; nothing is run twice."""
    caplog.set_level(logging.INFO, "mantle")
    passed = engine.run("verify", Options(tmp_path, 2))
    entries = json.loads((tmp_path / "verify.json").read_text())
    off = {e["name"]: (e["error"], e["message"]) for e in entries if e["outcome"] != "passed"}
    assert passed and off.keys() == OUTSIDE, off
    assert (tmp_path / "verify.png").stat().st_size > 5_000
    assert (
        engine.run("verify", Options(tmp_path, 2))
        and "151 checks: 146 passed, 5 missed" in caplog.text
    )
    assert re.search(r"(\d+) runs: \1 done already", caplog.text)
    entry = next(e for e in entries if e["name"] == "lame_plane_strain_3")
    assert 0 < entry["error"] < entry["tolerance"] == 0.005
    assert entry["expected_order"] == 2 and abs(entry["order"] - 2) < 0.2
    assert entry["reference"] == pytest.approx(1.02740, abs=6e-6) and entry["seconds"] > 1
    assert entry["error"] == pytest.approx(abs(entry["value"] / entry["reference"] - 1))
    for name in ("sizes", "errors"):
        assert entry[name] == sorted(entry[name], reverse=True)
    notes = [e["note"] for e in entries if e["group"] == "stiff"]
    assert len(notes) > 15
    assert all(re.match(r"steps \d+, rejected \d+, balance \d", note) for note in notes)
    assert all(note in caplog.text for note in notes)


QUICK_PROBLEMS = {p.name: p.up_to("quick") for p in problems() if p.tier == "quick"}


@pytest.mark.parametrize("name", sorted(QUICK_PROBLEMS))
def test_the_answer_is_the_known_one(name: str, tmp_path: Path) -> None:
    """The quick tier; all of them, with their finest rungs: ``mantle verify``, the mutations."""
    problem, results = QUICK_PROBLEMS[name], []
    for k, run in enumerate(problem.runs):
        path, folder = CONFIGS / run.case, tmp_path / str(k)
        mantle.run(load(path, run.overrides), folder)
        results.append(Result(PlannedRun.load(name, path, run.overrides), folder, 0, 0.0, {}, ""))
    result = engine.judge(problem, results)
    assert result.outcome == ("missed" if name in OUTSIDE else "passed"), result.as_json()


def test_validation_tells_where_it_stands() -> None:
    """Published means lie within their ranges; notes name the source, the mesh and the range."""
    (disc,) = [p for p in problems() if p.name == "validation_disc_foam_peak"]
    assert disc.judge and disc.group == "validation"

    def runs(*peaks: float) -> list[Any]:
        return [SimpleNamespace(history={"centre [degC]": np.array([23.0, p])}) for p in peaks]

    near = disc.judge(runs(95, 46, 95, 47, 90, 60))
    assert near.error == pytest.approx(0.02) and near.error < disc.tolerance
    assert near.note.startswith("49 ± 1 by mesh, inside the measured 40 to 60; seed 1e-4 30; abs")
    far = disc.judge(runs(95, 34, 95, 34))
    assert far.error == pytest.approx(0.22) and far.error > disc.tolerance
    assert "61 ± 0 by mesh, OUTSIDE the measured 40 to 60; abstract of" in far.note
