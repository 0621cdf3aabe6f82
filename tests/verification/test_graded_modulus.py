"""A Young's modulus that varies over the height: a closed form, and equal constant values."""

from __future__ import annotations

import numpy as np
import pytest

from app.results.stresses import Stresses
from tests import support
from tests.cases.blocks import PULLED, bar


@pytest.mark.parametrize("order", [1, 2])
def test_graded_modulus_elongation_of_a_bar(order: int) -> None:
    """The integral of s / E is s (z1 - z0) / (E1 - E0) ln(E1 / E0) if E is linear.

    The error of the work has twice the order of that of the displacement.
    """
    exact, errors = 10 * (2 / 100 + 6 / 900 * np.log(10) + 2 / 1000), []
    for layers in (20, 40):
        solved = support.solve(PULLED, f"mesh.order={order}", tagged=bar(layers))
        work = solved.problem.f.dot(solved.solver.u_and_q()[0])
        errors.append(abs(work / 10 / exact - 1))
        stresses = Stresses(solved.problem)
        energy = float(
            (stresses.energy_density("bar") * stresses.points_and_volumes("bar")[1]).sum()
        )
        assert energy == pytest.approx(0.5 * work, rel=1e-9)
        grid = solved.problem.tagged.mesh.geometry
        z = grid.x[grid.dofmap, 2].mean(axis=1)  # kinks are between cells
        E = stresses.varying_moduli()["bar"]
        assert np.interp(z, [2, 8], [100, 1000]) == pytest.approx(E, rel=1e-12)
    assert errors[0] / errors[1] == pytest.approx(4**order, rel=0.2)


def test_graded_modulus_equal_values_are_a_constant() -> None:
    """The case has contact at second order. Results agree to rounding."""
    even = "regions.bone.youngs_modulus=[[0 mm, 17 GPa], [10 mm, 17 GPa], [15 mm, 17 GPa]]"
    more = ("mesh.order=2", "mesh.curved=false", "solver.tolerance=1e-13")
    both = [support.solve(support.STEM, *more, *change) for change in ((even,), ())]
    for region in ("stem", "cement", "bone"):
        assert support.difference(*(s.displacement(region)[1] for s in both)) < 1e-12
        assert support.difference(*(s.stress(region) for s in both)) < 1e-11
