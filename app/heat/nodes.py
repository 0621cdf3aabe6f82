"""Nodes of regions, of the two sides of interfaces, and named points in the temperature field.

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
from meshes.location import place

# A point [mm], and the region that it belongs to; None for any region that holds it.
Probe = tuple[tuple[float, float, float], str | None]


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
        """Temperatures of the nodes (n,) [K], from the temperatures of the bodies."""
        return np.asarray(temperatures[self.body].x.array[self.dof], dtype=np.float64)


def region_nodes(
    forms: HeatForms, regions: Sequence[str], of_region: Mapping[str, int]
) -> dict[str, ThermalNodes]:
    """Nodes of regions, with the body of each region; collective."""
    x = forms.space.tabulate_dof_coordinates()
    nodes = {}
    for region in regions:
        volume = forms.volumes(region)
        dof = np.flatnonzero(volume > 0)
        nodes[region] = ThermalNodes(of_region[region], dof, x[dof], volume[dof])
    return nodes


# One side of an interface: rows of nodes by region.
Side = Mapping[str, Ints]


class InterfaceNodes:
    """Nodes of the two sides of an interface.

    Conforming sides share them; bodies meshed separately do not.

    Attributes:
        sides: Nodes of the first and the second side.
        apart: True if the sides share no nodes: bodies meshed apart.

    Args:
        faces: Nodes of the two boundaries of bodies meshed apart.
    """

    def __init__(
        self,
        nodes: Mapping[str, ThermalNodes],
        interface: tuple[Sequence[str], Sequence[str]],
        faces: tuple[Ints, Ints] | None = None,
    ) -> None:
        first, second = (np.concatenate([nodes[r].dof for r in side]) for side in interface)
        self._dof, self.apart = np.intersect1d(first, second), faces is not None
        self.sides: list[Side] = [
            {r: np.flatnonzero(np.isin(nodes[r].dof, nodes_of_side)) for r in side}
            for side, nodes_of_side in zip(interface, faces or (self._dof, self._dof), strict=True)
        ]
        self._bodies = np.zeros((2, len(self._dof)), dtype=np.int64)
        for bodies, side in () if faces else zip(self._bodies, self.sides, strict=True):
            for region, rows in side.items():
                region_nodes = nodes[region]
                bodies[np.searchsorted(self._dof, region_nodes.dof[rows])] = region_nodes.body

    def jump(self, temperatures: Sequence[fem.Function]) -> Floats:
        """Temperature of the second side minus that of the first (n,) [K].

        Empty for bodies meshed separately.
        """
        table = np.stack([t.x.array[self._dof] for t in temperatures])
        first, second = table[self._bodies, np.arange(len(self._dof))]
        return np.asarray(second - first)


class Probes:
    """Temperatures or displacements at named points, by the shape functions of their cells.

    Raises:
        InputError: A point is not in its region.
    """

    def __init__(
        self,
        tagged: TaggedMesh,
        space: fem.FunctionSpace,
        of_region: Mapping[str, int],
        probes: Mapping[str, Probe],
    ) -> None:
        self.names = tuple(probes)
        self._comm = tagged.mesh.comm
        self._local_probes: list[tuple[int, int, Ints, Floats]] = []
        for k, (name, probe) in enumerate(probes.items()):
            location = _locate(tagged, name, probe)
            if location is not None:
                cell, region, share = location
                dofs = space.dofmap.list[cell].astype(np.int64)
                table = space.element.basix_element.tabulate(0, share[None, 1:])
                self._local_probes.append((k, of_region[region], dofs, table.ravel()[: len(dofs)]))
        self._components = space.dofmap.bs

    def values(self, functions: Sequence[fem.Function]) -> Floats:
        """Values of the bodies' functions at the probes (p, components); collective."""
        local = np.zeros((len(self.names), self._components))
        for k, body, dofs, shape in self._local_probes:
            local[k] = shape @ functions[body].x.array.reshape(-1, self._components)[dofs]
        return np.asarray(self._comm.allreduce(local, MPI.SUM))


def _locate(tagged: TaggedMesh, probed: str, probe: Probe) -> tuple[int, str, Floats] | None:
    """Cell that holds a point, its region, and the barycentric coordinates there (4,).

    Collective; one rank has it, the others None.

    Raises:
        InputError: The point is not in its region.
    """
    comm, geometry = tagged.mesh.comm, tagged.mesh.geometry
    tags = cell_tags(tagged)[: tagged.mesh.topology.index_map(3).size_local]
    at, region = probe
    cells = np.flatnonzero(tags == tagged.regions[region]) if region else np.arange(len(tags))
    # Columns in the order of gmsh.
    nodes: Ints = np.empty((len(cells), geometry.dofmap.shape[1]), dtype=np.int64)
    nodes[:, cell_perm_array(CellType.tetrahedron, nodes.shape[1])] = geometry.dofmap[cells]
    located = place(np.asarray(geometry.x, np.float64), nodes, np.array([at]))
    inside_margin, rank = comm.allreduce((located.inside[0], -comm.rank), MPI.MAX)
    if inside_margin == -np.inf:
        raise InputError(outside_text(probed, probe))
    if rank != -comm.rank:
        return None
    names = {tag: name for name, tag in tagged.regions.items()}
    cell = int(cells[located.cell[0]])
    return cell, names[int(tags[cell])], located.share[0]


def outside_text(name: str, probe: Probe) -> str:
    """Return the message on a probe that is not in its region."""
    at, region = probe
    where = f"region '{region}'" if region else "the model"
    return f"output.probes.{name}: {list(at)} mm is not in {where}; allowed: a point inside"
