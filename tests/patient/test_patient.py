"""A patient's femur: the parametric one as triangles, and a measured one, with a stem."""

from __future__ import annotations

import math
import random
import re
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial import cKDTree

from app.case.geometries import Femur
from app.case.hips import MUSCLES
from app.case.stems import StemFile
from app.foundation.arrays import Floats
from app.foundation.errors import GeometryError
from app.patient import bone_surface
from app.patient.bone_surface import BoneSurface
from app.patient.geometry import Patient
from app.patient.measured_layers import MeasuredLayers
from app.soundness import preview
from meshes import _make, femur_bone, femur_stem, quality
from meshes.data import interface_facets, region_volumes
from meshes.femur_bone import CORTEX_LEFT
from meshes.gruen import Zones
from meshes.layered_surfaces import LEAST_MANTLE, LayeredSurfaces
from meshes.placement import lengthening
from tests import support
from tests.meshes import cad_stems
from tests.patient.bones import (
    LINES,
    MEASURED,
    MEASURED_CANAL,
    VERSION,
    moved,
    parametric_canal,
    parametric_femur,
    turned,
    write,
)
from tests.patient.patients import TURNED, as_own, made, measured, options, patient
from tests.patient.surface_text import damaged, obj_faces, obj_vertices, ply_binary, put, stl


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Surfaces of the parametric femur."""
    path = tmp_path_factory.mktemp("bone")
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    for name, surface in (("bone", parametric_femur()), ("canal", parametric_canal())):
        write(path / f"{name}.stl", surface)
        write(path / f"{name}_moved.stl", moved(surface, turn, np.array([50.0, -20.0, 900.0])))
    return path


def test_patient_bone_of_the_parametric_femur_equals_it(folder: Path) -> None:
    """Volumes agree to 1 %, because the polygons are within the bone. The stem is the same.

    A canal by ratios leaves 2 mm of cortex in the metaphysis.
    """
    thin = TURNED.model_copy(update={"metaphyseal_cortex": 2.0})
    here, there = made(as_own(folder)), made(thin)
    volumes, expected = region_volumes(here), region_volumes(there)
    assert volumes["stem"] == pytest.approx(expected["stem"], rel=1e-4)
    within = LINES / (2 * math.pi) * math.sin(2 * math.pi / LINES)  # of a circle, a polygon
    for name in ("cortical_bone", "cancellous_bone"):
        assert volumes[name] == pytest.approx(within * expected[name], rel=0.01)
    assert volumes["cement"] == pytest.approx(expected["cement"], rel=0.01)
    assert set(here.boundaries) == set(there.boundaries)
    assert here.notes["quality"]["sicn_min"] > 0.05
    head = turned(np.array([here.notes["head_centre"]]), math.radians(VERSION))
    assert head[0] == pytest.approx(there.notes["head_centre"], abs=0.3)


def test_patient_note_on_the_canal_has_the_level_of_its_file(folder: Path) -> None:
    """The note has the level at which the surface ends.

    It also has that of the last whole section of the mesh.
    """
    geometry = patient(folder, canal={"surface": "canal.stl", "ream": "broach"})
    bone = LayeredSurfaces(geometry, options()).bone
    assert isinstance(bone, MeasuredLayers) and geometry.femur.canal
    (text,) = (note for note in bone.notes if note.startswith("canal: "))
    numbers = [float(number) for number in re.findall(r"(-?\d+) mm[,;]", text)]
    assert numbers[0] == pytest.approx(geometry.femur.canal.points[:, 2].max(), abs=0.5)
    assert numbers[1] < numbers[0]


@pytest.mark.parametrize(
    ("ream", "starts"),
    [
        ("none", {"least bone around the canal"}),
        ("broach", {"most bone removed by reaming", "least bone left by reaming"}),
    ],
)
def test_patient_notes_on_reaming_are_those_of_a_reamed_canal(
    ream: str, starts: set[str], folder: Path
) -> None:
    geometry = patient(folder, canal={"surface": "canal.stl", "ream": ream})
    bone = LayeredSurfaces(geometry, options()).bone
    assert isinstance(bone, MeasuredLayers)
    titles = {note.partition(":")[0] for note in bone.notes}
    words = ("reaming", "around the canal")
    assert {title for title in titles if any(word in title for word in words)} == starts


def test_patient_bone_zones_equal_the_parametric_ones(folder: Path) -> None:
    x = np.random.default_rng(0).uniform((-15, -15, -150), (15, 15, 5), (4000, 3))
    here, there = Zones(as_own(folder)), Zones(TURNED)
    y = turned(x, math.radians(VERSION))
    assert (here.zones_at(x) == there.zones_at(y)).mean() > 0.98
    assert here.depth(x) == pytest.approx(there.depth(y), abs=0.4)


def test_patient_bone_is_independent_of_scan_axes(folder: Path) -> None:
    canal = {"surface": "canal_moved.stl", "ream": "broach"}
    still = patient(folder, canal=canal | {"surface": "canal.stl"})
    turned = patient(folder, bone={"surface": "bone_moved.stl"}, canal=canal)
    one, other = (LayeredSurfaces(g, options()) for g in (still, turned))
    s = np.linspace(0, one.cut, 200)
    phi = np.random.default_rng(1).uniform(size=200)
    a, b = one.lines(phi, s), other.lines(phi, s)
    assert a.end == pytest.approx(b.end, abs=0.1)
    assert a.endosteum == pytest.approx(b.endosteum, abs=0.02)


# The parametric stem below the cut, placed where its shoulder is out of the bone.
NECK = (135.919, 130.0, 4.9, 5.5, 56.133)
PUT = {"depth": "-1 mm", "varus": "1 deg", "version": {"angle": "-8 deg"}}
IN = {"canal": {"ream": "broach"}, "insertion": PUT}


def test_patient_stem_from_a_file_equals_the_parametric_stem(folder: Path) -> None:
    """Circles of 6 mm agree to 0.008 mm, the axis to 0.005 mm.

    The end of the file's stem is flat.
    """
    file = {"step": cad_stems.write("parametric", folder, neck=NECK)}
    given, here = patient(folder, **IN), patient(folder, stem=file, **IN)
    (there, expected), (data, volumes) = ((d, region_volumes(d)) for d in map(made, (given, here)))
    assert here.head_centre == pytest.approx(given.head_centre, abs=0.02)
    assert here.details["end of the neck in parametric.step"] == "[43.0, 0.0, 172.0] mm"
    x = here.placement.to_stem(data.points[np.unique(interface_facets(data, "stem_cement")[0])])
    x, y, z = x[x[:, 2] > -146.9].T
    body = femur_stem.shaft_of(given.implant)
    assert len(z) > 200 and z.max() < 0
    assert np.hypot(x, y) == pytest.approx(body.radius(np.arctan2(y, x), z), abs=0.013)
    for name in ("cement", "cortical_bone", "cancellous_bone"):
        assert volumes[name] == pytest.approx(expected[name], rel=0.008), name
    nominal = [d.notes["mantle"]["thickness"]["median"] for d in (data, there)]
    assert nominal[0] == pytest.approx(nominal[1], abs=0.02)


def test_patient_right_femur_is_mirrored_with_its_stem(folder: Path) -> None:
    """The stem is not symmetric. Its medial direction is that to a head outside its plane."""
    file, mirror = cad_stems.write("parametric", folder, neck=NECK), np.diag([-1.0, 1.0, 1.0])
    write(folder / "right.stl", moved(parametric_femur(), mirror, np.zeros(3)))
    shapes = []
    for name, y, side in (("bone", -8, "left"), ("right", 8, "right, mirrored")):
        stem = {"step": file, "head_centre": ["42 mm", f"{y} mm", "172 mm"]}
        geometry = patient(folder, bone={"surface": f"{name}.stl"}, stem=stem, **IN)
        assert geometry.details["side"] == side
        body = LayeredSurfaces(geometry, options()).stem.shaft
        shapes.append(np.stack([body._cached_outline(z, 0.1, 0.0) for z in (-140.0, -80.0, -20.0)]))
        shapes.append(np.array(list(geometry.points.values())))
    one, points, other, mirrored = shapes
    assert points == pytest.approx(mirrored, abs=0.05)
    assert one == pytest.approx(other, abs=0.02)
    assert np.abs(one[:, 1:] - one[:, :0:-1] * [1, -1, 1]).max() > 0.5


def test_patient_muscles_are_on_the_bone_below_the_cut(folder: Path) -> None:
    geometry = patient(folder)
    placement = geometry.placement
    for name in MUSCLES:
        x = np.array(geometry.points[name])
        assert np.linalg.norm(geometry.femur.surface.corners.mean(axis=1) - x, axis=1).min() < 1e-9
        assert (x - placement.foot) @ placement.normal < -7.9
    assert "vastus_medialis" in geometry.details["muscles moved (mm)"]


def test_patient_stem_has_the_given_position(folder: Path) -> None:
    """Version and offsets are relative to the patient's neck."""
    at = patient(folder).placement
    aside = {"medial_offset": "2 mm", "anterior_offset": "1 mm"}
    put = patient(folder, insertion=aside | {"version": {"angle": "10 deg"}}).placement
    x, y, _ = put.rotation[:, 0]
    assert math.degrees(math.atan2(y, x)) == pytest.approx(10.0, abs=0.1)
    assert put.foot[:2] - at.foot[:2] == pytest.approx([2.0, 1.0], abs=0.02)


