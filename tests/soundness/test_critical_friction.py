"""Klarbring's particle: numbers of equilibria of a point, by trying all its states."""

from __future__ import annotations

import numpy as np
import pytest

from app.case.case import Case
from app.foundation.arrays import Floats
from app.foundation.verdict import Reason, Verdict
from app.soundness.critical_friction import (
    CriticalFriction,
    critical_friction,
    critical_friction_of_interfaces,
)
from tests import support

# Relative distance from the critical coefficient at which the two sides are distinguished.
NEAR = 1e-3


def numbers_of_states(K: Floats, μ: float) -> set[int]:
    """Numbers of solutions of K q = b + r in the plane that occur over all directions of b.

    The stiffness is K = [[k_T, w], [w, k_N]]. Every state is tried with every load.
    """
    angles = np.linspace(0, 2 * np.pi, 20_001)[:-1] + 1e-5
    load = np.stack([np.cos(angles), np.sin(angles)])
    opens = np.linalg.solve(K, load)[1] > 0
    sticks = np.abs(load[0]) < -μ * load[1]
    number = opens.astype(int) + sticks
    for sign in (1, -1):
        # q = (sign s, 0), r = (-sign μ p, p): two equations in s and p.
        s, p = np.linalg.solve(np.array([[sign * K[0, 0], sign * μ], [sign * K[1, 0], -1]]), load)
        number += (s > 0) & (p > 0)
    return set(number.tolist())


def critical_in_the_plane(K: Floats) -> float:
    """Critical friction of a particle in space that moves in the plane of x and z alone."""
    whole = np.eye(3) * K.trace()
    whole[np.ix_([0, 2], [0, 2])] = K
    return float(critical_friction(whole[None], np.array([[0.0, 0.0, 1.0]]))[0])


def test_critical_friction_of_klarbrings_particle() -> None:
    """Values k_T = 1, k_N = 2, w = 0.8 give every load one solution up to a coefficient of 1.25."""
    K = np.array([[1, 0.8], [0.8, 2]])
    assert critical_in_the_plane(K) == pytest.approx(1.25, rel=1e-14)
    for μ in (0.0, 0.3, 1.0, 1.25 * (1 - NEAR)):
        assert numbers_of_states(K, μ) == {1}, μ
    for μ in (1.25 * (1 + NEAR), 1.5, 3.0):
        assert max(numbers_of_states(K, μ)) > 1, μ


def test_critical_friction_of_random_particles_in_the_plane() -> None:
    rng = np.random.default_rng(1)
    for _ in range(12):
        B = rng.normal(size=(2, 2))
        K = B @ B.T + 0.1 * np.eye(2)
        μ = critical_in_the_plane(K)
        assert numbers_of_states(K, μ * (1 - 20 * NEAR)) == {1}
        assert max(numbers_of_states(K, μ * (1 + 20 * NEAR))) > 1


def slips(K: Floats, load: Floats, μ: float, φ: Floats) -> int:
    """Number of sliding states (s, p, t) in space, by the roots over the directions of slip.

    The equations s A t + μ p t = b_T with p = s w·t - b_n are two; their ratio gives the direction.
    """
    A, w = K[:2, :2], K[2, :2]

    def sides(φ: Floats) -> tuple[Floats, Floats, Floats]:
        t = np.stack([np.cos(φ), np.sin(φ)])
        # The first is multiplied by s.
        return A @ t + μ * (w @ t) * t, load[:2, None] + μ * load[2] * t, w @ t

    left, right, _ = sides(φ)
    cross = left[0] * right[1] - left[1] * right[0]
    k = np.flatnonzero(cross[1:] * cross[:-1] < 0)
    left, right, taken = sides(φ[k] - cross[k] * (φ[k + 1] - φ[k]) / (cross[k + 1] - cross[k]))
    s = (left * right).sum(axis=0) / (left**2).sum(axis=0)
    return int(((s > 0) & (s * taken > load[2])).sum())


def number_in_space(K: Floats, load: Floats, μ: float, φ: Floats) -> int:
    opens = np.linalg.solve(K, load)[2] > 0
    sticks = np.linalg.norm(load[:2]) < -μ * load[2]
    return int(opens) + int(sticks) + slips(K, load, μ, φ)


