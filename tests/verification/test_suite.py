"""`mantle verify`, `stress` and `bench`: verdicts on problems, solved runs and written files."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path

import pytest

from app import cli
from app.campaigns import batch
from app.campaigns.batch import Options
from app.campaigns.runs import Result
from app.case.case import PlannedRun
from app.foundation.errors import InputError
from app.verification import picture, problem, suite
from app.verification.problem import Row

LOOSE = "no convergence: it is loose [loose-body]"
KEYS = {"name", "group", "outcome", "error", "tolerance", "order", "seconds", "message", "runs"}
HEAD = """
from math import inf, nan

import pytest

from app.foundation.verdict import Reason
from app.verification.problem import Comparison, ProblemRun, bench, long, quick, verify
"""
CONFTEST = "from app.verification.problems.conftest import *\n"
# A number compared without a run.
COMPARED = """
@verify
def test_{name}(problem):
    problem.expects("a number", tolerance=1e-6, source="known")
    problem.compare(Comparison({error}, note="as it is"))
"""


@pytest.fixture
def problems(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder for problems of the user that replaces the program's."""
    folder = tmp_path / "problems"
    folder.mkdir()
    (folder / "conftest.py").write_text(CONFTEST)
    monkeypatch.setattr(suite, "PROBLEMS", folder)
    return folder


def write(problems: Path, text: str) -> None:
    # Names of modules are unique, as modules stay imported.
    (problems / f"test_{problems.parent.name}.py").write_text(HEAD + text)


def rows(folder: Path, name: str = "verify") -> dict[str, dict[str, object]]:
    entries = json.loads((folder / f"{name}.json").read_text())
    return {entry["name"]: entry for entry in entries}


OK = (0, "")


@pytest.mark.parametrize(
    ("answer", "ends", "outcome", "words"),
    [
        ("compare(Comparison(9e-7))", [OK], "passed", ""),
        # Never because it converged.
        ("compare(Comparison(2e-6))", [OK], "missed", ""),
        ("compare(Comparison(nan))", [OK], "missed", ""),
        ("compare(Comparison(inf))", [OK], "missed", ""),
        ("no answer", [OK], "missed", "there is no answer"),
        # By its reason, not by words, which may change; and with the exit code of a refusal.
        ("no answer", [(4, "any\n  [loose-body] words\n  to change: all")], "refused", "any"),
        ("no answer", [(2, "supports: other words [loose-body]")], "refused", "other words"),
        ("no answer", [(4, "nothing holds body 'stem'")], "failed", "nothing holds"),
        ("no answer", [(4, "may not be unique there [not-unique]")], "failed", "unique"),
        ("no answer", [(70, LOOSE)], "failed", LOOSE),
        ("no answer", [(5, "stopped: nothing holds [loose-body]")], "failed", "stopped"),
        # Not where there is an answer: of the run, or of what it is compared with.
        ("compare(Comparison(0.0))", [(4, LOOSE)], "failed", LOOSE),
        ("may refuse", [OK, (4, LOOSE)], "failed", LOOSE),
        ("may refuse", [(4, LOOSE), OK], "refused", LOOSE),
        ("compare(Comparison(run.nonsense))", [OK], "failed", "nonsense"),
    ],
)
def test_suite_outcomes(
    problems: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    answer: str,
    ends: list[tuple[int, str]],
    outcome: str,
    words: str,
) -> None:
    """A problem has this answer, and its runs end in this way."""
    expects = 'problem.expects("a number", tolerance=1e-6, source="known")'
    if answer == "no answer":
        expects = 'problem.expects_refusal("a number", Reason.FLOATING_BODY)'
    elif answer == "may refuse":
        expects = expects.replace('known")', 'known", or_refusal=Reason.FLOATING_BODY)')
    if answer in ("no answer", "may refuse"):
        answer = "compare(Comparison(0.0))"
    runs = [("mesh.size=4 mm",), ("mesh.size=5 mm",)][: len(ends)]
    write(
        problems,
        f"""
@verify
def test_row(problem):
    {expects}
    run, *_ = problem.solve_each("blocks.yaml", {runs})
    problem.{answer}
""",
    )

    def run(planned: Sequence[PlannedRun], folder: Path, *_: object) -> list[Result]:
        return [
            Result(job, folder, code, 1.5, {}, message)
            for job, (code, message) in zip(planned, ends, strict=True)
        ]

    monkeypatch.setattr(batch, "run", run)
    monkeypatch.setattr(problem, "Run", lambda folder: folder)
    good = suite.run("verify", Options(tmp_path, 1))
    assert good == (outcome in ("passed", "refused"))
    entry = rows(tmp_path)["row"]
    assert entry["outcome"] == outcome
    assert words in str(entry["message"])
    assert entry["seconds"] == 1.5


