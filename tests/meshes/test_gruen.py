"""Gruen zones: their places, and the energy reported for them."""

from __future__ import annotations

import numpy as np
import pytest
import ufl

from app.case.femurs import Femur, FemurResection
from app.case.stems import Stem
from app.mechanics.body_forms import OnBody, assemble_form_vector
from app.results.stresses import Stresses
from meshes import femur_bone, femur_stem
from meshes.gruen import BELOW_TIP, Zones
from tests import support
from tests.patient.bones import cut

GEOMETRY = Femur()
ZONES = Zones(GEOMETRY)


def test_gruen_zones_are_numbered_as_on_a_radiograph() -> None:
    """Zones 1 to 3 are lateral and 8 to 10 anterior downwards.

    Zones 4 and 11 follow, then the others upwards on the other side.
    """
    third = (ZONES.top - ZONES.tip) / 3
    high, middle, low, below = (ZONES.tip + third * k for k in (2.5, 1.5, 0.5, -0.2))
    for z, lateral, medial, anterior, posterior in (
        (high, 1, 7, 8, 14),
        (middle, 2, 6, 9, 13),
        (low, 3, 5, 10, 12),
        (below, 4, 4, 11, 11),
    ):
        x = np.array([(-10.0, 1.0, z), (10.0, 1.0, z), (1.0, 10.0, z), (1.0, -10.0, z)])
        zones = ZONES.zones_at(x)
        assert zones[:2, 0].tolist() == [lateral, medial]
        assert zones[2:, 1].tolist() == [anterior, posterior]


def test_gruen_thirds_are_of_the_length_in_the_bone() -> None:
    """Thirds are between the tip and the point where the axis of the stem leaves the neck cut.

    There is no zone 20 mm below the tip. Zones 4 and 11 begin at the rounding of the stem's end.
    """
    normal, level = cut(GEOMETRY)
    assert normal @ [0.0, 0.0, ZONES.top] == pytest.approx(level)
    assert ZONES.tip == -118.0 and 20.0 < ZONES.top < 25.0
    end = ZONES.tip + GEOMETRY.implant.tip_height
    levels = np.array([ZONES.top + 20.0, end + 1e-3, end, ZONES.tip - BELOW_TIP + 1e-3])
    x = np.column_stack([np.full(4, 10.0), np.ones(4), levels])
    assert ZONES.zones_at(x).tolist() == [[7, 8], [5, 10], [4, 11], [4, 11]]
    assert ZONES.zones_at(np.array([(10.0, 1.0, ZONES.tip - BELOW_TIP - 1e-3)])).tolist() == [
        [0, 0]
    ]
    # A stem whose shoulder is below the cut is embedded as far as that.
    short = {"stem": Stem().model_copy(update={"length": 130.0}), "tip_z": -118.0}
    assert Zones(GEOMETRY.model_copy(update=short)).top == 12.0


def test_gruen_rim_and_tip_follow_cut_and_end() -> None:
    """A cut at 45 degrees, by hand, leaves the anterior cortex at z = 5 mm."""
    cut = {"resection": FemurResection(angle="45 deg"), "anteversion": np.pi / 2}
    zones = Zones(GEOMETRY.model_copy(update=cut))
    r = float(femur_bone.PERIOSTEUM.radius(np.array(np.pi / 2), np.array(5.0)))
    x = np.array([(0, r, 5.0), (3.0, r, 5.0), (0, r - 20.0, 5.0), (0, r, -15.0), (0, 0, -118.0)])
    deep = [0.0, 0.0, 200**0.5, 200**0.5, (123.0 + r) / 2**0.5]
    assert zones.depth(x) == pytest.approx(deep, abs=1e-9)
    borders = zones.borders(x)
    assert borders["rim"] == pytest.approx(np.array(deep) - 10.0, abs=1e-9)
    assert (borders["tip"] <= 0).tolist() == [False] * 4 + [True]


def test_gruen_zones_are_robust_to_rounding() -> None:
    """Layered meshes have points on the planes between zones.

    BLAS libraries round them differently.
    """
    third = (ZONES.top - ZONES.tip) / 3
    levels = ZONES.tip + np.array([-BELOW_TIP, 0.0, third, 2 * third])
    normal, level = cut(GEOMETRY)
    x = np.array([(side, 0.0, z) for side in (-12.0, 12.0) for z in levels])
    x = np.concatenate([x, x[:, [1, 0, 2]], x + np.array([0.0, 0.0, 1.0]), level * normal[None]])
    plug = np.array([(1.0, 1.0, ZONES.tip - GEOMETRY.plug_length)])
    for rounding in np.random.default_rng(0).uniform(-1e-12, 1e-12, (20, 3)):
        assert np.array_equal(ZONES.zones_at(x), ZONES.zones_at(x + rounding))
        for points in (x, plug):
            assert np.array_equal(ZONES.is_left(points), ZONES.is_left(points + rounding))


