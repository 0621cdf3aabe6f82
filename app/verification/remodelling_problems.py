"""Bone that remodels: problems of ``mantle verify`` and rows of ``mantle stress``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from app.results.reading import Run
from app.verification.check import Check, Sample, each, problem, row, run, worst

# Modulus at 1 g/cm3 [MPa], stimulus [J/g], lazy zone, bounds and start [g/cm3] of the cases.
C, K, S, BOUNDS, START = 100.0, 0.25, 0.35, (0.01, 1.74), 0.8
LAW = "remodelling.law={{density: apparent, ranges: [[0 g/cm^3, 0 MPa, 100 MPa, {}]]}}"


def limit(stress: float, start: float = START, lazy: float = S, exponent: float = 2.0) -> float:
    """Density at which a column under a stress [MPa] ends that comes from a start [g/cm3]."""
    zone = np.array([1 + lazy, 1 - lazy])
    ends = (stress**2 / (2 * C * K * zone)) ** (1 / (exponent + 1))
    return float(np.clip(start, *np.clip(ends, *BOUNDS)))


def grown(run: Run, **expected: float) -> Sample:
    """Density of regions against what is expected of them everywhere [g/cm3]."""
    rho = run.on_cells("density")
    parts = [rho[run.region == run.regions[name]] - value for name, value in expected.items()]
    return Sample(max(float(np.abs(part).max()) for part in parts))


def on_the_way(run: Run, tolerance: float) -> Sample:
    """Density after 2 s against its differential equation, over the tolerance of a step."""
    from scipy.integrate import solve_ivp

    def speed(t: float, rho: float) -> float:
        U = 3.0**2 / (2 * C * rho**3)
        return max(U - (1 + S) * K, 0.0) + min(U - (1 - S) * K, 0.0)

    exact = solve_ivp(speed, (0, 2), [START], rtol=1e-10, atol=1e-12).y[0, -1]
    found = float(run.on_cells("density").mean())
    return Sample(abs(found - exact) / tolerance, found, exact)


def balanced(run: Run) -> Sample:
    """Mass at the end less that at the start, added and cut, over that at the start."""
    return Sample(abs(run.summary["remodelling"]["mass"]["audit"]))


def even(runs: Sequence[Run], cells: Sequence[int]) -> Sample:
    """Change of mass from mesh to mesh, of so many cells a side; checkerboards, doubled.

    These are the part of the variance that alternates from cell to cell, of which 1 % is too much.
    """
    found = []
    for r, n in zip(runs, cells, strict=True):
        x = np.floor(n * r.points[r.cells].mean(axis=1)).astype(int)
        place = x[:, 0] * n + x[:, 2]
        rho = (np.bincount(place, r.on_cells("density")) / np.bincount(place)).reshape(n, n)
        alternating = np.diff(np.diff(rho, axis=0), axis=1) / 4
        found.append(Sample(float(2 * (alternating**2).mean() / rho.var()), note="checkerboards"))
    one, other = (r.summary["remodelling"]["mass"]["end"] for r in runs)
    return worst([*found, Sample(abs(one / other - 1), one, other)])


def remodelling_problems() -> Iterator[Check]:
    """Problems of ``mantle verify``."""
    block, press = "remodelling", "loads.press.pressure={} MPa"
    E = "regions.{}.youngs_modulus={} MPa"
    ends = [(3.0, START, 64), (8.0, START, 64), (3.0, 0.3, 9)]
    runs = [(press.format(p), E.format("bone", e)) for p, _, e in ends]
    judges = [partial(grown, bone=limit(p, start)) for p, start, _ in ends]
    what = "density at the edge of the lazy zone, from above and below [g/cm3]"
    yield problem("remodelling_ends", what, block, judges, 1e-3, runs)
    judges = [partial(grown, bone=b) for b in BOUNDS]
    pressed = [(press.format(p),) for p in (0.001, 40)]
    what = "density on its bounds [g/cm3]"
    yield problem("remodelling_bounds", what, block, judges, 1e-12, pressed)
    what = "density after 2 s, over the tolerance of a step, 1e-2 to 1e-4 g/cm3"
    steps = (1e-2, 1e-3, 1e-4)
    runs = [("stages.1.remodels=2 s", f"remodelling.tolerance={t} g/cm^3") for t in steps]
    courses = [partial(on_the_way, tolerance=t) for t in steps]
    yield problem("remodelling_course", what, block, courses, 0.5, runs)
    what = "density of two columns under one cap [g/cm3]: exponent 0.9, both stay"
    half, all_of_it = limit(3.0, lazy=0.0, exponent=0.9), limit(6.0, lazy=0.0)
    own = [(LAW.format(0.9), E.format("one", 83), E.format("other", 70))]
    both = partial(grown, one=half, other=half)
    yield problem("remodelling_two_stay", what, "columns", both, 0.01, own)
    what = "the same by exponent 2: one bears all, the other vanishes"
    alone = partial(grown, one=all_of_it, other=BOUNDS[0])
    yield problem("remodelling_one_stays", what, "columns", alone, 0.01)
    what = "mass that is not accounted for, over all, of two columns"
    yield problem("remodelling_mass", what, "columns", balanced, 1e-10)
    sizes = (10, 20)
    plates = tuple(run("verification/plate.yaml", f"mesh.size={1 / n} mm") for n in sizes)
    what = "mass of a plate on two meshes, relative, or twice its checkerboards"
    yield Check("remodelling_plate", what, plates, partial(even, cells=sizes), 0.02)


def densities() -> Iterator[Check]:
    """Rows of ``mantle stress``: density on both bounds."""
    for p in 10.0 ** np.arange(-3, 4):
        block = run("verification/remodelling.yaml", f"loads.press.pressure={p:g} MPa")
        yield row(f"density/{p:g} MPa", block, each(partial(grown, bone=limit(p))), 2e-3)
    columns = run("verification/columns.yaml", "loads.press.force=[0 N, 0 N, -15 N]")
    alone = each(partial(grown, one=limit(15.0, lazy=0.0), other=BOUNDS[0]))
    yield row("density/one of two columns", columns, alone, 0.01)
