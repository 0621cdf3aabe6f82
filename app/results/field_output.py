"""Fields of a run on one grid, in which bodies that can separate have separate nodes.

A node of the mesh is in the grid once for every body at this node, so that gaps and temperature
jumps are visible. Mechanics and heat may have different bodies: a bonded interface may resist heat,
and an open one may conduct it. The grid separates the bodies of both.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

import numpy as np
from dolfinx import fem, la

from app.foundation.arrays import Floats, Ints
from app.foundation.dolfinx_features import interpolation_points
from app.mechanics.problem import Problem
from app.numerics.saved_state import NODE_VERTICES, node_keys
from app.results.bond_forces import BondForces
from app.results.interface_numbers import ContactSamples
from app.results.necrosis import CELSIUS
from app.results.records import NodalSurface, Record
from app.results.stresses import Stresses, extrapolated, mises_and_principal
from app.results.thermal_record import W_PER_M2, Interfaces, ThermalRecord
from app.results.vtkhdf import QUADRATIC_NODES, Grid, GridFile, write_last_step
from app.scene.bodies import Bodies, cell_tags
from app.scene.scene import Interface
from app.stepping.heat_state import HeatState
from forms.contact import OPEN
from meshes.distribute import TaggedMesh


@dataclass(frozen=True)
class OutputNodes:
    """Nodes at which this rank evaluates the fields of mechanics or of heat.

    Attributes:
        body: Body of each node (n,).
        dof: Its dof in the function space of the nodes, on this rank, ghosts included (n,).
        cell: A cell with this node (n,).
        ends: Two vertices of this cell (n, 2): the ends of the edge with the node in its middle, or
            twice the node itself.
        parts: Groups of regions. The stress at a node is the mean over the cells of its group.
        part: Group of each node (n,).
    """

    body: Ints
    dof: Ints
    cell: Ints
    ends: Ints
    parts: Sequence[Sequence[str]]
    part: Ints


def output_nodes(
    tagged: TaggedMesh, groups: Sequence[FieldGroup], cells: Ints, label: Ints
) -> tuple[list[OutputNodes], Ints, Ints]:
    """Return the nodes of cells of this rank, once for each label of their cells.

    Args:
        tagged: The mesh.
        groups: Sources of fields; the first one has the finest space.
        cells: Cells of this rank (m,).
        label: Number of the body or region of each cell (m,).

    Returns:
        * The nodes for each source of fields, with its bodies as groups of regions.
        * Numbers of the nodes of each cell, in the order of the function space (m, k).
        * Keys of the nodes, equal on all ranks (n,).
    """
    space = groups[0].space
    dofs = space.dofmap.list[cells]
    stride = tagged.mesh.geometry.index_map().size_global ** 2
    keys, first_rows, rows = np.unique(
        label[:, None] * stride + node_keys(space)[dofs],
        return_index=True,
        return_inverse=True,
    )
    row, local = np.divmod(first_rows, dofs.shape[1])
    dof, cell = dofs.ravel()[first_rows], cells[row]
    tags = cell_tags(tagged)[cell]
    nodes = []
    for group in groups:
        body = group.bodies.body_of_tag[tags]
        regions_of_body: list[list[str]] = [[] for _ in group.bodies.names]
        for region, number in group.bodies.body_of_region.items():
            regions_of_body[number].append(region)
        nodes.append(OutputNodes(body, dof, cell, NODE_VERTICES[local], regions_of_body, body))
    return nodes, rows.reshape(dofs.shape), keys


class Fields:
    """The field file."""

    def __init__(self, tagged: TaggedMesh, groups: Sequence[FieldGroup], path: Path) -> None:
        self._groups, self._path, self._comm = tuple(groups), path, tagged.mesh.comm
        space, owned = groups[0].space, tagged.mesh.topology.index_map(3).size_local
        tags = cell_tags(tagged)[:owned]
        # Each combination of bodies of mechanics and heat has one number.
        bodies: Ints = np.zeros(owned, dtype=np.int64)
        for group in groups:
            bodies = bodies * len(group.bodies.names) + group.bodies.body_of_tag[tags]
        self._nodes, cells, keys = output_nodes(tagged, groups, np.arange(owned), bodies)
        self._grid = Grid(
            points=space.tabulate_dof_coordinates()[self._nodes[0].dof],
            point_keys=keys,
            cells=cells[:, QUADRATIC_NODES] if cells.shape[1] > 4 else cells,
            cell_keys=tagged.mesh.topology.original_cell_index[:owned],
            cell_data={"region": tags.astype(np.int32)},
            texts={"region_names": tuple(tagged.regions)},
        )

    def open(self, steps: int = 0) -> None:
        """Begin the file, or continue it after some steps; collective.

        Raises:
            OSError: The file cannot be written or has too few steps.
        """
        self._file = GridFile(self._comm, self._path, self._grid, steps)

    def close(self) -> None:
        """Write the last step to a separate file, for programs that read no time; on rank 0.

        Raises:
            OSError: The file cannot be written.
        """
        write_last_step(self._path, self._path.with_name("final.vtkhdf"))

    def write(self, time: float, samples: ContactSamples | None) -> None:
        """Append a step; collective."""
        point: dict[str, Floats] = {}
        cell: dict[str, Floats] = {}
        for group, nodes in zip(self._groups, self._nodes, strict=True):
            of_points, of_cells = group.values(nodes, samples, len(self._grid.cells))
            point |= of_points
            cell |= of_cells
        self._file.write(time, point, cell)


# Heat doses of bone that are written as fields.
WRITTEN_DOSES = ("seconds_over_47", "cem43", "henriques_moritz")


class FieldGroup(ABC):
    """The fields of one physics of a run.

    Attributes:
        bodies: Bodies between which its fields may jump.
        space: Space of its nodal fields.
    """

    bodies: Bodies
    space: fem.FunctionSpace

    @abstractmethod
    def at_nodes(
        self, nodes: OutputNodes, samples: ContactSamples | None, cells: int
    ) -> dict[str, Floats]:
        """Return the fields on nodes by name; collective."""

    def of_cells(self, cells: int) -> dict[str, Floats]:
        """Return the fields on cells (cells,) by name: by default none."""
        return {}

    def values(
        self, nodes: OutputNodes, samples: ContactSamples | None, cells: int
    ) -> tuple[dict[str, Floats], dict[str, Floats]]:
        """Return the fields on nodes and on cells; collective."""
        return self.at_nodes(nodes, samples, cells), self.of_cells(cells)


class HeatFields(FieldGroup):
    """Temperature, heat doses, cure, and heat through interfaces of finite conductance."""

    def __init__(self, heating: HeatState, record: ThermalRecord, interfaces: Interfaces) -> None:
        self._heating, self._record, self._interfaces = heating, record, interfaces
        self._operators = heating.operators
        self.bodies, self.space = self._operators.bodies, self._operators.forms.space
        # At the nodes of this rank, ghosts included.
        self._work = fem.Function(self.space)

    def at_nodes(
        self, nodes: OutputNodes, samples: ContactSamples | None, cells: int
    ) -> dict[str, Floats]:
        """Return the fields on nodes by name; collective.

        All regions have the temperature and its highest value so far [degC]. Bone has the time at
        or above 47 degC [s], CEM43 [min] and the Henriques-Moritz integral [-]. Curing regions have
        the degree of cure [-]. An interface of finite conductance has the temperature jump, second
        side minus first [K], and the heat flux from the first to the second side [W/m2]. Both are
        zero away from the interface.
        """
        x = self._heating.vectors()
        temperatures = [t.x.array - CELSIUS for t in self._operators.temperatures(x)]
        fields = {"temperature": self._values_on_nodes(nodes, temperatures, nodes.body)}
        regions, bone = self._record.regions, self._record.bone
        peaks = {name: r.peak.value for name, r in regions.items()}
        fields["temperature_peak"] = self._of_regions(nodes, peaks) - CELSIUS
        for name in WRITTEN_DOSES if bone else ():
            doses = {region: regions[region].doses.totals[name] for region in bone}
            fields[name] = self._of_regions(nodes, doses)
        cure = self._heating.degrees()
        if cure:
            fields["degree_of_cure"] = self._of_regions(nodes, cure)
        j = self._operators.jumps
        if j is not None:
            τ = x[1].array
            point_values = np.zeros((2, len(j.points.dof)))
            point_values[:, j.owned_rows] = τ, W_PER_M2 * j.flux(τ)[0]
            self._operators.forms.comm.Allreduce(MPI.IN_PLACE, point_values)
            at_corners = [j.points.surface.spread(values) for values in point_values]
            rows = _contact_rows(j.points.surface, self.space, self.bodies, nodes)
            for c, points in zip(self._operators.scene.thermal_contacts, rows, strict=True):
                # From the first to the second side, independent of which one is the master.
                forward = set(self._interfaces[c.name][0]) == set(c.master)
                for quantity, values in zip(
                    ("temperature_jump", "heat_flux"), at_corners, strict=True
                ):
                    fields[f"{c.name}_{quantity}"] = _values_on_rows(
                        points, values if forward else -values
                    )
        return fields

    def _of_regions(self, nodes: OutputNodes, values: Mapping[str, Floats]) -> Floats:
        """Return nodal values of regions at the nodes of the grid, zero elsewhere; collective."""
        values_of_parts = [np.zeros(len(self._work.x.array)) for _ in nodes.parts]
        for region, of_region in values.items():
            region_nodes = self._record.regions[region].nodes
            self._work.x.array[:] = 0.0
            self._work.x.array[region_nodes.dof] = of_region
            self._work.x.scatter_forward()
            for k, regions in enumerate(nodes.parts):
                if region in regions:
                    # Regions of one body have equal values at their common nodes.
                    values_of_parts[k] = np.maximum(values_of_parts[k], self._work.x.array)
        return self._values_on_nodes(nodes, values_of_parts, nodes.part)

    def _values_on_nodes(
        self, nodes: OutputNodes, values: Sequence[Floats], body_of_node: Ints
    ) -> Floats:
        """Return values at nodes (n,), each from its body (n,); linear along edges."""
        table = np.stack(values)
        dofs = self.space.dofmap.list[nodes.cell[:, None]][:, 0]
        end_dofs = np.take_along_axis(dofs, nodes.ends, axis=1)
        return np.asarray(table[body_of_node[:, None], end_dofs].mean(axis=1))


# Of the mechanics


class MechanicalFields(FieldGroup):
    """Fields of mechanics: displacement, stress, and quantities of the interfaces."""

    def __init__(
        self,
        problem: Problem,
        stresses: Stresses,
        records: Iterable[Record],
        bonds: BondForces,
    ) -> None:
        self._problem = problem
        self._stresses = stresses
        self._records = tuple(records)
        self._bonds = bonds
        self.bodies, self.space = problem.bodies, problem.space
        index_map = self.space.dofmap.index_map
        # Sums of stress times volume and of volume, at the nodes of a body.
        self._sums = la.vector(index_map, len(VTK_COMPONENTS) + 1)

    def values(
        self, nodes: OutputNodes, samples: ContactSamples | None, cells: int
    ) -> tuple[dict[str, Floats], dict[str, Floats]]:
        """Return fields on nodes and on cells, with one evaluation of the stress; collective."""
        nodal, mean = self._stress(nodes, cells)
        return self._point(nodes, samples, nodal), named_stress(mean) | self.of_cells(cells)

    def at_nodes(
        self, nodes: OutputNodes, samples: ContactSamples | None, cells: int
    ) -> dict[str, Floats]:
        """Return the fields on nodes by name; collective."""
        return self._point(nodes, samples, self._stress(nodes, cells)[0])

    def _point(
        self, nodes: OutputNodes, samples: ContactSamples | None, σ: Floats
    ) -> dict[str, Floats]:
        """Return displacement with prescribed rotations, stress, and fields of the interfaces.

        An interface has gap, slip, motion [mm], tractions [MPa], status, and fields of the records.
        """
        u = np.zeros((len(nodes.dof), 3))
        for b, function in enumerate(self._problem.displacements()):
            on_body = nodes.body == b
            u[on_body] = function.x.array.reshape(-1, 3)[nodes.dof[on_body]]
        scene, x = self._problem.scene, self.space.tabulate_dof_coordinates()[nodes.dof]
        for motion in scene.motions:
            on_body = nodes.body == self.bodies.body_of_region[motion.region]
            R = scene.rotation(motion, self._problem.time)
            if np.isfinite(scene.moduli[motion.region]):  # its displacement is in rotated axes
                u[on_body] = u[on_body] @ R.T
            u[on_body] += (x[on_body] - motion.about) @ (R.T - np.eye(3))
        point_fields: dict[str, Floats] = {"displacement": u, **named_stress(σ)}
        if samples is not None:
            assert self._problem.contact is not None
            surface = self._problem.contact.points.surface
            rows = _contact_rows(surface, self.space, self.bodies, nodes)
            recorded = [record.surface_fields() for record in self._records]
            for i, interface in enumerate(self._problem.scene.parting_interfaces):
                point_fields |= _interface(interface, samples, rows[i])
                for fields in [
                    fields_by_interface[interface.name]
                    for fields_by_interface in recorded
                    if interface.name in fields_by_interface
                ]:
                    (master_rows,) = _contact_rows(fields.master, self.space, self.bodies, nodes)
                    for key, (slave, master) in fields.values.items():
                        all_values = np.zeros(len(surface.dof))
                        all_values[np.flatnonzero(surface.interface == i)[: len(slave)]] = slave
                        side_values = _values_on_rows(rows[i], all_values) + _values_on_rows(
                            master_rows, master
                        )
                        point_fields[f"{interface.name}_{key}"] = side_values
        bonds = self._bonds.indices()
        if bonds:
            surface, indices = bonds
            rows = _contact_rows(surface, self.space, self.bodies, nodes)
            for name, (i, index) in indices.items():
                point_fields[f"{name}_failure_index"] = _values_on_rows(rows[i], index)
        return point_fields

    def of_cells(self, cells: int) -> dict[str, Floats]:
        """Return varying Young's moduli [MPa], changing densities, fields of records (cells,)."""
        stresses, forms = self._stresses, self._problem.body_forms
        density = {
            r: forms.density_at(r, CENTRE, forms.density)[:, 0] for r in forms.density_regions
        }
        fields: dict[str, Floats] = {}
        for record in self._records:
            fields |= record.cell_fields(cells)
        for name, values_by_region in {
            "youngs_modulus": stresses.varying_moduli(),
            "density": density,
        }.items():
            for region, values in values_by_region.items():
                fields.setdefault(name, np.zeros(cells))[stresses.cells[region]] = values
        return fields

    def _stress(self, nodes: OutputNodes, cells: int) -> tuple[Floats, Floats]:
        """Return stress at the nodes (n, 6) and its mean in the cells (cells, 6) [MPa]; collective.

        The stress at a node is the mean, by volume, over the cells of its group at this node.
        Within a cell it is the linear field that fits the stress best. Cells outside all groups
        have no mean.
        """
        dofs, X = self.space.dofmap.list, interpolation_points(self.space)
        nodal, mean = (np.zeros((n, len(VTK_COMPONENTS))) for n in (len(nodes.dof), cells))
        for k, regions in enumerate(nodes.parts):
            sums = self._sums.array.reshape(-1, len(VTK_COMPONENTS) + 1)
            sums[:] = 0.0
            for region, owned in self._stresses.cells.items():
                if region not in regions:
                    continue
                σ = _components(self._stresses.evaluate(region))
                mean[owned] = self._stresses.volume_fractions[region] @ σ
                at_nodes = extrapolated(σ, self._stresses.points_of_region[region], X)
                volume = self._stresses.points_and_volumes(region)[1].sum(axis=1)
                owned_dofs = dofs[owned].ravel()
                # A column at a time takes a tenth of the time of np.add.at.
                for c in range(len(VTK_COMPONENTS)):
                    weighted = at_nodes[..., c] * volume[:, None]
                    sums[:, c] += np.bincount(owned_dofs, weighted.ravel(), len(sums))
                sums[:, -1] += np.bincount(owned_dofs, np.repeat(volume, len(X)), len(sums))
            self._sums.scatter_reverse(la.InsertMode.add)
            self._sums.scatter_forward()
            on_part = nodes.part == k
            sampled = sums[nodes.dof[on_part]]
            nodal[on_part] = sampled[:, :-1] / np.where(sampled[:, -1:] > 0, sampled[:, -1:], 1.0)
        return nodal, mean


