"""Checks of one part of a case against another: names, lengths of load histories, supports.

They work on the valid parts, so that an error in one section does not hide errors in others.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Protocol, TypeVar

from app.case.probes import StrainGauge
from app.case.quantities import ADDED, PARTS, names_of_run_numbers
from app.case.run_options import STAGE_KINDS, OutputOptions, Stage, TimeOptions
from app.case.shapes import COMPANION, MOST_LINES, MeshOptions, Shape
from app.foundation.layout import two_digits
from app.foundation.verdict import Reason
from app.laws.heat_conditions import HeatCondition
from app.laws.interface_laws import InterfaceLaw
from app.laws.loads import Load
from app.laws.materials import Material
from app.laws.motions import Motion
from app.laws.supports import AnySupport
from app.laws.values import ROUNDING_OF_HEIGHTS
from app.schema.section import Section, did_you_mean
from app.schema.yaml_file import Fault, Path

T = TypeVar("T")

# Keys that a stage with cycle tables cannot have, and why.
NO_CYCLE_TABLE = {
    "creep_cycles": "needs constant loads",
    "creep_time": "needs constant loads",
    "fracture_step": "may reduce the loads",
}


class CaseParts(Protocol):
    """Parts of a case that checks read.

    An invalid part is None. A check is not called if a part that `check` names is None. Invalid
    entries of a table are None in every check.
    """

    @property
    def geometry(self) -> Shape:
        """Bodies, interfaces and boundaries."""

    @property
    def side(self) -> str:
        """Side of the hip, left or right."""

    @property
    def mesh(self) -> MeshOptions:
        """Mesh size and order."""

    @property
    def regions(self) -> Mapping[str, Material | None]:
        """Material of each region."""

    @property
    def interfaces(self) -> Mapping[str, InterfaceLaw | None]:
        """Law of each interface."""

    @property
    def supports(self) -> Mapping[str, AnySupport | None]:
        """Supports of the bodies."""

    @property
    def motions(self) -> Mapping[str, Motion | None]:
        """Regions that rotate far."""

    @property
    def loads(self) -> Mapping[str, Load | None]:
        """Loads on the bodies."""

    @property
    def heat(self) -> Mapping[str, HeatCondition | None]:
        """Heat conditions."""

    @property
    def stages(self) -> Sequence[Stage]:
        """Stages of the loading history."""

    @property
    def time(self) -> TimeOptions | None:
        """Division of stages into time steps."""

    @property
    def output(self) -> OutputOptions:
        """Results that are written."""

    @property
    def variations(self) -> Mapping[str, object]:
        """Overrides of each variation."""


# A check takes a case, or the parts of it that it reads.
Check = Callable[..., Iterable[Fault]]
# Every check of a case, with the parts that it needs.
_CHECKS: list[tuple[tuple[str, ...], Check]] = []


def check(*needed: str) -> Callable[[Check], Check]:
    """Register a check of the parts of a case against each other; also from another package.

    A check takes a case and returns its faults. It is left out where a needed part is invalid; of
    the other parts, invalid ones are None.
    """

    def register(function: Check) -> Check:
        _CHECKS.append((needed, function))
        return function

    return register


def cross_check(case: CaseParts) -> list[Fault]:
    """Contradictions between the parts of a case; invalid parts are None."""
    return [
        fault
        for needed, function in _CHECKS
        if all(getattr(case, part) is not None for part in needed)
        for fault in function(case)
    ]


def _unknown(
    path: Path, kind_name: str, name: str, known_names: Iterable[str], owner: str
) -> Fault:
    known_names = tuple(known_names)
    allowed = f"it has {', '.join(known_names)}" if known_names else "it has none"
    message = f"the geometry ({owner}) has no {kind_name} '{name}'; {allowed}"
    advice = did_you_mean(name, known_names)
    if not advice and (owner, kind_name) == ("file", "interface"):
        advice = f"; declare it: geometry: {{interfaces: {{{name}: [REGION, REGION]}}}}"
    return Fault(path, message + advice)


def _valid(entries: Mapping[str, T | None] | None) -> Iterator[tuple[str, T]]:
    """Name and entry of the valid entries of a section."""
    for name, entry in (entries or {}).items():
        if entry is not None:
            yield name, entry


def _entries(case: CaseParts, *sections: str) -> Iterator[tuple[str, str, Section]]:
    """Section, name and entry of the valid entries of sections."""
    for section in sections:
        entries: Mapping[str, Section | None] | None = getattr(case, section)
        for name, entry in _valid(entries):
            yield section, name, entry


@check("geometry")
def _names(case: CaseParts) -> Iterable[Fault]:
    """Names unknown to the geometry, and regions without material."""
    kind, regions = case.geometry.kind, case.geometry.region_names
    boundaries, interfaces = case.geometry.boundary_names, case.geometry.interface_sides
    used_names: list[tuple[Path, str, str | None]] = [
        *((("regions", name), "region", name) for name in case.regions or ()),
        *((("interfaces", name), "interface", name) for name in case.interfaces),
    ]
    for name, law in _valid(case.interfaces):
        for i, face in enumerate(law.sliding_boundaries or ()):
            used_names.append((("interfaces", name, "between", i), "boundary", face))
    for name, motion in _valid(case.motions):
        used_names.append((("motions", name, "region"), "region", motion.region))
    for section, name, entry in _entries(case, "supports", "loads", "heat"):
        keys = dict(entry)  # the keys of a load from another package may be others
        used_names.append(((section, name, "boundary"), "boundary", keys.get("boundary")))
        for i, region in enumerate(keys.get("regions") or ()):
            used_names.append(((section, name, "regions", i), "region", region))
    left_out = case.geometry.left_out
    used_names = [
        entry for entry in used_names if entry[2] not in left_out.get(str(entry[0][0]), ())
    ]
    if case.output is not None:
        for name, probe in (case.output.probes or {}).items():
            probe_path = ("output", "probes", name)
            used_names.append(((*probe_path, "region"), "region", probe.region))
            used_names.append(((*probe_path, "boundary"), "boundary", probe.boundary))
        for name, path_keys in (case.output.paths or {}).items():
            keys_path, interface = ("output", "paths", name), path_keys.interface_name or None
            used_names.append(((*keys_path, "region"), "region", path_keys.region))
            used_names.append(((*keys_path, "interface"), "interface", interface))
    known_names = {"region": regions, "interface": interfaces, "boundary": boundaries}
    for path, kind_name, used_name in used_names:
        if used_name is not None and used_name not in known_names[kind_name]:
            yield _unknown(path, kind_name, used_name, known_names[kind_name], kind)
    if case.regions is None:
        return
    missing_regions = [name for name in regions if name not in case.regions]
    if missing_regions:
        yield Fault(
            ("regions",), f"no material for {', '.join(missing_regions)}; every region needs one"
        )
    for name, region in _valid(case.regions):
        if region.tissue is None and name in regions:
            message = "'tissue' is missing; expected bone, cement, implant or other"
            yield Fault(("regions", name), message)


@check("geometry")
def _cement(case: CaseParts) -> Iterable[Fault]:
    """Names of a base that has cement, or none; interfaces that need a law."""
    geometry = case.geometry
    missing_laws = {n: law for n, law in geometry.laws_to_write.items() if n not in case.interfaces}
    unused = {
        section: [name for name in unused_names if name in (getattr(case, section) or {})]
        for section, unused_names in geometry.left_out.items()
    }
    if any(unused.values()):
        sections = []
        options = []
        for section, unused_names in unused.items():
            entry_of_name = dict.fromkeys(unused_names, "null")
            if section == "interfaces":
                entry_of_name |= missing_laws
            if not entry_of_name:
                continue
            written_entries = ", ".join(f"{name}: {entry}" for name, entry in entry_of_name.items())
            sections.append(f"`{section}: {{{written_entries}}}`")
            for name, entry in entry_of_name.items():
                option = shlex.quote(f"{section}.{name}={entry}")
                options.append(f"--set {option}")
        reason = "there is no cement"
        if "regions" not in geometry.left_out:
            reason = "there is cement; set `cement_thickness: 0 mm`, or change the rest"
        in_file = f"in a file, add {' and '.join(sections)}"
        message = f"{reason}: {in_file}; on the command line, add `{' '.join(options)}`"
        yield Fault(("geometry", "cement_thickness"), message)
    elif missing_laws:
        example = ", ".join(f"{name}: {law}" for name, law in missing_laws.items())
        names = ", ".join(missing_laws)
        message = f"no law for {names}; without one metal is bonded to bone as if ingrown"
        remedy = f"Write `{example}`, or `kind: bonded` if you mean this"
        yield Fault(("interfaces",), f"{message}. {remedy}")


@check("geometry")
def _mesh(case: CaseParts) -> Iterable[Fault]:
    """Lengths too small for the mesh size, and keys of layers on meshes without layers."""
    largest = case.geometry.coarsest_size
    if case.mesh is not None:
        if not case.mesh.size and largest:
            message = "'size' is missing; expected the edge length at the interfaces, e.g. 4 mm"
            yield Fault(("mesh",), message)
        if not case.geometry.spans and 0.0 < largest < case.mesh.size:
            message = f"{case.mesh.size:g} mm is larger than every part; use at most {largest:g} mm"
            yield Fault(("mesh", "size"), message)
        for key in ("around", "along", "through_cement"):
            if getattr(case.mesh, key) and not case.geometry.grid(case.mesh):
                message = "applies only to hips, which are meshed by lines and layers; leave it out"
                yield Fault(("mesh", key), f"{message} for geometry.kind: {case.geometry.kind}")
        if case.mesh.through_cement and "cement" in case.geometry.left_out.get("regions", ()):
            yield Fault(("mesh", "through_cement"), "there is no cement; leave through_cement out")
        yield from _lines(case.geometry, case.mesh)
    size = 0.0 if case.mesh is None else case.mesh.size
    for keys, (length, size_ratio) in case.geometry.spans.items():
        if size > size_ratio * length:
            message = f"is too small for edges of {size:g} mm (mesh.size)"
            expected_length = f"at least {size / size_ratio:.3g} mm, or a mesh.size of at most"
            yield Fault(
                ("geometry", *keys),
                f"{message}; expected {expected_length} {size_ratio * length:.3g} mm",
            )


def _lines(geometry: Shape, mesh: MeshOptions) -> Iterable[Fault]:
    """Distances of lines that the stem's section cannot hold, and steps that no part can."""
    distance_around, length = mesh.around, geometry.stem_perimeter
    if isinstance(distance_around, float) and length:
        # Rounded inwards: what the message allows is allowed.
        shortest, largest_distance = 1.001 * length / MOST_LINES, 0.999 * length / COMPANION
        if not length / MOST_LINES <= distance_around <= length / COMPANION:
            message = (
                f"{distance_around:g} mm: the section of the stem has a perimeter of {length:.3g}"
                " mm"
            )
            expected_distance = f"expected {two_digits(shortest)} to {largest_distance:.3g} mm"
            yield Fault(("mesh", "around"), f"{message}; {expected_distance}, or a number of lines")
    distance_along, largest_distance = mesh.along, geometry.coarsest_size
    if distance_along and length and distance_along > largest_distance:
        message = (
            f"{distance_along:g} mm: is longer than every part; expected at most"
            f" {largest_distance:g} mm"
        )
        yield Fault(("mesh", "along"), message)


