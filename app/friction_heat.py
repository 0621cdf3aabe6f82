"""Heat of friction: from the points of contact interfaces into the bodies on either side."""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from app.bodies import Bodies, contact_facets
from app.heat_forms import HeatForms
from app.sparse import at_vertices
from app.terms import Scene
from forms import interface_heat
from meshes.distribute import TaggedMesh

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Shares:
    """Parts (m,) of the heat at vertices that own nodes of bodies take."""

    vertex: Ints
    node: Ints
    body: Ints
    part: Floats


class FrictionHeating:
    """Heat of friction on all interfaces that have it.

    Attributes:
        nodal: Heat into own nodes of each body [N mm/s].
        flows: Heat on each interface by its name in the balance [N mm/s].
    """

    def __init__(self, scene: Scene, tagged: TaggedMesh, bodies: Bodies, forms: HeatForms) -> None:
        """Find the nodes; collective.

        Raises:
            InputError: An interface has no facets on this mesh.
        """
        self._forms = forms
        terms = {f.interface: f for f in scene.friction_heat}
        contacts = [c for c in scene.contacts if c.name in terms]
        facets = contact_facets(tagged, bodies, forms.space, contacts)
        start = forms.space.dofmap.index_map.local_range[0]
        self._shares: dict[str, Shares] = {}
        self._heat: dict[str, tuple[list[Floats], float]] = {}
        for i, c in enumerate(contacts):
            here = facets.interface == i
            vertex, dof = facets.vertices[here].ravel(), facets.vertex_dofs[here].ravel()
            area = facets.area[here].ravel()
            of = np.unique(vertex, return_inverse=True)[1].reshape(-1)
            part = area / np.bincount(of, area)[of]
            sides = interface_heat.friction_heat(part, terms[c.name].slave_share)
            own = (dof >= start) & (dof < start + forms.owned)
            self._shares[c.name] = Shares(
                np.tile(vertex[own], 2),
                np.tile(dof[own] - start, 2),
                np.concatenate([np.repeat(b[here], 3)[own] for b in (facets.master, facets.slave)]),
                np.concatenate([side[own] for side in sides]),
            )
        self.nodal = forms.zeros()
        self.flows = {f"friction {name}": 0.0 for name in self._shares}

    def set(self, interface: str, vertex: Ints, heat: Floats) -> None:
        """Set the heat of an interface; collective.

        Args:
            interface: Its name; nothing happens if its friction does not heat.
            vertex: Vertex numbers of the mesh file of this rank's contact points (n,).
            heat: Heat released at them (n,) [N mm/s].
        """
        if interface not in self._shares:
            return
        s = self._shares[interface]
        at = s.part * at_vertices(self._forms.comm, vertex, heat, s.vertex)
        parts = self._forms.zeros()
        for b, nodal in enumerate(parts):
            here = s.body == b
            np.add.at(nodal, s.node[here], at[here])
        self._heat[interface] = parts, float(at.sum())
        self.nodal = [
            np.sum([p[b] for p, _ in self._heat.values()], axis=0) for b in range(len(parts))
        ]
        self.flows[f"friction {interface}"] = float(
            self._forms.comm.allreduce(float(at.sum()), MPI.SUM)
        )
