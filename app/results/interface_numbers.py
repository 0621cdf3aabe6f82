"""Published numbers of interfaces.

All functions are collective and return the same plain values on every rank. Percentiles are
weighted by area or volume; maxima are reported beside them because peaks at edges grow with
refinement. Those of a hip leave out rim and tip, which have their own; sums are of the whole.

The law holds at the points, along the normals of the surface there. Between them the
surfaces move apart by the displacements of both bodies, along the normals of the facets themselves:
bodies may overlap there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from typing import Any

import numpy as np

from app.arrays import Bools, Floats, Ints
from app.case.quantities import TABLE, computed
from app.laws.interface_laws import Cohesive
from app.mechanics.contact import ContactInterfaces, TrialState
from app.mechanics.problem import Problem
from app.results.cycles import OF_CYCLES
from app.results.damage import BROKEN, zone
from app.results.percentiles import SurfaceField
from forms.contact import OPEN, SLIP, STICK
from meshes.contact_facets import InterfaceFacets, shape_functions, surface
from meshes.contact_points import ContactSurface

Parts = Sequence["Surface"]
MICROMOTION = 0.030  # mm: where biology reacts
# Facets decide the largest pressure if they may cause more than this part of it.
DECIDED = 0.2


def normal_pressure(pressures: Floats, normals: Floats) -> Floats:
    """Normal force per area (n,) [MPa], from those of the faces of each point (n, 3).

    Negative is tension, possible for laws that cannot open.
    """
    size = np.linalg.norm(np.einsum("pk,pki->pi", pressures, normals), axis=1)
    return np.where(pressures.sum(axis=1) < 0, -size, size)


class ContactSamples:
    """Corners of interfaces of all ranks, in canonical order, on every rank.

    One row per point for vectors, one per point and face for what belongs to a face.

    Attributes:
        interface: Interface of each point (n,).
        x: Position (n, 3) [mm].
        weight: Area (n,) [mm2].
        penetration: Overlap of the faces of contact points, by mean jumps where interfaces meet
            (p, 3) [mm].
        of_points: Interface of each contact point (p,).
        gap: Opening of each face (n, 3) [mm]; 0 beyond the point's faces.
        opening: Opening of the point, the largest of its faces (n,) [mm].
        slip: Irreversible tangential motion, 0 where the point is open (n, 3) [mm].
        path: Length of the path of sliding in contact (n,) [mm].
        motion: Displacement of the second side as declared against the first (n, 3) [mm].
        pressure: Normal force per area, positive in compression (n,) [MPa].
        shear: Friction per area (n,) [MPa].
        force: Force of the first side on the second, as declared, per area (n, 3) [MPa].
        status: State (n,).
        dissipation: Dissipated by friction and damage (n,) [N mm].
        least: Smallest dissipation of any step, 0 at most (n,) [N mm].
        contact_work: Work of the pressures in the opening (n,) [N mm].
        stored: Energy stored by layers and cohesion (n,) [N mm].
        own: History variables of the laws, by name: (n, ...).
        contacts: The interfaces.
        facet_sizes: Mean length of the edges of their facets [mm].
        index: Failure index (n,) of interfaces whose strength is known, by their numbers.
        sizes: Sizes of motion [mm] and tractions [MPa] of each point (n,) or face (n, 3), by name.
        friction: Friction on the master per area (n, 3) [MPa], where points slide far.
        arm: From the centre of the master to where they touch it (n, 3) [mm].

    Args:
        since: Jumps of own points at the last valley of the loads (n, 3) [mm]: ``inducible``
            sizes are those of the way since then.
        parts: Surface of each interface; by default undivided.
    """

    def __init__(
        self, problem: Problem, trial: TrialState, since: Floats | None = None, parts: Parts = ()
    ) -> None:
        contact, history = trial.contact, trial.contact.state
        own, points = contact.own, contact.points
        surface = points.surface

        def whole(values: Floats) -> Any:
            return surface.spread(contact.whole(values))

        def total(values: Floats) -> Any:
            """Amounts at the corners from amounts at the points, by area."""
            return whole(values / own.weight) * surface.weight

        self.interface, self.x, self.weight = surface.interface, surface.x, surface.weight
        motion = surface.true_jumps(contact.whole(trial.jump))
        opening = np.einsum("pi,pki->pk", motion + whole(contact.gap), surface.normals)
        used = np.arange(3)[None, :] < surface.faces[:, None]
        self.gap = np.where(used, opening, 0.0)
        self.opening = np.max(opening, axis=1, where=used, initial=-np.inf)
        # The law holds at the points, some of which have the mean jump of several corners.
        of_points = np.einsum("pi,pki->pk", trial.jump + contact.gap, own.normals)
        within = np.arange(3)[None, :] < own.faces[:, None]
        self.penetration = contact.whole(np.where(within, np.maximum(-of_points, 0.0), 0.0))
        self.of_points = points.interface
        # The second side as declared is the slave or the master.
        contacts = problem.scene.contacts
        signs = np.array([-1.0 if c.turned else 1.0 for c in contacts])
        sign = signs[own.interface][:, None]
        self.slip, self.path = whole(sign * history.slip), whole(history.path)
        self.motion = signs[surface.interface][:, None] * motion
        self.pressure = whole(normal_pressure(trial.law.pressures, own.normals))
        self.shear = whole(np.linalg.norm(history.friction, axis=1))
        self.force = whole(-sign * history.force)
        status = contact.whole(np.where(own.faces > 0, trial.law.status, STICK))
        self.status = surface.spread_status(status.astype(np.int64))
        self.dissipation, self.least = total(history.dissipation), total(history.least)
        self.contact_work, self.stored = total(history.contact_work), total(history.stored)
        self.own = {name: whole(values) for name, values in history.own.items()}
        self.sizes = {
            "gap": np.maximum(self.gap, 0.0),
            "slip": np.linalg.norm(self.slip, axis=1),
            "slip_path": self.path,
            "motion": np.linalg.norm(self.motion, axis=1),
            "pressure": self.pressure,
            "shear": self.shear,
        }
        laws = enumerate(c.law for c in contacts)
        self.index = {
            i: law.strength.index(self.pressure, self.shear) for i, law in laws if law.strength
        }
        if since is not None:
            way = surface.true_jumps(contact.whole(trial.jump - since))
            self.sizes["inducible"] = np.linalg.norm(way, axis=1)
        if (far := contact.large) is not None:
            arm = np.zeros((len(own), 3))
            arm[far.rows] = far.paired.arm
            self.arm, self.friction = whole(arm), whole(history.friction)
        self._contact, self._jump, self.contacts = contact, trial.jump, contacts
        # With a normal that is off by an angle, slip times this angle presses on the surface.
        pressed = np.linalg.norm(history.slip, axis=1) * points.doubt[own.rows]
        self.by_facets = contact.whole(contact.law.met * pressed)
        self.facet_sizes = contact.edge_lengths
        self.surfaces = parts or [Surface(surface, i, {}) for i in range(len(contacts))]

    @cached_property
    def numbers(self) -> dict[str, dict[str, Any]]:
        """Motion, tractions and states of each interface, by its name; collective."""
        depths, sizes = overlap(self._contact, self._jump), self.facet_sizes
        return {
            c.name: _numbers(self, i) | ({} if c.between else depths[i] | {"facet_size": sizes[i]})
            for i, c in enumerate(self.contacts)
        }

    @cached_property
    def history(self) -> dict[str, dict[str, Any]]:
        """The numbers of every step, those of history.csv among them."""
        wanted = {key for key, q in TABLE["interfaces"].items() if q.history} | OF_CYCLES
        return {c.name: _numbers(self, i, wanted) for i, c in enumerate(self.contacts)}


def _numbers(s: ContactSamples, i: int, wanted: set[str] | None = None) -> dict[str, Any]:
    """Numbers of an interface and its parts; the wanted ones of its main part if not all."""
    at, surface = s.interface == i, s.surfaces[i]
    parts = {part: _of_part(s, i, part, wanted) for part in ([""] if wanted else surface.at)}
    main = parts.pop("") | {
        "penetration_max": float(s.penetration[s.of_points == i].max(initial=0.0)),
        "dissipation": float(s.dissipation[at].sum()),
        "dissipation_min": float(s.least[at].min()),
        "contact_work": float(s.contact_work[at].sum()),
        "stored_energy": float(s.stored[at].sum()),
        **_damage(s, i),
        **computed("interfaces", s, at),
    }
    if wanted:
        return main
    area = float(s.weight[at].sum()) - sum(part["area"] for part in parts.values())
    by_facets = float(s.by_facets[s.of_points == i].max(initial=0.0))
    if by_facets > DECIDED * main["pressure_max"]:
        main["pressure_by_facets"] = by_facets
    return main | {"area": area, "force": (s.weight[at] @ s.force[at]).tolist(), **parts}


def _damage(s: ContactSamples, i: int) -> dict[str, float]:
    """Areas [mm2], mean damage and process zone of a cohesive interface; of others none."""
    if not isinstance(s.contacts[i].law, Cohesive):
        return {}
    at, surface, weight = s.interface == i, s.surfaces[i], s.weight
    never = np.ones(len(at))
    never[at] = s.contacts[i].values["unbonded"](s.x[at])
    bonded, spent = weight * (1 - never), np.where(never < 1, s.own["spent"], 0.0)
    length = zone(surface.corners, spent[surface.triangles], surface.area)
    return {
        "unbonded_fraction": float((weight * never)[at].sum() / weight[at].sum()),
        "area_damaged": float(bonded[spent > 0].sum()),
        "area_broken": float(bonded[spent >= BROKEN].sum()),
        "damage_mean": float(bonded @ s.own["damage"] / max(bonded.sum(), 1e-300)),
        "zone_length": length,
        "zone_elements": length / s.facet_sizes[i],
    }


def _of_part(s: ContactSamples, i: int, part: str, wanted: set[str] | None) -> dict[str, Any]:
    """Sizes of motion and tractions, states, area and force of a part of an interface."""
    surface, index = s.surfaces[i], s.index.get(i)
    at = surface.at[part]
    weight, x = s.weight[at], s.x[at]
    found: dict[str, Any] = {}  # of functions, what is asked for is computed
    # Where sides slide far a jump is no motion, a gap no debonding, and slips do not add up.
    left_out = ("slip", "motion", "inducible") if s.contacts[i].between else ()
    for name, values in ((k, v) for k, v in s.sizes.items() if k not in left_out):
        field = surface.field(values, part)
        here = values[at].reshape(len(x), -1).max(axis=1)
        k = int(np.argmax(here))
        found |= {
            f"{name}_max": float(max(here[k], 0.0)),
            f"{name}_p95": partial(field.percentile, 0.95),
            f"{name}_p99": partial(field.percentile, 0.99),
            f"{name}_mean": field.mean,
            f"{name}_max_at": x[k].tolist(),
        }
        if name in ("gap", "slip", "motion") and not s.contacts[i].between:
            found[f"area_{name}_over_30um"] = partial(field.area_above, MICROMOTION)
    for name, state in (("open", OPEN), ("stick", STICK), ("slip", SLIP)):
        found[f"{name}_fraction"] = float(weight[s.status[at] == state].sum() / weight.sum())
    found["area"] = field.whole
    found["force"] = lambda: [field.whole * surface.field(f, part).mean() for f in s.force.T]
    if index is not None:
        found |= failing(surface, index, s.x, part)
    asked = ((key, value) for key, value in found.items() if not wanted or key in wanted)
    return {key: value() if callable(value) else value for key, value in asked}


def failing(surface: Surface, index: Floats, x: Floats, part: str) -> dict[str, Any]:
    """Failure indices (n,) of a part of an interface: percentile, share of the area beyond 1.

    The load factor is by how much a traction proportional to it would have to grow until the first
    hundredth of the area fails.
    """
    field, at = surface.field(index, part), surface.at[part]
    k, p99 = int(np.argmax(index[at])), field.percentile()
    return {
        "failure_index_max": float(index[at][k]),
        "failure_index_p99": p99,
        "failure_index_max_at": x[at][k].tolist(),
        "strength_fraction": field.area_above(1.0) / (field.whole or 1.0),
    } | ({"failure_load_factor": 1 / p99} if p99 > 0 else {})


class Surface:
    """Facets of an interface in parts, by their centres; its points are all their corners.

    Attributes:
        at: Points of each part (n,) by its name, which is empty for the rest.
        triangles: Points at the corners of each facet (f, 3).
        corners: Their positions (f, 3, 3) [mm].
        area: Area of each facet (f,) [mm2].

    Args:
        borders: Functions of all points (n,) that are not positive in a part; the first counts.
    """

    def __init__(self, points: ContactSurface, i: int, borders: Mapping[str, Floats]) -> None:
        at = points.interface == i
        self.at = divided(at, borders)
        self.triangles: Ints = points.triangles[i]
        x = self.corners = points.x[self.triangles]
        flat = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
        area = np.linalg.norm(flat, axis=1) / 2
        # Curved facets have a little more than their corners span.
        whole = points.weight[at].sum()
        self.area = area * (whole / area.sum()) if len(area) else area
        # At each corner the face of the point that this facet belongs to.
        along = np.abs(np.einsum("fi,fcki->fck", flat, points.normals[self.triangles]))
        self._face: Ints = np.argmax(along, axis=2)
        centres = {part: own[self.triangles].mean(axis=1) for part, own in borders.items()}
        self._of = divided(np.ones(len(x), dtype=bool), centres)

    def field(self, values: Floats, part: str) -> SurfaceField:
        """Values at points (n,), or at the faces of points (n, 3), as a field on a part."""
        corners = values[self.triangles]
        if values.ndim == 2:
            corners = np.take_along_axis(corners, self._face[:, :, None], axis=2)[:, :, 0]
        return SurfaceField(corners[self._of[part]], self.area[self._of[part]])


def divided(whole: Bools, levels: Mapping[str, Floats]) -> dict[str, Bools]:
    """Parts of a whole (n,) where levels (n,) are not positive, the first first; "": the rest."""
    found = {}
    for part, level in levels.items():
        found[part], whole = whole & (level <= 0), whole & (level > 0)
    return {"": whole} | found


# Between the contact points


# Sampled points of a facet: corners, middles of edges, and between them (barycentric).
LATTICE = np.array([(i, j, 4 - i - j) for i in range(5) for j in range(5 - i)]) / 4


def overlap(contact: ContactInterfaces, jump: Floats) -> list[dict[str, float]]:
    """Penetration of each interface on its facets: largest and mean over the area; collective.

    Jumps are those of own contact points (n, 3) [mm].
    """
    motion = _motion(contact, jump)
    surface = contact.points.surface
    gap = surface.spread(contact.whole(contact.gap))
    clearance = np.einsum("pi,pi->p", gap, surface.normals[:, 0])
    found = []
    for rows, triangles in zip(surface.facets, surface.triangles, strict=True):
        gap, area = gaps(contact.facets, rows, motion[rows], clearance[triangles])
        depth = np.maximum(-gap, 0.0)
        found.append(
            {
                "penetration_sampled": float(depth.max(initial=0.0)),
                "penetration_mean": float((depth * area).sum() / area.sum()) if len(rows) else 0.0,
            }
        )
    return found


def gaps(
    facets: InterfaceFacets, rows: Ints, motion: Floats, clearance: Floats
) -> tuple[Floats, Floats]:
    """Gap along the normals of facets at `LATTICE` (f, q) [mm], and the area of each.

    Args:
        facets: All facets.
        rows: Facets to evaluate (f,).
        motion: Displacement of their slave side against the master at their nodes (f, m, 3) [mm].
        clearance: Initial gap at their corners (f, 3) [mm].
    """
    x = facets.nodes[rows]
    normals, area = surface(x, LATTICE)
    inwards = np.sign(np.einsum("fi,fi->f", normals[:, -1], facets.normal[rows, 0]))
    apart = np.einsum("qn,fni->fqi", shape_functions(LATTICE, motion.shape[1]), motion)
    along = np.einsum("fqi,fqi->fq", apart, normals) * inwards[:, None]
    return along + clearance @ LATTICE.T, area


def _motion(contact: ContactInterfaces, jump: Floats) -> Floats:
    """Displacement of the slave side against the master at the nodes of all facets (f, m, 3)."""
    dofs, bodies = contact.facets.dofs, contact.facets.bodies
    nodes, place = np.unique(dofs, return_inverse=True)
    place = place.reshape(dofs.shape)
    moved = np.zeros((1 + int(bodies.max()), len(nodes), 3))
    for body, B in contact.coupling.jump_to_displacement.items():
        q, u = B.createVecs()
        q.array[:] = jump.ravel()
        B.mult(q, u)
        start, end = (k // 3 for k in u.getOwnershipRange())
        own = (nodes >= start) & (nodes < end)
        moved[body, own] = u.array.reshape(-1, 3)[nodes[own] - start]
    moved = contact.comm.allreduce(moved)
    return moved[bodies[:, 1:], place] - moved[bodies[:, :1], place]
