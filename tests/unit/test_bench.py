"""``mantle bench``: figures from made-up costs, and processes that are what they are."""

from __future__ import annotations

import csv
import json
import math
import resource
import sys
from pathlib import Path
from typing import Any

import pytest

from mantle import cli
from mantle.errors import InputError
from mantle.schema import config
from mantle.verification import bench, bench_picture
from mantle.verification.bench import Goal, growth, later_steps, spread, stance
from mantle.verification.bench_run import CASES, BenchCase, Cost, NotMeasured, Runs


def cost(
    solution: float = 1.0,
    unknowns: int = 1000,
    newton: int = 8,
    slip: tuple[float, float] = (1.0, 1.0),
    **more: Any,
) -> Cost:
    summary = {
        "solver": {"dofs": unknowns, "newton_iterations": newton, "linear_iterations": 10 * newton},
        "cpu": {"assemble": 0.2 * solution, "solve": 0.8 * solution, "mesh": 7.0, "output": 3.0},
        "timing": {"solve": 2 * solution, "compile": 50.0, "total": 99.0},
        "interfaces": {
            name: {"slip_p99": s, "penetration_max": 1e-3 * s}
            for name, s in zip(bench.INTERFACES, slip, strict=True)
        },
    }
    return Cost(wall=9.0, cpu=8.0, memory=700.0, summary=summary, **more)


class Made(Runs):
    """Costs by the name of a setting, in their order; notes what runs when."""

    def __init__(self, folder: Path, costs: dict[str, list[Cost]]) -> None:
        super().__init__(folder)
        self.costs_of, self.order = costs, list[str]()

    def _warm(self, setting: BenchCase) -> None:
        self.meshing[setting.mesh] = 1.0

    def _run(self, setting: BenchCase) -> Cost:
        self.order.append(setting.name)
        if not self.costs_of.get(setting.name):
            raise NotMeasured(f"{setting.name} failed with exit code 4")
        return self.costs_of[setting.name].pop(0)


def line(name: str) -> Goal:
    (found,) = [x for x in bench.lines(full=True) if x.name == name]
    return found


def test_solution_leaves_out_what_is_no_solution() -> None:
    assert cost(4.0).solution == pytest.approx(4.0)
    assert cost(4.0).solution_wall == pytest.approx(8.0)


def test_a_ratio_is_the_median_of_pairs_run_in_turn(tmp_path: Path) -> None:
    # The machine slows down threefold, and something disturbs one contact run and one bonded one:
    # the ratio of the medians would be 8 / 3.
    contact, bonded = [2.0, 90.0, 8.0], [1.0, 3.0, 40.0]
    runs = Made(
        tmp_path,
        {"contact_20k": [cost(t) for t in contact], "bonded_20k": [cost(t) for t in bonded]},
    )
    assert line("contact_over_bonded_20k").measure(runs) == pytest.approx(2.0)
    assert runs.order == ["contact_20k", "bonded_20k"] * 3


def test_what_was_run_is_not_run_again(tmp_path: Path) -> None:
    rungs = {f"contact_{r}": [cost(n, 1000 * n)] * 3 for n, r in enumerate(bench.RUNGS, start=1)}
    runs = Made(tmp_path, rungs)
    assert line("growth_exponent").measure(runs) == pytest.approx(1.0)
    assert line("newton_spread").measure(runs) == 0.0
    assert runs.order == ["contact_20k"] * 3 + ["contact_100k"] * 3 + [
        *("contact_170k", "contact_1m")
    ]


def test_growth_is_the_slope_of_median_times() -> None:
    sizes = (50_000, 100_000, 200_000, 1_000_000)
    ladder = [[cost(3e-6 * n**1.1, n)] * 2 + [cost(1e3, n)] for n in sizes]
    assert growth(ladder) == pytest.approx(1.1)


@pytest.mark.parametrize(("newton", "met"), [((7, 9, 13), True), ((7, 9, 14), False)])
def test_newton_may_go_three_up_and_down(newton: tuple[int, ...], met: bool) -> None:
    figure = spread([[cost(newton=n)] for n in newton])
    assert figure == (newton[-1] - newton[0]) / 2
    assert line("newton_spread").met(figure) is met


