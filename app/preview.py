"""What ``mantle check`` says about a case: its parts as they were understood, and its size."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from app.conditions import Bonded, Contact, Force
from app.config import Case
from app.fields import Model
from app.materials import Rigid

if TYPE_CHECKING:
    from meshes import MeshData

# Measured on unstructured tetrahedral meshes: nodes and edges per cell.
NODES_PER_CELL = 0.19
EDGES_PER_CELL = 1.22
# Area of an interface per node on it, in units of the squared edge length.
AREA_PER_NODE = 0.87


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
    if not case.interfaces:
        lines.append("  none")
    for title, entries in (("supports", case.supports), ("loads", case.loads)):
        lines.append(title)
        lines += list(_table(entries, given.get(title, {}))) or ["  none"]
    lines += list(_resultant(case))
    lines.append("stages")
    for stage in case.stages:
        steps = f"{stage.increments} increment{'s' if stage.increments > 1 else ''}"
        lines.append(f"  {stage.name}: {steps}{', adaptive' if stage.adaptive else ''}")
    return "\n".join(lines)


def estimated_size(case: Case) -> str:
    """Cells, unknowns and memory, from the parameters alone."""
    cells = case.geometry.estimate_cells(case.mesh)
    if not cells:
        return "size\n  not known before it is meshed: --mesh counts"
    nodes = NODES_PER_CELL * cells + 50
    if case.mesh.order == 2:
        nodes += EDGES_PER_CELL * cells
    # Jumps are linear at either order; each interface has about the same share of the area.
    areas = case.geometry.interface_area / max(1, len(case.geometry.interface_sides))
    open_interfaces = sum(not isinstance(law, Bonded) for law in case.interfaces.values())
    jumps = open_interfaces * areas / (AREA_PER_NODE * case.mesh.size**2)
    return _size("size (estimated; --mesh counts)", cells, nodes, jumps)


def exact_size(case: Case, data: MeshData) -> str:
    """Cells, unknowns and memory of a mesh, and what the mesher noted."""
    import numpy as np

    from meshes.data import EDGES, interface_facets

    corners = data.cells[:, :4]
    nodes = len(np.unique(corners))
    if case.mesh.order == 2:
        nodes += len(np.unique(np.sort(corners[:, EDGES].reshape(-1, 2), axis=1), axis=0))
    jumps = sum(
        len(np.unique(interface_facets(data, name)[0][:, :3]))
        for name, law in case.interfaces.items()
        if not isinstance(law, Bonded)
    )
    lines = [_size("size", len(data.cells), nodes, jumps)]
    for name, tag in data.regions.items():
        lines.append(f"  {name}: {_count(np.count_nonzero(data.cell_tags == tag))} cells")
    for name, note in data.notes.items():
        text = f"{name.replace('_', ' ')}: {_plain(note)}"
        lines += textwrap.wrap(text, 98, initial_indent="  ", subsequent_indent="    ")
    return "\n".join(lines)


def _size(title: str, cells: float, nodes: float, jumps: float) -> str:
    unknowns = 3 * (nodes + jumps)
    # Factors of a direct solver grow as n^(4/3) in three dimensions; the rest is proportional.
    memory = 0.4 + 2e-6 * unknowns + 25 * 8e-9 * unknowns ** (4 / 3)
    return (
        f"{title}\n  {_count(cells)} cells, {_count(nodes)} displacement nodes, "
        f"{_count(jumps)} interface nodes with a jump\n"
        f"  {_count(unknowns)} unknowns, about {memory:.1f} GB with a direct solver"
    )


def _count(number: float) -> str:
    """A count with its thousands apart."""
    return f"{round(number):,}".replace(",", " ")


def _entries(model: Model, given: object, indent: int = 2) -> Iterable[str]:
    """A line per field: internal value, and as given where that differs."""
    written = model.model_dump(mode="json", exclude_none=True)
    source = given if isinstance(given, dict) else {}
    for key, value in written.items():
        if value in ([], {}) or (indent > 2 and key in ("kind", "rigid")):
            continue  # nothing to say, or said already in the line above
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


def _table(entries: Mapping[str, Any], given: object) -> Iterable[str]:
    """A line per support or load."""
    for name, entry in entries.items():
        fields = entry.model_dump(mode="json", exclude_none=True)
        kind, place = fields.pop("kind"), fields.pop("boundary", "")
        words = [f"{kind} on {place}" if place else kind]
        words += [f"{k} {_plain(v)}" for k, v in fields.items()]
        yield f"  {name}: {', '.join(words)}"


def _resultant(case: Case) -> Iterable[str]:
    """The sum of the forces at the end of the last stage."""
    forces = [load for load in case.loads.values() if isinstance(load, Force)]
    if not forces:
        return
    factors = [1.0 if f.history is None else f.history[-1] for f in forces]
    total = [sum(k * f.force[i] for k, f in zip(factors, forces, strict=True)) for i in range(3)]
    components = ", ".join(f"{c:.6g}" for c in total)
    rest = "" if len(forces) == len(case.loads) else ", without pressures and body forces"
    yield f"  sum at the end: [{components}] N, {math.hypot(*total):.6g} N{rest}"


def warnings(case: Case) -> list[str]:
    """What is allowed but rarely meant, for `mantle check` and the log of a run."""
    messages = []
    contacts = [law for law in case.interfaces.values() if isinstance(law, Contact)]
    if not case.loads and not any(law.gap for law in contacts):
        moved = any(any(getattr(s, a, None) for a in "xyz") for s in case.supports.values())
        strained = any(getattr(r, "eigenstrains", ()) for r in case.regions.values())
        if not moved and not strained:
            messages.append("nothing acts on the model: the result will be zero")
    if case.mesh.order == 1:
        messages += [
            f"regions.{name} is nearly incompressible: linear tetrahedra lock (they are far too "
            "stiff); use mesh.order: 2"
            for name, region in case.regions.items()
            if getattr(region, "nearly_incompressible", False)
        ]
    return messages
