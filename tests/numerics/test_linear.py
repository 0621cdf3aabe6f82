"""The inverse of the stiffness that all share, and motions that are solved for apart."""

from __future__ import annotations

import logging
import re
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest

import mantle
from app.case.case import load
from app.foundation.errors import ConvergenceError
from app.mechanics.coarse_space import Boxes, free_directions, sliding_motions
from app.numerics.deflation import CoarseSpace, Deflated
from app.numerics.preconditioners import CHOLESKY, MULTIGRID, SERIAL_CHOLESKY, Inverse
from app.numerics.remedies import solve
from app.numerics.sparse import from_rows
from tests import support


def laplacian(n: int = 40) -> PETSc.Mat:
    """Second differences: symmetric positive definite."""
    A = PETSc.Mat().createAIJ((n, n), nnz=3)
    for i in range(n):
        for j, value in ((i - 1, -1.0), (i, 2.0), (i + 1, -1.0)):
            if 0 <= j < n:
                A[i, j] = value
    A.assemble()
    return A


@pytest.mark.parametrize("options", [CHOLESKY, SERIAL_CHOLESKY, MULTIGRID])
def test_preconditioners_inverse_solves_from_any_start(options: dict[str, str]) -> None:
    A = laplacian()
    inverse = Inverse(A, lambda: 0, options)
    wanted, b = A.createVecs()
    wanted.array[:] = np.sin(np.arange(40))
    A.mult(wanted, b)
    x = wanted.duplicate()
    x.set(3.0)
    assert inverse.solve(b, x, 1e-12) > 0
    np.testing.assert_allclose(x.array, wanted.array, atol=1e-9)
    # What is solved already takes nothing more.
    assert inverse.solve(b, x, 1e-6) == 0


def test_coarse_space_free_directions_have_no_resistance() -> None:
    """Open, sticking, and slipping along x on a face normal to z with friction 0.4."""
    slip = np.array([[0.0, 0.0, 0.4], [0.0, 0.9, 0.0], [0.0, 0.0, 1.0]])
    projectors = free_directions(np.array([np.zeros((3, 3)), np.eye(3), slip]))
    np.testing.assert_allclose(projectors[0], np.eye(3), atol=1e-14)
    np.testing.assert_allclose(projectors[1], 0.0, atol=1e-14)
    np.testing.assert_allclose(projectors[2], np.diag([1.0, 0.0, 0.0]), atol=1e-14)


def test_coarse_space_boxes_reproduce_linear_functions() -> None:
    """Hat functions sum to one, interpolate what is linear, and are constant outside the boxes."""
    x = np.random.default_rng(2).uniform([0, 0, 0], [4, 3, 9], (5000, 3))
    boxes = Boxes(x)
    functions, values = boxes(x)
    assert values.min() >= 0 and functions.max() < boxes.size
    np.testing.assert_allclose(values.sum(axis=1), 1.0, atol=1e-14)
    # The matrix of all functions at the points reproduces the coordinates.
    matrix = np.zeros((len(x), boxes.size))
    np.put_along_axis(matrix, functions, values, axis=1)
    weights, *_ = np.linalg.lstsq(matrix, x, rcond=None)
    np.testing.assert_allclose(matrix @ weights, x, atol=1e-12)
    far, near = boxes(np.array([[100.0, 1, 1]])), boxes(np.array([[50.0, 1, 1]]))
    np.testing.assert_array_equal(far[0], near[0])
    np.testing.assert_allclose(far[1], near[1])


@pytest.mark.parametrize("spans", [(1.0, 1.0, 0.0), (5.0, 0.0, 0.0), (0.0, 0.0, 0.0)])
def test_coarse_space_boxes_at_flat_interfaces_are_few(spans: tuple[float, ...]) -> None:
    x = np.random.default_rng(2).uniform(size=(1000, 3)) * spans
    assert Boxes(x).size <= 64  # fifteen boxes in a row
    np.testing.assert_allclose(Boxes(x)(x)[1].sum(axis=1), 1.0, atol=1e-14)


def sparse(values: np.ndarray) -> PETSc.Mat:
    """A matrix of all these entries."""
    rows, columns = values.shape
    start, numbers = columns * np.arange(rows + 1), np.tile(np.arange(columns), rows)
    return from_rows(MPI.COMM_SELF, (rows, columns), start, numbers, values.ravel())


# All directions of two points.
ALL = np.tile(np.eye(3), (2, 1, 1))


def moving(displacement: PETSc.Mat, jump: PETSc.Mat) -> CoarseSpace:
    """Motions of given rows, in all directions."""
    motions = CoarseSpace(displacement, jump)
    motions.set_free_directions(ALL)
    return motions


def test_coarse_space_follows_breaking_cohesive_interfaces() -> None:
    """The free directions of a bond may stay the same; its stiffness does not."""
    random = np.random.default_rng(1)
    motions = CoarseSpace(sparse(random.normal(size=(6, 3))), sparse(random.normal(size=(6, 3))))
    versions = []
    for stiffness in ([8.0, 8.0], [8.0, 6.0], [8.0, 0.0], [8.0, 0.0], [0.0, 0.0]):
        motions.update(ALL, np.array(stiffness))
        versions.append(motions.version)
    assert versions == [1, 1, 2, 2, 3]


