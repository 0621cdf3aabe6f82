"""Bodies that slide along a curved surface of straight facets do not climb its facets."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import meshes
from app.case.case import Case
from app.case.mesh_names import ALLOWED
from meshes.distribute import distribute
from tests import support

# Two rings with a press fit, the inner one pushed along the axis.
PRESS_FIT = """
geometry: {kind: cylinders, stem_radius: 8 mm, cement_thickness: 8 mm, bone_thickness: 8 mm,
           length: 12 mm, sector: quarter}
mesh: {size: 4 mm, far_size: 4 mm, order: 2, curved: false}
regions:
  stem: {youngs_modulus: 1e-3 MPa, poisson_ratio: 0}
  cement: {youngs_modulus: 100 GPa, poisson_ratio: 0.3}
  bone: {youngs_modulus: 100 GPa, poisson_ratio: 0.3}
interfaces:
  cement_bone: {kind: contact, friction_coefficient: 0.1, gap: -0.004 mm, gap_history: [1, 1]}
supports:
  x: {kind: roller, boundary: symmetry_x, axis: x}
  y: {kind: roller, boundary: symmetry_y, axis: y}
  z: {kind: roller, boundary: bone_bottom, axis: z}
  push: {kind: displacement, boundary: cement_top, z: -0.1 mm, history: [0, 1]}
stages: [{name: fit}, {name: push, increments: 2}]
"""
THICKNESSES = ("stem_radius", "cement_thickness", "bone_thickness")


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(
    ("width", "length", "size", "overlap", "modulus"),
    [(8.0, 12.0, 4.0, 0.004, 100e3), (10.0, 20.0, 3.0, 0.0025, 200e3)],
)
def test_straight_facets_press_fit_pressure_stays_constant(
    width: float, length: float, size: float, overlap: float, modulus: float, order: int
) -> None:
    """Lame: p = δE / (b ((b² + a²)/(b² - a²) + (c² + b²)/(c² - b²))), a, b, c = 1, 2, 3 widths.

    The largest pressure is at the ends: 7.03 MPa of the second fit at second order on curved cells,
    8.37 MPa at first order.
    """
    solved = support.solve(
        PRESS_FIT,
        *(f"geometry.{key}={width} mm" for key in THICKNESSES),
        f"geometry.length={length} mm",
        f"mesh.size={size} mm",
        *(f"regions.{name}.youngs_modulus={modulus} MPa" for name in ("cement", "bone")),
        f"interfaces.cement_bone.gap={-overlap} mm",
        f"mesh.order={order}",
        balances=True,
    )
    a, b, c = width * np.arange(1, 4)
    pressure = overlap * modulus / b
    pressure /= (b**2 + a**2) / (b**2 - a**2) + (c**2 + b**2) / (c**2 - b**2)
    least, most = [], []
    for s in solved.samples[1:]:
        assert (s.pressure > 0).all()
        mean = np.average(s.pressure, weights=s.weight)
        assert mean == pytest.approx(pressure, rel=0.05 if order == 1 else 0.015)
        # The quarter is pushed by friction along the axis alone.
        area = np.pi / 2 * b * length
        push = abs(s.weight @ s.force[:, 2])
        assert push == pytest.approx(0.1 * pressure * area, rel=0.06 if order == 1 else 0.02)
        least.append(s.pressure.min())
        most.append(s.pressure.max())
    # Another 50 um of slip change nothing: normals have no part along the axis.
    assert least[1] == pytest.approx(least[0], rel=0.02)
    assert most[1] == pytest.approx(most[0], rel=0.02)
    assert most[1] < (1.5 if order == 1 else 1.25) * pressure
    assert "pressure_by_facets" not in solved.interfaces["cement_bone"]
    assert solved.balances.max() < 1e-8


# An elliptic stem in a block, and the block cut through: symmetric about both axes.
OVAL_GEO = """\
SetFactory("OpenCASCADE");
DefineConstant[ size = 3 ];
Box(1) = {0, 0, 0, 12, 12, 10};
Disk(10) = {0, 0, 0, 7, 5};
q[] = Extrude{0, 0, 10}{ Surface{10}; };
BooleanIntersection(3) = { Volume{1}; }{ Volume{q[1]}; Delete; };
BooleanFragments{ Volume{1}; Delete; }{ Volume{3}; Delete; }
Physical Volume("stem") = {3};
Physical Volume("block") = {4};
Physical Surface("stem_top") = Surface In BoundingBox {-0.1, -0.1, 9.9, 7.1, 5.1, 10.1};
Physical Surface("block_side") = Surface In BoundingBox {11.9, -0.1, -0.1, 12.1, 12.1, 10.1};
Physical Surface("x0") = Surface In BoundingBox {-0.1, -0.1, -0.1, 0.1, 12.1, 10.1};
Physical Surface("y0") = Surface In BoundingBox {-0.1, -0.1, -0.1, 12.1, 0.1, 10.1};
"""
OVAL = """
geometry: {{kind: file, path: {path}, interfaces: {{joint: [block, stem]}}}}
mesh: {{size: 1.5 mm, order: 1}}
regions:
  stem: {{youngs_modulus: 10 GPa, poisson_ratio: 0.3, tissue: other}}
  block: {{youngs_modulus: 10 GPa, poisson_ratio: 0.3, tissue: other}}