def test_ranks_are_compared_on_the_wall_and_asked_for_at_least(tmp_path: Path) -> None:
    runs = Made(tmp_path, {"contact_170k": [cost(9.0)], "contact_170k_2_ranks": [cost(5.0)]})
    ranks = line("ranks_2_over_1")
    assert ranks.measure(runs) == pytest.approx(1.8)
    assert ranks.met(1.8) and ranks.met(1.7) and not ranks.met(1.6)


def test_penetration_may_be_rounding_and_no_more() -> None:
    asked = line("stem_penetration")
    assert asked.asked == 0.0
    assert asked.met(1e-15) and not asked.met(1e-9)


def test_later_steps_over_the_first() -> None:
    rows = tuple({"step [s]": str(t)} for t in (8.0, 2.0, 3.0, 1.0))
    assert later_steps(cost(history=rows)) == pytest.approx(3 / 8)


def test_equal_error_is_found_between_two_runs() -> None:
    # First order: error 0.4, 0.2, 0.1 in 1, 4, 16 s (~ t^-1/2, so 0.15 in 64/9 s); the worse
    # interface counts.
    ones = [cost(t, slip=(1 - e, 1 + e / 2)) for t, e in ((1.0, 0.4), (4.0, 0.2), (16.0, 0.1))]
    two = cost(2.0, slip=(1.01, 0.85))
    assert bench.equal_error(two, ones, cost()) == pytest.approx(2 / (64 / 9))


@pytest.mark.parametrize(("error", "ratio"), [(0.01, 2 / 16), (0.5, 2 / 1)])
def test_equal_error_beyond_the_runs_is_against_the_nearest(error: float, ratio: float) -> None:
    ones = [cost(t, slip=(1 - e, 1.0)) for t, e in ((1.0, 0.4), (16.0, 0.1))]
    assert bench.equal_error(cost(2.0, slip=(1 - error, 1)), ones, cost()) == pytest.approx(ratio)


def test_what_fails_is_told_and_the_others_are_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    costs = {"stem": [cost(4.0, slip=(0.0, 0.0))] * 3}
    monkeypatch.setattr(bench, "Runs", lambda folder: Made(folder, costs))
    monkeypatch.setattr(bench, "picture", lambda rows, path: False)
    assert bench.run("stem", tmp_path, full=False)
    entries = json.loads((tmp_path / "bench.json").read_text())
    assert entries == [
        {"name": "stem_cpu", "figure": 4.0, "asked": 5.0, "unit": "s", "met": True},
        {"name": "stem_memory", "figure": 700.0, "asked": 500.0, "unit": "MB", "met": False},
        {"name": "stem_penetration", "figure": 0.0, "asked": 0.0, "unit": "mm", "met": True},
    ]
    (row,) = csv.DictReader((tmp_path / "bench.csv").read_text().splitlines())
    assert (row["name"], row["runs"], row["solution [CPU s]"]) == ("stem", "3", "4.0")

    runs = Made(tmp_path, {"contact_20k": [cost()] * 3})
    monkeypatch.setattr(bench, "Runs", lambda folder: runs)
    assert not bench.run("0k", tmp_path, full=False)
    entries = json.loads((tmp_path / "bench.json").read_text())
    assert len(entries) == 5
    assert all(e["figure"] is None and e["met"] is False for e in entries)
    assert "contact_over_bonded_20k cannot be measured: bonded_20k failed with exit" in caplog.text
    # What has failed is not tried again.
    assert bench.measure(line("contact_over_bonded_20k"), runs).figure is None
    assert runs.order.count("bonded_20k") == 1