@pytest.mark.parametrize(
    ("errors", "outcome"),
    [
        ((0.16, 0.04, 0.01), "passed"),
        ((0.04, 0.02, 0.01), "missed"),  # of first order
        ((1.6, 0.4, 0.11), "missed"),
        ((0.1, 0.1, float("nan")), "missed"),
    ],
)
def test_suite_wrong_order_misses(
    problems: Path, tmp_path: Path, errors: tuple[float, ...], outcome: str
) -> None:
    """The error may be small. The finest run counts."""
    write(
        problems,
        f"""
@verify
def test_row(problem):
    problem.expects("a number", tolerance=0.1, order=2.0, source="known")
    problem.rungs((1.0, 0.5, 0.25), finest="quick")
    problem.converges([Comparison(error) for error in {errors}])
""",
    )
    assert suite.run("verify", Options(tmp_path, 1)) == (outcome == "passed")
    assert rows(tmp_path)["row"]["outcome"] == outcome


def test_suite_worst_comparison_counts(problems: Path, tmp_path: Path) -> None:
    write(
        problems,
        """
@verify
@pytest.mark.parametrize("errors", [(0.01, 0.02), (0.2, 0.02), (0.01, nan)], ids=["a", "b", "c"])
def test_row(problem, errors):
    problem.expects("a number", tolerance=0.1, source="known")
    problem.compare(*map(Comparison, errors))
""",
    )
    suite.run("verify", Options(tmp_path, 1))
    outcomes = {name: entry["outcome"] for name, entry in rows(tmp_path).items()}
    assert outcomes == {"row_a": "passed", "row_b": "missed", "row_c": "missed"}


def test_suite_table_verdict_picture_and_json(tmp_path: Path) -> None:
    errors = (9e-7, 0.0, 1e-12, 2e-6, float("inf"), float("nan"))
    compared = [
        Row(
            f"row_{k}",
            "row",
            quantity="a number",
            source="known",
            tolerance=1e-6,
            comparison=problem.Comparison(error, 1.0, 1.0 + error),
            outcome="passed" if error < 1e-6 else "missed",
        )
        for k, error in enumerate(errors)
    ]
    refused = Row("row_6", "row", outcome="refused", message=LOOSE)
    broken = Row("row_7", "row", outcome="failed", message=f"one: exit code 70: {LOOSE}")
    everything = [*compared, refused, broken]
    text = suite.table_of_rows(everything)
    first = text.splitlines()[1].split()
    assert first == [
        "row_0",
        "1",
        "1",
        "9.00e-07",
        "1.0e-06",
        "0.0",
        "passed",
        "a",
        "number",
        "known",
    ]
    assert f"row_7 failed: one: exit code 70: {LOOSE}" in text
    others = "row_3, row_4, row_5, row_7"
    expected = f"8 problems: 3 passed, 1 refused, 3 missed, 1 failed: {others}"
    assert suite.summary_line(everything) == expected
    other = Row("b", "b", tolerance=1.0, comparison=problem.Comparison(0.0), outcome="passed")
    assert suite.table_of_rows([*everything, other]).splitlines()[-4].split()[:2] == ["row", "8"]
    picture.draw(everything, tmp_path / "a.png")
    entries = [suite.json_of_row(row) for row in everything]
    assert all(entry.keys() >= KEYS for entry in entries)
    json.loads(json.dumps(entries, allow_nan=False))
    assert (tmp_path / "a.png").stat().st_size > 5_000


