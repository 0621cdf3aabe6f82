"""Cases over others: bases, removal by null, errors at their place, magnitudes."""

from __future__ import annotations

import json
import re
import shutil
import time
from pathlib import Path
from typing import Any

import pytest
from pydantic import TypeAdapter

import mantle
from app.case import library, overlay
from app.case import sweep as sweep_file
from app.case.case import dump, load_case
from app.case.run_options import Stage
from app.schema import yaml_file
from app.schema.paths import File
from tests import support
from tests.case.overlays import loaded, messages, write
from tests.cases.blocks import BLOCKS
from tests.support import CONFIGS

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
    other = load_case(CONFIGS / "stance_cocr.yaml").config
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
    case: Any = load_case(path).config
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
    """A path in a base is relative to the base."""
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
    """An error in a default is placed at the section that chose the kind."""
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
    variations = load_case(tmp_path / "case.yaml").variations
    assert [v.case.loads["push"].force for v in variations] == [(3, 0, -4), (6, 0, -8)]  # type: ignore[union-attr]
    by_name = write(tmp_path, named="base: blocks\ngrid: {mesh.size: [2 mm, 5 mm]}\n")
    assert [p.case.title[:14] for p in sweep_file.read(by_name)[1]] == ["Patch test of "] * 2


def test_overlay_resolved_case_is_complete(tmp_path: Path) -> None:
    path = write(tmp_path, blocks=BLOCKS, case="base: blocks.yaml\nregions: {upper: "
                 "{material: 316L}}\nloads: {push: {force: 10 N}}\n")  # fmt: skip
    case = load_case(path)
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
    """Missing entries cause no further errors, such as missing forces for a body weight."""
    loads, mesh = "loads: {library: gaits, body_weight: 600 N}", "mesh: {ordr: 2}"
    text = f"base: blocks.yaml\n{loads}\n{mesh}\nregions: {{upper: {{material: Ti}}}}\n"
    path = write(tmp_path, blocks=BLOCKS, case=text)
    found = [": ".join(message.split(": ")[1:3]) for message in messages(path)]
    assert [text.split("; ")[0] for text in found] == [
        "loads.library: 'gaits' is not in the library",
        "mesh.ordr: unknown key",
        "regions.upper.material: 'Ti' is not in the library",
    ]


def test_overlay_reading_time_is_linear(tmp_path: Path) -> None:
    """Each file is read once, so the time is proportional to its size."""
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
            "{}",
            ("loads.a\x1b[31m.b=1",),
            ["--set loads.a\\x1b[31m.b: "],
        ),
        (
            "{history: [0, 1]}",
            ("loads.history[0]=1", "loads.library[0]=gait"),
            [
                "--set loads.history[0]: loads.history is for all loads: set it as a whole,",
                "--set loads.library[0]: loads.library is for all loads: set it as a whole,",
            ],
        ),
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
    """A history of a load has no place if a common history replaces it."""
    base = "base: stance\nloads: {hip: {history: [0, 1]}}\nstages: [{name: a}, {name: b}]\n"
    above = write(tmp_path, base=base, case="base: base.yaml\nloads: {history: [0, x]}\n")
    (text,) = messages(above)
    assert text.startswith("case.yaml:2:22: loads.history[1]: 'x' is not")
    base = base.replace("hip: {history: [0, 1]}", "history: [0, x]")
    case = "base: base.yaml\nloads: {hip: {history: [y, 1]}}\n"
    texts = messages(write(tmp_path, base=base, case=case))
    assert texts[0].startswith("case.yaml:2:25: loads.hip.history[0]: 'y' is not")
    assert len(texts) == 2 and texts[1].startswith("base.yaml:2:22: loads.history[1]: 'x'")


def test_overlay_kind_replaces_a_material(tmp_path: Path) -> None:
    below, above = tmp_path / "below.yaml", tmp_path / "above.yaml"
    below.write_text("base: stance\nregions: {cortical_bone: {material: cortical_bone}}\n")
    law = "{kind: isotropic, youngs_modulus: 16 GPa, poisson_ratio: 0.31}"
    above.write_text(f"base: below.yaml\nregions: {{cortical_bone: {law}}}\n")
    region = mantle.load(above).config.regions["cortical_bone"]
    assert (region.kind, region.youngs_modulus) == ("isotropic", 16e3)  # type: ignore[union-attr]


def test_overlay_overrides_reach_every_key(two_blocks: str) -> None:
    case = support.case(
        two_blocks,
        "mesh.size=0.1 cm",
        "geometry.blocks[1].name=top_one",
        "regions.upper=",
        "regions={lower: {rigid: true}, top_one: {youngs_modulus: 1 GPa, poisson_ratio: 0}}",
        "regions.top_one.eigenstrains=[{strain: -1e-3}, {strain: [0, 0, 1e-3, 0, 0, 0]}]",
        "supports.base={kind: foundation, boundary: bottom, stiffness: 0.1 GPa/mm}",
        "loads.push.kind=force",
        "loads.push.boundary=top",
        "loads.push.force=[0, 0, -1] kN",
        "solver.petsc.ksp_monitor=true",
        "mesh.size=3 mm",
        "stages.0.name=only",
        "stages.0.increments=3",
    )
    assert case.mesh.size == 3.0
    assert case.stages == (Stage(name="only", increments=3),)
    assert case.geometry.region_names == ("lower", "top_one")
    assert case.loads["push"].force == (0.0, 0.0, -1000.0)  # type: ignore[union-attr]
    assert case.solver.petsc == {"ksp_monitor": True}
    # Single values stand for all directions.
    assert case.supports["base"].stiffness == (100.0, 100.0, 100.0)  # type: ignore[union-attr]
    strains = [e.strain for e in case.regions["top_one"].eigenstrains]  # type: ignore[union-attr]
    assert strains == [(-1e-3, -1e-3, -1e-3, 0, 0, 0), (0, 0, 1e-3, 0, 0, 0)]
