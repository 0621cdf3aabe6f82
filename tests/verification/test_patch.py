r"""Patch tests: interfaces that carry a homogeneous stress exactly, on any mesh.

The strong form is div σ = 0 in each block, with contact and friction between them. The exact
solutions are affine in each block, so every mesh and every order has to give them to rounding.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from forms.contact import SLIP, STICK
from tests import support

TOLERANCE = 1e-9
STIFFNESS_RATIOS = [1.0, 50.0, 1000.0]

PRESSURE = 2.0
ν = 0.3

# Three blocks in a smooth box: σ_zz = -p, σ_xx = σ_yy = ν/(1-ν) σ_zz, in each block
# u = (0, 0, -p z/M + const) with M = E (1-ν)/((1+ν)(1-2ν)).
BOX = """
geometry: {{kind: blocks, blocks: [{{name: lower, size: [10 mm, 8 mm, 4 mm]}},
                                   {{name: middle, size: [10 mm, 8 mm, 3 mm]}},
                                   {{name: upper, size: [10 mm, 8 mm, 5 mm]}}]}}
mesh: {{size: 2.5 mm, far_size: 2.5 mm, order: {order}}}
regions:
  lower: {{youngs_modulus: {stiff} MPa, poisson_ratio: 0.3}}
  middle: {{youngs_modulus: 100 MPa, poisson_ratio: 0.3}}
  upper: {{youngs_modulus: {stiff} MPa, poisson_ratio: 0.3}}
interfaces:
  lower_middle: {{kind: contact, friction_coefficient: 0.4}}
  middle_upper: {{kind: contact, friction_coefficient: {friction}}}
supports:
  floor: {{kind: roller, boundary: bottom, axis: z}}
  left: {{kind: roller, boundary: x_min, axis: x}}
  right: {{kind: roller, boundary: x_max, axis: x}}
  front: {{kind: roller, boundary: y_min, axis: y}}
  back: {{kind: roller, boundary: y_max, axis: y}}
loads:
  press: {{kind: pressure, boundary: top, pressure: 2 MPa}}
solver: {{tolerance: 1.0e-13}}
"""


def confined(E: float) -> float:
    return E * (1 - ν) / ((1 + ν) * (1 - 2 * ν))


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("ratio", STIFFNESS_RATIOS)
def test_patch_blocks_in_a_frictionless_box(ratio: float, order: int) -> None:
    result = support.solve(BOX.format(order=order, stiff=100 * ratio, friction=0))
    moduli = {"lower": 100 * ratio, "middle": 100.0, "upper": 100 * ratio}
    floors = {"lower": 0.0, "middle": 4.0, "upper": 7.0}
    start = 0.0
    for (name, E), height in zip(moduli.items(), (4, 3, 5), strict=True):
        x, u = result.displacement(name)
        exact = np.zeros_like(u)
        exact[:, 2] = start - PRESSURE / confined(E) * (x[:, 2] - floors[name])
        start -= PRESSURE / confined(E) * height
        assert np.abs(u - exact).max() < TOLERANCE * PRESSURE * 12 / confined(100.0), name
        σ = -PRESSURE * np.diag([ν / (1 - ν), ν / (1 - ν), 1.0])
        assert np.abs(result.stress(name) - σ).max() < TOLERANCE * PRESSURE, name
    s = result.last
    assert np.abs(s.pressure - PRESSURE).max() < TOLERANCE * PRESSURE
    assert np.abs(s.gap).max() < TOLERANCE * 1e-3
    assert np.abs(s.shear).max() < TOLERANCE * PRESSURE
    assert (s.status[s.interface == 0] == STICK).all()
    # Without friction there is nothing to stick with.
    assert (s.status[s.interface == 1] == SLIP).all()
    for q in result.interfaces.values():
        assert q["area"] == pytest.approx(80.0)
        assert q["open_fraction"] == 0


# Two blocks with a tilted interface, plane strain, free sideways: σ_zz = -p, σ_xx = 0. The strain
# along the interface, ε_zz sin² + ε_xx cos² with ε_xx = -ν/(1-ν) ε_zz, vanishes for ν = sin² of the
# tilt, so that blocks of any stiffness fit without slip; the upper one turns rigidly about y by the
# difference of the shear strains. The interface carries p cos² of pressure, p sin cos of shear.
TILT = 20.0
TILTED = """
geometry: {{kind: blocks, tilt: {tilt} deg, blocks: [{{name: lower, size: [8 mm, 5 mm, 6 mm]}},
                                                     {{name: upper, size: [8 mm, 5 mm, 6 mm]}}]}}
mesh: {{size: 2 mm, far_size: 3 mm, order: {order}}}
regions:
  lower: {{youngs_modulus: {stiff} MPa, poisson_ratio: {ratio}}}
  upper: {{youngs_modulus: 100 MPa, poisson_ratio: {ratio}}}
interfaces:
  lower_upper: {{kind: contact, friction_coefficient: {friction}}}
supports:
  floor: {{kind: roller, boundary: bottom, axis: z}}
  left: {{kind: roller, boundary: lower_x_min, axis: x}}
  front: {{kind: roller, boundary: y_min, axis: y}}
  back: {{kind: roller, boundary: y_max, axis: y}}
loads:
  press: {{kind: pressure, boundary: top, pressure: 2 MPa}}
