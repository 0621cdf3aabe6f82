"""``mantle verify``: what it solves, writes and says."""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import Any

import pytest

from app.campaigns.batch import Options
from app.case.case import load
from app.verification import closed_forms, engine
from app.verification.check import CONFIGS, Check, CheckRun, Sample, each
from app.verification.engine import SUITES
from app.verification.problems import problems

KEYS = {"name", "error", "tolerance", "order", "expected_order", "seconds", "outcome"}


def verify(pattern: str, folder: Path) -> bool:
    return engine.run("verify", Options(folder, 2, pattern))


def written(folder: Path, pattern: str) -> list[dict[str, Any]]:
    name = f"verify-{pattern}" if pattern else "verify"
    entries: list[dict[str, Any]] = json.loads((folder / f"{name}.json").read_text())
    assert all(KEYS <= entry.keys() for entry in entries)
    assert (folder / f"{name}.png").stat().st_size > 5_000
    return entries


@pytest.mark.slow
def test_a_ladder_of_runs(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Error, order, run time, table, picture; nothing is run twice."""
    caplog.set_level(logging.INFO, "mantle")
    assert verify("lame_plane_strain_3", tmp_path)
    (entry,) = written(tmp_path, "lame_plane_strain_3")
    assert entry["name"] == "lame_plane_strain_3"
    assert entry["outcome"] == "passed"
    assert 0 < entry["error"] < entry["tolerance"] == 0.005
    assert entry["expected_order"] == 2
    assert abs(entry["order"] - 2) < 0.2
    assert entry["seconds"] > 1
    assert entry["reference"] == pytest.approx(1.02740, abs=6e-6)
    assert entry["error"] == pytest.approx(abs(entry["value"] / entry["reference"] - 1))
    assert entry["sizes"] == sorted(entry["sizes"], reverse=True)
    assert entry["errors"] == sorted(entry["errors"], reverse=True)
    assert "lame_plane_strain_3" in caplog.text and "1 check: 1 passed" in caplog.text
    begin = len(caplog.text)
    assert verify("lame_plane_strain_3", tmp_path)
    assert "3 runs: 3 done already" in caplog.text[begin:]


def test_what_fails_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A wrong number, and a run that fails; the others are measured all the same."""
    caplog.set_level(logging.INFO, "mantle")
    loose = (
        "interfaces.slope_block.friction_coefficient=0",
        "supports.push={kind: roller, boundary: top, axis: y}",
    )
    run = CheckRun("verification/incline.yaml", loose)
    broken = Check("incline_loose", "nothing holds it", (run,), each(_never), 0.1)
    everything = problems()
    monkeypatch.setitem(SUITES, "verify", lambda: [broken, *everything])
    monkeypatch.setattr(closed_forms, "push_up", lambda slope, friction: 0.5)
    assert not verify("incline", tmp_path)
    loose, wrong = written(tmp_path, "incline")
    assert loose["outcome"] == "failed" and loose["error"] is None
    assert "incline_loose" in loose["message"] and loose["message"] in caplog.text.replace(
        "\n  ", "\n"
    )
    assert wrong["outcome"] == "missed" and wrong["error"] == pytest.approx(
        1 - 0.412371 / 0.5, rel=1e-5
    )
    assert "2 checks: 1 missed, 1 failed: incline, incline_loose" in caplog.text


def _never(run: object) -> Sample:
    raise AssertionError("a run that failed is not measured")


def test_problems_are_well_posed() -> None:
    """Unique short names; cases that exist and say how to run them; ladders that go down."""
    everything = problems()
    names = [p.name for p in everything]
    assert len(set(names)) == len(names) == 92
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
    assert cases == {f"verification/{p.name}" for p in CONFIGS.glob("verification/*.yaml")}


@pytest.mark.slow
def test_all_pass(tmp_path: Path) -> None:
    """The default suite, some minutes on two cores."""
    assert verify("", tmp_path), [
        (e["name"], e["error"], e["order"], e["message"])
        for e in written(tmp_path, "")
        if e["outcome"] != "passed"
    ]
