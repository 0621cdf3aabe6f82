"""Heat in a case: units, defaults, and its terms in the scene."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from app.case.case import load_case
from app.case.femurs import Femur
from app.foundation.errors import InputError
from app.laws.fibres import Straight
from app.laws.heat_conditions import FixedTemperature
from app.laws.values import multiplier
from app.scene.scene import Scene, Stage, build_scene
from app.schema import units
from tests import support

CASE = Path(__file__).with_name("hot.yaml").read_text()


def build(*overrides: str) -> Scene:
    return build_scene(support.case(CASE, *overrides))


def read(kind: object, text: str) -> float:
    return TypeAdapter(kind).validate_python(text)  # type: ignore[arg-type, no-any-return]


# ------------------------------------------------------------------------------------ units


@pytest.mark.parametrize(
    ("kind", "text", "value"),
    [
        (units.Temperature, "37 degC", 310.15),
        (units.Temperature, "37 °C", 310.15),
        (units.Temperature, "310.15 K", 310.15),
        (units.Temperature, "98.6 degF", 310.15),
        (units.PositiveDifference, "5 K", 5.0),
        (units.PositiveDifference, "9 delta_degF", 5.0),
        (units.Conductivity, "0.2 W/(m K)", 0.2),
        (units.Conductivity, "0.2 W/m/degC", 0.2),
        (units.Conductivity, "0.2 N/(s K)", 0.2),
        (units.Density, "1.2 g/cm^3", 1.2e-9),
        (units.SpecificHeat, "1450 J/(kg K)", 1.45e9),
        (units.SpecificHeat, "1.45 kJ/kg/K", 1.45e9),
        (units.ExpansionCoefficient, "80 ppm/K", 80e-6),
        (units.ExpansionCoefficient, "80e-6 K^-1", 80e-6),
        (units.ExpansionCoefficient, "80e-6 1/degC", 80e-6),
        (units.HeatDensity, "155 MJ/m^3", 155.0),
        (units.ConductancePerArea, "300 W/(m^2 K)", 0.3),
        (units.ConductancePerPressure, "100 W/(m^2 K MPa)", 0.1),
        (units.PositiveRate, "0.003 1/s", 0.003),
        (units.PositiveRate, "0.18 1/min", 0.003),
        (units.ActivationEnergy, "62.866 kJ/mol", 62866.0),
        (units.PositiveTime, "10 min", 600.0),
    ],
)
def test_case_heat_units(kind: object, text: str, value: float) -> None:
    assert read(kind, text) == value
    adapter: TypeAdapter[float] = TypeAdapter(kind)
    assert adapter.validate_python(adapter.dump_python(value, mode="json")) == value


@pytest.mark.parametrize("text", ["0 K", "-273.15 degC", "-1 K", "-500 degF", "5 delta_degC", "37"])
def test_case_heat_refuses_wrong_temperatures(text: str) -> None:
    with pytest.raises(ValidationError):
        read(units.Temperature, text)


# ------------------------------------------------------------------------------------ terms


def test_case_heat_conductors() -> None:
    """A heat capacity of 1e6 J/(m^3 K) is 1 N/(mm^2 K).

    Bone with two conductivities has a fibre.
    """
    stem, cement, bone = build().conductors
    assert (stem.region, stem.conductivities, stem.fibre) == ("stem", (14.8,), None)
    assert stem.capacity == pytest.approx(3.735)
    assert cement.capacity == pytest.approx(1.74)
    assert cement.initial_temperature == 295.15
    assert bone.conductivities == (0.6, 0.5)
    assert bone.fibre is not None and bone.fibre.axis == pytest.approx((0, 0.6, 0.8))


def test_case_heat_conducts_along_the_fibre() -> None:
    bone = (
        "{kind: transversely_isotropic, axial_youngs_modulus: 17 GPa, transverse_youngs_modulus: "
        "11.5 GPa, axial_poisson_ratio: 0.31, transverse_poisson_ratio: 0.51, axial_shear_modulus: "
        "3.3 GPa, fibre: [1, 0, 0], thermal: {axial_conductivity: 0.6 W/(m K), "
        "transverse_conductivity: 0.5 W/(m K), density: 1850 kg/m^3, specific_heat: 1260 J/(kg K), "
        "initial_temperature: 37 degC}}"
    )
    scene = build(f"regions.bone={bone}")
    assert scene.conductors[2].fibre == Straight(axis=[1, 0, 0])
    assert scene.elastic[1].fibre == Straight(axis=[1, 0, 0])


def test_case_heat_conditions() -> None:
    x = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    blood, outside, held, lamp, air, warm = build().heat
    assert blood.coefficient == pytest.approx(0.0119886)  # 0.003 * 1060 * 3770 W/(m^3 K)
    assert isinstance(outside, FixedTemperature) and isinstance(held, FixedTemperature)
    np.testing.assert_allclose(outside.values(x), [301, 304])
    for seconds, celsius in ((0, 40), (30, 30), (60, 20), (1e4, 20)):
        given = multiplier(held.time_course, seconds) * held.values(x)
        np.testing.assert_allclose(given, celsius + 273.15)
    np.testing.assert_allclose(lamp.values(x), 0.1)
    assert lamp.time_course == ((0, 1), (10, 0))
    assert (air.name, air.coefficient, air.ambient) == ("air", 0.02, 295.15)
    np.testing.assert_allclose(warm.values(x), 1.0)
    impossible = build("heat.outside.temperature=37 - 10 * x").heat[1]
    with pytest.raises(InputError, match=r"heat.outside.temperature: .* not above 0 K"):
        impossible.values(x)


def test_case_heat_interfaces() -> None:
    scene = build()
    (contact,) = scene.parting_interfaces
    rubbing, glued = scene.thermal_contacts
    # The rigid stem is stiffer than cement, bone stiffer than cement.
    assert (contact.master, contact.slave) == (("stem",), ("cement",))
    assert rubbing == contact
    assert rubbing.law.conductances == (0.1, 0.05, math.inf)
    assert (glued.master, glued.slave) == (("bone",), ("cement",))
    assert glued.law.conductances == (1.0, 0.0, math.inf)
    for perfect in ("perfect", ""):  # which costs nothing
        key = "interfaces.stem_cement.conductance.cap=1e4 W/(m^2 K)"
        (capped,) = build(key, f"interfaces.cement_bone.conductance={perfect}").thermal_contacts
        assert (capped.name, capped.law.conductances) == ("stem_cement", (0.1, 0.05, 10.0))


def test_case_heat_of_friction_is_shared_by_effusivity() -> None:
    """The effusivity of cement is 590, of cobalt-chromium 7435 W s^1/2/(m^2 K): a share of 7 %.

    A fibrous region has its mean conductivity.
    """
    sliding = (
        "{kind: penalty, friction_coefficient: 1, penalty: 1 GPa/mm, friction_heating: effusivity}"
    )
    at_stem, at_bone = build(f"interfaces.cement_bone={sliding}").friction_heat
    e_cement, e_stem = math.sqrt(0.2 * 1200 * 1450), math.sqrt(14.8 * 8300 * 450)
    e_bone = math.sqrt((0.6 * 0.5 * 0.5) ** (1 / 3) * 1850 * 1260)
    assert at_stem.name == "stem_cement"
    assert at_stem.slave_share == pytest.approx(e_cement / (e_cement + e_stem))
    assert at_stem.slave_share == pytest.approx(0.07, abs=0.005)
    assert at_bone.slave_share == pytest.approx(e_cement / (e_cement + e_bone))


def test_case_heat_share_is_that_of_the_first_side() -> None:
    """The first side of stem_cement is the master, the first side of cement_bone the slave."""
    sliding = "{kind: contact, friction_coefficient: 1, friction_heating: 0.3}"
    a, b = build(
        "interfaces.stem_cement.friction_heating=0.3", f"interfaces.cement_bone={sliding}"
    ).friction_heat
    assert (a.slave_share, b.slave_share) == pytest.approx((0.7, 0.3))


def test_case_heat_strains_and_cure() -> None:
    scene = build()
    assert [(e.region, e.expansion, e.reference) for e in scene.expansions] == [
        ("cement", 80e-6, 295.15),
        ("bone", 27.5e-6, 293.15),
    ]
    (cure,) = scene.cures
    assert (cure.region, cure.heat, cure.kinetics.limit) == (
        "cement",
        155.0,
        ((293.15, 0.9), (373.15, 1.0)),
    )


def test_case_heat_stages_time_and_supports() -> None:
    scene = build("time={method: backward_euler, first_step: 1 ms}")
    assert [(s.seconds, s.steady) for s in scene.stages] == [(3600, False), (0, False)]
    assert scene.time is not None and scene.time.first_step == 1e-3
    assert [[scene.is_active(s, k) for k in (0, 1)] for s in scene.supports] == [
        [True, True],
        [True, False],
    ]


def test_case_heat_conductors_alone_have_no_mechanics() -> None:
    thermal = (
        "{conductivity: 1 W/(m K), density: 1000 kg/m^3, specific_heat: 1000 J/(kg K), "
        "initial_temperature: 300 K}"
    )
    scene = build(
        *(
            f"regions.{r}={{kind: conductor, thermal: {thermal}}}"
            for r in ("stem", "cement", "bone")
        ),
        "interfaces={cement_bone: {kind: bonded, conductance: 1 W/(m^2 K)}}",
        "supports={}",
        "stages=[{name: wait, steady: true}]",
    )
    mechanics = (*scene.elastic, *scene.rigid, *scene.foundations, *scene.supports)
    assert mechanics + scene.loads + scene.parting_interfaces == ()
    assert scene.stages == (Stage(name="wait", steady=True),)
    # Neither side is stiffer: the first is the master.
    (glued,) = scene.thermal_contacts
    assert (glued.master, glued.slave) == (("cement",), ("bone",))


# ------------------------------------------------------------------------ shipped cases


def test_case_heat_hot_case_is_that_of_the_paper() -> None:
    case = load_case(support.CONFIGS / "thermal_100C.yaml").config
    assert isinstance(case.geometry, Femur)
    assert case.geometry.cement_thickness == 4.0
    initial = {n: r.thermal.initial_temperature - 273.15 for n, r in case.regions.items()}  # type: ignore[union-attr]
    assert initial == pytest.approx(
        {"stem": 37, "cement": 100, "cortical_bone": 37, "cancellous_bone": 37}
    )
    scene = build_scene(case)
    assert {c.law.largest_friction for c in scene.parting_interfaces} == {1.0}
    assert [c.law.conductances[0] for c in scene.thermal_contacts] == [0.3, 0.3]
    assert scene.time is not None
    modulus = load_case(support.CONFIGS / "stance_cocr.yaml").config.regions["stem"]
    cold = {"thermal": None, "status": modulus.status, "source": modulus.source}
    assert case.regions["stem"].model_copy(update=cold) == modulus


def test_case_heat_cure_cases_have_equal_materials() -> None:
    """The materials equal the reference values of verification: an adiabatic rise of 89.0805 K."""
    cure, residual, hot = (
        build_scene(load_case(support.CONFIGS / f"{n}.yaml").config)
        for n in ("cure", "residual", "thermal_100C")
    )
    for scene in (cure, residual):
        assert [(c.region, c.conductivities, c.capacity) for c in scene.conductors] == [
            (c.region, c.conductivities, c.capacity) for c in hot.conductors
        ]
        cement = next(c for c in scene.conductors if c.region == "cement")
        assert scene.cures[0].heat / cement.capacity == pytest.approx(89.0805, abs=1e-4)
        assert scene.cures[0].kinetics == cure.cures[0].kinetics
    assert cure.elastic == ()
    assert [residual.is_active(residual.supports[1], k) for k in range(3)] == [True, True, False]


def test_case_heat_residual_ends_in_the_stance() -> None:
    residual, stance = (
        load_case(support.CONFIGS / f"{n}.yaml").config for n in ("residual", "stance")
    )
    assert residual.loads.keys() == stance.loads.keys()
    for name, acting in residual.loads.items():
        assert acting.history == (0, 0, 1)
        assert acting.model_copy(update={"history": None}) == stance.loads[name]
