"""Checks of one part of a case against another: names, lengths of histories, what holds the model.

They work on the parts that are valid by themselves, so that an error in one section does not hide
those of the others.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from app.case import thermal_checks
from app.case.femurs import Femur, IntactFemur
from app.case.quantities import of_run
from app.errors import Reason
from app.laws.materials import Conductor, Rigid
from app.schema.section import did_you_mean
from app.schema.yaml_file import Fault, Path


def cross_check(case: Any) -> list[Fault]:
    """Every contradiction between the case."""
    return [
        *_names(case),
        *_too_small(case),
        *_histories(case),
        *_stage_names(case),
        *_support_stages(case),
        *_rigid(case),
        *_held(case),
        *_side(case),
        *thermal_checks.cross_check(case),
        *thermal_checks.probe_regions(case),
    ]


def _unknown(path: Path, what: str, name: str, known: Iterable[str], owner: str) -> Fault:
    known = tuple(known)
    allowed = f"it has {', '.join(known)}" if known else "it has none"
    return Fault(
        path, f"the geometry ({owner}) has no {what} '{name}'; {allowed}{did_you_mean(name, known)}"
    )


def _names(case: Any) -> Iterable[Fault]:
    """Names that the geometry does not have, and regions without material."""
    geometry = case.geometry
    if geometry is None:
        return
    kind = geometry.kind
    regions, boundaries = geometry.region_names, geometry.boundary_names
    if case.regions is not None:
        for name in case.regions:
            if name not in regions:
                yield _unknown(("regions", name), "region", name, regions, kind)
        if missing := [name for name in regions if name not in case.regions]:
            yield Fault(
                ("regions",), f"no material for {', '.join(missing)}; every region needs one"
            )
        for name, region in case.regions.items():
            unsaid = name in regions and name not in geometry.tissues
            if region is not None and region.tissue is None and unsaid:
                text = "'tissue' is missing; expected bone, cement, implant or other"
                yield Fault(("regions", name), text)
    for name in case.interfaces or {}:
        if name not in geometry.interface_sides:
            yield _unknown(("interfaces", name), "interface", name, geometry.interface_sides, kind)
    for section in ("supports", "loads", "heat"):
        for name, entry in (getattr(case, section) or {}).items():
            boundary = getattr(entry, "boundary", None)
            if boundary is not None and boundary not in boundaries:
                yield _unknown((section, name, "boundary"), "boundary", boundary, boundaries, kind)
            for i, region in enumerate(getattr(entry, "regions", None) or ()):
                if region not in regions:
                    yield _unknown((section, name, "regions", i), "region", region, regions, kind)


def _too_small(case: Any) -> Iterable[Fault]:
    """Lengths that cells of the mesh's size do not go with."""
    if case.geometry is None or case.mesh is None:
        return
    size = case.mesh.size
    for key, (length, most) in case.geometry.spans.items():
        if size > most * length:
            text = f"cannot be meshed with edges of {size:g} mm (mesh.size)"
            expected = f"at least {size / most:.3g} mm, or a mesh.size of at most"
            yield Fault(("geometry", *key), f"{text}; expected {expected} {most * length:.3g} mm")


def _histories(case: Any) -> Iterable[Fault]:
    """Histories of another length than the stages."""
    if case.stages is None:
        return
    number = len(case.stages)

    def check(path: Path, history: tuple[float, ...] | None) -> Iterable[Fault]:
        if history is not None and len(history) != number:
            names = ", ".join(s.name for s in case.stages)
            wanted = f"{number}, one for the end of each stage ({names})"
            yield Fault(path, f"has {len(history)} values; expected {wanted}")

    for section in ("interfaces", "supports", "loads"):
        for name, entry in (getattr(case, section) or {}).items():
            for key in ("history", "gap_history"):
                if entry is not None and key in type(entry).model_fields:
                    yield from check((section, name, key), getattr(entry, key))
    for name, region in (case.regions or {}).items():
        for i, eigenstrain in enumerate(getattr(region, "eigenstrains", ())):
            history = getattr(eigenstrain, "history", None)
            yield from check(("regions", name, "eigenstrains", i, "history"), history)


