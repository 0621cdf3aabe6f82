r"""Temperature jumps between the two sides of interfaces of finite conductance.

One continuous temperature θ and, at the vertices of these interfaces, jumps τ (slave minus master):
body b has the temperature T_b = θ + B_b τ. With r_b the residual heat of the nodes of body b,
interfaces excluded, and q the heat from master to slave per area,

.. math:: \sum_b r_b = 0, \qquad \sum_b B_b^T r_b - W q(τ, p) = 0,

W the areas of the points. A large conductance makes jumps small and causes no cancellation; without
any the two sides are decoupled. Where interfaces meet, or one or both sides have given
temperatures, the rules of displacement hold (`app.interfaces.contact_points`).
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np

from app.foundation.arrays import Floats, Ints
from app.heat.heat_forms import HeatForms
from app.interfaces.contact_points import contact_points
from app.interfaces.corners import VertexConstraints
from app.interfaces.interface_facets import InterfaceFacets, gather
from app.numerics.pointwise import Pointwise
from app.numerics.sparse import from_triplets, owners
from app.scene.bodies import Bodies, contact_facets
from app.scene.scene import Scene
from forms import interface_heat
from meshes.distribute import TaggedMesh


class TemperatureJumps:
    """Jumps at all interfaces of finite conductance.

    Attributes:
        points: All points, replicated; component 0 of data by component.
        owned_rows: Rows of ``points`` that this rank owns (n,).
        dof: Owned node of each owned point (n,).
        interface: Number of the owned points' interfaces in ``scene.thermal_contacts`` (n,).
        bodies: Thermal bodies (master, slave) of owned points (n, 2).
        weight: Areas of owned points (n,) [mm2].
        prescribed: True where both sides of an owned point have given temperatures (n,).
        prescribing_condition: Conditions at master and slave of owned points, -1 where the jump is
            free (n, 2).
        moves: B_b of each body whose temperature includes jumps.
        pressure: Contact pressure at owned points (n,) [MPa], set from outside.
        friction: Friction heat per area at owned points (n,) [N/(mm s)], set from outside.
        share: Share of the friction heat that enters the slave (n,).

    Args:
        prescribed: Condition with a given temperature at owned nodes of each body, or -1 (b, n).

    Raises:
        InputError: An interface has no facets on this mesh.
    """

    def __init__(
        self, scene: Scene, tagged: TaggedMesh, bodies: Bodies, forms: HeatForms, prescribed: Ints
    ) -> None:
        contacts = scene.thermal_contacts
        comm, index_map = forms.comm, forms.space.dofmap.index_map
        facets = contact_facets(tagged, bodies, forms.space, contacts, {})
        holds = _held_vertices(forms, facets, prescribed)
        names = [c.name for c in contacts]
        self.points, entries = contact_points(facets, holds, names, {}, by_face=False)
        self.owned_rows, number_of_point = owners(comm, index_map, self.points.dof)
        begin, end = index_map.local_range
        n = len(self.owned_rows)
        self.dof = self.points.dof[self.owned_rows] - begin
        self.interface = self.points.interface[self.owned_rows]
        self.bodies = self.points.bodies[self.owned_rows]
        self.weight = self.points.weight[self.owned_rows]
        self.prescribing_condition = self.points.prescribing_support[self.owned_rows, 0]
        self.prescribed = self.prescribing_condition[:, 0] >= 0
        # Temperature has one component where displacement has three.
        owned = (entries.column % 3 == 0) & (entries.row >= 3 * begin) & (entries.row < 3 * end)
        row, column = entries.row[owned] // 3 - begin, entries.column[owned] // 3
        body, value = entries.body[owned], entries.value[owned]
        self.moves: dict[int, PETSc.Mat] = {}
        for b in map(int, np.unique(entries.body)):
            i = body == b
            columns = number_of_point[column[i]]
            self.moves[b] = from_triplets(comm, forms.owned, n, row[i], columns, value[i])
        self.pressure: Floats = np.zeros(n)
        self.friction: Floats = np.zeros(n)
        shares = {f.name: f.slave_share for f in scene.friction_heat}
        self.share = np.array([shares.get(c.name, 0.0) for c in contacts])[self.interface]
        with forms.compiling():
            inputs = ("p", "τ", "open", "per_pressure", "cap")
            self._law = Pointwise(
                comm,
                n,
                dict.fromkeys(inputs, 1),
                lambda x: interface_heat.flux_and_derivatives(*(x[name] for name in inputs)),
            )
        laws = np.array([c.law.conductances for c in contacts])[self.interface]
        self._law.set(open=laws[:, 0], per_pressure=laws[:, 1], cap=laws[:, 2])

    def flux(self, τ: Floats) -> tuple[Floats, Floats, Floats]:
        """Heat q from master to slave [N/(mm s)] at owned jumps τ [K], dq/dτ and dq/dp."""
        q, by_jump, by_pressure = self._law(p=self.pressure, τ=τ)
        return q, by_jump, by_pressure


def _held_vertices(
    forms: HeatForms, facets: InterfaceFacets, prescribed: Ints
) -> VertexConstraints:
    """Given temperatures at the vertices of interfaces, as supports hold displacement."""
    start = forms.space.dofmap.index_map.local_range[0]
    dof, first = np.unique(facets.dofs[:, :3], return_index=True)
    owned = (dof >= start) & (dof < start + forms.owned)
    node, vertex = dof[owned] - start, facets.vertices.ravel()[first[owned]]
    body, row = np.nonzero(prescribed[:, node] >= 0)
    columns = gather(forms.comm, vertex[row], body, prescribed[body, node[row]])
    rigid = np.zeros(len(columns[0]), dtype=bool)
    return VertexConstraints(
        columns[0], columns[1], np.repeat(columns[2][:, None], 3, axis=1), rigid
    )
