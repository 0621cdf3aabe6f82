"""Contact of a given stiffness: walls, penalties, elastic layers in series with contact."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from app.campaigns.work_precision import fitted_order
from app.foundation.verdict import Reason
from app.results.reading import Run
from app.verification import closed_forms as exact
from app.verification.measures import law_violation, summary_number
from app.verification.problem import (
    Comparison,
    KnownProblem,
    condensed,
    quick,
    relative,
    run,
    stress,
    verify,
)

# A bar pressed by 0.01 mm on a wall

BAR_STIFFNESS = 220.0  # MPa/mm
MOTION = 0.01  # mm
BAR_AREA = 4.0  # mm2


@verify
def test_wall_augmented(problem: KnownProblem) -> None:
    problem.expects(
        "force of a bar on a wall [N] and penetration, relative; augmentation 1 to 1e6 MPa/mm",
        tolerance=1e-10,
        source="a bar in compression; no penetration",
    )
    changes_of_runs = [
        (f"interfaces.wall_bar.augmentation={r} MPa/mm",) for r in 10.0 ** np.arange(0, 7)
    ]

    def force(run: Run) -> Comparison:
        q = run.summary["interfaces"]["wall_bar"]
        stiffness = relative(abs(q["force"][2]), BAR_STIFFNESS * MOTION * BAR_AREA)
        deep = q["penetration_max"] / MOTION
        return Comparison(max(stiffness.error, deep), stiffness.computed, stiffness.exact)

    problem.compare(*map(force, problem.solve_each("verification/wall.yaml", changes_of_runs)))


@verify
def test_wall_penalty(problem: KnownProblem) -> None:
    problem.expects(
        "penetration by the penalty's law [mm], relative; penalty 1e2 to 1e8 MPa/mm",
        tolerance=1e-6,
        source="springs in series",
    )
    penalties = 10.0 ** np.arange(2, 9)
    law = "{{kind: penalty, friction_coefficient: 0.3, penalty: {} MPa/mm}}"
    changes_of_runs = [(f"interfaces.wall_bar={law.format(r)}",) for r in penalties]
    runs = problem.solve_each("verification/wall.yaml", changes_of_runs)
    problem.compare(
        *(
            relative(
                solved.summary["interfaces"]["wall_bar"]["penetration_max"],
                exact.penalty_penetration(BAR_STIFFNESS, MOTION, float(r)),
            )
            for solved, r in zip(runs, penalties, strict=True)
        )
    )


# Errors of order -1 in a penalty, or in the stiffness of a layer

POWERS = tuple(float(f"{10.0**k:.6g}") for k in range(9))
FIRST_ORDER = "a body in series with a spring: errors fall with its stiffness"
STRESS_STEM = "stress/stem.yaml"
LAYER = "interfaces.stem_cement.elastic_layer={{normal: {0!r} MPa/mm, tangential: {0!r} MPa/mm}}"


def orders(runs: Sequence[Run], stiffnesses: Sequence[float]) -> Comparison:
    """Orders of penetration and of the error of pressure against the last run, which is exact."""
    *soft, hard = (run.summary["interfaces"]["stem_cement"] for run in runs)
    errors = [abs(q["pressure_mean"] / hard["pressure_mean"] - 1) for q in soft]
    first_order = fitted_order(stiffnesses, errors)
    second = fitted_order(stiffnesses, [q["penetration_max"] for q in soft])
    note = f"order of the pressure's error {first_order:.3f}, of the penetration {second:.3f}"
    return Comparison(max(abs(first_order + 1), abs(second + 1)), note=note)


@stress
@condensed
def test_penalty_order_shrink_fit(problem: KnownProblem) -> None:
    """The shrink fit keeps its interference."""
    problem.expects("orders of a penalty, from -1", tolerance=0.05, source=FIRST_ORDER)
    law = "{{kind: penalty, friction_coefficient: 0, gap: -0.01 mm, penalty: {!r} MPa/mm}}"
    penalties = POWERS[4:8]
    changes_of_runs = [(f"interfaces.stem_cement={law.format(r)}",) for r in penalties]
    runs = problem.solve_each("verification/lame_plane_strain.yaml", [*changes_of_runs, ()])
    problem.compare(orders(runs, penalties))


@stress
@condensed
@pytest.mark.parametrize("k", [pytest.param(k, id=f"{k:g}") for k in POWERS])
def test_layer_stem(problem: KnownProblem, k: float) -> None:
    """Soft springs hold a wedge. Its displacement of millimetres is not small."""
    problem.expects(
        "violation of balance and of the laws of the layer and friction",
        tolerance=1e-8,
        source="springs in series with Signorini's conditions and Coulomb's law",
        or_refusal=Reason.LARGE_DISPLACEMENT if k < 100 else None,
    )
    problem.compare(law_violation(problem.solve(STRESS_STEM, LAYER.format(k))))


@stress
@condensed
def test_layer_order_stem(problem: KnownProblem) -> None:
    problem.expects("orders of a layer's stiffness, from -1", tolerance=0.05, source=FIRST_ORDER)
    stiffnesses = POWERS[4:]
    runs = problem.solve_all(
        [*(run(STRESS_STEM, LAYER.format(k)) for k in stiffnesses), run(STRESS_STEM)]
    )
    problem.compare(orders(runs, stiffnesses))


# A block on an elastic layer, pressed and pushed along it by prescribed displacements

CASE = "verification/layer.yaml"
SERIES = "layer of stiffness k_n, k_t in series with Coulomb's law"
ALONG = 130.0  # MPa/mm
LIMIT = 0.9  # MPa, of friction
PRESS = 0.02  # mm
PUSH = 0.02  # mm
AREA = 16.0  # mm2
# The layer bears k_t d up to mu p and slips by the rest, d - mu p / k_t, which dissipates mu p.
SLIP = PUSH - LIMIT / ALONG
BACK = PUSH - 2 * LIMIT / ALONG
LOST = LIMIT * AREA * SLIP
PRESSED = (
    "supports.press=null",
    "loads.press={kind: pressure, boundary: top, pressure: 3 MPa, history: [1, 1, 1, 1]}",
)


@verify
@pytest.mark.parametrize(
    ("what", "key", "time", "reference", "changes"),
    [
        pytest.param(
            "approach p / k_n [mm]", "penetration_max [mm]", 1, PRESS, PRESSED, id="approach"
        ),
        pytest.param("shear k_t d [MPa]", "shear_max [MPa]", 2, ALONG * PUSH / 4, (), id="shear"),
        pytest.param("shear at its limit mu p [MPa]", "shear_max [MPa]", 3, LIMIT, (), id="limit"),
        pytest.param("slip d - mu p / k_t [mm]", "slip_max [mm]", 3, SLIP, (), id="slip"),
        pytest.param("dissipation [N mm]", "dissipation [N mm]", 3, LOST, (), id="work"),
        pytest.param(
            "slip left after a way back [mm]", "slip_max [mm]", 4, SLIP - BACK, (), id="back"
        ),
        pytest.param(
            "its work [N mm]",
            "dissipation [N mm]",
            4,
            LOST + LIMIT * AREA * BACK,
            (),
            id="cycle",
            marks=quick,
        ),
    ],
)
def test_layer(
    problem: KnownProblem,
    what: str,
    key: str,
    time: float,
    reference: float,
    changes: Sequence[str],
) -> None:
    """The number of history.csv at the end of a stage."""
    problem.expects(f"{what}, relative", tolerance=2e-6, source=SERIES)
    solved = problem.solve(CASE, *changes)
    step = np.argmin(np.abs(solved.step_record["time [-]"] - time))
    problem.compare(relative(float(solved.step_record[f"wall_bar {key}"][step]), reference))


def moved(x: float, z: float) -> tuple[str, ...]:
    """Overrides for one step that moves the top [mm]."""
    top_support = f"kind: displacement, boundary: top, x: {x!r} mm, y: 0 mm, z: {z!r} mm"
    return f"supports.press={{{top_support}}}", "supports.push=null", "stages=[{name: all}]"


@verify
def test_layer_series(problem: KnownProblem) -> None:
    problem.expects(
        "pressure u / (1 / k + L / E) of a layer and a bar, k over eight decades, relative",
        tolerance=1e-8,
        source="springs in series",
    )
    stiffnesses = [10.0**k for k in range(9)]
    law = "interfaces.wall_bar.elastic_layer.normal={} MPa/mm"
    case = ("regions.bar.youngs_modulus=2200 MPa", *moved(0.0, -PRESS))
    runs = problem.solve_each(CASE, [(*case, law.format(k)) for k in stiffnesses])
    pressures = [PRESS / (1 / k + 2 / 2200) for k in stiffnesses]
    problem.compare(
        *(
            summary_number(solved, "wall_bar.pressure_mean", p)
            for solved, p in zip(runs, pressures, strict=True)
        )
    )


@verify
@quick
def test_layer_turned(problem: KnownProblem) -> None:
    problem.expects(
        "slip at 25 degrees to the axes, pressed and pushed in one step [mm], relative",
        tolerance=2e-6,
        source=SERIES,
    )
    c = math.cos(math.radians(25))
    s = math.sin(math.radians(25))
    changes = moved(c * PUSH + s * PRESS, s * PUSH - c * PRESS)
    solved = problem.solve(CASE, "geometry.tilt=25 deg", *changes)
    problem.compare(summary_number(solved, "wall_bar.slip_mean", SLIP))


@verify
@quick
def test_layer_corner(problem: KnownProblem) -> None:
    problem.expects(
        "motion F / (A (k_n + 2 k_t)) of a cube into a corner [mm], relative",
        tolerance=1e-6,
        source="three springs at right angles",
    )
    solved = problem.solve("verification/socket.yaml")
    problem.compare(summary_number(solved, "socket_cube.motion_mean", 0.01 * math.sqrt(3)))