def _stage_names(case: Any) -> Iterable[Fault]:
    """No stages, or two of the same name."""
    if case.stages is None:
        return
    if not case.stages:
        yield Fault(("stages",), "is empty; expected at least one stage")
    names = [s.name for s in case.stages]
    for i, name in enumerate(names):
        if name in names[:i]:
            yield Fault(
                ("stages", i, "name"),
                f"'{name}' is the name of an earlier stage too; expected another",
            )


def _support_stages(case: Any) -> Iterable[Fault]:
    """Supports that hold in stages that there are not."""
    if case.stages is None:
        return
    known = [stage.name for stage in case.stages]
    for name, support in (case.supports or {}).items():
        for i, stage in enumerate(getattr(support, "stages", None) or ()):
            if stage not in known:
                text = f"'{stage}' is not one of {', '.join(known)}{did_you_mean(stage, known)}"
                yield Fault(("supports", name, "stages", i), text)


def _rigid(case: Any) -> Iterable[Fault]:
    """Rigid regions in contact with each other, and models without any elastic region."""
    if case.geometry is None or not case.regions:
        return
    rigid = {name for name, region in case.regions.items() if isinstance(region, Rigid)}
    if rigid.issuperset(case.geometry.region_names):
        yield Fault(("regions",), "every region is rigid; at least one has to be elastic")
        return
    for name, law in (case.interfaces or {}).items():
        sides = case.geometry.interface_sides.get(name)
        if sides is None or law is None or not law.can_part:
            continue
        if all(rigid & set(side) for side in sides):
            regions = " and ".join(sorted(rigid & {*sides[0], *sides[1]}))
            text = f"contact between rigid regions ({regions}); one side has to be elastic"
            text += f" [{Reason.RIGID_CONTACT}]"
            yield Fault(("interfaces", name), text)


def _held(case: Any) -> Iterable[Fault]:
    """Directions in which nothing keeps the whole model from moving."""
    if case.supports is None or any(support is None for support in case.supports.values()):
        return
    if case.regions and all(isinstance(r, Conductor) for r in case.regions.values()):
        return
    limited = any(getattr(support, "stages", None) for support in case.supports.values())
    for stage in [s.name for s in case.stages or ()] if limited else [""]:
        held = {
            axis
            for support in case.supports.values()
            for axis in getattr(support, "felt_axes", support.held_axes)
            if not (stages := getattr(support, "stages", None)) or stage in stages
        }
        when = f" in stage '{stage}'" if stage else ""
        if free := [axis for axis in "xyz" if axis not in held]:
            along = "" if len(free) == 3 else f" along {' and '.join(free)}"
            allowed = "expected a support: fixed, roller, displacement or foundation"
            text = f"nothing holds the model{along}{when}; {allowed} [{Reason.LOOSE_BODY}]"
            yield Fault(("supports",), text)


def _side(case: Any) -> Iterable[Fault]:
    """Femurs that are made here are left ones."""
    if case.side == "right" and isinstance(case.geometry, Femur | IntactFemur):
        text = (
            f"the geometry ({case.geometry.kind}) is a left femur; expected left, whose numbers "
            "are those of the mirrored right one"
        )
        yield Fault(("side",), text)


def quantities(geometry: Any, study: Any) -> Iterable[Fault]:
    """Quantities of interfaces or regions that the geometry does not have."""
    if geometry is None or study is None:
        return
    known = (*geometry.interface_sides, *geometry.region_names)
    for i, quantity in enumerate(study.quantities):
        name = quantity.partition(".")[0]
        if name not in known and quantity not in of_run():
            path = ("study", "quantities", i)
            yield _unknown(path, "interface or region", name, known, geometry.kind)