interfaces:
  joint: {{kind: contact, friction_coefficient: 0.1, gap: -0.01 mm, gap_history: [1, 1]}}
supports:
  x: {{kind: roller, boundary: x0, axis: x}}
  y: {{kind: roller, boundary: y0, axis: y}}
  z: {{kind: roller, boundary: block_side, axis: z}}
  push: {{kind: displacement, boundary: stem_top, z: -0.1 mm, history: [0, 1]}}
stages: [{{name: fit}}, {{name: push, increments: 2}}]
"""


def test_straight_facets_elliptic_stem_does_not_climb(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(ALLOWED, "1")
    (tmp_path / "oval.geo").write_text(OVAL_GEO)
    solved = support.solve(OVAL.format(path=tmp_path / "oval.geo"), balances=True)
    one, two = solved.samples[1:]
    assert two.pressure.min() == pytest.approx(one.pressure.min(), rel=0.02)
    assert two.pressure.max() == pytest.approx(one.pressure.max(), rel=0.02)
    push = [abs(s.weight @ s.force[:, 2]) for s in (one, two)]
    assert push == pytest.approx([0.1 * s.weight @ s.pressure for s in (one, two)], rel=0.02)
    assert "pressure_by_facets" not in solved.interfaces["joint"]
    assert solved.balances.max() < 1e-8


# A cone pressed into its seat, then turned about its axis.
TURNED = """
geometry: {kind: cylinders, stem_radius: 7 mm, cement_thickness: 3 mm, bone_thickness: 4 mm,
           length: 8 mm, taper: 3 deg}
mesh: {size: 3 mm, far_size: 4 mm, order: 1}
regions:
  stem: {youngs_modulus: 10 GPa, poisson_ratio: 0.3}
  cement: {youngs_modulus: 2200 MPa, poisson_ratio: 0.3}
  bone: {youngs_modulus: 17 GPa, poisson_ratio: 0.3}
interfaces:
  stem_cement: {kind: contact, friction_coefficient: 0.1, gap: -0.01 mm, gap_history: [1, 1]}
  cement_bone: {kind: bonded}
supports:
  outer: {kind: fixed, boundary: bone_surface}
  turn: {kind: displacement, boundary: stem_top, x: -0.02 * y, y: 0.02 * x, z: 0 mm,
    history: [0, 1]}