def test_suite_selection_keeps_results_of_the_whole_suite(
    problems: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If no picture can be drawn, the picture of other numbers is removed."""
    marks = {"a": "@quick", "b": "", "c": "@long"}
    texts = [mark + COMPARED.format(name=name, error=1e-7) for name, mark in marks.items()]
    write(problems, "\n".join(texts))
    out = tmp_path / "out"
    assert suite.run("verify", Options(out, 1))
    before = {p.name: p.read_bytes() for p in out.iterdir()}
    assert suite.run("verify", Options(out, 1, "a"))
    assert suite.run("verify", Options(out, 1, tier="quick"))
    assert suite.run("verify", Options(out, 1, tier="long"))
    assert [*rows(out, "verify-a")] == ["a"]
    assert [*rows(out, "verify-quick")] == ["a"]
    assert [*rows(out)] == ["a", "b"]
    assert [*rows(out, "verify-long")] == ["a", "b", "c"]
    assert {name: (out / name).read_bytes() for name in before} == before

    def broken(entries: object, path: Path) -> None:
        raise RuntimeError("no fonts")

    monkeypatch.setattr(picture, "draw", broken)
    with pytest.raises(RuntimeError):
        suite.run("verify", Options(out, 1))
    assert not (out / "verify.png").exists()


def test_suite_missed_goal_is_a_result(problems: Path, tmp_path: Path) -> None:
    write(problems, COMPARED.format(name="slow", error=1.0).replace("@verify", "@bench"))
    assert suite.run("bench", Options(tmp_path, 1))
    assert rows(tmp_path, "bench")["slow"]["outcome"] == "missed"


def test_suite_raises_errors_of_problem_modules(problems: Path, tmp_path: Path) -> None:
    write(problems, "import no_such_module\n")
    with pytest.raises(RuntimeError, match="no_such_module"):
        suite.run("verify", Options(tmp_path, 1))


@pytest.mark.parametrize("name", ["verify", "stress", "bench"])
def test_suite_pattern_without_match_is_an_input_error(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no problem of this tier has this in its name; allowed"):
        suite.run(name, Options(tmp_path, 1, "agumentation"))
    assert not list(tmp_path.iterdir())


def test_suite_options(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[tuple[object, ...]] = []

    def run(*arguments: object) -> bool:
        given.append(arguments)
        return len(given) < 3

    monkeypatch.setattr(suite, "run", run)
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


TIMED = """
@bench
def test_one(problem):
    problem.expects("a time", tolerance=1.0, source="goal")
    runs = problem.solve_all([ProblemRun("blocks.yaml", times=2), ProblemRun("cylinders.yaml")])
    problem.compare(Comparison(9.0, note=" ".join(runs)))


@bench
def test_other(problem):
    problem.expects("a time", tolerance=1.0, source="goal")
    problem.solve_all([ProblemRun("blocks.yaml", times=2), ProblemRun("cylinders.yaml")])
    problem.compare(Comparison(0.0))
"""


def test_suite_timed_problems_run_in_turn(
    problems: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Problems run one after the other. Each run is repeated as often as it says.

    A judge gets the times by run.
    """
    called = []

    def run(planned: Sequence[PlannedRun], folder: Path, *_: object) -> list[Result]:
        called.append([job.name for job in planned])
        assert all(job.needs_idle_machine for job in planned)
        summary = {"solver": {"dofs": 7}, "cpu": {"solve": 2.0, "mesh": 9.0}}
        return [Result(job, folder / job.name, 0, 1.0, summary, "") for job in planned]

    monkeypatch.setattr(batch, "run", run)
    monkeypatch.setattr(problem, "Run", lambda folder: str(folder.relative_to(tmp_path)))
    write(problems, TIMED)
    assert suite.run("bench", Options(tmp_path, 2))
    assert called == [["one_1", "one_2"], ["one_1"]]
    assert rows(tmp_path, "bench")["one"]["note"] == "one_1 again-1/one_1 one_2"
    table = list(csv.DictReader((tmp_path / "bench.csv").read_text().splitlines()))
    assert [r["solution [CPU s]"] for r in table] == ["2.0"] * 3
    assert table[0]["unknowns"] == "7"


def test_suite_judges_a_run_that_cannot_start(problems: Path, tmp_path: Path) -> None:
    """The verdict is that of a run that ended with this error."""
    write(
        problems,
        """
@verify
def test_row(problem):
    problem.expects("a number", tolerance=1.0, source="known")
    problem.solve("blocks.yaml", "mesh.size=-1 mm")
""",
    )
    assert not suite.run("verify", Options(tmp_path, 1))
    entry = rows(tmp_path)["row"]
    assert entry["outcome"] == "failed"
    assert "must be positive" in str(entry["message"])


@pytest.mark.slow
def test_suite_stress_from_end_to_end(tmp_path: Path) -> None:
    """One case has an exact answer for any friction. The other has a body that nothing holds."""
    for pattern, outcome, count in (
        ("friction_incline", "passed", 3),
        ("floating_no_support", "refused", 1),
        ("friction_bar_pulled_off_0.3", "refused", 1),
    ):
        assert suite.run("stress", Options(tmp_path, 2, pattern))
        entries = list(rows(tmp_path, f"stress-{pattern}").values())
        assert [entry["outcome"] for entry in entries] == [outcome] * count
        assert (tmp_path / f"stress-{pattern}.png").stat().st_size > 5_000
    assert "nothing holds body 'bar'" in str(entries[0]["message"])
