"""A stem in its bench test: a prismatic bar that is built in, with the load of a head."""

from __future__ import annotations

import pytest

from app.verification import closed_forms as exact
from app.verification.measures import summary_number
from app.verification.problem import KnownProblem, quick, verify

POTTED_BAR = "verification/potted_bar.yaml"
BEAM = "beam: N / A + M x / I; energy of axial force, bending, shear and Saint-Venant's torsion"
# Bar of potted_bar.yaml: Young's modulus [MPa], width, depth, length [mm].
E = 110e3
SECTION = (10.0, 8.0)
LENGTH = 80.0
SHORT = 40.0
# Height at which the stress is evaluated [mm].
LEVEL = 20.0
# Centre of the head against the centre of the top [mm].
HEAD_CENTRE = (30.0, 0.0, 20.0)
# Force of ISO 7206-4, and its part along the axis [N].
FORCE = (-399.4, -354.3, -2237.2)
AXIAL = (0.0, 0.0, -2237.2)
ALONG = f"loads.hip.force=[0 N, 0 N, {AXIAL[2]} N]"
SHORTER = (
    "geometry.blocks=[{name: stem, size: [10 mm, 8 mm, 40 mm]}]",
    "loads.hip.at=[35 mm, 4 mm, 60 mm]",
)


def expect(problem: KnownProblem, what: str, tolerance: float, order: float | None = None) -> None:
    """State a number of the bar."""
    problem.expects(f"{what}, relative", tolerance=tolerance, order=order, source=BEAM)


@verify
@quick
@pytest.mark.parametrize("name", ["level_stress", "deflection"])
def test_potted_axial(problem: KnownProblem, name: str) -> None:
    """Without shear the displacement is quadratic, so cells of second order are exact."""
    expect(problem, f"{name} of a bar under an eccentric force along its axis", 1e-8)
    bar = exact.CantileverBar(E, *SECTION, LENGTH)
    answers = {
        "level_stress": bar.largest_stress(AXIAL, HEAD_CENTRE, LEVEL),
        "deflection": bar.deflection(AXIAL, HEAD_CENTRE),
    }
    problem.compare(summary_number(problem.solve(POTTED_BAR, ALONG), f"stem.{name}", answers[name]))


@verify
def test_potted_order(problem: KnownProblem) -> None:
    expect(problem, "deflection of the same bar, shorter, by P1", 0.03, order=2.0)
    changes_of_runs = [
        (ALONG, *SHORTER, "mesh.order=1", f"mesh.size={h} mm")
        for h in problem.rungs((1.4, 1.0, 0.7), finest="default")
    ]
    answer = exact.CantileverBar(E, *SECTION, SHORT).deflection(AXIAL, HEAD_CENTRE)
    runs = problem.solve_each(POTTED_BAR, changes_of_runs)
    problem.converges([summary_number(run, "stem.deflection", answer) for run in runs])


@verify
@pytest.mark.parametrize(
    ("name", "tolerance"),
    [
        pytest.param("level_stress", 2e-3, id="level_stress"),
        pytest.param("deflection", 5e-3, id="deflection"),
    ],
)
def test_potted_head(problem: KnownProblem, name: str, tolerance: float) -> None:
    """Shear and torsion act as well. The clamp restrains warping, which the beam ignores."""
    expect(problem, f"{name} of a bar under the force of ISO 7206-4", tolerance)
    bar = exact.CantileverBar(E, *SECTION, LENGTH)
    answers = {
        "level_stress": bar.largest_stress(FORCE, HEAD_CENTRE, LEVEL),
        "deflection": bar.deflection(FORCE, HEAD_CENTRE),
    }
    solved = problem.solve(POTTED_BAR, "mesh.size=2.5 mm")
    problem.compare(summary_number(solved, f"stem.{name}", answers[name]))
