"""Keys of hips without effect are noted, and no others."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import BaseModel

from app.case.case import dump, load_case
from app.case.femurs import Femur
from app.case.geometries import MeshOptions
from app.case.hips import OperatedHip
from app.laws.contact_laws import Contact
from app.patient.geometry import Patient
from app.soundness import preview
from tests import support
from tests.patient import bones

# Two values of each key of a hip, mantle's stem among them. A key without an entry fails a test.
VALUES: dict[str, tuple[Any, Any] | None] = {
    "cement_thickness": ("2 mm", "3 mm"),
    "plug_length": ("12 mm", "14 mm"),
    "tip_void": ("4 mm", "6 mm"),
    "distal_cut_z": ("-215 mm", "-220 mm"),
    "stem.length": ("118 mm", "120 mm"),
    "stem.tip_half_width": ("3 mm", "3.2 mm"),
    "stem.tip_half_depth": ("3 mm", "3.2 mm"),
    "stem.tip_corner_radius": ("2 mm", "2.2 mm"),
    "stem.tip_rounding": ("2 mm", "3 mm"),
    "stem.section_depth": ("14 mm", "16 mm"),
    "stem.half_width": ("7 mm", "7.3 mm"),
    "stem.half_depth": ("4.5 mm", "4.8 mm"),
    "stem.corner_radius": ("3 mm", "3.2 mm"),
    "stem.neck_diameter": ("11 mm", "12 mm"),
    "stem.neck_fillet": ("5 mm", "6 mm"),
    "stem.trunnion_diameter": ("11 mm", "12 mm"),
    "stem.head_offset": ("42 mm", "44 mm"),
    "stem.head_height": ("25 mm", "27 mm"),
    "stem.neck_angle": ("128 deg", "131 deg"),
    "stem.collar.thickness": ("3 mm", "4 mm"),
    "stem.collar.angle": ("90 deg", "140 deg"),
    "resection.height": ("6 mm", "7 mm"),
    "resection.angle": ("36 deg", "38 deg"),
    "resection.azimuth": ("10 deg", "14 deg"),
    "insertion.depth": ("1 mm", "2 mm"),
    "insertion.varus": ("0.2 deg", "0.4 deg"),
    "insertion.flexion": ("0.2 deg", "0.4 deg"),
    "insertion.version.relative_to": None,  # the bones here have no condyles
    "insertion.version.angle": ("-2 deg", "2 deg"),
    "insertion.medial_offset": ("0.5 mm", "1 mm"),
    "insertion.anterior_offset": ("0.5 mm", "1 mm"),
    "insertion.best": None,  # changes the other numbers of an insertion
    # Of the parametric femur.
    "canal_widening": ("1 mm", "1.5 mm"),
    "metaphyseal_cortex": ("3 mm", "2.5 mm"),
    "tip_z": ("-100 mm", "-98 mm"),
    "anteversion": ("10 deg", "12 deg"),
    # Of a patient.
    "bone.surface": None,  # files and their units
    "bone.image": None,
    "bone.label": None,
    "bone.unit": None,
    "bone.side": None,  # the other one is refused
    "bone.extend": None,  # a permission: it does nothing where a scan is long enough
    "canal.surface": None,
    "canal.image": None,
    "canal.label": None,
    "canal.unit": ("mm", "mm"),
    "canal.ct": None,
    "canal.threshold": (500, 600),
    "canal.isthmus": ("12 mm", "13 mm"),
    "canal.ream": ("by", "broach"),
    "canal.ream_by": ("0.5 mm", "1 mm"),
    "landmarks.head_centre": ([41, 11, 54], [42, 11, 55]),
    "landmarks.lesser_trochanter": ([20, -5, 0], [20, -5, 1]),
    "landmarks.shaft": ([[0, 0, -100], [0, 0, -20]], [[0.5, 0, -100], [0, 0, -20]]),
    "landmarks.condyles": (
        [[20, -20, -300], [-20, -20, -300]],
        [[20, -25, -300], [-20, -20, -300]],
    ),
}
MESH = MeshOptions.model_validate({"size": "8 mm"})
SLIM = {"length": "118 mm", "half_width": "7 mm", "half_depth": "4.5 mm", "neck_diameter": "11 mm"}
SCENES: dict[str, tuple[type[OperatedHip], dict[str, Any]]] = {
    "femur": (Femur, {"stem": SLIM, "tip_z": "-100 mm"}),
    "femur, no cement": (Femur, {"stem": SLIM, "tip_z": "-100 mm", "cement_thickness": "0 mm"}),
    "femur, inserted": (Femur, {"stem": SLIM, "tip_z": "-100 mm", "insertion": {"depth": "1 mm"}}),
    "patient, reamed by": (
        Patient,
        {"stem": SLIM, "cement_thickness": "2 mm", "canal": {"ream": "by"}},
    ),
    "patient, no cement": (
        Patient,
        {"stem": SLIM, "cement_thickness": "0 mm", "canal": {"ream": "broach"}},
    ),
}

# Keys whose other value is refused: without cement nothing is reamed for it.
REFUSED = {("femur, no cement", "canal_widening"), ("patient, no cement", "canal.ream")}


def keys_of(model: type[BaseModel], above: str = "") -> Iterator[str]:
    """Leaves of a section, of the first kind if there are several."""
    for name, field in model.model_fields.items():
        if name == "kind":
            continue
        options = [field.annotation, *getattr(field.annotation, "__args__", ())]
        options += [part for o in options for part in getattr(o, "__args__", ())]
        inner = [o for o in options if isinstance(o, type) and issubclass(o, BaseModel)]
        named = [o for o in inner if o.__name__ not in ("GradedThickness", "Search")]
        if named:
            yield from keys_of(named[0], f"{above}{name}.")
        else:
            yield above + name


def changed(keys: dict[str, Any], path: str, value: Any) -> dict[str, Any]:
    first, _, rest = path.partition(".")
    below = keys.get(first)
    inner = changed(dict(below or {}), rest, value) if rest else value
    return keys | {first: inner}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bone")
    bones.write(path / "bone.stl", bones.parametric_femur())
    return path


def made(scene: str, folder: Path, path: str = "", value: Any = None) -> OperatedHip:
    kind, keys = SCENES[scene]
    if kind is Patient:
        keys = keys | {"bone": {"surface": "bone.stl"}}
    if path:
        keys = changed(keys, path, value)
    return kind.model_validate(keys, context={"folder": folder})


def trace(geometry: OperatedHip) -> str:
    """Hash of the surfaces of a hip, its head and the insertions of its muscles [mm]."""
    mesh = MeshOptions.model_validate({"size": "8 mm", "around": 16})
    surfaces = geometry.surfaces(mesh)
    last = sum(segment.steps for segment in surfaces.segments)
    phi, s = (v.ravel() for v in np.meshgrid(np.arange(8) / 8, np.linspace(0.0, last, 30)))
    lines = surfaces.lines(phi, s)
    ends = [surfaces.to_model(x) for x in (lines.start, lines.end)]
    values = [*ends, lines.mantle, lines.endosteum, np.array(list(geometry.points.values()))]
    named = (*geometry.region_names, last, len(surfaces.spans) if geometry.has_collar else 0)
    text = repr(named).encode() + b"".join((np.round(v, 5) + 0.0).tobytes() for v in values)
    return hashlib.sha256(text).hexdigest()


@pytest.mark.parametrize("kind", [Femur, Patient])
def test_hips_keys_without_effect_are_looked_for_among_all(kind: type[OperatedHip]) -> None:
    assert set(keys_of(kind)) <= VALUES.keys()


def tried() -> Iterator[Any]:
    for scene, (kind, _) in SCENES.items():
        for path in keys_of(kind):
            if VALUES[path] is not None and (scene, path) not in REFUSED:
                # Each landmark reads the bone anew.
                marks = [pytest.mark.slow] if path.startswith("landmarks") else []
                yield pytest.param(scene, path, id=f"{scene}: {path}", marks=marks)


@pytest.mark.parametrize(("scene", "path"), tried())
def test_hips_keys_without_effect_are_those_that_change_nothing(
    folder: Path, scene: str, path: str
) -> None:
    one, other = (made(scene, folder, path, value) for value in VALUES[path] or ())
    said = ("geometry", *path.split(".")) in one.without_effect(MESH)
    assert said == (trace(one) == trace(other)), one.without_effect(MESH)


def test_hips_keys_without_effect_are_noted_where_they_are_given() -> None:
    given = (
        "geometry.cement_thickness=0 mm",
        "geometry.stem.tip_rounding=3 mm",
        "mesh.far_size=30 mm",
        "regions.cement=null",
        "interfaces={stem_bone: {kind: contact, friction_coefficient: 0.5, gap_history: [1]}}",
    )
    case = load_case(support.CONFIGS / "stance.yaml", given).config
    notes = {n.where: str(n) for n in preview.input_notes(case)}
    expected = {"geometry.stem.tip_rounding", "mesh.far_size", "interfaces.stem_bone.gap_history"}
    assert {where for where, text in notes.items() if "has no effect" in text} == expected
    assert "the end of the stem is flat above a void of 5 mm" in notes["geometry.stem.tip_rounding"]


def test_hips_keys_without_effect_are_not_noted_in_a_case_that_mantle_wrote(tmp_path: Path) -> None:
    (tmp_path / "case.yaml").write_text(dump(load_case(support.CONFIGS / "pressed.yaml").config))
    notes = preview.input_notes(load_case(tmp_path / "case.yaml").config)
    assert not [n.where for n in notes if "has no effect" in str(n)]


def test_hips_keys_without_effect_are_those_of_covered_zones() -> None:
    zones = {
        "inner": {"above": "20 mm", "below": "40 mm", "friction_coefficient": 0.3, "gap": "0.1 mm"},
        "outer": {"below": "60 mm", "interference": "0.02 mm"},
    }
    law = Contact.model_validate({"kind": "contact", "friction_coefficient": 0.5, "zones": zones})
    covered = {("zones", "inner", key) for key in ("gap", "interference")}
    assert law.without_effect.keys() == covered
