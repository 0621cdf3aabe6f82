"""The engine under ``mantle verify``, ``stress`` and ``bench``: how it judges, what it writes."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app import cli
from app.campaigns import batch
from app.campaigns.batch import Options
from app.campaigns.runs import Result
from app.case.case import PlannedRun
from app.foundation.errors import InputError
from app.foundation.verdict import Reason
from app.verification import engine, picture
from app.verification.check import CONFIGS, Check, CheckRun, Sample, each
from app.verification.engine import SUITES

LOOSE = "no convergence: it is loose [loose-body]"
KEYS = {"name", "group", "outcome", "error", "tolerance", "order", "seconds", "message", "runs"}


def check(error: Any, refusal: Reason | None = None, runs: int = 1) -> Check:
    """A check whose judge has made up its mind; without one, or one that breaks."""

    def decided(runs: object) -> Sample:
        if isinstance(error, Exception):
            raise error
        return Sample(error, note="as it is")

    judge = None if error is None else decided
    wanted = tuple(CheckRun("blocks.yaml", (f"mesh.size={k + 1} mm",)) for k in range(runs))
    return Check("row_3_mm", "a number", wanted, judge, 1e-6, refusal=refusal)


@pytest.fixture
def done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Result:
    monkeypatch.setattr(engine, "Run", lambda folder: folder)
    planned = PlannedRun.load("one", CONFIGS / "blocks.yaml")
    return Result(planned, tmp_path, 0, 1.5, {"status": "converged"}, "")


OK = (0, "")
MAY = Reason.LOOSE_BODY


@pytest.mark.parametrize(
    ("error", "refusal", "ends", "outcome", "words"),
    [
        (9e-7, None, [OK], "passed", ""),
        # Never because it converged.
        *((error, None, [OK], "missed", "") for error in (2e-6, np.nan, np.inf)),
        (None, MAY, [OK], "missed", "there is no answer"),
        # By its reason, not by words, which may change; and with the exit code of a refusal.
        (None, MAY, [(4, "any\n  [loose-body] words\n  what to change: all")], "refused", "any"),
        (None, MAY, [(2, "supports: other words [loose-body]")], "refused", "other words"),
        (None, MAY, [(4, "nothing holds body 'stem'")], "failed", "nothing holds"),
        (None, MAY, [(4, "solutions may not be unique there [not-unique]")], "failed", "unique"),
        (None, MAY, [(70, LOOSE)], "failed", LOOSE),
        (None, MAY, [(5, "stopped: nothing holds [loose-body]")], "failed", "stopped"),
        # Not where there is an answer: of the run, or of what it is compared with.
        (0.0, None, [(4, LOOSE)], "failed", LOOSE),
        (0.0, MAY, [OK, (4, LOOSE)], "failed", LOOSE),
        (0.0, MAY, [(4, LOOSE), OK], "refused", LOOSE),
        (ValueError("no such field"), None, [OK], "failed", "no such field"),
    ],
)
def test_outcomes(
    done: Result,
    error: Any,
    refusal: Reason | None,
    ends: list[tuple[int, str]],
    outcome: str,
    words: str,
) -> None:
    """Of a judge with this error, on runs that ended so."""
    results = [replace(done, exit_code=code, message=message) for code, message in ends]
    found = engine.judge(check(error, refusal, len(ends)), results)
    assert found.outcome == outcome and words in found.message
    judged = outcome in ("passed", "missed") and error is not None
    assert (found.sample is not None and found.sample.note == "as it is") == judged
    assert found.seconds == 1.5


def test_a_wrong_order_misses(done: Result) -> None:
    """However small the error; the last of a ladder counts, the worst of other runs."""
    runs = tuple(CheckRun("none.yaml", size=h) for h in (1.0, 0.5, 0.25))

    def result(*errors: float, ladder: bool = True) -> engine.CheckResult:
        samples = iter(errors)
        judge = each(lambda run: Sample(next(samples)), last=ladder)
        return engine.judge(Check("a", "", runs, judge, 0.1, 2.0 if ladder else None), [done] * 3)

    assert result(0.16, 0.04, 0.01).order == pytest.approx(2)
    assert result(0.16, 0.04, 0.01).outcome == "passed"
    assert result(0.04, 0.02, 0.01).outcome == "missed"
    assert result(1.6, 0.4, 0.11).outcome == "missed"
    assert result(0.1, 0.1, float("nan")).outcome != "passed"
    assert result(0.01, 0.02, 0.03, ladder=False).outcome == "passed"
    assert result(0.2, 0.02, 0.03, ladder=False).outcome == "missed"
    assert result(0.01, float("nan"), 0.03, ladder=False).outcome == "missed"


def test_table_verdict_picture_and_json(done: Result, tmp_path: Path) -> None:
    refused, broken = (replace(done, exit_code=code, message=LOOSE) for code in (4, 70))
    outcomes = [
        *(engine.judge(check(e), [done]) for e in (9e-7, 0.0, 1e-12, 2e-6, np.inf, np.nan)),
        engine.judge(check(None, MAY), [refused]),
        engine.judge(check(None, MAY), [broken]),
    ]
    text = engine.table(outcomes)
    assert text.splitlines()[1].split()[:3] == ["row_3_mm", "9.00e-07", "1.0e-06"]
    assert f"row_3_mm failed: one: exit code 70: {LOOSE}" in text
    names = ", ".join(["row_3_mm"] * 4)
    said = f"8 checks: 3 passed, 1 refused, 3 missed, 1 failed: {names}"
    assert engine.verdict(outcomes) == said
    other = engine.judge(Check("b", "", (), lambda runs: Sample(0.0)), [])
    assert engine.table([*outcomes, other]).splitlines()[-4].split()[:2] == ["row", "8"]
    picture.draw(outcomes, tmp_path / "a.png")
    entries = [o.as_json() for o in outcomes]
    assert all(e.keys() >= KEYS for e in entries)
    json.loads(json.dumps(entries, allow_nan=False))
    assert (tmp_path / "a.png").stat().st_size > 5_000


def test_a_selection_leaves_the_results_of_the_whole_suite(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And where no picture can be drawn, that of other numbers does not stay."""
    own = [
        Check(name, "a number", (), lambda runs: Sample(0.01), 0.1, tier=tier)
        for name, tier in (("a", "quick"), ("b", "default"), ("c", "long"))
    ]
    monkeypatch.setitem(SUITES, "verify", lambda: own)

    def written(name: str) -> list[str]:
        return [entry["name"] for entry in json.loads((tmp_path / f"{name}.json").read_text())]

    assert engine.run("verify", Options(tmp_path, 1))
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    assert engine.run("verify", Options(tmp_path, 1, "a"))
    assert engine.run("verify", Options(tmp_path, 1, tier="quick"))
    assert engine.run("verify", Options(tmp_path, 1, tier="long"))
    assert written("verify-a") == written("verify-quick") == ["a"]
    assert written("verify") == ["a", "b"]
    assert written("verify-long") == ["a", "b", "c"]
    assert {name: (tmp_path / name).read_bytes() for name in before} == before

    def broken(entries: object, path: Path) -> None:
        raise RuntimeError("no fonts")

    monkeypatch.setattr(picture, "draw", broken)
    with pytest.raises(RuntimeError):
        engine.run("verify", Options(tmp_path, 1))
    assert not (tmp_path / "verify.png").exists()


