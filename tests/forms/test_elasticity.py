"""Elasticity: the stiffness of the corrected eq. 48-50 is the inverse of the compliance.

UFL derives the stiffness from the strain energy, and dolfinx evaluates it on a cell. The compliance
follows from its definition, and numpy inverts it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from hypothesis import given
from hypothesis import strategies as st
from ufl.algorithms import expand_derivatives, strip_variables
from ufl.core.expr import Expr

from app.foundation.arrays import Floats
from app.numerics.pointwise import Pointwise
from app.verification.closed_forms import Fibrous
from forms import elasticity
from tests.cases.laws import compliance

Stiffness = Callable[[Sequence[float], Sequence[float]], Floats]

FIBRES = [
    pytest.param((0.0, 0.0, 1.0), id="z"),
    pytest.param((1.0, 0.0, 0.0), id="x"),
    pytest.param(tuple(np.ones(3) / np.sqrt(3)), id="diagonal"),
]
# E_l, E_t, ν_l, ν_t, μ_l of the example of errata E6.
BONE = (17000.0, 11500.0, 0.31, 0.51, 3280.0)
# Components of a symmetric tensor in Mandel's notation, in which rotations are orthogonal.
PAIRS = [(0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)]
ROOT_2 = np.array([1, 1, 1, np.sqrt(2), np.sqrt(2), np.sqrt(2)])


def compile_stiffness(coefficients: Callable[..., tuple]) -> Stiffness:
    """Function (constants, fibre) -> stiffness (3, 3, 3, 3), compiled once for all constants."""
    names = ("E_l", "E_t", "ν_l", "ν_t", "μ_l")

    def build(x: dict[str, Expr]) -> list[Expr]:
        ε = ufl.variable(ufl.as_matrix([[x["ε"][3 * i + j] for j in range(3)] for i in range(3)]))
        constants = coefficients(*(x[n] for n in names))
        ψ = elasticity.transversely_isotropic_energy(ufl.sym(ε), x["m"], *constants)
        return [strip_variables(expand_derivatives(ufl.diff(ufl.diff(ψ, ε), ε)))]

    law = Pointwise(MPI.COMM_SELF, 1, dict.fromkeys(names, 1) | {"m": 3, "ε": 9}, build)

    def stiffness(values: Sequence[float], fibre: Sequence[float]) -> Floats:
        constants = {n: np.array([v]) for n, v in zip(names, values, strict=True)}
        return law(m=np.array([fibre]), **constants)[0][0]

    return stiffness


@pytest.fixture(scope="module")
def stiffness() -> Stiffness:
    return compile_stiffness(elasticity.transversely_isotropic_coefficients)


def tensor(C: Floats) -> Floats:
    """Fourth-order tensor from Mandel's notation."""
    T = np.zeros((3, 3, 3, 3))
    for a, (i, j) in enumerate(PAIRS):
        for b, (k, l) in enumerate(PAIRS):  # noqa: E741
            value = C[a, b] / (ROOT_2[a] * ROOT_2[b])
            for p, q in ((i, j), (j, i)):
                for r, s in ((k, l), (l, k)):
                    T[p, q, r, s] = value
    return T


def mandel(T: Floats) -> Floats:
    """Mandel's notation of a fourth-order tensor."""
    rows = [[T[i, j, k, l] for k, l in PAIRS] for i, j in PAIRS]  # noqa: E741
    return np.array(rows) * np.outer(ROOT_2, ROOT_2)


def rotation(fibre: Sequence[float]) -> Floats:
    """An orthogonal matrix whose third column is the fibre."""
    m = np.asarray(fibre)
    a = np.cross(m, np.eye(3)[np.argmin(np.abs(m))])
    a /= np.linalg.norm(a)
    return np.column_stack([np.cross(a, m), a, m])


def expected(values: Sequence[float], fibre: Sequence[float]) -> Floats:
    Q = rotation(fibre)
    C = tensor(np.linalg.inv(compliance(*values)))
    return np.einsum("ia,jb,kc,ld,abcd->ijkl", Q, Q, Q, Q, C)


def error(actual: Floats, values: Sequence[float], fibre: Sequence[float]) -> float:
    exact = expected(values, fibre)
    return float(np.abs(actual - exact).max() / np.abs(exact).max())


@st.composite
def admissible(draw: st.DrawFn) -> tuple[float, float, float, float, float]:
    """Random constants with 1 - ν_t - 2 ν_l² E_t/E_l > 0, at a distance from the limits."""
    E_l = 10 ** draw(st.floats(2, 5))
    E_t = E_l * 10 ** draw(st.floats(-1.5, 1.0))
    ν_t = draw(st.floats(-0.9, 0.9))
    share = draw(st.floats(-0.97, 0.97))
    μ_l = E_l * 10 ** draw(st.floats(-1.5, 0.5))
    return E_l, E_t, share * np.sqrt((1 - ν_t) * E_l / (2 * E_t)), ν_t, μ_l


