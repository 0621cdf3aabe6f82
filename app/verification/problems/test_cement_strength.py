r"""Strength and fatigue of cement: Weibull's risk of bars, Miner's damage of cycles.

R V_0 is V s^m in a bar under tension and V s^m / (2 (m + 1)) in pure bending. It is
V s^m / (2 (m + 1)^2) where the moment falls to zero along the bar. Above a threshold t, in bending,
it is V (s - t)^(m + 1) / (2 s (m + 1)). The damage of n cycles under s is n / N(s).
"""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from app.verification.measures import summary_number
from app.verification.problem import Comparison, KnownProblem, verify

BENDING = "verification/bending.yaml"
RISK = "bar.failure_risk"
WEIBULL = "integral of Weibull's stress over the bar"
# At the surface over the scale: as in pure bending by 80 N mm.
SURFACE = 3.75
VOLUME = 640.0  # mm3
PULL = "loads.up={kind: pressure, boundary: x_max, pressure: -3.75 MPa}"
SHEAR = "loads.up={kind: force, boundary: x_max, force: [0 N, 0 N, -0.125 N]}"
LONG_BAR = "geometry.blocks=[{name: bar, size: [80 mm, 1 mm, 4 mm]}]"
ALONE = "loads.down=null"


def compare_risk(
    problem: KnownProblem, m: float, exact: float, tolerance: float, *changes: str
) -> None:
    """Solve the bar for a shape m and compare its risk."""
    problem.expects(f"{RISK}, relative", tolerance=tolerance, source=WEIBULL)
    solved = problem.solve(BENDING, f"regions.bar.weibull.shape={m}", *changes)
    problem.compare(summary_number(solved, RISK, exact))


def bent(m: float) -> float:
    """Risk of a bar in pure bending."""
    return VOLUME * SURFACE**m / 2 / (m + 1)


SHAPES = [pytest.param(m, id=f"{m:g}") for m in (2.86, 10.0)]


@verify
@pytest.mark.parametrize("m", SHAPES)
def test_weibull_pulled(problem: KnownProblem, m: float) -> None:
    compare_risk(problem, m, VOLUME * SURFACE**m, 1e-9, ALONE, PULL)


@verify
@pytest.mark.parametrize("m", SHAPES)
def test_weibull_bent(problem: KnownProblem, m: float) -> None:
    compare_risk(problem, m, bent(m), 1e-6)


@verify
@pytest.mark.parametrize("m", SHAPES)
def test_weibull_threshold(problem: KnownProblem, m: float) -> None:
    exact = bent(m) * (1 - 1 / SURFACE) ** (m + 1)
    compare_risk(problem, m, exact, 1e-6, "regions.bar.weibull.threshold=1 MPa")


@verify
@pytest.mark.parametrize("m", SHAPES)
def test_weibull_three_points(problem: KnownProblem, m: float) -> None:
    exact = 320 * SURFACE**m / 2 / (m + 1) ** 2
    compare_risk(problem, m, exact, 0.01, ALONE, SHEAR, LONG_BAR)


@verify
def test_weibull_corner(problem: KnownProblem) -> None:
    """The run names those of its risks that grow with the mesh."""
    problem.expects(
        "0 if a risk is said to grow with the mesh at a corner, and there alone",
        tolerance=0.5,
        source="singular stress at an edge",
    )
    solved = problem.solve("verification/corner.yaml")
    unsettled = solved.summary["error"]["unsettled"]
    (_, fine), (_, coarse) = unsettled.get("corner_edge.failure_risk", ((1, 0), (2, 0)))
    is_unsettled = "corner.failure_risk" in unsettled or not fine > 3 * coarse
    note = f"from {coarse:.2g} to {fine:.2g} at half the mesh size"
    problem.compare(Comparison(float(is_unsettled), note=note))


# Damage of walking, stairs and stumbling

# Cycles and stress range [MPa] of walking and stumbling, which come from zero.
FROM_ZERO = ((1e6, 3.0), (10, 6.6))
# Stairs go from 0.33 to 3.3 MPa: the amplitude with zero mean on Goodman's line of 40 MPa.
STAIRS = 2.97 / 2 / (1 - (3.3 + 0.33) / 2 / 40)
# Cycles and range [MPa] of the stairs, by Goodman's line the range from zero; overrides.
SPECTRA: dict[str, tuple[tuple[float, float], Sequence[str]]] = {
    "levels": ((0.0, 0.0), ("fatigue.spectrum.stairs=null",)),
    "spectrum": ((5e4, 2.97), ()),
    "goodman": ((5e4, 2 * STAIRS / (1 + STAIRS / 40)), ("fatigue.goodman=40 MPa",)),
}


def power_law(stress: float) -> float:
    """Cycles to failure."""
    return 10**8.77 * stress**-4.68 if stress else float("inf")


def logarithmic_law(stress: float) -> float:
    """Cycles to failure."""
    return 10 ** ((37.8 - stress) / 4.736)


LAWS = {"power": power_law, "logarithmic": logarithmic_law}


@verify
@pytest.mark.parametrize(
    ("name", "law"),
    [pytest.param(name, law, id=f"{name}_{law}") for name in SPECTRA for law in LAWS],
)
def test_miner(problem: KnownProblem, name: str, law: str) -> None:
    damage_name = f"{law}.damage_p99"
    problem.expects(f"{damage_name}, relative", tolerance=1e-9, source="Miner's sum of n / N(s)")
    stairs, changes = SPECTRA[name]
    solved = problem.solve("verification/spectrum.yaml", *changes)
    damage = sum(n / LAWS[law](stress) for n, stress in (*FROM_ZERO, stairs))
    problem.compare(summary_number(solved, damage_name, damage))
