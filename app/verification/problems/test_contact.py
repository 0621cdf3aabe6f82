"""Contact of curved bodies, and friction: Hertz, Cattaneo, bars, inclines, tapers."""

from __future__ import annotations

import numpy as np
import pytest

from app.foundation.verdict import Reason
from app.results.reading import Run
from app.verification import closed_forms as exact
from app.verification.measures import (
    CEMENT,
    MESH,
    law_violation,
    step_at,
    summary_number,
    work_lost,
)
from app.verification.problem import (
    Comparison,
    KnownProblem,
    condensed,
    long,
    quick,
    relative,
    stress,
    verify,
)

# Contact of curved bodies

SIZE = 0.1  # mm, of cells
FINE = (f"mesh.size={SIZE} mm", "mesh.order=2")
JOHNSON = "Hertz (Johnson, Contact Mechanics, section {})"
HERTZ = {
    "line": exact.hertz_line(100.0, 10.0, exact.contact_modulus(CEMENT)),
    "ball": exact.hertz_point(100.0, 10.0, exact.contact_modulus(CEMENT)),
}
SECTION = {"line": JOHNSON.format("4.2c"), "ball": JOHNSON.format("4.2a")}
# Number of coordinates in the contact plane.
WIDE = {"line": 1, "ball": 2}


def width(run: Run, wanted: np.ndarray, reference: float, axes: int) -> Comparison:
    """Distance from 0 of the furthest of some points, along x or in the plane [mm]; in cells."""
    points = run.points[run.on_interface("contact") & wanted, :axes]
    computed = float(np.linalg.norm(points, axis=1).max(initial=0.0))
    return Comparison(abs(computed - reference) / SIZE, computed, reference)


# Quantity and tolerance.
HERTZ_NUMBERS = {
    "pressure": ("peak pressure under a {} contact [MPa], relative", 0.03),
    "width": ("half-width of contact [mm], in cells", 1.0),
    "approach": ("approach [mm], relative", 0.02),
}


@verify
@pytest.mark.parametrize(
    ("kind", "name"),
    [
        pytest.param("line", "pressure", id="line_pressure", marks=quick),
        pytest.param("line", "width", id="line_width"),
        pytest.param("ball", "pressure", id="ball_pressure", marks=quick),
        pytest.param("ball", "width", id="ball_width"),
        pytest.param("ball", "approach", id="ball_approach"),
    ],
)
def test_hertz(problem: KnownProblem, kind: str, name: str) -> None:
    quantity, tolerance = HERTZ_NUMBERS[name]
    problem.expects(quantity.format(kind), tolerance=tolerance, source=SECTION[kind])
    solved = problem.solve(f"verification/hertz_{kind}.yaml", *FINE)
    exact_contact = HERTZ[kind]
    if name == "pressure":
        problem.compare(summary_number(solved, "contact.pressure_max", exact_contact.p0))
    elif name == "width":
        pressed = solved.at_interface("contact", "pressure") > 0
        problem.compare(width(solved, pressed, exact_contact.a, WIDE[kind]))
    else:
        plate = np.unique(solved.cells[solved.region == 2])  # which descends
        descent = float(-solved.displacement()[plate, 2].mean())
        problem.compare(relative(descent, exact_contact.approach))


@verify
@quick
def test_cattaneo_stick_width(problem: KnownProblem) -> None:
    problem.expects(
        "half-width of the strip that sticks [mm], in cells",
        tolerance=1.0,
        source="Cattaneo 1938, Mindlin 1949 (Johnson, Contact Mechanics, section 7.2)",
    )
    solved = problem.solve("verification/cattaneo.yaml", f"mesh.size={SIZE} mm")
    thickness = 0.2  # mm
    force = solved.summary["interfaces"]["contact"]["force"]
    shear, _, pressure = np.abs(force) / thickness
    a = exact.hertz_line(pressure, 10.0, exact.contact_modulus(CEMENT, CEMENT)).a
    reference = exact.stick_half_width(a, shear, pressure, friction=0.3)
    problem.compare(width(solved, solved.at_interface("contact", "status") == 1, reference, 1))


