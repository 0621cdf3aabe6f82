"""Notes on implausible input (`app/soundness/preview.py`)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import mantle
import meshes
from app.case.case import Case, load_case
from app.soundness import preview
from tests import support
from tests.soundness.judged import TWO, judged
from tests.support import CONFIGS, build


def texts(case: Case) -> list[str]:
    return [v.text for v in preview.input_notes(case)]


def test_preview_notes_input_without_effect() -> None:
    notes = texts(mantle.load(CONFIGS / "stance.yaml").config)
    assert not any("friction_coefficient" in n or "fixes" in n for n in notes)
    changes = {
        "loads.hip.boundary": "distal_cut",
        "interfaces.cement_bone.friction_coefficient": 6.5,
    }
    notes = texts(mantle.load(CONFIGS / "stance.yaml", **changes).config)
    assert any(n.startswith("loads.hip: acts on distal_cut, which supports.shaft") for n in notes)
    assert any(n.startswith("interfaces.cement_bone.friction_coefficient is 6.5") for n in notes)
    zone = {"distal": {"below": "20 mm", "friction_coefficient": 30}}
    changes = {"interfaces.cement_bone.zones": zone}
    notes = texts(mantle.load(CONFIGS / "stance.yaml", **changes).config)
    assert not any(n.startswith("interfaces.cement_bone.friction_coefficient") for n in notes)
    assert any(
        n.startswith("interfaces.cement_bone.zones.distal.friction_coefficient is 30")
        for n in notes
    )


@pytest.mark.parametrize(
    ("key", "note"),
    [
        ("gap: -0.5 mm", "interfaces.stem_cement.gap: is an interference of 0.5 mm"),
        ("zones: {a: {above: 8 mm, gap: -0.3 mm}}", "interfaces.stem_cement.zones.a.gap: is an"),
        ("interference: [[0 mm, 0 mm], [20 mm, 0.2 mm]]", "interfaces.stem_cement.interference: "),
        ("gap: -0.02 mm", None),
        ("gap: 0.5 mm", None),
        ("gap: 0 * x - 0.5", None),  # known on the mesh
    ],
)
def test_preview_notes_large_interferences_without_bone(key: str, note: str | None) -> None:
    law = f"interfaces.stem_cement={{kind: contact, friction_coefficient: 0.4, {key}}}"
    case = load_case(CONFIGS / "cylinders.yaml", (law,)).config
    notes = [text for text in texts(case) if "strains may not be small" in text]
    assert len(notes) == (note is not None)
    assert note is None or (notes[0].startswith(note) and "usual: 0.01 to 0.02 mm" in notes[0])


@pytest.mark.parametrize(
    ("up", "cut", "height"),
    [(0.0, 5.0, None), (10.0, 5.0, None), (25.0, 5.0, 29.7), (0.0, -7, 16.7)],
)
def test_preview_notes_a_stem_far_out_of_the_bone(
    up: float, cut: float, height: float | None
) -> None:
    """The shipped shoulder is at 29 mm, the cut 24.747 tan 38 deg above its medial end."""
    case = mantle.load(
        CONFIGS / "stance.yaml",
        **{"geometry.tip_z": f"{-118 + up} mm", "geometry.resection.height": f"{cut} mm"},
    ).config
    notes = [n for n in texts(case) if "neck cut" in n]
    text = f"geometry: the shoulder of the stem is {height} mm above the neck cut; in hips it is"
    assert len(notes) == (height is not None) and all(n.startswith(text) for n in notes)


@pytest.mark.parametrize(("depth", "noted"), [(-10.0, False), (-30.0, True)])
def test_preview_notes_an_insertion_far_out_of_the_bone(depth: float, noted: bool) -> None:
    case = mantle.load(CONFIGS / "stance.yaml", **{"geometry.insertion.depth": f"{depth} mm"})
    notes = [n for n in texts(case.config) if "neck cut" in n]
    text = "geometry: the shoulder of the stem is 30 mm above the neck cut"
    assert len(notes) == noted and all(n.startswith(text) for n in notes)


@pytest.mark.parametrize(
    ("first", "last", "end"), [(100, 100, None), (0, 0, "0 %"), (100, 90, "90 %")]
)
def test_preview_notes_cycles_that_end_below_their_peak(
    first: int, last: int, end: str | None
) -> None:
    """The numbers of a run are those at the end. Muscles that stay constant are noted, too."""
    rows = ["time [s], factor [%]", f"0, {first}", "0.5, 100", f"1, {last}"]
    changes = {
        "loads.hip.history": None,
        "loads.hip.cycle_table": rows,
        "stages": [{"name": "rise"}, {"name": "walk"}],
    }
    notes = texts(mantle.load(CONFIGS / "stance.yaml", **changes).config)
    ends = [note for note in notes if "of its peak" in note]
    assert len(ends) == (end is not None)
    assert all(f"loads.hip.cycle_table: the force ends at {end} of its peak" in n for n in ends)
    (constant,) = [note for note in notes if "stay constant" in note]
    assert constant.startswith("loads: hip follows a cycle, but gluteus_medius_anterior")


@pytest.mark.parametrize(
    ("gait", "stairs", "stages", "valley_part"),
    [
        # Load in the valleys: 1 + 0.1 (0 - 1), or from 0.5 to 0 with a valley of 0.2.
        ([1, 0], [0, 1], [{"cycles": 2}, {"cycles": 2}], "90 %"),
        ([0.5, 0], [0, 1], [{}, {"cycles": 2, "valley": 0.2}], "40 %"),
        ([1, 0.1, 0], [0, 0, 1], [{"cycles": 2}, {}, {"cycles": 2}], None),
        ([1, 1], [0, 1], [{"cycles": 2}, {"cycles": 2}], None),
        ([1, 0], [0, 1], [{"cycles": 2}, {}], None),
    ],
)
def test_preview_notes_loads_that_fall_in_a_stage_with_cycles(
    gait: list[float],
    stairs: list[float],
    stages: list[dict[str, float]],
    valley_part: str | None,
) -> None:
    named = [{"name": f"part_{k}", **stage} for k, stage in enumerate(stages)]
    changes = {"loads": {"library": {"gait": gait, "stairs_up": stairs}}, "stages": named}
    case = mantle.load(CONFIGS / "stance.yaml", **changes).config
    notes = [note for note in texts(case) if "valleys have" in note]
    assert len(notes) == (valley_part is not None)
    for text in notes:
        assert text.startswith(f"stages.part_1: its valleys have {valley_part} of gait_hip and 4")
        assert "separate activities by a stage without cycles" in text


def test_preview_notes_conductance_across_open_contact() -> None:
    """Conductance that falls has no note, nor has a bond, nor an interface without motion."""

    def noted(name: str, **changes: object) -> list[str]:
        notes = texts(mantle.load(CONFIGS / name, **changes).config)
        return [n.split(": ")[0] for n in notes if "where the interface opens" in n]

    assert noted("thermal_100C.yaml") == ["interfaces.stem_cement, cement_bone"]
    assert noted("stance.yaml") == []
    falls = {"kind": "pressure", "open": "10 W/(m^2 K)", "per_pressure": "100 W/(m^2 K MPa)"}
    places = noted("thermal_100C.yaml", interfaces__stem_cement__conductance=falls)
    assert places == ["interfaces.cement_bone"]
    bond = {"kind": "bonded", "conductance": "300 W/(m^2 K)"}
    assert noted("thermal_100C.yaml", interfaces__cement_bone=bond) == ["interfaces.stem_cement"]
    assert noted("thermal_rings.yaml") == []


MORE = "supports.more={kind: displacement, boundary: "
BOTH_SIDES = [
    f"supports.{a}_{b}={{kind: fixed, boundary: {a}_{b}}}" for a in "xy" for b in ("min", "max")
]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("interfaces.bone_metal.gap=-1 mm", "interference of 1 mm in bodies 10 mm thick"),
        ("interfaces.bone_metal.gap=2 mm", "2 mm apart everywhere"),
        ("loads.press.pressure=20 GPa", "loads.press: 2e+04 MPa on boundary 'top'"),
        ("loads.press={kind: force, boundary: top, force: [0 N, 0 N, -2 MN]}", ": 2e+04 MPa"),
        (f"{MORE}metal_x_min, x: 10 mm}}", "moves a model of 17.3 mm by 10 mm"),
        (f"{MORE}bone_x_min, x: 0.01 mm}}", "a different displacement along x than supports.floor"),
        ("\n".join(BOTH_SIDES), "hold both sides of interface 'bone_metal' at"),
        ("mesh.size=5 mm\ngeometry.blocks[1].size=[10 mm, 10 mm, 1 mm]", "'metal' is 1 mm"),
    ],
)
def test_preview_notes_disproportionate_values(change: str, words: str) -> None:
    assert any(words in note for note in judged(TWO, *change.splitlines()))


@pytest.mark.parametrize("change", ["bone.youngs_modulus=17 MPa", "bone.youngs_modulus=17 TPa"])
def test_preview_notes_moduli_wrong_by_a_thousand(change: str) -> None:
    note = preview.input_notes(support.case(TWO, f"regions.{change}"))[0].text
    assert note.startswith("regions.bone.youngs_modulus is ")
    assert note.endswith("is the unit wrong?")


@pytest.mark.parametrize("force", ["1.8 N", "1800 kN"])
def test_preview_notes_forces_wrong_by_a_thousand(force: str) -> None:
    path = CONFIGS / "stance.yaml"
    changes = [f"loads.{n}.history=[0]" for n in load_case(path).config.loads if n != "hip"]
    change = f'loads.hip.force="[0, 0, -{force.replace(" ", "] ", 1)}"'
    note = preview.input_notes(load_case(path, [*changes, change]).config)[0].text
    assert "N; is the unit wrong?" in note


def test_preview_notes_a_mesh_in_metres(tmp_path: Path) -> None:
    data = build(support.case(TWO))
    meshes.write_msh(replace(data, points=data.points * 1e-3), tmp_path / "a.msh")
    sides = "interfaces: {bone_metal: [bone, metal]}"
    tissues = "regions.bone.tissue=bone", "regions.metal.tissue=implant"
    geometry = f"geometry={{kind: file, path: {tmp_path}/a.msh, {sides}}}"
    notes = judged(TWO, geometry, *tissues)
    assert any("0.0173 mm from corner to corner: is its unit really mm?" in n for n in notes)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, None),
        ({"loads.history": [0, 0]}, "no load acts at any time: each `history` is 0"),
        ({"loads": None}, "no load acts at any time; only the interference strains the bodies"),
    ],
)
def test_preview_notes_that_no_load_acts(changes: dict[str, Any], expected: str | None) -> None:
    notes = [n for n in texts(mantle.load(CONFIGS / "pressed.yaml", **changes).config)]
    found = [n for n in notes if "no load acts" in n]
    assert len(found) == (expected is not None)
    assert expected is None or expected in found[0]


@pytest.mark.parametrize(("gap", "is_noted"), [("0.1 mm", True), ("-0.1 mm", False)])
def test_preview_notes_that_a_clearance_is_no_load(gap: str, is_noted: bool) -> None:
    """An interference strains the bodies."""
    case = support.case(TWO, "loads={}", f"interfaces.bone_metal.gap={gap}")
    assert any("no load acts at any time" in n for n in texts(case)) == is_noted


@pytest.mark.parametrize("name", ["cylinders", "cure"])
def test_preview_notes_no_missing_load_where_else_something_acts(name: str) -> None:
    """A prescribed displacement, and heat."""
    case = mantle.load(CONFIGS / f"{name}.yaml").config
    assert not case.loads
    assert not any("no load acts" in n for n in texts(case))