@pytest.mark.parametrize("fibre", FIBRES)
@given(values=admissible())
def test_elasticity_stiffness_is_inverse_compliance(
    stiffness: Stiffness, fibre: tuple[float, ...], values: tuple[float, ...]
) -> None:
    C = stiffness(values, fibre)
    assert error(C, values, fibre) < 1e-10
    assert np.linalg.eigvalsh(mandel(C)).min() > 0


def test_elasticity_coefficients_of_the_errata() -> None:
    """Coefficients e1..e5 agree with errata E6 to its digits."""
    e = elasticity.transversely_isotropic_coefficients(*BONE)
    np.testing.assert_allclose(e, [12165.1, 7615.9, -2261.8, -1055.9, 9994.4], atol=0.051)


def printed_coefficients(E_l, E_t, ν_l, ν_t, μ_l):  # type: ignore[no-untyped-def]
    """Eq. 50 as printed: ν_t² for ν_l² in e1, e3, e5, and E_t/E_l for E_l/E_t in e5."""
    Δ = (1 - ν_t - 2 * ν_l**2 * E_t / E_l) * (1 + ν_t)
    a = ν_t**2 * E_t / E_l
    e1 = (ν_t + a) * E_t / Δ
    e2 = E_t / (1 + ν_t)
    e3 = (ν_l - ν_t + ν_l * ν_t - a) * E_t / Δ
    e4 = 2 * μ_l - E_t / (1 + ν_t)
    e5 = -4 * μ_l + (1 - 2 * ν_l - 2 * ν_l * ν_t - a + (1 - ν_t**2) * E_t / E_l) * E_t / Δ
    return e1, e2, e3, e4, e5


def test_elasticity_printed_coefficients_fail() -> None:
    """The misprints change the modulus along the fibre from 17000 to 542 MPa."""
    printed = compile_stiffness(printed_coefficients)
    z = (0.0, 0.0, 1.0)
    C = printed(BONE, z)
    assert 1 / np.linalg.inv(mandel(C))[2, 2] == pytest.approx(542, abs=0.5)
    assert error(C, BONE, z) > 0.1
    # The second example of E6 is indefinite.
    second = mandel(printed((17000.0, 11500.0, 0.46, 0.42, 3300.0), z))
    assert np.linalg.eigvalsh(second).min() == pytest.approx(-324, abs=1)


def test_elasticity_isotropic_limit() -> None:
    """Equal E_l and E_t, one Poisson's ratio and μ_l = E/2(1+ν) make the fibre terms vanish."""
    E, ν = 2200.0, 0.3
    e = elasticity.transversely_isotropic_coefficients(E, E, ν, ν, E / (2 * (1 + ν)))
    e1, e2 = elasticity.isotropic_coefficients(E, ν)
    np.testing.assert_allclose(e, [e1, e2, 0, 0, 0], atol=1e-9)


@pytest.mark.parametrize("fibre", [(1, 0, 0), (0, 0.6, 0.8), (1 / 3, 2 / 3, -2 / 3)])
def test_elasticity_stress_is_the_derivative_of_energy(fibre: tuple[float, ...]) -> None:
    """Eq. 49 with its corrected sign: stretching gives tension, and eigenstrains are subtracted.

    The stress of a fibrous material is the inverse of the compliance times a strain with all
    shears.
    """
    constants = elasticity.transversely_isotropic_coefficients(17.0, 11.5, 0.31, 0.51, 3.28)

    def build(x: dict[str, Expr]) -> list[Expr]:
        free = elasticity.symmetric([x["ε"][i] for i in range(6)])
        return [
            elasticity.stress(lambda e: elasticity.isotropic_energy(e, 3.0, 2.0), free),
            elasticity.stress(
                lambda e: elasticity.transversely_isotropic_energy(e, x["m"], *constants), free
            ),
        ]

    law = Pointwise(MPI.COMM_SELF, 1, {"ε": 6, "m": 3}, build)
    isotropic, fibrous = law(ε=np.arange(1.0, 7.0)[None], m=np.array([fibre], dtype=float))
    ε = np.array([[1.0, 6, 5], [6, 2, 4], [5, 4, 3]])
    np.testing.assert_allclose(isotropic[0], 3 * 6 * np.eye(3) + 2 * ε, rtol=1e-12)
    exact = Fibrous(17.0, 11.5, 0.31, 0.51, 3.28).stress(ε, fibre)
    np.testing.assert_allclose(fibrous[0], exact, rtol=1e-11, atol=1e-11)
