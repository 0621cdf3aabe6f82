"""The ball in its cup, solved by dense compliance: other unknowns, matrix and Newton method.

The liner alone gives the displacement u = S f of its surface by the forces on it. With the place of
the ball, the law at each point gives 3 n + 3 equations in f and the ball's displacement t.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import splu

from app.foundation.arrays import Floats, Ints
from app.mechanics import contact_gaps
from app.mechanics.body_forms import assemble_form_matrix
from tests import support
from tests.cases.turning_head import CUP, FORCE, MU, R, cup, solve, stages, turning

STEP = 1e-7  # of differences, in mm and N
r = 500.0  # N/mm, any


def compliance() -> tuple[Floats, Floats]:
    """Displacement of the bearing by forces on it (n, 3, n, 3) [mm/N], and its points (n, 3)."""
    problem, _ = support.assemble(support.case(CUP), cup())
    rows, columns, values = assemble_form_matrix(problem.body_forms.stiffness()).getValuesCSR()
    K = csr_matrix((values, columns, rows))
    x = problem.space.tabulate_dof_coordinates()
    size = np.linalg.norm(x, axis=1)
    assert problem.contact is not None
    points: Ints = problem.contact.points.dof
    of_liner = np.unique(
        problem.space.dofmap.list[problem.tagged.cell_tags.find(problem.tagged.regions["liner"])]
    )
    free = of_liner[size[of_liner] < R + 0.1 + 8 - 1e-6]
    dofs = (3 * free[:, None] + np.arange(3)).ravel()
    place = np.searchsorted(free, points)
    forces = np.zeros((len(dofs), 3 * len(points)))
    forces[(3 * place[:, None] + np.arange(3)).ravel(), np.arange(3 * len(points))] = 1
    moved = splu(K[dofs][:, dofs].tocsc()).solve(forces).reshape(len(free), 3, -1)
    return moved[place].reshape(len(points), 3, len(points), 3), problem.contact.points.x


def law(f: Floats, q: Floats, x: Floats, old: Floats, turn: Floats) -> Floats:
    """Force on the liner by that of the last iterate and the jump (n, 3): eq. 65 of the manual."""
    way = x + q
    normal = way / np.linalg.norm(way, axis=1)[:, None]
    gap = np.linalg.norm(way, axis=1) - R
    slip = q - old - np.cross(turn, R * normal)
    pressed = np.maximum(np.einsum("pi,pi->p", f, normal) - r * gap, 0.0)
    along = f - r * slip
    along -= np.einsum("pi,pi->p", along, normal)[:, None] * normal
    size = np.linalg.norm(along, axis=1)
    share = np.minimum(1.0, MU * pressed / np.where(size > 0, size, 1.0))
    return pressed[:, None] * normal + share[:, None] * along


def step(S: Floats, x: Floats, load: Floats, old: Floats, turn: Floats, start: Floats) -> Floats:
    """Forces of the points and displacement of the ball (3 n + 3,) after a step, by Newton."""
    n, z = len(x), start.copy()
    flat = S.reshape(3 * n, 3 * n)
    ball = np.tile(np.eye(3), (n, 1))
    for _ in range(60):
        f, q = z[:-3].reshape(n, 3), (flat @ z[:-3] - ball @ z[-3:]).reshape(n, 3)
        left = np.append((f - law(f, q, x, old, turn)).ravel(), load - f.sum(axis=0))
        if np.abs(left).max() < 1e-10 * np.abs(load).max():
            return z
        J = np.eye(3 * n + 3)
        J[-3:] = np.append(-ball.T, np.zeros((3, 3)), axis=1)
        for k in range(3):
            e = STEP * np.eye(3)[k]
            by_f = (law(f + e, q, x, old, turn) - law(f - e, q, x, old, turn)) / (2 * STEP)
            by_q = (law(f, q + e, x, old, turn) - law(f, q - e, x, old, turn)) / (2 * STEP)
            for i in range(3):
                rows = 3 * np.arange(n) + i
                J[rows, 3 * np.arange(n) + k] -= by_f[:, i]
                J[rows, :-3] -= by_q[:, i, None] * flat[k::3]
                J[rows, -3 + k] += by_q[:, i]
        z -= np.linalg.solve(J, left)
    raise AssertionError("the dense form did not converge")


def test_dense_compliance_gives_equal_forces_of_sliding(monkeypatch: pytest.MonkeyPatch) -> None:
    """The ball is pressed, then turned by 5 degrees twice.

    Normal forces agree to 1e-7 of the largest.
    """
    monkeypatch.setattr(contact_gaps, "PAIRING_ACCURACY", 1e-12)
    steps = solve(turning((0, 0, 0), (0, 10, 0)), stages(2))[-3:]
    S, x = compliance()
    n = len(x)
    z = np.zeros(3 * n + 3)
    z[-3:] = steps[0].place  # near: Newton does not find the contact from afar
    z[:-3] = (steps[0].load[:, None] * steps[0].normal).ravel()
    old: Floats = np.zeros((n, 3))
    for one in steps:
        z = step(S, x, FORCE, old, one.turn, z)
        f = z[:-3].reshape(n, 3)
        old = (np.einsum("piqj,qj->pi", S, f) - z[-3:]).reshape(n, 3)
        normal = np.einsum("pi,pi->p", f, one.normal)
        np.testing.assert_allclose(normal, one.load, atol=1e-7 * one.load.max())
        np.testing.assert_allclose(z[-3:], one.place, atol=1e-8)