solver: {{tolerance: 1.0e-13}}
"""


def tilted(order: int, ratio: float, friction: float) -> dict[str, Any]:
    θ = np.deg2rad(TILT)
    return {
        "order": order,
        "stiff": 100 * ratio,
        "tilt": TILT,
        "ratio": f"{np.sin(θ) ** 2:.17g}",
        "friction": friction,
    }


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("ratio", STIFFNESS_RATIOS)
def test_patch_tilted_interface_within_the_friction_cone(ratio: float, order: int) -> None:
    θ = np.deg2rad(TILT)
    result = support.solve(TILTED.format(**tilted(order, ratio, 1.2 * np.tan(θ))))
    ν = np.sin(θ) ** 2
    σ = np.diag([0, -ν, -1.0]) * PRESSURE

    def gradient(E: float) -> support.Floats:
        return ((1 + ν) * σ - ν * np.trace(σ) * np.eye(3)) / E

    for name in ("lower", "upper"):
        assert np.abs(result.stress(name) - σ).max() < TOLERANCE * PRESSURE, name
    G, H = gradient(100 * ratio), gradient(100.0)
    t = np.array([np.cos(θ), 0, np.sin(θ)])
    n = np.array([-np.sin(θ), 0, np.cos(θ)])
    # The upper block turns so that its gradient along the interface is the lower one's.
    assert t @ (G - H) @ t == pytest.approx(0, abs=1e-15)
    turn = n @ (G - H) @ t
    H = H + turn * (np.outer(n, t) - np.outer(t, n))
    centre = np.array([4.0, 0, 6.0])
    for name, gradient_ in (("lower", G), ("upper", H)):
        x, u = result.displacement(name)
        exact = G @ centre + (x - centre) @ gradient_.T
        assert np.abs(u - exact).max() < TOLERANCE * np.abs(exact).max(), name
    s = result.last
    assert np.abs(s.pressure - PRESSURE * np.cos(θ) ** 2).max() < TOLERANCE
    assert np.abs(s.shear - PRESSURE * np.sin(θ) * np.cos(θ)).max() < TOLERANCE
    assert (s.status == STICK).all()


# Three blocks of one material whose whole surface is held by one affine displacement u = G x + c:
# it is exact inside too, where G presses the interfaces together within the friction cone.
GRADIENT = np.array([[2e-4, 1e-4, 2e-4], [-3e-4, 1e-4, -1e-4], [1e-4, 2e-4, -1e-3]])
SHIFT = np.array([0.01, -0.02, 0.005])


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("interfaces", ["{}", "bonded and contact", "contact"])
def test_patch_affine_displacement_on_the_boundary(interfaces: str, order: int) -> None:
    """Expressions give the displacement on all sides.

    It is exact inside, also if interfaces may open.
    """
    rows = [
        f"{axis}: '{' + '.join(f'{g} * {c}' for g, c in zip(row, 'xyz', strict=True))} + {shift}'"
        for axis, row, shift in zip("xyz", GRADIENT, SHIFT, strict=True)
    ]
    sides = ("bottom", "top", "x_min", "x_max", "y_min", "y_max")
    hold = f"kind: displacement, {', '.join(rows)}"
    supports = ", ".join(f"{s}: {{{hold}, boundary: {s}}}" for s in sides)
    change = {"{}": "interfaces={}", "bonded and contact": "interfaces.lower_middle={kind: bonded}"}
    result = support.solve(
        BOX.format(order=order, stiff=100, friction=2),
        f"supports={{{supports}}}",
        "loads={}",
        change.get(interfaces, "interfaces.lower_middle.friction_coefficient=2"),
        "stages=[{name: load, increments: 2}]",
    )
    σ = 100 / 1.3 * ((GRADIENT + GRADIENT.T) / 2 + 0.3 / 0.4 * np.trace(GRADIENT) * np.eye(3))
    for name in ("lower", "middle", "upper"):
        x, u = result.displacement(name)
        exact = x @ GRADIENT.T + SHIFT
        assert np.abs(u - exact).max() < 1e-12 * np.abs(exact).max(), name
        assert np.abs(result.stress(name) - σ).max() < 1e-11 * np.abs(σ).max(), name
    for s in result.samples[-1:]:
        inside = s.pressure > 0  # at the sides supports hold both blocks
        assert inside.sum() > 10
        assert np.abs(s.pressure[inside] + σ[2, 2]).max() < 1e-9 * -σ[2, 2]
        assert (s.status[inside] == STICK).all()


@pytest.mark.parametrize("order", [1, 2])
def test_patch_prescribed_jump_by_two_expressions(order: int) -> None:
    """The jump of blocks that are both held is that of their supports, growing with the load."""
    lower, upper = "1e-3 * (y - z)", "2e-3 * y + 1e-3 * z"
    result = support.solve(
        TILTED.format(**tilted(order, 1.0, 0)),
        "geometry.tilt=0 deg",
        "loads={}",
        f"supports.left={{kind: displacement, boundary: lower_x_min, x: {lower}}}",
        f"supports.more={{kind: displacement, boundary: upper_x_min, x: {upper}, history: [2]}}",
        balances=True,
    )
    for name, exact in (
        ("lower", lambda x: 1e-3 * (x[:, 1] - x[:, 2])),
        ("upper", lambda x: 4e-3 * x[:, 1] + 2e-3 * x[:, 2]),
    ):
        x, u = result.displacement(name)
        side = np.abs(x[:, 0]) < 1e-9
        assert (np.abs(x[side, 2] - 6) < 1e-9).sum() > 2
        np.testing.assert_allclose(u[side, 0], exact(x[side]), atol=1e-15)
    assert result.balances.max() < 1e-9
