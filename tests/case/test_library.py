"""The library: materials and loads by name, their sources, changes and histories."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mantle
from app.case import library, overlay
from app.case.case import dump, load_case
from app.foundation.errors import InputError
from app.laws.cycle_tables import CycleTable
from tests import support
from tests.case.overlays import loaded, messages, write
from tests.cases.blocks import BLOCKS
from tests.support import CONFIGS

HEATED = """\
geometry: {kind: blocks, blocks: [{name: body, size: [4 mm, 4 mm, 4 mm]}]}
mesh: {order: 1, size: 4 mm}
regions:
  body: {material: PMMA, thermal: {initial_temperature: 60 degC}}
supports:
  base: {kind: fixed, boundary: bottom}
stages: [{name: cooling, duration: 1 s}]
"""


# --------------------------------------------------------------------------------------- names


def test_library_entries_have_sources_and_are_valid(tmp_path: Path) -> None:
    shipped = library.read().data
    assert {"Ti-6Al-4V", "CoCrMo", "316L", "PMMA", "cortical_bone", "cancellous_bone"} <= set(
        shipped["materials"]
    )
    for name, entry in shipped["materials"].items():
        assert len(entry["source"]) > 20 and entry["about"]
        if "thermal" not in entry:  # synthetic bone: its constants of heat are not known
            region = f"base: blocks.yaml\nregions: {{upper: {{material: {name}}}}}\n"
            assert loaded(tmp_path, region).regions["upper"].moduli, name
            continue
        body = loaded(tmp_path, HEATED.replace("PMMA", name)).regions["body"]
        assert body.thermal.conductivity and body.thermal.thermal_expansion, name
    for name, entry in shipped["cycle_tables"].items():
        assert len(entry["source"]) > 20 and entry["about"]
        force = BLOCKS.replace("[3 N, 0 N, -4 N]", f'"[0, 0, -1] N", cycle_table: {name}')
        table = loaded(tmp_path, force).loads["push"].cycle_table
        assert (table.status, table.source) == (entry["status"], entry["source"])
    stance = load_case(CONFIGS / "stance.yaml").config
    for name, entry in shipped["loads"].items():
        assert len(entry["source"]) > 20 and entry["about"]
        case: Any = loaded(tmp_path, f"base: stance\nloads: {{library: {name}}}\n")
        others = {"about", "source", "status", "body_weight", "per_day"}
        assert case.loads.keys() == entry.keys() - others
        assert all(load.status and load.source == entry["source"] for load in case.loads.values())
        if name == "paper_stance":
            assert support.without_origin(case)["loads"] == support.without_origin(stance)["loads"]


def test_library_source_is_removed_with_changed_values(tmp_path: Path) -> None:
    """An override, a case above or a key next to the name removes the source.

    A place or a time of a load does not.
    """
    text = """\
base: blocks.yaml
regions: {upper: {material: PMMA}, lower: {material: PMMA, youngs_modulus: 2 GPa}}
loads: {push: {status: measured, source: a scale, history: [0.5]}}
"""
    case = loaded(tmp_path, text)
    upper, lower, push = case.regions["upper"], case.regions["lower"], case.loads["push"]
    assert upper.status == "assumed" and upper.source.startswith("Young's modulus: Rakoto")
    assert (lower.status, lower.source, push.status) == (None, None, "measured")
    again = write(tmp_path, case=dump(case))
    assert load_case(again).config == case
    changed: Any = load_case(
        again, ["regions.upper.youngs_modulus=2 GPa", "loads.push.force[0]=2 N"]
    )
    for part in (changed.config.regions["upper"], changed.config.loads["push"]):
        assert (part.status, part.source) == (None, None)
    kept = load_case(again, ["loads.push.history=[0.7]", "regions.upper.tissue=cement"]).config
    assert (kept.loads["push"].status, kept.regions["upper"].status) == ("measured", "assumed")
    above = "base: case.yaml\nregions: {upper: {poisson_ratio: 0.4}}\n"
    region = load_case(write(tmp_path, above=above)).config.regions["upper"]
    assert (region.poisson_ratio, region.status) == (0.4, None)


def test_library_loads_have_the_size_of_their_sources(tmp_path: Path) -> None:
    percents = {"walking": 232.6, "walking_hip": 247, "standing_up_hip": 215, "stairs_up_hip": 251}
    percents |= {"one_leg_stance": 260, "standing_up": 215, "stairs_up": 251}
    percents |= {"gait": 247, "stairs_down": 260, "sitting_down": 156}
    for name, percent in percents.items():
        case: Any = loaded(tmp_path, f"base: stance\nloads: {{library: {name}}}\n")
        assert math.hypot(*case.loads["hip"].force) / 6.0 == pytest.approx(percent, abs=1.5)


def test_library_keys_next_to_a_name_change_it(tmp_path: Path) -> None:
    text = """\