@verify
@quick
def test_klarbring(problem: KnownProblem) -> None:
    """A particle on springs, without a run."""
    problem.expects(
        "friction beyond which a particle has several equilibria, relative",
        tolerance=1e-9,
        source="Klarbring, Ingenieur-Archiv 60, 1990",
    )
    # Not at the top: it brings MPI, which the process that starts ranks must not initialize.
    from app.soundness.critical_friction import critical_friction

    K = np.diag([1.0, 1.0, 2.0])
    K[0, 2] = K[2, 0] = 0.8
    computed = critical_friction(K[None], np.array([[0.0, 0.0, 1.0]]))[0]
    problem.compare(relative(float(computed), exact.particle_friction(1.0, 0.8)))


# A bar on a bed with friction

FOUNDATION_BAR = "verification/foundation_bar.yaml"
BED = "friction balances the force of the bar: F^2 / (2 EA f)"
STIFFNESS = 1.1e6  # N, of its section
PRESS = 2.0  # MPa on the bar, 10 mm wide


def end_of_bar(run: Run, time: float) -> float:
    """End displacement of the bar [mm]."""
    x, _, z = run.points.T
    end = np.isclose(x, 110) & np.isclose(z, z.max())
    return float(run.displacement(step_at(run, time))[end, 0].mean())


@verify
@pytest.mark.parametrize("number", [pytest.param("end", marks=quick), "residual", "dissipation"])
def test_foundation_bar(problem: KnownProblem, number: str) -> None:
    """The bar is pulled, released, and pulled again."""
    quantities = {
        "end": "end displacement of a bar on a bed with friction [mm], relative",
        "residual": "the same after unloading [mm], relative",
        "dissipation": "work lost in a cycle of its load [N mm], relative",
    }
    problem.expects(quantities[number], tolerance=0.02, source=BED)
    solved = problem.solve(FOUNDATION_BAR)
    bar = exact.FoundationBar(force=500.0, friction=6.0, stiffness=STIFFNESS)
    if number == "end":
        problem.compare(relative(end_of_bar(solved, 2.0), bar.end))
    elif number == "residual":
        problem.compare(relative(end_of_bar(solved, 3.0), bar.residual))
    else:
        problem.compare(relative(float(work_lost(solved, "base_bar", (3.0, 5.0))[0]), bar.cycle))


@stress
@condensed
@pytest.mark.parametrize("μ", [pytest.param(μ, id=f"{μ:g}") for μ in (0.01, 0.3, 1.0, 2.0, 5.0)])
def test_friction_bar_on_a_bed(problem: KnownProblem, μ: float) -> None:
    """Friction acts on the lower face of the bar and rotates the bar.

    The rotation moves the end by a part of friction times height over length. So the bar is thin,
    and of the same stiffness EA.
    """
    problem.expects(
        "end displacement, pulled and let go [mm], relative", tolerance=MESH, source=BED
    )
    solved = problem.solve(
        FOUNDATION_BAR,
        f"interfaces.base_bar.friction_coefficient={μ}",
        f"loads.pull.force=[{1200 * μ} N, 0 N, 0 N]",
        "geometry.blocks.1.size=[110 mm, 10 mm, 0.1 mm]",
        "regions.bar.youngs_modulus=1100 GPa",
    )
    bar = exact.FoundationBar(1200 * μ, 10 * PRESS * μ, STIFFNESS)
    problem.compare(
        relative(end_of_bar(solved, 2.0), bar.end),
        relative(end_of_bar(solved, 3.0), bar.residual),
    )


@stress
@quick
@condensed
@pytest.mark.parametrize(
    "μ", [pytest.param(μ, id=f"{μ:g}") for μ in (0.0, 0.01, 0.3, 1.0, 2.0, 5.0)]
)
def test_friction_bar_pulled_off(problem: KnownProblem, μ: float) -> None:
    problem.expects_refusal("a pull beyond what friction can hold", Reason.FLOATING_BODY)
    problem.solve(
        FOUNDATION_BAR,
        f"interfaces.base_bar.friction_coefficient={μ}",
        f"loads.pull.force=[{1.2 * 2200 * μ or 1} N, 0 N, 0 N]",
    )


def cycles_of(count: int, low: str) -> tuple[str, str]:
    """Stages and load history of a first load and a number of cycles down to a part of it."""
    stage_names = ["first", "back"] + [
        f"{direction}{k}" for k in range(count) for direction in ("up", "down")
    ]
    stages = ", ".join(f"{{name: {name}, increments: 4}}" for name in stage_names)
    return stages, ", ".join(f"1, {low}" for _ in range(count + 1))


