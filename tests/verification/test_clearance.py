"""A clearance is part of the geometry: it is there from the start, for any increments.

An interference is not: bodies that overlap are pushed into each other through the first stage.
"""

from __future__ import annotations

import numpy as np
import pytest

from app.case.case import Case, load_case
from app.laws.values import gap_at
from app.verification import closed_forms as exact
from app.verification.measures import CEMENT
from forms.contact import STICK
from meshes.distribute import TaggedMesh
from tests import support

CASES = support.CONFIGS / "verification"


def case(name: str, *overrides: str) -> Case:
    return load_case(CASES / f"{name}.yaml", ("mesh.order=1", *overrides)).config


def test_clearance_gap_over_the_stages() -> None:
    gap = np.array([0.1, -0.1, 0.0])
    times = (0.0, 0.25, 1.0, 1.5)
    grown = np.array([gap_at(gap, (), t) for t in times])
    assert grown[:, 0] == pytest.approx([0.1, 0.1, 0.1, 0.1])
    assert grown[:, 1] == pytest.approx([0.0, -0.025, -0.1, -0.1])
    assert not grown[:, 2].any()
    gaps = np.array([gap_at(gap, (1.0, 3.0), t) for t in times])
    assert gaps == pytest.approx(np.outer([0.0, 0.25, 1.0, 2.0], gap))


def test_clearance_hertz_contact_grows_with_its_load() -> None:
    """The half-width is a = sqrt(4 P R / (π E*)) at every increment (Johnson, section 4.2)."""
    size, increments = 0.1, 4
    this = case("hertz_line", f"mesh.size={size} mm", "stages=[{name: press, increments: 4}]")
    steps = support.solve(this).samples
    for k, s in enumerate(steps, 1):
        hertz = exact.hertz_line(100.0 * k / increments, 10.0, exact.contact_modulus(CEMENT))
        width = np.abs(s.x[s.pressure > 0, 0]).max()
        assert abs(width - hertz.a) <= size, k
        assert s.pressure.max() == pytest.approx(hertz.p0, rel=0.1)


@pytest.fixture(scope="module")
def half_planes() -> TaggedMesh:
    """The mesh of cattaneo.yaml, twice as coarse."""
    return support.mesh(case("cattaneo", "mesh.size=0.2 mm"))


def pressed_aside(tagged: TaggedMesh, *overrides: str) -> support.Solved:
    return support.solve(case("cattaneo", "mesh.size=0.2 mm", *overrides), tagged=tagged)


def test_clearance_in_one_stage_equals_clearance_first(half_planes: TaggedMesh) -> None:
    """Loads act in one stage, or after a stage that closes only the clearance."""
    one = pressed_aside(
        half_planes,
        "stages=[{name: load, increments: 3}]",
        "supports.press.history=[1]",
        "supports.shear.history=[1]",
    )
    two = pressed_aside(
        half_planes,
        "interfaces.contact.gap_history=[1, 1]",
        "stages=[{name: approach}, {name: load, increments: 3}]",
        "supports.press.history=[0, 1]",
        "supports.shear.history=[0, 1]",
    )
    for a, b in zip(one.samples, two.samples[1:], strict=True):
        assert support.difference(a.force, b.force) < 1e-7
        assert support.difference(a.motion, b.motion) < 1e-7
    # The pressures do work neither on a clearance nor on what closes it, beyond the load steps.
    assert one.last.contact_work == pytest.approx(two.last.contact_work, abs=1e-9)


def test_clearance_constant_oblique_force_does_not_slip(half_planes: TaggedMesh) -> None:
    """A constant Q/P < μ makes points stick from their first contact on.

    The same Q after P lets a rim slip (Mindlin and Deresiewicz 1953; Johnson, section 7.3).
    """
    oblique = pressed_aside(
        half_planes,
        "stages=[{name: load, increments: 4}]",
        "supports.press.history=[1]",
        "supports.shear.history=[1]",
    )
    for before, after in zip(oblique.samples, oblique.samples[1:], strict=False):
        touched = before.pressure > 0
        assert (after.status[touched] == STICK).all()
    later = pressed_aside(half_planes)
    assert not (later.last.status[later.samples[0].pressure > 0] == STICK).all()


# A block above a base, apart, that nothing holds but the contact to come.
APART = """
geometry: {kind: blocks, blocks: [{name: base, size: [10 mm, 10 mm, 5 mm]},
                                  {name: lid, size: [10 mm, 10 mm, 5 mm]}]}
mesh: {order: 1, size: 4 mm}
regions:
  base: {youngs_modulus: 10 GPa, poisson_ratio: 0}
  lid: {youngs_modulus: 2 GPa, poisson_ratio: 0}
interfaces:
  base_lid: {kind: contact, friction_coefficient: 0.3, gap: 0.1 mm}
supports:
  floor: {kind: fixed, boundary: bottom}
loads:
  push: {kind: pressure, boundary: top, pressure: 5 MPa}
stages: [{name: push, increments: 2}]
"""


@pytest.mark.parametrize("kind", ["contact", "penalty"])
def test_clearance_of_a_block_is_closed(kind: str) -> None:
    """The gap g closes at the first load. Then both blocks shorten by p h/E."""
    law = "{kind: penalty, penalty: 1.0e4 MPa/mm, friction_coefficient: 0.3, gap: 0.1 mm}"
    change = (f"interfaces.base_lid={law}",) if kind == "penalty" else ()
    solved = support.solve(APART, *change)
    x, u = solved.displacement("lid")
    top = x[:, 2] == 10
    for k, s in enumerate(solved.samples, 1):
        assert s.pressure == pytest.approx(2.5 * k)
    sunk = 5 / 1e4 if kind == "penalty" else 0.0
    down = 0.1 + sunk + 5 * 5 / 10e3 + 5 * 5 / 2e3
    assert u[top] == pytest.approx(np.tile([0.0, 0.0, -down], (top.sum(), 1)), abs=1e-9)


def test_clearance_contact_on_a_foundation() -> None:
    """The bed gives way by p/k, and each block shortens by p h/E under the pressure p."""
    bed = "{kind: foundation, boundary: bottom, stiffness: [10 MPa/mm, 10 MPa/mm, 20 MPa/mm]}"
    solved = support.solve(APART, "interfaces.base_lid.gap=0 mm", f"supports={{bed: {bed}}}")
    assert solved.last.pressure == pytest.approx(5.0)
    for region, at, down in (("base", 0, 5 / 20), ("lid", 10, 5 / 20 + 25 / 10e3 + 25 / 2e3)):
        x, u = solved.displacement(region)
        level = np.isclose(x[:, 2], at)
        assert u[level] == pytest.approx(np.tile([0.0, 0.0, -down], (level.sum(), 1)), abs=1e-9)
