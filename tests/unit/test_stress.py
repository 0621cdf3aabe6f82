"""``mantle stress``: what it tries, how it judges, what it writes."""

from __future__ import annotations

import json
import logging
import re
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mantle.campaigns import batch
from mantle.errors import InputError, Reason
from mantle.meshes import build
from mantle.meshes.data import cell_volumes
from mantle.meshes.quality import sicn
from mantle.results.reading import Run
from mantle.schema import config
from mantle.verification import changed_meshes, extremes, judges
from mantle.verification.extremes_case import CONFIGS, ExtremeCase, Judged, Wanted
from mantle.verification.extremes_cases import trials
from mantle.verification.extremes_picture import picture
from tests import support

KEYS = {"case", "parameters", "outcome", "explanation", "deviation", "seconds"}


LOOSE = "no convergence: it is loose [loose-body]"


def trial(deviation: float | None, refused: Reason | None = None, runs: int = 1) -> ExtremeCase:
    """A case whose judge has made up its mind."""
    judge = None if deviation is None else lambda runs: Judged(deviation, "as it is")
    wanted = tuple(Wanted("blocks.yaml", (f"mesh.size={k + 1} mm",)) for k in range(runs))
    return ExtremeCase("row", "line", "3 mm", {"size": 3.0}, wanted, judge, 1e-6, refused)


@pytest.fixture
def done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> batch.Result:
    monkeypatch.setattr(extremes, "Run", lambda folder: folder)
    return batch.Result(batch.Job("one", tmp_path), tmp_path, 0, 1.5, {"status": "converged"}, "")


def ended(code: int, message: str) -> batch.Result:
    return batch.Result(batch.Job("one", Path()), Path(), code, 2.0, {}, message)


def test_an_answer_is_correct_or_wrong(done: batch.Result) -> None:
    """By its judge, and never because it converged."""
    right = extremes.judge(trial(9e-7), [done])
    assert (right.state, right.deviation, right.seconds) == ("correct", 9e-7, 1.5)
    assert right.explanation == "as it is"
    assert extremes.judge(trial(2e-6), [done]).state == "wrong"
    assert extremes.judge(trial(np.nan), [done]).state == "wrong"
    assert extremes.judge(trial(np.inf), [done]).state == "wrong"


def test_convergence_without_an_answer_is_wrong(done: batch.Result) -> None:
    outcome = extremes.judge(trial(None, Reason.LOOSE_BODY), [done])
    assert outcome.state == "wrong" and "there is no answer" in outcome.explanation


@pytest.mark.parametrize(
    ("code", "message", "state"),
    [
        (4, "whatever words\n  [loose-body] in any line\n  what to change: all", "refused"),
        (2, "supports: other words [loose-body]", "refused"),
        (4, "nothing holds body 'stem'", "failed"),
        (4, "solutions may not be unique there [not-unique]", "failed"),
        (70, "nothing holds body 'stem' [loose-body]", "failed"),
        (5, "stopped: nothing holds [loose-body]", "failed"),
    ],
)
def test_a_refusal_names_the_cause(code: int, message: str, state: str) -> None:
    """By its reason, not by words, which may change; and comes with the exit code of one."""
    outcome = extremes.judge(trial(None, Reason.LOOSE_BODY), [ended(code, message)])
    assert outcome.state == state and message in outcome.explanation
    assert outcome.deviation is None


def test_no_refusal_where_there_is_an_answer(done: batch.Result) -> None:
    """Of the case, or of what it is compared with."""
    assert extremes.judge(trial(0.0), [ended(4, LOOSE)]).state == "failed"
    both = trial(0.0, Reason.LOOSE_BODY, runs=2)
    assert extremes.judge(both, [done, ended(4, LOOSE)]).state == "failed"
    assert extremes.judge(both, [ended(4, LOOSE), done]).state == "refused"


def test_a_judge_that_breaks_is_a_failure(done: batch.Result) -> None:
    def breaks(runs: object) -> Judged:
        raise ValueError("no such field")

    case = ExtremeCase("row", "", "1", {}, (Wanted("blocks.yaml"),), breaks)
    outcome = extremes.judge(case, [done])
    assert outcome.state == "failed" and "no such field" in outcome.explanation


