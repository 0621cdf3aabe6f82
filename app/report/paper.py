"""The paper by Rakotomanana and Ramaniraka: its cases in a sweep, and their temperatures.

A sweep with ``compare_with: paper`` names its parts as `configs/sweeps/paper.yaml` does; the
paper's cases are known by these names.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import Any, TypeVar

import numpy as np

from app.case.case import read_geometry
from app.errors import MantleError
from app.report.sweep_results import PERCENTILES, Number, SweepResults, SweptCase, magnitude
from app.results.percentiles import percentile
from app.results.reading import Run
from app.results.unrolled import facets

STEMS = {110e3: "titanium", 200e3: "CoCr"}  # Young's modulus [MPa]
THICKNESS, BONE_FRICTION = 4.0, 1.0  # of the mantle [mm] and at the bone where the other varies
# Parts of the sweep by what they are, of hot cement with the model.
STANCES, HOT, COOLED = (
    ("thickness", "friction", "limits"),
    {"hot": "femur", "slice": "slice"},
    "cooled",
)
READINGS = {"initial": "100 °C at the start", "held": "100 °C held"}
# When the temperature of cement that starts at 100 degC is reported; the paper names no time [s].
AT = 10.0
# Earlier numbers of a perfect interface include its first instant, an average over nodes [s].
SETTLED = 2.0

Family = dict[float, SweptCase]
X = TypeVar("X")
Numbers = Callable[[SweptCase], Number | None]


class Cases:
    """Cases of the paper in a sweep; none if the sweep is not compared with it.

    Attributes:
        stances: Single-limb stances on a stem in contact with its cement.
        hot: Cases of hot cement, bonded ones too.
    """

    def __init__(self, sweep: SweepResults) -> None:
        own = sweep.cases if sweep.compare_with == "paper" else ()
        # Of equal cases the finer counts, then the first: the last overwrites.
        ordered = sorted(reversed(own), key=lambda c: c.unknowns)
        self.stances = [c for c in ordered if c.part in STANCES and _friction(c, "stem_cement")]
        self.hot = [c for c in ordered if c.part in (*HOT, COOLED)]

    def __bool__(self) -> bool:
        """Whether any has results."""
        return any(c.done for c in (*self.stances, *self.hot))

    def thicknesses(self, stem: str, friction: float = BONE_FRICTION, done: bool = True) -> Family:
        """Stances by thickness of the mantle, at a friction coefficient at the bone."""
        own = (c for c in self.stances if stem_of(c) == stem and c.done >= done)
        return _family((c for c in own if same(bone_friction(c), friction)), thickness)

    def frictions(self, stem: str) -> Family:
        """Stances with a mantle of 4 mm, by friction coefficient at the bone."""
        own = (c for c in self.stances if stem_of(c) == stem and c.done)
        return _family((c for c in own if same(thickness(c), THICKNESS)), bone_friction)

    def of_stems(self) -> dict[str, SweptCase]:
        """Stances with a mantle of 4 mm, by material of the stem."""
        found = {stem: self.thicknesses(stem).get(THICKNESS) for stem in STEMS.values()}
        return {stem: case for stem, case in found.items() if case}

    def heats(self, done: bool = True) -> dict[tuple[str, str], Family]:
        """Cases of hot cement by model and reading, then by thickness."""
        found = {}
        for part, model in HOT.items():
            for reading in READINGS:
                own = [c for c in self.hot if c.part == part and reading_of(c) == reading]
                found[model, reading] = _family([c for c in own if c.done >= done], thickness)
        return {key: family for key, family in found.items() if family}

    def representative(self) -> list[list[tuple[str, SweptCase]]]:
        """Cases to draw in groups: both stems at 4 and 2 mm, the ends of each reading of heat."""
        stances = []
        for stem in STEMS.values():
            family = self.thicknesses(stem)
            stances += [(f"{stem}, {t:g} mm", family[t]) for t in (4.0, 2.0) if t in family]
        hot = []
        for (model, reading), family in self.heats().items():
            if model == "femur":
                ends = dict.fromkeys((min(family), max(family)))
                hot += [(f"100 °C {reading}, {t:g} mm", family[t]) for t in ends]
        return [group for group in (stances, hot) if group]


def _family(cases: Iterable[SweptCase], key: Callable[[SweptCase], float | None]) -> Family:
    found = {x: c for c in cases if (x := key(c)) is not None}
    return dict(sorted(found.items()))


def _value(case: SweptCase, *path: str) -> Any:
    found: Any = case.data
    for key in path:
        found = found.get(key) if isinstance(found, dict) else None
    return found


def stem_of(case: SweptCase) -> str:
    """Material of the stem."""
    modulus = magnitude(_value(case, "regions", "stem", "youngs_modulus"))
    return STEMS.get(modulus or 0.0, "")


def thickness(case: SweptCase) -> float | None:
    """Thickness of the mantle [mm]."""
    return magnitude(_value(case, "geometry", "cement_thickness"))


def _friction(case: SweptCase, place: str) -> float | None:
    return magnitude(_value(case, "interfaces", place, "friction_coefficient"))


def bone_friction(case: SweptCase) -> float | None:
    """Friction coefficient at the cement-bone interface."""
    return _friction(case, "cement_bone")


def reading_of(case: SweptCase) -> str:
    """How the paper's "100 degrees" are read: ``held`` or ``initial``."""
    return "held" if "heat.held" in case.overrides else "initial"