@check("stages")
def _stages(case: CaseParts) -> Iterable[Fault]:
    """Missing or duplicate stages, load histories of wrong length, unknown stages of supports."""
    stage_names = [stage.name for stage in case.stages]
    if not stage_names:
        yield Fault(("stages",), "is empty; expected at least one stage")
    for i, name in enumerate(stage_names):
        if name in stage_names[:i]:
            message = f"'{name}' is the name of an earlier stage too; choose another name"
            yield Fault(("stages", i, "name"), message)
    laws = [law for _, law in _valid(case.interfaces)]
    if len(laws) == len(case.interfaces or ()) and not any(w.dissipates for w in laws):
        for i, stage in enumerate(case.stages):
            if stage.fracture_step:
                message = "no interface can break; expected an interface of kind: cohesive"
                yield Fault(("stages", i, "fracture_step"), message)
    load_histories: list[tuple[Path, Sequence[float] | None]] = [
        ((section, name, key), getattr(entry, key))
        for section, name, entry in _entries(case, "interfaces", "supports", "loads")
        for key in ("history", "gap_history")
        if key in type(entry).model_fields
    ]
    for name, region in _valid(case.regions):
        for i, strain in enumerate(region.eigenstrains):
            key = ("regions", name, "eigenstrains", i, "history")
            load_histories.append((key, strain.history))
    for path, load_history in load_histories:
        if load_history is not None and len(load_history) != len(stage_names):
            expected_values = (
                f"{len(stage_names)}, one for the end of each stage ({', '.join(stage_names)})"
            )
            yield Fault(path, f"has {len(load_history)} values; expected {expected_values}")
    used_stages: list[tuple[Path, str]] = []
    supports: Iterable[tuple[str, AnySupport]] = _valid(case.supports)
    for name, support in supports:
        stages = enumerate(support.stages or ())
        used_stages += [(("supports", name, "stages", i), stage) for i, stage in stages]
    for path, used_stage in used_stages:
        if used_stage not in stage_names:
            hint = did_you_mean(used_stage, stage_names)
            message = f"'{used_stage}' is not one of {', '.join(stage_names)}{hint}"
            yield Fault(path, message)


