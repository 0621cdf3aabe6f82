r"""Temperature jumps between the two sides of interfaces of finite conductance.

One continuous temperature θ and, at the vertices of these interfaces, jumps τ (slave minus master):
body b has the temperature T_b = θ + B_b τ. With r_b the residual heat of the nodes of body b,
interfaces excluded, and q the heat from master to slave per area,

.. math:: \sum_b r_b = 0, \qquad \sum_b B_b^T r_b - W q(τ, p) = 0,

with the areas W of the points. A large conductance makes jumps small and causes no cancellation.
Without conductance the two sides are decoupled. The rules of displacement
(`app.interfaces.contact_points`) also apply to temperature: at vertices where interfaces meet, and
if one or both sides have prescribed temperatures.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np

from app.foundation.arrays import Floats, Ints
from app.heat.heat_forms import HeatForms
from app.interfaces.contact_points import contact_points
from app.interfaces.corners import VertexConstraints
from app.interfaces.interface_facets import InterfaceFacets, gathered_arrays
from app.numerics.pointwise import Pointwise
from app.numerics.sparse import from_triplets, owners
from app.scene.bodies import Bodies, facets_of_interfaces
from app.scene.scene import Scene
from forms import interface_heat
from meshes.distribute import TaggedMesh


class TemperatureJumps:
    """Jumps at all interfaces of finite conductance.

    Attributes:
        points: All points, replicated. Temperature uses component 0 of data by component.
        owned_rows: Rows of ``points`` that this rank owns (n,).
        dof: Owned node of each owned point (n,).
        interface: Index in ``scene.thermal_contacts`` of the interface of each owned point (n,).
        bodies: Thermal bodies (master, slave) of owned points (n, 2).
        weight: Areas of owned points (n,) [mm2].
        prescribed: Mask of owned points whose two sides have prescribed temperatures (n,).
        prescribing_condition: Conditions that prescribe the temperatures of master and slave at
            owned points, -1 where the jump is free (n, 2).
        jump_to_temperature: Matrix B_b of each body whose temperature depends on jumps.
        pressure: Contact pressure at owned points (n,) [MPa], set by the mechanics.
        friction: Friction heat per area at owned points (n,) [N/(mm s)], set by the mechanics.
        share: Share of the friction heat that enters the slave (n,).

    Args:
        scene: The laws.
        tagged: The mesh.
        bodies: Thermal bodies.
        forms: Forms of heat on the mesh.
        condition_of_body: Condition that prescribes the temperature at owned nodes of each body, or
            -1 (b, n).

    Raises:
        InputError: An interface has no facets on this mesh.
    """

    saved = ("pressure",)

    def __init__(
        self,
        scene: Scene,
        tagged: TaggedMesh,
        bodies: Bodies,
        forms: HeatForms,
        condition_of_body: Ints,
    ) -> None:
        interfaces = scene.thermal_contacts
        comm, index_map = forms.comm, forms.space.dofmap.index_map
        facets = facets_of_interfaces(tagged, bodies, forms.space, interfaces, {})
        constraints = _vertex_constraints(forms, facets, condition_of_body)
        names = [c.name for c in interfaces]
        self.points, entries = contact_points(facets, constraints, names, {}, by_face=False)
        self.owned_rows, number_of_point = owners(comm, index_map, self.points.dof)
        begin, end = index_map.local_range
        point_count = len(self.owned_rows)
        self.dof = self.points.dof[self.owned_rows] - begin
        self.interface = self.points.interface[self.owned_rows]
        self.bodies = self.points.bodies[self.owned_rows]
        self.weight = self.points.weight[self.owned_rows]
        self.prescribing_condition = self.points.prescribing_support[self.owned_rows, 0]
        self.prescribed = self.prescribing_condition[:, 0] >= 0
        # Entries are for three components of displacement. Temperature uses the first one.
        is_used = (entries.column % 3 == 0) & (entries.row >= 3 * begin) & (entries.row < 3 * end)
        body = entries.body[is_used]
        row = entries.row[is_used] // 3 - begin
        column = number_of_point[entries.column[is_used] // 3]
        value = entries.value[is_used]
        self.jump_to_temperature: dict[int, PETSc.Mat] = {}
        for b in map(int, np.unique(entries.body)):
            rows = body == b
            self.jump_to_temperature[b] = from_triplets(
                comm, forms.owned, point_count, row[rows], column[rows], value[rows]
            )
        self.pressure: Floats = np.zeros(point_count)
        self.friction: Floats = np.zeros(point_count)
        share_of_interface = {f.name: f.slave_share for f in scene.friction_heat}
        shares = np.array([share_of_interface.get(c.name, 0.0) for c in interfaces])
        self.share = shares[self.interface]
        with forms.compiling():
            inputs = ("p", "τ", "open", "per_pressure", "cap")
            self._law = Pointwise(
                comm,
                point_count,
                dict.fromkeys(inputs, 1),
                lambda x: interface_heat.flux_and_derivatives(*(x[name] for name in inputs)),
            )
        conductances = np.array([c.law.conductances for c in interfaces])[self.interface]
        self._law.set(
            open=conductances[:, 0], per_pressure=conductances[:, 1], cap=conductances[:, 2]
        )

    @property
    def row_keys(self) -> Ints:
        """Keys of owned points."""
        return self.owned_rows

    def flux(self, τ: Floats) -> tuple[Floats, Floats, Floats]:
        """Heat flux q from master to slave [N/(mm s)] at jumps τ of owned points (n,) [K].

        Returns:
            q, dq/dτ [N/(mm s K)] and dq/dp [N/(mm s MPa)], each (n,).
        """
        q, by_jump, by_pressure = self._law(p=self.pressure, τ=τ)
        return q, by_jump, by_pressure


def _vertex_constraints(
    forms: HeatForms, facets: InterfaceFacets, condition_of_body: Ints
) -> VertexConstraints:
    """Prescribed temperatures at the vertices of interfaces, as supports of all components.

    Collective. ``condition_of_body`` is the condition at owned nodes of each body, or -1 (b, n).
    """
    start = forms.space.dofmap.index_map.local_range[0]
    dof, corner = np.unique(facets.dofs[:, :3], return_index=True)
    is_owned = (dof >= start) & (dof < start + forms.owned)
    node = dof[is_owned] - start
    vertex = facets.vertices.ravel()[corner[is_owned]]
    body, row = np.nonzero(condition_of_body[:, node] >= 0)
    condition = condition_of_body[body, node[row]]
    vertex, body, condition = gathered_arrays(forms.comm, vertex[row], body, condition)
    support = np.repeat(condition[:, None], 3, axis=1)
    return VertexConstraints(vertex, body, support, rigid=np.zeros(len(vertex), dtype=bool))
