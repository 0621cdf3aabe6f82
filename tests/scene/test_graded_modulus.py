"""A Young's modulus that varies over the height: a bar with a closed form, and equal values."""

from __future__ import annotations

from itertools import permutations

from mpi4py import MPI

import numpy as np
import pytest

from app.results.stresses import Stresses
from meshes.data import assemble, exterior_facets
from meshes.distribute import TaggedMesh, distribute
from tests import support

PULLED = """
geometry: {kind: blocks, blocks: [{name: bar, size: [1 mm, 1 mm, 10 mm]}]}
mesh: {size: 1 mm}
regions: {bar: {youngs_modulus: [[2 mm, 100 MPa], [8 mm, 1 GPa]], poisson_ratio: 0, tissue: bone}}
supports: {floor: {kind: fixed, boundary: bottom}}
loads: {pull: {kind: pressure, boundary: top, pressure: -10 MPa}}
"""


def bar(layers: int) -> TaggedMesh:
    """Layers of one cuboid of six cells."""
    axes = np.meshgrid([0, 1], [0, 1], np.linspace(0, 10, layers + 1), indexing="ij")
    points, steps = np.stack(axes, axis=-1).reshape(-1, 3), [2 * layers + 2, layers + 1, 1]
    paths = np.cumsum([(0, *p) for p in permutations(steps)], axis=1)
    cells = (np.arange(layers)[:, None, None] + paths).reshape(-1, 4)
    facets, _ = exterior_facets(cells)
    ends = {k: (points[facets, 2] == z).all(axis=1) for k, z in (("bottom", 0), ("top", 10))}
    data = assemble(points, cells, np.ones(6 * layers), {"bar": 1}, {}, ends, facets)
    return distribute(data, MPI.COMM_WORLD)


@pytest.mark.parametrize("order", [1, 2])
def test_a_bar_under_tension_lengthens_by_the_logarithm(order: int) -> None:
    """By the integral of s / E, s (z1 - z0) / (E1 - E0) ln(E1 / E0) where E is linear.

    The error of the work is of twice the order of the displacement.
    """
    exact, errors = 10 * (2 / 100 + 6 / 900 * np.log(10) + 2 / 1000), []
    for layers in (20, 40):
        solved = support.solve(PULLED, f"mesh.order={order}", tagged=bar(layers))
        work = solved.problem.f.dot(solved.solver.u_and_q()[0])
        errors.append(abs(work / 10 / exact - 1))
        stresses = Stresses(solved.problem)
        energy = float((stresses.energy_density("bar") * stresses.places("bar")[1]).sum())
        assert energy == pytest.approx(0.5 * work, rel=1e-9)
        grid = solved.problem.tagged.mesh.geometry
        z = grid.x[grid.dofmap, 2].mean(axis=1)  # kinks are between cells
        E = stresses.varying_moduli()["bar"]
        assert np.interp(z, [2, 8], [100, 1000]) == pytest.approx(E, rel=1e-12)
    assert errors[0] / errors[1] == pytest.approx(4**order, rel=0.2)


def test_equal_values_are_a_constant() -> None:
    """In contact, at the second order: to the rounding of the solutions."""
    even = "regions.bone.youngs_modulus=[[0 mm, 17 GPa], [10 mm, 17 GPa], [15 mm, 17 GPa]]"
    more = ("mesh.order=2", "mesh.curved=false", "solver.tolerance=1e-13")
    both = [support.solve(support.STEM, *more, *own) for own in ((even,), ())]
    for region in ("stem", "cement", "bone"):
        assert support.difference(*(s.displacement(region)[1] for s in both)) < 1e-12
        assert support.difference(*(s.stress(region) for s in both)) < 1e-11