def test_gruen_zones_exclude_stem_cement_and_neck() -> None:
    """Stem, cement and neck are left out. The bone next to them counts."""

    def left(*points: tuple[float, float, float]) -> list[bool]:
        on_left: list[bool] = ZONES.is_left(np.array(points)).tolist()
        return on_left

    cavity = femur_stem.shaft_of(GEOMETRY.implant).offset(GEOMETRY.cement_thickness)
    medial = float(cavity.section(0.0)[0])
    assert left((medial - 0.1, 0.0, 0.0), (medial + 0.1, 0.0, 0.0)) == [False, True]
    # Where the canal has no room all of the cancellous bone goes, and none of the cortex.
    canal = float(femur_bone.Tube(femur_bone.CANAL).radius(np.array(0.0), np.array(-80.0)))
    assert canal < cavity.section(-80.0)[0]
    assert left((canal - 0.1, 0.0, -80.0), (canal + 0.1, 0.0, -80.0)) == [False, True]
    head, below_plug = (43.0, 0.0, 54.0), (0.0, 0.0, -118.0 - 10.1)
    assert left(head, below_plug) == [False, True]


# Bone along a tilted fibre beside cement, sheared, pressed and partly let free by an eigenstrain.
CASE = """
geometry:
  kind: blocks
  blocks:
    - {name: lower, size: [4 mm, 5 mm, 6 mm]}
    - {name: upper, size: [4 mm, 5 mm, 3 mm]}
mesh: {order: 2, size: 3 mm}
regions:
  lower:
    kind: transversely_isotropic
    axial_youngs_modulus: 17 GPa
    transverse_youngs_modulus: 11.5 GPa
    axial_poisson_ratio: 0.31
    transverse_poisson_ratio: 0.51
    axial_shear_modulus: 3.3 GPa
    fibre: [1, 2, 2]
  upper: {youngs_modulus: 600 MPa, poisson_ratio: 0.3}
supports:
  floor: {kind: fixed, boundary: bottom}
loads:
  push: {kind: force, boundary: top, force: [30 N, -10 N, -200 N]}
"""


def test_gruen_strain_energy_is_half_the_work_of_loads() -> None:
    """Clapeyron's theorem holds for the sum over all points, for any law."""
    solved = support.solve(CASE)
    stresses = Stresses(solved.problem)
    total = 0.0
    for region, height in (("lower", 6.0), ("upper", 3.0)):
        x, dx = stresses.points_and_volumes(region)
        assert dx.sum() == pytest.approx(4 * 5 * height)
        mean = (x * dx.reshape(-1, 1)).sum(axis=0) / dx.sum()
        assert mean == pytest.approx([2.0, 2.5, height / 2 if region == "lower" else 7.5])
        density = stresses.energy_density(region)
        assert (density > 0).all()
        total += float((density * dx).sum())
    body_forms, (load,) = solved.problem.body_forms, solved.problem.scene.loads
    v = ufl.TestFunction(body_forms.space)
    f = assemble_form_vector(body_forms.form(load.work(v, OnBody(body_forms, 0))))
    u = solved.problem.displacements()[0].x.array[: f.getLocalSize()]
    assert total == pytest.approx(0.5 * float(f.array @ u), rel=1e-9)


def _rollers(*sides: str) -> str:
    """Supports of each side, normal to it."""
    axes = {side: side[0] if side[0] in "xy" else "z" for side in sides}
    each = [f"{s}: {{kind: roller, boundary: {s}, axis: {a}}}" for s, a in axes.items()]
    return f"{{{', '.join(each)}}}"


def test_gruen_free_strain_has_no_energy() -> None:
    """A stack swells freely, then is held: the energy is E e^2 / 2 (1 - 2 nu) times 3."""
    free = "{strain: [1e-3, 1e-3, 1e-3, 0, 0, 0]}"
    swelling = (
        "loads={}",
        f"supports={_rollers('x_min', 'y_min', 'bottom')}",
        f"regions.lower={{youngs_modulus: 600 MPa, poisson_ratio: 0.3, eigenstrains: [{free}]}}",
        f"regions.upper.eigenstrains=[{free}]",
    )
    stresses = Stresses(support.solve(CASE, *swelling).problem)
    assert np.abs(stresses.energy_density("upper")).max() < 1e-12
    held = _rollers("x_min", "y_min", "bottom", "x_max", "y_max", "top")
    stresses = Stresses(support.solve(CASE, *swelling, f"supports={held}").problem)
    exact = 1.5 * 600.0 * 1e-6 / (1 - 0.6)
    assert stresses.energy_density("upper") == pytest.approx(exact, rel=1e-9)
