"""The cost of a case: cells, unknowns, memory and time, estimated or counted on its mesh."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from app.case.case import Case
from app.foundation.layout import count, duration
from app.numerics.choice import SolverChoice
from app.scene.scene import build_scene
from app.soundness import mesh_notes
from meshes.data import interface_nodes
from meshes.shape_functions import GMSH_TETRAHEDRON

if TYPE_CHECKING:
    from meshes import MeshData

# Measured on unstructured tetrahedral meshes: nodes and edges per cell.
NODES_PER_CELL = 0.19
EDGES_PER_CELL = 1.22
# Cost of a run on one core (measured): seconds per unknown of the mechanics, without the solver.
PRICE = 6e-5
# Time of a later load step over that of the first.
LATER = 0.05
# Seconds of a solve of contact by a Krylov method per unknown of displacement.
KRYLOV = 1e-4
# Time of a later Krylov solve over that of the first.
LATER_KRYLOV = 0.45
# Time of a Krylov solve without contact over that with contact, which takes several Newton steps.
LINEAR = 0.25
# Operations per second of sparse factors.
SPARSE_FACTOR_SPEED = 48e9
# Operations per second of dense factors in single precision.
DENSE_FACTOR_SPEED = 86e9
# Bytes per second of back-substitutions.
SUBSTITUTION_SPEED = 10e9
# Newton iterations of the first solve, from rest.
FIRST_ITERATIONS = 12
# Newton iterations of a later solve.
LATER_ITERATIONS = 5.5
# Cycles after which friction has shaken down in hips. A state is then predicted exactly from the
# cycles before, and its solve takes one iteration.
SHAKEDOWN_CYCLES = 50
# Seconds of setting up the matrices of condensed bodies, per unknown.
CONDENSED_ASSEMBLY = 1.5e-5
# Seconds of a time step of heat.
TIME_STEP = 0.05
# Seconds of a time step per temperature.
TIME_STEP_PER_TEMPERATURE = 3e-5
# Time steps of a stage with heat.
HEAT_STEPS = 35
# Time steps of a stage in which cement sets.
SETTING_STEPS = 95
# Solves of a stage that creeps.
CREEP = 150
# Time of a run with estimated errors over that of one without.
WITH_ERRORS = 1.25
# The same ratio with heat.
WITH_HEAT_ERRORS = 2.5
# Seconds of the start of the program and of the report page.
START = 2.6
# Seconds of meshing per cell.
MESHING = 1e-4
# Seconds of compiling the forms of the mechanics, which are cached.
MECHANICAL_FORMS = 5.0
# Seconds of compiling that fibres add.
FIBRE_FORMS = 10.0
# Seconds of compiling the forms of heat.
HEAT_FORMS = 2.0
# Seconds per unknown of three phases of a first run (`phases`).
ASSEMBLE = 3e-5
FACTORIZE = 3e-5
OUTPUT = 2e-5
# Memory of a run without factors [GB].
BASE = 0.4
# Memory per unknown of the condensed solution [GB].
CONDENSED = 2e-6
# Memory per unknown of a Krylov method [GB].
MULTIGRID = 5e-6
# Assumed number of unknowns if it is not known before meshing.
UNKNOWN_SIZE = 3e4


@dataclass(frozen=True)
class _Size:
    """Size of a mesh.

    Attributes:
        cells: Number of cells.
        nodes: Number of displacement nodes.
        jumps: Number of interface nodes with a jump of displacement.
        temperatures: Number of temperatures.
        steps: Number of temperature jumps.
    """

    cells: float
    nodes: float
    jumps: float
    temperatures: float
    steps: float

    @property
    def unknowns(self) -> float:
        return 3 * (self.nodes + self.jumps) + self.temperatures + self.steps


def _size(
    case: Case, cells: float, nodes: float, corners: float, interface_nodes: Mapping[str, float]
) -> _Size:
    """Size of a mesh with given numbers of displacement nodes, cell corners and interface nodes."""
    laws, deforms, conducts = case.interfaces.items(), solid(case), case.conducts
    jumps = deforms * sum(interface_nodes[name] for name, law in laws if law.can_part)
    conducting = {
        name for name, law in laws if law.conductance is not None
    } - case.sliding_boundaries.keys()
    steps = conducts * sum(interface_nodes[name] for name in conducting)
    return _Size(cells, deforms * nodes, jumps, conducts * corners, steps)


def _estimated(case: Case) -> _Size:
    """Size from the parameters alone; without cells if it is unknown before meshing."""
    count = case.geometry.estimate_cells(case.mesh)
    if not count:
        return _Size(0.0, UNKNOWN_SIZE / 3, 0.0, 0.0, 0.0)
    corners = NODES_PER_CELL * count + 50
    rigid = (name for name, region in case.regions.items() if region.moves_rigidly)
    moving = count - sum(case.geometry.cells_apart(name, case.mesh) for name in rigid)
    nodes = (NODES_PER_CELL + EDGES_PER_CELL * (case.mesh.order == 2)) * moving + 50
    # Jumps are linear at either order.
    interface_nodes = dict.fromkeys(case.interfaces, case.geometry.interface_nodes(case.mesh))
    return _size(case, count, nodes, corners, interface_nodes)


def estimated_size(case: Case, available: float = math.inf) -> str:
    """Describe cells, unknowns, memory and time as estimated from the parameters alone.

    Args:
        case: The case.
        available: Available memory [byte], by which the solver is chosen.
    """
    size = _estimated(case)
    if not size.cells:
        return "size\n  not known before meshing; --mesh counts the cells"
    return _described("size (estimated; --mesh counts the cells)", case, size, available)


def estimated_unknowns(case: Case) -> float:
    """Estimated number of unknowns of a case; 0 if it is not known before meshing."""
    size = _estimated(case)
    return size.unknowns if size.cells else 0.0


def estimated_seconds(case: Case, alone: bool = True) -> float:
    """Time of a run on one core [s], within a factor of two for the shipped cases.

    A run that is not ``alone`` shares mesh, forms and matrices with an earlier one.
    """
    size = _estimated(case)
    return _duration(case, size) if alone else _solution(case, size, 2) - _solution(case, size)


def phases(case: Case) -> dict[str, float]:
    """Time of each phase of a first run on one core [s], by its name in `Timing`."""
    size = _estimated(case)
    alone = case.model_copy(update={"output": case.output.model_copy(update={"error": False})})
    return {
        "mesh": MESHING * size.cells,
        "stiffness": compiling(case) / 2,
        "contact": MECHANICAL_FORMS / 2,
        "assemble": ASSEMBLE * size.unknowns,
        "factorize": FACTORIZE * size.unknowns,
        "output": OUTPUT * size.unknowns,
        "error": _solution(case, size) - _solution(alone, size),
    }


def _duration(case: Case, size: _Size, runs: int = 1) -> float:
    """Time of runs of known size on one core, one after the other [s]."""
    return START + MESHING * size.cells + _solution(case, size, runs)


def compiling(case: Case) -> float:
    """Time of compiling all forms of a case [s]."""
    fibres = any(region.has_fibre for region in case.regions.values())
    mechanical = MECHANICAL_FORMS + FIBRE_FORMS * fibres if solid(case) else 0.0
    return mechanical + HEAT_FORMS * case.conducts


def _solution(case: Case, size: _Size, runs: int = 1) -> float:
    """Time of the solution alone in runs that share matrices [s]."""
    load_steps, time_steps = (runs * number for number in solves(case))
    choice, condensed = _choice(case, size, runs)
    mechanical = PRICE * 3 * (size.nodes + size.jumps)
    loading = mechanical * (1.0 + LATER * max(0, load_steps + time_steps - 1))
    loading += (
        condensed_seconds(choice, runs * repeated_solves(case))
        if condensed
        else krylov_seconds(choice)
    )
    heating = time_steps * (
        TIME_STEP + TIME_STEP_PER_TEMPERATURE * (size.temperatures + size.steps)
    )
    errors = WITH_HEAT_ERRORS if time_steps else WITH_ERRORS
    return (loading + heating) * (errors if case.output.error else 1.0)


def condensed_seconds(choice: SolverChoice, repeated: float = 0.0) -> float:
    """Time of all contact solves with bodies condensed onto the jumps, on one core [s].

    ``repeated`` of the solves repeat an earlier cycle (`repeated_solves`).

    In hips of 24,000 to 153,000 unknowns the operations of the factors are estimated to within a
    sixth, at 850,000 unknowns to within a third. Their entries are estimated to within a tenth.
    """
    n, m = choice.size, choice.jumps
    operations = 15 * n**2.05 + 1.1 * m**2.91 - m**3 / 3
    entries = 6 * n**1.44 + 1.1 * m**1.95
    setup = operations / SPARSE_FACTOR_SPEED + CONDENSED_ASSEMBLY * n
    dense = (2 / 3) * (0.64 * m) ** 3 / DENSE_FACTOR_SPEED
    iteration = dense + (32 * m**2 + 8 * entries) / SUBSTITUTION_SPEED
    setup *= choice.solves if choice.changes_stiffness else 1
    iterations = FIRST_ITERATIONS + LATER_ITERATIONS * (choice.solves - 1 - repeated) + repeated
    return setup + iterations * iteration


def krylov_seconds(choice: SolverChoice) -> float:
    """Time of all solves with a Krylov method on one core [s]."""
    seconds_per_iteration = KRYLOV if choice.jumps else LINEAR * KRYLOV
    later_seconds = LATER_KRYLOV * (choice.solves - 1)
    return seconds_per_iteration * choice.size * (1 + later_seconds)


def _choice(
    case: Case, size: _Size, runs: int, available: float = math.inf
) -> tuple[SolverChoice, bool]:
    """Choice of the linear solver of mechanics; True if it condenses the bodies."""
    number, changes_stiffness = runs * max(1, sum(solves(case))), build_scene(case).stiffness_varies
    sizes = case.mesh.order, 3 * size.nodes, 3 * size.jumps
    choice = SolverChoice(*sizes, number, changes_stiffness, available)
    can_condense = bool(size.jumps and contact_solves(case))
    return choice, can_condense and choice.condenses(case.solver.linear)


def solves(case: Case) -> tuple[int, int]:
    """Estimated numbers of solved load steps and of time steps."""
    timed = sum(1 for stage in case.stages if stage.duration)
    cures = any(r.thermal is not None and r.thermal.cure is not None for r in case.regions.values())
    time_steps = HEAT_STEPS * timed + SETTING_STEPS * (cures and timed > 0)
    scene, steps = build_scene(case), 0
    for k, stage in enumerate(scene.stages):
        number = stage.increments * stage.load_segments
        steps += 0 if stage.duration else number * scene.rotation_substeps(k, 1 / number)
    steps += CREEP * sum(1 for stage in case.stages if stage.creep)
    steps += sum(stage.extension_kind.solves(case) for stage in case.stages if stage.extension_kind)
    if _proportional(case):
        steps -= case.stages[0].increments - 1  # the others are proportional to the first
    return steps, time_steps


def repeated_solves(case: Case) -> int:
    """Estimated number of solves after friction has shaken down, without moving parts."""
    if case.motions:
        return 0
    # Two solves in each cycle: at the peak and in the valley.
    until_shakedown = 2 * SHAKEDOWN_CYCLES
    return sum(
        stage.increments * max(0, stage.load_segments - until_shakedown)
        for stage in case.stages
        if not stage.duration
    )


def contact_solves(case: Case) -> int:
    """Estimated number of contact solves; 0 if heat and mechanics are one system."""
    return 0 if build_scene(case).coupled else sum(solves(case))


def _proportional(case: Case) -> bool:
    """Return True if the solution of the first stage is proportional to the loads."""
    load_histories = [load.history for load in case.loads.values()]
    gaps = [law.has_initial_gap for law in case.interfaces.values()]
    has_changes = any(load_histories) or any(gaps) or case.motions
    return not case.stages[0].duration and not has_changes


def solid(case: Case) -> bool:
    """Return True if a region of the case can move."""
    return any(not region.only_conducts for region in case.regions.values())


def exact_size(case: Case, data: MeshData, available: float = math.inf) -> str:
    """Describe cells, unknowns, memory and time on a mesh, with the notes of the mesher.

    Args:
        case: The case.
        data: Its mesh.
        available: Available memory [byte], by which the solver is chosen.
    """
    rigid = [data.regions[n] for n, r in case.regions.items() if r.moves_rigidly]
    elastic = data.cells[~np.isin(data.cell_tags, rigid), :4]
    nodes, corners = len(np.unique(elastic)), len(np.unique(data.cells[:, :4]))
    if case.mesh.order == 2:
        nodes += len(
            np.unique(np.sort(elastic[:, GMSH_TETRAHEDRON].reshape(-1, 2), axis=1), axis=0)
        )
    counts = {n: len(interface_nodes(data, n, case.sliding_boundaries)) for n in case.interfaces}
    size = _size(case, len(data.cells), nodes, corners, counts)
    lines = [_described("size", case, size, available)]
    for name, tag in data.regions.items():
        lines.append(f"  {name}: {count(np.count_nonzero(data.cell_tags == tag))} cells")
    for line in mesh_notes.lines_of_mesh_notes(data.notes):
        lines += textwrap.wrap(line, 98, initial_indent="  ", subsequent_indent="    ")
    return "\n".join(lines)


def gigabytes(case: Case, available: float = math.inf) -> float:
    """Estimated memory of a run [GB]; 0 if its size is not known before meshing."""
    size = _estimated(case)
    choice, condensed = _choice(case, size, max(1, len(case.variations)), available)
    return _gigabytes(choice, condensed, size) if size.cells else 0.0


def _gigabytes(choice: SolverChoice, condensed: bool, size: _Size) -> float:
    memory = BASE + (CONDENSED if condensed else MULTIGRID) * size.unknowns
    return float(memory + choice.memory_needed / 1e9 * condensed)


def _described(title: str, case: Case, size: _Size, available: float) -> str:
    """Lines on cells, unknowns, memory and time."""
    parts = [f"{count(size.cells)} cells"]
    if size.nodes:
        parts.append(f"{count(size.nodes)} displacement nodes")
        parts.append(f"{count(size.jumps)} interface nodes with a jump")
    if size.temperatures:
        parts.append(f"{count(size.temperatures)} temperatures")
        parts.append(f"{count(size.steps)} temperature jumps")
    runs = max(1, len(case.variations))
    choice, condensed = _choice(case, size, runs, available)
    memory = _gigabytes(choice, condensed, size)
    contact = size.jumps and contact_solves(case)
    solver = f"\n  contact: {choice.description(case.solver.linear, condensed)}" if contact else ""
    variations_text = (
        f", {duration(_duration(case, size, runs))} for all variations" if runs > 1 else ""
    )
    return (
        f"{title}\n  {', '.join(parts)}\n"
        f"  {count(size.unknowns)} unknowns, about {memory:.1f} GB{solver}\n"
        f"  about {duration(_duration(case, size))} on one core{variations_text}; "
        f"{compiling(case):.0f} s more to compile forms at the first run"
    )
