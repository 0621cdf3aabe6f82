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

PULL = "loads.up={{kind: pressure, boundary: x_max, pressure: -{} MPa}}"
# 3.75 times the scale at the surface, as in pure bending by 80 N mm.
SHEAR = "loads.up={kind: force, boundary: x_max, force: [0 N, 0 N, -0.125 N]}"
LONG = "geometry.blocks=[{name: bar, size: [80 mm, 1 mm, 4 mm]}]"


def cement_problems() -> Iterator[Check]:
    """All of them."""
    s, volume, alone = 3.75, 640.0, "loads.down=null"
    threshold = "regions.bar.weibull.threshold=1 MPa"
    for m in (2.86, 10.0):
        bent = volume * s**m / 2 / (m + 1)
        rows: dict[str, tuple[float, tuple[str, ...], float]] = {
            "pulled": (volume * s**m, (alone, PULL.format(s)), 1e-9),
            "bent": (bent, (), 1e-6),
            "three_points": (320 * s**m / 2 / (m + 1) ** 2, (alone, SHEAR, LONG), 0.01),
            "threshold": (bent * (1 - 1 / s) ** (m + 1), (threshold,), 1e-6),
        }
        for name, (risk, changes, tolerance) in rows.items():
            what = f"risk of failure of a bar, shape {m:g}, relative"
            measure = partial(number, name="bar.failure_risk", reference=risk)
            runs = [(f"regions.bar.weibull.shape={m}", *changes)]
            yield problem(f"weibull_{name}_{m:g}", what, "bending", measure, tolerance, runs)
    what = "0 if a risk is said to grow with the mesh at a corner, and there alone"
    yield problem("weibull_corner", what, "corner", corner, 0.5)
    walking, stairs, stumbling = 3.0, 3.3 - 0.33, 6.6
    spectrum = ((1e6, walking), (5e4, stairs), (10, stumbling))
    # Goodman's line to 40 MPa: only the stairs do not come from zero.
    a, level = stairs / 2 / (1 - (3.3 + 0.33) / 80), 40.0
    goodman = (*spectrum[::2], (5e4, 2 * a / (1 + a / level)))
    for name, cycles, changes in (
        ("levels", spectrum[::2], ("fatigue.spectrum.stairs=null",)),
        ("spectrum", spectrum, ()),
        ("goodman", goodman, ("fatigue.goodman=40 MPa",)),
    ):
        laws = {
            "power": sum(n / 10**8.77 * x**4.68 for n, x in cycles),
            "logarithmic": sum(n / 10 ** ((37.8 - x) / 4.736) for n, x in cycles),
        }
        for law, damage in laws.items():
            measure = partial(number, name=f"{law}.damage_p99", reference=damage)
            what = f"damage in a year by a {law} law, relative"
            yield problem(f"miner_{name}_{law}", what, "spectrum", measure, 1e-9, [changes])


def corner(run: Run) -> Sample:
    """Whether the run says which of its risks grow with the mesh."""
    told = run.summary["error"]["unsettled"]
    beside, at = "corner.failure_risk" in told, told.get("corner_edge.failure_risk")
    note = f"from {at[1][1]:.2g} to {at[0][1]:.2g} at half the mesh size" if at else "not told"
    return Sample(float(beside or not at or at[0][1] < 3 * at[1][1]), note=note)