@check("geometry")
def _accuracy(case: CaseParts) -> Iterable[Fault]:
    """An accuracy where there is no mesh to choose, or no number that counts."""
    has_fixed_mesh = case.geometry.kind == "file" or case.variations
    touches = any(law and law.can_part for law in case.interfaces.values())
    if case.output and case.output.accuracy and (has_fixed_mesh or not touches):
        message = (
            "needs contact and a mesh that mantle makes; it cannot be used with variations or a "
            "mesh file"
        )
        yield Fault(("output", "accuracy"), message)


@check("geometry")
def _rigid(case: CaseParts) -> Iterable[Fault]:
    """Rigid regions in contact with each other, and models without any elastic region."""
    rigid = {name for name, region in _valid(case.regions) if region.moves_rigidly}
    if rigid.issuperset(case.geometry.region_names):
        yield Fault(("regions",), "every region is rigid; at least one has to be elastic")
        return
    for name, law in _valid(case.interfaces):
        sides = case.geometry.interface_sides.get(name)
        if sides and law.can_part and all(rigid & set(side) for side in sides):
            regions = " and ".join(sorted(rigid & {*sides[0], *sides[1]}))
            message = f"both sides are rigid ({regions})"
            remedy = "make one side elastic"
            path = ("interfaces", name)
            yield Fault(path, message, remedy=remedy, code=Reason.RIGID_CONTACT)


