"""``mantle bench``: what frictional contact costs, over a ladder of sizes, beside what is asked.

Ratios are of runs made in turn in one call; CPU time is that of assembly, set-up and solution with
coarse problems included, without making the mesh, compiling forms and writing results.
"""

from __future__ import annotations

import logging
import math
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

from mantle.campaigns.work_precision import fitted_order
from mantle.errors import InputError
from mantle.system.folders import csv_text, write_json, write_text
from mantle.verification.bench_picture import picture
from mantle.verification.bench_run import BenchCase, Cost, NotMeasured, Runs

log = logging.getLogger("mantle")

BUSY = 0.5  # load of the machine beside a benchmark
TIMES = 3  # of which the median is taken, where that is cheap
# Mesh sizes of the femur, by about how many unknowns they give at first order.
RUNGS = {"20k": "2.8 mm", "100k": "2.4 mm", "170k": "1.3 mm", "1m": "1 mm"}
DEFAULT, FULL = ("20k", "100k", "170k"), ("1m",)
CHEAP = ("20k", "50k", "100k")
STANCE = ("output.error=false", "stages.0.increments=1")
FIRST_ORDER = ("mesh.order=1", *STANCE)
INTERFACES = ("stem_cement", "cement_bone")
BONDED = tuple(f"interfaces.{name}={{kind: bonded}}" for name in INTERFACES)
# The stem a little too large for its hole: a quarter of its points slip, no others.
STEM = "bench/stem.yaml"
STEM_RUNGS = {"50k": "1.79 mm", "100k": "1.35 mm"}
MODERATE = ("interfaces.stem_cement.gap=-0.004 mm",)
# Twelve cases of one mesh and stiffness: friction by hip force.
TWELVE = (
    "variations={grid: {interfaces.stem_cement.friction_coefficient: [0.2, 0.3, 0.4, 0.6], "
    "loads.hip.history: [[0.8], [1.0], [1.2]]}}"
)
# All loads at once, then the hip's alone by a tenth more in each of three steps: all in proportion
# would leave nothing to do after the first.
STEPS = (
    "stages=[{name: stance, adaptive: false}, {name: more, increments: 3, adaptive: false}]",
    "loads.hip.history=[1, 1.3]",
)
# Half an hour of setting cement, and the same time steps of conduction through bonded regions.
HALF_AN_HOUR = ("stages=[{name: setting, duration: 30 min, increments: 60, adaptive: false}]",)
CONDUCTION = (
    "regions.cement.thermal.cure=",
    *(f"interfaces.{name}.conductance=perfect" for name in INTERFACES),
)
# Second order: what is timed, and what it and first order are compared with.
SECOND, REFERENCE = "5 mm", "3 mm"
# Penetration that is rounding [mm].
ROUNDING = 1e-12


@dataclass(frozen=True)
class Goal:
    """A figure to be reached.

    Attributes:
        name: Its name.
        asked: What it should be at most.
        unit: Its unit.
        measure: Gives the figure.
        at_least: Whether `asked` is the least it should be instead.
        rounding: What may be added to or taken from it.
    """

    name: str
    asked: float
    unit: str
    measure: Callable[[Runs], float]
    at_least: bool = False
    rounding: float = 0.0

    def met(self, figure: float) -> bool:
        """Whether a figure is as asked."""
        if self.at_least:
            return figure >= self.asked - self.rounding
        return figure <= self.asked + self.rounding


@dataclass(frozen=True)
class BenchResult:
    """Result of a line.

    Attributes:
        line: The line.
        figure: What was measured; None if it could not be.
    """

    line: Goal
    figure: float | None

    @property
    def met(self) -> bool:
        """Whether it is as asked."""
        return self.figure is not None and self.line.met(self.figure)

    def as_json(self) -> dict[str, Any]:
        """The entry of bench.json."""
        figure = None if self.figure is None else float(f"{self.figure:.4g}")
        line = self.line
        return {
            "name": line.name,
            "figure": figure,
            "asked": line.asked,
            "unit": line.unit,
            "met": self.met,
        }


def run(pattern: str, folder: Path, full: bool) -> bool:
    """Measure, and write ``bench.json``, ``bench.csv`` and ``bench.png``.

    Args:
        pattern: Part of the names of the lines wanted; empty for all.
        folder: Where results and runs go.
        full: Whether a million unknowns are solved too.

    Returns:
        Whether every line could be measured; one that is not reached is a result too.

    Raises:
        InputError: No line has such a name, or the folder cannot be written.
    """
    chosen = [line for line in lines(full) if pattern in line.name]
    if not chosen:
        names = ", ".join(line.name for line in lines(True))
        raise InputError(f"-k {pattern}: no line has this in its name; allowed: {names}")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"-o {folder}: cannot be made: {error.strerror}") from error
    if (load := os.getloadavg()[0]) > BUSY:
        log.warning("the machine is busy (load %.1f): measured times will be too long", load)
    runs = Runs(folder / "runs")
    outcomes = []
    for line in chosen:
        outcomes.append(measure(line, runs))
        # An interrupted benchmark leaves what it has.
        write_json(folder / "bench.json", [o.as_json() for o in outcomes])
    rows = points(runs)
    write_text(folder / "bench.csv", csv_text(rows))
    picture(rows, folder / "bench.png")
    log.info("%s\nwritten in %s: bench.json, bench.csv, bench.png", table(outcomes), folder)
    return all(o.figure is not None for o in outcomes)


