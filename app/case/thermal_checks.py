"""Checks of what a case says of heat against its other case."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from app.laws.materials import Conductor
from app.laws.thermal import Convection, FixedTemperature, Perfusion
from app.schema.yaml_file import Fault


def cross_check(case: Any) -> Iterable[Fault]:
    """Every contradiction about heat between the case."""
    if case.regions is None:
        return
    regions = {name: region for name, region in case.regions.items() if region is not None}
    cold = [name for name, region in regions.items() if region.thermal is None]
    if len(cold) == len(regions):
        yield from _without_heat(case, whole=len(regions) == len(case.regions))
        return
    for name in cold:
        others = " and ".join(n for n in regions if n not in cold)
        text = f"'thermal' is missing; expected in every region or in none, like {others}"
        yield Fault(("regions", name), text)
    yield from _conductors(case, regions)
    yield from _stages(case, regions)


def _without_heat(case: Any, whole: bool) -> Iterable[Fault]:
    """Faults of keys that need a region that conducts heat."""
    if not whole or not case.regions:
        return  # the region that cannot be read may be the one that conducts
    text = "no region conducts heat; expected `thermal` in every region"
    if case.heat:
        yield Fault(("heat",), text)
    if case.time:
        yield Fault(("time",), text)
    for i, stage in enumerate(case.stages or ()):
        if stage.takes_time:
            key = "steady" if stage.steady else "duration"
            yield Fault(("stages", i, key), f"nothing takes time: {text}")
    for name, law in case.interfaces.items():
        for key in ("conductance", "friction_heating"):
            if getattr(law, key, None) is not None:
                yield Fault(("interfaces", name, key), text)


def _conductors(case: Any, regions: Mapping[str, Any]) -> Iterable[Fault]:
    """BodyForms where no region is a solid; regions of both sorts."""
    solid = [name for name, region in regions.items() if not isinstance(region, Conductor)]
    if len(solid) == len(regions):
        return
    if solid:
        text = f"a conductor beside solids ({', '.join(solid)}); expected conductors only, or none"
        for name in regions:
            if name not in solid:
                yield Fault(("regions", name), text)
        return
    for section in ("supports", "loads"):
        for name in getattr(case, section) or {}:
            yield Fault((section, name), "every region is a conductor: nothing can move")
    for name, law in case.interfaces.items():
        if law is not None and law.can_part:
            text = "every region is a conductor: nothing can part; expected kind: bonded"
            yield Fault(("interfaces", name), text)


def _stages(case: Any, regions: Mapping[str, Any]) -> Iterable[Fault]:
    """Stages in which heat does not flow, or has nowhere to go."""
    if not case.stages:
        return
    if not any(stage.takes_time for stage in case.stages):
        text = "heat has no time to flow; expected a duration, or steady: true, in some stage"
        yield Fault(("stages",), text)
    elif all(isinstance(region, Conductor) for region in regions.values()):
        for i, stage in enumerate(case.stages):
            if not stage.takes_time:
                text = "nothing happens in it; expected a duration, or steady: true"
                yield Fault(("stages", i), text)
    sinks = (FixedTemperature, Convection, Perfusion)
    drained = any(
        condition is None or isinstance(condition, sinks) for condition in case.heat.values()
    )
    setting = [name for name, region in regions.items() if region.thermal and region.thermal.cure]
    for i, stage in enumerate(case.stages):
        if stage.steady and not drained:
            text = "nothing settles the temperature; expected heat of kind temperature, convection"
            yield Fault(("stages", i, "steady"), f"{text} or perfusion")
        if stage.steady and setting:
            text = f"{', '.join(setting)} sets with time; expected a duration"
            yield Fault(("stages", i, "steady"), text)