def test_critical_friction_of_random_points_in_space() -> None:
    """Below the value random loads and those near the fold have one state.

    Beyond it the fold has stick and slip.
    """
    rng = np.random.default_rng(2)
    φ = np.linspace(0, 2 * np.pi, 4001)
    n = np.array([[0.0, 0.0, 1.0]])
    for _ in range(8):
        B = rng.normal(size=(3, 3))
        K = B @ B.T + 0.05 * np.eye(3)
        A, w = K[:2, :2], K[2, :2]
        t = np.stack([np.cos(φ), np.sin(φ)])
        ratio = np.einsum("ik,ij,jk->k", t, A, t) / np.abs(w @ t)
        μ = float(critical_friction(K[None], n)[0])
        assert μ == pytest.approx(ratio.min(), rel=1e-5)
        assert μ <= ratio.min() * (1 + 1e-14)
        # Slip by a little along the worst direction, under unit pressure.
        k = int(np.argmin(np.where(w @ t < 0, ratio, np.inf)))
        for factor, several in ((0.97, False), (1.03, True)):
            f = factor * μ
            state = 1e-3 * np.append(A @ t[:, k], w @ t[:, k]) / np.linalg.norm(A)
            fold = state + np.append(f * t[:, k], -1)
            loads = rng.normal(size=(100, 3))
            numbers = [number_in_space(K, b, f, φ) for b in loads]
            at_fold = number_in_space(K, fold, f, φ)
            assert (at_fold > 1) == several
            if not several:
                assert at_fold == 1
                assert set(numbers) == {1}


def test_critical_friction_is_invariant_under_rotation() -> None:
    """The frame of the point does not matter, nor the scale of the stiffness."""
    rng = np.random.default_rng(3)
    B = rng.normal(size=(5, 3, 3))
    K = B @ B.transpose(0, 2, 1)
    n = rng.normal(size=(5, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turned = critical_friction(1e3 * Q @ K @ Q.T, n @ Q.T)
    np.testing.assert_allclose(turned, critical_friction(K, n), rtol=1e-10)


def test_critical_friction_is_infinite_without_coupling() -> None:
    K = np.diag([1.0, 2.0, 3.0])[None]
    assert np.isinf(critical_friction(K, np.array([[0.0, 0.0, 1.0]]))).all()


STACK = f"""{support.TWO_BLOCKS}regions:
  lower: {{youngs_modulus: 1000 MPa, poisson_ratio: 0.3}}
  upper: {{youngs_modulus: 500 MPa, poisson_ratio: 0.3}}
supports:
  floor: {{kind: fixed, boundary: bottom}}
  side: {{kind: roller, boundary: x_min, axis: x}}
"""


def stack(friction: float) -> Case:
    law = f"{{kind: contact, friction_coefficient: {friction}}}"
    return support.case(STACK, f"interfaces.lower_upper={law}")


def test_critical_friction_is_reported_only_beyond() -> None:
    def judged(friction: float) -> tuple[dict[str, float], list[Verdict]]:
        found = critical_friction_of_interfaces(support.assemble(stack(friction))[0])
        coefficients = {critical.interface: critical.smallest for critical in found}
        return coefficients, [warning for critical in found for warning in critical.warnings()]

    critical, warnings = judged(0.5)
    assert 1 < critical["lower_upper"] < 10 and not warnings
    again, (warning,) = judged(1.01 * critical["lower_upper"])
    assert again == pytest.approx(critical)
    assert "critical value at" in warning.what and "may not be unique" in warning.what
    assert warning.code is Reason.NOT_UNIQUE
    assert judged(0) == ({}, [])


def test_critical_friction_is_compared_with_the_friction_of_zones() -> None:
    """A zone that covers the interface has its own coefficient."""

    def found(friction: float, of_zone: float) -> list[CriticalFriction]:
        zone = f"{{all: {{above: 0 mm, friction_coefficient: {of_zone}}}}}"
        law = f"{{kind: contact, friction_coefficient: {friction}, zones: {zone}}}"
        case = support.case(STACK, f"interfaces.lower_upper={law}")
        return critical_friction_of_interfaces(support.assemble(case)[0])

    (below,) = found(100.0, 0.1)
    assert below.points_beyond == 0 and not below.warnings()
    (beyond,) = found(0.1, 100.0)
    assert beyond.points_beyond > 0 and "coefficient 100 exceeds" in beyond.warnings()[0].what
    assert found(100.0, 0.0) == []


def test_critical_friction_uses_the_jump_block() -> None:
    """A unit jump of one component causes the forces of its column."""
    problem, solver = support.assemble(stack(0.5))
    j = problem.contact
    u, q = solver.u_and_q(solver.x.duplicate())
    u.set(0)
    blocks = j.coupling.jump_stiffness()
    for k, c in ((0, 0), (3, 2), (len(blocks) - 1, 1)):
        q.set(0)
        q.array[3 * k + c] = 1
        forces = j.coupling.equilibrium(u, q, np.zeros(3 * len(blocks)))
        np.testing.assert_allclose(forces[k], blocks[k, :, c], rtol=1e-12)