@check("supports")
def _held(case: CaseParts) -> Iterable[Fault]:
    """Directions in which the whole model is not constrained."""
    supports = [support for support in case.supports.values() if support is not None]
    if len(supports) < len(case.supports):
        return
    if case.regions and all(r and r.only_conducts for r in case.regions.values()):
        return
    limited = any(support.stages for support in supports)
    for stage in [s.name for s in case.stages or ()] if limited else [""]:
        held_axes = {
            axis
            for support in supports
            for axis in support.felt_axes
            if support.stages is None or stage in support.stages
        }
        when = f" in stage '{stage}'" if stage else ""
        free_axes = [axis for axis in "xyz" if axis not in held_axes]
        if free_axes:
            along_axes = "" if len(free_axes) == 3 else f" along {' and '.join(free_axes)}"
            message = f"no support holds the model{along_axes}{when}"
            remedy = "add a support: fixed, roller, displacement or foundation"
            yield Fault(("supports",), message, remedy=remedy, code=Reason.FLOATING_BODY)


@check()
def _names_of_zones(case: CaseParts) -> Iterable[Fault]:
    """Refuse zones with the name of a part that each interface has in the results."""
    for name, law in _valid(case.interfaces):
        for zone in law.zone_heights:
            if zone in PARTS:
                message = f"results have a part '{zone}' of each interface; choose another name"
                yield Fault(("interfaces", name, "zones", zone), message)


@check("geometry")
def _heights_on_stem(case: CaseParts) -> Iterable[Fault]:
    """Refuse zones and tables of interferences with heights above or below the stem."""
    length = case.geometry.stem_length
    expected = f"expected heights from 0 to {length:.0f} mm above its tip"
    for name, law in _valid(case.interfaces) if length else ():
        for zone, (low, high) in law.zone_heights.items():
            key = ("interfaces", name, "zones", zone)
            if low >= length or high <= 0.0:
                yield Fault(key, f"covers nothing of the stem; {expected}")
            elif -math.inf < low < 0.0:
                yield Fault((*key, "above"), f"{low:g} mm is below the stem; {expected}")
        for path, heights in law.table_heights.items():
            for i, height in enumerate(heights):
                if not 0.0 <= height <= length + ROUNDING_OF_HEIGHTS:
                    where = "below" if height < 0.0 else "above"
                    message = f"{height:g} mm is {where} the stem; {expected}"
                    yield Fault(("interfaces", name, *path, i), message)


