"""Tractions of bonded interfaces from the equilibrium of their sides, and failure indices.

The stress of one side exerts forces on the common nodes. After subtraction of loads and elastic
foundations they are the forces on the other side. They are converted to the points that contact
would have instead of the bond, and equal the forces of sticking contact. Loads on cells at the
interface count as traction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from app.case.summary import Numbers
from app.foundation.arrays import Field, Floats, Ints
from app.interfaces.contact_points import contact_points
from app.interfaces.corners import ContactPoints, ContactSurface, Entries
from app.interfaces.faces import projectors
from app.laws.interface_laws import InterfaceStrength
from app.laws.loads import Load
from app.mechanics.body_forms import BodyForms, OnBody, SurfaceMeasure, assemble_form_vector
from app.mechanics.external_forces import at_full_amplitude
from app.mechanics.problem import Problem
from app.results.interface_numbers import failing, normal_pressure
from app.results.records import Borders
from app.results.stresses import Stresses
from app.results.surface_parts import Surface, in_parts
from app.scene.bodies import (
    Bodies,
    boundary_facets,
    facet_nodes,
    facets_between,
    facets_of_interfaces,
    pieces_of,
)
from app.scene.frames import vertex_constraints
from app.scene.scene import Interface

# Strength of the cement-bone interface: Mann, Werner & Ayers 1999, as quoted by the paper in its
# section 4.5.
CEMENT_ON_BONE = InterfaceStrength.model_validate({"tension": "1.35 MPa", "shear": "2.25 MPa"})


def _strength(bond: Interface) -> InterfaceStrength:
    """Return the strength of a bond; the default is the strength of cement on bone."""
    return bond.law.strength or CEMENT_ON_BONE


def _numbers(bond: Interface, surface: Surface, pressures: Floats, shear: Floats) -> Numbers:
    """Numbers of a bond, with those of its parts below their names.

    Args:
        bond: The bond.
        surface: Its facets.
        pressures: Pressure of each face, negative in tension (m, 3) [MPa].
        shear: Shear at each point (m,) [MPa].
    """
    means = surface.of_faces(pressures), np.repeat(shear[:, None], 3, axis=1)
    values = tuple(map(surface.sharpened, means))
    index = _strength(bond).index(*values)
    by_part = dict[str, Numbers]()
    for part in surface.parts:
        if not surface.weight[part].any():
            continue
        numbers = failing(surface, index, part)
        if not bond.law.strength:
            numbers = {"strength_fraction": numbers["strength_fraction"]}
        # Numbers have tension as positive.
        for name, sign, mean, value in zip(
            ("normal", "shear"), (-1.0, 1.0), means, values, strict=True
        ):
            field = surface.field(sign * value, part)
            numbers |= {
                "area": field.area,
                f"{name}_mean": sign * surface.field(mean, part).mean(),
                f"{name}_max": field.maximum()[0],
            }
        by_part[part] = numbers
    return by_part.pop("", {}) | by_part


class _OnPiece(OnBody):
    """A piece of a body between interfaces; only loads on its boundaries act on it."""

    def __init__(self, body_forms: BodyForms, piece: int, surface: SurfaceMeasure) -> None:
        super().__init__(body_forms, piece)
        self._surface = surface

    def ds(self, boundary: str) -> ufl.Measure | None:
        """Return the measure of the facets of a boundary that belong to the piece, if any."""
        return self._surface.on(boundary, self._body)

    def spread(
        self, density: Field, regions: Sequence[str] | None
    ) -> list[tuple[Expr, ufl.Measure]]:
        """Return an empty list, because loads on cells count as traction."""
        return []


@dataclass(frozen=True)
class _BondGeometry:
    """All interfaces of the mesh, bonded or not, between pieces of the bodies.

    Attributes:
        points: Contact points that these interfaces would have.
        entries: Displacement of the pieces as a function of the jumps.
        surfaces: Facets of each bond.
        pieces: The pieces.
        rigid: Numbers of the rigid pieces.
        nodes: Global blocked dofs of the nodes on interfaces, in increasing order (m,).
        cells: For each region, its rank-local cells with such nodes. First their numbers (c,), then
            the indices of their nodes in ``nodes``, with m for other nodes (c, nodes), then the
            gradients of the shape functions times volume at the points of the stress
            (c, points, nodes, 3) [mm2].
        near_boundaries: Measures of the boundaries with such nodes, on the pieces.
        springs: Piece and negative forces of each elastic foundation on these boundaries.
    """

    points: ContactPoints
    entries: Entries
    surfaces: dict[str, Surface]
    pieces: Bodies
    rigid: Ints
    nodes: Ints
    cells: dict[str, tuple[Ints, Ints, Floats]]
    near_boundaries: SurfaceMeasure
    springs: list[tuple[int, fem.Form]]


class BondForces:
    """Tractions of bonded interfaces, and failure indices of bonds with known strength.

    Raises:
        InputError: The mesh does not determine the tractions of a bond.
    """

    def __init__(self, problem: Problem, stresses: Stresses, borders: Borders | None) -> None:
        self._problem, self._stresses, self._borders = problem, stresses, borders
        self._full_forces: dict[Load, Floats] = {}
        if self._bonds:
            _ = self._geometry  # refuses a mesh that is too coarse before it is solved

    def indices(self) -> tuple[ContactSurface, dict[str, tuple[int, Floats]]] | None:
        """Return failure indices of bonds by mean tractions; collective.

        Returns:
            The surface of all interfaces, and for each bond its number there and the indices at its
            points (m,) [-]. None without a bond of known strength.
        """
        if not any(b.law.strength for b in self._bonds):
            return None
        surface, (pressures, shear) = self._geometry.points.surface, self._tractions()
        loads = normal_pressure(pressures, surface.normals), shear
        with_strength = [(i, b) for i, b in enumerate(self._bonds) if b.law.strength]
        return surface, {b.name: (i, _strength(b).index(*loads)) for i, b in with_strength}

    def numbers(self, strong: bool = False) -> dict[str, Numbers]:
        """Numbers of each bond for ``summary.json``, by interface; collective.

        Args:
            strong: True for bonds of known strength only.
        """
        selected_bonds = [b for b in self._bonds if b.law.strength or not strong]
        if not selected_bonds:
            return {}
        pressures, shear = self._tractions()
        return {
            bond.name: _numbers(bond, self._geometry.surfaces[bond.name], pressures, shear)
            for bond in selected_bonds
        }

    def _tractions(self) -> tuple[Floats, Floats]:
        """Tractions over the areas of the corners; collective.

        Returns:
            Pressure of each face, negative in tension (m, 3) [MPa], and shear (m,) [MPa].
        """
        geometry, points, entries = self._geometry, self._geometry.points, self._geometry.entries
        exerted = self._exerted()
        node, component = np.divmod(entries.row, 3)
        forces = exerted[entries.body, np.searchsorted(geometry.nodes, node), component]
        force = np.zeros((len(points.x), 3))
        np.add.at(force.ravel(), entries.column, -entries.value * forces)
        force /= points.weight[:, None]
        force -= np.einsum("pij,pj->pi", projectors(points.axes, points.is_prescribed), force)
        at_corners, normals = points.surface.spread_forces(force), points.surface.normals
        pressures = -np.einsum("cik,ci->ck", np.linalg.pinv(normals), at_corners)
        shear = at_corners + np.einsum("ck,cki->ci", pressures, normals)
        return pressures, np.linalg.norm(shear, axis=1)

    def _exerted(self) -> Floats:
        """Forces of the interfaces on the pieces at the nodes (pieces, m, 3) [N]; collective."""
        geometry, problem = self._geometry, self._problem
        nodal = np.zeros((len(geometry.pieces.names), len(geometry.nodes) + 1, 3))
        for region, (rows, nodes, gradients) in geometry.cells.items():
            σ = self._stresses.evaluate(region)[rows]
            forces = np.einsum("cqij,cqnj->cni", σ, gradients)
            np.add.at(nodal[geometry.pieces.body_of_region[region]], nodes, forces)
        exerted = problem.comm.allreduce(nodal)[:, :-1]
        for load in problem.scene.loads:
            if geometry.near_boundaries.has(load.boundaries):
                exerted -= load.amplitude(problem.load_time) * self._forces(load)
        for piece, form in geometry.springs:
            exerted[piece] += self._at_nodes(assemble_form_vector(form))
        # A rigid piece has no stress. It is in equilibrium with the opposite of all other forces.
        exerted[geometry.rigid] = 0.0
        exerted[geometry.rigid] = -exerted.sum(axis=0)
        return np.asarray(exerted)

    @cached_property
    def _bonds(self) -> list[Interface]:
        """Bonds with facets in the mesh; collective."""
        problem = self._problem

        def has_facets(b: Interface) -> bool:
            return bool(
                problem.comm.allreduce(len(facets_between(problem.tagged, b.slave, b.master).cells))
            )

        return [b for b in problem.scene.bonds if has_facets(b)]

    @cached_property
    def _geometry(self) -> _BondGeometry:
        """Interfaces of the mesh with contact points, the same in all states and variations."""
        problem, scene, frames = self._problem, self._problem.scene, self._problem.stiffness.frames
        pieces, interfaces = self._pieces_and_interfaces()
        # Mechanical body of each piece.
        body = np.zeros(len(pieces.names), dtype=np.int64)
        for region, piece in pieces.body_of_region.items():
            body[piece] = problem.bodies.body_of_region[region]
        if frames is not None:
            frames = replace(frames, acts=frames.acts[:, body])
        facets = facets_of_interfaces(
            problem.tagged, pieces, problem.space, interfaces, scene.moduli
        )
        constraints, axes = vertex_constraints(
            frames, problem.tagged, pieces, problem.space, scene.supports, facets
        )
        names = [i.name for i in interfaces]
        points, entries = contact_points(facets, constraints, names, axes)
        surface = points.surface
        levels = self._borders(surface.x) if self._borders else {}
        bond_names = [bond.name for bond in self._bonds]
        surfaces = dict(zip(bond_names, in_parts(surface, bond_names, levels), strict=True))
        nodes = np.unique(entries.row // 3)
        near_boundaries = self._boundaries_near(pieces, nodes)
        return _BondGeometry(
            points=replace(points, surface=replace(surface, bodies=body[surface.bodies])),
            entries=entries,
            surfaces=surfaces,
            pieces=pieces,
            rigid=np.unique([pieces.body_of_region[r.region] for r in scene.rigid]).astype(
                np.int64
            ),
            nodes=nodes,
            cells={r: self._cells(r, nodes) for r in self._stresses.cells},
            near_boundaries=near_boundaries,
            springs=self._springs(near_boundaries, body),
        )

    def _pieces_and_interfaces(self) -> tuple[Bodies, list[Interface]]:
        """Return the pieces of the bodies and the conforming interfaces between them.

        Pieces that touch without an interface have an unnamed bond.
        """
        problem = self._problem
        conforming = [c for c in problem.scene.parting_interfaces if not c.slides_finitely]
        pieces, other_pieces = pieces_of(problem.tagged, [*self._bonds, *conforming])
        unnamed = [
            replace(self._bonds[0], name=f"{a}_{b}", master=(a,), slave=(b,))
            for a, b in other_pieces
        ]
        return pieces, [*self._bonds, *conforming, *unnamed]

    def _boundaries_near(self, pieces: Bodies, nodes: Ints) -> SurfaceMeasure:
        """Return measures of loaded or supported boundaries with some of the nodes; collective."""
        problem, scene = self._problem, self._problem.scene

        def is_near(boundary: str) -> bool:
            dofs = facet_nodes(
                problem.tagged, problem.space, boundary_facets(problem.tagged, boundary)
            )[1]
            return bool(problem.comm.allreduce(int(np.isin(dofs, nodes).any())))

        near_names = [name for name in sorted(scene.loaded_boundaries) if is_near(name)]
        return SurfaceMeasure(problem.tagged, pieces, near_names)

    def _springs(self, near_boundaries: SurfaceMeasure, body: Ints) -> list[tuple[int, fem.Form]]:
        """Forces of elastic foundations by piece; ``body`` is the body of each piece."""
        problem, forms = self._problem, list[tuple[int, fem.Form]]()
        U, v = problem.displacements(), ufl.TestFunction(problem.space)
        for foundation, spring_moduli in zip(
            problem.scene.foundations, problem.body_forms.springs, strict=True
        ):
            for piece, b in enumerate(body):
                ds = near_boundaries.on(foundation.boundary, piece)
                if ds is not None:
                    work = sum(spring_moduli[i] * U[b][i] * v[i] for i in range(3)) * ds
                    forms.append((piece, problem.body_forms.form(work)))
        return forms

    def _forces(self, load: Load) -> Floats:
        """Forces of a load on the pieces at the nodes (pieces, m, 3) at full amplitude [N]."""
        full_load = at_full_amplitude(load)
        if full_load not in self._full_forces:
            problem, geometry = self._problem, self._geometry
            v = ufl.TestFunction(problem.space)
            forces = self._full_forces[full_load] = np.zeros(
                (len(geometry.pieces.names), len(geometry.nodes), 3)
            )
            for piece in range(len(forces)):
                work = full_load.work(
                    v, _OnPiece(problem.body_forms, piece, geometry.near_boundaries)
                )
                if work != 0:
                    vector = assemble_form_vector(problem.body_forms.form(work))
                    forces[piece] = self._at_nodes(vector)
        return self._full_forces[full_load]

    def _at_nodes(self, vector: PETSc.Vec) -> Floats:
        """Return values of a vector at the nodes (m, 3) on all ranks; collective."""
        nodes = self._geometry.nodes
        first_owned, after_owned = self._problem.space.dofmap.index_map.local_range
        is_owned = (nodes >= first_owned) & (nodes < after_owned)
        values = np.zeros((len(nodes), 3))
        values[is_owned] = vector.array_r.reshape(-1, 3)[nodes[is_owned] - first_owned]
        return np.asarray(self._problem.comm.allreduce(values))

    def _cells(self, region: str, nodes: Ints) -> tuple[Ints, Ints, Floats]:
        """Return the ``cells`` of a region, as `_BondGeometry` has them."""
        stresses, space = self._stresses, self._problem.space
        dofs = space.dofmap.list[stresses.cells[region]]
        global_nodes = space.dofmap.index_map.local_to_global(dofs.ravel()).reshape(dofs.shape)
        near_rows = np.where(
            np.isin(global_nodes, nodes), np.searchsorted(nodes, global_nodes), len(nodes)
        )
        rows = np.flatnonzero((near_rows < len(nodes)).any(axis=1))
        geometry = space.mesh.geometry
        # Derivatives of shape functions in the reference cell: of the displacement, of positions.
        elements = [space.ufl_element(), space.mesh.ufl_domain().ufl_coordinate_element()]
        of_u, of_x = (
            np.array(element.sub_elements[0].tabulate(1, stresses.points_of_region[region])[1:])
            for element in elements
        )
        x = geometry.x[geometry.dofmap[stresses.cells[region][rows]]]
        inverse = np.linalg.inv(np.einsum("cni,jqn->cqij", x, of_x))
        volumes = stresses.points_and_volumes(region)[1][rows]
        gradients = np.einsum("cq,jqn,cqji->cqni", volumes, of_u, inverse, optimize=True)
        return rows, near_rows[rows], gradients