def conductance(case: SweptCase) -> str:
    """Thermal conductance of the cement-bone interface, in words."""
    h = _value(case, "interfaces", "cement_bone", "conductance")
    if isinstance(h, dict):
        return str(h.get("kind"))
    value = magnitude(h)
    return "perfect" if value is None else f"{1e3 * value:.4g} W/(m²K)"


def same(a: float | None, b: float) -> bool:
    """Whether two numbers are equal to rounding."""
    return a is not None and math.isclose(a, b, rel_tol=1e-6)


def contact(place: str, quantity: str, how: str) -> Numbers:
    """A contact quantity of an interface: its ``max`` or ``percentile``."""
    part = PERCENTILES[quantity] if how == "percentile" else how
    return lambda case: case.number(f"{place}.{quantity}_{part}")


def series(family: Mapping[X, SweptCase], of: Numbers) -> dict[X, Number]:
    """A number over the parameter of a family of cases, where it is known."""
    return {x: n for x, c in family.items() if (n := of(c)) is not None}


# Temperatures


def cement_peak(case: SweptCase) -> Number | None:
    """Highest temperature of the cement [degC]; after ten seconds where it starts at 100 degC."""
    if reading_of(case) == "held":
        return case.number("cement.temperature_max")
    return at_ten_seconds(case, "cement")


def at_ten_seconds(case: SweptCase, region: str) -> Number | None:
    """Highest temperature of a region after ten seconds [degC]; its error if the run ends then."""
    rows = [r for r in case.history if _float(r, "seconds [s]") <= AT * (1 + 1e-9)]
    if not rows or _float(rows[-1], "seconds [s]") < 0.9 * AT:
        return None
    value = _float(rows[-1], f"{region} temperature_max [degC]")
    if math.isnan(value):
        return None
    last = len(rows) == len(case.history)
    return (case.number(f"{region}.temperature_end_max") if last else None) or Number(value)


def bone_peak(case: SweptCase) -> Number | None:
    """Highest temperature of bone at the cement-bone interface [degC], at any time.

    With perfect conductance: of all bone, from two seconds on.
    """
    if (found := case.number("cement_bone.temperature_max_second")) is not None:
        return found
    late = [r for r in case.history if _float(r, "seconds [s]") >= SETTLED]
    values = [_float(row, f"{bone} temperature_max [degC]") for row in late for bone in case.bones]
    known = [v for v in values if not math.isnan(v)]
    return Number(max(known)) if known else None


def _float(row: dict[str, str], key: str) -> float:
    with suppress(ValueError):
        return float(row.get(key) or "nan")
    return math.nan


def bone_p99(case: SweptCase) -> Number | None:
    """Temperature that 99 % of the bone area at the cement-bone interface stays below [degC].

    After ten seconds, or at the end where the cement is held at 100 degC. Peaks sit where bone is
    thinnest and depend on the mesh; this does not.
    """
    with suppress(OSError, LookupError, ValueError, MantleError):
        geometry, run = read_geometry(case.data, case.folder), Run(case.folder)
        step = -1
        if reading_of(case) == "initial":
            after = AT / (magnitude(case.data["stages"][0].get("duration")) or math.nan)
            step = int(np.flatnonzero(np.isclose(run.times, 1.0) & same(after, 1.0))[0])
        if geometry is None:
            return None
        T = run.temperature(step)
        sides = geometry.interface_sides["cement_bone"]
        first, second = ([1 + geometry.region_names.index(r) for r in side] for side in sides)
        triangles = facets(run, second, first)
        a, b, c = (run.points[triangles[:, k]] for k in range(3))
        areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        return Number(percentile(T[triangles].mean(axis=1), areas))
    return None
