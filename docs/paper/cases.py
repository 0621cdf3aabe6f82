"""The paper's cases in a sweep, by the parts of `configs/sweeps/paper.yaml`; their numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from functools import reduce
from operator import attrgetter
from typing import Any, TypeVar

import numpy as np

from app.case.case import read_geometry
from app.case.number_text import Number
from app.foundation.arrays import Floats
from app.foundation.errors import MantleError
from app.report.pictures import facets
from app.report.sweep_results import PERCENTILES, SweepResults, SweptCase, magnitude
from app.results.percentiles import percentile
from app.results.reading import Run

STEMS = {"titanium": 110e3, "CoCr": 200e3}  # Young's modulus [MPa]
# Parameters of a single-limb stance where another one varies: mantle [mm], friction at the bone.
REFERENCE = {"thickness": 4.0, "friction": 1.0}
# Models by the parts of the sweep.
MODELS = {
    **dict.fromkeys(("thickness", "friction", "limits"), "stance"),
    **{"hot": "femur", "slice": "slice", "cooled": "cooled"},
}
# Places by Gruen zone, from 1.
ZONES = ["proximal lateral", "intermediate lateral", "distal lateral", "at the tip or below"]
ZONES += ["distal medial", "intermediate medial", "proximal medial"]
# Parts that vary what the paper does not tell: does a trend that differs agree there?
CAUSES = {
    "canal": "room in the canal",
    "loads": "loads in balance",
    "interface": "a smoother stem",
    "history": "cement that set first",
}
READINGS = {"initial": "100 °C at the start", "held": "100 °C held"}
# When the temperature of cement that starts at 100 degC is reported; the paper names no time [s].
AT = 10.0
# Earlier numbers of a perfect interface include its first instant, an average over nodes [s].
SETTLED = 2.0

Family = dict[Any, SweptCase]
X = TypeVar("X")
Numbers = Callable[[SweptCase], Number | None]


class Cases:
    """Cases of the paper in a sweep.

    Attributes:
        stances: Single-limb stances on a stem in contact with its cement.
        hot: Cases of hot cement, bonded ones too.
        causes: Stances that vary what the paper does not tell, by what it is.

    Args:
        cause: One of `CAUSES`: its stances alone.
    """

    def __init__(self, sweep: SweepResults, cause: str = "") -> None:
        parts = {cause: "stance"} if cause else MODELS
        # Of equal cases the finer counts, then the first: the last overwrites.
        ordered = sorted(reversed(sweep.cases), key=lambda c: c.unknowns)
        known = [c for c in ordered if c.part in parts]
        stances = [c for c in known if parts[c.part] == "stance"]
        self.stances = [c for c in stances if _friction(c, "stem_cement")]
        self.hot = [c for c in known if parts[c.part] != "stance"]
        self.causes = {} if cause else {w: Cases(sweep, part) for part, w in CAUSES.items()}

    def over(self, parameter: str, done: bool = True, **others: Any) -> Family:
        """Stances by stem, thickness or friction; the others as given, or of the reference."""
        fixed = {k: v for k, v in (REFERENCE | others).items() if k != parameter}
        return _family((c for c in self.stances if c.done >= done), parameter, fixed)

    def heats(self, done: bool = True) -> dict[tuple[str, str], Family]:
        """Cases of hot cement by model and reading, then by thickness."""
        finished = [c for c in self.hot if c.done >= done]
        pairs = [(model, reading) for model in ("femur", "slice") for reading in READINGS]
        families = {
            (m, r): _family(finished, "thickness", {"model": m, "reading": r}) for m, r in pairs
        }
        return {key: family for key, family in families.items() if family}


def _family(cases: Iterable[SweptCase], parameter: str, fixed: Mapping[str, Any]) -> Family:
    members = {}
    for case in cases:
        labelled = labels(case)
        if labelled[parameter] is not None and all(labelled[key] == v for key, v in fixed.items()):
            members[labelled[parameter]] = case
    return dict(sorted(members.items(), key=lambda item: STEMS.get(item[0], item[0])))


def labels(case: SweptCase) -> dict[str, Any]:
    """Model, stem, thickness [mm], friction at the bone, reading of "100 degrees"."""
    modulus = magnitude(_value(case, "regions", "stem", "youngs_modulus"))
    return {
        "model": MODELS.get(case.part, "stance"),
        "stem": next((stem for stem, stiffness in STEMS.items() if stiffness == modulus), None),
        "thickness": magnitude(_value(case, "geometry", "cement_thickness")),
        "friction": _friction(case, "cement_bone"),
        "reading": "held" if "heat.held" in case.overrides else "initial",
    }


def _value(case: SweptCase, *path: str) -> Any:
    data: Any = case.data
    return reduce(lambda part, key: part.get(key, {}), path, data)


def _friction(case: SweptCase, place: str) -> float | None:
    return magnitude(_value(case, "interfaces", place, "friction_coefficient"))


def conductance(case: SweptCase) -> str:
    """Thermal conductance of the cement-bone interface, in words."""
    h = _value(case, "interfaces", "cement_bone", "conductance")
    if isinstance(h, dict):
        return str(h.get("kind", "perfect"))
    value = magnitude(h)
    return "perfect" if value is None else f"{1e3 * value:.4g} W/(m²K)"


def contact(place: str, quantity: str, how: str) -> Numbers:
    """A contact quantity of an interface: its ``percentile``, or ``max`` with rim and tip."""
    if how == "percentile":
        return lambda case: case.number(f"{place}.{quantity}_{PERCENTILES[quantity]}")
    keys = [f"{place}{part}.{quantity}_max" for part in ("", "_rim", "_tip")]
    return lambda case: max(
        (n for key in keys if (n := case.number(key))), key=attrgetter("value"), default=None
    )


def peak_zone(case: SweptCase, place: str, quantity: str) -> str:
    """Where on an interface a contact quantity is largest, in words; empty if unknown."""
    zones = (
        numbers["interfaces"].get(place, {}) for numbers in case.summary.get("gruen", {}).values()
    )
    peaks = [
        (numbers.get(f"{quantity}_max", 0.0), z) for numbers, z in zip(zones, ZONES, strict=False)
    ]
    return max(peaks, default=(0.0, ""))[1]


def series(family: Mapping[X, SweptCase], of: Numbers) -> dict[X, Number]:
    """A number over the parameter of a family of cases, where it is known."""
    return {x: n for x, c in family.items() if (n := of(c)) is not None}


# Temperatures


def cement_peak(case: SweptCase) -> Number | None:
    """Highest temperature of the cement [degC]; after ten seconds where it starts at 100 degC."""
    if labels(case)["reading"] == "held":
        return case.number("cement.temperature_max")
    return at_ten_seconds(case, "cement")


def at_ten_seconds(case: SweptCase, region: str) -> Number | None:
    """Highest temperature of a region after ten seconds [degC]; its error if the run ends then."""
    seconds, T = _column(case, "seconds [s]"), _temperature(case, region)
    last = int((seconds <= AT * (1 + 1e-9)).sum()) - 1
    if last < 0 or seconds[last] < 0.9 * AT or math.isnan(T[last]):
        return None
    end = case.number(f"{region}.temperature_end_max") if last == len(seconds) - 1 else None
    return end or Number(float(T[last]))


def bone_peak(case: SweptCase) -> Number | None:
    """Highest temperature of bone at the cement-bone interface [degC], at any time.

    With perfect conductance: of all bone, from two seconds on.
    """
    highest = case.number("cement_bone.temperature_max_second")
    if highest is not None:
        return highest
    late = _column(case, "seconds [s]") >= SETTLED
    known = [T for bone in case.bones for T in _temperature(case, bone)[late] if T == T]
    return Number(float(max(known))) if known else None


def _temperature(case: SweptCase, region: str) -> Floats:
    return _column(case, f"{region} temperature_max [degC]")


def _column(case: SweptCase, title: str) -> Floats:
    """A column of history.csv; nan where there is none."""
    rows = len(next(iter(case.step_record.values()), ()))
    return case.step_record.get(title, np.full(rows, np.nan))


def bone_p99(case: SweptCase) -> Number | None:
    """Temperature that 99 % of the bone area at the cement-bone interface stays below [degC].

    After ten seconds, or at the end where the cement is held at 100 degC. Peaks sit where bone is
    thinnest and depend on the mesh; this does not.
    """
    with suppress(OSError, LookupError, ValueError, MantleError):
        run, step = Run(case.folder), -1
        if labels(case)["reading"] == "initial":
            duration = magnitude(case.data["stages"][0]["duration"])
            if duration is None or not math.isclose(duration, AT):
                return None
            step = int(np.flatnonzero(np.isclose(run.times, 1.0))[0])
        geometry = read_geometry(case.data, case.folder)
        if geometry is None:
            return None
        sides = geometry.interface_sides["cement_bone"]
        first, second = ([run.regions[r] for r in side] for side in sides)
        triangles = facets(run, second, first)
        a, b, c = (run.points[triangles[:, k]] for k in range(3))
        areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        T = run.temperature(step)[triangles].mean(axis=1)
        return Number(percentile(T, areas))
    return None
