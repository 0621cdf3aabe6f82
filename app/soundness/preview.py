"""Output of ``mantle check``: the parts of a case as they were understood, and its size."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mantle.schema.config import Case, Stage
from mantle.schema.fields import Section
from mantle.schema.materials import Conductor, Rigid
from mantle.schema.thermal_options import PressureConductance, Thermal
from mantle.schema.variation_options import expand

if TYPE_CHECKING:
    from mantle.meshes import MeshData

# Measured on unstructured tetrahedral meshes: nodes and edges per cell.
NODES_PER_CELL = 0.19
EDGES_PER_CELL = 1.22
# Data that some material has, in internal units: from foam to diamond and osmium. Absolute
# temperatures between dry ice and burning.
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
# Young's moduli of what the name of a region says it is, else of all from gel to diamond [MPa]:
# wide enough for any such material, and a thousand times off for none.
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
# What a run costs on one core (measured): seconds at 1e5 unknowns by order, exponent of growth, a
# later load step beside the first, seconds per temperature and time step, time steps of a stage,
# errors beside the run alone, a run that shares matrices beside one that makes them, and what is
# spent before anything is solved. The size that is assumed where it is not known.
PRICE, GROWTH, LATER = {1: 13.0, 2: 27.0}, 1.25, 0.5
HEAT, HEAT_STEPS, WITH_ERRORS, SHARED, START = 1.5e-5, 80, 1.4, 0.6, 6.0
UNKNOWN_SIZE = 3e4
# Area of an interface per node on it, in units of the squared edge length.
AREA_PER_NODE = 0.87


@dataclass(frozen=True)
class CheckedCase:
    """Result of the check of a case.

    Attributes:
        description: The case as it was understood, in words and tables.
        size: Cells, unknowns and memory: estimated, or counted if it was meshed.
        notes: What is allowed but rarely meant.
    """

    description: str
    size: str
    notes: tuple[str, ...]

    def __str__(self) -> str:
        """All of it."""
        return "\n".join([self.description, self.size, *(f"note: {n}" for n in self.notes)])


def describe(case: Case, given: Mapping[str, Any]) -> str:
    """The case in words and tables.

    Args:
        case: The case.
        given: The data of the file, to show values in the units they were given in.
    """
    geometry = case.geometry
    lines = [case.title or "(no title)", ""]
    lines += ["geometry", *_entries(geometry, given.get("geometry", {}))]
    lines += ["mesh", *_entries(case.mesh, given.get("mesh", {}))]
    lines.append("regions")
    for name, region in case.regions.items():
        kind = "rigid" if isinstance(region, Rigid) else region.kind
        lines += [f"  {name}: {kind}", *_entries(region, given["regions"][name], 4)]
    lines.append("interfaces")
    laws = given.get("interfaces", {})
    for name, law in case.interfaces.items():
        a, b = (" + ".join(side) for side in geometry.interface_sides[name])
        lines += [f"  {name} ({a} | {b}): {law.kind}", *_entries(law, laws.get(name, {}), 4)]
        if case.conducts and law.conductance is None:
            lines.append("    conductance: perfect, one temperature")
    if not case.interfaces:
        lines.append("  none")
    if _solid(case):
        lines += ["supports", *(_table(case.supports) or ["  none"])]
        lines += ["loads", *(_table(case.loads) or ["  none"]), *_resultant(case)]
    if case.conducts:
        lines += ["heat", *(_table(case.heat) or ["  none"])]
    lines += ["stages", *(_stage(stage) for stage in case.stages)]
    if case.time is not None:
        lines += ["time", *_entries(case.time, given.get("time", {}))]
    if case.output.probes:
        lines += ["probes", *_table(case.output.probes)]
    if varied := expand(case.variations):
        lines.append(f"variations: {len(varied)} runs, and none of the case without them")
        lines += [f"  {v.name}: {_plain(v.changes) or 'the case as it is'}" for v in varied]
    return "\n".join(lines)


def _stage(stage: Stage) -> str:
    """A line on a stage."""
    steps = f"{stage.increments} increment{'s' if stage.increments > 1 else ''}"
    time = "until nothing changes, " if stage.steady else ""
    time = f"{stage.duration:g} s, " if stage.duration else time
    return f"  {stage.name}: {time}{steps}{', adaptive' if stage.adaptive else ''}"


def _solid(case: Case) -> bool:
    """Whether anything in it can move."""
    return not all(isinstance(region, Conductor) for region in case.regions.values())


def estimated_size(case: Case) -> str:
    """Cells, unknowns and memory, from the parameters alone."""
    cells, nodes, corners, each = _estimated(case)
    if not cells:
        return "size\n  not known before it is meshed: --mesh counts"
    return _size("size (estimated; --mesh counts)", case, cells, nodes, corners, each)


def unknowns(case: Case) -> float:
    """How many unknowns a case has, estimated; 0 where that is not known before it is meshed."""
    cells, nodes, corners, each = _estimated(case)
    return sum(_unknowns(case, nodes, corners, each)) if cells else 0.0


def seconds(case: Case, alone: bool = True) -> float:
    """How long a run takes on one core, within a factor of two or three.

    Args:
        case: The case.
        alone: Whether it is the first of those that share mesh, forms and matrices.
    """
    cells, nodes, corners, each = _estimated(case)
    mechanical, thermal = _unknowns(case, nodes, corners, each) if cells else (UNKNOWN_SIZE, 0.0)
    price = PRICE[case.mesh.order] * (mechanical / 1e5) ** GROWTH
    steps = sum(1.0 + LATER * (stage.increments - 1) for stage in case.stages)
    timed = sum(1 for stage in case.stages if stage.duration)
    solution = price * steps + HEAT * HEAT_STEPS * timed * thermal
    solution *= WITH_ERRORS if case.output.error else 1.0
    return START + solution if alone else SHARED * solution


def _estimated(case: Case) -> tuple[float, float, float, dict[str, float]]:
    """Cells, nodes of the displacement, of the temperature, and of each interface."""
    cells = case.geometry.estimate_cells(case.mesh)
    corners = NODES_PER_CELL * cells + 50
    nodes = corners + (EDGES_PER_CELL * cells if case.mesh.order == 2 else 0)
    # Jumps are linear at either order; each interface has about the same share of the area.
    areas = case.geometry.interface_area / max(1, len(case.geometry.interface_sides))
    each = dict.fromkeys(case.interfaces, areas / (AREA_PER_NODE * case.mesh.size**2))
    return cells, nodes, corners, each


def _unknowns(
    case: Case, nodes: float, corners: float, interfaces: Mapping[str, float]
) -> tuple[float, float]:
    """Unknowns of the mechanics and of heat."""
    mechanical = thermal = 0.0
    if _solid(case):
        jumps = sum(interfaces[name] for name, law in case.interfaces.items() if law.can_part)
        mechanical = 3 * (nodes + jumps)
    if case.conducts:
        steps = sum(
            interfaces[n] for n, law in case.interfaces.items() if law.conductance is not None
        )
        thermal = corners + steps
    return mechanical, thermal


def exact_size(case: Case, data: MeshData) -> str:
    """Cells, unknowns and memory of a mesh, and what the mesher noted."""
    import numpy as np

    from mantle.meshes.data import EDGES, interface_facets

    tetrahedra = data.cells[:, :4]
    nodes = corners = len(np.unique(tetrahedra))
    if case.mesh.order == 2:
        nodes += len(np.unique(np.sort(tetrahedra[:, EDGES].reshape(-1, 2), axis=1), axis=0))
    each = {n: len(np.unique(interface_facets(data, n)[0][:, :3])) for n in case.interfaces}
    lines = [_size("size", case, len(data.cells), nodes, corners, each)]
    for name, tag in data.regions.items():
        lines.append(f"  {name}: {_count(np.count_nonzero(data.cell_tags == tag))} cells")
    if "mantle" in data.notes:
        lines += textwrap.wrap(
            _mantle(data.notes["mantle"]), 98, initial_indent="  ", subsequent_indent="    "
        )
    for name, note in data.notes.items():
        if name == "mantle" or note == {}:
            continue
        text = f"{name.replace('_', ' ')}: {_plain(note)}"
        lines += textwrap.wrap(text, 98, initial_indent="  ", subsequent_indent="    ")
    return "\n".join(lines)


def _mantle(note: Mapping[str, Any]) -> str:
    """A line on the thickness of the cement."""
    t = note["thickness"]
    return (
        f"cement mantle: {t['nominal']:.3g} mm, achieved {t['min']:.2f} to {t['max']:.2f}, mean "
        f"{t['mean']:.2f}, median {t['median']:.2f}, p5 {t['p5']:.2f}, p95 {t['p95']:.2f} mm; "
        f"clipped on {t['clipped_fraction']:.1%} of the stem; {note['volume']:.0f} mm3 of cement, "
        f"{note['plug_volume']:.0f} below the tip"
    )


def _size(
    title: str,
    case: Case,
    cells: float,
    nodes: float,
    corners: float,
    interfaces: Mapping[str, float],
) -> str:
    """Unknowns of what there is: displacements, temperatures, jumps of either.

    Args:
        title: First line.
        case: The case.
        cells: Cells.
        nodes: Nodes of the displacement.
        corners: Nodes of the temperature.
        interfaces: Nodes on each interface.
    """
    laws = case.interfaces.items()
    parts = [f"{_count(cells)} cells"]
    if _solid(case):
        jumps = sum(interfaces[name] for name, law in laws if law.can_part)
        parts += [
            f"{_count(nodes)} displacement nodes",
            f"{_count(jumps)} interface nodes with a jump",
        ]
    if case.conducts:
        steps = sum(interfaces[name] for name, law in laws if law.conductance is not None)
        parts += [f"{_count(corners)} temperatures", f"{_count(steps)} temperature jumps"]
    unknowns = sum(_unknowns(case, nodes, corners, interfaces))
    # Factors of a direct solver grow as n^(4/3) in three dimensions; the rest is proportional.
    memory = 0.4 + 2e-6 * unknowns + 25 * 8e-9 * unknowns ** (4 / 3)
    return (
        f"{title}\n  {', '.join(parts)}\n"
        f"  {_count(unknowns)} unknowns, about {memory:.1f} GB with a direct solver"
    )


def _count(number: float) -> str:
    """A count with its thousands apart."""
    return f"{round(number):,}".replace(",", " ")


def _entries(model: Section, given: object, indent: int = 2) -> Iterable[str]:
    """A line per field: internal value, and as given where that differs."""
    written = model.model_dump(mode="json", exclude_none=True)
    source = given if isinstance(given, dict) else {}
    for key, value in written.items():
        if value in ([], {}) or (indent > 2 and key in ("kind", "rigid")):
            continue  # nothing to say, or said already in the line above
        if isinstance(part := getattr(model, key), Section):
            kind = f" {value['kind']}" if "kind" in value else ""
            yield f"{' ' * indent}{key}:{kind}"
            yield from _entries(part, source.get(key), indent + 2)
            continue
        text = _plain(value)
        raw = _plain(source[key]) if key in source else None
        note = "" if raw is None or raw == text else f"  ({raw})"
        yield f"{' ' * indent}{key}: {text}{note}" + ("" if key in source else "  [default]")


def _plain(value: object) -> str:
    """A value on one line, floats shortened for the eye."""
    if isinstance(value, dict):
        return ", ".join(f"{k} {_plain(v)}" for k, v in value.items())
    if isinstance(value, list | tuple):
        items = [_plain(v) for v in value]
        units = {text.partition(" ")[2] for text in items}
        if len(units) == 1 and (unit := units.pop())[:1].isalpha() and len(items) > 1:
            return f"[{', '.join(text.partition(' ')[0] for text in items)}] {unit}"
        return f"[{', '.join(items)}]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.6g}"
    text = str(value)
    number, space, unit = text.partition(" ")
    try:
        return f"{float(number):.6g}{space}{unit}"
    except ValueError:
        return text


def _table(entries: Mapping[str, Any]) -> list[str]:
    """A line per support, load, condition or probe."""
    lines = []
    for name, entry in entries.items():
        fields = entry.model_dump(mode="json", exclude_none=True)
        kind, place = fields.pop("kind", ""), fields.pop("boundary", "")
        words = [f"{kind} on {place}" if place else kind] if kind else []
        words += [f"{k} {_plain(v)}" for k, v in fields.items()]
        lines.append(f"  {name}: {', '.join(words)}")
    return lines


def _resultant(case: Case) -> Iterable[str]:
    """The sum of the forces at the end of the last stage."""
    forces = [(load, load.resultant) for load in case.loads.values() if load.resultant is not None]
    if not forces:
        return
    factors = [1.0 if load.history is None else load.history[-1] for load, _ in forces]
    total = [
        sum(k * force[i] for k, (_, force) in zip(factors, forces, strict=True)) for i in range(3)
    ]
    components = ", ".join(f"{c:.6g}" for c in total)
    rest = "" if len(forces) == len(case.loads) else ", without pressures and body forces"
    yield f"  sum at the end: [{components}] N, {math.hypot(*total):.6g} N{rest}"


def warnings(case: Case) -> list[str]:
    """Warnings about input that is allowed but rarely meant, for `mantle check` and the log."""
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
        known = next(limits for word, limits in STIFFNESS.items() if word in name)
        for key in MODULI:
            if hasattr(region, key):
                messages += _far_off(f"regions.{name}.{key}", region, key, *known)
        if region.thermal is not None:
            messages += _unusual(f"regions.{name}.thermal", region.thermal)
    expands = any(
        r.thermal is not None and r.thermal.thermal_expansion for r in case.regions.values()
    )
    messages += [
        f"interfaces.{name}: expansion and a conductance that grows with pressure feed each other: "
        "there may be several states, and the initial temperatures decide between them"
        for name, law in case.interfaces.items()
        if expands and isinstance(law.conductance, PressureConductance)
    ]
    if case.geometry.kind in ("femur", "intact_femur"):
        messages += [
            f"the largest of the loads is {force:.3g} N, on a hip: a wrong unit?"
            for force in _largest_force(case)
            if not HIP_FORCES[0] <= force <= HIP_FORCES[1]
        ]
    for name, condition in case.heat.items():
        for key in ("temperature", "ambient"):
            if isinstance(getattr(condition, key, None), float):
                messages += _far_off(f"heat.{name}.{key}", condition, key, *TEMPERATURES)
    return messages


def _acts(case: Case) -> bool:
    """Whether anything moves or strains the model."""
    gaps = any(getattr(law, "gap", None) for law in case.interfaces.values())
    moved = any(any(getattr(s, a, None) for a in "xyz") for s in case.supports.values())
    strained = any(getattr(r, "eigenstrains", ()) for r in case.regions.values())
    return bool(case.loads) or gaps or moved or strained


def _largest_force(case: Case) -> Iterable[float]:
    """The largest force at any time, if there are forces [N]."""
    sizes = [
        math.hypot(*load.resultant) * max(map(abs, load.history or (1.0,)))
        for load in case.loads.values()
        if load.resultant is not None
    ]
    return [max(sizes)] if any(sizes) else []


def _unusual(place: str, thermal: Thermal) -> Iterable[str]:
    """Data of a region a thousand times off what any material has: a wrong unit."""
    for key, (low, high) in USUAL.items():
        yield from _far_off(f"{place}.{key}", thermal, key, low, high)
    if thermal.cure is not None:
        yield from _far_off(f"{place}.cure.heat", thermal.cure, "heat", 1.0, 1e4)


def _far_off(place: str, model: Section, key: str, low: float, high: float) -> Iterable[str]:
    value = getattr(model, key)
    if value and not low <= abs(value) <= high:
        text = _plain(model.model_dump(mode="json")[key])
        yield f"{place} is {text}: a wrong unit?"