@check("geometry")
def _side(case: CaseParts) -> Iterable[Fault]:
    """Refuse right parametric femurs, which are left ones."""
    if case.side == "right" and case.geometry.has_gruen_zones:
        message = (
            f"the geometry ({case.geometry.kind}) is a left femur; use `side: left`, with the "
            "loads of a right hip mirrored in x"
        )
        yield Fault(("side",), message)


@check("regions")
def _creep(case: CaseParts) -> Iterable[Fault]:
    """Stages of creep where no region creeps, or where a law counts in another measure."""
    regions = list(_valid(case.regions))
    if not case.regions or len(regions) < len(case.regions):
        return
    creep_laws = {name: region.creep for name, region in regions}
    laws = {name: law for name, law in creep_laws.items() if law is not None}
    for i, stage in enumerate(case.stages or ()):
        key = ("stages", i, stage.creep_key)
        if stage.creep and not laws:
            yield Fault(key, "no region creeps; expected `creep` in a region")
        for name, law in laws.items() if stage.creep else ():
            counts = "time" if law.per else "cycles"
            if stage.creep_key != f"creep_{counts}":
                message = f"{name} creeps by a law in {counts}: use creep_{counts} in this stage"
                yield Fault(key, message)


@check("geometry")
def _sliding(case: CaseParts) -> Iterable[Fault]:
    """Finite sliding without boundaries, parts that move twice, cycle tables without a stage."""
    moving_parts = [(("motions", n, "region"), m.region) for n, m in _valid(case.motions)]
    for name, law in _valid(case.interfaces):
        if law.finite_sliding:
            boundaries = law.sliding_boundaries or case.geometry.sliding_boundaries.get(name)
            if not boundaries:
                message = "its sides share facets of the mesh; mesh the bodies separately, and set "
                message += "`between` to two of "
                message += ", ".join(case.geometry.boundary_names)
                yield Fault(("interfaces", name, "sliding"), message)
            moving_parts += [(("interfaces", name, "between"), face) for face in boundaries or ()]
    users = dict[tuple[str, str], str]()
    for path, part in moving_parts:
        user = users.get((path[0], part))
        if user:
            yield Fault(path, f"{part} is used by {path[0]}.{user} already; choose another")
        users[path[0], part] = path[1]
    for name, motion in _valid(case.motions):
        region = (case.regions or {}).get(motion.region)
        if region is not None and region.moves_rigidly == bool(motion.boundary):
            message = f"{motion.region} is elastic; expected `boundary`, the surface that moves"
            if motion.boundary:
                message = f"{motion.region} is rigid and moves as a whole; leave `boundary` out"
            yield Fault(("motions", name, "region"), message)
    motions = tuple(case.motions or ())
    is_cyclic = any(motion.cycle for _, motion in _valid(case.motions))
    for name, load in _valid(case.loads):
        is_cyclic |= load.cycle is not None
        motion_name = load.followed_motion
        if motion_name is not None and motion_name not in motions:
            message = f"there is no motion '{motion_name}'{did_you_mean(motion_name, motions)}"
            yield Fault(("loads", name, "follows"), message)
    stages = case.stages or ()
    if is_cyclic and stages and all(stage.takes_time for stage in stages):
        key_of_end = "steady" if stages[-1].steady else "duration"
        message = "cycle tables act in the last stage without duration, and there is none; add one "
        message += "before this stage, which has the mean heat of a cycle"
        yield Fault(("stages", len(stages) - 1, key_of_end), message)
    last_loading = max((i for i, s in enumerate(stages) if not s.takes_time), default=0)
    reasons = NO_CYCLE_TABLE | {kind.key: kind.no_cycle_table for kind in STAGE_KINDS}
    for key, reason in reasons.items() if is_cyclic and stages else ():
        if getattr(stages[last_loading], key):
            message = f"{reason}, but cycle tables act in the last stage without duration, which is"
            message += f" this one; give `{key}` to an earlier stage"
            yield Fault(("stages", last_loading, key), message)


