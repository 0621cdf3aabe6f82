"""Nodes of regions and of both sides of interfaces in the temperature field, and named points.

Nodes are owned by one rank, also if other ranks own cells around them. A node has the integral of
its shape function as volume. At a temperature jump, each side has a separate temperature.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
from dolfinx import fem
from dolfinx.mesh import CellType

from app.foundation.arrays import Floats, Ints
from app.foundation.dolfinx_features import cell_perm_array
from app.foundation.errors import InputError
from app.heat.heat_forms import HeatForms
from app.scene.bodies import cell_tags
from meshes.distribute import TaggedMesh
from meshes.location import cells_of_points

# Position of a point [mm], and the region to which it belongs, or None for any region.
ProbePoint = tuple[tuple[float, float, float], str | None]


@dataclass(frozen=True)
class ThermalNodes:
    """Nodes of a region that this rank owns.

    Attributes:
        body: Index of the thermal body.
        dof: Local dofs of the nodes, ascending (n,).
        x: Positions (n, 3) [mm].
        volume: Integrals of their shape functions over the region (n,) [mm3].
    """

    body: int
    dof: Ints
    x: Floats
    volume: Floats

    def values(self, temperatures: Sequence[fem.Function]) -> Floats:
        """Temperatures of the nodes (n,) [K], from the temperature functions of all bodies."""
        return np.asarray(temperatures[self.body].x.array[self.dof], dtype=np.float64)


def region_nodes(
    forms: HeatForms, regions: Sequence[str], body_of_region: Mapping[str, int]
) -> dict[str, ThermalNodes]:
    """Owned nodes of regions, by region; collective."""
    x = forms.space.tabulate_dof_coordinates()
    nodes = {}
    for region in regions:
        volume = forms.volumes(region)
        dof = np.flatnonzero(volume > 0)
        nodes[region] = ThermalNodes(body_of_region[region], dof, x[dof], volume[dof])
    return nodes


# One side of an interface: by region, rows of `ThermalNodes`.
Side = Mapping[str, Ints]


class InterfaceNodes:
    """Nodes of the two sides of an interface.

    Conforming sides share them; bodies meshed separately do not.

    Attributes:
        sides: Nodes of the first and of the second side.
        apart: True if the sides share no nodes, because their bodies are meshed separately.

    Args:
        nodes: Nodes of each region.
        interface: Regions of the first and of the second side.
        boundary_nodes: Local dofs on the two boundaries of bodies meshed separately, else None.
    """

    def __init__(
        self,
        nodes: Mapping[str, ThermalNodes],
        interface: tuple[Sequence[str], Sequence[str]],
        boundary_nodes: tuple[Ints, Ints] | None = None,
    ) -> None:
        self.apart = boundary_nodes is not None
        first_regions, second_regions = interface
        first_dof = np.concatenate([nodes[region].dof for region in first_regions])
        second_dof = np.concatenate([nodes[region].dof for region in second_regions])
        self._shared_dof = np.intersect1d(first_dof, second_dof)
        # Bodies of the two sides at the shared nodes.
        self._bodies = np.zeros((2, len(self._shared_dof)), dtype=np.int64)
        self.sides: list[Side] = []
        for side_index, regions in enumerate(interface):
            side_dof = boundary_nodes[side_index] if boundary_nodes else self._shared_dof
            side: dict[str, Ints] = {}
            for region in regions:
                region_dof = nodes[region].dof
                side[region] = np.flatnonzero(np.isin(region_dof, side_dof))
                if not self.apart:
                    columns = np.searchsorted(self._shared_dof, region_dof[side[region]])
                    self._bodies[side_index, columns] = nodes[region].body
            self.sides.append(side)

    def jump(self, temperatures: Sequence[fem.Function]) -> Floats:
        """Temperature of the second side minus that of the first at shared nodes (n,) [K].

        Empty for bodies meshed separately, which share no nodes.
        """
        temperature_of_body = np.stack([t.x.array[self._shared_dof] for t in temperatures])
        first, second = temperature_of_body[self._bodies, np.arange(len(self._shared_dof))]
        return np.asarray(second - first)


@dataclass(frozen=True)
class _LocalProbe:
    """A probe in a cell of this rank.

    Attributes:
        index: Number of the probe.
        body: Body of its cell.
        dofs: Local dofs of the cell (k,).
        shape_values: Shape functions of these dofs at the probe (k,).
    """

    index: int
    body: int
    dofs: Ints
    shape_values: Floats


class Probes:
    """Temperatures or displacements at named points, by the shape functions of their cells.

    Raises:
        InputError: A point is not in its region.
    """

    def __init__(
        self,
        tagged: TaggedMesh,
        space: fem.FunctionSpace,
        body_of_region: Mapping[str, int],
        probes: Mapping[str, ProbePoint],
    ) -> None:
        self.names = tuple(probes)
        self._comm = tagged.mesh.comm
        self._local_probes: list[_LocalProbe] = []
        for index, (name, probe) in enumerate(probes.items()):
            location = _locate(tagged, name, probe)
            if location is None:
                continue
            cell, region, barycentric = location
            dofs = space.dofmap.list[cell].astype(np.int64)
            # Reference coordinates are the barycentric ones of corners 1 to 3.
            tabulated = space.element.basix_element.tabulate(0, barycentric[None, 1:])
            shape_values = tabulated.ravel()[: len(dofs)]
            self._local_probes.append(
                _LocalProbe(index, body_of_region[region], dofs, shape_values)
            )
        self._components = space.dofmap.bs

    def values(self, functions: Sequence[fem.Function]) -> Floats:
        """Values of the bodies' functions at the probes (p, components); collective."""
        values = np.zeros((len(self.names), self._components))
        for probe in self._local_probes:
            nodal_values = functions[probe.body].x.array.reshape(-1, self._components)
            values[probe.index] = probe.shape_values @ nodal_values[probe.dofs]
        return np.asarray(self._comm.allreduce(values, MPI.SUM))


