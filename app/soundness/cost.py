"""The cost of a case: cells, unknowns, memory and time, estimated or counted on its mesh."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from app.case.case import Case
from app.laws.materials import Conductor, TransverselyIsotropic
from app.system.layout import count, duration, plain

if TYPE_CHECKING:
    from meshes import MeshData

# Measured on unstructured tetrahedral meshes: nodes and edges per cell.
NODES_PER_CELL = 0.19
EDGES_PER_CELL = 1.22
# Cost of a run on one core (measured). Mechanics: seconds at 1e5 unknowns by order, exponent of
# growth, a later load step beside the first.
PRICE, GROWTH, LATER = {1: 20.0, 2: 25.0}, 1.2, 0.35
# Heat: seconds of a time step, and per temperature; time steps of a stage, and of cement that sets.
TIME_STEP, HEAT, HEAT_STEPS, SETTING_STEPS = 0.05, 3e-5, 35, 95
# Factors of runs with errors, of the mechanics and with heat, and of a run that shares matrices;
# seconds of start and page; of meshing, per cell.
WITH_ERRORS, WITH_HEAT_ERRORS, SHARED, START, MESHING = 1.25, 2.5, 0.6, 2.6, 1e-4
# Seconds of compiling forms, which are cached: of the mechanics, in addition with fibres, of heat.
MECHANICAL_FORMS, FIBRE_FORMS, HEAT_FORMS = 5.0, 10.0, 2.0
# Seconds of a phase per unknown, the first time; `phases`.
ASSEMBLE, FACTORIZE, OUTPUT = 3.5e-5, 5e-5, 4e-5
# Assumed size where it is not known.
UNKNOWN_SIZE = 3e4
# Area of an interface per node on it, in units of the squared edge length.
AREA_PER_NODE = 0.87


def estimated_size(case: Case) -> str:
    """Cells, unknowns and memory, from the parameters alone."""
    cells, nodes, corners, each = _estimated(case)
    if not cells:
        return "size\n  not known before it is meshed: --mesh counts"
    return _size("size (estimated; --mesh counts)", case, cells, nodes, corners, each)


def unknowns(case: Case) -> float:
    """Estimated unknowns of a case; 0 where they are unknown before meshing."""
    cells, sizes = _cells_and_unknowns(case)
    return sum(sizes) if cells else 0.0


def seconds(case: Case, alone: bool = True) -> float:
    """Time of a run on one core [s], within a factor of two for the shipped cases.

    A run that is not ``alone`` shares mesh, forms and matrices with an earlier one.
    """
    return _duration(case, *_cells_and_unknowns(case), alone)


def phases(case: Case) -> dict[str, float]:
    """Time of each phase of a first run on one core [s], by its name in `Timing`."""
    cells, sizes = _cells_and_unknowns(case)
    unknowns = sum(sizes)
    alone = case.model_copy(update={"output": case.output.model_copy(update={"error": False})})
    return {
        "mesh": MESHING * cells,
        "stiffness": compiling(case) / 2,
        "contact": MECHANICAL_FORMS / 2,
        "assemble": ASSEMBLE * unknowns,
        "factorize": FACTORIZE * unknowns,
        "output": OUTPUT * unknowns,
        "error": _solution(case, *sizes) - _solution(alone, *sizes),
    }


def _duration(case: Case, cells: float, sizes: tuple[float, float], alone: bool = True) -> float:
    """Time of a run of known size on one core [s]."""
    solution = _solution(case, *sizes)
    return START + MESHING * cells + solution if alone else SHARED * solution


def compiling(case: Case) -> float:
    """Time of compiling all forms of a case [s]."""
    fibres = any(isinstance(region, TransverselyIsotropic) for region in case.regions.values())
    mechanical = MECHANICAL_FORMS + FIBRE_FORMS * fibres if solid(case) else 0.0
    return mechanical + HEAT_FORMS * case.conducts


def _solution(case: Case, mechanical: float, thermal: float) -> float:
    """Time of the solver alone [s], from the unknowns of mechanics and heat."""
    price = PRICE[case.mesh.order] * (mechanical / 1e5) ** GROWTH
    timed = sum(1 for stage in case.stages if stage.duration)
    sets = any(r.thermal is not None and r.thermal.cure is not None for r in case.regions.values())
    moments = HEAT_STEPS * timed + SETTING_STEPS * (sets and timed > 0)
    steps = sum(stage.increments for stage in case.stages if not stage.duration)
    if _proportional(case):
        steps -= case.stages[0].increments - 1  # the first step tells the others
    loading = price * (1.0 + LATER * max(0, steps + moments - 1)) if mechanical else 0.0
    heating = moments * (TIME_STEP + HEAT * thermal)
    errors = WITH_HEAT_ERRORS if timed else WITH_ERRORS
    return (loading + heating) * (errors if case.output.error else 1.0)


def _proportional(case: Case) -> bool:
    """Whether the solution of the first stage is proportional to the loads, as without gaps."""
    histories = [load.history for load in case.loads.values()]
    gaps = [getattr(law, "gap", 0.0) for law in case.interfaces.values()]
    return not case.stages[0].duration and not any(histories) and not any(gaps)


def solid(case: Case) -> bool:
    """Whether anything in it can move."""
    return any(not isinstance(region, Conductor) for region in case.regions.values())


def _estimated(case: Case) -> tuple[float, float, float, dict[str, float]]:
    """Cells, nodes of the displacement, nodes of the temperature, nodes by interface."""
    count = case.geometry.estimate_cells(case.mesh)
    corners = NODES_PER_CELL * count + 50
    nodes = corners + (EDGES_PER_CELL * count if case.mesh.order == 2 else 0)
    # Jumps are linear at either order; each interface has about the same share of the area.
    areas = case.geometry.interface_area / max(1, len(case.geometry.interface_sides))
    each = dict.fromkeys(case.interfaces, areas / (AREA_PER_NODE * case.mesh.size**2))
    return count, nodes, corners, each


def _cells_and_unknowns(case: Case) -> tuple[float, tuple[float, float]]:
    """Estimated cells, 0 before meshing, and unknowns of mechanics and heat."""
    cells, nodes, corners, each = _estimated(case)
    return cells, _unknowns(case, nodes, corners, each) if cells else (UNKNOWN_SIZE, 0.0)


def _on_interfaces(case: Case, each: Mapping[str, float]) -> tuple[float, float]:
    """Nodes with a jump of displacement, and of temperature."""
    laws = case.interfaces.items()
    jumps = sum(each[name] for name, law in laws if law.can_part)
    return jumps, sum(each[name] for name, law in laws if law.conductance is not None)


def _unknowns(
    case: Case, nodes: float, corners: float, each: Mapping[str, float]
) -> tuple[float, float]:
    """Unknowns of mechanics and heat."""
    jumps, steps = _on_interfaces(case, each)
    return 3 * (nodes + jumps) * solid(case), (corners + steps) * case.conducts


def exact_size(case: Case, data: MeshData) -> str:
    """Cells, unknowns and memory of a mesh, and notes of the mesher."""
    import numpy as np

    from meshes.data import EDGES, interface_facets

    tetrahedra = data.cells[:, :4]
    nodes = corners = len(np.unique(tetrahedra))
    if case.mesh.order == 2:
        nodes += len(np.unique(np.sort(tetrahedra[:, EDGES].reshape(-1, 2), axis=1), axis=0))
    each = {n: len(np.unique(interface_facets(data, n)[0][:, :3])) for n in case.interfaces}
    lines = [_size("size", case, len(data.cells), nodes, corners, each)]
    for name, tag in data.regions.items():
        lines.append(f"  {name}: {count(np.count_nonzero(data.cell_tags == tag))} cells")
    for name, note in sorted(data.notes.items(), key=lambda item: item[0] != "mantle"):
        if name == "told" or note == {}:
            continue
        text = f"{name.replace('_', ' ')}: {plain(note)}" if name != "mantle" else _mantle(note)
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
    """Lines on unknowns and memory: ``nodes`` carry displacements, ``corners`` temperatures."""
    parts = [f"{count(cells)} cells"]
    jumps, steps = _on_interfaces(case, interfaces)
    if solid(case):
        parts += [
            f"{count(nodes)} displacement nodes",
            f"{count(jumps)} interface nodes with a jump",
        ]
    if case.conducts:
        parts += [f"{count(corners)} temperatures", f"{count(steps)} temperature jumps"]
    sizes = _unknowns(case, nodes, corners, interfaces)
    unknowns = sum(sizes)
    # Factors of a direct solver grow as n^(4/3) in three dimensions; the rest is proportional.
    memory = 0.4 + 2e-6 * unknowns + 25 * 8e-9 * unknowns ** (4 / 3)
    first, others = _duration(case, cells, sizes), _duration(case, cells, sizes, alone=False)
    more = len(case.variations) - 1
    every = f", {duration(first + more * others)} for all variations" if more > 0 else ""
    return (
        f"{title}\n  {', '.join(parts)}\n"
        f"  {count(unknowns)} unknowns, about {memory:.1f} GB with a direct solver\n"
        f"  about {duration(first)} on one core{every}; {compiling(case):.0f} s more where forms "
        "are compiled first"
    )