base: stance
regions:
  stem: {material: 316L, poisson_ratio: 0.31}
loads:
  library: paper_stance
  hip: {force: 2000 N}
  psoas: null
  extra: {kind: pressure, boundary: head, pressure: 1 MPa}
"""
    path = write(tmp_path, case=text.replace("boundary: head", "boundary: resection"))
    case: Any = load_case(path).config
    stem = case.regions["stem"]
    assert (stem.youngs_modulus, stem.poisson_ratio, stem.thermal) == (193e3, 0.31, None)
    assert math.hypot(*case.loads["hip"].force) == pytest.approx(2000.0, rel=1e-12)
    assert "psoas" not in case.loads and case.loads["extra"].pressure == 1.0


def test_library_material_replaces_only_constants(tmp_path: Path) -> None:
    heated = loaded(
        tmp_path, "base: blocks.yaml\nregions: {body: {material: CoCrMo}}\n", below=HEATED
    )
    body = heated.regions["body"]
    assert (body.youngs_modulus, body.thermal.conductivity) == (200e3, 14.8)
    assert body.thermal.initial_temperature == 333.15
    bone = loaded(tmp_path, HEATED, "regions.body.material=cortical_bone").regions["body"]
    assert (bone.kind, bone.thermal.initial_temperature) == ("transversely_isotropic", 333.15)
    cure = loaded(tmp_path, "base: cure\nregions: {cement: {material: PMMA}}\n")
    assert support.without_origin(cure) == support.without_origin(
        load_case(CONFIGS / "cure.yaml").config
    )
    hot = load_case(CONFIGS / "thermal_100C.yaml").config
    names = "stem: {material: CoCrMo}, cement: {material: PMMA}"
    bones = "cortical_bone: {material: cortical_bone}, cancellous_bone: {material: cancellous_bone}"
    named = loaded(tmp_path, f"base: thermal_100C\nregions: {{{names}, {bones}}}\n")
    assert support.without_origin(named) == support.without_origin(hot)
    # A rigid region takes what conducts.
    text = "base: thermal_100C\nregions: {stem: {material: CoCrMo, rigid: true}}\n"
    thermal = loaded(tmp_path, text).regions["stem"].thermal
    assert (thermal.conductivity, thermal.thermal_expansion) == (14.8, None)


def test_library_of_the_user(tmp_path: Path) -> None:
    entries = """\
materials:
  PMMA: {source: measured here, youngs_modulus: 2.5 GPa, poisson_ratio: 0.33}
loads:
  hammer:
    source: measured here
    blow: {kind: force, boundary: top, force: "[0, 0, -1] N"}