def _locate(tagged: TaggedMesh, name: str, probe: ProbePoint) -> tuple[int, str, Floats] | None:
    """Find the cell that holds a probe; collective.

    Returns:
        The cell, its region, and the barycentric coordinates in it (4,) on one rank; None on all
        other ranks.

    Raises:
        InputError: The probe is not in its region.
    """
    comm, geometry = tagged.mesh.comm, tagged.mesh.geometry
    tags = cell_tags(tagged)[: tagged.mesh.topology.index_map(3).size_local]
    position, region = probe
    cells = np.flatnonzero(tags == tagged.regions[region]) if region else np.arange(len(tags))
    # `cells_of_points` expects the node order of gmsh.
    nodes: Ints = np.empty((len(cells), geometry.dofmap.shape[1]), dtype=np.int64)
    nodes[:, cell_perm_array(CellType.tetrahedron, nodes.shape[1])] = geometry.dofmap[cells]
    located = cells_of_points(np.asarray(geometry.x, np.float64), nodes, np.array([position]))
    # MPI.MAX compares tuples: the deepest position wins, and ties go to the lowest rank.
    inside_margin, minus_rank = comm.allreduce((located.inside[0], -comm.rank), MPI.MAX)
    if inside_margin == -np.inf:
        raise InputError(outside_text(name, probe))
    if minus_rank != -comm.rank:
        return None
    region_of_tag = {tag: name_of_region for name_of_region, tag in tagged.regions.items()}
    cell = int(cells[located.cell[0]])
    return cell, region_of_tag[int(tags[cell])], located.barycentric[0]


def outside_text(name: str, probe: ProbePoint) -> str:
    """Return the message on a probe that is not in its region."""
    position, region = probe
    region_text = f"region '{region}'" if region else "the model"
    return (
        f"output.probes.{name}: {list(position)} mm is not in {region_text}; "
        "allowed: a point inside"
    )
