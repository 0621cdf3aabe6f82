"""The estimate of a run's error: exact values by models, and costs."""

from __future__ import annotations

import json
from typing import Any

import pytest

from app.case import error_classes, quantities
from app.case.case import Case
from app.case.error_classes import MOTION_ERRORS, SLIP_ERRORS, STRESS_ERRORS, ErrorClass
from app.results import error_estimate
from tests import support
from tests.cases.blocks import STACK
from tests.frozen import frozen

HEAT = """
geometry: {kind: blocks, blocks: [{name: lower, size: [4 mm, 4 mm, 2 mm]}]}
mesh: {size: 1 mm}
regions:
  lower:
    kind: conductor
    thermal: {conductivity: 1 W/(m K), density: 1000 kg/m^3, specific_heat: 1000 J/(kg K),
              initial_temperature: 37 degC}
heat:
  cold: {kind: temperature, boundary: bottom, temperature: 20 degC}
stages: [{name: cool, duration: 60 s}]
output: {error: true}
"""


def case(*overrides: str) -> Case:
    return support.case(STACK, *overrides)


def fitted_factors(error_class: ErrorClass, of_part: bool = False) -> tuple[float, float]:
    """Factors a and b of a class at second order."""
    return error_class.change_factor(1), error_class.median_factor(1, of_part)


def compared(run: dict[str, Any], this: Case, *others: dict[str, Any]) -> dict[str, Any]:
    """The estimate of a run from the numbers of its first companions."""
    companions = error_estimate.companions(this)[: len(others)]
    return error_estimate.add_error_estimates(run, this, list(zip(companions, others, strict=True)))


def modelled(run: dict[str, Any], this: Case, model: Any) -> dict[str, Any]:
    """The estimate of a run whose numbers follow a model in mesh size and increments."""
    companions = error_estimate.companions(this)
    return compared(
        run, this, *(model(c.case.mesh.size, c.case.stages[0].increments) for c in companions)
    )


def numbers(size: float, increments: float, order: float) -> dict[str, Any]:
    """Numbers with an error of C h^p + C' / n. The p is that of the estimate."""

    def wrong(by: float, p: float = order) -> float:
        return by * (0.01 * size**p + 0.02 / increments)

    return {
        "interfaces": {
            "lower_upper": {
                "slip_p99": 1 + wrong(1),
                "slip_max": 1 + 0.2 * size,
                "gap_max": 0.0 if size < 1.5 else 1e-3,
                "force": [wrong(1), wrong(2), 0.0],
            }
        },
        "regions": {},
        "stem": {},
    }


@pytest.mark.parametrize(
    ("text", "changes", "expected"),
    [
        (STACK, ("output.error=false",), []),
        (STACK, ("stages.0.increments=9",), [(2, 4, 4 / 9), (3, 4, 4 / 9), (3, 9, 1)]),
        # One increment is compared with two.
        (STACK, (), [(2, 1, 1), (3, 1, 1), (3, 2, 2)]),
        # Without friction the path does not matter, and a steady state has no time steps.
        (STACK, ("interfaces.lower_upper.friction_coefficient=0",), [(2, 1, 1)]),
        (HEAT, ("stages=[{name: cool, steady: true}]",), [(2, 1, 1)]),
    ],
    ids=("not asked", "nine", "one", "smooth", "steady"),
)
def test_error_estimate_companions_are_coarser(
    text: str, changes: tuple[str, ...], expected: list[tuple[float, ...]]
) -> None:
    """Companions have mesh sizes, increments, and steps relative to the run."""
    companions = error_estimate.companions(support.case(text, *changes))
    assert [
        (c.case.mesh.size, c.case.stages[0].increments, c.step_ratio) for c in companions
    ] == expected
    assert all(c.case.mesh.far_size_or_default == 4 * c.case.mesh.size for c in companions)


