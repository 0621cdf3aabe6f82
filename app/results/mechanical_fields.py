"""Fields of the mechanics: displacement, stress, and contact quantities."""

from __future__ import annotations

import numpy as np
from dolfinx import la

from app.arrays import Floats, Ints
from app.mechanics.problem import Problem
from app.results.field_output import OutputNodes
from app.results.interface_numbers import ContactSamples
from app.results.stresses import Stresses, extrapolated
from app.scene.scene import Interface
from forms.contact import OPEN


class MechanicalFields:
    """Displacement, stress, and contact quantities."""

    def __init__(self, problem: Problem, stresses: Stresses) -> None:
        self._problem, self._stresses = problem, stresses
        self.bodies, self.space = problem.bodies, problem.space
        index_map = self.space.dofmap.index_map
        # Stress times volume, and volume, at the nodes of a body.
        self._sums = la.vector(index_map, len(COMPONENTS) + 1)

    def point(self, nodes: OutputNodes, samples: ContactSamples | None) -> dict[str, Floats]:
        """Displacement [mm], and by interface gap, slip, motion [mm], tractions [MPa], status."""
        u = np.zeros((len(nodes.dof), 3))
        for b, function in enumerate(self._problem.displacements()):
            at = nodes.body == b
            u[at] = function.x.array.reshape(-1, 3)[nodes.dof[at]]
        point: dict[str, Floats] = {"displacement": u, **_named(self._nodal_stress(nodes))}
        if samples is not None:
            rows = self._contact_rows(nodes)
            for i, contact in enumerate(self._problem.scene.contacts):
                point |= _interface(contact, samples, rows[i])
        return point

    def cell(self, cells: int) -> dict[str, Floats]:
        """Mean stress [MPa]."""
        σ = np.zeros((cells, len(COMPONENTS)))
        for region, own in self._stresses.cells.items():
            σ[own] = _components(self._stresses.mean(region))
        return _named(σ)

    def _nodal_stress(self, nodes: OutputNodes) -> Floats:
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
                cells, σ = self._stresses.cells[region], self._stresses.evaluate(region)
                nodes_of = np.broadcast_to(X, (len(cells), *X.shape))
                σ = _components(extrapolated(σ, self._stresses.points[region], nodes_of))
                volume = self._stresses.places(region)[1].sum(axis=1)
                np.add.at(sums[:, :-1], dofs[cells], σ * volume[:, None, None])
                np.add.at(sums[:, -1], dofs[cells], volume[:, None])
            self._sums.scatter_reverse(la.InsertMode.add)
            self._sums.scatter_forward()
            at = nodes.body == body
            mean = sums[nodes.dof[at]]
            found[at] = mean[:, :-1] / np.where(mean[:, -1:] > 0, mean[:, -1:], 1.0)
        return found

    def _contact_rows(self, nodes: OutputNodes) -> list[Ints]:
        """For each interface, the contact points (n, 2) at or around the nodes of the grid.

        The point twice at a corner, the ends of an edge of the interface at its middle, -1
        elsewhere.
        """
        if self._problem.contact is None:
            return []
        points, index_map = self._problem.contact.points, self.space.dofmap.index_map
        count, dofs = len(self.bodies.names), self.space.dofmap.list
        ends = np.take_along_axis(dofs[nodes.cell], nodes.ends, axis=1)
        numbers = index_map.local_to_global(ends.ravel().astype(np.int32)).reshape(ends.shape)
        rows = []
        for i, triangles in enumerate(points.triangles):
            here = np.flatnonzero(points.interface == i)
            # By node and body.
            point = np.full((index_map.size_global, count), -1, dtype=np.int64)
            point[points.dof[here, None], points.bodies[here]] = here[:, None]
            rows.append(_on_edges(point[numbers, nodes.body[:, None]], triangles, len(points.dof)))
        return rows


# Components of a symmetric tensor in VTK's order: XX, YY, ZZ, XY, YZ, XZ.
COMPONENTS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))


def _components(σ: Floats) -> Floats:
    return np.stack([σ[..., i, j] for i, j in COMPONENTS], axis=-1)


def _named(σ: Floats) -> dict[str, Floats]:
    """Components of stress (n, 6), von Mises and principal stresses [MPa], by name."""
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


def _interface(contact: Interface, s: ContactSamples, rows: Ints) -> dict[str, Floats]:
    """Fields of an interface at the grid's nodes: zero away from it, status -1.

    They are linear along edges. In the middle of one the status is the more mobile of its ends:
    open before all, else the higher number.
    """
    on = rows[:, 0] >= 0

    def spread(values: Floats) -> Floats:
        out = np.zeros((len(rows), *values.shape[1:]))
        out[on] = values[rows[on]].mean(axis=1)
        return out

    status = np.full(len(rows), -1.0)
    ends = s.status[rows[on]]
    status[on] = np.where((ends == OPEN).any(axis=1), OPEN, ends.max(axis=1))
    fields = {
        **{variable: s.own[variable] for variable in contact.law.history},
        **{"gap": s.opening, "slip": s.slip, "slip_path": s.path, "motion": s.motion},
        **{"pressure": s.pressure, "shear": s.shear},
    }
    found = {f"{contact.name}_{key}": spread(values) for key, values in fields.items()}
    return found | {f"{contact.name}_status": status}
