"""Cases and figures of `mantle bench`: the cost of frictional contact.

CPU time is that of assembly, set-up and solution with coarse problems included, without making the
mesh, compiling forms and writing results. Ratios are of runs made in turn.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import groupby, product
from statistics import median

import numpy as np

from app.campaigns.work_precision import fitted_order
from app.results.reading import Run
from app.verification.problem import Comparison, ProblemRun, solution

# Mesh sizes of the femur, by about how many unknowns they give at first order.
RUNGS = {"20k": "2.8 mm", "100k": "2.4 mm", "170k": "1.3 mm", "1m": "1 mm"}
LONG_RUNG = "1m"  # the rung for the tier "long" alone
REPEATS = 3  # runs per median on small meshes
CHEAP = ("20k", "50k", "100k")
# Meshes on which contact may take twice the time of bonded interfaces.
SMALL = ("20k", "50k")
FEMUR = "stance.yaml"
STANCE = ("output.error=false", "stages.0.increments=1")
INTERFACES = ("stem_cement", "cement_bone")
BONDED = tuple(f"interfaces.{name}={{kind: bonded}}" for name in INTERFACES)
# The stem a little too large for its hole: a quarter of its points slip, no others.
BENCH_STEM = "bench/stem.yaml"
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
CONDENSED = {"20k": "8 mm", "100k": "4 mm"}
# Second order: the timed case, and the reference of both orders.
SECOND = "5 mm"
REFERENCE = "3 mm"
# Penetration that is rounding [mm].
ROUNDING_OF_PENETRATION = 1e-12

# Runs


def femur_run(kind: str, rung: str) -> ProblemRun:
    """The femur at first order, its interfaces in contact or bonded."""
    laws = BONDED if kind == "bonded" else ()
    overrides = ("mesh.order=1", *STANCE, *laws, f"mesh.size={RUNGS[rung]}")
    return ProblemRun(FEMUR, overrides, times=REPEATS if rung in CHEAP else 1)


def cemented_stem(rung: str, overrides: Sequence[str]) -> ProblemRun:
    """The stem on a mesh of one size."""
    size = STEM_RUNGS[rung]
    sizes = (f"mesh.size={size}", f"mesh.far_size={size}")
    return ProblemRun(BENCH_STEM, (*overrides, *sizes), times=REPEATS if rung in CHEAP else 1)


def runs_of_variations(first: ProblemRun) -> list[ProblemRun]:
    """The twelve cases of a model in one process."""
    return [ProblemRun(FEMUR, (*first.overrides, *changes), share=True) for changes in TWELVE]


# Figures


def cpu(run: Run) -> float:
    """CPU time of the solution [s]."""
    return solution(run.summary["cpu"])


def wall(run: Run) -> float:
    """Wall time of the solution, which falls with the number of ranks [s]."""
    return solution(run.summary["timing"])


def megabytes(run: Run) -> float:
    """Peak memory of all ranks [MB]."""
    return float(run.summary["memory"]["peak"])


def minutes(run: Run) -> float:
    """Minutes of a run without the mesh and the forms, which are made once."""
    timing = run.summary["timing"]
    return float(timing["total"] - timing["mesh"] - timing["compile"]) / 60


def penetration(run: Run) -> float:
    """Largest penetration of both interfaces [mm]."""
    return max(numbers_of_interfaces(run, "penetration_max").values())


def median_of(figure: Callable[[Run], float], runs: Sequence[Run]) -> Comparison:
    """Median of a figure."""
    return Comparison(median(map(figure, runs)))


def ratio(runs: Sequence[Run], figure: Callable[[Run], float] = cpu) -> Comparison:
    """Median of ratios of two cases, run in turn: the first half of the runs over the second."""
    figures = np.array([figure(run) for run in runs]).reshape(2, -1)
    return Comparison(median(figures[0] / figures[1]))


def numbers_of_interfaces(run: Run, key: str) -> dict[str, float]:
    """A number of each interface."""
    return {name: float(q[key]) for name, q in run.summary["interfaces"].items()}


def unknowns_of_run(run: Run) -> int:
    """Number of unknowns."""
    return int(run.summary["solver"]["dofs"])


def growth(runs: Sequence[Run]) -> Comparison:
    """Exponent p of time ~ unknowns^p by least squares in logarithms, of median times."""
    rungs = {
        n: list(rung) for n, rung in groupby(sorted(runs, key=unknowns_of_run), unknowns_of_run)
    }
    times = [median(map(cpu, rung)) for rung in rungs.values()]
    return Comparison(fitted_order(list(rungs), times))


def spread_of_iterations(runs: Sequence[Run]) -> Comparison:
    """Deviation of Newton iterations from the middle of their range."""
    newton = [run.summary["solver"]["newton_iterations"] for run in runs]
    return Comparison((max(newton) - min(newton)) / 2, note=f"{min(newton)} to {max(newton)}")


def variations(runs: Sequence[Run]) -> Comparison:
    """Time of twelve cases in one process over the time of one, without mesh and forms."""
    seconds = [solution(run.summary["cpu"], ("mesh", "compile", "total")) for run in runs]
    return Comparison(sum(seconds[-len(TWELVE) :]) / median(seconds[: -len(TWELVE)]))


def later_steps(run: Run, *, setup: bool = False) -> Comparison:
    """The longest later load step of a run over its first, or all before the later ones."""
    first_step, *later_seconds = run.step_record["step [s]"]
    if setup:
        first_step = wall(run) - sum(later_seconds)
    return Comparison(float(max(later_seconds) / first_step))


def equal_error(runs: Sequence[Run]) -> Comparison:
    """Time of a run over that of others at the same error of slip_p99 against a reference.

    The time is interpolated by a straight line in logarithms. Where none of the others is as good,
    the finest is taken: a run as good takes longer, so the ratio is smaller.

    Args:
        runs: The run, the reference, then the others by size.
    """
    second_order, reference, *first_order_runs = runs
    run_of_size = {unknowns_of_run(run): run for run in reversed(first_order_runs)}
    reference_numbers = numbers_of_interfaces(reference, "slip_p99")

    def error(run: Run) -> float:
        run_numbers = numbers_of_interfaces(run, "slip_p99")
        return max(
            abs(run_numbers[name] / reference_numbers[name] - 1) for name in reference_numbers
        )

    finest_first = [run_of_size[n] for n in sorted(run_of_size, reverse=True)]
    errors, times = (
        np.log([figure(run_of_rung) for run_of_rung in finest_first]) for figure in (error, cpu)
    )
    return Comparison(
        cpu(second_order) / float(np.exp(np.interp(np.log(error(second_order)), errors, times)))
    )
