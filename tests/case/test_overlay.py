"""Cases over others: bases, what null takes away, materials and loads by name, magnitudes."""

from __future__ import annotations

import json
import math
import re
import shutil
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter

import mantle
from app.case import library, overlay
from app.case import sweep as sweep_file
from app.case.case import dump, load
from app.foundation.errors import InputError
from app.laws.cycle_tables import CycleTable
from app.schema import yaml_file
from app.schema.paths import File
from tests import support
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


def write(folder: Path, **texts: str) -> Path:
    """Files by name; the path of the last."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        path = folder / f"{name}.yaml"
        path.write_text(text, encoding="utf-8")
    return path


def loaded(folder: Path, text: str, *overrides: str, below: str = BLOCKS) -> Any:
    return load(write(folder, blocks=below, case=text), overrides).config


def messages(path: Path, *overrides: str) -> tuple[str, ...]:
    with pytest.raises(InputError) as caught:
        load(path, overrides)
    return tuple(m.replace(f"{path.parent}/", "") for m in caught.value.messages)


# -------------------------------------------------------------------------------------- bases


def test_overlay_changes_named_keys_of_a_base(tmp_path: Path) -> None:
    text = """\
base: blocks.yaml
mesh: {size: 2 mm}
regions:
  upper: {poisson_ratio: 0.2}
loads:
  push: {force: [0 N, 0 N, -1 N]}
