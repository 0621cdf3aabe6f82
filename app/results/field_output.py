"""The fields of a run on one grid, where bodies that can part have nodes of their own.

A node of the mesh is there once for every body that meets there, so that gaps and jumps of the
temperature can be seen. Bodies of the mechanics are not those of the heat: a bonded interface may
resist heat and an open one may conduct; the grid tells both apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol

from mpi4py import MPI

import numpy as np
from dolfinx import fem, la
from numpy.typing import NDArray

from mantle.arrays import Floats, Ints
from mantle.forms.contact import OPEN, SLIP, STICK
from mantle.mechanics.problem import Problem
from mantle.meshes.distribute import TaggedMesh
from mantle.numerics.state import ENDS, Rows, State
from mantle.results.heat_passed import W_PER_M2
from mantle.results.necrosis import CELSIUS
from mantle.results.quantities import Samples
from mantle.results.stresses import Stresses
from mantle.results.thermal_quantities import Interfaces, ThermalRecord
from mantle.results.vtkhdf import (
    QUADRATIC_NODES,
    QUADRATIC_TETRAHEDRON,
    TETRAHEDRON,
    GridFile,
    write_last_step,
)
from mantle.scene.bodies import Bodies, cell_tags
from mantle.stepping.heat_steps import HeatState


@dataclass(frozen=True)
class Copies:
    """Nodes of the grid that this rank writes, as one layer sees them.

    Attributes:
        body: Body of each node (n,).
        dof: Its row in the space the grid was made from (n,).
        cell: A cell that has it (n,).
        ends: Vertices of that cell that it is, twice, or is in the middle of (n, 2).
    """

    body: Ints
    dof: Ints
    cell: Ints
    ends: Ints


class Layer(Protocol):
    """One physics of a run: what it has to write."""

    bodies: Bodies
    space: fem.FunctionSpace

    def point(self, nodes: Copies, samples: Samples | None) -> dict[str, Floats]:
        """Values at the nodes of the grid (n,) or (n, components)."""

    def cell(self, cells: int) -> dict[str, Floats]:
        """Values in this rank's own cells (cells, components)."""


