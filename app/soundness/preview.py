"""Output of ``mantle check``: the parts of a case as read, and allowed but doubtful input.

Input is doubtful if a unit looks wrong, if nothing acts, or if elements lock.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from app.case.case import Case
from app.case.library import ORIGIN
from app.case.run_options import Stage
from app.case.section_loads import section_loads, table_of_section_loads
from app.foundation.layout import fixed, plain_text, several
from app.foundation.verdict import Verdict, note
from app.laws.cycle_tables import ROTATIONS
from app.laws.interface_laws import insertion_stages, most_interference
from app.laws.values import MEMORY, MUCH_INTERFERENCE, USUAL_INTERFERENCE
from app.scene.scene import build_scene
from app.schema.section import Section, added_keys, is_given
from app.schema.units import Plain
from app.soundness.cost import solid


@dataclass(frozen=True)
class CheckedCase:
    """Result of the check of a case.

    Attributes:
        description: The case in words and tables.
        size: Cells, unknowns and memory: estimated, or counted if it was meshed.
        notes: Warnings about allowed but doubtful input.
    """

    description: str
    size: str
    notes: tuple[Verdict, ...]

    def __str__(self) -> str:
        """Description, size and notes."""
        return "\n".join([self.description, self.size, *map(str, self.notes)])


def case_in_words(case: Case, given: Mapping[str, Mapping[str, object]]) -> str:
    """The case in words and tables; ``given`` is the data of the file, for its units."""
    lines = [case.title or "(no title)", ""]
    lines += ["geometry", *_entries(case.geometry, given.get("geometry"))]
    details = case.geometry.details | case.geometry.placement_details
    lines += [f"  {k}: {plain_text(v)}" for k, v in details.items()]
    lines += ["mesh", *_entries(case.mesh, given.get("mesh"))]
    lines += [f"  {k}: {plain_text(v)}" for k, v in case.geometry.grid(case.mesh).items()]
    lines.append("regions")
    for name, region in case.regions.items():
        kind = "rigid" if region.moves_rigidly is True else region.kind
        lines += [f"  {name}: {kind}", *_entries(region, given["regions"][name], 4)]
        if region.modulus_field:
            details = region.modulus_field.details(case.geometry)
            lines += [f"      {k}: {plain_text(v)}" for k, v in details.items()]
    lines += ["interfaces", *([] if case.interfaces else ["  none"])]
    for name, law in case.interfaces.items():
        a, b = (" + ".join(side) for side in case.geometry.interface_sides[name])
        lines += [
            f"  {name} ({a} | {b}): {law.kind}",
            *_entries(law, given.get("interfaces", {}).get(name), 4),
        ]
        if case.conducts and law.conductance is None:
            lines.append("    conductance: perfect, one temperature")
    if solid(case):
        lines += ["supports", *_table(case.supports)]
        lines += ["motions"] if case.motions else []
        for n, m in case.motions.items():
            rotation_text = f"no rotation about {plain_text(m.about)} mm"
            if m.rotation:
                table_text = m.rotation.cycle_table.description
                rotation_text = f"rotates about {plain_text(m.about)} mm by {m.rotation.axes}: "
                rotation_text += table_text
            lines.append(f"  {n}: {m.region}, {rotation_text}; translation {m.translation}")
        lines += [
            "loads",
            *_table(case.loads),
            *(f"  {resultant_text}" for resultant_text in resultant(case)),
        ]
    lines += ["not measured", *([*_not_measured(case)] or ["  none"])]
    if case.conducts:
        lines += ["heat", *_table(case.heat)]
    lines += ["stages", *map(_stage, build_scene(case).stages)]
    for key in added_keys(type(case)):
        section = case.added(key, Section)
        if section:
            lines += [key, *_entries(section, given.get(key))]
    if case.time is not None:
        lines += ["time", *_entries(case.time, given.get("time"))]
    if case.output.probes:
        lines += ["probes", *_table(case.output.probes)]
    if case.output.paths:
        lines += ["paths", *_table(case.output.paths)]
    varied = case.variations
    if varied:
        lines.append(f"variations: {len(varied)} runs, and none of the case without them")
        lines += [f"  {n}: {plain_text(keys) or 'the case as it is'}" for n, keys in varied.items()]
    return "\n".join(lines)


def _stage(stage: Stage) -> str:
    seconds = stage.extension_kind.seconds(stage) if stage.extension_kind else stage.seconds
    time = f"{seconds:g} s, " if seconds else "steady state, " * stage.steady
    steps = f"{stage.increments} increment{'s' if stage.increments > 1 else ''}"
    unit = "cycle" if stage.load_segments == stage.cycles else "half cycle"
    steps += f" per {unit}, {stage.cycles} cycles" if stage.cycles > 1 else ""
    return f"  {stage.name}: {time}{steps}{', adaptive' if stage.adaptive else ''}"


def _entries(model: Section, given_values: object, indent: int = 2) -> Iterable[str]:
    """A line per field: internal value, and the given one where that differs."""
    internal_values = model.model_dump(mode="json", exclude_none=True)
    source = given_values if isinstance(given_values, dict) else {}
    for key, value in internal_values.items():
        if value in ([], {}) or key in ORIGIN or (indent > 2 and key in ("kind", "rigid")):
            continue  # empty, or printed in the line above
        part = getattr(model, key)
        if isinstance(part, Section):
            kind = f" {value['kind']}" if "kind" in value else ""
            yield f"{' ' * indent}{key}:{kind}"
            yield from _entries(part, source.get(key), indent + 2)
            continue
        value_text = plain_text(value)
        given_text = plain_text(source[key]) if key in source else None
        note = "" if given_text is None or given_text == value_text else f"  ({given_text})"
        origin = ""
        if key not in source:
            origin = f"  [{'from the file' if key in model.from_file else 'default'}]"
        unit = next((f" {m.unit}" for m in _numbers(model, key) if m.unit), "")
        yield f"{' ' * indent}{key}: {value_text}{unit}{note}{origin}"


def _numbers(model: Section, key: str) -> list[Plain]:
    """Marks of a key that is a number without a written unit; none of another key."""
    return [m for m in type(model).model_fields[key].metadata if isinstance(m, Plain)]


def _table(entries: Mapping[str, Section]) -> list[str]:
    """A line per support, load, condition or probe."""
    lines = []
    for name, entry in entries.items():
        fields = entry.model_dump(mode="json", exclude_none=True)
        kind, place = fields.pop("kind", ""), fields.pop("boundary", "")
        descriptions = [f"{kind} on {place}" if place else kind] if kind else []
        value_texts = {
            k: _point(v) if k == "at" else getattr(getattr(entry, k), "description", plain_text(v))
            for k, v in fields.items()
        }
        descriptions += [
            f"{k} {value_text}" for k, value_text in value_texts.items() if k not in ORIGIN
        ]
        lines.append(f"  {name}: {', '.join(descriptions)}")
    return lines or ["  none"]


def _point(coordinates: object) -> str:
    """Coordinates of a point with their unit, to 0.1 mm."""
    return re.sub(
        r"-?\d+\.\d+(?:e[+-]?\d+)?",
        lambda number: fixed(float(number[0])).removesuffix(".0"),
        plain_text(coordinates),
    )


def _not_measured(case: Case) -> Iterable[str]:
    """Names of regions and loads whose values are not measured, a line for each status."""
    for status in ("assumed", "unverified", None):
        names_of_sections = []
        tables = {name: m.cycle for name, m in case.motions.items() if m.cycle is not None}
        loads = {name: load.cycle or load for name, load in case.loads.items()}
        parts: Any
        for section, parts in (("regions", case.regions), ("motions", tables), ("loads", loads)):
            names_with_status = [name for name, part in parts.items() if part.status == status]
            if names_with_status:
                all_parts = len(names_with_status) == len(parts)
                names_of_sections.append(
                    f"all {section}" if all_parts else f"{section} {', '.join(names_with_status)}"
                )
        if names_of_sections:
            yield f"  {status or 'without status'}: {'; '.join(names_of_sections)}"


def resultant(case: Case) -> Iterator[str]:
    """Resultant force at the end of the last stage in words; nothing without forces."""
    loads = [load for load in case.loads.values() if load.resultant is not None]
    if not loads:
        return
    factors = [1.0 if load.history is None else load.history[-1] for load in loads]
    forces = zip(*(load.resultant for load in loads), strict=True)
    total = [math.sumprod(factors, along) for along in forces]
    components = ", ".join(f"{c:.1f}" for c in total)
    remark = "" if len(loads) == len(case.loads) else ", without pressures and body forces"
    yield f"sum of the forces at the end: [{components}] N, {math.hypot(*total):.1f} N{remark}"
    sections = section_loads(case, len(case.stages))
    if sections:
        remark = "" if all(load.point for load in loads) else ", of loads with `at`"
        yield (
            f"force and moment above a section{remark}, at the end (last row: the knee; "
            "line: line of action of the force)"
        )
        yield from (f"  {line}" for line in table_of_section_loads(sections).splitlines())


# Doubtful input

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
# Young's moduli by the name of a region, else from gel to diamond [MPa]. The ranges hold any such
# material, but no value that is wrong by a factor of a thousand.
STIFFNESS = {
    "cancellous": (5.0, 2e4),
    "cortical": (1e3, 1e5),
    "bone": (50.0, 1e5),
    "cement": (100.0, 2e4),
    "stem": (1e3, 5e5),
    "metal": (5e3, 1e6),
    "": (1e-3, 1.5e6),
}
# Forces on a hip, from the press of a finger to a fall [N].
HIP_FORCES = (20.0, 5e4)
# Part of the peak of a cycle above which its end counts as the peak [-].
PEAK = 0.95
# Friction coefficient above which a note asks for its unit: porous metal in bone has 1.5.
MOST_FRICTION = 5.0
# Largest usual height of a stem's shoulder above the neck cut [mm].
MOST_PROUD = 15.0


InputNote = Callable[[Case], Iterable[Verdict]]
# Functions of other packages that return notes on the input of a case.
_INPUT_NOTES: list[InputNote] = []


def input_note(function: InputNote) -> InputNote:
    """Register a function of a case that returns notes on allowed but doubtful input."""
    _INPUT_NOTES.append(function)
    return function


def from_memory(place: str, source: str | None) -> list[Verdict]:
    """A note on values that were written without the original source."""
    return [note(str(source), place)] if MEMORY in str(source) else []


def input_notes(case: Case) -> list[Verdict]:
    """Return notes on allowed but doubtful input for `mantle check` and the log."""
    notes = [*case.geometry.former_keys]
    acts = [
        *(law.has_initial_gap for law in case.interfaces.values()),
        *(support.moves for support in case.supports.values()),
        *(region.eigenstrains for region in case.regions.values()),
    ]
    if not (case.conducts or case.loads or any(acts)):
        notes.append(note("nothing acts on the model: the result will be zero"))
    notes += _doubtful_materials(case)
    notes += _several_steady_states(case)
    notes += _doubtful_loads(case)
    notes += _no_load(case)
    for name, region in case.regions.items():
        notes += from_memory(f"regions.{name}", region.source)
    notes += _without_effect(case)
    notes += _open_conductances(case)
    notes += _proud(case)
    notes += _large_interferences(case)
    limits = dict.fromkeys(("temperature", "ambient"), TEMPERATURES)
    for name, condition in case.heat.items():
        notes += _far_off(f"heat.{name}", condition, limits)
    for notes_of in _INPUT_NOTES:
        notes += notes_of(case)
    return notes


def _doubtful_materials(case: Case) -> Iterable[Verdict]:
    """Notes on regions whose elements lock, and on unusual constants of materials."""
    for name, region in case.regions.items():
        if case.mesh.order == 1 and region.nearly_incompressible:
            message = (
                f"regions.{name} is nearly incompressible: linear tetrahedra lock (they are far "
                "too stiff)"
            )
            yield note(message, remedy="use mesh.order: 2")
    for name, region in case.regions.items():
        place, thermal = f"regions.{name}", region.thermal
        limits_of_material = next(
            limits for region_word, limits in STIFFNESS.items() if region_word in name
        )
        yield from _far_off(place, region, dict.fromkeys(MODULI, limits_of_material))
        yield from _far_off(f"{place}.thermal", thermal, USUAL)
        setting = None if thermal is None else thermal.cure
        yield from _far_off(f"{place}.thermal.cure", setting, {"heat": (1.0, 1e4)})


def _several_steady_states(case: Case) -> Iterable[Verdict]:
    """Notes on interfaces whose conductance and thermal expansion reinforce each other."""
    if not any(r.thermal and r.thermal.thermal_expansion for r in case.regions.values()):
        return
    for name, law in case.interfaces.items():
        if law.conducts_by_pressure and name not in case.sliding_boundaries:
            message = (
                "thermal expansion and a conductance that grows with pressure reinforce each "
                "other: several steady states may exist, some of them unstable"
            )
            remedy = "vary the initial temperatures, which select one of them"
            yield note(message, f"interfaces.{name}", remedy)


def _doubtful_loads(case: Case) -> Iterable[Verdict]:
    """Notes on the size of hip loads, on cycles without a rise, and on units of angles."""
    loads = [(load.resultant or (0.0,), load.history or (1.0,)) for load in case.loads.values()]
    force = max((math.hypot(*f) * max(map(abs, h)) for f, h in loads), default=0.0)
    if case.geometry.has_gruen_zones and force:
        if not HIP_FORCES[0] <= force <= HIP_FORCES[1]:
            yield note(f"the largest load on the hip is {force:.3g} N; is the unit wrong?")
    tables = [name for name, load in case.loads.items() if load.cycle is not None]
    insertion = insertion_stages(case.interfaces, case.geometry.press_fits)
    if tables and sum(not stage.takes_time for stage in case.stages) <= 1 + insertion:
        first = "first stage after the insertion" if insertion else "first stage"
        message = f"the cycle begins in the {first}, so that all loads act in its first step"
        stages = "{name: insertion}, {name: rise}" if insertion else "{name: rise}"
        remedy = f"put a stage before it in which the loads grow: stages: [{stages}, ...]"
        yield note(message, f"loads.{tables[0]}.cycle_table", remedy)
    yield from _doubtful_cycles(case)
    yield from _falling_loads(case)
    for name, motion in case.motions.items():
        columns = motion.cycle.columns if motion.cycle else {}
        largest = max((abs(a) for r in ROTATIONS for a in columns.get(r, ())), default=0.0)
        if 0.0 < largest < math.radians(0.5):
            message = "all angles are below 0.5 degrees; are they in radians?"
            yield note(message, f"motions.{name}.rotation.cycle_table")


def _no_load(case: Case) -> Iterable[Verdict]:
    """Note on a case in which no load acts and nothing else moves or strains the bodies."""
    if case.loads:
        if not any(load.cycle is not None or _acts(load.history) for load in case.loads.values()):
            remedy = "give a `history` that is not 0 in one of the stages"
            yield note("no load acts at any time: each `history` is 0", "loads", remedy)
        return
    moves = any(not s.is_spring and s.moves and _acts(s.history) for s in case.supports.values())
    strains = any(region.eigenstrains for region in case.regions.values())
    if moves or strains or case.motions or case.conducts or not solid(case):
        return
    is_pressed = any(law.overlaps_initially for law in case.interfaces.values())
    # An expression may have interferences somewhere.
    gaps = [gap for law in case.interfaces.values() for gap in law.gaps.values()]
    may_press = is_pressed or any(isinstance(gap.gap, str) for gap in gaps)
    if may_press and not case.geometry.has_gruen_zones:
        return  # a fit is tested
    only = "; only the interference strains the bodies" if is_pressed else ""
    yield note(f"no load acts at any time{only}", "loads", "add a load, if one is meant to act")


def _acts(history: Sequence[float] | None) -> bool:
    """Return True if a history is not always 0."""
    return history is None or any(history)


def _falling_loads(case: Case) -> Iterable[Verdict]:
    """Notes on stages with cycles in which loads of a former stage fall: they act in the valleys.

    Loads that have fallen to the valley of these cycles before are no fault.
    """
    has_table = any(load.cycle is not None for load in case.loads.values())
    for k, stage in enumerate(case.stages):
        if k == 0 or stage.cycles == 1 or has_table:
            continue
        valley_of_load: dict[str, float] = {}
        for name, load in case.loads.items():
            history = load.history or (1.0,) * len(case.stages)
            before, after = abs(history[k - 1]), abs(history[k])
            if after < before and before > stage.valley * max(map(abs, history)):
                valley_of_load[name] = before + stage.valley * (after - before)
        if valley_of_load:
            first, *others = valley_of_load
            names = f"{first} and {several(len(others), 'other load')}" if others else first
            parts = sorted({f"{100 * part:.0f}" for part in valley_of_load.values()}, key=float)
            message = (
                f"its valleys have {' or '.join(parts)} % of {names}, which act in the stage before"
                " and fall in the cycles of this one. So the inducible motion is only that from one"
                " activity to the other, and the permanent motion contains the former activity"
            )
            remedy = (
                "separate activities by a stage without cycles, such as {name: rest}; there the"
                f" history of the former loads is {stage.valley:g} or 0"
            )
            yield note(message, f"stages.{stage.name}", remedy)


def _doubtful_cycles(case: Case) -> Iterable[Verdict]:
    """Notes on cycles of the forces on a hip that end below their peak, and on constant forces."""
    if not case.geometry.has_gruen_zones:
        return
    sizes_of = {
        name: load.force_magnitudes for name, load in case.loads.items() if load.force_magnitudes
    }
    for name, sizes in sizes_of.items():
        last, peak = sizes[-1], max(sizes)
        if last < PEAK * peak:
            message = (
                f"the force ends at {100 * last / peak:.0f} % of its peak, and the numbers of a run"
                " are those at the end"
            )
            remedy = "begin and end the table at the peak"
            yield note(message, f"loads.{name}.cycle_table", remedy)
    constant = [n for n, load in case.loads.items() if load.resultant and not load.force_magnitudes]
    if sizes_of and constant:
        message = f"{', '.join(sizes_of)} follows a cycle, but {', '.join(constant)} stay constant"
        yield note(message, "loads", "give the muscles cycle tables, too, or leave them out")


def _without_effect(case: Case) -> Iterable[Verdict]:
    """Notes on keys that do nothing, loads on held boundaries, and high friction."""
    for path, reason in case.geometry.without_effect(case.mesh).items():
        if is_given(case, path):
            yield note(f"has no effect: {reason}", ".".join(path), "leave it out")
    for name, law in case.interfaces.items():
        for path, reason in law.without_effect.items():
            if is_given(law, path):
                key = ".".join(("interfaces", name, *path))
                yield note(f"has no effect: {reason}", key, "leave it out")
    fixed_boundaries = {s.boundary: n for n, s in case.supports.items() if s.clamps}
    for name, load in case.loads.items():
        for boundary in load.boundaries:
            support = fixed_boundaries.get(boundary)
            if support and not case.supports[support].stages:
                message = f"acts on {boundary}, which supports.{support} holds, so it has no effect"
                yield note(message, f"loads.{name}")
    for name, law in case.interfaces.items():
        for path, friction in law.frictions.items():
            if friction > MOST_FRICTION:
                key = ".".join(("interfaces", name, *path))
                message = f"is {friction:g}; for implants it is 0 to 1.5. Was it given in per cent?"
                yield note(f"{key} {message}")


def _open_conductances(case: Case) -> Iterable[Verdict]:
    """A note on interfaces that can open, but conduct heat as if they were closed."""
    if not (case.conducts and solid(case)):
        return
    open_names = [
        name
        for name, law in case.interfaces.items()
        if law.can_part and name not in case.sliding_boundaries and not law.conducts_by_pressure
    ]
    if open_names:
        message = "the conductance does not change where the interface opens"
        yield note(
            message, f"interfaces.{', '.join(open_names)}", "use `kind: pressure` for one that does"
        )


def _proud(case: Case) -> Iterable[Verdict]:
    """A note on a stem that stands far out of the bone."""
    height_above_cut = case.geometry.proud
    if height_above_cut > MOST_PROUD and case.of_tissue("bone"):  # a pot on a test bench has none
        message = (
            f"the shoulder of the stem is {height_above_cut:.3g} mm above the neck cut; in hips"
            " it is at most "
            f"{MOST_PROUD:g} mm. Is geometry.tip_z or geometry.insertion.depth wrong?"
        )
        yield note(message, "geometry")


def _large_interferences(case: Case) -> Iterable[Verdict]:
    """Notes on large interferences where no bone is; those of bone are notes of `press_fit`."""
    bones = {*case.of_tissue("bone")}
    for name, law in case.interfaces.items():
        first, second = case.geometry.interface_sides[name]
        if bones.intersection((*first, *second)):
            continue
        for path, surface in law.gaps.items():
            key, most = most_interference(surface)
            if most > MUCH_INTERFERENCE:
                place = ".".join(("interfaces", name, *path, key))
                message = f"is an interference of {most:g} mm; strains may not be small"
                yield note(message, place, f"usual: {USUAL_INTERFERENCE}, along the normal")


def _far_off(place: str, part: Section | None, limits: Mapping[str, Range]) -> Iterable[Verdict]:
    """Notes on values of a part of a case that are outside the limits of their keys."""
    for key, (lower_limit, upper_limit) in limits.items():
        value = dict(part or ()).get(key)
        values = [v for _, v in value] if isinstance(value, tuple) else [value]
        if part and any(
            isinstance(v, float) and v and not lower_limit <= abs(v) <= upper_limit for v in values
        ):
            value_text = plain_text(part.model_dump(mode="json")[key])
            yield note(f"{place}.{key} is {value_text}; is the unit wrong?")
