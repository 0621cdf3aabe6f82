"""The assembled Jacobian is the derivative of the residual, away from kinks."""

from __future__ import annotations

from contextlib import ExitStack

import numpy as np
import pytest

from tests import support


@pytest.mark.parametrize(
    ("order", "law", "given"),
    [
        (1, "{kind: contact, friction_coefficient: 0.4}", False),
        (2, "{kind: contact, friction_coefficient: 0.4}", False),
        (1, "{kind: penalty, friction_coefficient: 0.4, penalty: 500 MPa/mm}", False),
        (1, "{kind: contact, friction_coefficient: 0}", False),
        (1, "{kind: contact, friction_coefficient: 0.4}", True),
    ],
)
def test_jacobian_taylor_remainder_is_of_second_order(order: int, law: str, given: bool) -> None:
    """|R(x + ε v) - R(x) - ε J v| falls with ε^2 near a solution of a stem in contact."""
    solved = support.solve(support.STEM, f"mesh.order={order}", f"interfaces.stem_cement={law}")
    snes = solved.solver.snes
    x, J = solved.solver.x, snes.getJacobian()[0]
    # Off the solution, where the points have some force: on it many sit exactly on their cone.
    rng = np.random.default_rng(1)
    u, q = solved.solver.u_and_q()
    free = ~solved.problem.stiffness.constraints.constrained
    u.array[free] += 1e-5 * rng.standard_normal(int(free.sum()))
    q.array[:] += 1e-5 * rng.standard_normal(q.array.size)
    changes = ExitStack()
    if given:
        contact = solved.solver.system.contact
        changes.enter_context(contact.remedies.tresca_friction())
        solved.solver.residual(x)
        contact.remedies.relax_tresca_friction(0.8)
    base, moved, linear = (x.duplicate() for _ in range(3))
    step, there = x.duplicate(), x.duplicate()
    du, dq = solved.solver.u_and_q(step)
    du.array[:] = np.where(free, rng.standard_normal(free.size), 0.0)
    dq.array[:] = rng.standard_normal(dq.array.size)
    snes.computeFunction(x, base)
    snes.computeJacobian(x, J)
    J.mult(step, linear)
    remainders = []
    for ε in (4e-9, 2e-9, 1e-9):
        x.copy(there)
        there.axpy(ε, step)
        snes.computeFunction(there, moved)
        moved.axpy(-1.0, base)
        moved.axpy(-ε, linear)
        remainders.append(moved.norm() / (ε * linear.norm()))
    # The relative remainder falls with ε, down to rounding; a wrong entry would leave it constant.
    assert remainders[-1] < 1e-4
    assert remainders[0] < 1e-6 or remainders[-1] < 0.6 * remainders[0]