"""
    write(tmp_path / "lib", own=entries)
    text = "base: blocks.yaml\nlibrary: lib/own.yaml\nregions: {upper: {material: %s}}\n"
    assert loaded(tmp_path, text % "PMMA").regions["upper"].youngs_modulus == 2500.0
    assert loaded(tmp_path, text % "CoCrMo").regions["upper"].youngs_modulus == 200e3
    assert list(loaded(tmp_path, text % "PMMA", "loads.library=hammer").loads) == ["blow"]
    # A base reads the names of its library from any folder.
    write(tmp_path / "lib", base=f"library: own.yaml\n{HEATED}".replace(", thermal: {initial_"
          "temperature: 60 degC}", "").replace(", duration: 1 s", ""))  # fmt: skip
    assert loaded(tmp_path, "base: lib/base.yaml\n").regions["body"].poisson_ratio == 0.33


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("~no-one/none.yaml", "case.yaml:1:1: library: no such file: ~no-one/none.yaml"),
        ("loud.yaml", "case.yaml: too many or too deeply nested values"),
        ("none.yaml", "case.yaml:1:1: library: no such file: none.yaml"),
        ("[1]", "case.yaml:1:1: library: a list is not text; expected a file"),
        ("bad.yaml", "bad.yaml:2:3: materials.X: expected a mapping with 'source'"),
    ],
)
def test_library_refuses_bad_files(name: str, message: str, tmp_path: Path) -> None:
    write(tmp_path, bad="materials:\n  X: {youngs_modulus: 1 GPa}\nother: 1\n")
    many = "[" + "0, " * 3000 + "0]"
    write(tmp_path, loud=f"materials:\n  X: {{source: here, kind: {many}, tissue: bone}}\n")
    loud = "".join(f"  n{i}: {{material: X}}\n" for i in range(40))
    text = BLOCKS.replace("regions:\n", f"regions:\n{loud}")
    path = write(tmp_path, case=f"library: {name}\n{text}")
    assert messages(path)[0].startswith(message)


@pytest.mark.parametrize(
    ("file", "override", "kilograms"),
    [("75 N", "", 8), ("750 N", "", 0), ("75 N", "750 N", 0), ("750 N", "7500 N", 765)],
)
def test_library_body_weight_in_other_units_is_noted(
    tmp_path: Path, file: str, override: str, kilograms: int
) -> None:
    """The body weight of the option counts."""
    path = write(tmp_path, case=f"base: stance\nloads: {{library: gait, body_weight: {file}}}\n")
    overrides = [f"loads.body_weight={override}"] if override else []
    notes = [verdict.text for verdict in overlay.read(path, overrides).notes]
    assert len(notes) == (kilograms > 0)
    assert all(f"is the weight of {kilograms} kg; expected 300 to 1500 N" in n for n in notes)


def test_library_body_weight_and_tilt_change_forces(tmp_path: Path) -> None:
    """Body weight and tilt apply in the given order. Rotations about x add up.

    A given force stays.
    """
    hip = loaded(tmp_path, "base: stance\nloads: {library: walking_hip}\n").loads["hip"].force
    text = (
        "base: stance\nloads: {library: walking_hip, body_weight: 1.2 kN, sagittal_tilt: 30 deg}\n"
    )
    x, y, z = (2.0 * part for part in hip)
    c, s = math.cos(math.pi / 6), 0.5
    both = (x, c * y + s * z, c * z - s * y)
    assert loaded(tmp_path, text).loads["hip"].force == pytest.approx(both)
    back = "loads.sagittal_tilt=0 deg", "loads.body_weight=600 N"
    assert loaded(tmp_path, text, *back).loads["hip"].force == pytest.approx(hip)
    changed = loaded(tmp_path, text.replace("}", ", hip: {force: '[0, 0, -9] N'}}"))
    assert changed.loads["hip"].force == (0.0, 0.0, -9.0)
    assert loaded(tmp_path, BLOCKS, "loads.sagittal_tilt=90 deg").loads["push"].force == (
        pytest.approx((3.0, -4.0, 0.0))
    )
    for change, words in (
        ("loads.body_weight=1 N", "no forces here depend on body_weight"),
        ("loads.sagittal_tilt=8.4", "8.4 needs a unit"),
    ):
        assert words in messages(write(tmp_path, blocks=BLOCKS), change)[0]


def test_library_history_of_all_loads(tmp_path: Path) -> None:
    case = tmp_path / "two.yaml"
    stages = "stages: [{name: rest}, {name: stand}, {name: walk}]\n"
    text = "loads: {library: one_leg_stance, history: [0, 1, 0.5], hip: {history: [1, 1, 1]}}\n"
    case.write_text(f"base: stance\n{text}{stages}")
    loads = mantle.load(case).config.loads
    assert loads["hip"].history == (1.0, 1.0, 1.0) and len(loads) > 2
    assert {a.history for n, a in loads.items() if n != "hip"} == {(0.0, 1.0, 0.5)}
    changed = mantle.load(CONFIGS / "stance.yaml", **{"loads.history": [0.25]}).config.loads
    assert {a.history for a in changed.values()} == {(0.25,)}
    case.write_text(f"base: stance\nloads:\n  history: [0, 1]\n{stages}")
    option = "loads={library: one_leg_stance, history: [0, 1]}"
    with pytest.raises(InputError, match=r"--set loads: loads.history: has 2 values"):
        load_case(CONFIGS / "stance.yaml", [option])
    with pytest.raises(InputError, match=r"two.yaml:3:3: .*history: has 2 values; expected 3"):
        mantle.load(case)


def test_library_cycle_table_of_all_loads(tmp_path: Path) -> None:
    """All forces follow one course. Body weight and direction stay those of the set."""
    keys = "library: gait, body_weight: 750 N, cycle_table: walking_cycle"
    case: Any = loaded(tmp_path, f"base: stance\nloads: {{{keys}}}\n")
    assert len(case.loads) == 5
    for force in case.loads.values():
        assert force.history is None and force.cycle_table.columns["factor"][0] == 1.0
        assert force.force_at(0.0) == force.force
        assert force.force_at(1.0) == force.force
    hip = case.loads["hip"]
    assert math.hypot(*hip.force) == pytest.approx(2.4648 * 750, rel=1e-4)
    valley = 0.176 / 1.1  # 75.9 % between the peaks
    assert hip.force_at(valley) == pytest.approx([0.759 * f for f in hip.force])
    changed: Any = mantle.load(CONFIGS / "stance.yaml", **{"loads.cycle_table": "walking_cycle"})
    assert all(force.cycle_table for force in changed.config.loads.values())
    still = mantle.load(tmp_path / "case.yaml", **{"loads.history": [1]}).config.loads
    assert {(force.cycle_table, force.history) for force in still.values()} == {(None, (1.0,))}
    (tmp_path / "mine.csv").write_text("time [s], factor [%]\n0, 100\n1, 20\n2, 100\n")
    text = "base: stance\nloads: {library: gait, cycle_table: mine.csv}\n"
    assert loaded(tmp_path, text).loads["hip"].cycle_table.times == (0.0, 1.0, 2.0)
    with pytest.raises(InputError, match="'jogging' is not in the library; cycle_tables: iso"):
        loaded(tmp_path, text.replace("mine.csv", "jogging"))


@pytest.mark.parametrize(
    "columns", ["time [s], force [N]\n0, 9\n1, 9", "time [s], force x [N]\n0, 9\n1, 9"]
)
def test_library_cycle_table_of_all_loads_has_factors_alone(columns: str, tmp_path: Path) -> None:
    """A table with a force is refused once, at the line of the case."""
    (tmp_path / "hip.csv").write_text(columns)
    case = "base: stance\nloads: {library: gait, cycle_table: hip.csv}\n"
    (text,) = messages(write(tmp_path, case=case))
    assert text.startswith("case.yaml:2:24: loads.cycle_table: has a force, but all loads here")
    assert "expected a column `factor [%]`" in text
    (tmp_path / "case.yaml").write_text("base: stance\n")
    with pytest.raises(InputError, match=r"^loads.cycle_table: has a force") as error:
        mantle.load(tmp_path / "case.yaml", **{"loads.cycle_table": "hip.csv"})
    assert len(error.value.messages) == 1


def test_library_cycle_table_names_the_history_that_it_replaces(tmp_path: Path) -> None:
    case = "base: stance\nloads: {library: gait, history: [1]}\n"
    (tmp_path / "case.yaml").write_text(case)
    read = mantle.load(tmp_path / "case.yaml", **{"loads.cycle_table": "walking_cycle"})
    (text,) = map(str, read.file.notes)
    assert text.startswith("note: loads.cycle_table: replaces history [1] of hip, gluteus_medius")
    assert not mantle.load(tmp_path / "case.yaml", **{"loads.history": [0.5]}).file.notes


def test_library_walking_cycle_has_the_published_peaks() -> None:
    """Bergmann 2001 has 238 % of body weight and two peaks.

    Their ratio is that of 757 other strides.
    """
    cycle = library.read().data["cycle_tables"]["walking_cycle"]
    table = CycleTable.model_validate({"rows": list(cycle["rows"])})
    assert cycle["status"] == "measured"
    (peak,) = re.findall(r"(\d+) percent of body weight", " ".join(cycle["source"].split()))
    assert int(peak) == pytest.approx(238, rel=0.01)  # what the abstract gives
    factor, times = np.array(table.columns["factor"]), np.array(table.times)
    stride = times[-1]
    inner = (factor[1:-1] > factor[:-2]) & (factor[1:-1] > factor[2:])
    (second,) = np.flatnonzero(inner) + 1
    assert factor[0] == 1.0
    assert factor[-1] == 1.0
    assert factor.max() == 1.0
    assert factor[second] == pytest.approx(232.2 / 249.9, rel=0.03)
    assert times[second] / stride == pytest.approx(0.31, abs=0.02)  # at 50 % of the stride
    assert factor[: second + 1].min() == pytest.approx(181 / 239, rel=0.01)
    assert factor.min() == pytest.approx(31.6 / 238.9, rel=0.01)  # the leg swings
    assert 0.62 < times[factor.argmin()] / stride < 0.81


def test_library_several_sets_with_their_histories(tmp_path: Path) -> None:
    text = """\
