"""Published numbers of interfaces.

All functions are collective and return the same values on every rank. Maxima, percentiles, means,
areas and fractions of a hip exclude rim and tip, which have separate numbers. Sums include them.
Percentiles are weighted by area. They are reported in addition to maxima, because maxima at edges
grow with refinement.

Maxima and percentiles of tractions are those of point values, which are recovered from forces per
area (`surface_parts`). Means are those of the forces.

The contact law holds at the contact points, along the normals of the surface. Between the points
the gap follows from the displacements of both bodies, along the normals of the facets. There the
bodies may overlap.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from app.case.quantities import TABLE, computed
from app.case.summary import Numbers
from app.foundation.arrays import Floats, Ints
from app.interfaces.faces import dual_vectors
from app.interfaces.interface_facets import InterfaceFacets
from app.mechanics.contact import ContactInterfaces, TrialState
from app.mechanics.point_forces import normal_force
from app.mechanics.problem import Problem
from app.results.cycles import OF_CYCLES
from app.results.damage import BROKEN, zone
from app.results.surface_parts import Surface
from forms.contact import OPEN, SLIP, STICK
from meshes.facets import facet_shape_functions, normals_and_areas

Parts = Sequence[Surface]
# Micromotion threshold for bone ingrowth [mm].
MICROMOTION = 0.030
# Levels of micromotion [mm] with the ends of their keys. In dogs bone grew in partly at 40 um, and
# not at 150 um (Jasty 1997).
INGROWTH = {"40um": 0.040, "150um": 0.150}
# A point at its friction limit sticks if it slides less than this fraction of the longest path of
# sliding in a step [-]. So rounding does not decide while loads are constant.
RESTING_SLIP = 1e-9
# A face is closed if its opening is below this fraction of the force over the augmentation [-].
CLOSED = 1e-6
# The effect of facets on pressures is reported above this fraction of the largest pressure [-].
DECIDED = 0.2


def normal_pressure(pressures: Floats, normals: Floats) -> Floats:
    """Return the normal force per area of points (n,) [MPa] from that of their faces (n, 3).

    Negative values are tension, which laws without opening can carry.
    """
    size = np.linalg.norm(normal_force(pressures, normals), axis=1)
    return np.where(pressures.sum(axis=1) < 0, -size, size)


def least_friction(trial: TrialState) -> tuple[Floats, Floats]:
    """Return pressures of faces (n, 3) and friction (n, 3) of local points [MPa].

    At a point that sticks on an edge whose faces are all closed only the total force is known:
    friction on one face may carry the pressure of another. Of all divisions this is the one with
    the least friction. On an edge with an elastic layer, friction is that along the edge, where the
    layer is elastic; the layer is rigid along the normals of all faces.
    """
    contact, law, normals = trial.contact, trial.forces, trial.contact.local.normals
    pressures, friction = law.pressures.copy(), contact.state.friction.copy()
    opening, is_face = contact.gaps.openings(trial.jump), contact.local.is_face
    rounding = CLOSED * np.linalg.norm(law.force, axis=1) / contact.laws.augmentation
    is_closed = np.where(is_face, np.abs(opening) <= rounding[:, None], True).all(axis=1)
    has_edge = (contact.local.faces > 1) & (law.status == STICK)
    rows = np.flatnonzero(has_edge & contact.laws.has_contact & is_closed)
    on_faces = -np.einsum("pki,pi->pk", dual_vectors(normals[rows]), law.force[rows])
    pressed = (on_faces >= 0).all(axis=1)
    rows, on_faces = rows[pressed], on_faces[pressed]
    change = on_faces - pressures[rows]
    pressures[rows] = on_faces
    friction[rows] += np.einsum("pk,pki->pi", change, normals[rows])
    has_layer = (contact.local.faces > 1) & contact.laws.compliance.any(axis=(1, 2))
    duals = dual_vectors(normals[has_layer])
    along_normals = np.einsum("pki,pi->pk", duals, friction[has_layer])
    friction[has_layer] -= np.einsum("pk,pki->pi", along_normals, normals[has_layer])
    return pressures, friction


def overlap_of_faces(trial: TrialState) -> Floats:
    """Return the overlap of the faces of local points (n, 3) [mm], 0 where they are open."""
    contact = trial.contact
    opening = contact.gaps.openings(trial.jump)
    return np.where(contact.local.is_face, np.maximum(-opening, 0.0), 0.0)


def status_at_rest(trial: TrialState) -> Ints:
    """Return the states of local points (n,); points that slip less than rounding stick.

    Collective, for the longest path of sliding of all ranks. A point without faces sticks.
    """
    contact, state = trial.contact, trial.contact.state
    longest_path = contact.gather(state.path).max(initial=0.0)
    is_resting = contact.laws.has_friction & (state.step_slip <= RESTING_SLIP * longest_path)
    is_held = (contact.local.faces == 0) | (is_resting & (trial.forces.status == SLIP))
    return np.where(is_held, STICK, trial.forces.status)


def shear_of_faces(shear: Floats, pressures: Floats, of_faces: Floats) -> Floats:
    """Return the shear of the faces of points (n, 3), over their areas [MPa].

    Faces that press carry the friction of their point in proportion to their pressures, so that the
    law of friction holds on each. Without pressure all faces have the shear of the point.

    Args:
        shear: Shear of the points (n,).
        pressures: Pressures of their faces, over the areas of the points (n, 3).
        of_faces: The same over the areas of the faces (n, 3).
    """
    total = pressures.sum(axis=1)
    is_pressed = (pressures >= 0).all(axis=1) & (total > 0)
    ratio = np.divide(shear, total, where=is_pressed, out=np.zeros_like(shear))
    return np.where(is_pressed[:, None], ratio[:, None] * of_faces, shear[:, None])


class TractionSize(NamedTuple):
    """Size of a traction at the faces of points [MPa].

    Attributes:
        mean: Means over the areas of the faces (n, 3).
        value: Point values recovered from them (n, 3).
        point_mean: Means over the areas of the points (n,).
    """

    mean: Floats
    value: Floats
    point_mean: Floats


class ContactSamples:
    """Corners of the interfaces of all ranks, in an order independent of ranks, on every rank.

    n is the number of corners, called points below. Quantities of faces are (n, 3), one for each
    face of a point; vectors are (n, 3), too.

    Attributes:
        interface: Interface of each point (n,).
        x: Position (n, 3) [mm].
        weight: Area (n,) [mm2].
        penetration: Overlap of the faces of contact points (p, 3) [mm]; by mean jumps where
            interfaces meet.
        interface_of_contact_point: Interface of each contact point (p,).
        gap: Opening of each face (n, 3) [mm]; 0 for faces that a point does not have, and where
            bone never touches a stem.
        opening: Opening of the point, the largest of its faces (n,) [mm].
        slip: Slip of the second side relative to the first, as declared (n, 3) [mm];
            `mechanics.contact.TrialState.slip` defines it.
        path: Length of the path of sliding in contact (n,) [mm].
        motion: Displacement of the second side relative to the first, as declared (n, 3) [mm].
        micromotion: Motion since the insertion, if there is a press fit (n, 3) [mm].
        pressure: Normal force per area, positive in compression (n,) [MPa].
        shear: Friction per area (n,) [MPa].
        force: Force of the first side on the second, as declared, per area (n, 3) [MPa].
        status: State (n,).
        dissipation: Energy dissipated by friction and damage (n,) [N mm].
        smallest_dissipation: Smallest dissipation of any step, 0 at most (n,) [N mm].
        contact_work: Work of the pressures in the opening (n,) [N mm].
        stored: Energy stored by layers and cohesion (n,) [N mm].
        internal_variables: Internal variables of the laws, by name: (n, ...).
        interfaces: The interfaces.
        facet_sizes: Mean length of the edges of their facets [mm].
        all_corners: Corners and facets of all interfaces.
        sizes: Sizes of motion [mm] and tractions [MPa] of each point (n,) or face (n, 3), by name.

    Args:
        since: Jumps of local points at the last valley of the loads (n, 3) [mm]. Sizes with the
            name ``inducible`` are those of the motion since then.
        parts: Surface of each interface with its parts; by default undivided.
    """

    def __init__(
        self, problem: Problem, trial: TrialState, since: Floats | None = None, parts: Parts = ()
    ) -> None:
        contact, state = trial.contact, trial.contact.state
        local, points = contact.local, contact.points
        corners = points.surface

        def at_corners(values: Floats) -> Floats:
            return corners.spread(contact.gather(values))

        def distributed(values: Floats) -> Floats:
            """Distribute amounts at the contact points to their corners, by area."""
            return at_corners(values / local.weight) * corners.weight

        def motion_since(jumps: Floats | float) -> Floats:
            """Motion of the corners since jumps of local points (n, 3) [mm]."""
            return corners.true_jumps(contact.gather(trial.jump - jumps))

        self.all_corners = corners
        self.interface, self.x, self.weight = corners.interface, corners.x, corners.weight
        motion = motion_since(0.0)
        opening = np.einsum(
            "pi,pki->pk", motion + at_corners(contact.gaps.initial_gap), corners.normals
        )
        is_face = np.arange(3)[None, :] < corners.faces[:, None]
        interfaces = problem.scene.parting_interfaces
        for i, c in enumerate(interfaces):
            if c.off_bone is not None:
                opening[(corners.interface == i) & c.off_bone(self.x)] = 0.0
        self.gap = np.where(is_face, opening, 0.0)
        largest = np.max(opening, axis=1, where=is_face, initial=-np.inf)
        self.opening = np.where(corners.faces > 0, largest, 0.0)  # supports may hold both sides
        # The law holds at the contact points. Some of them have the mean jump of several corners.
        self.penetration = contact.gather(overlap_of_faces(trial))
        self.interface_of_contact_point = points.interface
        # The second side of the case may be the slave or the master.
        signs = np.array([-1.0 if c.swapped else 1.0 for c in interfaces])
        sign = signs[local.interface][:, None]
        self.slip, self.path = at_corners(sign * state.slip), at_corners(state.path)
        self.motion = signs[corners.interface][:, None] * motion
        pressures, friction = least_friction(trial)
        self._pressures = corners.spread_pressures(contact.gather(pressures))
        self.pressure = normal_pressure(self._pressures, corners.normals)
        self.shear = at_corners(np.linalg.norm(friction, axis=1))
        self.force = corners.spread_forces(contact.gather(-sign * state.force))
        status = contact.gather(status_at_rest(trial).astype(float))
        self.status = corners.spread_status(status.astype(np.int64))
        self.dissipation = distributed(state.dissipation)
        self.smallest_dissipation = distributed(state.smallest_dissipation)
        self.contact_work = distributed(state.contact_work)
        self.stored = distributed(state.stored)
        self.internal_variables = {
            name: at_corners(values) for name, values in state.internal_variables.items()
        }
        self.sizes = {
            "gap": np.maximum(self.gap, 0.0),
            "slip": np.linalg.norm(self.slip, axis=1),
            "slip_path": self.path,
            "motion": np.linalg.norm(self.motion, axis=1),
            "pressure": self.pressure,
            "shear": self.shear,
        }
        if any(c.press_fit for c in interfaces):
            self.micromotion = signs[corners.interface][:, None] * motion_since(
                state.jump_at_insertion
            )
            self.sizes["micromotion"] = np.linalg.norm(self.micromotion, axis=1)
        if since is not None:
            self.sizes["inducible"] = np.linalg.norm(motion_since(since), axis=1)
        self._contact, self._jump, self.interfaces = contact, trial.jump, interfaces
        # If a normal is wrong by an angle, slip times this angle is an overlap with pressure.
        pressed = np.linalg.norm(state.slip, axis=1) * points.normal_error[local.rows]
        self.by_facets = contact.gather(contact.laws.softest_stiffness * pressed)
        self._body_stiffness = at_corners(contact.laws.softest_stiffness)
        self.facet_sizes = contact.edge_lengths
        self.surfaces = parts or [Surface(corners, i, {}) for i in range(len(interfaces))]

    @cached_property
    def tractions(self) -> list[dict[str, TractionSize]]:
        """Return pressure and shear of each interface, by the name of the traction."""
        return [self._tractions(i) for i in range(len(self.interfaces))]

    def _tractions(self, i: int) -> dict[str, TractionSize]:
        surface = self.surfaces[i]
        means = {
            name: np.repeat(v[:, None], 3, axis=1)
            for name, v in (("pressure", self.pressure), ("shear", self.shear))
        }
        point_means = {"pressure": self.pressure.copy(), "shear": self.shear}
        # With finite sliding, forces per area are not means weighted by shape functions.
        if self.interfaces[i].slides_finitely:
            return {k: TractionSize(m, m, point_means[k]) for k, m in means.items()}
        means["pressure"] = surface.of_faces(self._pressures)
        if self.interfaces[i].law.layer is None:
            means["shear"] = shear_of_faces(self.shear, self._pressures, means["pressure"])
        point_means["pressure"] = self._pressures.sum(axis=1)
        shares = self._recovered_shares(i)
        return {
            k: TractionSize(m, m + shares[k] * (surface.sharpened(m) - m), point_means[k])
            for k, m in means.items()
        }

    def _recovered_shares(self, i: int) -> dict[str, Floats | float]:
        """Return the weight of the recovery's correction for each traction of an interface.

        It is 1 for rigid contact, because a force over its area is a mean. It is nearly 0 for
        springs softer than the bodies: stiffness times jump is a point value. Between them it is
        that of two springs in series, interface and bodies.

        Returns:
            Weights [-] (n, 1), by the name of the traction.
        """
        stiffnesses = self.interfaces[i].law.spring_stiffness
        if stiffnesses is None:
            return {"pressure": 1.0, "shear": 1.0}
        normal, tangential = (1 / (1 + self._body_stiffness / k) for k in stiffnesses)
        return {"pressure": normal[:, None], "shear": tangential[:, None]}

    @cached_property
    def numbers(self) -> dict[str, Numbers]:
        """Return motion, tractions and states of each interface by its name; collective."""
        depths = overlap(self._contact, self._jump)
        numbers = {}
        for i, c in enumerate(self.interfaces):
            numbers[c.name] = _numbers(self, i)
            if not c.slides_finitely:
                numbers[c.name] |= depths[i] | {"facet_size": self.facet_sizes[i]}
        return numbers

    @cached_property
    def step_numbers(self) -> dict[str, Numbers]:
        """Return the numbers of every step, which include the columns of history.csv."""
        selected = {key for key, q in TABLE["interfaces"].items() if q.step_record} | OF_CYCLES
        return {c.name: _numbers(self, i, selected) for i, c in enumerate(self.interfaces)}


def _numbers(s: ContactSamples, i: int, selected: set[str] | None = None) -> Numbers:
    """Return all numbers of an interface and its parts, or selected ones without rim and tip."""
    mask, surface = s.interface == i, s.surfaces[i]
    parts = {
        part: _of_part(s, i, surface, part, selected)
        for part in ([""] if selected else surface.parts)
    }
    main = parts.pop("") | {
        "penetration_max": float(s.penetration[s.interface_of_contact_point == i].max(initial=0.0)),
        "dissipation": float(s.dissipation[mask].sum()),
        "dissipation_min": float(s.smallest_dissipation[mask].min()),
        "contact_work": float(s.contact_work[mask].sum()),
        "stored_energy": float(s.stored[mask].sum()),
        **_damage(s, i),
        **computed("interfaces", s, mask),
    }
    if selected:
        return main
    if s.interfaces[i].law.compresses:
        main["compression_max"] = main["penetration_max"]
    main["pressure_mean_max"], _ = surface.field(s.tractions[i]["pressure"].mean, "").maximum()
    by_facets = float(s.by_facets[s.interface_of_contact_point == i].max(initial=0.0))
    if by_facets > DECIDED * main["pressure_max"]:
        main["pressure_by_facets"] = by_facets
    zones = {}
    for name, level in s.interfaces[i].zones.items():
        zone_surface = Surface(s.all_corners, i, {**surface.borders, name: level(s.x)})
        if zone_surface.weight[name].any():
            zones[name] = _of_part(s, i, zone_surface, name, None)
    if zones:
        main["zones"] = zones
    return main | {"force": (s.weight[mask] @ s.force[mask]).tolist(), **parts}


def _damage(s: ContactSamples, i: int) -> dict[str, float]:
    """Return areas [mm2], mean damage [-] and process zone [mm] of an interface with damage."""
    interface = s.interfaces[i]
    if not {"damage", "spent"} <= interface.law.internal_variables.keys():
        return {}
    mask, surface, weight = s.interface == i, s.surfaces[i], s.weight
    unbonded = np.ones(len(mask))
    unbonded[mask] = (
        interface.constants["unbonded"](s.x[mask]) if "unbonded" in interface.constants else 0.0
    )
    bonded = weight * (1 - unbonded)
    dissipated = np.where(unbonded < 1, s.internal_variables["spent"], 0.0)
    length = zone(surface.corners, dissipated[surface.triangles], surface.area)
    return {
        "unbonded_fraction": float((weight * unbonded)[mask].sum() / weight[mask].sum()),
        "area_damaged": float(bonded[dissipated > 0].sum()),
        "area_broken": float(bonded[dissipated >= BROKEN].sum()),
        "damage_mean": float(bonded @ s.internal_variables["damage"] / max(bonded.sum(), 1e-300)),
        "zone_length": length,
        "zone_elements": length / s.facet_sizes[i],
    }


def _of_part(
    s: ContactSamples, i: int, surface: Surface, part: str, selected: set[str] | None
) -> Numbers:
    """Return sizes of motion and tractions, states, area and force of a part of an interface."""
    interface = s.interfaces[i]
    numbers: Numbers = {}  # of functions, what is asked for is computed
    tractions = s.tractions[i]
    # With finite sliding the jump is not a motion, a gap not a debonding, and slips do not add up.
    left_out = ("slip", "motion", "inducible") if interface.slides_finitely else ()
    if not interface.press_fit:
        left_out = (*left_out, "micromotion")
    for name, values in s.sizes.items():
        if name in left_out:
            continue
        mean, value, _ = tractions.get(name, TractionSize(values, values, values))
        field = surface.field(value, part)
        largest_value, position = field.maximum()
        numbers |= {
            f"{name}_max": max(largest_value, 0.0),
            f"{name}_max_at": position,
            f"{name}_p95": partial(field.percentile, 0.95),
            f"{name}_p99": partial(field.percentile, 0.99),
            f"{name}_mean": surface.field(mean, part).mean,
        }
        if name in ("gap", "slip", "motion") and not interface.slides_finitely:
            numbers[f"area_{name}_over_30um"] = partial(field.area_above, MICROMOTION)
        if name == "micromotion" or (name == "inducible" and interface.press_fit):
            numbers |= {
                f"area_{name}_over_{key}": partial(field.area_above, level)
                for key, level in INGROWTH.items()
            }
    weight = surface.weight[part]
    for name, state in (("open", OPEN), ("stick", STICK), ("slip", SLIP)):
        numbers[f"{name}_fraction"] = float(weight[s.status == state].sum() / weight.sum())
    numbers["area"] = float(weight.sum())
    numbers["force"] = lambda: (weight @ s.force).tolist()
    if interface.law.strength:
        values = (traction.value for traction in tractions.values())
        numbers |= failing(surface, interface.law.strength.index(*values), part)
    computed_numbers: Numbers = {}
    for key, value in numbers.items():
        if not selected or key in selected:
            computed_numbers[key] = value() if callable(value) else value
    return computed_numbers


def failing(surface: Surface, index: Floats, part: str) -> Numbers:
    """Return numbers on the failure index of a part of an interface.

    They are the maximum, the percentile, the fraction of the area above 1, and the load factor: the
    multiple of the tractions at which one hundredth of the area fails.

    Args:
        surface: The interface.
        index: Failure index at points (n,) or faces (n, 3) [-].
        part: Name of the part.
    """
    field = surface.field(index, part)
    p99, (largest, place) = field.percentile(), field.maximum()
    return {
        "failure_index_max": largest,
        "failure_index_p99": p99,
        "failure_index_max_at": place,
        "strength_fraction": field.area_above(1.0) / (field.area or 1.0),
    } | ({"failure_load_factor": 1 / p99} if p99 > 0 else {})


# Between the contact points


# Barycentric coordinates of the points of a facet at which overlap is sampled, quarters apart.
LATTICE = np.array([(i, j, 4 - i - j) for i in range(5) for j in range(5 - i)]) / 4


def overlap(contact: ContactInterfaces, jump: Floats) -> list[dict[str, float]]:
    """Return the penetration of each interface on its facets: maximum and mean; collective.

    Args:
        contact: The interfaces.
        jump: Jumps of local contact points (n, 3) [mm].
    """
    motion = _motion(contact, jump)
    surface = contact.points.surface
    gap = surface.spread(contact.gather(contact.gaps.initial_gap))
    clearance = np.einsum("pi,pi->p", gap, surface.normals[:, 0])
    penetrations = []
    for rows, triangles in zip(surface.facets, surface.triangles, strict=True):
        gap, area = gaps(contact.facets, rows, motion[rows], clearance[triangles])
        depth = np.maximum(-gap, 0.0)
        penetrations.append(
            {
                "penetration_sampled": float(depth.max(initial=0.0)),
                "penetration_mean": float((depth * area).sum() / area.sum()) if len(rows) else 0.0,
            }
        )
    return penetrations


def gaps(
    facets: InterfaceFacets, rows: Ints, motion: Floats, clearance: Floats
) -> tuple[Floats, Floats]:
    """Return the gap along the normals of facets at `LATTICE` (f, q) [mm], and their areas (f,).

    Args:
        facets: All facets.
        rows: Facets to evaluate (f,).
        motion: Displacement of their slave side against the master at their nodes (f, m, 3) [mm].
        clearance: Initial gap at their corners (f, 3) [mm].
    """
    x = facets.nodes[rows]
    normals, area = normals_and_areas(x, LATTICE)
    inwards = np.sign(np.einsum("fi,fi->f", normals[:, -1], facets.normal[rows, 0]))
    motion_at_points = np.einsum(
        "qn,fni->fqi", facet_shape_functions(LATTICE, motion.shape[1]), motion
    )
    normal_motion = np.einsum("fqi,fqi->fq", motion_at_points, normals) * inwards[:, None]
    return normal_motion + clearance @ LATTICE.T, area


def _motion(contact: ContactInterfaces, jump: Floats) -> Floats:
    """Displacement of the slave side against the master at the nodes of all facets (f, m, 3)."""
    dofs, bodies = contact.facets.dofs, contact.facets.bodies
    nodes, node_row = np.unique(dofs, return_inverse=True)
    node_row = node_row.reshape(dofs.shape)
    motion_of_bodies = np.zeros((1 + int(bodies.max()), len(nodes), 3))
    for body, B in contact.coupling.jump_to_displacement.items():
        q, u = B.createVecs()
        q.array[:] = jump.ravel()
        B.mult(q, u)
        first_owned, after_owned = (k // 3 for k in u.getOwnershipRange())
        owned = (nodes >= first_owned) & (nodes < after_owned)
        motion_of_bodies[body, owned] = u.array.reshape(-1, 3)[nodes[owned] - first_owned]
    motion_of_bodies = contact.comm.allreduce(motion_of_bodies)
    return motion_of_bodies[bodies[:, 1:], node_row] - motion_of_bodies[bodies[:, :1], node_row]