stages: [{name: fit}, {name: turn, increments: 2}]
"""


def test_straight_facets_rotated_cone_does_not_climb() -> None:
    """The cone slides by 0.07 and 0.14 mm.

    The torque is that of friction on all of its pressure.
    """
    solved = support.solve(TURNED, balances=True)
    one, two = solved.samples[1:]
    assert two.pressure.min() == pytest.approx(one.pressure.min(), rel=0.02)
    assert two.pressure.max() == pytest.approx(one.pressure.max(), rel=0.02)
    arm = np.hypot(two.x[:, 0], two.x[:, 1])
    torque = two.weight @ (two.x[:, 0] * two.force[:, 1] - two.x[:, 1] * two.force[:, 0])
    assert abs(torque) == pytest.approx(0.1 * (two.weight * two.pressure) @ arm, rel=0.02)
    assert solved.balances.max() < 1e-8


# What nothing holds, and no load moves

SMOOTH = "interfaces.stem_cement.friction_coefficient=0"


def torsion(solved: support.Solved) -> float:
    """Mean rotation of the stem against its cement about the axis, by area [rad]."""
    s = solved.last
    here = s.interface == 0
    x, w, q = s.x[here], s.weight[here], s.motion[here]
    return float(w @ (x[:, 0] * q[:, 1] - x[:, 1] * q[:, 0]) / (w @ (x[:, :2] ** 2).sum(axis=1)))


def rounded(case: Case, digits: int) -> support.TaggedMesh:
    """The mesh of a case with coordinates of some digits after the point."""
    comm = support.MPI.COMM_WORLD
    data = meshes.build(case.geometry, case.mesh, None) if comm.rank == 0 else None
    return distribute(data and replace(data, points=np.round(data.points, digits)), comm)


@pytest.mark.parametrize("digits", [12, 6, 4, 3])
@pytest.mark.parametrize("taper", [1.5, 0])
def test_straight_facets_frictionless_stem_does_not_rotate(taper: float, digits: int) -> None:
    """Any solver is exact on exact and on rounded coordinates.

    Facets rotated the stem by 1.6e-3.
    """
    load = "[300 N, 0 N, -900 N]" if taper else "[300 N, 0 N, 0 N]"
    changes = (SMOOTH, f"geometry.taper={taper} deg", f"loads.hip.force={load}")
    tagged = rounded(support.case(support.STEM, *changes), digits)
    states = []
    for linear in support.SOLVERS:
        solved = support.solve(
            support.STEM, *changes, f"solver.linear={linear}", tagged=tagged, balances=True
        )
        # The axis is off by as much, along which the stem sinks by 2 mm.
        assert abs(torsion(solved)) < max(1e-9, 0.1 * 10.0**-digits)
        assert solved.balances.max() < 1e-8
        states.append(solved.last)
    assert (states[0].pressure > 0).any()
    for other in states[1:]:
        assert support.difference(states[0].pressure, other.pressure) < 1e-6
        assert support.difference(states[0].motion, other.motion) < 1e-6


@pytest.mark.parametrize("friction", [0, 0.2, 0.4])
def test_straight_facets_stem_closes_a_gap(friction: float) -> None:
    """A taper sinks by gap / sin(taper), so pressures are those without a gap."""
    changes = (f"interfaces.stem_cement.friction_coefficient={friction}",)
    axial = "loads.hip.force=[0 N, 0 N, -900 N]"
    tight = support.solve(support.STEM, *changes, axial).last
    on = tight.interface == 0
    for linear in support.SOLVERS:
        gap = "interfaces.stem_cement.gap=0.01 mm"
        solved = support.solve(
            support.STEM, *changes, axial, gap, f"solver.linear={linear}", balances=True
        )
        s = solved.last
        assert solved.balances.max() < 1e-8
        assert s.pressure[on].max() == pytest.approx(tight.pressure[on].max(), rel=0.01)
        sunk = np.average((s.motion - tight.motion)[on, 2], weights=s.weight[on])
        assert abs(sunk) == pytest.approx(0.01 / np.sin(np.deg2rad(1.5)), rel=0.01)


WARM = """
geometry: {kind: cylinders, stem_radius: 7 mm, cement_thickness: 4 mm, bone_thickness: 5 mm,
           length: 20 mm, taper: 1.5 deg}
mesh: {order: 1, size: 5 mm}
regions:
  stem: {youngs_modulus: 110 GPa, poisson_ratio: 0.3, thermal: {conductivity: 6 W/(m K),
    density: 4400 kg/m^3, specific_heat: 500 J/(kg K), initial_temperature: 60 degC}}
  cement: {youngs_modulus: 2200 MPa, poisson_ratio: 0.3, thermal: {conductivity: 0.2 W/(m K),
    density: 1200 kg/m^3, specific_heat: 1500 J/(kg K), initial_temperature: 37 degC}}
  bone: {youngs_modulus: 17 GPa, poisson_ratio: 0.3, thermal: {conductivity: 0.4 W/(m K),
    density: 1900 kg/m^3, specific_heat: 1300 J/(kg K), initial_temperature: 37 degC}}
supports:
  outer: {kind: fixed, boundary: bone_surface}
interfaces:
  stem_cement: {kind: contact, friction_coefficient: 0,
    conductance: {kind: pressure, open: 50 W/(m^2 K), per_pressure: 400 W/(m^2 K MPa)}}
  cement_bone: {kind: bonded}
heat:
  wall: {kind: temperature, boundary: bone_surface, temperature: 37 degC}
loads:
  hip: {kind: force, boundary: stem_top, force: [300 N, 0 N, -900 N]}
stages:
  - {name: press, duration: 10 s, increments: 2, adaptive: false}
time: {method: backward_euler, tolerance: 1 K}
"""


@pytest.mark.parametrize("linear", ["auto", "direct", "multigrid"])
def test_straight_facets_conducting_stem_does_not_rotate(linear: str, tmp_path: Path) -> None:
    """Heat and contact are one system, with the mechanics of a case without heat."""
    summary = support.run(WARM, tmp_path, f"solver.linear={linear}").summary
    text = re.sub(r",\s+(thermal|conductance): \{[^}]*\}", "", WARM.partition("time:")[0])
    text = re.sub(r"heat:\n.*\n", "", text).replace("duration: 10 s, ", "")
    cold = support.solve(text).interfaces["stem_cement"]
    warm = summary["interfaces"]["stem_cement"]
    for key in ("pressure_max", "pressure_mean", "motion_max"):
        assert warm[key] == pytest.approx(cold[key], rel=1e-6)
