"""Deflation: exact for its motions, which follow the state."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest

from app.mechanics.coarse_space import sliding_motions
from app.numerics.deflation import CoarseSpace, Deflated
from tests import support
from tests.mechanics.coarse_spaces import ALL, sparse
from tests.numerics.blocks import PUSHED


def moving(displacement: PETSc.Mat, jump: PETSc.Mat) -> CoarseSpace:
    """Motions of given rows, in all directions."""
    motions = CoarseSpace(displacement, jump)
    motions.set_free_directions(ALL)
    return motions


def test_deflation_is_exact_for_its_motions() -> None:
    """Deflation solves exactly for its motions Z."""
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