@pytest.mark.parametrize(
    ("stem", "words"),
    [
        (
            {"neck_diameter": "19 mm"},
            r"is wider than the stem's shoulder; expected at most 18\.2 mm",
        ),
        ({"neck_angle": "150 deg"}, "is not between 100 and 145 deg"),
        ({"corner_radius": "5 mm"}, "is not below the half-width and half-depth, 5 mm"),
        ({"tip_rounding": "0.5 mm"}, "must be 0 or at least 1 mm"),
        (
            {"tip_half_depth": "9 mm", "half_depth": "3.1 mm"},
            r"is 2\.?\d* mm at the shoulder, .* Raise half_depth, or reduce tip_half_depth",
        ),
    ],
)
def test_patient_stem_without_room_is_refused_in_any_bone(
    stem: dict[str, str], words: str, folder: Path
) -> None:
    """At its shoulder the parametric stem is 18.16 mm wide. Half depths fall by 5.9 in 133 mm."""
    with pytest.raises(ValidationError, match=words):
        patient(folder, stem=stem)
    with pytest.raises(ValidationError, match=words):
        Femur.model_validate({"stem": stem})


def random_patient(
    folder: Path, seed: int, bone: BoneSurface, canal: BoneSurface, deepest: float = 2.0
) -> Patient:
    """A bone stretched and sheared, left or right, with random stem, mantle, cut, position, canal.

    Every fifth stem is from CAD.
    """
    rng = np.random.default_rng(seed)
    shear = np.triu(math.tan(math.radians(3)) * rng.uniform(-1, 1, (3, 3)), 1)
    change = np.diag(rng.uniform(0.94, 1.06, 3) * [(-1) ** seed, 1, 1]) @ (np.eye(3) + shear)
    for name, surface in ((f"{seed}", bone), (f"{seed}_canal", canal)):
        write(folder / f"{name}.stl", moved(surface, change, np.zeros(3)))
    most = {"medial_offset": 2, "anterior_offset": 2, "depth": deepest}
    shift = {k: f"{rng.uniform(-2, far)} mm" for k, far in most.items()}
    turn = {"varus": f"{rng.uniform(0, 3)} deg", "version": {"angle": f"{rng.uniform(-15, 5)} deg"}}
    canal_file = {"surface": f"{seed}_canal.stl"} if rng.uniform() < 0.8 else {}
    cement, distal = (f"{t} mm" for t in rng.uniform(3, 6, 2))
    stem: dict[str, Any] = {"length": f"{rng.uniform(100, 147)} mm"}
    if seed % 5 == 4:
        kind = ("exeter", "short", "charnley", "anatomic")[seed // 5 % 4]
        stem = {"step": cad_stems.write(kind, folder)}
    return patient(
        folder,
        bone={"surface": f"{seed}.stl", "unit": "mm"},
        canal={"ream": "broach"} | canal_file,
        insertion=shift | turn,
        cement_thickness={"proximal": cement, "distal": distal} if seed % 2 else cement,
        stem=stem,
        tip_void=f"{5 * (seed % 3 == 2)} mm",
        resection={"angle": f"{rng.uniform(34, 44)} deg"},
    )


def _own(geometry: Patient) -> Floats:
    """Points of the parametric stem in axes of the stem (n, 3) [mm]."""
    placement, implant = geometry.placement, geometry.implant
    z, phi = np.meshgrid(np.arange(-geometry.stem.length, 20.0), np.arange(48) / 48)
    slope, lean = placement.slopes
    body = replace(femur_stem.shaft_of(implant), lean=lean)
    x = body.point(phi.ravel(), z.ravel(), 0.0)
    edge = min(femur_stem.shoulder_plane_height(implant, slope), placement.top)
    if edge < placement.top:  # metal is on the body up to there, and then on the way to the neck
        x = x[x @ [slope, slope * lean, 1.0] < edge]
        upper = femur_stem.stem_above_cut(implant, body, options(), edge, placement.top, slope)
        z, phi = np.meshgrid(np.linspace(edge, placement.top, 20), np.arange(48) / 48)
        x = np.concatenate([x, upper.point(phi.ravel(), z.ravel())])
    return x


def distance(geometry: Patient) -> float:
    """Least distance of the stem below the cut from the bone's triangles, up to 10 mm [mm].

    Points of both are compared, without sections or rays. The distance is near 0 where a stem
    leaves the bone.
    """
    placement, corners = geometry.placement, geometry.femur.surface.corners
    if isinstance(geometry.stem, StemFile):
        tip = [0.0, 0.0, geometry.implant.tip_z]
        x = np.add(geometry.stem.shape["x"].mean(axis=1), tip)
    else:
        x = _own(geometry)
    x = placement.to_model(x)
    x = x[(x - placement.foot) @ placement.normal < 0]
    parts = [(i / 4, j / 4, 1 - (i + j) / 4) for i in range(5) for j in range(5 - i)]
    y = (parts @ corners[corners[:, 0, 2] > x[:, 2].min() - 10]).reshape(-1, 3)
    below = cKDTree(y[(y - placement.foot) @ placement.normal < 0])
    return float(below.query(x, distance_upper_bound=10.0)[0].min())


def check(geometry: Patient, seed: int) -> bool:
    """Return whether the mesh was made at the first attempt.

    Otherwise the refusal must name the right place.
    """
    mesh = options(size=f"{6 + seed % 3} mm", order=1 + seed % 2, around=None)
    try:
        data = _make(geometry, mesh)
    except GeometryError as error:
        assert "mm below the cut" in str(error), seed
        assert distance(geometry) < LEAST_MANTLE + CORTEX_LEFT, seed
        return False
    # Wedges where thin layers of cancellous bone begin are short, for the sake of accuracy: the
    # worst of a hundred copies has 0.012.
    assert data.notes["quality"]["sicn_min"] > quality.BAD, seed
    assert data.notes["mantle"]["thickness"]["min"] > 0.8
    return True


@pytest.mark.parametrize("seed", range(12))
def test_patient_random_cases_mesh_or_are_refused(tmp_path: Path, seed: int) -> None:
    check(random_patient(tmp_path, seed, parametric_femur(), parametric_canal(), 12.0), seed)


@measured
@pytest.mark.slow
def test_patient_hundred_copies_have_room_in_four_fifths(tmp_path: Path) -> None:
    """Copies of the measured femur are larger by a fifth.

    At least four fifths have room for the stem.
    """
    surfaces = [
        moved(bone_surface.read(path, "mm"), 1.2 * np.eye(3), np.zeros(3))
        for path in (MEASURED, MEASURED_CANAL)
    ]
    meshed = sum(check(random_patient(tmp_path, seed, *surfaces), seed) for seed in range(100))
    assert meshed >= 80


@measured
def test_patient_cells_at_calcar_and_plug_are_sound(tmp_path: Path) -> None:
    """This is one of the worst of a hundred patients.

    Layers are oblique at the neck, and sections long in the shaft.
    """
    surfaces = [
        moved(bone_surface.read(path, "mm"), 1.2 * np.eye(3), np.zeros(3))
        for path in (MEASURED, MEASURED_CANAL)
    ]
    geometry = random_patient(tmp_path, 8, *surfaces)
    for order, least, percent in ((1, 0.06, 0.14), (2, 0.05, 0.13)):
        data = _make(geometry, options(size="4 mm", order=order, around=None))
        stubbiness = quality.quality_without_length(data.points, data.cells)
        assert stubbiness.min() > least and np.quantile(stubbiness, 0.01) > percent


def measured_hip(folder: Path, cement: float, mirrored: bool = False) -> Patient:
    """The measured femur with a stem from a file, placed by docs/howto/your_hip.md."""
    change = np.diag([-1.0 if mirrored else 1.0, 1.0, 1.0])
    for name, path in (("bone", MEASURED), ("canal", MEASURED_CANAL)):
        write(folder / f"{name}.stl", moved(bone_surface.read(path, "mm"), change, np.zeros(3)))
    return patient(
        folder,
        bone={"surface": "bone.stl", "unit": "mm"},
        canal={"surface": "canal.stl", "ream": "broach"},
        stem={"step": cad_stems.write("exeter", folder)},
        cement_thickness=f"{cement} mm",
    )


@measured
@pytest.mark.parametrize("size", [3.1, 3.0, 2.7, 2.2])
def test_patient_measured_femur_meshes_at_any_size(tmp_path: Path, size: float) -> None:
    """A section can cut off the corner of the shoulder next to the neck, which leaves a horn."""
    data = _make(measured_hip(tmp_path, 3.0), options(size=f"{size} mm", around=None))
    assert quality.quality_without_length(data.points, data.cells).min() > 0.035


@measured
@pytest.mark.slow
@pytest.mark.parametrize("cement", [2.0, 3.0, 5.0])
@pytest.mark.parametrize("kind", ["parametric", "measured", "mirrored"])
def test_patient_meshes_at_all_sizes(tmp_path: Path, kind: str, cement: float) -> None:
    """Curved meshes of 8 to 2 mm by 0.1 are accepted. No cell, if shorter, is below 0.03."""
    if kind == "parametric":
        geometry: Any = Femur.model_validate({"cement_thickness": f"{cement} mm"})
    else:
        geometry = measured_hip(tmp_path, cement, kind == "mirrored")
    for tenths in range(80, 19, -1):
        mesh = options(size=f"{tenths / 10} mm", order=2, around=None)
        data = _make(geometry, mesh)
        assert quality.quality_without_length(data.points, data.cells).min() > 0.03, mesh.size


@measured
def test_patient_stem_too_deep_is_refused_with_remedy(tmp_path: Path) -> None:
    """A thin calcar is next to a shoulder 11 mm below the cut. Layers fold at all similar sizes."""
    surfaces = [
        moved(bone_surface.read(path, "mm"), 1.2 * np.eye(3), np.zeros(3))
        for path in (MEASURED, MEASURED_CANAL)
    ]
    geometry = random_patient(tmp_path, 1012, *surfaces, 12.0)
    words = (
        r"layers cut through each other; the worst:\n  cortical_bone at \((.|\n)*"
        r"\nChange geometry\.insertion or geometry\.resection: elements are also inverted or"
        r" nearly flat with mesh\.size from 4\.5 to 8 mm"
    )
    with pytest.raises(GeometryError, match=words):
        _make(geometry, options(size="5 mm", around=None))


def test_patient_places_in_an_image_are_inside_the_bone(folder: Path) -> None:
    """The bone is rotated, shifted and mirrored.

    Places are at least 1.5 mm deep, and at their true depth.
    """
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    shift = np.array([50.0, -20.0, 900.0])
    here, there = (patient(folder, bone={"surface": f"bone{k}.stl"}) for k in ("", "_moved"))
    angle, z = 2 * np.pi * np.arange(16) / 16, np.linspace(-110.0, -60.0, 16)
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(16)], axis=1)
    tube = femur_bone.PERIOSTEUM
    for depth in (0.0, 3.0):
        x = (tube.radius(angle, z) - depth)[:, None] * ring + [0.0, 0.0, 1.0] * z[:, None]
        mapped = here.in_file(here.femur.frame.to_model(x), 1.5)
        least = max(depth, 1.5)
        assert np.hypot(*mapped[:, :2].T) == pytest.approx(tube.radius(angle, z) - least, abs=0.3)
        moved_ = there.in_file(there.femur.frame.to_model(x @ turn.T + shift), 1.5)
        assert moved_ == pytest.approx(mapped @ turn.T + shift, abs=0.05)


