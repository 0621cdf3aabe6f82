"""References of the verification suite, against other formulas and their equations.

Displacement fields are differentiated numerically, so no step of their derivation is used twice.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

from app.schema.expressions import values_at_points
from app.verification import closed_forms as exact
from tests.verification.differences import STEP, slope

CASES = Path(__file__).resolve().parents[2] / "configs" / "verification"
# Young's modulus [MPa] and Poisson's ratio.
CEMENT = (2200.0, 0.3)
STEM = (110e3, 0.3)

Field = Callable[[np.ndarray], np.ndarray]


def flamant(x: np.ndarray, load: float, material: exact.Elastic) -> np.ndarray:
    """Displacement (n, 3) of the half-plane z < 0 under a line load [N/mm] at 0 along -z [mm].

    Plane strain, zero of u_z at r = 1 mm below the load (Johnson, Contact Mechanics, section 2.2).
    """
    E, ν = material
    depth = -x[:, 2]
    r, θ = np.hypot(x[:, 0], depth), np.arctan2(x[:, 0], depth)
    k = load * (1 + ν) / (math.pi * E)
    u_r = -2 * k * (1 - ν) * np.cos(θ) * np.log(r) - k * (1 - 2 * ν) * θ * np.sin(θ)
    u_θ = 2 * k * (1 - ν) * np.sin(θ) * np.log(r) - k * (1 - 2 * ν) * θ * np.cos(θ) + k * np.sin(θ)
    down = u_r * np.cos(θ) - u_θ * np.sin(θ)
    across = u_r * np.sin(θ) + u_θ * np.cos(θ)
    return np.column_stack([across, 0 * r, -down])


def boussinesq(x: np.ndarray, load: float, material: exact.Elastic) -> np.ndarray:
    """Displacement (n, 3) of the half-space z < 0 under a force [N] at 0 along -z [mm].

    Johnson, Contact Mechanics, section 3.2.
    """
    E, ν = material
    depth = -x[:, 2]
    ρ = np.linalg.norm(x, axis=1)
    k = load * (1 + ν) / (2 * math.pi * E)
    side = k * (depth / ρ**3 - (1 - 2 * ν) / (ρ * (ρ + depth)))
    down = k * (depth**2 / ρ**3 + 2 * (1 - ν) / ρ)
    return np.column_stack([side * x[:, 0], side * x[:, 1], -down])


def strain(u: Field, x: np.ndarray) -> np.ndarray:
    """Strain (n, 3, 3) of a displacement at points (n, 3)."""
    gradient = np.stack([slope(lambda s, e=e: u(x + s * e), 0.0) for e in np.eye(3)], axis=2)
    return np.asarray(gradient + gradient.transpose(0, 2, 1)) / 2


def stress(u: Field, material: tuple[float, float]) -> Field:
    λ, μ = exact.lame(material)

    def σ(x: np.ndarray) -> np.ndarray:
        ε = strain(u, x)
        trace = np.trace(ε, axis1=1, axis2=2)
        return λ * trace[:, None, None] * np.eye(3) + 2 * μ * ε

    return σ


def divergence(σ: Field, x: np.ndarray) -> np.ndarray:
    slopes = [slope(lambda s, e=e: σ(x + s * e), 0.0, 10 * STEP) for e in np.eye(3)]
    return sum(d[:, :, k] for k, d in enumerate(slopes))


def support(case: str, name: str) -> Field:
    """The displacement that a case prescribes, as a field."""
    entry = YAML(typ="safe").load(CASES / case)["supports"][name]

    def u(x: np.ndarray) -> np.ndarray:
        return np.column_stack(
            [values_at_points(entry[axis], x) if axis in entry else 0 * x[:, 0] for axis in "xyz"]
        )

    return u


def points(n: int, low: tuple[float, ...], high: tuple[float, ...]) -> np.ndarray:
    return np.random.default_rng(1).uniform(low, high, (n, 3))


def test_closed_forms_compliance_of_a_fibrous_material() -> None:
    bone = exact.Fibrous(17000, 11500, 0.31, 0.51, 3280)
    σ = np.diag([0, 0, 10.0])
    ε = np.diag([-0.31, -0.31, 1]) * 10 / 17000
    np.testing.assert_allclose(bone.stress(ε, (0, 0, 1)), σ, atol=1e-11)
    # Eigenvalues of the stiffness: physics reference E6.
    np.testing.assert_allclose(
        np.linalg.eigvalsh(np.linalg.inv(bone.compliance())),
        [3280, 3280, 3807.9, 7615.9, 12861.9, 42224.1],
        atol=0.06,
    )
    # An axial test along any fibre.
    m = np.array([1, 1, 1]) / np.sqrt(3)
    M = np.outer(m, m)
    ε = 10 / 17000 * (M - 0.31 * (np.eye(3) - M))
    np.testing.assert_allclose(bone.stress(ε, (1, 1, 1)), 10 * M, atol=1e-11)


@pytest.mark.parametrize(
    ("u", "case"), [(flamant, "hertz_line.yaml"), (boussinesq, "hertz_ball.yaml")]
)
def test_closed_forms_far_fields_of_a_half_space(u: Callable, case: str) -> None:
    """The fields have equilibrium, no traction on z = 0, and the load below.

    The case prescribes the same field.
    """

    def field(x: np.ndarray) -> np.ndarray:
        return u(x, 100.0, CEMENT)

    plane = u is flamant
    σ = stress(field, CEMENT)
    x = points(9, (0.5, 0 if plane else 0.5, -3), (3, 0 if plane else 3, -1))
    assert np.abs(divergence(σ, x)).max() < 1e-5
    surface = np.array([[1.0, 0 if plane else 0.5, 0], [-2.0, 0, 0]])
    surface[:, 2] = -1e-2  # differences need room: what is left vanishes with the depth
    at_depth = np.abs(σ(surface)[:, :, 2]).max()
    surface[:, 2] = -5e-3
    assert np.abs(σ(surface)[:, :, 2]).max() < 0.51 * at_depth < 0.3
    # The force through z = -1, by the midpoint rule on a stretched grid.
    s = (np.arange(200) + 0.5) / 200 * math.pi - math.pi / 2
    t, w = np.tan(s), math.pi / 200 / np.cos(s) ** 2
    if plane:
        y = np.column_stack([t, 0 * t, 0 * t - 1])
        force = (σ(y)[:, 2, 2] * w).sum()
    else:
        r = np.abs(t)
        y = np.column_stack([r, 0 * r, 0 * r - 1])
        force = (σ(y)[:, 2, 2] * w * math.pi * r).sum()
    assert force == pytest.approx(-100, rel=1e-3)
    np.testing.assert_allclose(support(case, "far")(x), field(x), atol=1e-7 * 0.05)


def test_closed_forms_foundation_bar() -> None:
    """Physics reference 5.5 gives the values, and the work of the end in a cycle."""
    bar = exact.FoundationBar(500, 6, 1.1e6)
    assert (bar.end, bar.residual, bar.cycle) == pytest.approx(
        (0.01893939, 0.00946970, 1.578283), rel=1e-6
    )
    force = np.linspace(0, 500, 4001)
    unloading = bar.end - (500 - force) ** 2 / (4 * 1.1e6 * 6)
    loading = bar.residual + force**2 / (4 * 1.1e6 * 6)
    assert np.trapezoid(unloading - loading, force) == pytest.approx(bar.cycle, rel=1e-6)


PRESS_FITS = [(0.01, 7.0, 7.0 + t, STEM, CEMENT) for t in (2, 3, 4, 5, 7)]
MODULUS = exact.contact_modulus(CEMENT)
LINE = exact.hertz_line(100, 10, MODULUS)
BALL = exact.hertz_point(100, 10, MODULUS)
PENALTIES = {1e2: 6.875e-3, 1e3: 1.803e-3, 1e4: 2.153e-4, 1e5: 2.195e-5, 1e6: 2.2e-6, 1e8: 2.2e-8}


@pytest.mark.parametrize(
    ("values", "reference", "rel"),
    [
        # Physics reference 5.2: titanium in 2 to 7 mm of cement.
        (
            [exact.lame_pressure(*fit) for fit in PRESS_FITS],
            [0.76706, 1.02740, 1.23297, 1.39736, 1.63941],
            7e-6,
        ),
        (
            [exact.lame_pressure_free(*fit) for fit in PRESS_FITS],
            [0.71812, 0.97135, 1.17485, 1.33991, 1.58677],
            7e-6,
        ),
        # Physics reference 5.3.
        ([MODULUS, LINE.a, LINE.p0], [2417.582, 0.725712, 87.7235], 1e-6),
        ([BALL.a, BALL.p0, BALL.approach], [0.676955, 104.1889, 0.0458268], 2e-6),
        ([exact.stick_half_width(1.0, 0.5 * 0.3 * 50, 50, 0.3)], [math.sqrt(0.5)], 1e-12),
        ([exact.push_up(0.1, 0.3)], [0.412371], 2e-6),
        # Physics reference 5.7; all states: `soundness/test_critical_friction.py`.
        ([exact.particle_friction(1, w) for w in (0.8, -0.8)], [1.25, 1.25], 1e-14),
        (
            [exact.penalty_penetration(220, 0.01, r) for r in PENALTIES],
            list(PENALTIES.values()),
            3e-4,
        ),
    ],
    ids="Lamé,free ends,line,ball,Cattaneo,incline,Klarbring,penalty".split(","),
)
def test_closed_forms_reference_values(
    values: list[float], reference: list[float], rel: float
) -> None:
    assert values == pytest.approx(reference, rel=rel)


def test_closed_forms_cantilever_bar_has_known_limits() -> None:
    """Torsion is that of a square and a strip (Timoshenko and Goodier, section 109).

    Bending is by hand.
    """
    square, strip = exact.CantileverBar(1.0, 2.0, 2.0, 10.0), exact.CantileverBar(1.0, 100, 1, 10)
    assert square.torsion_constant() == pytest.approx(0.1406 * 2**4, rel=1e-3)
    assert strip.torsion_constant() == pytest.approx(100 / 3, rel=1e-2)
    # A force across the end: F L^3 / 3 E I and 6/5 F L / (G A); M / W = F L / (b h^2 / 6)
    across = (3.0, 0.0, 0.0)
    shear = 1.2 * 3.0 * 10 / (0.5 * 4)
    assert square.deflection(across, (0, 0, 0)) == pytest.approx(3 * 10**3 / (16 / 4) + shear)
    assert square.largest_stress(across, (0, 0, 0), 0.0) == pytest.approx(3 * 10 / (8 / 6))


def test_closed_forms_press_out_moves_the_inner_surface_by_a_change_of_shear() -> None:
    """Finite differences solve the radial equation of a ring in plane stress."""
    r, R, ν, n = 7.0, 17.0, 0.3, 1001
    x = np.linspace(r, R, n)
    h = x[1] - x[0]
    # E u'' + E u'/x - E u/x² + (1 - ν²) f = 0 with f = E / r at the inner surface.
    force = r / (R * R - r * r) * (R * R / x - x) / r
    rows = np.zeros((n, n))
    i = np.arange(1, n - 1)
    rows[i, i - 1] = 1 / h**2 - 1 / (2 * h * x[i])
    rows[i, i] = -2 / h**2 - 1 / x[i] ** 2
    rows[i, i + 1] = 1 / h**2 + 1 / (2 * h * x[i])
    rows[0, :3] = np.array([-3, 4, -1]) / (2 * h)
    rows[-1, -3:] = np.array([1, -4, 3]) / (2 * h)
    rows[0, 0] += ν / r
    rows[-1, -1] += ν / R
    right = -(1 - ν * ν) * force
    right[[0, -1]] = 0.0
    u = np.linalg.solve(rows, right)
    assert exact._under_changing_shear(r, R, ν) == pytest.approx(u[0], rel=1e-4)


def test_closed_forms_press_out_needs_no_more_force_than_lame_without_poissons_effect() -> None:
    assert exact.press_out_factor(0.5, 7.0, 17.0, 40.0, 1e-9) == pytest.approx(1.0, abs=1e-6)
