"""The closed forms of creep against their equations, integrated here by rates."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from app.verification import closed_forms as exact
from app.verification import closed_forms_long_term as creep

A = creep.CEMENT_CREEP[0]
P = creep.CEMENT_CREEP[1]
M0 = creep.CEMENT_CREEP[2]
M1 = creep.CEMENT_CREEP[3]


def test_closed_forms_creep_laws_have_published_values() -> None:
    """Values are by hand in the notes on clinical data, for 1e4, 2.5e5 and 1e6 cycles."""
    for s, values in ((3, (1.7, 5.4, 8.9)), (5, (3.6, 10.4, 16.5)), (7, (5.8, 16.0, 24.7))):
        strains = [
            1e4 * creep.creep_strain_at_constant_stress(creep.CEMENT_CREEP, s, N)
            for N in (1e4, 2.5e5, 1e6)
        ]
        assert strains == pytest.approx(values, abs=0.06)


@pytest.mark.parametrize("law", [creep.CEMENT_CREEP, creep.NORTON])
def test_closed_forms_creep_relaxation_of_a_held_bar(law: creep.Law) -> None:
    """The rate equation is ds/dN = -E de/dN. Norton's law also has a closed form."""
    a, p, m0, m1 = law
    s0, end = 10.0, 1e6 if law is creep.CEMENT_CREEP else 100.0

    def rate(_: float, y: list[float]) -> list[float]:
        s = s0 - creep.E * y[0]
        m = m0 + m1 * math.log10(s)
        return [m * (a * s**p) ** (1 / m) * y[0] ** (1 - 1 / m)]

    first = 1e-6
    start = [creep.creep_strain_at_constant_stress(law, s0, first)]
    e = solve_ivp(rate, (first, end), start, method="LSODA", rtol=1e-10, atol=1e-16).y[0, -1]
    assert creep.relaxed_stress(law, s0, end) == pytest.approx(s0 - creep.E * e, rel=1e-5)
    if law is creep.NORTON:
        closed = (s0**-3 + 3 * creep.E * a * end) ** (-1 / 3)
        assert creep.relaxed_stress(law, s0, end) == pytest.approx(closed, rel=1e-5)


def test_closed_forms_creep_shrink_fit_limits() -> None:
    rigid = (1e12, 0.3)
    at_once = exact.lame_pressure(0.01, 6, 10, rigid, (creep.E, 0.3))
    assert creep.shrink_fit(6, 10, 0.01, 0.3, 0.0) == pytest.approx(at_once, rel=1e-6)
    assert creep.shrink_fit(6, 10, 0.01, 0.3, 100.0) < 1e-10
    assert creep.shrink_fit(6, 10, 0.01, 0.3, 2.0) == pytest.approx(0.27350, abs=1e-5)


def test_closed_forms_creep_taper_subsides_as_rings_widen() -> None:
    """Rings of quadratic elements are in plane strain under 3 MPa. Their rates are integrated."""
    nodes = np.concatenate([np.linspace(6, 10, 41), np.linspace(10, 15, 21)[1:]])
    dofs = np.array([[k, k + 1, k + 2] for k in range(0, len(nodes) - 1, 2)]).repeat(2, axis=0)
    ξ = np.tile([-1, 1] / np.sqrt(3), len(dofs) // 2)
    x = nodes[dofs]
    half = (x[:, 2] - x[:, 0]) / 2
    N = np.stack([ξ * (ξ - 1) / 2, 1 - ξ**2, ξ * (ξ + 1) / 2], axis=1)
    dN = np.stack([ξ - 0.5, -2 * ξ, ξ + 0.5], axis=1) / half[:, None]
    r = (N * x).sum(axis=1)
    B = np.stack([dN, N / r[:, None], 0 * N], axis=1)
    modulus, cement = np.where(r < 10, creep.E, 17e3), r < 10
    shear = modulus / 2.6
    C = 1.5 * shear[:, None, None] * np.ones((3, 3)) + 2 * shear[:, None, None] * np.eye(3)
    work = (r * half)[:, None, None] * np.einsum("qki,qkl->qil", B, C)
    K = np.zeros((len(nodes), len(nodes)))
    np.add.at(K, (dofs[:, :, None], dofs[:, None, :]), work @ B)
    inverse = np.linalg.inv(K)

    def solved(crept: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        f = np.zeros(len(nodes))
        f[0] = 3.0 * 6
        strain = np.zeros((len(r), 3))
        strain[cement] = crept
        np.add.at(f, dofs, np.einsum("qil,ql->qi", work, strain))
        u = inverse @ f
        σ = np.einsum("qkl,ql->qk", C, np.einsum("qki,qi->qk", B, u[dofs]) - strain)[cement]
        return u, σ - σ.mean(axis=1, keepdims=True)

    def flow(s: np.ndarray, e: np.ndarray, N: float | None) -> np.ndarray:
        """Rate of equivalent strain and strains, or their values after N at this stress."""
        size = np.sqrt(1.5 * (s**2).sum(axis=1))
        m = M0 + M1 * np.log10(size)
        a = A * size**P
        de = a * N**m if N else m * a ** (1 / m) * e ** (1 - 1 / m)
        return np.concatenate([de, (1.5 * (de / size)[:, None] * s).ravel()])

    n = int(cement.sum())

    def by_log(y: float, state: np.ndarray) -> np.ndarray:
        _, s = solved(state[n:].reshape(-1, 3))
        return np.exp(y) * flow(s, state[:n], None)

    u0, s0 = solved(np.zeros((n, 3)))
    first, end = np.log(1e-4), np.log(1e7)
    start = flow(s0, np.zeros(n), 1e-4)
    state = solve_ivp(by_log, (first, end), start, method="LSODA", rtol=1e-7, atol=1e-12).y[:, -1]
    widened = solved(state[n:].reshape(-1, 3))[0][0] - u0[0]
    assert widened / math.tan(math.radians(1.5)) == pytest.approx(creep.SUBSIDENCE, rel=1e-4)