def test_table_and_verdict(done: batch.Result) -> None:
    outcomes = [
        extremes.judge(trial(9e-7), [done]),
        extremes.judge(trial(2e-6), [done]),
        extremes.judge(trial(None, Reason.LOOSE_BODY), [ended(4, LOOSE)]),
        extremes.judge(trial(0.0), [ended(70, "internal error")]),
    ]
    lines = extremes.table(outcomes).splitlines()
    assert lines[1].split()[:6] == ["row", "4", "1", "1", "1", "1"]
    assert "2.0e-06 of 1.0e-06" in lines[1]
    assert "row_line_3_mm is wrong by 2.00e-06: as it is" in lines
    assert any("is failed: one: exit code 70: internal error" in line for line in lines)
    assert extremes.verdict(outcomes) == "4 cases: 1 correct, 1 refused, 1 wrong, 1 failed"


def test_the_plan() -> None:
    """Names are unique, cases resolve, each row has its share."""
    small, everything = trials(), trials(full=True)
    rows = Counter(t.row for t in small)
    assert {"augmentation", "penalty", "modulus", "poisson", "friction", "thin mantle"} < set(rows)
    assert {"loads", "units", "floating", "taper", "cycles", "increments"} < set(rows)
    assert {"symmetry", "bad cells", "heat"} < set(rows)
    assert len(small) > 150 and len(everything) > 1.5 * len(small)
    for plan in (small, everything):
        assert len({t.name for t in plan}) == len(plan)
    factors = {t.parameters["augmentation"] for t in small if t.row == "augmentation"}
    assert factors == {10.0**k for k in range(-4, 5) if k}
    for t in everything:
        assert re.fullmatch(r"[^\s/]+", t.name)
        assert (t.judge is not None and t.tolerance > 0) or t.refused
        assert all((CONFIGS / w.case).is_file() for w in t.runs)
        json.dumps(t.parameters)
    for name in ("stem", "taper"):
        text = (CONFIGS / "stress" / f"{name}.yaml").read_text(encoding="utf-8")
        assert f"run configs/stress/{name}.yaml" in text
    # Every override is one: what is refused at once is meant to be.
    jobs, refused = extremes._jobs([t for t in small if not any(w.mesh for w in t.runs)], Path())
    assert len(jobs) > 150
    meant = {t.runs[0] for t in small if t.row == "floating" and t.judge is None}
    assert set(refused) <= meant and len(refused) == 3


def test_picture_and_json(done: batch.Result, tmp_path: Path) -> None:
    refused = trial(None, Reason.LOOSE_BODY)
    outcomes = [
        *(extremes.judge(trial(d), [done]) for d in (0.0, 1e-12, 9e-7, 2e-6, np.inf, np.nan)),
        *(extremes.judge(refused, [ended(code, LOOSE)]) for code in (4, 70)),
    ]
    entries = [o.as_json() for o in outcomes]
    assert all(e.keys() >= KEYS for e in entries)
    json.loads(json.dumps(entries, allow_nan=False))
    picture(entries, tmp_path / "stress.png")
    assert (tmp_path / "stress.png").stat().st_size > 5_000


def test_a_wrong_name_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no case has this in its name; rows: augmentation"):
        extremes.run("agumentation", tmp_path, full=False, cores=1)


# Meshes


def blocks(*overrides: str) -> Any:
    case = config.load(CONFIGS / "blocks.yaml", ["mesh.size=4 mm", *overrides])
    return build(case.geometry, case.mesh, None)


def test_turned_and_scaled_meshes() -> None:
    data = blocks()
    R = changed_meshes.ROTATION
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1) and np.trace(R) == pytest.approx(
        1 + 2 * np.cos(np.radians(40))
    )
    whole = cell_volumes(data.points, data.cells).sum()
    turned = changed_meshes.turned(data)
    assert cell_volumes(turned.points, turned.cells).sum() == pytest.approx(whole)
    small = changed_meshes.scaled(data, 1e-3)
    assert cell_volumes(small.points, small.cells).sum() == pytest.approx(1e-9 * whole)