def quantities(case: CaseParts, names: Mapping[Path, str]) -> Iterable[Fault]:
    """Quantities, by path in a file, of owners of numbers that a case does not have."""
    geometry = case.geometry
    added_owners = [owner for section in ADDED.values() for owner in section.owners(case)]
    known_owners = (*geometry.interface_sides, *geometry.region_names, *added_owners)
    for path, quantity in names.items():
        name = quantity.partition(".")[0]
        if name not in known_owners and quantity not in names_of_run_numbers():
            yield _unknown(path, "interface or region", name, known_owners, geometry.kind)


# ------------------------------------------------------------------------------------- heat


@check("regions")
def _heat(case: CaseParts) -> Iterable[Fault]:
    """Regions with and without heat, and keys that need heat."""
    regions = dict(_valid(case.regions))
    without_heat = [name for name, region in regions.items() if region.thermal is None]
    if len(without_heat) == len(regions):
        yield from _without_heat(case, all_valid=len(regions) == len(case.regions))
        return
    for name in without_heat:
        with_heat = " and ".join(n for n in regions if n not in without_heat)
        message = f"'thermal' is missing; set it in every region or in none (now in {with_heat})"
        yield Fault(("regions", name), message)
    yield from _conductors(case, regions)
    yield from _flow(case, regions)


def _without_heat(case: CaseParts, all_valid: bool) -> Iterable[Fault]:
    """Faults of keys that need a region that conducts heat."""
    if not all_valid or not case.regions:
        return  # an invalid region may be the one that conducts
    message = "no region conducts heat; expected `thermal` in every region"
    if case.heat:
        yield Fault(("heat",), message)
    if case.time:
        yield Fault(("time",), message)
    for i, stage in enumerate(case.stages or ()):
        if stage.takes_time:
            key = "steady" if stage.steady else "duration"
            yield Fault(("stages", i, key), f"a stage has a duration only for heat: {message}")
    for name, law in _valid(case.interfaces):
        if law.conductance is not None:
            yield Fault(("interfaces", name, "conductance"), message)
        if law.heated_by_friction is not None:
            yield Fault(("interfaces", name, "friction_heating"), message)


def _conductors(case: CaseParts, regions: Mapping[str, Material]) -> Iterable[Fault]:
    """Mechanical sections where every region is a conductor; conductors beside solids."""
    solids = [name for name, region in regions.items() if not region.only_conducts]
    if len(solids) == len(regions):
        return
    if solids:
        message = (
            f"is of kind conductor, but others are solid ({', '.join(solids)}); expected only "
        )
        message += "conductors, or none"
        for name in regions:
            if name not in solids:
                yield Fault(("regions", name), message)
        return
    for section in ("supports", "loads"):
        for name in getattr(case, section) or {}:
            message = "every region is a conductor, which has no displacement; leave it out"
            yield Fault((section, name), message)
    for name, probe in _valid(case.output.probes if case.output else None):
        if isinstance(probe, StrainGauge):
            message = "every region is a conductor, which has no strain; use `kind: point`"
            yield Fault(("output", "probes", name), message)
    for name, law in case.interfaces.items():
        if law is not None and law.can_part:
            message = "every region is a conductor, which has no displacement; use `kind: bonded`"
            yield Fault(("interfaces", name), message)


def _flow(case: CaseParts, regions: Mapping[str, Material]) -> Iterable[Fault]:
    """Stages in which heat does not flow, or has no steady state."""
    if not case.stages:
        return
    if not any(stage.takes_time for stage in case.stages):
        message = "heat needs time: give at least one stage a `duration`, or `steady: true`"
        yield Fault(("stages",), message)
    elif all(region.only_conducts for region in regions.values()):
        for i, stage in enumerate(case.stages):
            if not stage.takes_time:
                message = "heat does not change in this stage; expected a duration, or steady: true"
                yield Fault(("stages", i), message)
    has_heat_sink = any(c is None or c.role != "heats" for c in case.heat.values())
    curing = [name for name, region in regions.items() if region.thermal and region.thermal.cure]
    for i, stage in enumerate(case.stages):
        if stage.steady and not has_heat_sink:
            message = "no steady state: no temperature is prescribed; expected heat of kind "
            yield Fault(("stages", i, "steady"), f"{message}temperature, convection or perfusion")
        if stage.steady and curing:
            message = f"{', '.join(curing)} cures over time; expected a duration instead of steady"
            yield Fault(("stages", i, "steady"), message)
