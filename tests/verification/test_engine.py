"""The engine under ``mantle verify``, ``stress`` and ``bench``: how it judges, what it writes."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app import cli
from app.campaigns import batch
from app.campaigns.batch import Options
from app.campaigns.runs import Job, Result
from app.errors import InputError, Reason
from app.verification import engine, picture
from app.verification.check import Check, CheckRun, Sample, each
from app.verification.engine import SUITES

LOOSE = "no convergence: it is loose [loose-body]"
KEYS = {"name", "group", "outcome", "error", "tolerance", "order", "seconds", "message", "runs"}


def check(error: float | None, refusal: Reason | None = None, runs: int = 1) -> Check:
    """A check whose judge has made up its mind."""
    judge = None if error is None else lambda runs: Sample(error, note="as it is")
    wanted = tuple(CheckRun("blocks.yaml", (f"mesh.size={k + 1} mm",)) for k in range(runs))
    return Check("row_3_mm", "a number", wanted, judge, 1e-6, refusal=refusal)


@pytest.fixture
def done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Result:
    monkeypatch.setattr(engine, "TimedRun", lambda result: result.folder)
    return Result(Job("one", tmp_path), tmp_path, 0, 1.5, {"status": "converged"}, "")


def ended(code: int, message: str) -> Result:
    return Result(Job("one", Path()), Path(), code, 2.0, {}, message)


def test_an_answer_passes_or_misses(done: Result) -> None:
    """By its judge, and never because it converged."""
    right = engine.judge(check(9e-7), [done])
    assert right.sample and right.sample.note == "as it is"
    assert (right.outcome, right.sample.error, right.seconds) == ("passed", 9e-7, 1.5)
    for error in (2e-6, np.nan, np.inf):
        assert engine.judge(check(error), [done]).outcome == "missed"


def test_convergence_without_an_answer_misses(done: Result) -> None:
    result = engine.judge(check(None, Reason.LOOSE_BODY), [done])
    assert result.outcome == "missed" and "there is no answer" in result.message


@pytest.mark.parametrize(
    ("code", "message", "outcome"),
    [
        (4, "whatever words\n  [loose-body] in any line\n  what to change: all", "refused"),
        (2, "supports: other words [loose-body]", "refused"),
        (4, "nothing holds body 'stem'", "failed"),
        (4, "solutions may not be unique there [not-unique]", "failed"),
        (70, "nothing holds body 'stem' [loose-body]", "failed"),
        (5, "stopped: nothing holds [loose-body]", "failed"),
    ],
)
def test_a_refusal_names_the_cause(code: int, message: str, outcome: str) -> None:
    """By its reason, not by words, which may change; and comes with the exit code of one."""
    result = engine.judge(check(None, Reason.LOOSE_BODY), [ended(code, message)])
    assert result.outcome == outcome and message in result.message
    assert result.sample is None


def test_no_refusal_where_there_is_an_answer(done: Result) -> None:
    """Of the run, or of what it is compared with."""
    assert engine.judge(check(0.0), [ended(4, LOOSE)]).outcome == "failed"
    both = check(0.0, Reason.LOOSE_BODY, runs=2)
    assert engine.judge(both, [done, ended(4, LOOSE)]).outcome == "failed"
    assert engine.judge(both, [ended(4, LOOSE), done]).outcome == "refused"


def test_a_judge_that_breaks_is_a_failure(done: Result) -> None:
    def breaks(runs: object) -> Sample:
        raise ValueError("no such field")

    result = engine.judge(Check("row", "", (CheckRun("blocks.yaml"),), breaks), [done])
    assert result.outcome == "failed" and "no such field" in result.message


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


def test_table_and_verdict(done: Result) -> None:
    outcomes = [
        engine.judge(check(9e-7), [done]),
        engine.judge(check(2e-6), [done]),
        engine.judge(check(None, Reason.LOOSE_BODY), [ended(4, LOOSE)]),
        engine.judge(check(0.0), [ended(70, "internal error")]),
    ]
    text = engine.table(outcomes)
    assert text.splitlines()[2].split()[:3] == ["row_3_mm", "2.00e-06", "1.0e-06"]
    assert "row_3_mm failed: one: exit code 70: internal error" in text
    said = "4 checks: 1 passed, 1 refused, 1 missed, 1 failed: row_3_mm, row_3_mm"
    assert engine.verdict(outcomes) == said
    other = engine.judge(Check("b", "", (), lambda runs: Sample(0.0)), [])
    assert engine.table([*outcomes, other]).splitlines()[-4].split()[:2] == ["row", "4"]


def test_picture_and_json(done: Result, tmp_path: Path) -> None:
    refused = check(None, Reason.LOOSE_BODY)
    outcomes = [
        *(engine.judge(check(e), [done]) for e in (0.0, 1e-12, 9e-7, 2e-6, np.inf, np.nan)),
        *(engine.judge(refused, [ended(code, LOOSE)]) for code in (4, 70)),
    ]
    picture.draw(outcomes, tmp_path / "a.png")
    entries = [o.as_json() for o in outcomes]
    assert all(e.keys() >= KEYS for e in entries)
    json.loads(json.dumps(entries, allow_nan=False))
    assert (tmp_path / "a.png").stat().st_size > 5_000


@pytest.fixture
def suite(monkeypatch: pytest.MonkeyPatch) -> list[Check]:
    """A suite without runs: a quick check, a default one, a long one."""
    own = [
        Check(name, "a number", (), lambda runs: Sample(0.01), 0.1, tier=tier)
        for name, tier in (("a", "quick"), ("b", "default"), ("c", "long"))
    ]
    monkeypatch.setitem(SUITES, "verify", lambda: own)
    return own


def written(folder: Path, name: str) -> list[str]:
    entries: list[dict[str, Any]] = json.loads((folder / f"{name}.json").read_text())
    return [e["name"] for e in entries]


def test_a_selection_leaves_the_results_of_the_whole_suite(
    tmp_path: Path, suite: list[Check], monkeypatch: pytest.MonkeyPatch
) -> None:
    """And where no picture can be drawn, that of other numbers does not stay."""
    assert engine.run("verify", Options(tmp_path, 1))
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    assert engine.run("verify", Options(tmp_path, 1, "a"))
    assert engine.run("verify", Options(tmp_path, 1, tier="quick"))
    assert engine.run("verify", Options(tmp_path, 1, tier="long"))
    assert written(tmp_path, "verify-a") == written(tmp_path, "verify-quick") == ["a"]
    assert written(tmp_path, "verify") == ["a", "b"]
    assert written(tmp_path, "verify-long") == ["a", "b", "c"]
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


def test_finest_rungs_are_of_the_long_tier() -> None:
    (sine,) = [c for c in SUITES["verify"]() if c.name == "sine_p1"]
    assert [len(sine.up_to(tier).runs) for tier in ("quick", "default", "long")] == [4, 4, 5]


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

    def run(jobs: Sequence[Job], folder: Path, *rest: object) -> list[Result]:
        called.append([job.name for job in jobs])
        assert all(job.alone for job in jobs)
        summary = {"solver": {"dofs": 7}, "cpu": {"solve": 2.0, "mesh": 9.0}}
        return [Result(job, folder / job.name, 0, 1.0, summary, "") for job in jobs]

    monkeypatch.setattr(batch, "run", run)
    monkeypatch.setattr(engine, "TimedRun", lambda result: result.folder)
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
    job, why = next(engine._planned(Check("a", "", (run,), None), tmp_path))
    assert job.name == "a" and "must be positive" in why