def test_bad_cells_are_bad_and_fill_the_blocks() -> None:
    data = blocks()
    bad = changed_meshes.flattened(data, 0.012)
    quality = sicn(bad.points, bad.cells)
    assert 0.012 <= quality.min() < 0.05 < sicn(data.points, data.cells).min()
    for tag in data.regions.values():
        on = data.cell_tags == tag
        volume = cell_volumes(bad.points, bad.cells[on]).sum()
        assert volume == pytest.approx(cell_volumes(data.points, data.cells[on]).sum())


def test_a_quarter_mirrored_is_the_whole() -> None:
    case = config.load(
        CONFIGS / "cylinders.yaml", ["mesh.size=6 mm", "mesh.far_size=8 mm", "mesh.order=1"]
    )
    quarter = build(case.geometry, case.mesh, None)
    whole = changed_meshes.mirrored(quarter)
    volumes = cell_volumes(whole.points, whole.cells)
    assert volumes.min() > 0
    assert volumes.sum() == pytest.approx(4 * cell_volumes(quarter.points, quarter.cells).sum())
    assert len(np.unique(np.round(whole.points, 7), axis=0)) == len(whole.points)
    assert not any(name.startswith("symmetry") for name in whole.boundaries)


# Judges


def test_judges_see_what_is_off(tmp_path: Path) -> None:
    """Real runs: a right one is right, another answer is not."""
    path = tmp_path / "case.yaml"
    twice, slack = "loads.press.pressure: 4 MPa", "interfaces.cement_metal.gap: 0.001 mm"
    text = (CONFIGS / "blocks.yaml").read_text(encoding="utf-8").replace("size: 2 mm", "size: 4 mm")
    path.write_text(f"{text}\nvariations: {{one: {{}}, twice: {{{twice}}}, slack: {{{slack}}}}}\n")
    support.on_ranks(1, "-m", "mantle", "run", path, "-o", tmp_path / "out")
    first, second, third = (Run(tmp_path / "out" / name) for name in ("one", "twice", "slack"))
    moduli, ratios = (17e3, 2200, 110e3), (0.3, 0.3, 0.3)
    assert judges.stack([first], moduli, ratios).deviation < 1e-9
    assert judges.stack([third], moduli, ratios).deviation > 1e-2
    assert judges.stack([second], moduli, ratios).deviation == pytest.approx(1, rel=1e-6)
    assert judges.same([first, first]).deviation == 0
    assert judges.same([second, first], lengths=2, stresses=2).deviation < 1e-9
    assert judges.same([second, first]).deviation == pytest.approx(1, rel=1e-6)
    assert judges.same([third, first]).deviation > 1e-2
    with pytest.raises(ValueError, match="not the same"):
        judges.same([first, first], points=2)
    assert judges.lawful([first]).deviation < 1e-9
    assert judges.close([second, first], factor=2).deviation == pytest.approx(1, rel=1e-6)
    assert judges.nothing_moves([first]).deviation == pytest.approx(2, rel=1e-6)


def test_rows_end_to_end(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """An exact answer whatever the penalty, and a body that nothing holds; nothing runs twice."""
    caplog.set_level(logging.INFO, "mantle")
    for pattern, states, count in (
        ("penalty_bar_on_a_wall_1", {"correct"}, 5),
        ("floating_no_support", {"refused"}, 1),
        ("friction_bar_pulled_off_0.3", {"refused"}, 1),
    ):
        assert extremes.run(pattern, tmp_path, full=False, cores=2)
        entries = json.loads((tmp_path / "stress.json").read_text())
        assert all(e.keys() >= KEYS for e in entries)
        assert {e["outcome"] for e in entries} == states and len(entries) == count
        assert (tmp_path / "stress.png").stat().st_size > 5_000
    assert "nothing holds body 'bar'" in entries[0]["explanation"]
    begin = len(caplog.text)
    assert extremes.run("penalty_bar_on_a_wall_1", tmp_path, full=False, cores=2)
    assert "5 runs: 5 done already" in caplog.text[begin:]