def test_error_estimate_with_fewer_companions() -> None:
    text = (support.CONFIGS / "stance.yaml").read_text(encoding="utf-8")
    femur = support.case(text, "mesh.size=8 mm")
    sizes = [c.case.mesh.size for c in error_estimate.companions(femur)]
    assert sizes == [16, 20, 20] and femur.geometry.coarsest_size == 20


def test_error_estimate_names_its_sources() -> None:
    for text, coarsening, sources in (
        (STACK, 2.0, "mesh and step"),
        (STACK, 1.0, "load step"),
        (HEAT, 1.0, "time step"),
    ):
        companion = error_estimate.Companion(support.case(text), coarsening, 0.5)
        assert error_estimate.error_sources([companion]) == sources


@pytest.mark.parametrize(("method", "power"), [("sdirk4", 1), ("backward_euler", 2)])
def test_error_estimate_companions_in_time(method: str, power: int) -> None:
    """Errors of order p with an estimate of order q grow as tolerance^(p / q): 4/4 and 1/2."""
    companions = error_estimate.companions(
        support.case(HEAT, f"time.method={method}", "time.tolerance=3e-4 K")
    )
    assert [c.case.mesh.size for c in companions] == [2, 3, 3]
    larger = 3e-4 * 2**power
    assert [c.case.time.tolerance for c in companions] == pytest.approx([larger, larger, 3e-4])  # type: ignore[union-attr]


@pytest.mark.parametrize("increments", [1, 8, 9])
def test_error_estimate_is_exact_for_its_model(increments: int) -> None:
    p = MOTION_ERRORS.orders[1]
    run, this = numbers(1.0, increments, p), case(f"stages.0.increments={increments}")
    unsettled = modelled(run, this, lambda size, n: numbers(size, n, p))
    q = run["interfaces"]["lower_upper"]
    # The difference from 2 h, and the steps; a single number changes as the median of all.
    a = MOTION_ERRORS.change_factor(1)
    by_mesh, by_step = 0.01 * (2**p - 1), 0.02 / increments
    error = a * by_mesh + by_step
    a, b = fitted_factors(SLIP_ERRORS)
    assert q["slip_p99_error"] == pytest.approx(b / a * (a * by_mesh + by_step))
    assert q["force_error"] == pytest.approx([error, 2 * error, 0])
    # The peak changes by 0.2 of 1.2, the gap by far less than any slip.
    assert list(unsettled) == ["lower_upper.slip_max"]
    assert "slip_max_error" not in q


def test_error_estimate_lists_maxima_that_do_not_converge() -> None:
    """The finest mesh comes first, then the worst peak.

    Of two runs on a mesh the one with the run's steps counts.
    """
    this = case("stages.0.increments=8")

    def peaks(pressure: float, slip: float, stress: float, shear: float) -> dict[str, Any]:
        interface = {
            "pressure_max": pressure,
            "slip_max": slip,
            "slip_p99": 0.1,
            "shear_max": shear,
        }
        return {
            "interfaces": {"lower_upper": interface},
            "regions": {"lower": {"von_mises_max": stress, "principal_min": -stress / 4}},
        }

    run = peaks(9.3, 0.050, 20.0, 3.0)
    others = (
        peaks(6.2, 0.049, 15.0, 2.8),  # on 2 h, half the steps
        peaks(4.0, 0.030, 11.0, 1.0),  # on 3 h, half the steps
        peaks(4.5, 0.035, 12.0, 1.5),  # on 3 h, all steps
    )
    unsettled = compared(run, this, *others)
    # Slip and shear stress change by 2 and 7 %, from the finest mesh to the next.
    assert list(unsettled.items()) == [
        ("lower_upper.pressure_max", [[1.0, 9.3], [2.0, 6.2], [3.0, 4.5]]),
        ("lower.von_mises_max", [[1.0, 20.0], [2.0, 15.0], [3.0, 12.0]]),
        ("lower.principal_min", [[1.0, -5.0], [2.0, -3.75], [3.0, -3.0]]),
    ]
    assert json.loads(json.dumps(unsettled)) == unsettled