class Fields:
    """The field file."""

    def __init__(self, tagged: TaggedMesh, layers: Sequence[Layer], path: Path) -> None:
        """Make the grid; `begin` or `resume` comes next; collective.

        Args:
            tagged: The mesh.
            layers: The mechanics, if there are any, then the heat; at least one of them.
            path: The file.
        """
        self._layers, self._path = tuple(layers), path
        space, owned = layers[0].space, tagged.mesh.topology.index_map(3).size_local
        tags = cell_tags(tagged)[:owned]
        dofs = space.dofmap.list[:owned]
        self._cells = owned
        bodies, group = np.unique(
            np.stack([layer.bodies.of_tag[tags] for layer in layers], axis=1),
            axis=0,
            return_inverse=True,
        )
        stride = int(dofs.max(initial=0)) + 1
        node = group.reshape(-1, 1) * stride + dofs
        pairs, first, cells = np.unique(node, return_index=True, return_inverse=True)
        group, dof = np.divmod(pairs, stride)
        cell, local = np.divmod(first, dofs.shape[1])
        # What the points and cells of the file are, in the order of the ranks.
        of_mesh, of_points = self._vertices(tagged, cell, local), none(len(dof))
        for k, layer in enumerate(layers):
            of_points = of_points * len(layer.bodies.names) + bodies[group, k]
        keys = of_points * tagged.mesh.geometry.index_map().size_global ** 2 + of_mesh
        comm = self._comm = tagged.mesh.comm
        mine, number = _owners(comm, keys)
        self._nodes = [
            Copies(body[group[mine]], dof[mine], cell[mine], ENDS[local[mine]]) for body in bodies.T
        ]
        place = np.where(mine, np.cumsum(mine), mine.sum() + np.cumsum(~mine)) - 1
        cells = place[cells.reshape(dofs.shape)]
        quadratic = dofs.shape[1] > 4
        self._make = partial(
            GridFile,
            comm,
            path,
            space.tabulate_dof_coordinates()[dof[mine]],
            cells[:, QUADRATIC_NODES] if quadratic else cells,
            QUADRATIC_TETRAHEDRON if quadratic else TETRAHEDRON,
            {"region": tags.astype(np.int32)},
            {"region_names": tuple(tagged.regions)},
            ghosts=number[~mine],
        )
        of_cells = tagged.mesh.topology.original_cell_index[:owned]
        self._keys = [comm.gather(k) for k in (keys[mine], of_cells)]

    @staticmethod
    def _vertices(tagged: TaggedMesh, cell: Ints, local: Ints) -> Ints:
        """Between which vertices of the mesh file nodes of cells are (n,)."""
        geometry = tagged.mesh.geometry
        corners = geometry.input_global_indices[geometry.dofmap[:, :4]][cell]
        ends = np.take_along_axis(corners, ENDS[local], axis=1)
        return np.asarray(ends.min(axis=1) * geometry.index_map().size_global + ends.max(axis=1))

    def begin(self) -> None:
        """Write the grid; collective.

        Raises:
            OSError: It cannot be written.
        """
        self._grid = self._make()
        self._order: list[Ints] = [np.concatenate(keys) if keys else none() for keys in self._keys]

    def state(self) -> State:
        """How many steps there are, of what points and cells; collective."""
        points, cells = (Rows(np.arange(len(keys)), keys) for keys in self._order)
        return {"steps": self._grid.steps, "points": points, "cells": cells}

    def resume(self, state: State) -> bool:
        """Go on after some steps of the file that is there, if it is; collective."""
        self._order = [none(), none()]
        order: list[Ints] = []
        if self._comm.rank == 0:
            self._order = [state[name].values for name in ("points", "cells")]
            for wanted, keys in zip(self._order, self._keys, strict=True):
                have = np.concatenate(keys)
                sort = np.argsort(have, kind="stable")
                place = np.minimum(np.searchsorted(have[sort], wanted), len(have) - 1)
                order.append(sort[place])
        try:
            self._grid = self._make(order=order, steps=state["steps"])
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Write the last step to a file of its own, for readers that know no time; on rank 0.

        Raises:
            OSError: It cannot be written.
        """
        part = self._path.with_name("final.vtkhdf.partial")
        write_last_step(self._path, part)
        part.replace(self._path.with_name("final.vtkhdf"))

    def write(self, time: float, samples: Samples | None) -> None:
        """Append a step; collective."""
        point: dict[str, Floats] = {}
        cell: dict[str, Floats] = {}
        for layer, nodes in zip(self._layers, self._nodes, strict=True):
            point |= layer.point(nodes, samples)
            cell |= layer.cell(self._cells)
        self._grid.write(time, point, cell)


def _owners(comm: MPI.Comm, keys: Ints) -> tuple[NDArray[np.bool_], Ints]:
    """Whose the points of several ranks are: the first one's that has them; collective.

    Args:
        comm: The ranks.
        keys: What the points of this rank are (n,), none twice.

    Returns:
        Which are this rank's own (n,), and the number of each among those of all ranks, counted in
        the order of the ranks (n,).
    """
    parts = comm.allgather(keys)
    _, first, copies = np.unique(np.concatenate(parts), return_index=True, return_inverse=True)
    own = np.zeros(len(copies), dtype=bool)
    own[first] = True
    number = (np.cumsum(own) - 1)[first[copies]]
    begin = sum(map(len, parts[: comm.rank]))
    here = slice(begin, begin + len(keys))
    return own[here], number[here]


def none(n: int = 0) -> Ints:
    """Keys of which nothing is known."""
    return np.zeros(n, dtype=np.int64)


class MechanicalFields:
    """Displacement, stress, and what contact points do."""

    def __init__(self, problem: Problem, stresses: Stresses) -> None:
        """Write these of a problem."""
        self._problem, self._stresses = problem, stresses
        self.bodies, self.space = problem.bodies, problem.space
        index_map = self.space.dofmap.index_map
        # Stress times volume, and volume, at the nodes of a body.
        self._sums = la.vector(index_map, len(COMPONENTS) + 1)

    def point(self, nodes: Copies, samples: Samples | None) -> dict[str, Floats]:
        """Displacement [mm], and by interface gap, slip, motion [mm], tractions [MPa], status."""
        u = np.zeros((len(nodes.dof), 3))
        for b, function in enumerate(self._problem.displacements()):
            at = nodes.body == b
            u[at] = function.x.array.reshape(-1, 3)[nodes.dof[at]]
        point: dict[str, Floats] = {"displacement": u, **_named(self._nodal_stress(nodes))}
        if samples is not None:
            rows = self._contact_rows(nodes)
            for i, contact in enumerate(self._problem.scene.contacts):
                point |= _interface(contact.name, samples, rows[i])
        return point

    def cell(self, cells: int) -> dict[str, Floats]:
        """Mean stress [MPa]."""
        σ = np.zeros((cells, len(COMPONENTS)))
        for region, own in self._stresses.cells.items():
            σ[own] = _components(self._stresses.mean(region))
        return _named(σ)

    def _nodal_stress(self, nodes: Copies) -> Floats:
        """Stress at the nodes (n, 6) [MPa]: the mean of the body's cells there, by volume.

        Within a cell it is the linear field that fits its stress best.
        """
        dofs, X = self.space.dofmap.list, self.space.element.interpolation_points()
        found = np.zeros((len(nodes.dof), len(COMPONENTS)))
        regions: dict[int, list[str]] = {}
        for region in self._stresses.cells:
            regions.setdefault(int(self.bodies.of_region[region]), []).append(region)
        for body in range(len(self.bodies.names)):
            sums = self._sums.array.reshape(-1, len(COMPONENTS) + 1)
            sums[:] = 0.0
            for region in regions.get(body, ()):
                cells, ξ = self._stresses.cells[region], self._stresses.at(region)
                linear = [np.column_stack([np.ones(len(p)), p]) for p in (ξ, X)]
                extrapolate = linear[1] @ np.linalg.pinv(linear[0])
                σ = _components(self._stresses.evaluate(region))
                volume = self._stresses.places(region)[1].sum(axis=1)
                at_nodes = np.einsum("nq,cqi->cni", extrapolate, σ) * volume[:, None, None]
                np.add.at(sums[:, :-1], dofs[cells], at_nodes)
                np.add.at(sums[:, -1], dofs[cells], volume[:, None])
            self._sums.scatter_reverse(la.InsertMode.add)
            self._sums.scatter_forward()
            at = nodes.body == body
            mean = sums[nodes.dof[at]]
            found[at] = mean[:, :-1] / np.where(mean[:, -1:] > 0, mean[:, -1:], 1.0)
        return found

    def _contact_rows(self, nodes: Copies) -> dict[int, Ints]:
        """For each interface, the contact points (n, 2) that nodes of the grid are or lie between.

        The point twice at a corner, the ends of an edge of the interface at its middle, -1
        elsewhere.
        """
        rows: dict[int, Ints] = {}
        layout = self.space.dofmap.dof_layout
        corner = np.array([layout.entity_dofs(0, v)[0] for v in range(4)])
        dofs = self.space.dofmap.list[nodes.cell]
        ends = np.take_along_axis(dofs, corner[nodes.ends], axis=1)
        numbers = self.space.dofmap.index_map.local_to_global(ends.ravel().astype(np.int32))
        body = np.repeat(nodes.body, 2)
        for j in self._problem.jumps:
            p = j.points
            for i in range(len(self._problem.scene.contacts)):
                found = np.full(len(numbers), -1, dtype=np.int64)
                here = np.flatnonzero(p.interface == i)
                order = here[np.argsort(p.dof[here], kind="stable")]
                at = np.clip(np.searchsorted(p.dof[order], numbers), 0, max(len(order) - 1, 0))
                if len(order):
                    k = order[at]
                    same = (p.bodies[k] == body[:, None]).any(axis=1)
                    match = (p.dof[k] == numbers) & same
                    found[match] = k[match]
                rows[i] = _on_edges(found.reshape(-1, 2), p.triangles[i], len(p.dof))
        return rows


# Of a symmetric tensor in the order in which VTK names them: XX, YY, ZZ, XY, YZ, XZ.
COMPONENTS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))


def _components(σ: Floats) -> Floats:
    """Six components (..., 6) of symmetric tensors (..., 3, 3)."""
    return np.stack([σ[..., i, j] for i, j in COMPONENTS], axis=-1)


def _named(σ: Floats) -> dict[str, Floats]:
    """Stress by components (n, 6), its von Mises and principal stresses [MPa]."""
    full = np.empty((len(σ), 3, 3))
    for k, (i, j) in enumerate(COMPONENTS):
        full[:, i, j] = full[:, j, i] = σ[:, k]
    principal: Floats = np.linalg.eigvalsh(full).astype(np.float64)
    apart = principal - np.roll(principal, 1, axis=1)
    return {
        "stress": σ,
        "von_mises": np.sqrt((apart**2).sum(axis=1) / 2),
        "principal_max": principal[:, 2],
        "principal_min": principal[:, 0],
    }


def _on_edges(rows: Ints, triangles: Ints, points: int) -> Ints:
    """Pairs of contact points (n, 2), -1 where no triangle of the interface has both."""
    edges = np.sort(triangles[:, [(0, 1), (1, 2), (2, 0)]].reshape(-1, 2), axis=1)
    pairs = np.sort(rows, axis=1)
    on = np.isin(pairs @ [points, 1], edges @ [points, 1]) | (rows[:, 0] == rows[:, 1])
    return np.where((on & (rows >= 0).all(axis=1))[:, None], rows, -1)


def _interface(name: str, s: Samples, rows: Ints) -> dict[str, Floats]:
    """Fields of an interface at the grid's nodes: zero away from it, status -1.

    They are linear along edges. In the middle of one the status is the more mobile of its ends.
    """
    on = rows[:, 0] >= 0

    def spread(values: Floats) -> Floats:
        out = np.zeros((len(rows), *values.shape[1:]))
        out[on] = values[rows[on]].mean(axis=1)
        return out

    status = np.full(len(rows), -1.0)
    moves = np.argsort([STICK, SLIP, OPEN])  # rank of each status
    ends = s.status[rows[on]]
    status[on] = np.where(moves[ends[:, 0]] >= moves[ends[:, 1]], ends[:, 0], ends[:, 1])
    return {
        f"{name}_gap": spread(s.opening),
        f"{name}_slip": spread(s.slip),
        f"{name}_slip_path": spread(s.path),
        f"{name}_motion": spread(s.motion),
        f"{name}_pressure": spread(s.pressure),
        f"{name}_shear": spread(s.shear),
        f"{name}_status": status,
    }


class HeatFields:
    """Temperature, heat doses, cure, and what passes interfaces of finite conductance."""

    def __init__(self, heating: HeatState, record: ThermalRecord, interfaces: Interfaces) -> None:
        """Write these of a run.

        Args:
            heating: The heat.
            record: Its doses.
            interfaces: Regions on the first and second side of each interface.
        """
        self._heating, self._record, self._interfaces = heating, record, interfaces
        self._conduction = heating.conduction
        self.bodies, self.space = self._conduction.bodies, self._conduction.space
        # On nodes of this rank, ghosts too.
        self._work = fem.Function(self.space)

    def point(self, nodes: Copies, samples: Samples | None) -> dict[str, Floats]:
        """By node.

        Temperature [degC]; in bone seconds at or above 47 degC, CEM43 [min] and Henriques-Moritz;
        where anything sets its degree of cure; by interface of finite conductance the jump of the
        temperature (second side minus first) [K] and the heat flux from first to second side
        [W/m2], zero away from it.
        """
        x = self._heating.vectors()
        temperatures = [t.x.array - CELSIUS for t in self._conduction.temperatures(x)]
        found = {"temperature": self._at(nodes, temperatures)}
        if self._record.bone:
            found |= {name: self._at(nodes, dose) for name, dose in self._doses().items()}
        degrees = [np.zeros(len(self._work.x.array)) for _ in self.bodies.names]
        for region, values in self._heating.degrees().items():
            own, _ = self._record.exposure(region)
            degrees[own.body] += self._spread(own.dof, values)
        if self._heating.degrees():
            found["degree_of_cure"] = self._at(nodes, degrees)
        for j, τ in zip(self._conduction.jumps, x[1:], strict=True):
            flux = W_PER_M2 * j.flux(τ.array)[0]
            for i, c in enumerate(self._conduction.scene.thermal_contacts):
                here = j.interface == i
                # From first to second side, whichever is the master.
                forward = set(self._interfaces[c.name][0]) == set(c.master)
                sign = 1.0 if forward else -1.0
                sides = {self.bodies.of_region[r] for r in (*c.master, *c.slave)}
                on = np.isin(nodes.body, list(sides)) & (nodes.ends[:, 0] == nodes.ends[:, 1])
                for what, values in (("temperature_jump", τ.array), ("heat_flux", flux)):
                    spread = self._spread(j.dof[here], sign * values[here])
                    table = [spread for _ in self.bodies.names]
                    found[f"{c.name}_{what}"] = np.where(on, self._at(nodes, table), 0.0)
        return found

    def cell(self, cells: int) -> dict[str, Floats]:
        """Nothing."""
        return {}

    def _doses(self) -> dict[str, list[Floats]]:
        """Doses of bone at the nodes of each body, by name."""
        zero = np.zeros(len(self._work.x.array))
        names = ("seconds_over_47", "cem43", "henriques_moritz")
        found: dict[str, list[Floats]] = {
            name: [zero.copy() for _ in self.bodies.names] for name in names
        }
        for region in self._record.bone:
            own, e = self._record.exposure(region)
            for name, dose in zip(names, (e.over[0], e.cem43, e.damage), strict=True):
                # Regions of one body agree on the nodes that they share.
                of_body = found[name][own.body]
                np.maximum(of_body, self._spread(own.dof, dose), out=of_body)
        return found

    def _spread(self, dof: Ints, values: Floats) -> Floats:
        """Values of own nodes on all nodes of this rank, zero elsewhere; collective."""
        self._work.x.array[:] = 0.0
        self._work.x.array[dof] = values
        self._work.x.scatter_forward()
        return self._work.x.array.copy()

    def _at(self, nodes: Copies, values: Sequence[Floats]) -> Floats:
        """Values of the bodies at the nodes of the grid: linear along edges."""
        table = np.stack(values)
        dofs = self.space.dofmap.list[nodes.cell[:, None]][:, 0]
        ends = np.take_along_axis(dofs, nodes.ends, axis=1)
        return np.asarray(table[nodes.body[:, None], ends].mean(axis=1))
