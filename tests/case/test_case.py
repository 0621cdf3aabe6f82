"""Reading, resolving and writing a case; the shipped configurations."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

import mantle
from app.campaigns.runs import runs_of
from app.case import explanations, keys
from app.case import sweep as sweep_file
from app.case.case import PlannedRun, dump, load_case
from app.case.femurs import Femur
from app.foundation.errors import InputError
from app.laws.creep import Creep
from app.laws.interface_laws import Bonded
from app.laws.loads import Force
from app.laws.materials import Rigid
from app.soundness import preview
from tests import support
from tests.support import CONFIGS

EVERY = [
    p
    for f in (".", "start", "verification", "stress")
    for p in sorted((CONFIGS / f).glob("*.yaml"))
]


@pytest.mark.parametrize("path", EVERY, ids=lambda p: p.stem)
def test_case_survives_dump_and_load(path: Path) -> None:
    case = load_case(path).config
    text = dump(case)
    again = support.case(text)
    assert again == case.model_copy(update={"variations": {}})
    assert dump(again) == text


def test_case_schema_for_editors_is_current() -> None:
    """``mantle explain --schema > configs/schema.json`` renews it; shipped cases name it."""
    first = "# yaml-language-server: $schema=schema.json\n"
    assert all(path.read_text().startswith(first) for path in CONFIGS.glob("*.yaml"))
    assert json.loads((CONFIGS / "schema.json").read_text()) == keys.json_schema()


def test_case_stance_is_that_of_the_paper() -> None:
    case = load_case(CONFIGS / "stance.yaml").config
    assert isinstance(case.geometry, Femur)
    assert case.geometry.cement_thickness == 4.0
    hip = case.loads["hip"]
    assert isinstance(hip, Force)
    assert math.hypot(*hip.force) == pytest.approx(1800.0, abs=0.1)
    assert hip.at == case.geometry.head_centre
    assert [law.friction_coefficient for law in case.interfaces.values()] == [0.4, 1.0]  # type: ignore[union-attr]
    forces = np.array([load.force for load in case.loads.values()])  # type: ignore[union-attr]
    medius = [n.startswith("gluteus_medius") for n in case.loads]
    assert forces[medius].sum(axis=0) == pytest.approx([320.6, 124.0, 989.1])


def test_case_defaults_are_filled_in(two_blocks: str) -> None:
    case = support.case(two_blocks)
    assert case.interfaces == {"lower_upper": Bonded()}
    assert [stage.name for stage in case.stages] == ["load"]
    assert case.mesh.far_size_or_default == 8.0
    assert case.loads == {}
    assert case.geometry.blocks[0].size == case.geometry.blocks[1].size == (10.0, 20.0, 5.0)  # type: ignore[union-attr]


@pytest.mark.parametrize("change", ["={kind: rigid}", ".kind=rigid", ".rigid=true"])
def test_case_region_is_rigid_by_its_kind(two_blocks: str, change: str) -> None:
    """The moduli of the former kind are dropped; the tissue stays."""
    text = two_blocks.replace("{rigid: true}", "{material: PMMA, tissue: cement}")
    region = support.case(text, f"regions.upper{change}").regions["upper"]
    assert isinstance(region, Rigid)
    assert region.tissue == ("other" if "{" in change else "cement")


# ------------------------------------------------------------------------------ expressions


@pytest.mark.parametrize(
    "title", ["Lamé, 5 µm", "a\x85b", "a\u2028b", "\ttab", "two\nlines\n", "'", "~", "1e3"]
)
def test_case_title_survives(two_blocks: str, title: str) -> None:
    case = support.case(two_blocks).model_copy(update={"title": title})
    assert support.case(dump(case)) == case


# --------------------------------------------------------------------------------- titles

STANCE = CONFIGS / "stance.yaml"
TITLE = "Single-limb stance, titanium stem, 4 mm mantle"
FRICTION = "interfaces.stem_cement.friction_coefficient=0.1"


@pytest.mark.parametrize(
    ("overrides", "changed"),
    [
        ([], ""),
        (["geometry.cement_thickness=2 mm"], "cement_thickness 2 mm"),
        (["mesh={size: 5 mm, order: 1}"], "mesh size 5 mm, order 1"),
        ([FRICTION, "interfaces.cement_bone.friction_coefficient=0.8"],
         "stem_cement.friction_coefficient 0.1, cement_bone.friction_coefficient 0.8"),
        # A title that is given stays; changes without effect on results have no note.
        (["title=Thin", "geometry.cement_thickness=2 mm"], None),
        (["output.every=2", "solver.tolerance=1e-9"], ""),
    ],
)  # fmt: skip
def test_case_title_names_changes(overrides: list[str], changed: str | None) -> None:
    title = load_case(STANCE, overrides).config.title
    known = "Thin" if changed is None else TITLE
    assert title == (f"{known}; changed: {changed}" if changed else known)


def test_case_titles_of_variations_and_sweeps_differ(tmp_path: Path) -> None:
    text = STANCE.read_text() + "\nvariations: {rough: {interfaces.*.friction_coefficient: 1.5}}\n"
    (tmp_path / "stance.yaml").write_text(text)
    (rough,) = load_case(tmp_path / "stance.yaml").variations
    assert rough.case.title == (
        f"{TITLE}; changed: stem_cement.friction_coefficient 1.5, "
        "cement_bone.friction_coefficient 1.5"
    )
    path = tmp_path / "sweep.yaml"
    path.write_text("base: stance.yaml\ngrid: {geometry.cement_thickness: [2 mm, 3 mm]}\n")
    _, planned = sweep_file.read(path)
    assert [p.case.title for p in planned] == [
        f"{TITLE}; changed: cement_thickness {t} mm" for t in (2, 3)
    ]


def test_case_title_does_not_change_its_identity(tmp_path: Path) -> None:
    """An option that repeats the value of the file leaves the case the same."""
    same = ("geometry.cement_thickness=4 mm",)
    jobs = [PlannedRun.load("a", STANCE), PlannedRun.load("b", STANCE, same)]
    one, two = runs_of(jobs, tmp_path, 1)
    assert one.id == two.id


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        (
            {"stem_length": "120 mm", "tip_z": "-118 mm"},
            "stem_length: puts the shoulder at z = 2 mm; .* 15 mm and",
        ),
        ({"stem_section_z": "31 mm"}, "stem_section_z: puts the shoulder at z = 29 mm; .* 31 mm"),
        ({"stem_tip_z": "16 mm"}, "stem_tip_z: puts the shoulder at z = 163 mm; .* 54 mm"),
        (
            {"stem.section_depth": "147 mm"},
            "stem.section_depth: must be below the stem's length, 147 mm",
        ),
        ({"tip_z": "16 mm"}, "stem.head_height: puts the head's centre at z = 188 mm"),
    ],
)
def test_case_stem_without_section_names_the_key(changes: dict[str, str], text: str) -> None:
    given = {f"geometry.{key}": value for key, value in changes.items()}
    with pytest.raises(InputError, match=f"geometry.{text}") as caught:
        mantle.load(CONFIGS / "stance.yaml", **given)
    assert len(caught.value.messages) == 1


@pytest.mark.parametrize("key", ["stem.length", "stem_length"])
@pytest.mark.parametrize("length", [110.0, 130.0, 160.0])
def test_case_length_of_a_stem_moves_its_tip(key: str, length: float) -> None:
    """The shoulder is at -118 + 147 = 29 mm, and the head 25 mm above it."""
    given = {f"geometry.{key}": f"{length} mm"}
    implant = mantle.load(CONFIGS / "stance.yaml", **given).config.geometry.implant
    assert (implant.tip_z, implant.shoulder, implant.head_height) == (29.0 - length, 29.0, 54.0)


def test_case_former_keys_of_a_stem_are_read_with_a_note() -> None:
    """Levels are 15 mm and 54 mm without a key; the shoulder is at -101 + 130 = 29 mm."""
    old = {"stem_length": "130 mm", "stem_tip_z": "-101 mm", "stem_section_z": "20 mm"}
    old |= {"head_height": "60 mm", "neck_diameter": "12 mm"}
    case = mantle.load(CONFIGS / "stance.yaml", **{f"geometry.{k}": v for k, v in old.items()})
    femur = case.config.geometry
    assert (femur.tip_z, femur.stem.length, femur.stem.section_depth) == (-101.0, 130.0, 9.0)
    assert (femur.stem.head_height, femur.stem.neck_diameter) == (31.0, 12.0)
    notes = [str(n) for n in preview.input_notes(case.config) if "has a new name" in str(n)]
    assert len(notes) == len(old)
    expected = "note: geometry.stem_length: the key 'stem_length' has a new name; use stem.length"
    assert expected in notes


def test_case_former_and_present_keys_of_a_stem_are_refused_together() -> None:
    given = {"geometry.stem.length": "130 mm", "geometry.stem_half_width": "9 mm"}
    with pytest.raises(
        InputError, match=r"stem_half_width: is the former name of stem\.half_width"
    ):
        mantle.load(CONFIGS / "stance.yaml", **given)


def test_case_creep_exponent_requires_stresses() -> None:
    with pytest.raises(ValueError, match="'stresses' is missing, required with m1"):
        Creep.model_validate({"A": 1e-7, "p": 1.8, "m0": 0.3, "m1": 0.02})
    explained = " ".join(explanations.explained("regions.creep.stresses").split())
    assert "required with m1" in explained