COUNTS = [pytest.param(10, id="10"), pytest.param(100, id="100", marks=long)]


@stress
@condensed
@pytest.mark.parametrize("count", COUNTS)
def test_cycles_bar_on_a_bed(problem: KnownProblem, count: int) -> None:
    problem.expects(
        "work lost in each cycle of a bar, and return of its end, relative",
        tolerance=MESH,
        source="F^3 / (12 EA f), twice the friction on the way back",
    )
    stages, history = cycles_of(count, "0")
    solved = problem.solve(
        FOUNDATION_BAR,
        f"stages=[{{name: press}}, {stages}]",
        f"loads.press.history=[1, {', '.join(['1'] * 2 * (count + 1))}]",
        f"loads.pull.history=[0, {history}]",
    )
    bar = exact.FoundationBar(500.0, 6.0, STIFFNESS)
    unloaded = np.arange(count + 1) * 2 + 3.0
    lost_work = work_lost(solved, "base_bar", unloaded)
    end_positions = [end_of_bar(solved, time) for time in unloaded]
    drift = float(np.abs(np.diff(end_positions)).max()) / bar.end
    note = (
        f"{count} cycles, {lost_work[0]:.5g} to {lost_work[-1]:.5g} N mm each, exact"
        f" {bar.cycle:.5g}; "
        f"the end drifts by {drift:.1e} of its stroke in a cycle"
    )
    problem.compare(
        Comparison(max(float(np.abs(lost_work / bar.cycle - 1).max()), drift), note=note)
    )


# A block on a slope

INCLINE = "verification/incline.yaml"
SLOPE = "balance of forces on a slope: (tan a + mu) / (1 - mu tan a)"
WEIGHT = 0.01 * 800  # N


def compare_push(run: Run, friction: float) -> Comparison:
    """Compare the horizontal force over the weight with its exact value."""
    force = run.summary["interfaces"]["slope_block"]["force"][0]
    return relative(abs(force) / WEIGHT, exact.push_up(0.1, friction))


@verify
@quick
def test_incline(problem: KnownProblem) -> None:
    problem.expects(
        "force over weight that pushes a block up a slope, relative; by a penalty too",
        tolerance=0.005,
        source=SLOPE,
    )
    law = "{kind: penalty, friction_coefficient: 0.3, penalty: 1.0e3 MPa/mm}"
    runs = problem.solve_each(INCLINE, [(), (f"interfaces.slope_block={law}",)])
    problem.compare(*(compare_push(solved, 0.3) for solved in runs))


@stress
@quick
@condensed
@pytest.mark.parametrize("μ", [pytest.param(μ, id=f"{μ:g}") for μ in (0.01, 0.3, 1.0)])
def test_friction_incline(problem: KnownProblem, μ: float) -> None:
    problem.expects("force over weight, relative", tolerance=0.005, source=SLOPE)
    solved = problem.solve(INCLINE, f"interfaces.slope_block.friction_coefficient={μ}")
    problem.compare(compare_push(solved, μ))


# A stem in its cement and bone

STRESS_STEM = "stress/stem.yaml"
CRITICAL = 1.4  # critical friction: above it the solution may not be unique


@stress
@condensed
@pytest.mark.parametrize(
    "μ", [pytest.param(μ, id=f"{μ:g}") for μ in (0.0, 0.01, 0.3, 1.0, 2.0, 5.0)]
)
def test_friction_stem(problem: KnownProblem, μ: float) -> None:
    """The coefficient of friction goes from zero to beyond the limit of uniqueness."""
    refusal = None
    if μ > CRITICAL:
        refusal = Reason.NOT_UNIQUE
    elif μ == 0:
        refusal = Reason.FLOATING_BODY
    problem.expects(
        "violation of balance and of the laws of contact and friction",
        tolerance=1e-7,
        source="Signorini's conditions and Coulomb's law",
        or_refusal=refusal,
    )
    sides = ("stem_cement", "cement_bone")
    laws = (f"interfaces.{side}.friction_coefficient={μ}" for side in sides)
    problem.compare(law_violation(problem.solve(STRESS_STEM, *laws)))


# A taper of 5 degrees, held by friction from 0.0875 on