"""
    below = loaded(tmp_path, BLOCKS)
    case = loaded(tmp_path, text)
    upper = below.regions["upper"].model_copy(update={"poisson_ratio": 0.2})
    push = below.loads["push"].model_copy(update={"force": (0.0, 0.0, -1.0)})
    assert case == below.model_copy(
        update={
            "mesh": below.mesh.model_copy(update={"size": 2.0}),
            "regions": below.regions | {"upper": upper},
            "loads": below.loads | {"push": push},
        }
    )


def test_overlay_shipped_cases_are_bases_by_name(tmp_path: Path) -> None:
    case = loaded(tmp_path, "base: stance\nregions: {stem: {material: CoCrMo}}\ntitle: x\n")
    other = load(CONFIGS / "stance_cocr.yaml").config
    assert case == other.model_copy(update={"title": "x"})


def test_overlay_paths_are_relative_to_their_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    deep = tmp_path / "deep"
    deep.mkdir()
    for name in ("patch.yaml", "patch.geo"):
        shutil.copy(CONFIGS / "verification" / name, deep)
    write(tmp_path / "middle", middle="base: ../deep/patch.yaml\ntitle: middle\nmesh: {order: 1}\n")
    path = write(tmp_path, top="base: middle/middle.yaml\ntitle: top\n")
    monkeypatch.setenv("MANTLE_ALLOW_SCRIPTS", "1")
    case: Any = load(path).config
    assert (case.title, case.mesh.order) == ("top", 1)
    assert case.geometry.path == (deep / "patch.geo").resolve()


@pytest.mark.parametrize(
    "keys",
    [
        ("geometry", "bone", "surface"),
        ("geometry", "canal", "ct"),
        ("remodelling", "intact"),
        ("loads", "hip", "cycle_table"),
        ("regions", "bone", "youngs_modulus", "density"),
        ("geometry", "lists", 0),
    ],
    ids=str,
)
def test_overlay_files_of_a_base_are_beside_it(keys: tuple[str | int, ...], tmp_path: Path) -> None:
    """Whatever the key, a file of the same name beside the case is not taken."""
    for folder in (tmp_path, tmp_path / "deep"):
        folder.mkdir(exist_ok=True)
        (folder / "file.dat").touch()
    value: Any = "file.dat"
    for key in reversed(keys):
        value = [value] if key == 0 else {key: value}
    write(tmp_path / "deep", below=json.dumps(value))
    merged: Any = overlay.read(write(tmp_path, case="base: deep/below.yaml\ntitle: top\n")).data
    for key in keys:
        merged = merged[key]
    found = TypeAdapter(File).validate_python(merged, context={"folder": tmp_path})
    assert found == tmp_path / "deep" / "file.dat"


def test_overlay_another_kind_replaces_the_mapping(tmp_path: Path) -> None:
    text = "base: blocks.yaml\nloads: {push: {kind: pressure, boundary: top, pressure: 1 MPa}}\n"
    assert loaded(tmp_path, text).loads["push"].pressure == 1.0
    rigid = "base: blocks.yaml\nregions: {lower: {kind: conductor, thermal: {}}}\n"
    complaints = messages(write(tmp_path, case=rigid))
    assert complaints and not any("youngs_modulus" in m for m in complaints)


def test_overlay_another_kind_has_no_places_of_the_former_one(tmp_path: Path) -> None:
    """So an error in a default is placed at the section that chose the kind."""
    text = "base: pressed\ngeometry: {kind: intact_femur}\n"
    places = overlay.read(write(tmp_path, case=text)).places
    assert ("geometry", "kind") in places and ("geometry", "stem", "length") not in places
    assert ("geometry", "cement_thickness") not in places


def test_overlay_stem_from_cad_replaces_dimensions_but_not_the_collar(tmp_path: Path) -> None:
    collar = {"thickness": "3 mm"}
    text = f"base: stance\ngeometry: {{stem: {{length: 120 mm, collar: {json.dumps(collar)}}}}}\n"
    upper = "base: blocks.yaml\ngeometry: {stem: {step: stem.step}}\n"
    merged = overlay.read(write(tmp_path, blocks=text, case=upper)).data
    stem = merged["geometry"]["stem"]
    assert stem.keys() == {"step", "collar"} and stem["collar"] == collar


def test_overlay_null_removes(tmp_path: Path) -> None:
    case = loaded(tmp_path, "base: blocks.yaml\nloads: {push: null}\ninterfaces: null\n")
    assert list(case.loads) == ["press"]
    assert case.interfaces["lower_upper"].kind == "bonded"
    assert list(loaded(tmp_path, BLOCKS, "loads.push=null").loads) == ["press"]


def test_overlay_errors_name_the_file_of_the_key(tmp_path: Path) -> None:
    below = BLOCKS.replace("press: {", "press: {wrong: 1, ")
    text = "base: blocks.yaml\nmesh:\n  size: 2\nregions: {other: {rigid: true}}\n"
    complaints = messages(write(tmp_path, blocks=below, case=text))
    assert [m.partition(": ")[0] for m in complaints] == [
        "case.yaml:3:3",
        "case.yaml:4:11",
        "blocks.yaml:14:11",
    ]
    # A key that is missing is missed where its section stands, or at the top.
    (missing,) = messages(write(tmp_path, case="base: blocks.yaml\nloads: {a: {kind: pressure, "
                                "pressure: 1 MPa}}\n"), "loads.press=null")  # fmt: skip
    assert missing.startswith("case.yaml:2:9: loads.a: 'boundary' is missing")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("base: none.yaml", "case.yaml:1:1: base: no such file: none.yaml; cases by name: blocks"),
        ("base: stnce", "case.yaml:1:1: base: no such file: stnce; did you mean 'stance'?"),
        ("title: x\nbase: case.yaml", "case.yaml:2:1: base: a circle of bases, or more"),
        ("base: round.yaml", "round.yaml:1:1: base: a circle of bases, or more than 10: case.y"),
        ("base: [a]", "case.yaml:1:1: base: a list is not text; expected a file"),
        ("base: .", "case.yaml:1:1: base: no such file: "),
        ('base: "a\\0b"', "case.yaml:1:1: base: no such file: a\\x00b"),
        (f"base: {300 * 'x'}", "case.yaml:1:1: base: 'xxx"),
        ("base: broken.yaml", "broken.yaml:1:5: not valid YAML"),
        ("base: twice.yaml", "twice.yaml:2:1: mesh: this key is given twice; keep one"),
        ("base: large.yaml", "large.yaml: is larger than 4 MB, too large for a case file"),
        ("base: link0.yaml", "link9.yaml:1:1: base: a circle of bases, or more"),
        ("base: blocks.yaml\ngrid: {mesh.size: [1 mm]}", "case.yaml:1:1: base: is a sweep file"),
        ("base: blocks.yaml\nstudy: {}", "case.yaml:1:1: base: is a study file"),
        ("base: study.yaml", "study.yaml:2:1: set: unknown key"),
    ],
)  # fmt: skip
def test_overlay_refuses_bad_bases(text: str, message: str, tmp_path: Path) -> None:
    write(
        tmp_path,
        blocks=BLOCKS,
        round="base: case.yaml\n",
        broken="a: b: c\n",
        twice="mesh: {}\nmesh: {}\n" + BLOCKS,
        large="a: " + "x" * (5 << 20),
        study="base: blocks.yaml\nset: {}\n",
        **{f"link{i}": f"base: link{i + 1}.yaml\n" for i in range(12)},
    )
    begin = time.process_time()
    complaints = messages(write(tmp_path, case=text))
    assert any(m.startswith(message) for m in complaints), complaints
    assert time.process_time() - begin < 10.0


def test_overlay_base_in_sweeps_and_variations(tmp_path: Path) -> None:
    varied = "variations: {a: {loads.push.force: 5 N}, b: {loads.push.force: 10 N}}\n"
    write(tmp_path, blocks=BLOCKS, case="base: blocks.yaml\nmesh: {size: 2 mm}\n" + varied)
    sweep = write(tmp_path, sweep="base: case.yaml\ngrid: {loads.push.force: [1 N, 10 N]}\n")
    _, planned = sweep_file.read(sweep)
    assert [p.case.loads["push"].force for p in planned] == [(0.6, 0, -0.8), (6, 0, -8)]  # type: ignore[union-attr]
    assert {p.case.mesh.size for p in planned} == {2.0}
    variations = load(tmp_path / "case.yaml").variations
    assert [v.case.loads["push"].force for v in variations] == [(3, 0, -4), (6, 0, -8)]  # type: ignore[union-attr]
    by_name = write(tmp_path, named="base: blocks\ngrid: {mesh.size: [2 mm, 5 mm]}\n")
    assert [p.case.title[:14] for p in sweep_file.read(by_name)[1]] == ["Patch test of "] * 2


def test_overlay_resolved_case_is_complete(tmp_path: Path) -> None:
    path = write(tmp_path, blocks=BLOCKS, case="base: blocks.yaml\nregions: {upper: "
                 "{material: 316L}}\nloads: {push: {force: 10 N}}\n")  # fmt: skip
    case = load(path)
    text = dump(case.config)
    assert not any(word in text for word in ("base: b", "material", "library"))
    assert loaded(tmp_path / "other", text) == case.config
    files = [str(path), str(path.with_name("blocks.yaml")), str(library.SHIPPED)]
    assert list(case.file.digests) == files


# ---------------------------------------------------------------------------------- magnitudes


@pytest.mark.parametrize(
    ("old", "new", "force"),
    [
        ("[3 N, 0 N, -4 N]", "10 N", (6.0, 0.0, -8.0)),
        ('"[3, 0, -4] N"', "0.01 kN", (6.0, 0.0, -8.0)),
        ("[3 N, 0 N, -4 N]", "0 N", (0.0, 0.0, 0.0)),
        ("[3 N, 0 N, -4 N]", "[1, 2, 3] N", (1.0, 2.0, 3.0)),
    ],
)
def test_overlay_magnitude_keeps_the_direction(
    old: str, new: str, force: tuple[float, ...], tmp_path: Path
) -> None:
    below = BLOCKS.replace("[3 N, 0 N, -4 N]", old)
    assert loaded(tmp_path, below, f"loads.push.force={new}").loads["push"].force == force
    text = f'base: blocks.yaml\nloads: {{push: {{force: "{new}"}}}}\n'
    assert loaded(tmp_path, text, below=below).loads["push"].force == force


def test_overlay_title_has_the_given_magnitude(tmp_path: Path) -> None:
    case = loaded(tmp_path, "title: A\n" + BLOCKS, "loads.push.force=10 N", "loads.press=null")
    assert case.title == "A; changed: force 10 N, without press"


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
    stance = load(CONFIGS / "stance.yaml").config
    for name, entry in shipped["loads"].items():
        assert len(entry["source"]) > 20 and entry["about"]
        case: Any = loaded(tmp_path, f"base: stance\nloads: {{library: {name}}}\n")
        others = {"about", "source", "status", "body_weight", "per_day"}
        assert case.loads.keys() == entry.keys() - others
        assert all(load.status and load.source == entry["source"] for load in case.loads.values())
        if name == "paper_stance":
            assert support.without_origin(case)["loads"] == support.without_origin(stance)["loads"]


def test_library_source_is_removed_with_changed_values(tmp_path: Path) -> None:
    """By an override, a case above or a key beside the name; not by where or when a load acts."""
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
    assert load(again).config == case
    changed: Any = load(again, ["regions.upper.youngs_modulus=2 GPa", "loads.push.force[0]=2 N"])
    for part in (changed.config.regions["upper"], changed.config.loads["push"]):
        assert (part.status, part.source) == (None, None)
    kept = load(again, ["loads.push.history=[0.7]", "regions.upper.tissue=cement"]).config
    assert (kept.loads["push"].status, kept.regions["upper"].status) == ("measured", "assumed")
    above = "base: case.yaml\nregions: {upper: {poisson_ratio: 0.4}}\n"
    region = load(write(tmp_path, above=above)).config.regions["upper"]
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
    case: Any = load(path).config
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
        load(CONFIGS / "cure.yaml").config
    )
    hot = load(CONFIGS / "thermal_100C.yaml").config
    names = "stem: {material: CoCrMo}, cement: {material: PMMA}"
    bones = "cortical_bone: {material: cortical_bone}, cancellous_bone: {material: cancellous_bone}"
    named = loaded(tmp_path, f"base: thermal_100C\nregions: {{{names}, {bones}}}\n")
    assert support.without_origin(named) == support.without_origin(hot)
    # A rigid region takes what conducts.
    text = "base: thermal_100C\nregions: {stem: {material: CoCrMo, rigid: true}}\n"
    thermal = loaded(tmp_path, text).regions["stem"].thermal
    assert (thermal.conductivity, thermal.thermal_expansion) == (14.8, None)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("loads:\n  pusch: null",
         "case.yaml:3:3: loads.pusch: is not in the base, so null cannot remove it; did you mean"),
        ("loads: {push: {force: -1 N}}", "case.yaml:2:16: loads.push.force: '-1 N': a magni"),
        ("regions: {upper: {material: Ti}}",
         "case.yaml:2:19: regions.upper.material: 'Ti' is not in the library; materials: Ti-6"),
        ("loads:\n  library: stance",
         "case.yaml:3:3: loads.library: 'stance' is not in the library; loads: paper_stance"),
        ("loads: {push: {force: '[0, 0, -1] N', cycle_table: walk}}",
         "case.yaml:2:39: loads.push.cycle_table: 'walk' is not in the library; cycle_tables: iso"),
        ("loads:\n  library: walking_hip", "LIBRARY:7: loads.hip.at: 'head_centre'"),
        ("regions: {upper: {material: PMMA, kind: transversely_isotropic}}",
         "case.yaml:2:35: regions.upper.kind: PMMA is of kind isotropic; leave `kind` out"),
        ("regions: {upper: {material: [PMMA]}}", "case.yaml:2:19: regions.upper.material: a list"),
        ("regions: {upper: {material: PMMA, yongs_modulus: 1 GPa}}",
         "case.yaml:2:35: regions.upper.yongs_modulus: unknown key"),
    ],
)  # fmt: skip
def test_overlay_refuses_keys_that_a_base_lacks(text: str, message: str, tmp_path: Path) -> None:
    path = write(tmp_path, blocks=BLOCKS, case=f"base: blocks.yaml\n{text}\n")
    complaint = messages(path)[0]
    assert re.sub(rf"{library.SHIPPED}:\d+", "LIBRARY", complaint).startswith(message)


def test_overlay_reports_errors_of_other_sections_too(tmp_path: Path) -> None:
    """Missing entries cause no further errors: no forces for a body weight, no moduli."""
    loads, mesh = "loads: {library: gaits, body_weight: 600 N}", "mesh: {ordr: 2}"
    text = f"base: blocks.yaml\n{loads}\n{mesh}\nregions: {{upper: {{material: Ti}}}}\n"
    path = write(tmp_path, blocks=BLOCKS, case=text)
    found = [": ".join(message.split(": ")[1:3]) for message in messages(path)]
    assert [text.split("; ")[0] for text in found] == [
        "loads.library: 'gaits' is not in the library",
        "mesh.ordr: unknown key",
        "regions.upper.material: 'Ti' is not in the library",
    ]


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


def test_overlay_reading_time_is_linear(tmp_path: Path) -> None:
    """Each file is walked through once: nothing grows with the square of its size."""
    names = "".join(f"  n{i}: {{material: PMMA, tissue: bone}}\n" for i in range(1500))
    path = write(tmp_path, blocks=BLOCKS, case=f"base: blocks.yaml\nregions:\n{names}")
    begin = time.process_time()
    file = overlay.read(path)
    spent = time.process_time() - begin
    begin = time.process_time()
    yaml_file.read(path)
    assert spent < 5 * (time.process_time() - begin) + 1.0
    assert len(file.data["regions"]) == 1502


@pytest.mark.parametrize(
    ("file", "override", "kilograms"),
    [("75 N", "", 8), ("750 N", "", 0), ("75 N", "750 N", 0), ("750 N", "7500 N", 765)],
)
def test_library_body_weight_in_other_units_is_noted(
    tmp_path: Path, file: str, override: str, kilograms: int
) -> None:
    """The weight that counts is that of the option."""
    path = write(tmp_path, case=f"base: stance\nloads: {{library: gait, body_weight: {file}}}\n")
    overrides = [f"loads.body_weight={override}"] if override else []
    notes = [verdict.text for verdict in overlay.read(path, overrides).notes]
    assert len(notes) == (kilograms > 0)
    assert all(f"is the weight of {kilograms} kg; expected 300 to 1500 N" in n for n in notes)


def test_library_body_weight_and_tilt_change_forces(tmp_path: Path) -> None:
    """In the order given; turns about x add up, and a force beside them stays as it is."""
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
        load(CONFIGS / "stance.yaml", [option])
    with pytest.raises(InputError, match=r"two.yaml:3:3: .*history: has 2 values; expected 3"):
        mantle.load(case)


@pytest.mark.parametrize(
    ("loads", "overrides", "errors"),
    [
        ("{history: [0, x]}", (), ["case.yaml:2:22: loads.history[1]: 'x' is not a"]),
        ("{history: x}", (), ["case.yaml:2:9: loads.history: 'x' is not a list"]),
        ("{history: [0]}", (), ["case.yaml:2:9: loads.history: has 1 values; expected 2"]),
        ("{cycle_table: {}}", (), ["case.yaml:2:9: loads.cycle_table: has too few rows"]),
        (
            "{library: {gait: [1, x], stairs_up: [0, 1]}}",
            (),
            ["case.yaml:2:29: loads.library.gait[1]: 'x' is not a number"],
        ),
        (
            "{library: {gait: [1, 0], stairs_up: [0, 1]}, cycle_table: walking_cycle}",
            (),
            ["case.yaml:2:53: loads.cycle_table: each set of `library` has a history; leave"],
        ),
        (
            "{library: {gait: [1, 0], stairs_up: [0, 1]}, history: [0, 1]}",
            (),
            ["case.yaml:2:53: loads.history: each set of `library` has a history; leave one"],
        ),
        (
            "{history: [0, x], hip: {history: [y, 1]}}",
            (),
            [
                "case.yaml:2:22: loads.history[1]: 'x' is not a number",
                "case.yaml:2:42: loads.hip.history[0]: 'y' is not a number",
            ],
        ),
        ("{}", ("loads.history=[0, x]",), ["--set loads.history: loads.history[1]: 'x' is"]),
        (
            "{history: [0, 1]}",
            ("loads.hip.history[1]=x",),
            ["--set loads.hip.history[1]: 'x' is not a number"],
        ),
        (
            "{}",
            ("loads={library: one_leg_stance, history: [0, x], hip: {history: [y, 1]}}",),
            [
                "--set loads: loads.hip.history[0]: 'y' is not a number",
                "--set loads: loads.history[1]: 'x' is not a number",
            ],
        ),
    ],
)
def test_overlay_a_wrong_common_history_is_one_error(
    loads: str, overrides: tuple[str, ...], errors: list[str], tmp_path: Path
) -> None:
    text = f"base: stance\nloads: {loads}\nstages: [{{name: rest}}, {{name: stand}}]\n"
    texts = messages(write(tmp_path, case=text), *overrides)
    assert len(texts) == len(errors)
    for message, error in zip(texts, errors, strict=True):
        assert message.startswith(error)


@pytest.mark.parametrize("loads", ["[{kind: pressure}]", "7", "[[a], {b: 1}]"])
def test_overlay_loads_that_are_no_mapping_are_refused(loads: str, tmp_path: Path) -> None:
    (complaint,) = messages(
        write(tmp_path, blocks=BLOCKS, case=f"base: blocks.yaml\nloads: {loads}\n")
    )
    assert complaint.startswith("case.yaml:2:1: loads: ")


def test_overlay_a_wrong_history_of_a_base_is_at_its_place(tmp_path: Path) -> None:
    """A load's history that a common one replaces no longer has a place."""
    base = "base: stance\nloads: {hip: {history: [0, 1]}}\nstages: [{name: a}, {name: b}]\n"
    above = write(tmp_path, base=base, case="base: base.yaml\nloads: {history: [0, x]}\n")
    (text,) = messages(above)
    assert text.startswith("case.yaml:2:22: loads.history[1]: 'x' is not")
    base = base.replace("hip: {history: [0, 1]}", "history: [0, x]")
    case = "base: base.yaml\nloads: {hip: {history: [y, 1]}}\n"
    texts = messages(write(tmp_path, base=base, case=case))
    assert texts[0].startswith("case.yaml:2:25: loads.hip.history[0]: 'y' is not")
    assert len(texts) == 2 and texts[1].startswith("base.yaml:2:22: loads.history[1]: 'x'")


