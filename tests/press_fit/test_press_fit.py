"""A press fit: interference by place, motion since the insertion, messages."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import app.extensions  # noqa: F401 (registers the package)
import mantle
from app.case.case import load_case
from app.foundation.errors import ConvergenceError, InputError
from app.foundation.verdict import Verdict
from app.laws.contact_laws import Contact
from app.laws.interface_laws import insertion_stages
from app.laws.values import gap_settled
from app.press_fit.findings import _beyond_yield, _ingrowth, _raised_collar
from app.results.closing_lines import headline
from app.results.hip import of_collar
from app.results.verdicts import _RESULT_VERDICTS
from app.scene.scene import build_scene
from app.soundness import preview
from configs import FOLDER as CONFIGS
from tests import support

# Two equal blocks between held ends: an interference, then a shift of the upper end along x.
PRESSED = """
geometry:
  kind: blocks
  blocks:
    - {name: bone, size: [4 mm, 4 mm, 4 mm]}
    - {name: metal, size: [4 mm, 4 mm, 4 mm]}
mesh: {order: 1, size: 2 mm}
regions:
  bone: {youngs_modulus: 1 GPa, poisson_ratio: 0}
  metal: {youngs_modulus: 1 GPa, poisson_ratio: 0}
interfaces:
  bone_metal: {kind: contact, friction_coefficient: 0, interference: 0.02 mm}
supports:
  floor: {kind: fixed, boundary: bottom}
  top: {kind: displacement, boundary: top, x: 0.03 mm, y: 0 mm, z: 0 mm, history: [0, 1]}