def test_error_estimate_compares_maxima_on_solved_meshes() -> None:
    """A companion has failed, another has no such number. Steps alone do not suffice."""
    this = case("stages.0.increments=8")
    finer, coarser, _ = error_estimate.companions(this)
    run = {"interfaces": {"lower_upper": {"pressure_max": 9.0}}}

    def on(value: float | None) -> dict[str, Any]:
        return {"interfaces": {"lower_upper": {"pressure_max": value}}}

    expected = {"lower_upper.pressure_max": [[1.0, 9.0], [3.0, 4.0]]}
    assert error_estimate.add_error_estimates(run, this, [(coarser, on(4.0))]) == expected
    assert (
        error_estimate.add_error_estimates(run, this, [(finer, on(None)), (coarser, on(4.0))])
        == expected
    )
    assert (
        error_estimate.add_error_estimates(run, this, [(finer, {}), (coarser, on(4.0))]) == expected
    )
    steps = error_estimate.Companion(this, 1.0, 0.5)
    assert error_estimate.add_error_estimates(run, this, [(steps, on(4.0))]) == {}
    assert error_estimate.add_error_estimates(run, this, []) == {}


def test_error_estimate_raises_accidentally_small_errors() -> None:
    """Errors are raised to b times the median of all numbers, relative to the numbers.

    Peaks have none.
    """
    this = case("interfaces.lower_upper.friction_coefficient=0")
    values = {"slip_p99": 2.0, "slip_p95": 1.0, "slip_mean": 0.5, "gap_p99": 4.0}
    other = {"slip_p99": 2.2, "slip_p95": 1.1, "slip_mean": 0.55, "gap_p99": 4.0}
    run: dict[str, Any] = {"interfaces": {"lower_upper": values}}
    compared(run, this, {"interfaces": {"lower_upper": other}})
    factor, least = fitted_factors(SLIP_ERRORS)
    assert values["slip_p99_error"] == pytest.approx(max(0.2 * factor, 2.0 * 0.1 * least))
    _, least = fitted_factors(MOTION_ERRORS)
    assert values["gap_p99_error"] == pytest.approx(4.0 * 0.1 * least)


@pytest.mark.parametrize(
    ("key", "order", "factors"),
    [
        ("gap", 1, [1, 1, 1]),
        ("gap", 2, [1, 1, 1]),
        ("interference", 1, [1.2, 6.0, 1.6]),
        ("interference", 2, [3.5, 2.5, 1.0]),
    ],
)
def test_error_estimate_of_press_fits_is_larger(key: str, order: int, factors: list[float]) -> None:
    """The fitted factors of docs/verification.md apply to slips, tractions and motions."""
    changes = {"slip_p99": 0.3, "pressure_p95": 0.3, "gap_p99": 0.3}
    errors = dict[str, dict[str, float]]()
    for law in ("friction_coefficient=0", f"{key}=0.01 mm"):
        values: dict[str, float] = dict.fromkeys(changes, 1.0)
        run: dict[str, Any] = {"interfaces": {"lower_upper": values}}
        coarser = {k: 1.0 + change for k, change in changes.items()}
        this = case(
            f"interfaces.lower_upper.{law}",
            f"mesh.order={order}",
            "stages=[{name: insertion}, {name: press}]",
            "loads.press.history=[0, 1]",
        )
        compared(run, this, {"interfaces": {"lower_upper": coarser}})
        errors[law] = {k: values[f"{k}_error"] for k in changes}
    plain, fitted = errors.values()
    ratios = [fitted[k] / plain[k] for k in changes]
    assert ratios == pytest.approx(factors)