def test_what_a_run_does_not_tell_is_no_figure(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    outcome = bench.measure(
        line("later_load_steps"),
        Made(tmp_path, {"load_steps": [cost(history=({"wall [s]": "1"},))]}),
    )
    assert outcome.figure is None
    assert "step [s]" in caplog.text


def test_a_name_that_no_line_has(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"allowed: stem_cpu, .*million_minutes"):
        bench.run("nothing", tmp_path, full=False)


@pytest.mark.parametrize(("measured", "code"), [(True, 0), (False, 1)])
def test_exit_code(measured: bool, code: int, monkeypatch: pytest.MonkeyPatch) -> None:
    called = []

    def run(pattern: str, folder: Path, full: bool) -> bool:
        called.append((pattern, folder, full))
        return measured

    monkeypatch.setattr(bench, "run", run)
    assert cli.main(["bench", "-k", "stem", "-o", "there", "--full"]) == code
    assert called == [("stem", Path("there"), True)]


def test_every_line_runs_cases_that_are_right(tmp_path: Path) -> None:
    """Each case that any line asks for can be read, and is of the kind that its name says."""
    seen: dict[str, BenchCase] = {}

    class Looked(Runs):
        def _warm(self, setting: BenchCase) -> None:
            seen[setting.name] = setting

        def _run(self, setting: BenchCase) -> Cost:
            return cost(unknowns=1000 * len(seen), history=({"step [s]": "1"},) * 2)

        def process(self, name: str, command: Any) -> Cost:
            return cost()

    looked = Looked(tmp_path)
    lines = bench.lines(full=True)
    for each in lines:
        each.measure(looked)
    assert {x.name for x in lines} >= {x.name for x in bench.lines(full=False)}
    cases = {}
    for name, s in seen.items():
        path, *sets = s.options
        cases[name] = config.load(Path(path), sets[1::2])
    for name, case in cases.items():
        first = name.partition("_")[0]
        assert case.mesh.order == (2 if first == "order" or first == "cylinders" else 1), name
        if first in ("contact", "bonded", "stem"):
            kinds = {type(i) for i in case.interfaces.values()}
            assert kinds == {config.Bonded if "bonded" in name else config.Contact}, name
            assert not case.output.error
    twelve = seen["variations"]
    path, *sets = twelve.options
    assert len(config.variations(Path(path), sets[1::2])) == 12
    assert [s.increments for s in cases["load_steps"].stages] == [1, 3]
    assert seen["contact_170k_2_ranks"].ranks == 2
    assert seen["stem_moderate_50k"].mesh != seen["stem"].mesh != seen["stem_bonded_50k"].mesh


def test_the_stem_is_as_described() -> None:
    case = config.load(CASES / "bench" / "stem.yaml")
    g = case.geometry
    assert isinstance(g, config.Cylinders)
    radii = (8.0, 12.0, 18.0)
    assert g.stem_radius == radii[0]
    assert g.stem_radius + g.cement_thickness == radii[1]
    assert radii[1] + g.bone_thickness == radii[2]
    assert math.degrees(g.taper) == pytest.approx(2.5)
    assert (g.length, g.sector, case.mesh.order) == (80.0, "full", 1)


def test_a_process_is_measured(tmp_path: Path) -> None:
    # 300 MB are touched, 1 s is slept, and CPU time is spent until there are 0.3 s of it.
    code = (
        "import time; b = b'x' * 300_000_000; time.sleep(1)\nwhile time.process_time() < 0.3: pass"
    )
    measured = Runs(tmp_path).process("busy", [sys.executable, "-c", code])
    # A child's peak counts that of the process it is forked from, here of all tests before.
    tests = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
    assert 300 < measured.memory < max(400, 1.1 * tests)
    assert 0.3 <= measured.cpu < measured.wall - 0.9


def test_a_process_that_fails_says_why(tmp_path: Path) -> None:
    code = "import sys; print('because of this'); sys.exit(4)"
    with pytest.raises(NotMeasured, match=r"exit code 4, see .*bad\.log:\nbecause of this"):
        Runs(tmp_path).process("bad", [sys.executable, "-c", code])


def test_a_run_is_measured(tmp_path: Path) -> None:
    ((measured,),) = Runs(tmp_path).costs(BenchCase("blocks", "blocks.yaml"))
    assert 0 < measured.solution < measured.cpu
    assert measured.newton > 0 and measured.unknowns > 100
    assert len(measured.history) == measured.summary["solver"]["steps"]
    assert 100 < measured.memory < 2000


def test_the_picture(tmp_path: Path) -> None:
    runs = Made(tmp_path, {})
    for kind in ("contact", "bonded"):
        for rung, n in (("20k", 20_000), ("100k", 100_000)):
            runs.known[stance(kind, rung)] = [cost(n / 1e4, n)]
            runs.meshing[stance(kind, rung).mesh] = 1.0
    path = tmp_path / "bench.png"
    assert bench_picture.picture(bench.points(runs), path)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert not bench_picture.picture([], tmp_path / "none.png")
    assert not (tmp_path / "none.png").exists()
