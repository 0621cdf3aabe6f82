r"""Problems of ``mantle verify`` on the strength and the fatigue of cement, with closed forms.

R V_0 is V s^m in a bar pulled, V s^m / (2 (m + 1)) in pure bending, V s^m / (2 (m + 1)^2) where the
moment falls to zero along the bar; above a threshold t of the scale, bent,
V (s - t)^(m + 1) / (2 s (m + 1)). Damage of n cycles under s is n / N(s).
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from app.results.reading import Run
from app.verification.check import Check, Sample, problem
from app.verification.measures import number

# 3.75 times the scale at the surface, as in pure bending by 80 N mm.
PULL = "loads.up={kind: pressure, boundary: x_max, pressure: -3.75 MPa}"
SHEAR = "loads.up={kind: force, boundary: x_max, force: [0 N, 0 N, -0.125 N]}"
LONG = "geometry.blocks=[{name: bar, size: [80 mm, 1 mm, 4 mm]}]"
ALONE, LEAST = "loads.down=null", "regions.bar.weibull.threshold=1 MPa"


def cement_problems() -> Iterator[Check]:
    """All of them."""
    s, volume = 3.75, 640.0
    for m in (2.86, 10.0):
        bent, shape = volume * s**m / 2 / (m + 1), f"regions.bar.weibull.shape={m}"
        row = partial(_row, case="bending", of="bar.failure_risk")
        yield row(f"weibull_pulled_{m:g}", volume * s**m, 1e-9, shape, ALONE, PULL)
        yield row(f"weibull_bent_{m:g}", bent, 1e-6, shape)
        yield row(f"weibull_threshold_{m:g}", bent * (1 - 1 / s) ** (m + 1), 1e-6, shape, LEAST)
        third = 320 * s**m / 2 / (m + 1) ** 2
        yield row(f"weibull_three_points_{m:g}", third, 0.01, shape, ALONE, SHEAR, LONG)
    what = "0 if a risk is said to grow with the mesh at a corner, and there alone"
    yield problem("weibull_corner", what, "corner", corner, 0.5)
    # Of walking, stairs and stumbling; only the stairs do not come from zero, for Goodman's line.
    a, both = 2.97 / 2 / (1 - (3.3 + 0.33) / 80), ((1e6, 3.0), (10, 6.6))
    for name, more, *changes in (
        ("levels", (0.0, 0.0), "fatigue.spectrum.stairs=null"),
        ("spectrum", (5e4, 2.97)),
        ("goodman", (5e4, 2 * a / (1 + a / 40)), "fatigue.goodman=40 MPa"),
    ):
        cycles = (*both, more)
        row = partial(_row, case="spectrum")
        power = sum(n / 10**8.77 * x**4.68 for n, x in cycles)
        yield row(f"miner_{name}_power", power, 1e-9, *changes, of="power.damage_p99")
        line = sum(n / 10 ** ((37.8 - x) / 4.736) for n, x in cycles)
        yield row(f"miner_{name}_logarithmic", line, 1e-9, *changes, of="logarithmic.damage_p99")


def _row(name: str, right: float, tolerance: float, *changes: str, case: str, of: str) -> Check:
    """A run of a case with changes, and one of its numbers."""
    measure = partial(number, name=of, reference=right)
    return problem(name, f"{of}, relative", case, measure, tolerance, [changes])


def corner(run: Run) -> Sample:
    """Whether the run says which of its risks grow with the mesh."""
    told = run.summary["error"]["unsettled"]
    (_, fine), (_, coarse) = told.get("corner_edge.failure_risk", ((1, 0), (2, 0)))
    note = f"from {coarse:.2g} to {fine:.2g} at half the mesh size"
    return Sample(float("corner.failure_risk" in told or not fine > 3 * coarse), note=note)
