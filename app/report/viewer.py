"""Interactive view of the bodies of a run in three dimensions, within a page.

Surfaces of all regions and their fields at the end of every stage are packed into the page as
16-bit numbers, and displacement, slip and temperature at steps between them. `viewer.js` draws them
with three.js (Debian's libjs-three), which has cameras, materials, clipping planes and mouse
control. `viewer.js` unpacks the numbers and has the controls: field, stage, motion, deformation,
cut, bodies, several runs under one camera.

vtk.js has no advantage. A bundle of release 37.4 (geometry, plane, cell picker, scalar bar) has
876 kB, three.js has 877 kB. Debian does not package it, and a bundle needs Node. It would replace
the colour map and its legend, some 40 of 375 lines. It cuts surfaces only, so closed cuts through
cells would remain in `viewer.js`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from math import ceil
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from app.case.quantities import INTERFACE_FIELDS
from app.foundation.arrays import Bools, Floats, Ints
from app.report import page
from app.report.packed_arrays import (
    LARGEST_INTEGER,
    PackedArrays,
    as_text,
    fractions,
    points_in_range,
)
from app.report.sweep_results import QUANTITIES
from app.results.reading import Run
from meshes.data import cell_volumes, exterior_facets

THREE = Path("/usr/share/javascript/three")
SCRIPTS = ("three.min.js", "examples/js/controls/OrbitControls.js")
# Largest size of all values before compression [bytes]; about half of a page of 2 MB.
MOST_BYTES = 3_000_000
# Largest size of steps between the ends of stages [bytes]; such a page is below 10 MB.
MOTION = 3_500_000
# Largest number of steps between the ends of stages.
FRAMES = 60
# Endings of the names of fields at these steps, which also have the displacement.
MOVING = ("slip", "micromotion", "temperature", "displacement", "degree_of_cure")
# Triangles of a facet with six nodes.
QUARTERS = [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]
# Largest value of a field that is zero to rounding, in the unit of its file.
ROUNDING_OF_FIELDS = 1e-9
# Number of steps shown of the last cycle of a rotating body.
MOMENTS = 12
# Label, printed unit, and factor on the values in the file. Vectors are shown by their length.
INTERFACE: dict[str, tuple[str, str, float]] = {
    **{key: (key, *QUANTITIES[key]) for key in ("micromotion", "slip", *QUANTITIES)},
    "status": ("open 0, stick 1, slip 2", "", 1.0),
}
NODAL = {
    "temperature_peak": ("highest temperature so far", "°C", 1.0),
    "temperature": ("temperature", "°C", 1.0),
    "von_mises": ("von Mises stress", "MPa", 1.0),
    "principal_max": ("largest principal stress", "MPa", 1.0),
    "principal_min": ("smallest principal stress", "MPa", 1.0),
    "displacement": ("displacement", "mm", 1.0),
}


class ShownStep(NamedTuple):
    """A written step that a view shows.

    Attributes:
        name: Its name on the page.
        step: Number of the step, or name of a stage for its last step.
        whole: True if all fields are shown, False for those of `MOVING` alone.
    """

    name: str
    step: int | str
    whole: bool


class ShownField(NamedTuple):
    """A field to show.

    Attributes:
        name: Its name in the file.
        contact: Its interface; empty for a field of all nodes.
        label: Its name on the page.
        unit: Its unit on the page; empty for a plain number.
        factor: Factor on the values of the file.
    """

    name: str
    contact: str
    label: str
    unit: str
    factor: float


def viewer(folders: Mapping[str, Path]) -> str:
    """Return the view as HTML; empty without fields or without three.js.

    Several runs are shown side by side under one camera, at the ends of stages. Runs on the mesh of
    the first run also have a view of the differences from it. Folders without fields are left out.
    A single run has steps between the ends of stages, too, so that they can be played.

    Args:
        folders: Run directories by name.
    """
    scripts = [THREE / name for name in SCRIPTS]
    runs = {n: Run(f) for n, f in folders.items() if (f / "fields.vtkhdf").exists()}
    if not runs or not all(s.exists() for s in scripts):
        return ""
    (first_name, base), *other_runs = runs.items()
    pairs: list[tuple[str, Run, Run | None]] = [(name, run, None) for name, run in runs.items()]
    pairs += [
        (f"{name} − {first_name}", run, base) for name, run in other_runs if same_mesh(run, base)
    ]
    views = []
    for name, run, minus in pairs:
        motion_bytes = MOTION if len(pairs) == 1 else 0
        head, values = packed_view(run, minus, MOST_BYTES // len(pairs), motion_bytes)
        views.append((name, json.dumps(head), as_text(values)))
    script_texts = [s.read_text("utf-8") for s in (*scripts, Path(__file__).with_name("viewer.js"))]
    return page.render("viewer.html", {"runs": views, "scripts": script_texts})


def distinct(folders: Sequence[Path]) -> list[str]:
    """Return the shortest ends of the paths of run directories that differ from each other."""
    paths = [folder.resolve().parts for folder in folders]
    for k in range(1, max(map(len, paths)) + 1):
        short_names = ["/".join(p[-k:]) for p in paths]
        if len(set(short_names)) == len(short_names):
            return short_names
    return [f"{name} ({number})" for number, name in enumerate(short_names, 1)]


def same_mesh(a: Run, b: Run) -> bool:
    """Return True if two runs have the same nodes and cells in the same order."""
    return (
        a.points.shape == b.points.shape
        and np.array_equal(a.cells, b.cells)
        and np.allclose(a.points, b.points, rtol=0.0, atol=1e-9 * np.ptp(a.points))
    )


def packed_view(
    run: Run, minus: Run | None = None, most_bytes: int = MOST_BYTES, motion_bytes: int = 0
) -> tuple[dict[str, object], bytes]:
    """Pack the input of `viewer.js`: a head with the offsets of the arrays, and all their numbers.

    Numbers are little-endian. Positions (n, 3) and values (n,) are 16-bit fractions of their range.
    Corners of triangles, and of the cells that fill a cut, are 32-bit indices.

    Args:
        run: The run.
        minus: A run on the same mesh whose fields are subtracted, at the end of the stage of the
            same name or else of the last stage; None for the fields of the run.
        most_bytes: Limit of the size [bytes]. Above it, only corners of cells and the last stages
            are drawn, and cuts are not filled.
        motion_bytes: Limit of the size of steps between the ends of stages [bytes].
    """
    steps_by_name, kinds = _moments(run), fields_to_show(run)
    stage_ends = [*steps_by_name]
    other_steps = {} if minus is None else _moments(minus)
    if minus is not None:
        stage_ends = [s for s in stage_ends if s == stage_ends[-1] or s in other_steps]
        kinds = [kind for kind in kinds if kind.name in minus.point_fields]
    # Three numbers for the position and three for the displacement.
    surfaces, filling_cells, nodes = _drawn(
        run, 2 * (3 + len(stage_ends) * (3 + len(kinds))), most_bytes
    )
    stage_ends = stage_ends[-max(1, most_bytes // (2 * len(nodes) * (3 + len(kinds)))) :]
    moving = sum(kind.name.endswith(MOVING) for kind in kinds)
    room = min(FRAMES, motion_bytes // (2 * len(nodes) * (3 + moving)))
    frames = _frames(run, {name: steps_by_name[name] for name in stage_ends}, room)
    numbers = PackedArrays()
    x = run.points[nodes]
    packed_points, extent = points_in_range(x)
    moves: list[dict[str, object]] = []
    fields: list[dict[str, object]] = []
    head: dict[str, object] = {
        "points": {"at": numbers.add(packed_points), "n": len(nodes), **extent},
        "bodies": [
            _packed_body(body, triangles, filling_cells[body], nodes, numbers)
            for body, triangles in surfaces.items()
        ],
        "stages": [frame.name for frame in frames],
        "ends": stage_ends,
        "recorded": len(run.times),
        "signed": minus is not None,
        "turned": [motion["region"] for motion in run.case.get("motions", {}).values()],
        "moves": moves,
        "fields": fields,
        "opening": opening(run, kinds, surfaces),
    }
    for frame in frames:
        u = run.displacement(frame.step)[nodes] if "displacement" in run.point_fields else 0 * x
        highest = float(np.abs(u).max()) or 1.0
        moves.append({"at": numbers.add(fractions((u / highest + 1) / 2)), "most": highest})
    for kind in kinds:
        is_on_interface: Bools | bool = True
        if kind.contact:
            is_on_interface = run.at_interface(kind.contact, "status", -1)[nodes] >= 0
        steps: list[dict[str, object] | None] = []
        for frame in frames:
            if not frame.whole and not kind.name.endswith(MOVING):
                steps.append(None)
                continue
            other_step = -1 if frame.name == stage_ends[-1] else other_steps.get(frame.name, -1)
            subtracted = 0.0 if minus is None else lengths(minus, kind.name, other_step)
            v = kind.factor * (lengths(run, kind.name, frame.step) - subtracted)[nodes]
            packed_values, lowest, highest = _scaled(
                v, np.isfinite(v) & (is_on_interface | (v > 0))
            )
            steps.append({"at": numbers.add(packed_values), "min": lowest, "max": highest})
        fields.append({"name": kind.name, "label": kind.label, "unit": kind.unit, "steps": steps})
    return head, numbers.content()


def _packed_body(
    body: str, triangles: Ints, filling_cells: Ints, nodes: Ints, numbers: PackedArrays
) -> dict[str, object]:
    """Append the triangles (t, 3) of a body, and the cells (c, 4) that fill a cut through it.

    Their nodes are written as rows in ``nodes``, the drawn nodes in increasing order.
    """
    return {
        "name": body,
        "at": numbers.add(np.searchsorted(nodes, triangles).astype(np.uint32)),
        "triangles": len(triangles),
        "inside": numbers.add(np.searchsorted(nodes, filling_cells).astype(np.uint32)),
        "cells": len(filling_cells),
    }


def opening(
    run: Run, kinds: Sequence[ShownField], surfaces: Mapping[str, Ints]
) -> dict[str, object]:
    """Return the field, the bodies and the axis of the cut that a view shows first.

    The view begins with the first field of an interface that is not zero, on its inner body without
    a cut (axis -1). If there is none, it begins with the first field of the bodies on a section of
    all bodies normal to y.
    """
    for kind in kinds:
        side = side_of(run, kind.contact, surfaces) if kind.contact else None
        if side and kind.unit:
            body, triangles = side
            if np.abs(lengths(run, kind.name)[triangles]).max() > ROUNDING_OF_FIELDS:
                return {"field": kind.name, "bodies": [body], "axis": -1}
    nodal = [kind.name for kind in kinds if not kind.contact]
    field = nodal[0] if nodal else ""
    return {"field": field, "bodies": list(surfaces), "axis": 1 if nodal else -1}


def side_of(run: Run, contact: str, surfaces: Mapping[str, Ints]) -> tuple[str, Ints] | None:
    """Return the first body with facets on an interface, and these facets (t, 3)."""
    is_on_interface = run.at_interface(contact, "status") >= 0
    for body, triangles in surfaces.items():
        triangles_on_it = triangles[is_on_interface[triangles].all(axis=1)]
        if len(triangles_on_it):
            return body, triangles_on_it
    return None


def _moments(run: Run) -> dict[str, int | str]:
    """Written steps to show, by name: ends of stages, and steps of the last cycle of a motion."""
    moments: dict[str, int | str] = {name: name for name in run.written_stages}
    if not run.case.get("motions") or not moments:
        return moments
    *_, name = moments
    cycles = run.case["stages"][-1].get("cycles", 1)
    cycle_fraction = cycles * (run.times - run.times[-1]) + 1
    in_last_cycle = np.flatnonzero((cycle_fraction > 1e-9) & (cycle_fraction < 1 - 1e-9))
    for k in in_last_cycle[:: 1 + len(in_last_cycle) // MOMENTS]:
        moments[f"{name}, {100 * cycle_fraction[k]:.0f} % of a cycle"] = int(k)
    return moments | {name: moments.pop(name)}


def _frames(run: Run, ends: Mapping[str, int | str], room: int) -> list[ShownStep]:
    """Return the ends of stages and at most ``room`` steps between them, in order of time."""
    frames = {run.number_of(step): ShownStep(name, step, True) for name, step in ends.items()}
    other_steps = [k for k in range(len(run.times)) if k not in frames]
    stride = -(-len(other_steps) // room) if room else 0
    if stride:
        moments = moments_of(run)
        for k in other_steps[::stride]:
            frames[k] = ShownStep(f"{moments[k]} (step {k + 1})", k, False)
    return [frames[k] for k in sorted(frames)]


def moments_of(run: Run) -> list[str]:
    """Return the stage of each written step with its seconds, or its fraction of the stage."""
    stages = [str(stage["name"]) for stage in run.case["stages"]]
    record = run.step_record
    moments = []
    for time in run.times:
        k = max(ceil(time - 1e-9) - 1, 0)
        moment = f"{100 * (time - k):.4g} %"
        if "seconds [s]" in record:
            row = int(np.abs(record["time [-]"] - time).argmin())
            moment = f"{record['seconds [s]'][row]:.4g} s"
        moments.append(f"{stages[k]}, {moment}")
    return moments


def _drawn(
    run: Run, of_node: int, most_bytes: int
) -> tuple[dict[str, Ints], dict[str, Ints], Ints]:
    """Return triangles and cells of each body, and their nodes; fewer above a limit of bytes."""
    cells_of_body = {name: run.cells[run.region == k][:, :4] for name, k in run.regions.items()}
    no_cells = {name: run.cells[:0, :4] for name in cells_of_body}
    for curved, filling_cells in (
        (True, cells_of_body),
        (False, cells_of_body),
        (True, no_cells),
        (False, no_cells),
    ):
        surfaces = outsides(run, curved)
        nodes = np.unique(
            np.concatenate([a.ravel() for a in (*surfaces.values(), *filling_cells.values())])
        )
        if of_node * len(nodes) + 16 * sum(map(len, filling_cells.values())) <= most_bytes:
            break
    return surfaces, filling_cells, nodes


def _scaled(values: Floats, is_known: Bools) -> tuple[NDArray[np.uint16], float, float]:
    """Return values as 16-bit fractions of their range, and its ends; one level marks no value."""
    lowest, highest = (
        (float(f(values[is_known])) for f in (np.min, np.max)) if is_known.any() else (0, 0)
    )
    packed_values = fractions(
        np.where(is_known, (values - lowest) / ((highest - lowest) or 1.0), 0.0)
    )
    packed_values[~is_known] = LARGEST_INTEGER + 1
    return packed_values, lowest, highest


def lengths(run: Run, name: str, step: int | str = -1) -> Floats:
    """Return a field on the nodes (n,) in the unit of its file; the length of vectors."""
    v = run.on_points(name, step)
    return np.asarray(np.linalg.norm(v, axis=1)) if v.ndim == 2 else v


def interface_fields() -> dict[str, tuple[str, str, float]]:
    """Label, unit and factor of the fields of interfaces, those of other packages first."""
    added_fields = {f.name: (f.label, f.unit, f.factor) for f in INTERFACE_FIELDS.values()}
    return added_fields | INTERFACE


def fields_to_show(run: Run) -> list[ShownField]:
    """Return the fields to show, the most interesting first."""
    kinds = [
        ShownField(
            f"{contact}_{key}", contact, f"{contact.replace('_', '-')}: {label}", unit, factor
        )
        for contact in sorted(run.contacts, reverse=True)
        for key, (label, unit, factor) in interface_fields().items()
        if f"{contact}_{key}" in run.point_fields
    ]
    kinds += [
        ShownField(key, "", *label_unit_factor)
        for key, label_unit_factor in NODAL.items()
        if key in run.point_fields
    ]
    known_names = {kind.name for kind in kinds}
    cure_fields = [name for name in run.point_fields if "cure" in name and name not in known_names]
    return kinds + [ShownField(name, "", name.replace("_", " "), "", 1.0) for name in cure_fields]


def outsides(run: Run, curved: bool) -> dict[str, Ints]:
    """Surface triangles of each region (t, 3), facing outwards; curved facets are divided."""
    surfaces: dict[str, Ints] = {}
    for name, number in run.regions.items():
        cells = cells_of(run, [number])
        if not len(cells):
            continue
        facets, owner = exterior_facets(cells)
        inverted = cell_volumes(run.points, cells[owner]) < 0
        reversed_facets = facets[:, [0, 2, 1, 5, 4, 3][: facets.shape[1]]]
        facets = np.where(inverted[:, None], reversed_facets, facets)
        surfaces[name] = quartered(facets) if curved else facets[:, :3]
    return surfaces


def cells_of(run: Run, numbers: Sequence[int]) -> Ints:
    """Nodes of the cells of regions (m, 4 or 10), in gmsh's order."""
    order = [*range(8), 9, 8][: run.cells.shape[1]]
    return run.cells[np.isin(run.region, numbers)][:, order]


def quartered(facets: Ints) -> Ints:
    """Triangles (t, 3) of facets with three or six nodes; a facet with six is four triangles."""
    return facets if facets.shape[1] == 3 else facets[:, QUARTERS].reshape(-1, 3)