base: stance
loads:
  library: {gait: [1, 0.1, 0], stairs_up: [0, 0, 1]}
  body_weight: 750 N
  stairs_up_vastus_medialis: null
stages: [{name: walk}, {name: rest}, {name: stairs}]
"""
    loads: Any = loaded(tmp_path, text).loads
    names = ("hip", "abductors", "vastus_lateralis")
    assert [n for n in loads if n.startswith("stairs_up")] == [f"stairs_up_{n}" for n in names]
    assert loads["gait_hip"].history == (1.0, 0.1, 0.0)
    assert loads["stairs_up_hip"].history == (0.0, 0.0, 1.0)
    assert loads["stairs_up_hip"].force == pytest.approx([-444.75, -454.5, -1772.25])
    assert loads["stairs_up_hip"].status == "unverified"
    for wrong, words in (
        (text.replace("stairs_up:", "jogging:"), "'jogging' is not in the library; loads: paper"),
        (text.replace("[0, 0, 1]", "[1]"), "loads.library.stairs_up: has 1 values"),
        (text.replace("[0, 0, 1]", "yes"), "loads.library.stairs_up: "),
    ):
        with pytest.raises(InputError, match=re.escape(words)) as caught:
            loaded(tmp_path, wrong)
        assert "body_weight" not in str(caught.value)


@pytest.mark.parametrize(
    ("loads", "words"),
    [
        (
            "{library: [gait]}",
            "is neither the name of a set nor names with histories, e.g. {gait: ",
        ),
        (
            "{library: gait, history: [1], cycle_table: walking_cycle}",
            "loads.history: the loads have a cycle_table, too; leave one of the two out",
        ),
    ],
)
def test_library_of_loads_refuses(loads: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=re.escape(words)) as caught:
        loaded(tmp_path, f"base: stance\nloads: {loads}\n")
    assert len(caught.value.messages) == 1


def test_library_cycle_in_the_first_stage_has_a_note(tmp_path: Path) -> None:
    text = "base: stance\nloads: {library: gait, cycle_table: walking_cycle}\n"
    case = mantle.load(write(tmp_path, case=text))
    notes = [str(n) for n in mantle.check(case).notes]
    assert "the cycle begins in the first stage, so that all loads" in notes[0]
    later = mantle.load(case.path, stages=[{"name": "rise"}, {"name": "gait"}])
    assert mantle.check(later).notes == ()


def test_library_counts_of_a_day_are_those_of_the_case_of_a_year() -> None:
    sets = library.read().data["loads"]
    counts = {name: entry[library.PER_DAY] for name, entry in sets.items() if "per_day" in entry}
    assert len(counts) == 5
    spectrum = mantle.load(CONFIGS / "day.yaml").config.fatigue.spectrum  # type: ignore[attr-defined]
    assert spectrum == {name: 365 * count for name, count in counts.items()}