# Centre of the reference cell (1, 3).
CENTRE = np.full((1, 3), 0.25)

# Components of a symmetric tensor in VTK's order: XX, YY, ZZ, XY, YZ, XZ.
VTK_COMPONENTS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))


def _components(σ: Floats) -> Floats:
    return np.stack([σ[..., i, j] for i, j in VTK_COMPONENTS], axis=-1)


def named_stress(σ: Floats) -> dict[str, Floats]:
    """Return fields of stress (n, 6) by name: tensor, von Mises, principal stresses [MPa]."""
    tensor = np.empty((len(σ), 3, 3))
    for k, (i, j) in enumerate(VTK_COMPONENTS):
        tensor[:, i, j] = tensor[:, j, i] = σ[:, k]
    mises, principal = mises_and_principal(tensor)
    return {
        "stress": σ,
        "von_mises": mises,
        "principal_max": principal[:, 2],
        "principal_min": principal[:, 0],
    }


def _contact_rows(
    points: NodalSurface,
    space: fem.FunctionSpace,
    bodies: Bodies,
    nodes: OutputNodes,
) -> list[Ints]:
    """Return two contact points (n, 2) for each node of the grid, for each interface.

    A corner of the interface has its point twice, the middle of an edge has the points at the ends
    of the edge, and other nodes have -1.
    """
    index_map, dofs = space.dofmap.index_map, space.dofmap.list
    end_dofs = np.take_along_axis(dofs[nodes.cell], nodes.ends, axis=1)
    numbers = index_map.local_to_global(end_dofs.ravel().astype(np.int32)).reshape(end_dofs.shape)
    rows = []
    for i, triangles in enumerate(points.triangles):
        interface_points = np.flatnonzero(points.interface == i)
        # Contact point by node and body.
        point_of_node = np.full((index_map.size_global, len(bodies.names)), -1, dtype=np.int64)
        point_of_node[points.dof[interface_points, None], points.bodies[interface_points]] = (
            interface_points[:, None]
        )
        rows.append(
            _rows_on_edges(point_of_node[numbers, nodes.body[:, None]], triangles, len(points.dof))
        )
    return rows


