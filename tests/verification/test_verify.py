"""``mantle verify``: what it solves, writes and says."""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import Any

import pytest

from mantle.errors import InputError
from mantle.schema import config
from mantle.verification import closed_forms, problems, verify
from mantle.verification.measures import Sample
from mantle.verification.problem import CASES, Check, CheckRun

KEYS = {"name", "error", "tolerance", "order", "expected_order", "seconds", "passed"}


def written(folder: Path, pattern: str) -> list[dict[str, Any]]:
    name = f"verify-{pattern}" if pattern else "verify"
    entries: list[dict[str, Any]] = json.loads((folder / f"{name}.json").read_text())
    assert all(KEYS <= entry.keys() for entry in entries)
    assert (folder / f"{name}.png").stat().st_size > 5_000
    return entries


def test_a_ladder_of_runs(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Error, order, run time, table, picture; nothing is run twice."""
    caplog.set_level(logging.INFO, "mantle")
    assert verify.run("lame_plane_strain_3", tmp_path, fine=False, cores=2)
    (entry,) = written(tmp_path, "lame_plane_strain_3")
    assert entry["name"] == "lame_plane_strain_3"
    assert entry["passed"] is True
    assert 0 < entry["error"] < entry["tolerance"] == 0.005
    assert entry["expected_order"] == 2
    assert abs(entry["order"] - 2) < 0.2
    assert entry["seconds"] > 1
    assert entry["reference"] == pytest.approx(1.02740, abs=6e-6)
    assert entry["error"] == pytest.approx(abs(entry["value"] / entry["reference"] - 1))
    assert entry["sizes"] == sorted(entry["sizes"], reverse=True)
    assert entry["errors"] == sorted(entry["errors"], reverse=True)
    assert "lame_plane_strain_3" in caplog.text and "it passes" in caplog.text
    begin = len(caplog.text)
    assert verify.run("lame_plane_strain_3", tmp_path, fine=False, cores=2)
    assert "3 runs: 3 done already" in caplog.text[begin:]


def test_problems_without_a_ladder(tmp_path: Path) -> None:
    """Runs that are compared one by one, and a problem without any."""
    assert verify.run("uniaxial", tmp_path, fine=False, cores=2)
    entries = written(tmp_path, "uniaxial")
    assert [e["name"] for e in entries] == ["uniaxial_along_fibre", "uniaxial_across_fibre"]
    assert all(e["order"] is None and e["expected_order"] is None for e in entries)
    assert all(len(e["runs"]) == 2 for e in entries)
    assert verify.run("klarbring", tmp_path, fine=False, cores=1)
    (entry,) = written(tmp_path, "klarbring")
    assert entry["runs"] == [] and entry["reference"] == pytest.approx(1.25)


def test_what_fails_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A wrong number, and a run that fails; the others are measured all the same."""
    caplog.set_level(logging.INFO, "mantle")
    loose = (
        "interfaces.slope_block.friction_coefficient=0",
        "supports.push={kind: roller, boundary: top, axis: y}",
    )
    broken = Check(
        "incline_loose", "nothing holds it", 0.1, "incline.yaml", (CheckRun(loose, _never),)
    )
    everything = problems.problems()
    monkeypatch.setattr(verify, "problems", lambda fine: [broken, *everything])
    monkeypatch.setattr(closed_forms, "push_up", lambda slope, friction: 0.5)
    assert not verify.run("incline", tmp_path, fine=False, cores=2)
    loose, wrong = written(tmp_path, "incline")
    assert not loose["passed"] and loose["error"] is None
    assert "incline_loose" in loose["message"] and loose["message"] in caplog.text.replace(
        "\n  ", "\n"
    )
    assert not wrong["passed"] and wrong["error"] == pytest.approx(1 - 0.412371 / 0.5, rel=1e-5)
    assert "2 of 2 fail: incline_loose, incline" in caplog.text


def _never(run: object) -> Sample:
    raise AssertionError("a run that failed is not measured")


def test_a_wrong_order_fails() -> None:
    """However small the error."""

    def outcome(*errors: float) -> verify.CheckResult:
        points = tuple(CheckRun((), _never, h) for h in (1.0, 0.5, 0.25))
        problem = Check("ladder", "", 0.1, "none.yaml", points, 2.0)
        return verify.CheckResult(problem, tuple(Sample(1, 1, e) for e in errors), 0.0)

    assert outcome(0.16, 0.04, 0.01).order == pytest.approx(2)
    assert outcome(0.16, 0.04, 0.01).passed
    assert not outcome(0.04, 0.02, 0.01).passed
    assert not outcome(1.6, 0.4, 0.11).passed
    assert not outcome(0.1, 0.1, float("nan")).passed


def test_a_selection_leaves_the_results_of_the_whole_suite(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And where no picture can be drawn, that of other numbers does not stay."""
    one, two = (
        Check(name, "a number", 0.1, direct=lambda: Sample(1.0, 1.0, 0.01)) for name in "ab"
    )
    monkeypatch.setattr(verify, "problems", lambda fine: [one, two])
    assert verify.run("", tmp_path, fine=False, cores=1)
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    assert verify.run("a", tmp_path, fine=False, cores=1)
    assert [e["name"] for e in written(tmp_path, "a")] == ["a"]
    assert [e["name"] for e in written(tmp_path, "")] == ["a", "b"]
    assert {name: (tmp_path / name).read_bytes() for name in before} == before

    def broken(entries: object, path: Path) -> None:
        raise RuntimeError("no fonts")

    monkeypatch.setattr(verify, "picture", broken)
    with pytest.raises(RuntimeError):
        verify.run("", tmp_path, fine=False, cores=1)
    assert {p.name for p in tmp_path.iterdir()} == {"verify.json", "verify-a.json", "verify-a.png"}


def test_pattern_without_match_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no problem has this in its name.*hertz_line_pressure"):
        verify.run("herz", tmp_path, fine=False, cores=1)
    assert not list(tmp_path.iterdir())


def test_problems_are_well_posed() -> None:
    """Unique short names; cases that exist and say how to run them; ladders that go down."""
    for fine in (False, True):
        everything = problems.problems(fine)
        names = [p.name for p in everything]
        assert len(set(names)) == len(names) > 35
        assert max(map(len, names)) <= 26
        for p in everything:
            assert bool(p.points) != bool(p.direct)
            assert not p.points or f"run configs/verification/{p.case}" in _text(p.case)
            for point in p.points:
                config.load(CASES / p.case, point.overrides)
            sizes = [point.size for point in p.points]
            assert sizes == sorted(sizes, reverse=True)
            assert p.order is None or len(set(sizes)) == len(sizes) >= 3
    assert {p.case for p in everything} - {""} == {p.name for p in CASES.glob("*.yaml")}


def _text(case: str) -> str:
    return (CASES / case).read_text(encoding="utf-8")


@pytest.mark.slow
def test_all_pass(tmp_path: Path) -> None:
    """The default suite, some minutes on two cores."""
    assert verify.run("", tmp_path, fine=False, cores=2), [
        (e["name"], e["error"], e["order"], e["message"])
        for e in written(tmp_path, "")
        if not e["passed"]
    ]