def test_error_estimate_by_an_order_alone_is_richardsons(monkeypatch: pytest.MonkeyPatch) -> None:
    """A change of 0.3 between h and 2 h at order 2 is an error of 0.3 / (2^2 - 1)."""
    wear = quantities.Quantity("interfaces", "wear", "mm", order=(1.0, 2.0))
    monkeypatch.setitem(quantities.TABLE["interfaces"], "wear", wear)
    this = case("interfaces.lower_upper.friction_coefficient=0")
    run = {"interfaces": {"lower_upper": {"wear": 1.0, "gap_p99": 1.0}}}
    compared(run, this, {"interfaces": {"lower_upper": {"wear": 1.3, "gap_p99": 9.0}}})
    assert run["interfaces"]["lower_upper"]["wear_error"] == pytest.approx(0.1)


def test_error_estimate_raises_strains_of_the_cortex() -> None:
    """A strain that is equal on two meshes gets the usual error, without strains in the median."""
    this = case("interfaces.lower_upper.friction_coefficient=0")

    def on(slip: float, strain: float) -> dict[str, Any]:
        femur = {"strain_medial_10": 1e-3, "strain_lateral_10": strain, "strain_medial_40": strain}
        return {"interfaces": {"lower_upper": {"slip_p99": slip}}, "femur": femur}

    run = on(1.0, 1e-3)
    compared(run, this, on(1.2, 1.5e-3))
    a, b = fitted_factors(STRESS_ERRORS)
    assert run["femur"]["strain_medial_10_error"] == pytest.approx(1e-3 * 0.2 * b)
    assert run["femur"]["strain_lateral_10_error"] == pytest.approx(0.5e-3 * a)


def test_error_estimate_of_gruen_zones() -> None:
    """Numbers are means of interfaces and strain energy.

    Zones without a value on the coarser mesh have none.
    """
    this = case("interfaces.lower_upper.friction_coefficient=0")

    def zone(by: float, *regions: str) -> dict[str, Any]:
        interface = {"gap_mean": 2.0 * by, "gap_max": 3.0, "area": 5.0}
        density = {region: 4.0 * by for region in regions}
        return {"interfaces": {"a_b": interface}, "strain_energy_density": density, "volume": {}}

    run = {"interfaces": {}, "gruen": {"1": zone(1.0, "cortex", "spongiosa"), "2": zone(1.0)}}
    other = {"interfaces": {}, "gruen": {"1": zone(1.1, "cortex")}}
    compared(run, this, other)
    first, second = run["gruen"]["1"], run["gruen"]["2"]
    # All change by a tenth, so that this is their median.
    a, b = fitted_factors(MOTION_ERRORS, of_part=True)
    assert first["interfaces"]["a_b"] == pytest.approx(
        {"gap_mean": 2, "gap_max": 3, "area": 5} | {"gap_mean_error": 0.2 * max(a, b)}
    )
    a, b = fitted_factors(STRESS_ERRORS, of_part=True)
    errors = first["strain_energy_density_error"]
    assert errors == pytest.approx({"cortex": 0.4 * max(a, b)})
    assert second == zone(1.0)


def test_error_estimate_raises_accidentally_small_errors_of_zones() -> None:
    """Errors are raised to b times the median of parts.

    Small values get the error of a quarter of the mean.
    """
    this = case("interfaces.lower_upper.friction_coefficient=0")

    def on(*pressures: float) -> dict[str, Any]:
        zones = {
            str(k): {"interfaces": {"a_b": {"pressure_mean": p}}, "strain_energy_density": {}}
            for k, p in enumerate(pressures)
        }
        return {"interfaces": {"a_b": {"pressure_mean": 3.0}}, "gruen": zones}

    run = on(4.0, 4.0, 4.0, 0.0, 8.0, 4.0)
    compared(run, this, on(4.8, 4.8, 4.0, 0.0, 9.6, 4.8) | {"interfaces": {"a_b": {}}})
    _, b = fitted_factors(MOTION_ERRORS, of_part=True)
    errors = [z["interfaces"]["a_b"]["pressure_mean_error"] for z in run["gruen"].values()]
    # The median change is a fifth, and the mean of the zones is 4.
    assert errors[2:4] == pytest.approx([0.2 * b * 4.0, 0.2 * b * 1.0])


