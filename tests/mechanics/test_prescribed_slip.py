"""The contact force along prescribed jumps, for Coulomb's law of one face written in numpy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from app.foundation.arrays import Floats
from app.mechanics.prescribed_slip import Inputs, Outputs, PrescribedSlip, respond

NORMAL = np.array([0.0, 0.0, 1.0])
ALONG_X = np.diag([1.0, 0.0, 0.0])


@dataclass(frozen=True)
class Coulomb:
    """Contact with friction at points with the normal z; μ: (n,) or a number."""

    μ: Floats | float

    def __call__(self, inputs: Inputs) -> Outputs:
        F, r = inputs["multiplier"], inputs["r"][:, None]
        S = F + r * (inputs["jump"] + inputs["initial_gap"])
        T = F + r * (inputs["jump"] - inputs["jump_old"])
        T = T * [1.0, 1.0, 0.0]
        pressure, size = np.maximum(-S[:, 2], 0), np.linalg.norm(T, axis=1)
        limit = self.μ * pressure
        sticks = size <= limit
        ratio = np.where(sticks, 1.0, limit / np.where(sticks, 1.0, size))
        t = T / np.where(size > 0, size, 1.0)[:, None]
        slips = ~sticks & (pressure > 0)
        by_force = ratio[:, None, None] * np.diag([1.0, 1.0, 0.0])
        across = np.einsum("p,pi,pj->pij", np.where(slips, ratio, 0.0), t, t)
        by_pressure = np.einsum("p,pi,j->pij", np.where(slips, self.μ, 0.0), t, -NORMAL)
        normal = (pressure > 0)[:, None, None] * np.outer(NORMAL, NORMAL)
        return {
            "force": ratio[:, None] * T - pressure[:, None] * NORMAL,
            "by_multiplier": normal + by_force - across + by_pressure,
        }


def inputs_of(force: Floats, jump: Floats, r: Floats) -> dict[str, Floats]:
    """Inputs of a law for a first step from rest."""
    none = np.zeros_like(force)
    return {"multiplier": force, "jump": jump, "jump_old": none, "initial_gap": none, "r": r}


def tensors(matrix: Floats, n: int) -> Floats:
    return np.tile(matrix, (n, 1, 1))


@pytest.mark.parametrize("directions", [1, 2])
def test_prescribed_slip_has_coulomb_friction(directions: int) -> None:
    """The force along the slip is x = R (x + a) / |(x + a, b)|.

    Slips go from far below rounding to far above the friction limit. R is the limit of friction, a
    the trial force of the slip, b the force across it. At rest, below a tolerance, the friction is
    that of the last state, here zero, plus at most a.
    """
    n, rng = 500, np.random.default_rng(5)
    μ, r = rng.uniform(0.05, 1.5, n), 10 ** rng.uniform(0, 4, n)
    pressure = 10 ** rng.uniform(-3, 3, n)
    R = μ * pressure
    a = R * 10 ** rng.uniform(-18, 3, n)
    near_the_limit = 1 + rng.choice([-1, 1], n) * 10 ** rng.uniform(-15, 0, n)
    b = R * np.where(rng.random(n) < 0.5, near_the_limit, 10 ** rng.uniform(-6, 2, n))
    angle = rng.uniform(0, 2 * np.pi, n)
    if directions == 1:
        angle = np.round(angle / np.pi) * np.pi
    else:
        b = 0.0 * b
    towards = np.column_stack([np.cos(angle), np.sin(angle) * (directions == 2), 0 * angle])
    F = np.column_stack([0 * b, b, -pressure])
    H = tensors(np.diag([1.0, float(directions == 2), 0.0]), n)
    inputs = inputs_of(F, (a / r)[:, None] * towards, r)
    out = respond(Coulomb(μ), inputs, H, tensors(np.eye(3), n), np.zeros((n, 3)))
    assert np.isfinite(out["by_multiplier"]).all()
    scale = np.linalg.norm(F, axis=1) + a
    x = np.einsum("pi,pi->p", out["force"], towards)
    slides = a > 1e-11 * scale
    assert slides.any() and not slides.all()
    assert (np.abs(x) <= 1.001 * a)[~slides].all()
    expected = R * (x + a) / np.hypot(x + a, b)
    assert (x[slides] > 0).all()
    assert (np.abs(x - expected)[slides] < 3e-12 * scale[slides]).all()


@pytest.mark.parametrize("μ", [999.0, 1e3, 5e3, 1e6, 1e9])
def test_prescribed_slip_has_a_bound_for_any_coefficient(μ: float) -> None:
    """Friction along a prescribed slip is μ times the pressure, however large μ is."""
    pressure = np.array([1e-3, 1.0, 50.0])
    F = np.column_stack([0 * pressure, 0 * pressure, -pressure])
    jump = np.column_stack([0.1 * pressure, 0 * pressure, 0 * pressure])
    inputs = inputs_of(F, jump, np.ones(3))
    H, M, last = tensors(ALONG_X, 3), tensors(np.eye(3), 3), np.zeros((3, 3))
    out = respond(Coulomb(μ), inputs, H, M, last, μ)
    np.testing.assert_allclose(out["force"][:, 0], μ * pressure, rtol=1e-12)


def test_prescribed_slip_at_rest_has_the_last_friction() -> None:
    """At a point that sticks, the force is that of the last state along the prescribed jump.

    The other component follows from the multiplier. A layer passes on its share M of both.
    """
    F = np.array([[0.0, 0.5, -10.0], [0.0, -0.25, -10.0]])
    last = np.array([[1.5, 9.0, 0.0], [-2.0, 9.0, 0.0]])
    M = tensors(np.diag([0.8, 0.8, 1.0]), 2)
    inputs = inputs_of(F, np.zeros((2, 3)), np.full(2, 100.0))
    out = respond(Coulomb(0.4), inputs, tensors(ALONG_X, 2), M, last)
    np.testing.assert_allclose(out["force"], [[1.2, 0.5, -10.0], [-1.6, -0.25, -10.0]], rtol=1e-14)
    np.testing.assert_array_equal(out["by_multiplier"], tensors(np.eye(3), 2))


def test_prescribed_slip_derivative_contains_the_change_of_the_force_along_it() -> None:
    """Central differences of the whole response, with and without a layer (M < 1)."""
    n, rng = 200, np.random.default_rng(2)
    F = np.column_stack([np.zeros(n), rng.normal(size=n), -rng.uniform(1, 5, n)])
    jump = np.column_stack([rng.normal(size=n), 0.1 * rng.normal(size=n), np.zeros(n)])
    H, r, last = tensors(ALONG_X, n), np.full(n, 3.0), np.zeros((n, 3))
    for share in (1.0, 0.6):
        M = tensors(np.diag([share, share, 1.0]), n)

        def response(force: Floats, M: Floats = M) -> Outputs:
            return respond(Coulomb(0.5), inputs_of(force, jump, r), H, M, last)

        step = 1e-6 * rng.normal(size=(n, 3))
        change = (response(F + step)["force"] - response(F - step)["force"]) / 2
        linear = np.einsum("pij,pj->pi", response(F)["by_multiplier"], step)
        assert np.abs(linear).max() > 1e-7
        # Some points stick at one end of a difference and slip at the other.
        assert np.quantile(np.abs(change - linear).max(axis=1), 0.97) < 1e-10


def test_prescribed_slip_calls_the_law_once_without_prescribed_directions() -> None:
    calls: list[Inputs] = []

    def law(inputs: Inputs) -> Outputs:
        calls.append(inputs)
        return {"force": inputs["multiplier"]}

    inputs = inputs_of(np.ones((2, 3)), np.ones((2, 3)), np.ones(2))
    none = np.zeros((2, 3, 3))
    out = respond(law, inputs, none, tensors(np.eye(3), 2), np.ones((2, 3)))
    assert calls == [inputs]
    assert out == {"force": inputs["multiplier"]}


def test_prescribed_slip_leaves_a_traction_that_depends_on_the_jump() -> None:
    """A law of springs needs no force along the jump: its force is K q."""

    def springs(inputs: Inputs) -> Outputs:
        K = tensors(20.0 * np.eye(3), 2)
        return {"force": 20.0 * inputs["jump"], "by_jump": K}

    jump = np.array([[0.1, 0.0, 0.0], [0.0, 0.2, 0.3]])
    inputs = inputs_of(np.ones((2, 3)), jump, np.ones(2))
    out = respond(springs, inputs, tensors(ALONG_X, 2), tensors(np.eye(3), 2), np.ones((2, 3)))
    np.testing.assert_allclose(out["force"], [[2.0, 0.0, 0.0], [0.0, 4.0, 6.0]])
    assert set(out) == {"force", "by_jump"}


def test_prescribed_slip_below_rounding_is_rest() -> None:
    """Slips of 1e-14 of the jump, and of 1e-12 of the trial force, are errors of rounding."""
    jump = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1e-12, 0.0, 0.0], [1e-9, 0.0, 0.0]])
    old = jump.copy()
    old[0, 0] -= 1e-14
    old[1, 0] -= 0.5
    old[2:] = 0.0
    force = np.array([[0.0, 0.0, -1.0]] * 4)
    inputs = inputs_of(force, jump, np.ones(4)) | {"jump_old": old}
    slip = PrescribedSlip.of(inputs, tensors(ALONG_X, 4), np.array([[3.0, 4.0, 5.0]] * 4))
    assert slip.is_sliding.tolist() == [False, True, False, True]
    np.testing.assert_allclose(slip.direction[[1, 3]], [[1, 0, 0]] * 2)
    np.testing.assert_allclose(slip.last_friction, [[3, 0, 0]] * 4)
    np.testing.assert_allclose(slip.scale, [2, 2, 1, 1], rtol=1e-8)
