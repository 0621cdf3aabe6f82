"""Numbers of interfaces: slip, force, pressure."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from app.results.interface_numbers import ContactSamples
from tests import support

# A rigid block on an elastic one without Poisson's ratio: its motion is prescribed.
BLOCKS = """
geometry: {kind: blocks, blocks: [{name: lower, size: [4 mm, 4 mm, 2 mm]},
                                  {name: upper, size: [4 mm, 4 mm, 2 mm]}]}
mesh: {order: 1, size: 2 mm, far_size: 2 mm}
regions: {lower: {youngs_modulus: 100 MPa, poisson_ratio: 0}, upper: {rigid: true}}
interfaces: {lower_upper: {kind: contact, friction_coefficient: 0}}
supports: {floor: {kind: fixed, boundary: bottom}}
"""
ELASTIC = BLOCKS.replace("rigid: true", "youngs_modulus: 100 MPa, poisson_ratio: 0")


def moved(path: list[tuple[float, float]], law: str = "friction_coefficient: 0") -> dict[str, Any]:
    """The interface after the upper block has followed a path of (x, z) [mm], a stage each."""
    x, z = ([0.0, *values] for values in zip(*path, strict=True))
    hand = (
        f"supports.x={{kind: displacement, boundary: top, x: 1 mm, history: {x[1:]}}}",
        "supports.y={kind: roller, boundary: top, axis: y}",
        f"supports.z={{kind: displacement, boundary: top, z: 1 mm, history: {z[1:]}}}",
        "stages=[" + ", ".join(f"{{name: s{k}}}" for k in range(len(path))) + "]",
        f"interfaces.lower_upper={{kind: contact, {law}}}",
    )
    return support.solve(BLOCKS, *hand).interfaces["lower_upper"]


# Pressed, 40 um aside, 10 um back, lifted by 20 um, aside by 50 um, put down, slid home, and again.
ROUND = [
    *((0, -0.001), (0.04, -0.001), (0.03, -0.001), (0.03, 0.02), (0.08, 0.02), (0.08, -0.001)),
    (0, -0.001),
]


@pytest.mark.parametrize(
    ("path", "slip", "way"),
    [
        (ROUND[:3], 0.03, 0.05),  # slip is net, its path is longer
        (ROUND[:4], 0.0, 0.05),  # open: no slip
        (ROUND[:5], 0.0, 0.05),  # what moves while it is open is not on the path
        (ROUND[:6], 0.08, 0.05),  # touching again: slip is where it is now
        (ROUND, 0.0, 0.13),  # a closed loop ends where it began
        (ROUND + ROUND + ROUND[:2], 0.04, 0.30),
    ],
)
def test_interface_numbers_slip_is_a_state_and_its_path_accumulates(
    path: list[tuple[float, float]], slip: float, way: float
) -> None:
    q = moved(path)
    assert q["slip_mean"] == pytest.approx(slip, rel=1e-9, abs=1e-12)
    assert q["slip_path_mean"] == pytest.approx(way, rel=1e-9)
    x, z = path[-1]
    # The lower block is shorter by 1 um, of which its upper side gives way.
    assert q["motion_mean"] == pytest.approx(np.hypot(x, max(z, 0.0)), rel=1e-9, abs=1e-12)
    assert q["gap_mean"] == pytest.approx(max(z, 0.0), rel=1e-9, abs=1e-12)
    assert q["area_slip_over_30um"] == pytest.approx(16 if slip >= 0.03 else 0)
    assert q["slip_max"] <= q["motion_max"] + 1e-12


@pytest.mark.parametrize(("slid", "fraction"), [(1e-11, 0.0), (1e-8, 1.0)])
def test_interface_numbers_slip_of_rounding_size_counts_as_stick(
    slid: float, fraction: float
) -> None:
    """A point has less than a millionth of the former pressure.

    So any motion exceeds the friction limit. The longest path of sliding is 0.04 mm. A step of
    1e-11 mm is below 1e-9 of it.
    """
    path = [(0, -0.001), (0.04, -0.001), (0.04, -1e-9), (0.04 + slid, -1e-9)]
    q = moved(path, "friction_coefficient: 0.3")
    assert q["slip_fraction"] == fraction and q["stick_fraction"] == 1 - fraction


@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_interface_numbers_slip_is_independent_of_proportional_steps(friction: float) -> None:
    """A taper is pressed in, with the same slip in 1, 3 and 16 steps."""
    interfaces = [
        support.solve(
            support.STEM,
            f"stages=[{{name: load, increments: {steps}}}]",
            *(f"interfaces.{name}.friction_coefficient={friction}" for name in CONTACTS),
        ).interfaces
        for steps in (1, 3, 16)
    ]
    for name in CONTACTS:
        for key in ("slip_p99", "slip_mean", "slip_max", "area_slip_over_30um"):
            for other in interfaces[1:]:
                assert other[name][key] == pytest.approx(interfaces[0][name][key], rel=1e-8), (
                    name,
                    key,
                )
        assert interfaces[0][name]["slip_mean"] > 1e-4


def test_interface_numbers_slip_is_zero_where_points_stick() -> None:
    """Friction of 10 holds a lateral motion as large as the compression."""
    q = moved([(0, -0.01), (0.01, -0.01)], "friction_coefficient: 10")
    assert q["slip_max"] < 1e-12 and q["motion_max"] < 1e-12


@pytest.mark.parametrize("stiff", ["lower", "upper"])
def test_interface_numbers_force_acts_on_the_second_body(stiff: str) -> None:
    """A force of 16 N presses down, with either side softer."""
    q = support.solve(
        ELASTIC,
        f"regions.{stiff}.youngs_modulus=1000 MPa",
        "loads={press: {kind: pressure, boundary: top, pressure: 1 MPa}}",
        "supports.x={kind: roller, boundary: top, axis: x}",
        "supports.y={kind: roller, boundary: top, axis: y}",
    ).interfaces["lower_upper"]
    np.testing.assert_allclose(q["force"], [0, 0, 16], atol=1e-8)


CONTACTS = ("stem_cement", "cement_bone")


@pytest.mark.parametrize(("normal_error", "decides"), [(0.0, False), (0.1, True)])
def test_interface_numbers_pressure_by_facets(normal_error: float, decides: bool) -> None:
    """A normal that is wrong by an angle a presses the surface by k s sin a at a slip s."""
    solved = support.solve(support.STEM)
    contact = solved.problem.contact
    assert contact is not None
    contact.points = replace(
        contact.points, normal_error=np.full(len(contact.points.x), normal_error)
    )
    trial = solved.problem.trial(*solved.solver.u_and_q())
    numbers = ContactSamples(solved.problem, trial).numbers["stem_cement"]
    assert ("pressure_by_facets" in numbers) == decides
    if decides:
        here = contact.local.interface == 0
        pressed = (
            contact.laws.softest_stiffness
            * np.linalg.norm(contact.state.slip, axis=1)
            * normal_error
        )
        assert numbers["pressure_by_facets"] == pytest.approx(pressed[here].max(), rel=1e-6)