@pytest.mark.parametrize(("height", "noted"), [("25 mm", False), ("30 mm", True)])
def test_patient_leg_length_is_noted(folder: Path, height: str, noted: bool) -> None:
    """The head of the stem is compared with that of the bone, along the shaft."""
    geometry = patient(folder, stem={"head_height": height}, canal={"ream": "broach"})
    case = support.case("base: stance").model_copy(update={"geometry": geometry})
    longer = lengthening(geometry)
    notes = [v.what for v in preview.input_notes(case) if "the leg becomes" in v.what]
    assert (abs(longer) > 10.0) == noted
    assert notes == ([f"the leg becomes {longer:.0f} mm longer"] if noted else [])


def odd(corners: Any, seed: int) -> Any:
    """Triangles of a bone. Some are missing, stretched, doubled, cut or wavy."""
    rng = np.random.default_rng(seed)
    match seed % 5:
        case 0:
            return corners[rng.random(len(corners)) > rng.choice([0.5, 0.9, 0.02])]
        case 1:
            return corners @ np.diag(rng.uniform(0.4, 2.0, 3))
        case 2:
            return np.concatenate([corners, corners + rng.normal(size=3)])
        case 3:
            return corners[corners[:, :, 2].mean(axis=1) > rng.uniform(-250, 50)]
        case _:
            return corners + rng.normal(0, 0.3, 3) * np.sin(corners * rng.uniform(0.1, 3))


@pytest.mark.slow
def test_patient_placement_of_damaged_bones_or_refusal(tmp_path: Path) -> None:
    """Bytes of files, or shapes, are damaged. Numpy prints no warnings."""
    surface = parametric_femur()
    whole = {
        "bone.stl": write(tmp_path / "bone.stl", surface).read_bytes(),
        "bone.obj": (obj_vertices(surface.points) + obj_faces(surface.triangles)).encode(),
        "bone.ply": ply_binary(surface),
    }
    for seed in range(60):
        rng = random.Random(seed)
        name = rng.choice(sorted(whole)) if seed % 4 else "bone.stl"
        if seed % 4:
            put(tmp_path, name, damaged(rng, whole[name]))
        else:
            stl(tmp_path, odd(surface.corners, seed // 4))
        given = {"bone": {"surface": name, "unit": "mm"}, "stem": {"length": "100 mm"}}
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                Patient.model_validate(given, context={"folder": tmp_path})
        except ValidationError:
            continue
        except BaseException as error:
            raise AssertionError(f"seed {seed}: {name}") from error