def test_library_cycle_table_of_all_loads(tmp_path: Path) -> None:
    """All forces follow one course; body weight and direction stay those of the set."""
    keys = "library: gait, body_weight: 750 N, cycle_table: walking_cycle"
    case: Any = loaded(tmp_path, f"base: stance\nloads: {{{keys}}}\n")
    assert len(case.loads) == 5
    for force in case.loads.values():
        assert force.history is None and force.cycle_table.columns["factor"][0] == 1.0
        assert force.force_at(0.0) == force.force_at(1.0) == force.force
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
    """Bergmann 2001: 238 % of body weight, two peaks; their ratio as that of 757 other strides."""
    cycle = library.read().data["cycle_tables"]["walking_cycle"]
    table = CycleTable.model_validate({"rows": list(cycle["rows"])})
    assert cycle["status"] == "measured"
    (peak,) = re.findall(r"(\d+) percent of body weight", " ".join(cycle["source"].split()))
    assert int(peak) == pytest.approx(238, rel=0.01)  # what the abstract gives
    factor, times = np.array(table.columns["factor"]), np.array(table.times)
    stride = times[-1]
    inner = (factor[1:-1] > factor[:-2]) & (factor[1:-1] > factor[2:])
    (second,) = np.flatnonzero(inner) + 1
    assert factor[0] == factor[-1] == factor.max() == 1.0
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


def test_overlay_kind_replaces_a_material(tmp_path: Path) -> None:
    below, above = tmp_path / "below.yaml", tmp_path / "above.yaml"
    below.write_text("base: stance\nregions: {cortical_bone: {material: cortical_bone}}\n")
    law = "{kind: isotropic, youngs_modulus: 16 GPa, poisson_ratio: 0.31}"
    above.write_text(f"base: below.yaml\nregions: {{cortical_bone: {law}}}\n")
    region = mantle.load(above).config.regions["cortical_bone"]
    assert (region.kind, region.youngs_modulus) == ("isotropic", 16e3)  # type: ignore[union-attr]