def _rows_on_edges(rows: Ints, triangles: Ints, points: int) -> Ints:
    """Return pairs of contact points (n, 2), with -1 if no triangle of the interface has both."""
    edges = np.sort(triangles[:, [(0, 1), (1, 2), (2, 0)]].reshape(-1, 2), axis=1)
    pairs = np.sort(rows, axis=1)
    is_on_edge = np.isin(pairs @ [points, 1], edges @ [points, 1]) | (rows[:, 0] == rows[:, 1])
    return np.where((is_on_edge & (rows >= 0).all(axis=1))[:, None], rows, -1)


def _values_on_rows(rows: Ints, values: Floats) -> Floats:
    """Return values of contact points at the nodes of the grid, linear along edges, 0 elsewhere."""
    has_point = rows[:, 0] >= 0
    node_values = np.zeros((len(rows), *values.shape[1:]))
    node_values[has_point] = values[rows[has_point]].mean(axis=1)
    return node_values


def _interface(interface: Interface, s: ContactSamples, rows: Ints) -> dict[str, Floats]:
    """Return the fields of an interface at the nodes of the grid; elsewhere 0, and -1 for status.

    Fields are linear along edges. The status in the middle of an edge is that of the more mobile
    end: open if one end is open, otherwise the higher number.
    """
    has_point, status = rows[:, 0] >= 0, np.full(len(rows), -1.0)
    end_status = s.status[rows[has_point]]
    status[has_point] = np.where((end_status == OPEN).any(axis=1), OPEN, end_status.max(axis=1))
    fields = {
        **{
            variable: s.internal_variables[variable]
            for variable in interface.law.internal_variables
        },
        **{"gap": s.opening, "slip": s.slip, "slip_path": s.path, "motion": s.motion},
        **{"pressure": s.pressure, "shear": s.shear},
    }
    if interface.slides_finitely:
        del fields["motion"], fields["slip"]
    if interface.press_fit:
        fields["micromotion"] = s.micromotion
    strength = interface.law.strength
    if strength:
        fields["failure_index"] = strength.index(s.pressure, s.shear)
    named_fields = {
        f"{interface.name}_{key}": _values_on_rows(rows, values) for key, values in fields.items()
    }
    return named_fields | {f"{interface.name}_status": status}
