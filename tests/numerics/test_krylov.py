"""Krylov methods: remedies, iterations, condition numbers."""

from __future__ import annotations

import logging
import re
from pathlib import Path

from petsc4py import PETSc

import numpy as np
import pytest

import mantle
from app.case.case import load_case
from app.foundation.errors import ConvergenceError
from app.numerics.krylov import condition_number
from app.numerics.remedies import solve
from meshes.distribute import TaggedMesh
from tests import support
from tests.numerics.blocks import BLOCK, PUSHED

FACTORED_LATE = ("contact block", "stiffness")


def test_krylov_remedies_factor_interfaces_then_stiffness(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """The linear solver fails. The log names the remedies."""
    never = "solver.petsc={ksp_max_it: 1, ksp_rtol: 1e-12}"
    with caplog.at_level(logging.INFO, logger="mantle"), pytest.raises(ConvergenceError):
        support.solve(PUSHED, never, "solver.linear=multigrid", "stages.0.adaptive=false")
    kinds = r"bodies \([\d,]+ dofs\): algebraic multigrid; contact \([\d,]+ dofs\): SOR"
    used = f"solver: FGMRES with field split; {kinds}; rigid sliding modes deflated"
    assert [bool(re.fullmatch(used, m)) for m in caplog.messages if "dofs" in m] == [True]
    printed = [m for m in caplog.messages if "linear solver" in m]
    assert [m.partition("factorizing the ")[2] for m in printed] == [*FACTORED_LATE]
    problem, solver = support.assemble(support.case(PUSHED, "solver.linear=multigrid"))
    linear = solver.linear
    remedies = [linear._fall_back() for _ in range(3)]
    assert [text.partition("factorizing the ")[2] for text in remedies] == [*FACTORED_LATE, ""]
    problem.set_time(0.5)
    assert solve(solver).converged


LAYERED = """\
geometry:
  kind: blocks
  blocks: [{name: lower, size: [10 mm, 10 mm, 20 mm]}, {name: upper, size: [10 mm, 10 mm, 20 mm]}]
mesh: {order: 2, size: 3 mm}
regions:
  lower: {youngs_modulus: 20 GPa, poisson_ratio: 0.3, tissue: other}
  upper: {youngs_modulus: 20 GPa, poisson_ratio: 0.3, tissue: other}
interfaces:
  lower_upper:
    kind: contact
    friction_coefficient: 0.8
    elastic_layer: {normal: 1000 MPa/mm, tangential: 1000 MPa/mm}
supports: {base: {kind: fixed, boundary: bottom}}
loads: {push: {kind: force, boundary: top, force: [20 N, 0 N, -100 N], at: [5 mm, 5 mm, 20 mm]}}
solver: {linear: direct}
output: {fields: false}
"""


@pytest.mark.parametrize("modulus", [20.0, 1e4])
@pytest.mark.parametrize("layer", [1e6, 1000.0, 10.0])
def test_krylov_iterations_do_not_grow_with_the_compliance_of_a_layer(
    tmp_path: Path, modulus: float, layer: float
) -> None:
    """Sticking contact is soft like its layer. The mean penetration is F/(k A)."""
    (tmp_path / "case.yaml").write_text(LAYERED)
    changes = [f"regions.{name}.youngs_modulus={modulus} GPa" for name in ("lower", "upper")]
    changes += [
        f"interfaces.lower_upper.elastic_layer.{way}={layer} MPa/mm"
        for way in ("normal", "tangential")
    ]
    summary = mantle.run(load_case(tmp_path / "case.yaml", changes), tmp_path / "out").summary
    assert summary["solver"]["linear_iterations"] <= 60
    there = summary["interfaces"]["lower_upper"]
    assert there["penetration_mean"] == pytest.approx(1.0 / layer, rel=1e-6)


def test_krylov_condition_number_equals_that_of_the_matrix(tagged: TaggedMesh) -> None:
    """The number is the largest over the smallest singular value of the Jacobian at the solution.

    A condensed solver does not need this matrix, but its number is the same. The solvers keep their
    states.
    """
    numbers = {}
    for linear in support.SOLVERS:
        problem, solver = support.assemble(support.case(BLOCK, f"solver.linear={linear}"), tagged)
        problem.set_time(1.0)
        solve(solver)
        before = solver.snes.getKSP().getTolerances()
        A = solver.jacobian()
        numbers[linear] = condition_number(A)
        assert solver.snes.getKSP().getTolerances() == before
        if linear == "direct":
            dense = A.convert("aij", PETSc.Mat()).convert("dense", PETSc.Mat())
    wanted = np.linalg.cond(dense.getDenseArray())
    assert list(numbers.values()) == pytest.approx([wanted] * len(numbers), rel=0.05)
