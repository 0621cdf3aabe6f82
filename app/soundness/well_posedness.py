"""Well-posedness of a case on its mesh, and doubtful sizes.

Each check is a function that returns verdicts: errors, which refuse the case before anything is
solved, and notes. `check_on_mesh` evaluates the checks of the tables at the end of this module.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from itertools import chain, combinations
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from app.case.case import Case
from app.case.geometries import MeshFile
from app.case.probes import StrainGauge
from app.foundation.arrays import Floats
from app.foundation.errors import InputError
from app.foundation.layout import point_text
from app.foundation.verdict import Severity, Verdict, note
from app.heat.nodes import outside_text
from app.laws.values import ROUNDING_OF_HEIGHTS
from app.scene.scene import build_scene
from app.soundness import paths_on_mesh
from app.soundness.bodies_on_mesh import (
    directions,
    gaps_of,
    holds,
    law_between,
    load_history_of,
    pieces_of_bodies,
    verdicts_on_held_bodies,
)
from app.soundness.result_notes import STRAIN, smallest_modulus
from meshes import location
from meshes.data import boundary_areas, interface_facets, nodes_of_boundary_facets
from meshes.gauge_points import GaugeFault, gauge_points
from meshes.pieces import MeshPieces, pieces_of_mesh, touching_without_shared_nodes

if TYPE_CHECKING:
    from meshes import MeshData

# Gaps beyond this fraction of the interface or of the bodies are not small.
LARGE_GAP = 0.05
# Interferences beyond this fraction of the thickness of the bodies are impossible.
IMPOSSIBLE_INTERFERENCE = 0.25
# Prescribed displacements beyond this fraction of the size of the model are not small.
LARGE_DISPLACEMENT = 0.5
# A piece is slender if it is thinner than this fraction of its length.
SLENDER_PIECE = 0.2
# Bars and plates of linear cells of edge l and thickness h are too stiff in bending by this factor
# times (l / h)^2 (measured with 1 to 5 cells through them: 2.2 to 3.0).
EXCESS_OF_LINEAR_CELLS = 2.3
# Relative excess of the bending stiffness above which it is noted.
LARGE_EXCESS = 0.1
# Remedy for numbers far from any usual one.
WRONG_UNIT = "is the unit wrong?"
# An interface is noted if supports hold both sides at more than this fraction of its points.
CLAMPED_SHARE = 0.5
# A piece bends freely if more than this fraction of its surface is free.
FREE_SURFACE_SHARE = 0.5
# Diagonals of anything in a human body or at a bench [mm].
USUAL_DIAGONALS = (1.0, 3000.0)
# Two prescribed displacements differ if their difference exceeds this fraction of the larger one.
SAME_DISPLACEMENT = 1e-9
# An eigenvalue of the directions that supports hold at a node is zero below this.
ZERO_EIGENVALUE = 1e-9
# An axis this close to a cell, as a fraction of its size, touches it.
TOUCHED_BY_AXIS = 1e-6

# Function that returns errors and notes on a case on its mesh.
Check = Callable[[Case, MeshPieces], Iterable[Verdict]]


def mesh_parts(case: Case, data: MeshData) -> MeshPieces:
    """Parts of a mesh that `check_on_mesh` examines."""
    faces = {s.boundary for s in case.supports.values() if s.normal == "face"}
    return pieces_of_mesh(
        data, {s.boundary for s in case.supports.values()}, faces, case.sliding_boundaries
    )


def check_on_mesh(case: Case, parts: MeshPieces) -> list[Verdict]:
    """Return notes on a case on its mesh.

    Raises:
        InputError: The case cannot be solved. The error lists all reasons, then the notes.
    """
    only_heat = all(region.only_conducts for region in case.regions.values())
    verdicts: list[Verdict] = []
    for checks in (MESH_CHECKS,) if only_heat else (MESH_CHECKS, *MECHANICS_CHECKS):
        for check in checks:
            verdicts += check(case, parts)
        errors = [v for v in verdicts if v.severity is Severity.ERROR]
        if errors:
            # Notes are shown, too: the reason is often a crack in the mesh.
            notes = [v for v in verdicts if v.severity is not Severity.ERROR]
            raise InputError([*errors, *notes])
    return verdicts


# Contradictions


def _empty_zones(case: Case, parts: MeshPieces) -> Iterator[Verdict]:
    """Zones of interfaces of an imported mesh that cover nothing; other stems are checked before.

    Heights are those of the geometry: without a stem, z in the file.
    """
    for name, law in case.interfaces.items() if isinstance(case.geometry, MeshFile) else ():
        if not law.zone_heights:
            continue
        heights = case.geometry.height_on_stem(parts.x[parts.on_interface(name)])
        lowest, highest = float(heights.min()), float(heights.max())
        least_length = 0.0 if highest - lowest < ROUNDING_OF_HEIGHTS else ROUNDING_OF_HEIGHTS
        for zone, (low, high) in law.zone_heights.items():
            covered_length = min(high, highest + ROUNDING_OF_HEIGHTS) - max(
                low, lowest - ROUNDING_OF_HEIGHTS
            )
            if covered_length < least_length + ROUNDING_OF_HEIGHTS:
                place = f"heights from {lowest:.4g} to {highest:.4g} mm"
                if highest - lowest < ROUNDING_OF_HEIGHTS:
                    place = f"the height {lowest:.4g} mm"
                yield Verdict(
                    f"covers nothing of the interface, which is at {place}",
                    f"interfaces.{name}.zones.{zone}",
                    "heights are z in the file of the mesh; change `above` or `below`",
                )


def _prescribed_displacements(case: Case, name: str, x: Floats) -> Floats:
    """Displacement prescribed by a support at points, at the ends of stages (stages, n, 3) [mm]."""
    support = case.supports[name]
    assert not support.is_spring
    return np.multiply.outer(load_history_of(case, support.history), support.named(name).values(x))


def _contradictory_supports(case: Case, parts: MeshPieces) -> Iterator[Verdict]:
    """Nodes of a body where two supports prescribe different displacements.

    Two bodies that can part may have different displacements where they touch.
    """
    for pieces in pieces_of_bodies(case, parts):
        yield from _contradictory_supports_of(case, parts, pieces)


def _contradictory_supports_of(
    case: Case, parts: MeshPieces, pieces: list[int]
) -> Iterator[Verdict]:
    """Contradictory supports of one body of some pieces."""
    nodes_of_support = {}
    for name, support in case.supports.items():
        of_piece = parts.boundaries.get(support.boundary, {})
        nodes = [of_piece[piece] for piece in pieces if piece in of_piece]
        if not support.is_spring and nodes:
            nodes_of_support[name] = np.unique(np.concatenate(nodes))
    for first_support, second_support in combinations(nodes_of_support, 2):
        a, b = case.supports[first_support], case.supports[second_support]
        x = parts.x[
            np.intersect1d(nodes_of_support[first_support], nodes_of_support[second_support])
        ]
        hold_both = [holds(a, stage.name) and holds(b, stage.name) for stage in case.stages]
        first_values, second_values = (
            _prescribed_displacements(case, name, x)[hold_both]
            for name in (first_support, second_support)
        )
        for axis in sorted(set(a.held_axes) & set(b.held_axes)):
            u, v = first_values[..., "xyz".index(axis)], second_values[..., "xyz".index(axis)]
            size = max(np.abs(u).max(initial=0.0), np.abs(v).max(initial=0.0))
            differ = (np.abs(u - v) > SAME_DISPLACEMENT * size).any(axis=0)
            if not differ.any():
                continue
            key = f"supports.{second_support}"
            message = (
                f"prescribes a different displacement along {axis} than supports.{first_support} "
                f"at {int(differ.sum())} nodes, e.g. at {point_text(x[int(np.argmax(differ))])}"
            )
            if differ.sum() == min(
                len(nodes_of_support[first_support]), len(nodes_of_support[second_support])
            ):
                yield Verdict(message, key, "remove one of the two")
            else:
                message += (
                    f". mantle uses '{second_support}' at these nodes. The stress there is "
                    "singular: it grows as the mesh is refined"
                )
                yield note(message, key)


def _rotations_not_given(case: Case, parts: MeshPieces) -> Iterator[Verdict]:
    """Rigid regions with finite sliding whose rotation is not prescribed.

    A computed rotation would use the contact points from before the sliding.
    """
    regions_without_free_rotation = {motion.region for motion in case.motions.values()}
    fixed_boundaries = [s.boundary for s in case.supports.values() if s.clamps]
    regions_without_free_rotation |= {
        parts.pieces[k].region for name in fixed_boundaries for k in parts.boundaries.get(name, ())
    }
    for name, law in case.interfaces.items():
        for region in chain(*case.geometry.interface_sides[name]):
            slides_finitely = law.finite_sliding and region not in regions_without_free_rotation
            if slides_finitely and case.regions[region].moves_rigidly:
                message = f"the rotation of the rigid {region} is not given"
                suggestion = f"`motions: {{NAME: {{region: {region}, about: [0 mm, 0 mm, 0 mm]}}}}`"
                remedy = f"add {suggestion}, or a fixed support"
                yield Verdict(message, f"interfaces.{name}", remedy)


def _motions_with_supports_or_loads(case: Case, parts: MeshPieces) -> Iterator[Verdict]:
    """Errors on rotating regions with supports, notes on loads of prescribed motions."""
    for name, motion in case.motions.items():
        pieces_of_region = {
            k for k, piece in enumerate(parts.pieces) if piece.region == motion.region
        }
        boundaries_of_body = {
            boundary
            for boundary, pieces in parts.boundaries.items()
            if pieces_of_region & pieces.keys()
        }
        supports_of_body = ", ".join(
            n for n, support in case.supports.items() if support.boundary in boundaries_of_body
        )
        loads = ", ".join(
            n for n, load in case.loads.items() if boundaries_of_body.intersection(load.boundaries)
        )
        if supports_of_body and motion.cycle:
            message = f"{motion.region} rotates, but supports hold it ({supports_of_body})"
            remedy = "use `translation: held` instead of the supports"
            yield Verdict(message, f"motions.{name}.region", remedy)
        if loads and motion.translation == "held":
            message = f"{motion.region} does not move under {loads}: its motion is prescribed"
            yield note(message, f"motions.{name}.translation")


def _fibre_axes_in_cells(case: Case, parts: MeshPieces) -> Iterator[Verdict]:
    """Fibre axes that meet cells of their region, where fibres have no direction."""
    for name, region in case.regions.items():
        fibres = {f"regions.{name}": region.fibre}
        if region.thermal is not None:
            fibres[f"regions.{name}.thermal"] = region.thermal.fibre
        for key, fibre in fibres.items():
            if fibre is None or not fibre.curved:
                continue
            cells = parts.corners_of(name)
            is_on_axis = _meets_axis(parts.x[cells], np.array(fibre.axis), np.array(fibre.through))
            if is_on_axis.any():
                middle = parts.x[cells[np.argmax(is_on_axis)]].mean(axis=0)
                message = (
                    f"its axis meets the region, e.g. at {point_text(middle)}, where fibres have "
                    "no direction"
                )
                remedy = "use an axis outside the region"
                yield Verdict(message, f"{key}.fibre", remedy)


def _sides_that_do_not_fit(case: Case, parts: MeshPieces) -> Iterator[Verdict]:
    """Interfaces without facets and finite sliding, or with both; sides on wrong surfaces."""
    for name, sides in case.geometry.interface_sides.items():
        shared_facets = len(interface_facets(parts.data, name)[0])
        first_side, second_side = ("/".join(side) for side in sides)
        if shared_facets and name in parts.sliding_boundaries:
            message = (
                f"{first_side} and {second_side} share {shared_facets} facets, so slip is limited"
                " to one facet"
            )
            remedy = "mesh the bodies separately, or use `sliding: small`"
            yield Verdict(message, f"interfaces.{name}.sliding", remedy)
        elif not shared_facets and name not in parts.sliding_boundaries:
            remedy = (
                "if the bodies are meshed separately, use `kind: contact` with `sliding: finite` "
                "and two boundaries in `between`"
            )
            message = f"no facet between {first_side} and {second_side}"
            yield Verdict(message, f"interfaces.{name}", remedy)
        for face, side in zip(parts.sliding_boundaries.get(name, ()), sides, strict=False):
            face_regions = sorted({parts.pieces[p].region for p in parts.boundaries.get(face, {})})
            if not face_regions or not {*face_regions} <= {*side}:
                message = f"{face} is a surface of {' and '.join(face_regions) or 'no region'}"
                remedy = f"choose a boundary of {'/'.join(side)} only"
                yield Verdict(message, f"interfaces.{name}.between", remedy)


def _misplaced_probes(case: Case, parts: MeshPieces) -> Iterator[Verdict]:
    """Probes that are not in their regions, gauges that do not fit their surfaces."""
    data = parts.data
    for name, probe in case.output.probes.items():
        if isinstance(probe, StrainGauge):
            yield from _misplaced_gauge(data, f"output.probes.{name}", probe)
            continue
        cells = data.cells
        if probe.region:
            cells = cells[data.cell_tags == data.regions[probe.region]]
        if location.cells_of_points(data.points, cells, np.array([probe.at])).cell[0] < 0:
            yield Verdict(outside_text(name, (probe.at, probe.region)))


def _misplaced_gauge(data: MeshData, key: str, gauge: StrainGauge) -> list[Verdict]:
    """Error on a strain gauge that does not fit its surface."""
    x = data.points[nodes_of_boundary_facets(data, gauge.boundary)]
    if not len(x):
        return [Verdict("has no facet on this mesh", f"{key}.boundary", "choose another one")]
    try:
        gauge_position = gauge_points(x, gauge.at, gauge.towards, gauge.direction, gauge.diameter)
    except GaugeFault as fault:
        return [Verdict(str(fault), f"{key}.{fault.key}", fault.remedy)]
    if gauge_position.distance <= gauge.diameter:
        return []
    message = f"is {gauge_position.distance:.3g} mm from {gauge.boundary}"
    remedy = f"expected at most a diameter, {gauge.diameter:g} mm; the nearest point is "
    remedy += f"{point_text(gauge_position.centre)}. `towards` finds a point in a direction"
    return [Verdict(message, f"{key}.at", remedy)]


def _followers_moved_twice(case: Case, parts: MeshPieces) -> Iterator[Verdict]:
    """Nodes of slaves with finite sliding that a support or another interface moves, too."""

    def nodes(boundary: str) -> NDArray[np.int64]:
        return np.concatenate([np.zeros(0, int), *parts.boundaries.get(boundary, {}).values()])

    interfaces = build_scene(case).parting_interfaces if parts.sliding_boundaries else ()
    supported_boundaries = {n: s.boundary for n, s in case.supports.items() if not s.is_spring}
    nodes_by_owner = {
        f"supports.{name}": nodes(boundary) for name, boundary in supported_boundaries.items()
    }
    for c in interfaces:
        interface_nodes = nodes(c.between[1]) if c.between else parts.on_interface(c.name)
        nodes_by_owner[f"interfaces.{c.name}"] = interface_nodes
    for c in interfaces:
        name = f"interfaces.{c.name}"
        for key, interface_nodes in nodes_by_owner.items():
            shared_nodes = np.intersect1d(nodes_by_owner[name], interface_nodes)
            if c.between and key != name and len(shared_nodes):
                message = (
                    f"{len(shared_nodes)} nodes of {c.between[1]}, e.g. at "
                    f"{point_text(parts.x[shared_nodes[0]])}, are constrained twice: here and by "
                    f"the finite sliding of {name}"
                )
                yield Verdict(message, key, "choose a boundary without these nodes")


def _meets_axis(x: Floats, axis: Floats, point_on_axis: Floats) -> NDArray[np.bool_]:
    """Tetrahedra of corners (n, 4, 3) that a line meets.

    A line misses a tetrahedron if, seen along the line, all corners lie within half a turn.
    """
    directions_across = np.linalg.svd(axis[None])[2][1:]
    y, z = np.einsum("ki,nci->knc", directions_across, x - point_on_axis)
    angle = np.sort(np.arctan2(z, y), axis=1)
    angles_between = np.diff(angle, axis=1, append=angle[:, :1] + 2 * np.pi)
    radius = np.hypot(y, z)
    is_near = radius.min(axis=1) <= TOUCHED_BY_AXIS * radius.max(axis=1)
    return np.asarray(is_near | (angles_between.max(axis=1) <= np.pi + TOUCHED_BY_AXIS))


def _clamped_interfaces(case: Case, parts: MeshPieces) -> Iterator[Verdict]:
    """Interfaces with both sides held by supports along all axes."""
    for name in gaps_of(case, parts):
        held_masks: list[NDArray[np.bool_]] = []
        for side in case.geometry.interface_sides[name]:
            values = np.zeros((len(parts.x), 3, 3))
            for s in case.supports.values():
                if s.is_spring:
                    continue
                for piece, nodes in parts.boundaries.get(s.boundary, {}).items():
                    if parts.pieces[piece].region in side:
                        d = directions(s, parts, nodes)
                        values[nodes] += d.swapaxes(1, 2) @ d
            held_masks.append(
                np.linalg.eigvalsh(values[parts.on_interface(name)])[:, 0] > ZERO_EIGENVALUE
            )
        clamped_share = float(np.mean(np.logical_and(*held_masks)))
        if clamped_share > CLAMPED_SHARE:
            message = (
                f"supports hold both sides of interface '{name}' at {100 * clamped_share:.0f} % "
                "of its nodes: it can neither open nor slip there"
            )
            yield note(message)


def _dependent_jumps(case: Case, parts: MeshPieces) -> list[Verdict]:
    """A note on vertices with more interfaces than independent jumps: some jumps follow."""
    interfaces_that_part = [name for name, law in case.interfaces.items() if law.can_part]
    regions_of_bodies = {
        frozenset(parts.pieces[p].region for p in g) for g in pieces_of_bodies(case, parts)
    }
    is_on_interface = np.array(
        [np.isin(np.arange(len(parts.x)), parts.on_interface(n)) for n in interfaces_that_part]
    )
    body_count = np.zeros(len(parts.x), dtype=int)
    for regions in regions_of_bodies:
        body_count[np.unique(np.concatenate([parts.corners_of(r) for r in regions]))] += 1
    rows = np.flatnonzero((body_count > 1) & (is_on_interface.sum(axis=0) >= body_count))
    if not interfaces_that_part or not len(rows):
        return []
    meeting_names = [
        name
        for name, is_on in zip(interfaces_that_part, is_on_interface[:, rows[0]], strict=True)
        if is_on
    ]
    message = (
        f"interfaces {', '.join(meeting_names)} meet at {len(rows)} vertices, e.g. at "
        f"{point_text(parts.x[rows[0]])}: there the law of one interface holds only as a mean over "
        "the neighbouring points"
    )
    return [note(message)]


# Proportions


def _side_spans(case: Case, parts: MeshPieces, name: str) -> tuple[float, float]:
    """Mean thickness behind the elastic sides of an interface, 0 if rigid, and its size [mm]."""
    touches = [t for t in parts.touches if law_between(case, parts, t.pieces)[0] == name]
    area = sum(float(t.areas.sum()) for t in touches)
    near_pieces = {p for t in touches for p in t.pieces}
    thickness = 0.0
    for side in case.geometry.interface_sides[name]:
        pieces = [parts.pieces[p] for p in near_pieces if parts.pieces[p].region in side]
        if not any(case.regions[p.region].moves_rigidly for p in pieces):
            thickness += sum(p.volume for p in pieces) / area
    x = np.concatenate([t.x for t in touches])
    return thickness, float(np.linalg.norm(np.ptp(x, axis=0)))


def _large_gaps(case: Case, parts: MeshPieces) -> Iterator[Verdict]:
    """Gaps and interferences that are not small."""
    for name, gap in gaps_of(case, parts).items():
        factors = (0.0, *load_history_of(case, case.interfaces[name].gap_multipliers))
        interference = -float(np.multiply.outer(factors, gap).min())
        smallest_gap = float(gap.min()) * factors[-1]
        thickness, size = _side_spans(case, parts, name)
        key = f"interfaces.{name}.gap"
        if thickness and interference >= IMPOSSIBLE_INTERFERENCE * thickness:
            message = (
                f"an interference of {interference:.3g} mm is "
                f"{100 * interference / thickness:.0f} % of the thickness of the bodies "
                f"({thickness:.3g} mm), so that strains are not small"
            )
            yield Verdict(message, key, f"use a smaller interference; {WRONG_UNIT}")
        elif thickness and interference > LARGE_GAP * thickness:
            message = (
                f"an interference of {interference:.3g} mm in bodies {thickness:.3g} mm thick: "
                "strains are not small"
            )
            yield note(message, key, WRONG_UNIT)
        if smallest_gap > LARGE_GAP * size:
            message = (
                f"the sides are {smallest_gap:.3g} mm apart everywhere, "
                f"{100 * smallest_gap / size:.0f} % of the size of the interface ({size:.3g} mm)"
            )
            remedy = "use a smaller gap, since results assume small displacements"
            yield note(message, key, remedy)


def _large_displacements(case: Case, parts: MeshPieces) -> Iterator[Verdict]:
    """Prescribed displacements that are not small."""
    model_size = float(np.linalg.norm(np.ptp(parts.x, axis=0)))
    for name, s in case.supports.items():
        if not s.moves or not parts.boundaries.get(s.boundary):
            continue
        x = parts.x[np.concatenate([*parts.boundaries[s.boundary].values()])]
        largest_displacement = float(np.abs(_prescribed_displacements(case, name, x)).max())
        if largest_displacement > LARGE_DISPLACEMENT * model_size:
            message = (
                f"moves a model of {model_size:.3g} mm by {largest_displacement:.3g} mm: "
                "displacements are not small"
            )
            yield note(message, f"supports.{name}", WRONG_UNIT)


def _large_strains(case: Case, parts: MeshPieces) -> Iterator[Verdict]:
    """Loads that strain the material under them by more than `STRAIN`."""
    areas = boundary_areas(parts.data)
    for name, load in case.loads.items():
        boundary = next(iter(load.boundaries), "")
        area = areas.get(boundary, 0.0)
        loaded_regions = {parts.pieces[p].region for p in parts.boundaries.get(boundary, {})}
        moduli = [smallest_modulus(case.regions[region]) for region in loaded_regions]
        softest = min((m for m in moduli if m), default=0.0)
        if not area or not softest:
            continue
        stress = math.hypot(*(load.resultant or ())) / area + abs(load.normal_pressure or 0.0)
        stress *= max(map(abs, load_history_of(case, load.history)), default=1.0)
        if stress > STRAIN * softest:
            message = (
                f"{stress:.3g} MPa on boundary '{boundary}' is large for a modulus of "
                f"{softest:.3g} MPa: strains are not small"
            )
            yield note(message, f"loads.{name}", WRONG_UNIT)


# Faults of the mesh


def _messages_of_the_mesher(case: Case, parts: MeshPieces) -> Iterator[Verdict]:
    """Notes that were made with the mesh."""
    for message in parts.data.notes.get("messages", ()):
        yield note(message)


def _open_cracks(case: Case, parts: MeshPieces) -> Iterator[Verdict]:
    """Coincident nodes that are not joined, and faces on each other without a common node."""
    slides = [{*chain(*case.geometry.interface_sides[n])} for n in parts.sliding_boundaries]
    for (a, b), x in parts.doubled.items():
        if a != b and any({a, b} <= regions for regions in slides):
            continue
        region_text = f"regions '{a}' and '{b}'" if a != b else f"region '{a}'"
        message = (
            f"{len(x)} pairs of nodes coincide but are not connected, e.g. at {point_text(x[0])}: "
            "an open crack"
        )
        remedy = (
            "if it is not intended, merge them (in gmsh BooleanFragments before meshing, or "
            "Coherence Mesh after it)"
        )
        yield note(message, region_text, remedy)
    if case.geometry.kind != "file":
        return
    for (a, b), (area, place) in touching_without_shared_nodes(parts.data).items():
        sliding = a != b and any({a, b} <= regions for regions in slides)
        if sliding or (a, b) in parts.doubled or (b, a) in parts.doubled:
            continue
        region_text = f"regions '{a}' and '{b}'" if a != b else f"two bodies of region '{a}'"
        message = (
            f"{region_text} touch over {area:.3g} mm^2, e.g. at {point_text(place)}, but share no "
            "node: neither force nor heat passes between them"
        )
        remedy = (
            "if they are to be joined, mesh them together (in gmsh BooleanFragments), or let them "
            "slide (`sliding: finite`)"
        )
        yield note(message, remedy=remedy)


def _doubtful_unit(case: Case, parts: MeshPieces) -> list[Verdict]:
    """A note on a mesh file in a doubtful unit."""
    size = float(np.linalg.norm(np.ptp(parts.x, axis=0)))
    smallest, largest = USUAL_DIAGONALS
    if not isinstance(case.geometry, MeshFile) or smallest <= size <= largest:
        return []
    message = (
        f"the mesh is {size:.3g} mm from corner to corner: is its unit really {case.geometry.unit}?"
    )
    return [note(message, "geometry")]


def _too_stiff_in_bending(case: Case, parts: MeshPieces) -> Iterator[Verdict]:
    """Slender regions of linear cells, which are too stiff in bending."""
    if case.mesh.order != 1:
        return
    worst_of_region: dict[str, tuple[float, float, float]] = {}
    for p in parts.pieces:
        slender = p.thickness < SLENDER_PIECE * float(p.box.max())
        if slender and p.free > FREE_SURFACE_SHARE and smallest_modulus(case.regions[p.region]):
            excess = EXCESS_OF_LINEAR_CELLS * (p.edge / p.thickness) ** 2
            candidate = (excess, p.thickness, p.edge)
            worst_of_region[p.region] = max(worst_of_region.get(p.region, candidate), candidate)
    for name, (excess, thickness, edge) in worst_of_region.items():
        if excess > LARGE_EXCESS:
            percent = float(f"{100 * excess:.2g}")
            message = (
                f"region '{name}' is {thickness:.3g} mm thick with linear cells of {edge:.3g} mm: "
                f"in bending it is about {percent:.0f} % too stiff"
            )
            yield note(message, remedy="use mesh.order: 2")


# Checks of the mesh and of places on it, also without mechanics.
MESH_CHECKS: tuple[Check, ...] = (
    _messages_of_the_mesher,
    _open_cracks,
    _doubtful_unit,
    _fibre_axes_in_cells,
    _sides_that_do_not_fit,
    _followers_moved_twice,
    _misplaced_probes,
    paths_on_mesh.misplaced_paths,
    _empty_zones,
)
# Checks of mechanics: those that can refuse a case, then those that only note.
MECHANICS_CHECKS: tuple[tuple[Check, ...], ...] = (
    (
        _rotations_not_given,
        _motions_with_supports_or_loads,
        verdicts_on_held_bodies,
        _contradictory_supports,
        _large_gaps,
    ),
    (
        _clamped_interfaces,
        _dependent_jumps,
        _large_displacements,
        _too_stiff_in_bending,
        _large_strains,
    ),
)
