"""Strain and displacement of strain gauges, and displacement of points.

A gauge measures the strain :math:`d · ε d` in the direction d of its grid as a mean over its circle
(`meshes.gauge_points`). It is the total strain, which includes thermal and other free strain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
from dolfinx import fem

from app.case.case import Case
from app.case.probes import Probe, StrainGauge
from app.case.summary import Numbers
from app.foundation.arrays import Floats, Ints
from app.foundation.errors import InputError
from app.heat.nodes import Probes
from app.mechanics.body_forms import shape_functions_in_cells
from app.mechanics.problem import Problem
from app.scene import bodies
from meshes.gauge_points import GaugeFault, GaugePoints, gauge_points

# Nodes of facets in the order of gmsh, whose middles follow the edges 01, 12, 20.
GMSH = [0, 1, 2, 5, 3, 4]
# Corners of the reference cell.
CORNERS = np.vstack([np.zeros(3), np.eye(3)])


@dataclass(frozen=True)
class _Surface:
    """Facets of a boundary on all ranks, in an order that does not depend on ranks.

    Attributes:
        x: Their nodes in the order of gmsh (f, 3 or 6, 3) [mm].
        rank: Rank that owns the cell of each facet (f,).
        cell: This cell, by its number on that rank (f,).
        local: Number of the facet in the cell (f,).
    """

    x: Floats
    rank: Ints
    cell: Ints
    local: Ints


@dataclass(frozen=True)
class _Gauge:
    """A gauge with its points on this rank.

    Attributes:
        centre: Its centre (3,) [mm].
        direction: Unit vector of its grid (3,).
        body: Body of each point on this rank (n,).
        nodes: Nodes of the cell of each point (n, k).
        mean: Weights of nodal values for the mean (n, k).
        slope: Weights for the mean of the derivative along the grid (n, k) [1/mm].
    """

    centre: Floats
    direction: Floats
    body: Ints
    nodes: Ints
    mean: Floats
    slope: Floats


class ProbedMechanics:
    """Displacements of points and numbers of strain gauges of a case; created on all ranks.

    Raises:
        InputError: A point is not in its region, or a gauge does not fit its surface.
    """

    def __init__(self, case: Case, problem: Problem) -> None:
        self._problem = problem
        points = {n: p for n, p in case.output.probes.items() if isinstance(p, Probe)}
        points_and_regions = {name: (p.at, p.region) for name, p in points.items()}
        self._points = Probes(
            problem.tagged, problem.space, problem.bodies.body_of_region, points_and_regions
        )
        surfaces: dict[str, _Surface] = {}
        self._gauges: dict[str, _Gauge] = {}
        for name, probe in case.output.probes.items():
            if isinstance(probe, StrainGauge):
                if probe.boundary not in surfaces:
                    surfaces[probe.boundary] = _surface(problem, probe.boundary)
                self._gauges[name] = _gauge(problem, surfaces[probe.boundary], name, probe)
        self._order = tuple(case.output.probes)

    def numbers(self) -> dict[str, Numbers]:
        """Return the numbers of each probe; collective."""
        u = self._problem.displacements()
        values = self._points.values(u)
        by_probe: dict[str, Numbers] = {
            name: {"displacement": values[k].tolist()} for k, name in enumerate(self._points.names)
        }
        for name, gauge in self._gauges.items():
            displacement, strain = _measured(self._problem, u, gauge)
            by_probe[name] = {
                "strain": strain,
                "displacement": displacement.tolist(),
                "centre": gauge.centre.tolist(),
                "direction": gauge.direction.tolist(),
            }
        return {name: by_probe[name] for name in self._order}

    def step_record(self) -> Mapping[str, float]:
        """Return the columns of ``history.csv`` after a step; collective."""
        row: dict[str, float] = {}
        for name, numbers in self.numbers().items():
            u = numbers["displacement"]
            row |= {f"{name} displacement.{a} [mm]": v for a, v in zip("xyz", u, strict=True)}
            if "strain" in numbers:
                row[f"{name} strain [-]"] = numbers["strain"]
        return row


def _surface(problem: Problem, boundary: str) -> _Surface:
    """Facets of a boundary on all ranks; collective."""
    facets = bodies.boundary_facets(problem.tagged, boundary)
    x = bodies.facet_coordinates(problem.tagged, facets)[0].astype(np.float64)
    if x.shape[1] == len(GMSH):
        x = x[:, GMSH]
    comm = problem.comm
    rank = np.full(len(facets.cells), comm.rank)
    rank_facets = comm.allgather((x, rank, facets.cells, facets.local))
    x, rank, cell, local = (np.concatenate(column) for column in zip(*rank_facets, strict=True))
    order = np.lexsort(np.round(x[:, :3].mean(axis=1), 9).T)
    return _Surface(x[order], rank[order], cell[order], local[order])


def _gauge(problem: Problem, surface: _Surface, name: str, gauge: StrainGauge) -> _Gauge:
    """Place a gauge; the same on all ranks.

    Raises:
        InputError: The gauge does not fit its surface.
    """
    try:
        points = gauge_points(surface.x, gauge.at, gauge.towards, gauge.direction, gauge.diameter)
    except GaugeFault as fault:
        raise InputError(f"output.probes.{name}.{fault.key}: {fault}; {fault.remedy}") from fault
    return _on_this_rank(problem, surface, points)


def _on_this_rank(problem: Problem, surface: _Surface, points: GaugePoints) -> _Gauge:
    """Weights of nodal values at the points of a gauge in cells of this rank."""
    local_points = np.flatnonzero(surface.rank[points.facet] == problem.comm.rank)
    facet = points.facet[local_points]
    corners = CORNERS[bodies.FACET_NODES[surface.local[facet], :3]]
    reference = np.einsum("nk,nkc->nc", points.barycentric[local_points], corners)
    cell = surface.cell[facet]
    values, gradients = shape_functions_in_cells(problem.space, cell, reference)
    weight = points.weight[local_points, None]
    return _Gauge(
        centre=points.centre,
        direction=points.direction,
        body=problem.bodies.body_of_tag[bodies.cell_tags(problem.tagged)[cell]],
        nodes=problem.space.dofmap.list[cell].astype(np.int64),
        mean=weight * values,
        slope=weight * (points.direction @ gradients),
    )


def _measured(problem: Problem, u: Sequence[fem.Function], gauge: _Gauge) -> tuple[Floats, float]:
    """Mean displacement (3,) [mm] and strain [-] of a gauge; collective."""
    displacements = np.stack([body_displacement.x.array.reshape(-1, 3) for body_displacement in u])
    nodal = displacements[gauge.body[:, None], gauge.nodes]
    displacement = np.einsum("nk,nkc->c", gauge.mean, nodal)
    strain = np.einsum("nk,nkc,c->", gauge.slope, nodal, gauge.direction)
    sums = problem.comm.allreduce(np.array([*displacement, strain]), MPI.SUM)
    return sums[:3], float(sums[3])