stages: [{name: insertion}, {name: shift}]
"""
INTERFERENCE = 0.02  # mm
SHIFT = 0.03  # mm


def law(**keys: object) -> Contact:
    return Contact.model_validate({"kind": "contact", "friction_coefficient": 0.3, **keys})


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({"interference": "-0.02 mm"}, "must not be negative"),
        ({"interference": "2 mm"}, "must be at most 1"),
        ({"zones": {"a": {"above": "9 mm", "below": "8 mm"}}}, "not above 9 mm"),
        ({"interference": [["9 mm", "0 mm"], ["8 mm", "0 mm"]]}, "height is not above"),
    ],
)
def test_press_fit_refuses(keys: dict[str, object], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        law(**keys)


def test_press_fit_gap_settles_when_it_last_changes() -> None:
    fit, clearance = np.array([-0.02, 0.0]), np.array([0.1])
    assert gap_settled(fit, ()) == 1.0
    assert gap_settled(clearance, ()) == 0.0
    assert gap_settled(fit, (0.5, 1.0, 1.0)) == 2.0
    assert gap_settled(fit, (0.0, 0.0, 1.0)) == 3.0


def test_press_fit_micromotion_is_without_the_insertion(tmp_path: Path) -> None:
    """Without friction the upper block slides by the shift as a rigid body."""
    results = support.run(PRESSED, tmp_path / "case", "output.report=false")
    q = results.summary["interfaces"]["bone_metal"]
    for key in ("mean", "p95", "p99", "max"):
        assert q[f"micromotion_{key}"] == pytest.approx(SHIFT, rel=1e-6)
    assert q["motion_p99"] == pytest.approx(np.hypot(SHIFT, INTERFERENCE), rel=1e-6)
    assert q["area_micromotion_over_40um"] == 0.0
    # Both blocks take half of the interference: E times the strain of each.
    pressure = 1000.0 * (INTERFERENCE / 2) / 4.0
    assert q["insertion_pressure_mean"] == pytest.approx(pressure, rel=1e-6)
    texts = [v["what"] for v in results.summary["verdicts"] if v.get("where") == "ingrowth"]
    assert texts[0].startswith("100 % of bone_metal moves less than 40 µm")


def test_press_fit_subsidence_counts_from_the_end_of_the_insertion(tmp_path: Path) -> None:
    """The upper block rises by the interference from the lower one, then slides.

    All meshes give the exact motion, so its error is zero. The companions of the error estimate
    count from the end of the insertion, too.
    """
    results = support.run(
        PRESSED,
        tmp_path / "case",
        "output.report=false",
        "output.error=true",
        "regions.bone.tissue=bone",
        "regions.metal.tissue=implant",
    )
    stem = results.summary["stem"]
    assert stem["insertion_subsidence"] == pytest.approx(-INTERFERENCE, rel=1e-6)
    assert stem["subsidence"] == pytest.approx(0.0, abs=1e-6 * INTERFERENCE)
    assert stem["subsidence_error"] == pytest.approx(0.0, abs=1e-6 * INTERFERENCE)
    assert stem["insertion_subsidence_error"] == pytest.approx(0.0, abs=1e-6 * INTERFERENCE)
    assert results.step_record["stem subsidence [mm]"] == pytest.approx(0.0, abs=1e-8)


def test_press_fit_zones_have_the_pressure_after_the_insertion(tmp_path: Path) -> None:
    zones = "interfaces.bone_metal.zones={coated: {above: 2 mm}, below: {below: 2 mm}}"
    results = support.run(PRESSED, tmp_path / "case", "output.report=false", zones)
    numbers = results.summary["interfaces"]["bone_metal"]["zones"]
    # The interface is above 2 mm; pressure as without zones.
    pressure = 1000.0 * (INTERFERENCE / 2) / 4.0
    assert list(numbers) == ["coated"]
    assert numbers["coated"]["insertion_pressure_mean"] == pytest.approx(pressure, rel=1e-6)


def raised_collar(
    rise: float, gap_mean: float, gap_p95: float, open_fraction: float
) -> list[Verdict]:
    """Verdicts on a collar by the rise of its stem and its gaps [mm] after the insertion."""
    collar: Any = {
        "insertion_gap_mean": gap_mean,
        "insertion_gap_p95": gap_p95,
        "insertion_open_fraction": open_fraction,
        "insertion_pressure_max": 0.08,
    }
    summary: Any = {
        "interfaces": {"collar_bone": collar},
        "stem": {"insertion_subsidence": -rise},
    }
    return [*_raised_collar(summary)]


def test_press_fit_raises_a_collar() -> None:
    """A collar with a corner in contact is raised, too.

    A seated one or one with a clearance is not.
    """
    (verdict,) = raised_collar(0.0158, 0.0129, 0.0158, 0.97)
    assert "raises the stem by 15.8 um" in verdict.what and "-0.016 mm" in verdict.remedy
    assert "97 % of its collar is off the bone, by 12.9 um in the mean" in verdict.what
    for other_gap in (1.0158, 0.001, 0.0):
        assert not raised_collar(0.0158, other_gap, 0.0158, 0.97)


def test_press_fit_collar_with_a_gap_is_raised_only_if_most_of_it_is_off_the_bone() -> None:
    """The collar is tilted. The stem rises by 7.8 and 8.9 um at gaps of -0.007 and -0.016 mm."""
    (verdict,) = raised_collar(0.0078, 0.0044, 0.0085, 0.65)
    assert "change the `gap` of interfaces.collar_bone by -0.009 mm" in verdict.remedy
    assert "seat" not in verdict.remedy
    assert not raised_collar(0.0089, 0.0055, 0.0085, 0.35)


def test_press_fit_collar_that_the_flanks_pull_has_no_share() -> None:
    case = load_case(CONFIGS / "collar.yaml").config
    forces = {"collar_bone": [0.0, 0.0, -900.0], "stem_bone": [0.0, 0.0, -100.0]}
    numbers = of_collar(case, {name: {"force": force} for name, force in forces.items()})
    assert numbers["collar_share"] == pytest.approx(0.9)
    forces["stem_bone"] = [0.0, 0.0, 500.0]
    numbers = of_collar(case, {name: {"force": force} for name, force in forces.items()})
    assert "collar_share" not in numbers and numbers["flank_force"] < 0.0
    stem = dict.fromkeys(("subsidence", "retroversion", "varus", "insertion_subsidence"), 0.0)
    texts = [*headline({"stem": stem | numbers})]
    assert texts[-1].endswith("they pull it onto the collar (-500 N)")


@pytest.mark.parametrize(
    ("key", "place"),
    [
        ("stem_bone.interference=0.5 mm", "interfaces.stem_bone.interference: presses bone by 0.5"),
        ("stem_bone.interference=[[0 mm, 0 mm], [80 mm, 0.2 mm]]", "presses bone by 0.2 mm"),
        ("stem_bone.zones={a: {above: 80 mm, interference: 0.3 mm}}", "zones.a.interference"),
        ("collar_bone.gap=-0.5 mm", "interfaces.collar_bone.gap: is an interference of 0.5 mm"),
    ],
)
def test_press_fit_notes_an_interference_that_bone_does_not_bear(key: str, place: str) -> None:
    case = load_case(CONFIGS / "collar.yaml", (f"interfaces.{key}",)).config
    (text,) = (str(v) for v in preview.input_notes(case) if "not crushed" in v.what)
    assert place in text
    usual = load_case(CONFIGS / "collar.yaml", ("interfaces.collar_bone.gap=-0.016 mm",)).config
    assert not [v for v in preview.input_notes(usual) if "not crushed" in v.what]


def test_press_fit_strain_after_the_insertion_is_that_of_the_pressure(tmp_path: Path) -> None:
    """A bar is pressed along z.

    The strain is half of the interference over its length, without hoop.
    """
    results = support.run(
        PRESSED,
        tmp_path / "case",
        "output.report=false",
        "regions.bone.tissue=bone",
        "regions.metal.tissue=implant",
    )
    q = results.summary["regions"]["bone"]
    assert q["insertion_compressive_strain_p99"] == pytest.approx(INTERFERENCE / 2 / 4, rel=1e-6)
    of_interface = results.summary["interfaces"]["bone_metal"]
    for key in ("gap_mean", "gap_p95", "open_fraction"):
        assert of_interface[f"insertion_{key}"] == pytest.approx(0.0, abs=1e-9)


def test_press_fit_with_an_elastic_layer_says_its_compression(tmp_path: Path) -> None:
    """Blocks of 4 mm and a layer are in series.

    The pressure is the interference over the sum of compliances.
    """
    layer = "interfaces.bone_metal.elastic_layer={normal: 100 MPa/mm, tangential: 100 MPa/mm}"
    results = support.run(PRESSED, tmp_path / "case", "output.report=false", layer)
    compression = INTERFERENCE / (1.0 / 100.0 + 8.0 / 1000.0) / 100.0
    q = results.summary["interfaces"]["bone_metal"]
    assert q["compression_max"] == pytest.approx(compression, rel=1e-6)
    (text,) = (v["what"] for v in results.summary["verdicts"] if v.get("where") == "contact")
    assert "the elastic layer of bone_metal is compressed by up to 11 µm" in text.replace(
        "um", "µm"
    )


def test_press_fit_ingrowth_counts_the_motion_of_the_last_cycle(tmp_path: Path) -> None:
    """The upper block slides by the shift and returns to a tenth.

    So 0.9 times the shift is inducible. With a shift of 0.2 mm the whole area moves by more than
    150 um. A stage without cycles after it has no inducible motion.
    """
    far = "supports.top.x=0.2 mm"
    cycles = "stages=[{name: insertion}, {name: shift, cycles: 2}]"
    results = support.run(PRESSED, tmp_path / "a", "output.report=false", far, cycles)
    q = results.summary["interfaces"]["bone_metal"]
    assert q["inducible_p99"] == pytest.approx(0.18, rel=1e-6)
    assert q["area_inducible_over_150um"] == pytest.approx(q["area"])
    (text,) = (v["what"] for v in results.summary["verdicts"] if v.get("where") == "ingrowth")
    assert "100 % more than 150 µm. The motion is inducible, from the last valley" in text
    rest = "stages=[{name: insertion}, {name: shift, cycles: 2}, {name: rest}]"
    history = "supports.top.history=[0, 1, 0.1]"
    results = support.run(PRESSED, tmp_path / "b", "output.report=false", far, rest, history)
    assert "inducible_p99" not in results.summary["interfaces"]["bone_metal"]
    assert results.summary["cycles"]["shift"]["inducible"]["bone_metal"]["micromotion_p99"] == (
        pytest.approx(0.18, rel=1e-6)
    )


def test_press_fit_ingrowth_counts_the_stage_with_the_largest_area(tmp_path: Path) -> None:
    """Peaks of 0.2 and 0.03 mm return to a tenth: 0.18 and 0.027 mm are inducible."""
    results = support.run(
        PRESSED,
        tmp_path / "a",
        "output.report=false",
        "supports.top.x=0.2 mm",
        "supports.top.history=[0, 1, 0, 0.15]",
        "stages=[{name: insertion}, {name: far, cycles: 2}, {name: rest}, {name: near, cycles: 2}]",
    )
    q, cycles = results.summary["interfaces"]["bone_metal"], results.summary["cycles"]
    assert q["area_inducible_over_40um"] == 0.0
    far, near = (cycles[stage]["areas"]["bone_metal"] for stage in ("far", "near"))
    assert far["area_inducible_over_150um"] == pytest.approx(16.0)
    assert near["area_inducible_over_40um"] == 0.0
    (text,) = (v["what"] for v in results.summary["verdicts"] if v.get("where") == "ingrowth")
    assert text.startswith("0 % of bone_metal moves less than 40 µm, 100 % more than 150 µm")
    assert "last peak of stage 'far', which has the largest area above 40 µm of 2 stages" in text


def test_press_fit_ingrowth_is_that_of_bone_alone() -> None:
    """Cement has a volume under tension; bone around a stem has a hoop strain."""
    q = {"area": 200.0, "area_micromotion_over_40um": 50.0, "area_micromotion_over_150um": 2.0}
    cement, bone = {"volume_over_3_MPa": 1.0}, {"insertion_hoop_strain_p99": 0.001}
    regions = {"stem": {}, "cement": cement, "cancellous_bone": bone}
    for name, count in (("stem_cement", 0), ("stem_sleeve", 0), ("stem_bone", 1)):
        summary: Any = {"interfaces": {name: q}, "regions": regions}
        assert len([*_ingrowth(summary)]) == count
    (verdict,) = _ingrowth({"interfaces": {"bone_metal": q}, "regions": {"bone": {}, "metal": {}}})
    assert "no cycles" not in verdict.what


def test_press_fit_loads_need_a_stage_after_the_insertion(tmp_path: Path) -> None:
    path = tmp_path / "case.yaml"
    load_ = "loads: {push: {kind: pressure, boundary: top, pressure: 1 MPa}}\n"
    path.write_text(PRESSED + load_)
    with pytest.raises(InputError, match="loads act during it: push"):
        load_case(path)
    one = ("stages=[{name: fit}]", "supports.top=null")
    with pytest.raises(InputError, match=r"stages: the interference grows until the end"):
        load_case(path, one)
    assert load_case(path, ("loads.push.history=[0, 1]",)).config


@pytest.mark.parametrize("history", ["[0.5, 1]", "[1, 0]"])
def test_press_fit_refuses_histories_that_act_during_it(history: str, tmp_path: Path) -> None:
    path = tmp_path / "case.yaml"
    path.write_text(PRESSED)
    shift = f"supports.top.history={history}"
    with pytest.raises(
        InputError, match=r"top.history: .* but supports move bodies during it: top"
    ):
        load_case(path, (shift,))
    keys = f"{{kind: pressure, boundary: top, pressure: 1 MPa, history: {history}}}"
    message = r"loads act during it: push. .* up to the end of 'insert.*; if 'insert\w*' is no part"
    with pytest.raises(InputError, match=message):
        load_case(path, (f"loads.push={keys}",))
    later = (
        "interfaces.bone_metal.gap_history=[0, 1, 1]",
        "stages=[{name: a}, {name: b}, {name: c}]",
    )
    with pytest.raises(InputError, match=r"end of 'b', e.g. `history: \[0, 0, 1\]"):
        load_case(path, (*later, "supports.top=null", "loads.push=" + keys.replace("]", ", 1]")))


def test_press_fit_cycle_tables_act_after_it(tmp_path: Path) -> None:
    """The force is 0 in the insertion, grows to its first row, then follows its table."""
    path = tmp_path / "case.yaml"
    table = '["time [s], factor [%]", "0, 100", "1, 20", "2, 100"]'
    force = f'{{kind: force, boundary: top, force: "[0, 30, -40] N", cycle_table: {table}}}'
    path.write_text(PRESSED + f"loads:\n  hip: {force}\n")
    of_case = ("supports.top=null", "stages=[{name: press}, {name: rise}, {name: gait}]")
    scene = build_scene(load_case(path, of_case).config)
    sizes = scene.force_sizes(np.array([0.5, 1.0, 1.5, 2.0, 2.5, 3.0]))["hip"]
    assert sizes == pytest.approx([0, 0, 25, 50, 10, 50])
    sudden = load_case(path, (*of_case[:1], "stages=[{name: press}, {name: gait}]")).config
    (note,) = (v for v in preview.input_notes(sudden) if "cycle begins" in v.what)
    assert "first stage after the insertion" in note.what and "{name: rise}" in note.remedy
    with pytest.raises(InputError, match=r"end of the last stage; .* \{name: rise\}, \{name: gait"):
        load_case(path, (*of_case[:1], "stages=[{name: gait}]"))


def test_press_fit_by_a_negative_gap_comes_before_the_loads() -> None:
    """A gap that is an interference counts on the interfaces of which micromotion is reported."""
    fit, clearance = law(gap="-0.02 mm"), law(gap="0.02 mm")
    assert insertion_stages({"stem_bone": fit}, ("stem_bone",)) == 1
    assert insertion_stages({"stem_bone": fit}, ()) == 0
    assert insertion_stages({"stem_bone": clearance}, ("stem_bone",)) == 0
    zone = law(zones={"a": {"above": "1 mm", "gap": "-0.01 mm"}})
    assert insertion_stages({"stem_bone": zone}, ("stem_bone",)) == 1


def test_press_fit_findings_say_areas_and_strains() -> None:
    q = {"area": 200.0, "area_micromotion_over_40um": 50.0, "area_micromotion_over_150um": 2.0}
    (verdict,) = _ingrowth({"interfaces": {"stem_bone": q, "other": {"area": 1.0}}})
    assert verdict.what.startswith("75 % of stem_bone moves less than 40 µm, 1 % more than 150 µm")
    assert "so it has a permanent part. To see the" in verdict.what
    assert "beyond" not in verdict.what
    q |= {"area_inducible_over_40um": 20.0, "area_inducible_over_150um": 0.0}
    (verdict,) = _ingrowth({"interfaces": {"stem_bone": q}})
    assert verdict.what.startswith("90 % of stem_bone moves less than 40 µm, 0 % more")
    assert "inducible, from the last valley to the last peak" in verdict.what


def test_press_fit_ingrowth_counts_the_rim_apart() -> None:
    """A coating is at the rim, which moves most: its areas are not those of the rest."""
    q = {"area": 200.0, "area_micromotion_over_40um": 0.0, "area_micromotion_over_150um": 0.0}
    rim = {"area": 20.0, "area_micromotion_over_40um": 15.0, "area_micromotion_over_150um": 5.0}
    (verdict,) = _ingrowth({"interfaces": {"stem_bone": q | {"rim": rim, "tip": {"area": 3.0}}}})
    assert verdict.what.startswith(
        "100 % of stem_bone without its rim and tip moves less than 40 µm, 0 % more than 150 µm;"
        " 25 % of its rim moves less than 40 µm, 25 % more than 150 µm. "
    )


def test_press_fit_ingrowth_states_the_area_that_does_not_touch_bone() -> None:
    """The interface and each zone have an area, above 5 % of their area."""
    moving = {"area": 200.0, "area_micromotion_over_40um": 22.0, "area_micromotion_over_150um": 0.0}
    q = moving | {"open_fraction": 0.387, "gap_p99": 0.1706}
    q["zones"] = {
        "reamed": moving | {"open_fraction": 0.952, "gap_p99": 0.2014},
        "coated": moving | {"open_fraction": 0.008, "gap_p99": 0.0006},
    }
    (verdict,) = _ingrowth({"interfaces": {"stem_bone": q}})
    of_stem, of_reamed, of_coated, *_ = verdict.what.replace(". This motion", "; This").split("; ")
    assert of_stem == (
        "89 % of stem_bone moves less than 40 µm, 0 % more than 150 µm, and 39 % does not touch the"
        " bone (gap 171 µm, p99)"
    )
    assert of_reamed.endswith("and 95 % does not touch the bone (gap 201 µm, p99)")
    assert of_coated == "89 % of zone coated moves less than 40 µm, 0 % more than 150 µm"


def test_press_fit_says_that_bone_yields_before_the_ingrowth() -> None:
    q = {"area": 200.0, "area_micromotion_over_40um": 0.0, "area_micromotion_over_150um": 0.0}
    interfaces = {"stem_bone": q | {"insertion_pressure_p95": 27.0}}
    regions = {
        "a": {"insertion_hoop_strain_p99": 0.006, "insertion_compressive_strain_p99": 0.0065},
        "b": {"insertion_hoop_strain_p99": 0.008, "insertion_compressive_strain_p99": 0.009},
    }
    summary = {"interfaces": interfaces, "regions": regions}
    hoop, compressed = _beyond_yield(summary)
    assert "strains b by 8000 um/m" in hoop.what and "compresses b by 9000 um/m" in compressed.what
    assert hoop.remedy == "reduce the interference of stem_bone"
    (ingrowth,) = _ingrowth(summary)
    assert "the insertion strains bone beyond its yield" in ingrowth.what
    assert _RESULT_VERDICTS.index(_beyond_yield) < _RESULT_VERDICTS.index(
        _ingrowth
    )  # the warning is printed first


def test_press_fit_without_friction_expels_the_stem(tmp_path: Path) -> None:
    """No bone above its shoulder holds it: a taper that is pressed without friction slides out."""
    changes = {
        "mesh.size": "12 mm",
        "interfaces.stem_bone.friction_coefficient": 0,
        "interfaces.stem_bone.elastic_layer": None,
        "loads.history": [0, 0],
        "output.error": False,
    }
    with pytest.raises(ConvergenceError, match="body 'stem'"):
        mantle.run(mantle.load(CONFIGS / "pressed.yaml", **changes), tmp_path)


def test_press_fit_refuses_reaming_for_cement() -> None:
    """The space between the canal and the stem would be filled with bone."""
    with pytest.raises(InputError, match=r"geometry\.canal_widening: is for cemented stems"):
        mantle.load(CONFIGS / "pressed.yaml", **{"geometry.canal_widening": "3 mm"})


def test_press_fit_shear_obeys_the_elastic_layer(tmp_path: Path) -> None:
    """Shear is the stiffness, 20 MPa/mm, times the elastic part of the motion.

    The edge of the tip obeys this too, where friction on a face could carry the pressure of
    another.
    """
    changes = {"mesh.size": "12 mm", "geometry.tip_void": "0 mm", "output": {"error": False}}
    run = mantle.run(mantle.load(CONFIGS / "pressed.yaml", **changes), tmp_path)
    numbers = run.summary["interfaces"]["stem_bone"]
    for part in (numbers, numbers["tip"], numbers["rim"]):
        # The layer has a thirtieth of the bodies' stiffness at most points and a tenth at a few.
        # So a tenth of the recovered change counts there.
        assert 0.3 < part["shear_max"] < 1.03 * 20 * part["motion_max"]


@pytest.mark.parametrize("size", [12, 20])
def test_press_fit_of_straight_cells_converges(size: int, tmp_path: Path) -> None:
    """Corners of the stem are round, although facets of coarse cells meet there at 45 degrees.

    Two faces per corner make friction of 0.3 without an elastic layer diverge with all solvers.
    """
    changes = {
        "mesh": {"size": f"{size} mm", "order": 1},
        "interfaces.stem_bone.elastic_layer": None,
        "interfaces.stem_bone.friction_coefficient": 0.3,
        "interfaces.stem_bone.interference": "0.008 mm",
        "output": {"error": False},
    }
    run = mantle.run(mantle.load(CONFIGS / "pressed.yaml", **changes), tmp_path)
    assert run.summary["solver"]["newton_iterations"] <= 30
