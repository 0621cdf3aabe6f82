"""Tractions of bonded interfaces, by equilibrium of the sides: would the bond hold?

What one side exerts on the other follows from the forces of its stress on their common nodes. They
are of the points that contact would have there, and equal those of contact that sticks. Loads on
cells at the interface count as traction.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from app.arrays import Floats, Ints
from app.laws.failure import InterfaceStrength
from app.mechanics.problem import Problem
from app.results.cement_risk import Borders
from app.results.interface_numbers import Surface, failing, normal_pressure
from app.results.stresses import Stresses
from app.scene.bodies import Bodies, contact_facets, facets_between
from app.scene.frames import held_at
from app.scene.scene import Interface
from meshes.contact_facets import projectors
from meshes.contact_points import ContactPoints, Entries, contact_points

# Strength of the cement-bone interface: Mann, Werner & Ayers 1999, as quoted by the paper in its
# section 4.5.
CEMENT_ON_BONE = InterfaceStrength.model_validate({"tension": "1.35 MPa", "shear": "2.25 MPa"})


@dataclass(frozen=True)
class _Place:
    """A bonded interface on the mesh.

    Attributes:
        entries: Displacement of the sides by jumps of its points.
        nodes: Their global blocked dofs, rising (m,).
        cells: Of each side, by region: which of its own cells meet the interface (c,), their nodes
            among those above, m elsewhere (c, nodes), and gradients of the shape functions times
            volume at the points of the stress (c, points, nodes, 3) [mm2].
    """

    points: ContactPoints
    entries: Entries
    nodes: Ints
    cells: tuple[dict[str, tuple[Ints, Ints, Floats]], ...]
    surface: Surface


class BondForces:
    """Tractions of bonded interfaces, and failure indices of those whose strength is known."""

    def __init__(self, problem: Problem, stresses: Stresses, borders: Borders | None) -> None:
        self._problem, self._stresses, self._borders = problem, stresses, borders
        self._places: dict[str, _Place | None] = {}

    def indices(self) -> dict[str, tuple[ContactPoints, Floats]]:
        """Points and their failure indices (n,) by interface; collective."""
        return {b.name: (place.points, index) for b, place, _, index in self._loaded(strong=True)}

    def numbers(self, strong: bool = False) -> dict[str, dict[str, Any]]:
        """Published numbers by interface, of those whose strength is known or all; collective."""
        found = {}
        for b, place, loads, index in self._loaded(strong):
            s, of_parts = place.surface, dict[str, dict[str, Any]]()
            for part in (part for part, at in s.at.items() if at.any()):
                of_parts[part] = own = failing(s, index, place.points.x, part)
                if not b.law.strength:
                    own = of_parts[part] = {"strength_fraction": own["strength_fraction"]}
                for name, values in (("normal", -loads[0]), ("shear", loads[1])):
                    field = s.field(values, part)
                    own |= {"area": field.whole, f"{name}_mean": field.mean()}
                    own[f"{name}_max"] = float(values[s.at[part]].max())
            found[b.name] = of_parts.pop("", {}) | of_parts
        return found

    def _loaded(
        self, strong: bool
    ) -> Iterator[tuple[Interface, _Place, tuple[Floats, Floats], Floats]]:
        """Bonds with facets in the mesh, of known strength or all: tractions and indices."""
        for b in self._problem.scene.bonds:
            if b.law.strength or not strong:
                if b.name not in self._places:  # all states and variations share it
                    self._places[b.name] = self._place(b)
                if place := self._places[b.name]:
                    loads = self._tractions(place)
                    yield b, place, loads, (b.law.strength or CEMENT_ON_BONE).index(*loads)

    def _tractions(self, place: _Place) -> tuple[Floats, Floats]:
        """Pressure, negative in tension, and shear at the points (n,) [MPa]; collective."""
        p, e, force = place.points, place.entries, np.zeros((len(place.points.x), 3))
        for side, cells in enumerate(place.cells):
            nodal = np.zeros((len(place.nodes) + 1, 3))
            for region, (rows, nodes, slopes) in cells.items():
                σ = self._stresses.evaluate(region)[rows]
                np.add.at(nodal, nodes, np.einsum("cqij,cqnj->cni", σ, slopes))
            nodal = self._problem.comm.allreduce(nodal)
            here = e.body == side
            node, component = np.divmod(e.row[here], 3)
            nodal = nodal[np.searchsorted(place.nodes, node), component]
            np.add.at(force.ravel(), e.column[here], -e.value[here] * nodal)
        force /= p.weight[:, None]
        force -= np.einsum("pij,pj->pi", projectors(p.axes, p.held), force)
        pressures = -np.einsum("pik,pi->pk", np.linalg.pinv(p.normals), force)
        shear = force + np.einsum("pk,pki->pi", pressures, p.normals)
        return normal_pressure(pressures, p.normals), np.linalg.norm(shear, axis=1)

    def _place(self, b: Interface) -> _Place | None:
        """The interface as though its sides were two bodies, if it has facets in the mesh."""
        p, scene, regions = self._problem, self._problem.scene, self._problem.tagged.regions
        if not p.comm.allreduce(len(facets_between(p.tagged, b.slave, b.master).cells)):
            return None
        sides, frames = (b.master, b.slave), p.stiffness.frames
        of_tag = -np.ones_like(p.bodies.of_tag)
        for k, side in enumerate(sides):
            of_tag[[regions[region] for region in side]] = k
        apart, body = Bodies(("", ""), {}, of_tag), p.bodies.of_region[b.slave[0]]
        if frames is not None:
            frames = replace(frames, acts=np.repeat(frames.acts[:, [body]], 2, axis=1))
        facets = contact_facets(p.tagged, apart, p.space, [b], scene.moduli)
        holds = held_at(frames, p.tagged, apart, p.space, scene.supports, facets)
        points, entries = contact_points(facets, holds[0], [b.name], holds[1])
        nodes = np.unique(entries.row // 3)
        of = self._stresses.cells
        cells = tuple({r: self._cells(r, nodes) for r in side if r in of} for side in sides)
        levels = self._borders(points.surface.x) if self._borders else {}
        surface = Surface(points.surface, 0, levels)
        whole = replace(points.surface, bodies=np.full_like(points.surface.bodies, body))
        points = replace(points, surface=whole)
        return _Place(points, entries, nodes, cells, surface)

    def _cells(self, region: str, nodes: Ints) -> tuple[Ints, Ints, Floats]:
        s, space = self._stresses, self._problem.space
        dofs = space.dofmap.list[s.cells[region]]
        of = space.dofmap.index_map.local_to_global(dofs.ravel()).reshape(dofs.shape)
        place = np.where(np.isin(of, nodes), np.searchsorted(nodes, of), len(nodes))
        rows = np.flatnonzero((place < len(nodes)).any(axis=1))
        geometry = space.mesh.geometry
        shapes = [space.ufl_element(), space.mesh.ufl_domain().ufl_coordinate_element()]
        by_X, maps = (np.array(e.sub_elements[0].tabulate(1, s.points[region])[1:]) for e in shapes)
        x = geometry.x[geometry.dofmap[s.cells[region][rows]]]
        inverse = np.linalg.inv(np.einsum("cni,jqn->cqij", x, maps))
        volumes = s.places(region)[1][rows]
        slopes = np.einsum("cq,jqn,cqji->cqni", volumes, by_X, inverse, optimize=True)
        return rows, place[rows], slopes
