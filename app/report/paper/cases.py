"""The cases of a sweep that are the paper's.

A case is recognised by its physics in case.yaml, not by its name. Geometry, muscle forces and bone
constants of the paper (Rakotomanana and Ramaniraka) are unknown: where a sweep varies them too,
the paper's cases are those that most of its cases agree in.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from app.case import quantities
from app.report.sweep_results import Number, SweepResults, SweptCase, magnitude

INTERFACES = ("cement_bone", "stem_cement")
STEMS = {110e3: "titanium", 200e3: "CoCr"}  # Young's modulus [MPa]
HIP = 1800.0  # N
STEM_FRICTION, BONE_FRICTION, THICKNESS = 0.4, 1.0, 4.0
HOT = 100.0  # degC
# Contact quantities: key in the summary, unit for people, factor.
_CONTACT = {
    key: quantities.TABLE["interfaces"][f"{key}_max"]
    for key in ("gap", "slip", "motion", "pressure", "shear")
}
# The percentile of each that converges.
PERCENTILES = {
    key: next(p for p in ("p95", "p99") if quantities.TABLE["interfaces"][f"{key}_{p}"].headline)
    for key in _CONTACT
}
QUANTITIES = {key: (quantities.printed(q.shown), q.factor) for key, q in _CONTACT.items()}
WORDS = {key: q.label.removesuffix(", max") for key, q in _CONTACT.items()}
WORDS |= {"cement_bone": "cement-bone", "stem_cement": "stem-cement"}


@dataclass(frozen=True)
class Physics:
    """Parameters of a case of the paper.

    Attributes:
        model: ``stance``, ``femur`` (hot cement in the femur) or ``slice`` (of cylinders).
        stem: Of what material; empty where it is a conductor alone.
        thickness: Of the mantle [mm].
        bone_friction: Friction coefficient at the cement-bone interface.
        reading: ``initial`` or ``held``, the two readings of "100 degrees"; empty without heat.
        conductance: Of the cement-bone interface in W/(m2 K), or ``perfect``; empty without heat.
        rest: All else that the answer depends on.
    """

    model: str
    stem: str
    thickness: float
    bone_friction: float | None
    reading: str
    conductance: str
    rest: str


def physics(data: dict[str, Any]) -> Physics | None:
    """The physics of a configuration, if it is one of the paper's.

    Args:
        data: The content of a resolved case.yaml.
    """
    try:
        return _physics(data)
    except (KeyError, TypeError, AttributeError, ValueError):
        return None


def _physics(data: dict[str, Any]) -> Physics | None:
    geometry, regions = data["geometry"], data["regions"]
    thickness = magnitude(geometry.get("cement_thickness"))
    if thickness is None or not {"stem", "cement"} <= set(regions):
        return None
    stem = STEMS.get(magnitude(regions["stem"].get("youngs_modulus")) or 0.0, "")
    laws = {name: data["interfaces"][name] for name in INTERFACES}
    friction = {name: magnitude(law.get("friction_coefficient")) for name, law in laws.items()}
    unilateral = all(law["kind"] == "contact" for law in laws.values())
    hot = regions["cement"].get("thermal")
    if hot is None:
        force = data["loads"]["hip"]["force"]
        total = math.hypot(*(magnitude(f) or 0.0 for f in force))
        ours = geometry["kind"] == "femur" and unilateral and friction["stem_cement"] is not None
        ours = ours and math.isclose(friction["stem_cement"] or 0.0, STEM_FRICTION)
        if not (ours and stem and math.isclose(total, HIP, rel_tol=0.01)):
            return None
        return Physics("stance", stem, thickness, friction["cement_bone"], "", "", _rest(data))
    model = {"femur": "femur", "cylinders": "slice"}.get(geometry["kind"])
    start = magnitude(hot.get("initial_temperature"))
    held = [c for c in data["heat"].values() if _holds(c)]
    if model is None or start is None or not math.isclose(start, HOT) or hot.get("cure"):
        return None
    if data["loads"] or stem == "titanium":
        return None
    h = laws["cement_bone"].get("conductance")
    conductance = "perfect"
    if isinstance(h, dict):
        conductance = str(h.get("kind"))
    elif (value := magnitude(h)) is not None:
        conductance = f"{1e3 * value:.4g} W/(m²K)"
    reading = "held" if held else "initial"
    mu = friction["cement_bone"]
    return Physics(model, stem or "CoCr", thickness, mu, reading, conductance, _rest(data))


def _holds(condition: dict[str, Any]) -> bool:
    """Whether a heat condition keeps the cement at 100 degC."""
    t = magnitude(condition.get("temperature"))
    held = condition.get("kind") == "temperature" and "cement" in condition.get("regions", [])
    return held and t is not None and math.isclose(t, HOT)


def _rest(data: dict[str, Any]) -> str:
    """Everything but mesh, steps and what `Physics` has apart, as text."""
    varied = ("cement_thickness", "bone_thickness")
    stem = {k: v for k, v in data["regions"]["stem"].items() if k != "youngs_modulus"}
    rest = {
        "geometry": {k: v for k, v in data["geometry"].items() if k not in varied},
        "regions": {**data["regions"], "stem": stem},
        "interfaces": {
            name: {k: v for k, v in law.items() if k != "friction_coefficient"}
            for name, law in data["interfaces"].items()
        },
        "supports": data.get("supports"),
        "loads": data.get("loads"),
        "heat": {k: v for k, v in data.get("heat", {}).items() if not _holds(v)},
    }
    return json.dumps(rest, sort_keys=True)


@dataclass(frozen=True)
class Known:
    """A case of the paper.

    Attributes:
        case: The case.
        physics: What it is.
    """

    case: SweptCase
    physics: Physics


class Cases:
    """The paper's cases among those of a sweep.

    Attributes:
        every: All cases that are of the kind, whatever they vary besides.
    """

    def __init__(self, sweep: SweepResults) -> None:
        """Recognise them."""
        self._compared = sweep.compare_with == "paper"
        cases = reversed(sweep.cases)  # of two that are the same the first counts: it comes last
        self.every = [Known(c, p) for c in cases if (p := physics(c.data)) is not None]
        counts: dict[str, Counter[str]] = {}
        for k in reversed(self.every):
            counts.setdefault(k.physics.model, Counter())[k.physics.rest] += 1
        # The rest that most cases of a model agree in; of equals the sweep's first.
        self._common = {model: c.most_common(1)[0][0] for model, c in counts.items()}
        # Most unknowns last, so that of two meshes the finer one counts.
        self.every.sort(key=lambda k: k.case.unknowns)

    def of(self, model: str, done: bool = True) -> list[Known]:
        """Cases of a model that differ in nothing but what the paper varies."""
        return [
            k
            for k in self.every
            if k.physics.model == model
            and k.physics.rest == self._common[model]
            and k.case.done >= done
        ]

    def stances(
        self, stem: str = "", friction: float | None = None, done: bool = True
    ) -> dict[float, SweptCase]:
        """Cases of single-limb stance by thickness.

        Args:
            stem: Of what material.
            friction: At the cement-bone interface, 1.0 by default.
            done: Only those with results.
        """
        mu = BONE_FRICTION if friction is None else friction
        found = {
            k.physics.thickness: k.case
            for k in self.of("stance", done)
            if k.physics.stem == stem and same(k.physics.bone_friction, mu)
        }
        return dict(sorted(found.items()))

    def frictions(self, stem: str, done: bool = True) -> dict[float, SweptCase]:
        """Cases of single-limb stance with a mantle of 4 mm by cement-bone friction."""
        found = {
            k.physics.bone_friction: k.case
            for k in self.of("stance", done)
            if k.physics.stem == stem and same(k.physics.thickness, THICKNESS)
        }
        return dict(sorted((mu, c) for mu, c in found.items() if mu is not None))

    def heats(self, done: bool = True) -> dict[tuple[str, str], dict[float, SweptCase]]:
        """Cases of hot cement by model and reading, then by thickness."""
        found: dict[tuple[str, str], dict[float, SweptCase]] = {}
        for model in ("femur", "slice"):
            if model not in self._common:
                continue
            for k in sorted(self.of(model, done), key=lambda k: k.physics.thickness):
                found.setdefault((model, k.physics.reading), {})[k.physics.thickness] = k.case
        order = [(m, r) for m in ("femur", "slice") for r in ("initial", "held")]
        return {key: found[key] for key in order if key in found}

    def conductance(self, model: str) -> str:
        """The conductance that the cases of `heats` have in common."""
        return next((k.physics.conductance for k in self.of(model, False)), "")

    @property
    def curves(self) -> bool:
        """Whether the sweep is to be compared, and varies what the paper does."""
        families: list[dict[float, SweptCase]] = [*self.heats().values()]
        for stem in STEMS.values():
            families += [self.stances(stem), self.frictions(stem)]
        return self._compared and any(len(family) > 1 for family in families)

    @cached_property
    def used(self) -> set[str]:
        """Names of the cases that the paper's figures are drawn from."""
        found = [c for stem in STEMS.values() for c in self.stances(stem, done=False).values()]
        found += [c for stem in STEMS.values() for c in self.frictions(stem, done=False).values()]
        found += [c for family in self.heats(done=False).values() for c in family.values()]
        return {c.name for c in found}


def same(a: float | None, b: float) -> bool:
    """Whether two numbers are equal to rounding."""
    return a is not None and math.isclose(a, b, rel_tol=1e-6)


Numbers = Callable[[SweptCase], Number | None]


def contact(place: str, quantity: str, how: str) -> Numbers:
    """A contact quantity of an interface, of which ``max`` or ``percentile``."""
    part = PERCENTILES[quantity] if how == "percentile" else how
    return lambda case: case.number(f"{place}.{quantity}_{part}")


def series(family: dict[float, SweptCase], of: Numbers) -> dict[float, Number]:
    """A number over what a family of cases varies, where it is known."""
    return {x: n for x, c in family.items() if (n := of(c)) is not None}