def test_deflation_is_exact_for_its_motions() -> None:
    """Whatever the other preconditioner does, A Z comes back as Z, of each Jacobian."""
    random = np.random.default_rng(1)
    sizes = {"heat": 2, "displacement": 6, "jump": 6}
    shapes = [[(n, m) for m in sizes.values()] for n in sizes.values()]
    blocks = [[sparse(random.normal(size=shape)) for shape in row] for row in shapes]
    blocks[0][2] = None
    nest = PETSc.Mat().createNest(blocks)
    nest.assemble()
    inner = PETSc.PC().create()
    inner.setType("none")
    rows = {k: sparse(random.normal(size=(sizes[k], 3))) for k in ("displacement", "jump")}
    motions = moving(**rows)
    context = Deflated(inner, list(sizes), lambda: motions)
    pc = PETSc.PC().createPython(context)
    pc.setOperators(nest)
    for k in range(3):
        # The rows of the jumps and their motions change, then everything does.
        blocks[2][1].scale(2.0)
        rows["jump"].scale(-1.5)
        motions.set_free_directions(ALL)
        if k == 2:
            blocks[1][1].scale(3.0)
            motions = moving(**rows)
        nest.assemble()
        pc.setUp()
        weights = rows["jump"].createVecRight()
        weights.array[:] = [1.0, -2.0, 0.5]
        vectors = [row[1].createVecLeft() for row in blocks]
        vectors[0].zeroEntries()
        motions.combine(weights, *vectors[1:])
        wanted = PETSc.Vec().createNest(vectors)
        r, solution = wanted.duplicate(), wanted.duplicate()
        nest.mult(wanted, r)
        pc.apply(r, solution)
        solution.axpy(-1.0, wanted)
        # The motions are a little stiffer than they are: one without resistance does no harm.
        assert solution.norm() < 1e-5 * wanted.norm()


FACTORED_LATE = ("contact block", "stiffness")
PUSHED = """
geometry: {kind: blocks, blocks: [{name: lower, size: [10 mm, 10 mm, 10 mm]},
                                  {name: upper, size: [10 mm, 10 mm, 10 mm]}]}
mesh: {size: 3 mm, order: 1}
regions:
  lower: {youngs_modulus: 200 MPa, poisson_ratio: 0.3}
  upper: {youngs_modulus: 100 MPa, poisson_ratio: 0.3}
interfaces: {lower_upper: {kind: contact, friction_coefficient: 0.2}}
supports: {floor: {kind: fixed, boundary: bottom}}
loads:
  push: {kind: pressure, boundary: top, pressure: 1 MPa}
  shear: {kind: force, boundary: top, force: [15 N, 0 N, 0 N]}
stages: [{name: push, increments: 2}]
"""


def test_krylov_remedies_factor_interfaces_then_stiffness(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Where the linear solver gives up; the log says so."""
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


def test_deflation_motions_are_updated_when_many_points_change(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("app.numerics.deflation.CHANGED_SHARE", 0.2)
    problem, _ = support.assemble(support.case(PUSHED))
    j = problem.contact
    motions = sliding_motions(problem)
    n = len(j.local.rows)
    assert motions.version == 0
    # Six at least for each of the two bodies; sticking points stick.
    assert motions.jump.getSize()[1] >= 12
    free = np.zeros((n, 3, 3))
    for rows, version in (([], 0), ([0], 1), ([n // 2], 1), (slice(None), 2)):
        free = free.copy()
        free[rows] = np.eye(3)
        motions.update(free, np.zeros(n))
        assert motions.version == version
        assert version == 0 or np.count_nonzero(motions.jump.getValuesCSR()[2]) > 0
    # Two bodies shifted against each other: the jump of every point is the same.
    shift = motions.jump.createVecRight()
    shift.set(1.0)
    u, q = problem.stiffness.K.createVecRight(), j.coupling.D.createVecRight()
    motions.combine(shift, u, q)
    work = shift.duplicate()
    motions.work(u, q, work)
    assert work.dot(shift) == pytest.approx(u.dot(u) + q.dot(q))


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
    """Sticking contact is soft where its layer is; the mean penetration is F/(k A)."""
    (tmp_path / "case.yaml").write_text(LAYERED)
    changes = [f"regions.{name}.youngs_modulus={modulus} GPa" for name in ("lower", "upper")]
    changes += [
        f"interfaces.lower_upper.elastic_layer.{way}={layer} MPa/mm"
        for way in ("normal", "tangential")
    ]
    summary = mantle.run(load(tmp_path / "case.yaml", changes), tmp_path / "out").summary
    assert summary["solver"]["linear_iterations"] <= 60
    there = summary["interfaces"]["lower_upper"]
    assert there["penetration_mean"] == pytest.approx(1.0 / layer, rel=1e-6)
