"""Allowed but doubtful input: wrong units, nothing that acts, elements that lock."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from app.case.case import Case
from app.laws.thermal import PressureConductance
from app.schema.section import Section
from app.system.layout import plain

Range = tuple[float, float]
# Ranges of material data, in internal units: from foam to diamond and osmium. Absolute temperatures
# between dry ice and burning.
TEMPERATURES = (190.0, 800.0)
USUAL = {
    "conductivity": (1e-2, 3e3),
    "axial_conductivity": (1e-2, 3e3),
    "transverse_conductivity": (1e-2, 3e3),
    "density": (1e-11, 2.3e-8),
    "specific_heat": (1e8, 1.5e10),
    "initial_temperature": TEMPERATURES,
    "reference_temperature": TEMPERATURES,
    "thermal_expansion": (1e-8, 1e-3),
}
MODULI = ("youngs_modulus", "axial_youngs_modulus", "transverse_youngs_modulus")
# Young's moduli by the name of a region, else of all from gel to diamond [MPa]: wide enough for any
# such material, too narrow for a factor of a thousand.
STIFFNESS = {
    "cancellous": (5.0, 2e4),
    "cortical": (1e3, 1e5),
    "bone": (50.0, 1e5),
    "cement": (100.0, 2e4),
    "stem": (1e3, 5e5),
    "metal": (5e3, 1e6),
    "": (1e-3, 1.5e6),
}
# Forces on a hip from that of a finger to that of a fall [N].
HIP_FORCES = (20.0, 5e4)


def warnings(case: Case) -> list[str]:
    """Warnings about allowed but doubtful input, for `mantle check` and the log."""
    messages = []
    if not case.conducts and not _acts(case):
        messages.append("nothing acts on the model: the result will be zero")
    if case.mesh.order == 1:
        messages += [
            f"regions.{name} is nearly incompressible: linear tetrahedra lock (they are far too "
            "stiff); use mesh.order: 2"
            for name, region in case.regions.items()
            if getattr(region, "nearly_incompressible", False)
        ]
    for name, region in case.regions.items():
        place, thermal = f"regions.{name}", region.thermal
        known = next(limits for word, limits in STIFFNESS.items() if word in name)
        messages += _far_off(place, region, dict.fromkeys(MODULI, known))
        messages += _far_off(f"{place}.thermal", thermal, USUAL)
        cure = None if thermal is None else thermal.cure
        messages += _far_off(f"{place}.thermal.cure", cure, {"heat": (1.0, 1e4)})
    expands = any(r.thermal and r.thermal.thermal_expansion for r in case.regions.values())
    messages += [
        f"interfaces.{name}: expansion and a conductance that grows with pressure feed each other: "
        "there may be several states, and the initial temperatures decide between them"
        for name, law in case.interfaces.items()
        if expands and isinstance(law.conductance, PressureConductance)
    ]
    force = _largest_force(case)
    if case.geometry.kind in ("femur", "intact_femur") and force:
        if not HIP_FORCES[0] <= force <= HIP_FORCES[1]:
            messages.append(f"the largest of the loads is {force:.3g} N, on a hip: a wrong unit?")
    limits = dict.fromkeys(("temperature", "ambient"), TEMPERATURES)
    for name, condition in case.heat.items():
        messages += _far_off(f"heat.{name}", condition, limits)
    return messages


def _acts(case: Case) -> bool:
    """Whether anything moves or strains the model."""
    gaps = any(getattr(law, "gap", None) for law in case.interfaces.values())
    moved = any(any(getattr(s, a, None) for a in "xyz") for s in case.supports.values())
    strained = any(getattr(r, "eigenstrains", ()) for r in case.regions.values())
    return bool(case.loads) or gaps or moved or strained


def _largest_force(case: Case) -> float:
    """The largest force at any time [N]."""
    loads = [(load.resultant or (0.0,), load.history or (1.0,)) for load in case.loads.values()]
    return max((math.hypot(*force) * max(map(abs, h)) for force, h in loads), default=0.0)


def _far_off(place: str, part: Section | None, limits: Mapping[str, Range]) -> Iterable[str]:
    """Messages on values of a part of a case that are beyond the limits of their keys."""
    for key, (low, high) in limits.items():
        value = getattr(part, key, None)
        if part and isinstance(value, float) and value and not low <= abs(value) <= high:
            text = plain(part.model_dump(mode="json")[key])
            yield f"{place}.{key} is {text}: a wrong unit?"
