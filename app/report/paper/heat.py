"""Temperatures of the paper's cases with hot cement, as a report compares them.

The paper says neither when nor where its temperatures are taken.
"""

from __future__ import annotations

import math

import numpy as np

from app.case.case import read_geometry
from app.errors import MantleError
from app.report.sweep_results import Number, SweptCase, magnitude
from app.results.reading import Run
from app.results.unrolled import facets

# When the temperature of cement that starts at 100 degC is reported [s].
AT = 10.0
# Until then the first instant, an average over the nodes of a perfect interface, is in the numbers.
SETTLED = 2.0
PERCENTILE = 0.99


def cement_peak(case: SweptCase, reading: str) -> Number | None:
    """Highest temperature of the cement [degC]: after ten seconds where it starts at 100 degC."""
    if reading == "held":
        return case.number("cement.temperature_max")
    return at_ten_seconds(case, "cement")


def at_ten_seconds(case: SweptCase, region: str) -> Number | None:
    """Highest temperature of a region after ten seconds [degC]; its error if the run ends then."""
    rows = [r for r in case.history if _float(r, "seconds [s]") <= AT * (1 + 1e-9)]
    if not rows:
        return None
    value = _float(rows[-1], f"{region} temperature_max [degC]")
    last = len(rows) == len(case.history)
    end = case.number(f"{region}.temperature_end_max") if last else None
    if math.isnan(value) or _float(rows[-1], "seconds [s]") < 0.9 * AT:
        return None
    return end or Number(value)


def bone_peak(case: SweptCase) -> Number | None:
    """Highest temperature of bone at the cement-bone interface [degC], at any time.

    Where the conductance is perfect: of bone, from two seconds on.
    """
    if (found := case.number("cement_bone.temperature_max_second")) is not None:
        return found
    late = [r for r in case.history if _float(r, "seconds [s]") >= SETTLED]
    values = [_float(row, f"{bone} temperature_max [degC]") for row in late for bone in case.bones]
    known = [v for v in values if not math.isnan(v)]
    return Number(max(known)) if known else None


def _float(row: dict[str, str], key: str) -> float:
    try:
        return float(row.get(key) or "nan")
    except ValueError:
        return math.nan


def bone_p99(case: SweptCase, reading: str) -> Number | None:
    """Temperature that 99 % of the area of bone at the cement-bone interface stay below [degC].

    After ten seconds, or at the end where the cement is held at 100 degC. Peaks sit where bone is
    thinnest and depend on the mesh; this does not.
    """
    try:
        geometry = read_geometry(case.data, case.folder)
        run = Run(case.folder)
        T = run.temperature(-1 if reading == "held" else _step(case, run))
    except (OSError, KeyError, ValueError, MantleError):
        return None
    if geometry is None:
        return None
    sides = geometry.interface_sides["cement_bone"]
    first, second = ([1 + geometry.region_names.index(r) for r in side] for side in sides)
    triangles = facets(run, second, first)
    a, b, c = (run.points[triangles[:, k]] for k in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    values = T[triangles].mean(axis=1)
    order = np.argsort(values)
    below = np.cumsum(areas[order])
    return Number(float(values[order][np.searchsorted(below, PERCENTILE * below[-1])]))


def _step(case: SweptCase, run: Run) -> int:
    """The written step that ends the first ten seconds.

    Raises:
        ValueError: There is none.
    """
    duration = magnitude(case.data["stages"][0].get("duration"))
    if duration is None or not math.isclose(duration, AT):
        raise ValueError("the first stage does not take ten seconds")
    found = np.flatnonzero(np.isclose(run.times, 1.0))
    if not len(found):
        raise ValueError("the end of the first stage is not written")
    return int(found[0])