def measure(line: Goal, runs: Runs) -> BenchResult:
    """Measure a line; a failure is logged and gives no number."""
    try:
        figure = line.measure(runs)
        if math.isfinite(figure):
            return BenchResult(line, figure)
        log.warning("%s cannot be measured: it is %s", line.name, figure)
    except NotMeasured as error:
        log.warning("%s cannot be measured: %s", line.name, error)
    except KeyError as error:
        log.warning("%s cannot be measured: the summaries of its runs have no %s", line.name, error)
    return BenchResult(line, None)


def lines(full: bool) -> list[Goal]:
    """Every line, those of a million unknowns last.

    Args:
        full: Whether those are wanted.
    """
    rungs = (*DEFAULT, *FULL) if full else DEFAULT
    found = [
        Goal("stem_cpu", 5.0, "s", lambda runs: median(c.solution for c in _stem(runs))),
        Goal("stem_memory", 500.0, "MB", lambda runs: median(c.memory for c in _stem(runs))),
        Goal("stem_penetration", 0.0, "mm", _penetration, rounding=ROUNDING),
        *(Goal(f"contact_over_bonded_{r}", 2.5, "-", partial(_contact, r)) for r in rungs),
        *(Goal(f"moderate_over_bonded_{r}", 1.5, "-", partial(_moderate, r)) for r in STEM_RUNGS),
        Goal("growth_exponent", 1.15, "-", lambda runs: growth(_ladder(runs, rungs))),
        Goal("newton_spread", 3.0, "-", lambda runs: spread(_ladder(runs, rungs))),
        Goal("ranks_2_over_1", 1.7, "-", _ranks, at_least=True),
        Goal("variations_12", 2.5, "-", _variations),
        Goal("later_load_steps", 0.5, "-", _load_steps),
        Goal("order_2_over_1", 1.0, "-", _orders),
        Goal("cure_over_conduction", 3.0, "-", _cure),
        Goal("cylinders_start_to_finish", 3.0, "-", _cylinders),
    ]
    if full:
        found += [
            Goal("million_memory", 12.0, "GB", lambda runs: _million(runs).memory / 1e3),
            Goal("million_minutes", 5.0, "min", lambda runs: _million(runs).wall / 60),
        ]
    return found


def stance(kind: str, rung: str, ranks: int = 1) -> BenchCase:
    """The femur at first order, its interfaces in contact or bonded."""
    name = f"{kind}_{rung}" + (f"_{ranks}_ranks" if ranks > 1 else "")
    bonded = BONDED if kind == "bonded" else ()
    return BenchCase(name, "stance.yaml", RUNGS[rung], (*FIRST_ORDER, *bonded), ranks)


def stem(kind: str, rung: str) -> BenchCase:
    """The press-fitted stem, its interfaces in contact or bonded."""
    overrides = BONDED if kind == "bonded" else MODERATE
    sized = ("mesh.size", "mesh.far_size")
    return BenchCase(f"stem_{kind}_{rung}", STEM, STEM_RUNGS[rung], overrides, sized=sized)


def _times(rung: str) -> int:
    return TIMES if rung in CHEAP else 1


def _stem(runs: Runs, times: int = TIMES) -> list[Cost]:
    return runs.costs(BenchCase("stem", STEM), times=times)[0]


def _penetration(runs: Runs) -> float:
    return max(max(c.interfaces("penetration_max").values()) for c in _stem(runs, 1))


def _contact(rung: str, runs: Runs) -> float:
    return _ratio(runs, stance("contact", rung), stance("bonded", rung), _times(rung))


def _moderate(rung: str, runs: Runs) -> float:
    return _ratio(runs, stem("moderate", rung), stem("bonded", rung), _times(rung))


def _ratio(runs: Runs, one: BenchCase, other: BenchCase, times: int) -> float:
    """CPU time beside that of another, run in turn."""
    both = runs.costs(one, other, times=times)
    return median(a.solution / b.solution for a, b in zip(*both, strict=True))


def _ladder(runs: Runs, rungs: Sequence[str]) -> list[list[Cost]]:
    """Contact from rung to rung."""
    return [runs.costs(stance("contact", r), times=_times(r))[0] for r in rungs]


def growth(ladder: Sequence[Sequence[Cost]]) -> float:
    """The p of time ~ unknowns^p by least squares in logarithms, of median times."""
    times = [median(c.solution for c in rung) for rung in ladder]
    return fitted_order([rung[0].unknowns for rung in ladder], times)


def spread(ladder: Sequence[Sequence[Cost]]) -> float:
    """How far Newton iterations go up and down from the middle of their range."""
    newton = [c.newton for rung in ladder for c in rung]
    return (max(newton) - min(newton)) / 2


