"""The checks of ``mantle bench``: the cost of frictional contact against its targets.

CPU time is that of assembly, set-up and solution with coarse problems included, without making the
mesh, compiling forms and writing results. Ratios are of runs made in turn.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import groupby, product
from statistics import median

import numpy as np

from app.campaigns.work_precision import fitted_order
from app.results.reading import Run
from app.verification.check import Check, CheckRun, Judge, Sample

# Mesh sizes of the femur, by about how many unknowns they give at first order.
RUNGS = {"20k": "2.8 mm", "100k": "2.4 mm", "170k": "1.3 mm", "1m": "1 mm"}
TIMES = 3  # of which the median is taken, where that is cheap
CHEAP = ("20k", "50k", "100k")
# Where bonded interfaces are so cheap that contact may take twice as long.
SMALL = ("20k", "50k")
LONG = "1m"
STANCE = ("output.error=false", "stages.0.increments=1")
INTERFACES = ("stem_cement", "cement_bone")
BONDED = tuple(f"interfaces.{name}={{kind: bonded}}" for name in INTERFACES)
# The stem a little too large for its hole: a quarter of its points slip, no others.
STEM = "bench/stem.yaml"
STEM_RUNGS = {"50k": "1.79 mm", "100k": "1.35 mm"}
MODERATE = ("interfaces.stem_cement.gap=-0.004 mm",)
# Twelve cases of one mesh and stiffness: friction by hip force.
TWELVE = tuple(
    (f"interfaces.stem_cement.friction_coefficient={μ}", f"loads.hip.history=[{force}]")
    for μ, force in product((0.2, 0.3, 0.4, 0.6), (0.8, 1.0, 1.2))
)
# All loads at once, then the hip's alone by a tenth more in each of three steps: all in proportion
# would leave nothing to do after the first.
STEPS = (
    "stages=[{name: stance, adaptive: false}, {name: more, increments: 3, adaptive: false}]",
    "loads.hip.history=[1, 1.3]",
)
# Ten times to the stance and back to a tenth of it.
TEN = "stages=[{name: walking, cycles: 10, valley: 0.1}]"
# Half an hour of setting cement, and the same time steps of conduction through bonded regions.
HALF_AN_HOUR = "stages=[{name: setting, duration: 30 min, increments: 60, adaptive: false}]"
CONDUCTION = (
    "regions.cement.thermal.cure=",
    *(f"interfaces.{name}.conductance=perfect" for name in INTERFACES),
)
# The same at second order, where the bodies are condensed.
CONDENSED = {"20k": ("8 mm", 0.6), "100k": ("4 mm", 1.0)}
# Second order: the timed case, and the reference of both orders.
SECOND, REFERENCE = "5 mm", "3 mm"
# Phases of a run outside set-up and solution.
APART = ("mesh", "compile", "output", "error", "total")
ROUNDING = 1e-12  # mm
_goal = partial(Check, group="bench", timed=True)


def benchmarks() -> list[Check]:
    """All checks of ``mantle bench``."""
    stem = (CheckRun(STEM, times=TIMES),)
    middle = stance("contact", "100k")
    ladder = tuple(stance("contact", rung) for rung in RUNGS)
    second = [CheckRun("stance.yaml", (f"mesh.size={h}", *STANCE)) for h in (SECOND, REFERENCE)]
    largest = stance("contact", "170k")
    half = CheckRun("cure.yaml", (HALF_AN_HOUR,), times=TIMES)
    bonded = CheckRun("cure.yaml", (HALF_AN_HOUR, *CONDUCTION), times=TIMES)
    twelve = tuple(CheckRun("stance.yaml", (*middle.overrides, *o), share=True) for o in TWELVE)
    steps = (CheckRun("stance.yaml", (*middle.overrides, *STEPS)),)
    two = CheckRun("stance.yaml", largest.overrides, ranks=2)
    million = (stance("contact", LONG),)
    return [
        _goal("stem_cpu", "CPU time [s]", stem, _median(cpu), 5.0, tier="quick"),
        _goal("stem_memory", "peak memory [MB]", stem, _median(megabytes), 500.0, tier="quick"),
        _goal("stem_penetration", "penetration [mm]", stem, _penetration, ROUNDING, tier="quick"),
        *_over_bonded(),
        _goal("growth_exponent", "of CPU time over unknowns", ladder, growth, 1.12),
        _goal("newton_spread", "of iterations about their middle", ladder, spread, 3.0),
        _goal("ranks_2_over_1", "wall time over one rank", (two, largest), _ratio(wall), 1 / 1.7),
        _goal("variations_12", "CPU time over that of one", (middle, *twelve), _variations, 2.5),
        _goal("later_load_steps", "the longest over the first", steps, later_steps, 0.3),
        *_condensed(),
        _goal(
            "order_2_over_1",
            "CPU time of second order over first at equal error of slip",
            (*second, *ladder[:3]),
            equal_error,
            1.0,
        ),
        _goal("cure_over_conduction", "CPU time", (half, bonded), _ratio(cpu), 2.5),
        _goal("million_memory", "peak [MB]", million, _median(megabytes), 12e3, tier="long"),
        _goal("million_minutes", "start to finish", million, _median(_minutes), 5.0, tier="long"),
    ]


def _over_bonded() -> Iterator[Check]:
    """CPU time of contact over CPU time of the same model with bonded interfaces."""
    for rung in RUNGS:
        yield _goal(
            f"contact_over_bonded_{rung}",
            "CPU time of contact over that of bonded interfaces",
            (stance("contact", rung), stance("bonded", rung)),
            _ratio(cpu),
            2.0 if rung in SMALL else 1.25,
            tier={"20k": "quick", LONG: "long"}.get(rung, "default"),
        )
    for rung in STEM_RUNGS:
        yield _goal(
            f"moderate_over_bonded_{rung}",
            "the same of a stem pressed in, of which a quarter slips",
            (_stem(rung, MODERATE), _stem(rung, BONDED)),
            _ratio(cpu),
            1.2,
        )


def _condensed() -> Iterator[Check]:
    """First solve, later step, variations and cycles at second order; contact over bonded."""
    for rung, (size, most) in CONDENSED.items():
        first, krylov = (
            CheckRun("stance.yaml", (f"mesh.size={size}", *STANCE, *o), times=TIMES)
            for o in ((), ("solver.linear=multigrid",))
        )
        steps = (CheckRun("stance.yaml", (*first.overrides, *STEPS)),)
        twelve = tuple(CheckRun("stance.yaml", (*first.overrides, *o), share=True) for o in TWELVE)
        yield _goal(f"condensed_{rung}", "over multigrid", (first, krylov), _ratio(cpu), most)
        later = partial(later_steps, setup=True)
        yield _goal(f"later_2_{rung}", "over the first with its set-up", steps, later, 0.1)
        yield _goal(f"variations_2_{rung}", "over one", (first, *twelve), _variations, 2.5)
        ten = CheckRun("stance.yaml", (f"mesh.size={size}", STANCE[0], TEN))
        yield _goal(f"cycles_2_{rung}", "ten over the first load", (ten, first), _ratio(cpu), 2.5)
        bonded = CheckRun("stance.yaml", (*first.overrides, *BONDED), times=TIMES)
        yield _goal(f"bonded_2_{rung}", "over bonded", (first, bonded), _ratio(cpu), 2.6)


def stance(kind: str, rung: str) -> CheckRun:
    """The femur at first order, its interfaces in contact or bonded."""
    own = BONDED if kind == "bonded" else ()
    overrides = ("mesh.order=1", *STANCE, *own, f"mesh.size={RUNGS[rung]}")
    tier = "long" if rung == LONG else "quick"
    return CheckRun("stance.yaml", overrides, tier=tier, times=TIMES if rung in CHEAP else 1)


def _stem(rung: str, overrides: Sequence[str]) -> CheckRun:
    size = STEM_RUNGS[rung]
    sizes = (f"mesh.size={size}", f"mesh.far_size={size}")
    return CheckRun(STEM, (*overrides, *sizes), times=TIMES if rung in CHEAP else 1)


def solution(seconds: Mapping[str, float], apart: Sequence[str] = APART) -> float:
    """Seconds of assembly, set-up and solution, coarse problems included, or of other phases."""
    return sum(value for phase, value in seconds.items() if phase not in apart)


def cpu(run: Run) -> float:
    """CPU time of the solution [s]."""
    return solution(run.summary["cpu"])


def wall(run: Run) -> float:
    """Wall time of the solution, which falls with the number of ranks [s]."""
    return solution(run.summary["timing"])


def megabytes(run: Run) -> float:
    """Peak memory of all ranks [MB]."""
    return float(run.summary["memory"]["peak"])


def _minutes(run: Run) -> float:
    """Minutes of a run without the mesh and the forms, which are made once."""
    timing = run.summary["timing"]
    return float(timing["total"] - timing["mesh"] - timing["compile"]) / 60


def _median(figure: Callable[[Run], float]) -> Judge:
    return lambda runs: Sample(median(map(figure, runs)))


def _ratio(figure: Callable[[Run], float]) -> Judge:
    """Median of ratios of two cases, run in turn: the first half of the runs over the second."""

    def judge(runs: Sequence[Run]) -> Sample:
        figures = np.array([figure(run) for run in runs]).reshape(2, -1)
        return Sample(median(figures[0] / figures[1]))

    return judge


def _penetration(runs: Sequence[Run]) -> Sample:
    return Sample(max(x for run in runs for x in _numbers(run, "penetration_max").values()))


def _numbers(run: Run, key: str) -> dict[str, float]:
    return {name: float(q[key]) for name, q in run.summary["interfaces"].items()}


def _unknowns(run: Run) -> int:
    return int(run.summary["solver"]["dofs"])


def growth(runs: Sequence[Run]) -> Sample:
    """Exponent p of time ~ unknowns^p by least squares in logarithms, of median times."""
    rungs = {n: list(rung) for n, rung in groupby(sorted(runs, key=_unknowns), _unknowns)}
    times = [median(map(cpu, rung)) for rung in rungs.values()]
    return Sample(fitted_order(list(rungs), times), errors=tuple(times))


def spread(runs: Sequence[Run]) -> Sample:
    """Deviation of Newton iterations from the middle of their range."""
    newton = [run.summary["solver"]["newton_iterations"] for run in runs]
    return Sample((max(newton) - min(newton)) / 2, note=f"{min(newton)} to {max(newton)}")


def _variations(runs: Sequence[Run]) -> Sample:
    """Time of twelve cases in one process over the time of one, without mesh and forms."""
    seconds = [solution(run.summary["cpu"], ("mesh", "compile", "total")) for run in runs]
    return Sample(sum(seconds[-len(TWELVE) :]) / median(seconds[: -len(TWELVE)]))


def later_steps(runs: Sequence[Run], setup: bool = False) -> Sample:
    """The longest later load step of a run over its first, or all before the later ones."""
    first, *later = runs[0].history["step [s]"]
    if setup:
        first = wall(runs[0]) - sum(later)
    return Sample(float(max(later) / first))


def equal_error(runs: Sequence[Run]) -> Sample:
    """Time of a run over that of others at the same error of slip_p99 against a reference.

    Runs: the one, the reference, the others. Interpolated by a straight line in logarithms. Where
    none of the others is as good, the finest is taken: a run as good takes longer, so the ratio is
    smaller.
    """
    two, reference, *others = runs
    ones = {_unknowns(run): run for run in reversed(others)}
    known = _numbers(reference, "slip_p99")

    def error(run: Run) -> float:
        have = _numbers(run, "slip_p99")
        return max(abs(have[name] / known[name] - 1) for name in known)

    finest_first = [ones[n] for n in sorted(ones, reverse=True)]
    errors, times = (np.log([figure(one) for one in finest_first]) for figure in (error, cpu))
    return Sample(cpu(two) / float(np.exp(np.interp(np.log(error(two)), errors, times))))