def test_error_estimate_of_steps_on_one_coarser_mesh() -> None:
    this = case("stages.0.increments=8")
    first = error_estimate.companions(this)[0]
    half = error_estimate.Companion(first.case, 5 / 3, 0.5)
    run = numbers(1e-9, 8, 2)
    error_estimate.add_error_estimates(run, this, [(half, numbers(1e-9, 4, 2))])
    assert 0.5 < run["interfaces"]["lower_upper"]["slip_p99_error"] / (0.02 / 8) < 3


def heated(size: float, increments: float) -> dict[str, Any]:
    """Numbers of heat with an error of C h^1.5 + C' / n, for any order of the mechanics."""
    wrong = 0.01 * size**1.5 + 0.02 / increments
    region = {
        "temperature_max": 60 + 10 * wrong,
        "temperature_max_at": [size, 0.0, 0.0],
        "necrosis_47C_1min_depth": 2 + wrong,
        "volume_over_47": 100.0,
    }
    sides = {"temperature_max_first": 50 - wrong, "entropy_production_min": wrong}
    return numbers(size, increments, 2.0) | {
        "thermal": {"regions": {"lower": region}, "interfaces": {"lower_upper": sides}},
        # On coarse meshes the cure does not get as far.
        "cure": {"lower": {"time_50": 60 * (1 + wrong), "time_90": 100.0 if size == 1 else None}},
    }


def test_error_estimate_of_heat_follows_temperature() -> None:
    run, this = heated(1.0, 8), case("stages.0.increments=8")
    modelled(run, this, heated)
    # Both coarser meshes show the same error, that of the model: the larger factor counts.
    wrong, dose = (
        0.01 * (2**1.5 - 1) * factor + 0.02 / 8
        for factor in (
            max(error_classes.TEMPERATURE_ERRORS.two_mesh_factors or ()),
            error_classes.DOSE_ERRORS.change_factor(1),
        )
    )
    lower = run["thermal"]["regions"]["lower"]
    assert lower["temperature_max_error"] == pytest.approx(10 * wrong)
    assert lower["necrosis_47C_1min_depth_error"] == pytest.approx(dose)
    # It is the same on both meshes: raised to what is usual.
    assert 0.1 < lower["volume_over_47_error"] / (100 * dose) < 1
    assert "temperature_max_at_error" not in lower
    sides = run["thermal"]["interfaces"]["lower_upper"]
    assert sides["temperature_max_first_error"] == pytest.approx(wrong)
    assert "entropy_production_min_error" not in sides
    cure = run["cure"]["lower"]
    assert cure["time_50_error"] == pytest.approx(60 * dose) and "time_90_error" not in cure
    # The mechanics keep their steps.
    assert "slip_p99_error" in run["interfaces"]["lower_upper"]


def test_error_estimate_of_heat_sees_two_meshes_that_agree_by_chance() -> None:
    """The third mesh then shows the change, with order 1.5. A mesh alone has its larger factor."""

    def hottest(size: float, increments: float) -> dict[str, Any]:
        temperatures = {1.0: 60.0, 2.0: 60.0, 3.0: 58.0}
        region = {"temperature_max": temperatures[size]}
        return numbers(size, increments, 2.0) | {"thermal": {"regions": {"lower": region}}}

    run = hottest(1.0, 8)
    modelled(run, case("stages.0.increments=8"), hottest)
    factors = error_classes.TEMPERATURE_ERRORS.two_mesh_factors or (0.0, 0.0)
    expected = factors[1] * 2.0 * (2**1.5 - 1) / (3**1.5 - 1)
    assert run["thermal"]["regions"]["lower"]["temperature_max_error"] == pytest.approx(expected)
    steady = support.case(HEAT, "stages=[{name: cool, steady: true}]")
    run, coarser = ({"thermal": {"regions": {"lower": {"temperature_max": t}}}} for t in (60, 59))
    compared(run, steady, coarser)
    alone, _ = fitted_factors(error_classes.TEMPERATURE_ERRORS)
    assert run["thermal"]["regions"]["lower"]["temperature_max_error"] == pytest.approx(alone)