@pytest.mark.parametrize("name", ["verify", "stress", "bench"])
def test_a_pattern_without_match_is_an_input_error(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no check of this tier has this in its name; allowed: "):
        engine.run(name, Options(tmp_path, 1, "agumentation"))
    assert not list(tmp_path.iterdir())


def test_options_reach_the_engine(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[tuple[str, Options]] = []
    monkeypatch.setattr(engine, "run", lambda *all: given.append(all) or len(given) < 3)
    assert cli.main(["verify", "--tier", "long", "-o", "there", "--cores", "1"]) == 0
    assert (
        cli.main(["bench", "-k", "stem", "--tier", "long", "--slurm=-p long", "--cores", "1"]) == 0
    )
    assert cli.main(["stress", "--tier", "quick", "--cores", "1"]) == 1
    assert given == [
        ("verify", Options(Path("there"), 1, tier="long")),
        ("bench", Options(Path("out/bench"), 1, "stem", "long", ["-p", "long"])),
        ("stress", Options(Path("out/stress"), 1, tier="quick")),
    ]


def test_timed_checks_run_in_turn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One after the other, each of their runs as often as it says; a judge sees them by run."""
    called, seen = [], []

    def run(jobs: Sequence[PlannedRun], folder: Path, *rest: object) -> list[Result]:
        called.append([job.name for job in jobs])
        assert all(job.alone for job in jobs)
        summary = {"solver": {"dofs": 7}, "cpu": {"solve": 2.0, "mesh": 9.0}}
        return [Result(job, folder / job.name, 0, 1.0, summary, "") for job in jobs]

    monkeypatch.setattr(batch, "run", run)
    monkeypatch.setattr(engine, "Run", lambda folder: folder)
    runs = (CheckRun("blocks.yaml", times=2), CheckRun("cylinders.yaml"))
    one = Check("one", "", runs, lambda runs: seen.extend(runs) or Sample(9.0), 1.0, timed=True)
    other = Check("other", "", runs, lambda runs: Sample(0.0), timed=True)  # of the same runs
    monkeypatch.setitem(SUITES, "bench", lambda: [one, other])
    assert engine.run("bench", Options(tmp_path, 2))  # a figure that is not reached is one too
    assert called == [["one_1", "one_2"], ["one_1"]]
    assert seen == [tmp_path / "one_1", tmp_path / "again-1" / "one_1", tmp_path / "one_2"]
    rows = list(csv.DictReader((tmp_path / "bench.csv").read_text().splitlines()))
    assert [r["solution [CPU s]"] for r in rows] == ["2.0"] * 3 and rows[0]["unknowns"] == "7"


def test_a_run_that_cannot_begin_is_judged_too(tmp_path: Path) -> None:
    """As one that ended with that error."""
    run = CheckRun("blocks.yaml", ("mesh.size=-1 mm",))
    job, _, why = next(engine._planned(Check("a", "", (run,), None), tmp_path))
    assert job is None and "must be positive" in why
