"""First hours of a new user: names, units, bases, messages about one key."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mantle
from app.case import keys
from app.case.geometries import Femur, MeshOptions
from app.cli import main
from app.command_line.commands import dispatch
from app.foundation.errors import GeometryError, InputError
from app.laws.creep import Creep
from app.schema.section import Section
from app.soundness import preview
from meshes.layered_surfaces import LayeredSurfaces, _rounded_up
from tests.support import CONFIGS, ROOT


def test_sections_with_cached_arrays_compare_by_their_fields() -> None:
    """Caches by geometry meet a second one of the same case, which holds arrays already."""

    class Place(Section):
        x: float = 1.0

    one, two, other = Place(), Place(), Place(x=2.0)
    one.__dict__["placement"], two.__dict__["placement"] = np.zeros(3), np.ones(3)
    assert one == two and hash(one) == hash(two)
    assert one != other and one != 1.0


def test_the_history_of_all_loads_of_a_library_or_a_base(tmp_path: Path) -> None:
    case = tmp_path / "two.yaml"
    stages = "stages: [{name: rest}, {name: stand}, {name: walk}]\n"
    load = "loads: {library: one_leg_stance, history: [0, 1, 0.5], hip: {history: [1, 1, 1]}}\n"
    case.write_text(f"base: stance\n{load}{stages}")
    loads = mantle.load(case).config.loads
    assert loads["hip"].history == (1.0, 1.0, 1.0) and len(loads) > 2
    assert {a.history for n, a in loads.items() if n != "hip"} == {(0.0, 1.0, 0.5)}
    changed = mantle.load(CONFIGS / "stance.yaml", **{"loads.history": [0.25]}).config.loads
    assert {a.history for a in changed.values()} == {(0.25,)}
    case.write_text(f"base: stance\nloads:\n  history: [0, 1]\n{stages}")
    with pytest.raises(InputError, match=r"two.yaml:3:3: .*history: has 2 values; expected 3"):
        mantle.load(case)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"stem_length": "120 mm"}, "stem_length: .* set stem_tip_z: -91 mm too"),
        ({"stem_section_z": "31 mm"}, "stem_section_z: is not between .* -118 mm and .* 29 mm"),
        ({"stem_tip_z": "16 mm"}, "stem_tip_z: puts the stem between z = 16 and 163 mm"),
    ],
)
def test_a_stem_without_its_section_names_the_key_that_was_set(
    changes: dict[str, str], text: str
) -> None:
    given = {f"geometry.{key}": value for key, value in changes.items()}
    with pytest.raises(InputError, match=f"geometry.{text}") as caught:
        mantle.load(CONFIGS / "stance.yaml", **given)
    assert len(caught.value.messages) == 1


def test_a_shorter_stem_cut_at_its_tip_is_as_the_message_says() -> None:
    given = {"geometry.stem_length": "120 mm", "geometry.stem_tip_z": "-91 mm"}
    assert mantle.load(CONFIGS / "stance.yaml", **given).config.geometry.kind == "femur"


def test_commands_take_a_shipped_case_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert dispatch(["check", "cylinders"]) == 0
    assert capsys.readouterr().out.startswith(mantle.load(CONFIGS / "cylinders.yaml").config.title)
    with pytest.raises(InputError, match="cylinder"):
        dispatch(["check", "cylinder"])
    assert ROOT != tmp_path


def test_explain_knows_units_and_the_keys_among_loads() -> None:
    assert "body_weight: 750 N scales" in " ".join(keys.explained("loads.body_weight").split())
    assert "sagittal_tilt: 8.4 deg" in " ".join(keys.explained("sagittal_tilt").split())
    table = keys.explained("units").splitlines()
    assert any(line.split()[:2] == ["MPa", "youngs_modulus,"] for line in table)
    assert keys.explained("unit") == keys.explained("units")


def test_a_base_with_a_material_is_overlaid_by_a_kind(tmp_path: Path) -> None:
    below, above = tmp_path / "below.yaml", tmp_path / "above.yaml"
    below.write_text("base: stance\nregions: {cortical_bone: {material: cortical_bone}}\n")
    law = "{kind: isotropic, youngs_modulus: 16 GPa, poisson_ratio: 0.31}"
    above.write_text(f"base: below.yaml\nregions: {{cortical_bone: {law}}}\n")
    region = mantle.load(above).config.regions["cortical_bone"]
    assert (region.kind, region.youngs_modulus) == ("isotropic", 16e3)  # type: ignore[union-attr]


def test_creep_with_an_exponent_of_the_stress_requires_stresses() -> None:
    with pytest.raises(ValueError, match="'stresses' is missing, required with m1"):
        Creep.model_validate({"A": 1e-7, "p": 1.8, "m0": 0.3, "m1": 0.02})
    explained = " ".join(keys.explained("regions.creep.stresses").split())
    assert "required with m1" in explained


def test_a_stem_that_cuts_by_a_hair_is_never_said_to_cut_by_zero() -> None:
    assert [_rounded_up(x) for x in (0.001, 0.041, 0.1, 0.31)] == [0.01, 0.05, 0.1, 0.4]


@pytest.mark.parametrize(
    ("half_width", "words"),
    [
        (9.85, "leaves 0.9[0-9] mm for cement, of 1 mm at least, .*; 0.0[1-9] mm more are needed"),
        (11.0, "leaves 0.3 mm for cement, of 1 mm at least, .*; 0.7 mm more are needed"),
        (11.7255, r"cuts 0.0[4-6] mm into the cortex .*\(stem_tip_z\); 1.1 mm more are needed"),
    ],
)
def test_a_stem_without_room_says_by_how_much(half_width: float, words: str) -> None:
    """At the last the cells between stem and cortex would have no volume."""
    geometry = Femur.model_validate({"stem_half_width": f"{half_width} mm"})
    with pytest.raises(GeometryError, match=words):
        LayeredSurfaces(geometry, MeshOptions.model_validate({"size": "6 mm"}))


def test_notes_on_input_without_effect() -> None:
    notes = preview.warnings(mantle.load(CONFIGS / "stance.yaml").config)
    assert not any("friction_coefficient" in n or "fixes" in n for n in notes)
    changes = {
        "loads.hip.boundary": "distal_cut",
        "interfaces.cement_bone.friction_coefficient": 6.5,
    }
    notes = preview.warnings(mantle.load(CONFIGS / "stance.yaml", **changes).config)
    assert any(n.startswith("loads.hip: acts on distal_cut, which supports.shaft") for n in notes)
    assert any(n.startswith("interfaces.cement_bone.friction_coefficient is 6.5") for n in notes)


@pytest.mark.parametrize(
    ("up", "cut", "height"),
    [(0.0, 5.0, None), (10.0, 5.0, None), (25.0, 5.0, 29.7), (0.0, -7, 16.7)],
)
def test_a_stem_far_out_of_the_bone_is_noted(up: float, cut: float, height: float | None) -> None:
    """The shipped shoulder is at 29 mm, the cut 24.747 tan 38 deg above its medial end."""
    case = mantle.load(
        CONFIGS / "stance.yaml",
        **{"geometry.stem_tip_z": f"{-118 + up} mm", "geometry.resection_height": f"{cut} mm"},
    ).config
    notes = [n for n in preview.warnings(case) if "neck cut" in n]
    text = f"geometry: the shoulder of the stem is {height} mm above the neck cut; in hips it is"
    assert len(notes) == (height is not None) and all(n.startswith(text) for n in notes)


def test_a_conductance_that_stays_when_contact_opens_is_noted() -> None:
    """One that falls is not, nor one of a bond, nor one where nothing moves."""

    def noted(name: str, **changes: object) -> list[str]:
        notes = preview.warnings(mantle.load(CONFIGS / name, **changes).config)
        return [n.split(": ")[0] for n in notes if "where the interface opens" in n]

    assert noted("thermal_100C.yaml") == ["interfaces.stem_cement, cement_bone"]
    assert noted("stance.yaml") == []
    falls = {"kind": "pressure", "open": "10 W/(m^2 K)", "per_pressure": "100 W/(m^2 K MPa)"}
    found = noted("thermal_100C.yaml", interfaces__stem_cement__conductance=falls)
    assert found == ["interfaces.cement_bone"]
    bond = {"kind": "bonded", "conductance": "300 W/(m^2 K)"}
    assert noted("thermal_100C.yaml", interfaces__cement_bone=bond) == ["interfaces.stem_cement"]
    assert noted("thermal_rings.yaml") == []


@pytest.mark.parametrize(
    ("probe", "where"),
    [
        ({"at": "[4 mm, 4 mm, 41 mm]"}, "[4.0, 4.0, 41.0] mm is not in the model"),
        ({"at": "[2 mm, 2 mm, 9 mm]", "region": "cement"}, "is not in region 'cement'"),
        ({"at": "[-2 mm, 2 mm, 9 mm]"}, "is not in the model"),
        ({"at": "[2 mm, 2 mm, 9 mm]", "region": "stem"}, ""),
        ({"at": "[5 mm, 5 mm, 20 mm]", "region": "cement"}, ""),
    ],
)
@pytest.mark.parametrize("order", [1, 2])
def test_check_finds_a_probe_outside_its_region(
    probe: dict[str, str], where: str, order: int
) -> None:
    """Without being asked for the mesh; the radius of the stem is 7 mm."""
    changes = {"mesh.size": "4 mm", "mesh.order": order, "output.probes": {"tip": probe}}
    case = mantle.load(CONFIGS / "cylinders.yaml", **changes)
    if not where:
        assert "unknowns" in mantle.check(case).size
        return
    with pytest.raises(InputError) as caught:
        mantle.check(case)
    assert "output.probes.tip: " in str(caught.value) and where in str(caught.value)


@pytest.mark.parametrize("name", ["case.yaml", "fields.vtkhdf", "history.csv", "summary.json"])
def test_a_folder_in_the_way_of_a_result_is_named(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before anything is solved, also for variations."""
    way = tmp_path / name
    way.mkdir()
    case = str(CONFIGS / "blocks.yaml")
    assert main(["run", case, "-o", str(tmp_path), "--force"]) == 2
    assert f"{way}: is a folder where results of a run are a file" in capsys.readouterr().err
    way.rmdir()
    (tmp_path / "a" / name).mkdir(parents=True)
    varied = "variations={a: {title: one}, b: {title: two}}"
    assert main(["run", case, "-o", str(tmp_path), "--force", "--set", varied]) == 2
    assert f"{tmp_path / 'a' / name}: is a folder" in capsys.readouterr().err


def test_a_read_only_folder_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("os.access", lambda path, mode: Path(path) != tmp_path)
    assert main(["run", str(CONFIGS / "blocks.yaml"), "-o", str(tmp_path)]) == 2
    assert capsys.readouterr().err.strip() == f"-o {tmp_path}: is not writable"


@pytest.mark.parametrize("left", ["checkpoint-3.state", "a/checkpoint-3.state", "a/DONE"])
def test_a_killed_run_names_how_to_go_on(
    left: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also where it was one of variations; each minute a checkpoint is written by default."""
    (tmp_path / left).parent.mkdir(exist_ok=True)
    (tmp_path / left).touch()
    case = CONFIGS / "blocks.yaml"
    assert main(["run", str(case), "-o", str(tmp_path)]) == 2
    assert "--restart auto to go on from its checkpoint" in capsys.readouterr().err
    assert mantle.load(case).config.output.checkpoint.minutes == 1.0