# Numbers of the stance at 3.2 mm, which 6 mm of the shipped case is compared with.
FINE = {
    "interfaces.stem_cement.gap_p99": 0.012550757986773763,
    "interfaces.stem_cement.slip_p99": 0.037195056656912286,
    "interfaces.stem_cement.motion_p99": 0.043119016753416964,
    "interfaces.stem_cement.pressure_p95": 2.843618287465198,
    "interfaces.stem_cement.shear_p95": 1.1438726068938057,
    "interfaces.cement_bone.gap_p99": 0.017140529255418528,
    "interfaces.cement_bone.slip_p99": 0.017449361712497613,
    "interfaces.cement_bone.motion_p99": 0.029126118700084108,
    "interfaces.cement_bone.pressure_p95": 1.341730849338463,
    "interfaces.cement_bone.shear_p95": 0.790792046503162,
}


def test_error_estimate_of_the_stance_covers_a_finer_mesh() -> None:
    """Each of ten numbers lies within its error."""
    stance = frozen()["stance"]
    off = []
    for name, fine in FINE.items():
        value = stance[f".:summary.{name}"]
        error = stance[f".:summary.{name}_error"]
        off.append(abs(value - fine) / error)
    assert max(off) <= 1, sorted(off)


def test_error_estimate_ignores_zero_numbers() -> None:
    """Numbers of rounding and a slip made by the mesh leave the median.

    Other numbers keep their errors.
    """
    this = case("interfaces.lower_upper.friction_coefficient=0")

    def on(size: float) -> dict[str, Any]:
        wrong = 1 + 1e-3 * size
        rounding = {"gap_p99": 3e-18 * size, "gap_p95": 1e-18 / size, "shear_p95": 1e-14 / size}
        made = {"slip_p99": 4e-6 * size**2, "slip_mean": 1e-6 * size**2, "slip_max": 1e-5 * size**2}
        right = {"pressure_p95": 2 * wrong, "motion_p99": 0.004 * wrong}
        return {"interfaces": {"lower_upper": rounding | made | right}}

    run = on(1.0)
    assert compared(run, this, on(2.0)) == {}
    q = run["interfaces"]["lower_upper"]
    _, b = fitted_factors(error_classes.TRACTION_ERRORS)
    assert q["pressure_p95_error"] == pytest.approx(b * 2e-3, rel=0.01)
    assert q["motion_p99_error"] < 2e-3 * q["motion_p99"]
    # A change of the other kind counts: a slip as large as the motion.
    large = {"interfaces": {"lower_upper": {"slip_p99": 0.004, "motion_p99": 0.004}}}
    compared(large, this, {"interfaces": {"lower_upper": {"slip_p99": 0.009, "motion_p99": 0.004}}})
    assert large["interfaces"]["lower_upper"]["slip_p99_error"] > 0.002


@pytest.mark.parametrize("jump", [0.0, 1e-13])
def test_error_estimate_ignores_zero_temperature_jumps(jump: float) -> None:
    this = support.case(HEAT, "stages=[{name: cool, steady: true}]")

    def on(size: float) -> dict[str, Any]:
        sides = {"temperature_max_first": 50 - 0.01 * size, "temperature_jump_max": jump * size}
        region = {"temperature_max": 50 - 0.01 * size, "temperature_mean": 40 + 0.01 * size}
        return {"thermal": {"regions": {"lower": region}, "interfaces": {"a_b": sides}}}

    run, (a, _) = on(1.0), fitted_factors(error_classes.TEMPERATURE_ERRORS)
    compared(run, this, on(2.0))
    sides = run["thermal"]["interfaces"]["a_b"]
    assert sides["temperature_max_first_error"] == pytest.approx(0.01 * a)
    assert (sides.get("temperature_jump_max_error") or 0.0) < 1e-11