def _ranks(runs: Runs) -> float:
    """How much shorter the largest rung of the default is on two ranks."""
    one, two = runs.costs(stance("contact", DEFAULT[-1]), stance("contact", DEFAULT[-1], 2))
    return one[0].solution_wall / two[0].solution_wall


def _variations(runs: Runs) -> float:
    """Twelve cases in one run over one of them, start to finish."""
    one = stance("contact", CHEAP[-1])
    twelve = BenchCase("variations", one.case, one.size, (*one.overrides, TWELVE))
    (together,), (alone,) = runs.costs(twelve, one)
    return together.cpu / alone.cpu


def _load_steps(runs: Runs) -> float:
    """The longest later load step over the first."""
    one = stance("contact", CHEAP[-1])
    ((cost,),) = runs.costs(BenchCase("load_steps", one.case, one.size, (*one.overrides, *STEPS)))
    return later_steps(cost)


def later_steps(cost: Cost) -> float:
    """The longest later load step of a run over its first."""
    first, *later = cost.step_seconds
    return max(later) / first


def _orders(runs: Runs) -> float:
    """Second order over first at equal error of slip."""
    second = BenchCase("order_2", "stance.yaml", SECOND, STANCE)
    reference = BenchCase("order_2_reference", "stance.yaml", REFERENCE, STANCE)
    (two,), (best,) = runs.costs(second, reference)
    return equal_error(two, [rung[0] for rung in _ladder(runs, DEFAULT)], best)


def equal_error(two: Cost, ones: Sequence[Cost], reference: Cost) -> float:
    """Time of a run over that of others of the same case at the same error of slip_p99.

    Args:
        two: The run.
        ones: The others, from coarse to fine.
        reference: The run that errors are against.

    Returns:
        The ratio, by the straight line in logarithms between the two others about it. Where none of
        the others is as good, the last is taken: one as good takes longer, the ratio is smaller.
    """

    def error(cost: Cost) -> float:
        have, known = cost.interfaces("slip_p99"), reference.interfaces("slip_p99")
        return max(abs(have[name] / known[name] - 1) for name in known)

    wanted = error(two)
    k = next((k for k, one in enumerate(ones) if error(one) <= wanted), None)
    if not k:
        return two.solution / ones[-1 if k is None else 0].solution
    worse, better = ones[k - 1], ones[k]
    part = math.log(wanted / error(worse)) / math.log(error(better) / error(worse))
    return two.solution / (worse.solution * (better.solution / worse.solution) ** part)


def _cure(runs: Runs) -> float:
    """Setting cement over the same time steps of bonded conduction."""
    cure = BenchCase("cure", "cure.yaml", overrides=HALF_AN_HOUR)
    conduction = BenchCase("conduction", "cure.yaml", overrides=(*HALF_AN_HOUR, *CONDUCTION))
    return _ratio(runs, cure, conduction, TIMES)


def _cylinders(runs: Runs) -> float:
    """A small case start to finish over importing the library that it needs, in turn."""
    ratios = []
    for i in range(TIMES):
        library = runs.process("import", [sys.executable, "-c", "import dolfinx"])
        (costs,) = runs.costs(BenchCase("cylinders", "cylinders.yaml"), times=i + 1)
        ratios.append(costs[i].wall / library.wall)
    return median(ratios)


def _million(runs: Runs) -> Cost:
    return runs.costs(stance("contact", FULL[-1]))[0][0]


def points(runs: Runs) -> list[dict[str, Any]]:
    """A row of bench.csv for every setting that was run: medians, where it was run often."""
    rows = []
    for setting, costs in runs.known.items():
        if not costs[0].summary:
            continue
        rows.append(
            {
                "name": setting.name,
                "ranks": setting.ranks,
                "runs": len(costs),
                "unknowns": costs[0].unknowns,
                "newton": costs[0].newton,
                "krylov": costs[0].krylov,
                "solution [CPU s]": round(median(c.solution for c in costs), 3),
                "whole run [s]": round(median(c.wall for c in costs), 3),
                "mesh [s]": round(runs.meshing[setting.mesh], 3),
                "memory [MB]": round(median(c.memory for c in costs), 1),
            }
        )
    return rows


def table(outcomes: Sequence[BenchResult]) -> str:
    """Figures beside what is asked."""
    width = max(len(o.line.name) for o in outcomes)
    text = [f"{'benchmark':<{width}} {'figure':>9} {'asked':>12}  unit"]
    for o in outcomes:
        figure = "-" if o.figure is None else f"{o.figure:.3g}"
        asked = f"{'at least' if o.line.at_least else 'at most'} {o.line.asked:g}"
        verdict = "" if o.met else "  not measured" if o.figure is None else "  missed"
        text.append(f"{o.line.name:<{width}} {figure:>9} {asked:>12}  {o.line.unit:<4}{verdict}")
    met = sum(o.met for o in outcomes)
    return "\n".join([*text, f"{met} of {len(outcomes)} reached"])
