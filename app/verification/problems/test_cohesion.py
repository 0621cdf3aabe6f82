"""Cohesive interfaces: traction and energy of bars and beams until they break.

Lengths in mm, stresses in MPa, fracture energy per area in N/mm.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from app.foundation.arrays import Floats
from app.results.reading import Run
from app.verification.measures import summary_number
from app.verification.problem import (
    Comparison,
    KnownProblem,
    condensed,
    quick,
    relative,
    stress,
    verify,
)

COHESIVE_BAR = "verification/cohesive_bar.yaml"
BEAMS = "verification/cohesive_beams.yaml"
SOFTENING = "linear softening: traction on the ellipse of strengths, shrunk by the energy used"

# Of cohesive_bar.yaml: strengths, fracture energies, exponent of the mixture, area, stiffness.
TENSILE = 10.0
SHEAR = 15.0
G_I = 0.1
G_II = 0.2
ETA = 2.0
AREA = 16.0
STIFFNESS = 1e4


def energy(mixture: float) -> float:
    """Fracture energy of a mixture B = D_t^2/|D|^2 (Benzeggagh and Kenane 1996)."""
    return G_I + (G_II - G_I) * mixture**ETA


def column(run: Run, name: str) -> Floats:
    """A column of the history of the interface."""
    return np.asarray(run.step_record[f"lower_upper {name}"])


def softening_error(
    run: Run, *, mixture: float = 0.0, strength: float = TENSILE, whole: float = G_I
) -> Comparison:
    """Largest error of traction and spent energy while a point is pulled apart in one direction.

    With linear softening the traction is on the ellipse of the strengths, shrunk by the used part
    of the energy. Strength and energy are those in tension.
    """
    spent_fraction = column(run, "dissipation [N mm]") / (whole / G_I * energy(mixture) * AREA)
    tension = np.maximum(-column(run, "pressure_p95 [MPa]"), 0)  # a sheared block tips and presses
    traction_ratio = np.hypot(tension / strength, column(run, "shear_p95 [MPa]") / SHEAR)
    softens = (spent_fraction > 0) & (spent_fraction < 1 - 1e-9)
    largest_defect = float(np.abs(traction_ratio + spent_fraction - 1)[softens].max(initial=0.0))
    solver = run.summary["solver"]
    note = (
        f"traction off by {largest_defect:.1e} of the strength in {softens.sum()} steps, "
        f"{solver['rejected_steps']} of {solver['steps']} failed"
    )
    return Comparison(
        max(largest_defect, abs(spent_fraction[-1] - 1)), spent_fraction[-1], 1.0, note
    )


# A bar of two blocks

STIFF = ("regions.lower={rigid: true, tissue: other}", "regions.upper.youngs_modulus=1e6 GPa")
SHORT = tuple(f"geometry.blocks.{k}.size=[4 mm, 4 mm, 2 mm]" for k in (0, 1))


def support(name: str, motion: str, history: str = "[1]") -> str:
    """Override for a support that moves the top."""
    top_support = f"{{kind: displacement, boundary: top, {motion} mm, history: {history}}}"
    return f"supports.{name}={top_support}"


def pull(x: float, z: float, history: str = "[1]") -> str:
    """Override that moves the top along x and z [mm]."""
    return support("pull", f"x: {x!r} mm, y: 0 mm, z: {z!r}", history)


@verify
@quick
def test_cohesive_bar(problem: KnownProblem) -> None:
    problem.expects(
        "traction of a bar that snaps back, over its strength, and energy used up",
        tolerance=1e-6,
        source=SOFTENING,
    )
    problem.compare(softening_error(problem.solve(COHESIVE_BAR)))


@verify
def test_cohesive_mixtures(problem: KnownProblem) -> None:
    problem.expects(
        "traction and energy of a point in five mixtures of modes",
        tolerance=1e-3,
        source=f"{SOFTENING}; Benzeggagh and Kenane 1996",
    )
    angles = np.linspace(0, math.pi / 2, 5)
    smooth = (*STIFF, *SHORT, "interfaces.lower_upper.friction_coefficient=0")
    pulls = [pull(0.4 * math.sin(a), 0.4 * math.cos(a)) for a in angles]
    runs = problem.solve_each(COHESIVE_BAR, [(*smooth, one) for one in pulls])
    mixtures = [math.sin(a) ** 2 for a in angles]
    problem.compare(*(softening_error(r, mixture=m) for r, m in zip(runs, mixtures, strict=True)))


@verify
@quick
def test_cohesive_unloading(problem: KnownProblem) -> None:
    """The interface is pulled to 0.005 mm and back in two steps.

    The traction falls on the line to the origin.
    """
    problem.expects(
        "traction of a bond pulled to 0.005 mm and let go, relative",
        tolerance=1e-4,
        source="linear softening, and unloading to the origin",
    )
    stages = "stages=[{name: pull}, {name: back, increments: 2}]"
    solved = problem.solve(COHESIVE_BAR, *STIFF, *SHORT, pull(0, 0.005, "[1, 0]"), stages)
    times = solved.step_record["time [-]"]
    traction = -column(solved, "pressure_p95 [MPa]")
    loaded, half_unloaded, unloaded = (
        float(traction[np.argmin(np.abs(times - t))]) for t in (1, 1.5, 2)
    )
    end = 2 * G_I / TENSILE
    exact = TENSILE * (end - 0.005) / (end - TENSILE / STIFFNESS)
    error = max(
        abs(loaded / exact - 1), abs(2 * half_unloaded / loaded - 1), abs(unloaded / loaded)
    )
    problem.compare(Comparison(error, loaded, exact))


@verify
def test_cohesive_pressed(problem: KnownProblem) -> None:
    problem.expects(
        "pressure of a bond and bars in series, whole [MPa], relative",
        tolerance=1e-9,
        source="springs in series",
    )
    solved = problem.solve(COHESIVE_BAR, *SHORT, pull(0, -0.4))
    problem.compare(
        summary_number(solved, "lower_upper.pressure_mean", 0.4 / (1 / STIFFNESS + 4 / 2000))
    )


@verify
def test_cohesive_friction(problem: KnownProblem) -> None:
    problem.expects(
        "friction of a bond that is broken and pressed", tolerance=1e-6, source="Coulomb's law"
    )
    stages = "stages=[{name: pull, fracture_step: 0.1 N mm}, {name: press}, {name: slide}]"
    solved = problem.solve(
        COHESIVE_BAR,
        *SHORT,
        support("slide", "x: 0.1", "[0, 0, 1]"),
        support("pull", "y: 0 mm, z: -0.01", "[-4, 1, 1]"),
        stages,
    )
    x, _, z = np.abs(solved.summary["interfaces"]["lower_upper"]["force"])
    problem.compare(relative(float(x / z), 0.3))


# A double cantilever beam

# Of an arm of cohesive_beams.yaml: Young's modulus, width, height, and fracture energy.
ARM_E = 70e3
ARM_WIDTH = 1.0
ARM_HEIGHT = 3.0
G_ARM = 0.25
ZONE = 3.0  # mm that the crack runs before its zone is whole


@verify
def test_cohesive_beams(problem: KnownProblem) -> None:
    """The length of the crack is the dissipated energy over G b.

    The slope is that of the steady part.
    """
    problem.expects(
        "J of a double cantilever beam turned apart [N/mm], relative",
        tolerance=0.01,
        source="J = 12 M^2 / (E b^2 h^3), M = E I dtheta/da",
    )
    solved = problem.solve(BEAMS)
    time = np.asarray(solved.step_record["time [-]"])
    crack = column(solved, "dissipation [N mm]") / (G_ARM * ARM_WIDTH)
    steady = (crack > ZONE) & (time < 1)
    slope = np.polyfit(crack[steady], 0.06 * time[steady], 1)[0]
    moment = ARM_E * ARM_WIDTH * ARM_HEIGHT**3 / 12 * slope
    J = relative(12 * moment**2 / (ARM_E * ARM_WIDTH**2 * ARM_HEIGHT**3), G_ARM)
    newton = np.asarray(solved.step_record["newton [-]"])[steady]
    rejected_share = (solved.summary["solver"]["rejected_steps"] or 0) / len(newton)
    note = (
        f"{newton.mean():.1f} Newton iterations a step, {100 * rejected_share:.0f} % of steps"
        " failed"
    )
    easy = newton.mean() <= 5 and rejected_share <= 0.05
    problem.compare(Comparison(J.error if easy else math.inf, J.computed, J.exact, note))


@verify
def test_cohesive_mesh(problem: KnownProblem) -> None:
    """Two meshes give the dissipated energy of the whole turn and the work on the interface."""
    problem.expects(
        "energy and work of the turn by cells of 2 mm, against 1 mm [N mm], relative",
        tolerance=0.02,
        source="the finer mesh",
    )
    runs = problem.solve_each(BEAMS, [("mesh.size=2 mm",), ()])
    comparisons = []
    for name in ("contact_work [N mm]", "dissipation [N mm]"):
        coarse, fine = (float(column(solved, name)[-1]) for solved in runs)
        comparisons.append(relative(coarse, fine))
    problem.compare(*comparisons)


@verify
def test_cohesive_balance(problem: KnownProblem) -> None:
    problem.expects(
        "balance of energy over its work, and least dissipation of a step",
        tolerance=1e-10,
        source="conservation of energy; dissipation is not negative",
    )
    solved = problem.solve(BEAMS)
    dissipation = column(solved, "dissipation [N mm]")
    least = max(0.0, -column(solved, "dissipation_min [N mm]").min() / dissipation[-1])
    balance = float(np.max(solved.step_record["energy balance [-]"]))
    problem.compare(Comparison(max(least, balance)))


# The bar at extremes: traction and energy are exact throughout

# Length over Young's modulus of the bar [mm/MPa].
SOFTNESS = 40 / 2000


def compare_bar(
    problem: KnownProblem,
    *,
    energy: float = G_I,
    strength: float = TENSILE,
    above: float = 10.0,
    steps: int = 16,
) -> None:
    """Break the bar with a stiffness ``above`` the least, in steps of a part of its energy."""
    problem.expects("traction over strength, and energy used up", tolerance=1e-5, source=SOFTENING)
    least = 1.125 * strength**2 / energy
    stiffness = above * least
    end = 1.5 * max(SOFTNESS * strength + 1 / stiffness * strength, 2 * energy / strength)
    solved = problem.solve(
        COHESIVE_BAR,
        f"interfaces.lower_upper.stiffness={stiffness!r} MPa/mm",
        f"interfaces.lower_upper.tensile_strength={strength!r} MPa",
        f"interfaces.lower_upper.shear_strength={1.5 * strength!r} MPa",
        f"interfaces.lower_upper.tensile_energy={energy!r} N/mm",
        f"interfaces.lower_upper.shear_energy={2 * energy!r} N/mm",
        f"supports.pull.z={end!r} mm",
        f"stages.0.fracture_step={AREA * energy / steps!r} N mm",
    )
    problem.compare(softening_error(solved, strength=strength, whole=energy))


@stress
@condensed
@pytest.mark.parametrize(
    "energy", [pytest.param(10.0**k, id=f"{10.0**k:g} N per mm") for k in range(-4, 3)]
)
def test_cohesion_energy(problem: KnownProblem, energy: float) -> None:
    compare_bar(problem, energy=energy)


@stress
@condensed
@pytest.mark.parametrize(
    "strength", [pytest.param(10.0**k, id=f"{10.0**k:g} MPa") for k in range(-2, 3)]
)
def test_cohesion_strength(problem: KnownProblem, strength: float) -> None:
    compare_bar(problem, strength=strength)


@stress
@condensed
@pytest.mark.parametrize(
    "above", [pytest.param(1.25 * 10.0**k, id=f"1e{k} of the least") for k in range(9)]
)
def test_cohesion_stiffness(problem: KnownProblem, above: float) -> None:
    compare_bar(problem, above=above)


@stress
@condensed
@pytest.mark.parametrize("steps", [pytest.param(2**k, id=f"{2**k}") for k in range(7)])
def test_cohesion_steps(problem: KnownProblem, steps: int) -> None:
    compare_bar(problem, steps=steps)
