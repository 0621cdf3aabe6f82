"""Keys of a hip without cement: accepted and refused ones."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from app.case.case import load_case
from app.foundation.errors import InputError
from tests.support import CONFIGS

STANCE = CONFIGS / "stance.yaml"
NO_CEMENT = ("geometry.cement_thickness=0 mm", "regions.cement=null")
NO_LAWS = ("interfaces.stem_cement=null", "interfaces.cement_bone=null")
LAW = ("interfaces.stem_bone={kind: contact, friction_coefficient: 0.5}",)


def refused(*overrides: str, path: Path = STANCE) -> list[str]:
    """Lines of the message with which a case is refused."""
    with pytest.raises(InputError) as error:
        load_case(path, overrides)
    return str(error.value).splitlines()


def test_hips_without_cement_have_one_interface_and_a_void() -> None:
    geometry = load_case(STANCE, (*NO_CEMENT, *NO_LAWS, *LAW)).config.geometry
    assert geometry.region_names == ("stem", "cortical_bone", "cancellous_bone")
    assert list(geometry.interface_sides) == ["stem_bone"]
    assert geometry.mantles == ()
    assert geometry.implant.tip_void == 5.0
    assert load_case(STANCE).config.geometry.implant.tip_void == 0.0


def test_hips_without_cement_say_in_one_line_what_a_base_lacks() -> None:
    (line,) = refused("geometry.cement_thickness=0 mm")
    assert "`regions: {cement: null}`" in line
    assert "stem_cement: null, cement_bone: null, stem_bone: {kind: contact" in line


def test_hips_without_cement_name_the_options_that_a_base_needs() -> None:
    (line,) = refused("geometry.cement_thickness=0 mm")
    command = line.partition("on the command line, add `")[2].removesuffix("`")
    words = shlex.split(command)
    assert words[::2] == ["--set"] * 4
    load_case(STANCE, ("geometry.cement_thickness=0 mm", *words[1::2]))


def test_hips_without_cement_need_a_law() -> None:
    (line,) = refused(*NO_CEMENT, *NO_LAWS)
    assert "no law for stem_bone" in line
    assert load_case(STANCE, (*NO_CEMENT, *NO_LAWS, "interfaces.stem_bone={kind: bonded}")).config


@pytest.mark.parametrize(
    ("thickness", "text"),
    [
        ("0.5 mm", "must be 0 (a stem without cement) or at least 1 mm"),
        ("{proximal: 2 mm, distal: 0 mm}", "'0 mm' must be at least 1 mm"),
    ],
)
def test_hips_refuse_thin_and_partly_absent_cement(thickness: str, text: str) -> None:
    assert text in refused(f"geometry.cement_thickness={thickness}")[0]


def test_hips_without_cement_refuse_cells_through_it() -> None:
    (line,) = refused(*NO_CEMENT, *NO_LAWS, *LAW, "mesh.through_cement=3")
    assert "there is no cement; leave through_cement out" in line


def test_hips_heights_on_the_stem_begin_at_its_tip() -> None:
    geometry = load_case(
        STANCE, (*NO_CEMENT, *NO_LAWS, *LAW, "geometry.tip_void=0 mm")
    ).config.geometry
    tip = geometry.placement.to_model([[0.0, 0.0, geometry.implant.tip_z]])
    shoulder = geometry.placement.to_model([[0.0, 0.0, geometry.implant.shoulder]])
    assert geometry.height_on_stem(tip)[0] == pytest.approx(0.0)
    assert geometry.height_on_stem(shoulder)[0] == pytest.approx(geometry.implant.length)
    assert not geometry.on_flanks(tip)[0]
    assert not geometry.on_flanks(2 * shoulder - tip)[0]
    assert geometry.on_flanks(0.5 * (tip + shoulder))[0]


@pytest.mark.parametrize(("zone", "is_refused"), [("above: 300 mm", True), ("above: 30 mm", False)])
def test_hips_refuse_zones_that_cover_nothing_of_the_stem(zone: str, is_refused: bool) -> None:
    """A coating from 300 mm on a stem of 147 mm is an error."""
    option = f"interfaces.stem_bone.zones={{coated: {{{zone}}}}}"
    if is_refused:
        (line,) = refused(option, path=CONFIGS / "pressed.yaml")
        assert "zones.coated: covers nothing of the stem; expected heights from 0 to 147 mm" in line
    else:
        load_case(CONFIGS / "pressed.yaml", (option,))


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        (
            "interference",
            "[[-120 mm, 0 mm], [-20 mm, 0.02 mm]]",
            r"interference\[0\]: -120 mm is below",
        ),
        (
            "interference",
            "[[0 mm, 0 mm], [800 mm, 0.02 mm]]",
            r"interference\[1\]: 800 mm is above",
        ),
        ("zones", "{coated: {above: -30 mm}}", "zones.coated.above: -30 mm is below"),
        (
            "zones",
            "{coated: {interference: [[0 mm, 0 mm], [148 mm, 0.02 mm]]}}",
            r"zones.coated.interference\[1\]: 148 mm is above",
        ),
    ],
)
def test_hips_refuse_heights_off_the_stem(key: str, value: str, text: str) -> None:
    """The coordinate z of the model is given in place of the height above the tip."""
    messages = refused(f"interfaces.stem_bone.{key}={value}", path=CONFIGS / "pressed.yaml")
    expected = f"{text} the stem; expected heights from 0 to 147 mm above its tip"
    assert any(re.search(expected, message) for message in messages)
    fitting = "interfaces.stem_bone.interference=[[0 mm, 0 mm], [147 mm, 0.02 mm]]"
    load_case(CONFIGS / "pressed.yaml", (fitting,))


def test_hips_refuse_a_zone_with_the_name_of_a_part() -> None:
    """Numbers of the zone would have the names of those of the rim."""
    change = "interfaces.stem_bone.zones={rim: {above: 80 mm, friction_coefficient: 0.6}}"
    (line,) = refused(change, path=CONFIGS / "pressed.yaml")
    assert "zones.rim: results have a part 'rim' of each interface; choose another name" in line