TAPER = "stress/taper.yaml"
HALF_ANGLE = float(np.radians(5))


def compare_wedge(problem: KnownProblem, friction: float, left: float) -> None:
    """Push the cone in by 100 N, then unload to a part.

    The result is force over the integral of pressure. This ratio is sin a +- m cos a if the cone
    slides. If friction holds the cone, the law of friction and the balances hold, and the pressure
    stays.
    """
    solved = problem.solve(
        TAPER,
        f"interfaces.stem_cement.friction_coefficient={friction}",
        f"loads.push.history=[1, {left}]",
    )
    s = np.sin(HALF_ANGLE)
    c = np.cos(HALF_ANGLE)
    area = solved.areas("stem_cement")
    pushed, now = (
        float((area * solved.at_interface("stem_cement", "pressure", step)).sum())
        for step in (step_at(solved, 1.0), -1)
    )
    into = abs(100 / (pushed * (s + friction * c)) - 1)
    note = f"{100 * now / pushed:.0f} % of the pressure stays; "
    note += f"error of the force while sliding in {into:.1e}"
    if friction <= s / c:
        error = abs(100 * left / (now * (s - friction * c)) - 1)
        problem.compare(Comparison(max(into, error), note=f"{note}, while sliding out {error:.1e}"))
    elif now > 0.1 * pushed:
        problem.compare(Comparison(law_violation(solved).error, note=f"held by friction; {note}"))
    else:
        problem.compare(Comparison(np.inf, note=f"held by friction; {note}"))


WEDGE = "forces on a cone: sin a +- mu cos a"


@stress
@condensed
@pytest.mark.parametrize(
    "μ", [pytest.param(μ, id=f"mu {μ:g}") for μ in (0.02, 0.05, 0.12, 0.2, 0.5)]
)
def test_taper_let_go(problem: KnownProblem, μ: float) -> None:
    locks = μ > np.tan(HALF_ANGLE)
    problem.expects(
        "force over pressure of a cone pushed in and let go, relative",
        tolerance=1e-7 if locks else MESH,
        source=WEDGE,
    )
    compare_wedge(problem, μ, 0.0 if locks else 0.05)


@stress
@condensed
@pytest.mark.parametrize(
    ("μ", "back"),
    [
        pytest.param(μ, back, id=f"mu {μ:g} by {-back:g}")
        for μ, back in ((0.05, -0.05), (0.2, -0.2), (0.2, -0.8))
    ],
)
def test_taper_pulled(problem: KnownProblem, μ: float, back: float) -> None:
    """A force of (m - tan a) / (m + tan a) times the force of insertion pulls the taper out."""
    description = "violation of balance and friction of a cone pulled back"
    limit_ratio = (μ - np.tan(HALF_ANGLE)) / (μ + np.tan(HALF_ANGLE))
    if -back < limit_ratio:
        problem.expects(description, tolerance=1e-7, source=WEDGE)
    else:
        problem.expects_refusal(description, Reason.FLOATING_BODY)
    compare_wedge(problem, μ, back)


@stress
@condensed
@pytest.mark.parametrize("count", COUNTS)
def test_cycles_taper(problem: KnownProblem, count: int) -> None:
    problem.expects(
        "subsidence of a taper in the last cycle over that of the first load",
        tolerance=1e-4,
        source="shakedown",
    )
    stages, history = cycles_of(count, "0.1")
    solved = problem.solve(TAPER, f"stages=[{stages}]", f"loads.push.history=[{history}]")
    x, y, z = solved.points.T
    on_top = (z > z.max() - 1e-6) & (np.hypot(x, y) < 1.0)
    pushed = np.arange(count + 1) * 2 + 1.0
    settlement = np.array(
        [-solved.displacement(step_at(solved, t))[on_top, 2].mean() for t in pushed]
    )
    sunk = np.diff(settlement)
    lost_work = work_lost(solved, "stem_cement", pushed)
    note = (
        f"sinks {1e3 * settlement[0]:.4g} um, then {1e3 * sunk[0]:.2e} .. {1e3 * sunk[-1]:.2e} um "
        f"in a cycle; loses {lost_work[0]:.3g} .. {lost_work[-1]:.3g} N mm"
    )
    problem.compare(Comparison(abs(sunk[-1]) / settlement[0], note=note))
