"""A first case by labels and CT: its content, and that it is valid."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import nibabel
import numpy as np
import pytest
import ruamel.yaml
from scipy.ndimage import affine_transform
from scipy.spatial import cKDTree

from app.case import case as case_file
from app.foundation.errors import InputError
from app.patient import first_case
from app.patient.geometry import Landmarks, Patient
from app.soundness.preview import input_notes
from meshes import femur_bone, room
from meshes.placement import lengthening
from meshes.plane_sections import centroid
from tests.patient.scans import HIP, NUMBERS, in_patient, scan


@pytest.mark.parametrize(
    ("side", "edges", "tilt"),
    [("left", (1.2, 1.2, 1.2), 0.0), ("right", (1.0, 1.0, 5.0), 10.0)],
    ids=["left", "right oblique in thick slices"],
)
def test_first_case_of_a_scan_has_the_bone_of_the_patient(
    tmp_path: Path, side: str, edges: tuple[float, float, float], tilt: float
) -> None:
    """The surface is within half a voxel of the truth on average, the cortex within 0.5 mm."""
    folder = scan(tmp_path, 130.0, side, edges, tilt)
    labels, ct = folder / "labels.nii.gz", folder / "ct.nii.gz"
    path, assumed = first_case.write(folder / "hip", labels, ct, None, None)
    assert len(assumed) == 5
    assert f"femur_{side} (label" in assumed[0]
    assert "the axes of the image agree" in assumed[0]
    assert "the shaft is continued" in assumed[1]
    assert "body weight 600 N (loads.body_weight)" in assumed[4]
    geometry = case_file.load_case(path).config.geometry
    assert isinstance(geometry, Patient)
    femur, frame = geometry.femur, geometry.femur.frame
    assert frame.side == side
    truth, _, head = in_patient(side)
    assert np.linalg.norm(frame.head - head) < 0.7
    scanned = femur.surface.points[femur.surface.points[:, 2] > frame.end]
    triangles = frame.to_model(truth.corners)
    parts = np.random.default_rng(0).dirichlet([1.0, 1.0, 1.0], 40)
    samples = np.einsum("pc,tcx->tpx", parts, triangles).reshape(-1, 3)
    apart = cKDTree(samples).query(scanned)[0]
    assert apart.mean() < 0.5 * max(edges[0], 1.0)
    assert np.percentile(apart, 95) < 1.5
    z, turn = -60.0, np.linspace(0.0, 2 * np.pi, 48, endpoint=False)
    for surface, table in ((femur.surface, femur_bone.OUTER), (femur.canal, femur_bone.CANAL)):
        expected = femur_bone.Tube(table).radius(turn, np.full(48, z)).mean()
        radius = math.sqrt(centroid(surface.level(z))[1] / math.pi)
        assert radius == pytest.approx(expected, abs=0.25)


def test_first_case_says_where_the_scan_ends(tmp_path: Path) -> None:
    """It ends with its lowest voxels, 130 mm below the head, as far below the lesser trochanter."""
    folder = scan(tmp_path, 130.0, edges=(1.5, 1.5, 1.5))
    path, assumed = first_case.write(folder / "hip", folder / "labels.nii.gz", None, None, None)
    geometry = case_file.load_case(path).config.geometry
    assert isinstance(geometry, Patient)
    frame = geometry.femur.frame
    depth = 130.0 - float(frame.head[2] - frame.trochanter[2])
    found = re.search(r"the scan ends (\d+) mm below the lesser trochanter", assumed[1])
    assert found
    assert float(found[1]) == pytest.approx(depth, abs=1.5)
    notes = [v.what for v in input_notes(case_file.load_case(path).config)]
    assert any(f"the scan ends at z = -{found[1]} mm" in note for note in notes)
    assert abs(lengthening(geometry)) < first_case.LEG_LIMIT


def test_first_case_has_the_canal_of_a_ct_that_is_turned(tmp_path: Path) -> None:
    """Its slices are turned by 25 degrees about the shaft; its numbers are those of each place."""
    folder = scan(tmp_path, 120.0, edges=(1.5, 1.5, 1.5))
    image = nibabel.load(folder / "ct.nii.gz")
    values, affine = np.asarray(image.dataobj, float), image.affine
    angle = math.radians(25.0)
    turn = np.eye(4)
    turn[:2, :2] = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
    middle = affine @ np.r_[(np.array(values.shape) - 1) / 2, 1.0]
    about, back = np.eye(4), np.eye(4)
    about[:3, 3], back[:3, 3] = middle[:3], -middle[:3]
    shape = (2 * max(values.shape[:2]), 2 * max(values.shape[:2]), values.shape[2])
    start = np.eye(4)
    start[:2, 3] = [(a - b) / 2 for a, b in zip(values.shape[:2], shape[:2], strict=True)]
    turned = about @ turn @ back @ affine @ start
    index = np.linalg.inv(affine) @ turned
    numbers = affine_transform(
        values, index[:3, :3], index[:3, 3], output_shape=shape, order=1, mode="nearest"
    )
    nibabel.Nifti1Image(numbers.astype(np.int16), turned).to_filename(folder / "turned.nii.gz")
    widths = []
    for name in ("ct", "turned"):
        ct = folder / f"{name}.nii.gz"
        path, _ = first_case.write(folder / name, folder / "labels.nii.gz", ct, None, None)
        geometry = case_file.load_case(path).config.geometry
        assert isinstance(geometry, Patient)
        widths.append(math.sqrt(centroid(geometry.femur.canal.level(-40.0))[1] / math.pi))
    assert widths[1] == pytest.approx(widths[0], abs=0.15)


@pytest.mark.parametrize("below", [24.0, 33.0, 60.0])
def test_first_case_says_what_a_scan_lacks(below: float, tmp_path: Path) -> None:
    """The apex of the lesser trochanter is 51 mm below the head, and 17 and 3 mm are below it."""
    folder = scan(tmp_path, below, edges=(1.5, 1.5, 1.5))
    with pytest.raises(InputError, match=r"ends about \d+ mm lower") as caught:
        first_case.write(folder / "hip", folder / "labels.nii.gz", None, None, None)
    found = re.search(r"about (\d+) mm lower", str(caught.value))
    assert found
    assert float(found[1]) == pytest.approx(51.3 + 17.1 + 3.0 - below, abs=3.0)


def test_first_case_names_no_keys_that_init_has_not(tmp_path: Path) -> None:
    """A message on keys of a case says how to give them."""
    folder = scan(tmp_path, 40.0, edges=(1.5, 1.5, 1.5))
    words = r"landmarks\.shaft .* `mantle init` takes no such keys"
    with pytest.raises(InputError, match=words) as caught:
        first_case.write(folder / "hip", folder / "labels.nii.gz", None, None, None)
    assert str(caught.value).endswith(first_case.LANDMARKS)
    text = re.sub("[XYZ]", "1", first_case.LANDMARKS).replace("NUMBER", "1")
    keys = ruamel.yaml.YAML(typ="safe").load(text)["geometry"]
    Landmarks.model_validate(keys["landmarks"])


def test_first_case_limits_the_leg_length(tmp_path: Path) -> None:
    """Patients notice 10 mm. The neck is shorter by whole millimetres, and the output says so."""
    folder = scan(tmp_path, 150.0, edges=(1.5, 1.5, 1.5))
    labels, ct = folder / "labels.nii.gz", folder / "ct.nii.gz"
    path, assumed = first_case.write(folder / "hip", labels, ct, None, None, cementless=True)
    geometry = case_file.load_case(path).config.geometry
    assert isinstance(geometry, Patient)
    assert 6.9 < lengthening(geometry) <= 8.0
    usual = case_file.load_case(path, ["geometry.stem.head_height=25 mm"]).config.geometry
    assert isinstance(usual, Patient)
    assert lengthening(usual) > 8.0
    shorter = 25.0 - geometry.stem.head_height
    assert f"the neck is {shorter:g} mm shorter (stem.head_height)" in assumed[3]


def test_first_case_without_ct_has_the_canal_of_the_table(tmp_path: Path) -> None:
    """The file may have any name."""
    folder = scan(tmp_path, 150.0, edges=(1.5, 1.5, 1.5))
    labels = (folder / "labels.nii.gz").rename(folder / "patient: 7 #1.nii.gz")
    path, assumed = first_case.write(folder / "hip.yaml", labels, None, None, None)
    assert "ratios of the parametric femur" in assumed[2]
    assert case_file.load_case(path).config.title == f"Hip of {labels.name}"
    with pytest.raises(InputError, match="exists already"):
        first_case.write(path, labels, None, None, None)


def test_first_case_without_cement_has_the_widest_stem_with_room(tmp_path: Path) -> None:
    """The next wider stem of the same length has less room than asked."""
    folder = scan(tmp_path, 150.0, edges=(1.5, 1.5, 1.5))
    labels, ct = folder / "labels.nii.gz", folder / "ct.nii.gz"
    path, assumed = first_case.write(folder / "hip", labels, ct, None, None, cementless=True)
    assert ", without cement; best position" in assumed[3]
    assert "materials of `pressed`" in assumed[4]
    case = case_file.load_case(path).config
    geometry = case.geometry
    assert isinstance(geometry, Patient)
    assert not geometry.is_cemented
    assert set(case.interfaces) == {"stem_bone"}
    assert room.fit_of(geometry).least >= first_case.CEMENTLESS_ROOM
    width = geometry.implant.half_width / first_case.CEMENTLESS.widths["half_width"]
    stems = first_case.CEMENTLESS.stems
    tried = stems.index((geometry.implant.length, pytest.approx(width)))
    length, wider = stems[tried - 1]
    assert length == geometry.implant.length
    numbers = {
        f"geometry.stem.{key}={round(wider * size, 2)} mm"
        for key, size in first_case.CEMENTLESS.widths.items()
    }
    other = case_file.load_case(path, sorted(numbers)).config.geometry
    assert isinstance(other, Patient)
    assert room.fit_of(other).least < first_case.CEMENTLESS_ROOM


def test_first_case_refuses_a_ct_of_another_place(tmp_path: Path) -> None:
    """The CT has a grid that differs from that of the labels. The CT must contain the femur."""
    folder = scan(tmp_path, 120.0, edges=(1.5, 1.5, 1.5))
    image = nibabel.load(folder / "ct.nii.gz")
    affine = image.affine.copy()
    affine[2, 3] += 100.0
    nibabel.Nifti1Image(np.asarray(image.dataobj), affine).to_filename(folder / "other.nii.gz")
    with pytest.raises(InputError, match="CT does not contain the labelled femur") as caught:
        first_case.write(
            folder / "hip", folder / "labels.nii.gz", folder / "other.nii.gz", None, None
        )
    assert "no stem" not in str(caught.value)
    # The key `axes` belongs to the image of a modulus, not to `mantle init`.
    assert "outside the image, such as" in str(caught.value) and "`axes`" not in str(caught.value)
    assert not (folder / "hip.yaml").exists()


def test_first_case_refuses_a_ct_that_is_mirrored(tmp_path: Path) -> None:
    """The grid contains the femur, but the cortex is not at that of the labels."""
    folder = scan(tmp_path, 120.0, edges=(1.5, 1.5, 1.5))
    image = nibabel.load(folder / "ct.nii.gz")
    mirrored = np.asarray(image.dataobj)[::-1]
    nibabel.Nifti1Image(mirrored, image.affine).to_filename(folder / "mirrored.nii.gz")
    labels = folder / "labels.nii.gz"
    for name in ("mirrored", "labels"):
        with pytest.raises(InputError, match=rf"{name}\.nii\.gz: only . % .* mirrored or moved"):
            first_case.write(folder / "hip", labels, folder / f"{name}.nii.gz", None, None)
    assert not (folder / "hip.yaml").exists()


def test_first_case_notes_a_ct_that_is_moved(tmp_path: Path) -> None:
    folder = scan(tmp_path, 120.0, edges=(1.5, 1.5, 1.5))
    image = nibabel.load(folder / "ct.nii.gz")
    affine = image.affine.copy()
    affine[0, 3] += 6.0
    nibabel.Nifti1Image(np.asarray(image.dataobj), affine).to_filename(folder / "moved.nii.gz")
    labels = folder / "labels.nii.gz"
    path, assumed = first_case.write(folder / "hip", labels, folder / "moved.nii.gz", None, None)
    assert "moved.nii.gz: only" in assumed[-1] and "mirrored or moved" in assumed[-1]
    notes = [v.what for v in input_notes(case_file.load_case(path).config)]
    assert any("mirrored or moved" in note for note in notes)


def test_first_case_refuses_a_side_that_the_bone_has_not(tmp_path: Path) -> None:
    """The label has no name, so the lesser trochanter decides."""
    folder = scan(tmp_path, 150.0, edges=(1.5, 1.5, 1.5))
    image = nibabel.load(folder / "labels.nii.gz")
    one = (np.asarray(image.dataobj) == NUMBERS["left"]).astype(np.uint8)
    nibabel.Nifti1Image(one, image.affine).to_filename(folder / "one.nii.gz")
    with pytest.raises(InputError, match="lesser trochanter"):
        first_case.write(folder / "hip", folder / "one.nii.gz", None, "right", "1")
    first_case.write(folder / "hip", folder / "one.nii.gz", None, "left", "1")


def test_first_case_refuses_a_label_of_two_femora(tmp_path: Path) -> None:
    """The program does not choose one bone silently. Small pieces are left out with a note."""
    folder = scan(tmp_path, 120.0, edges=(1.5, 1.5, 1.5))
    image = nibabel.load(folder / "labels.nii.gz")
    one = np.asarray(image.dataobj) == NUMBERS["left"]
    apart = np.zeros((10, *one.shape[1:]), dtype=bool)
    piece = np.zeros_like(one)
    k = int(0.8 * one.shape[2])  # part of the head
    piece[:, :, k:] = one[:, :, k:]
    for other, voxels in (("two", one), ("piece", piece)):
        both = np.concatenate([one, apart, voxels[::-1]]).astype(np.uint8)
        nibabel.Nifti1Image(both, image.affine).to_filename(folder / f"{other}.nii.gz")
    with pytest.raises(InputError, match=r"two\.nii\.gz: label 1 has two bodies, of .* cm3"):
        first_case.write(folder / "hip", folder / "two.nii.gz", None, None, None)
    (folder / "two.yaml").write_text(
        "base: stance\ngeometry: {kind: patient, bone: {image: two.nii.gz, label: 1}}"
    )
    with pytest.raises(InputError, match=r"two.yaml:2:27: geometry.bone: .*two.nii.gz: label 1"):
        case_file.load_case(folder / "two.yaml")
    _, assumed = first_case.write(folder / "hip", folder / "piece.nii.gz", None, None, None)
    assert f"{piece.sum():,} voxels in 1 other pieces left out" in assumed[-1]


def test_first_case_names_the_label_that_it_refuses(tmp_path: Path) -> None:
    """A scan ends too high, or the label is another structure."""
    folder = scan(tmp_path, 40.0, edges=(1.5, 1.5, 1.5))
    labels = folder / "labels.nii.gz"
    left = NUMBERS["left"]
    named = rf"femur_left \(label {left} of labels\.nii\.gz\): has \d mm of complete shaft"
    with pytest.raises(InputError, match=named):
        first_case.write(folder / "hip", labels, None, None, str(left))
    with pytest.raises(InputError, match=rf"labels\.nii\.gz: label {HIP} is .* mm long"):
        first_case.write(folder / "hip", labels, None, None, str(HIP))


def test_first_case_refuses_a_femur_in_which_no_stem_fits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = scan(tmp_path, 120.0, edges=(1.5, 1.5, 1.5))
    widths = {key: 2.4 * size for key, size in first_case.CEMENTED.widths.items()}
    wide = replace(
        first_case.CEMENTED,
        stems=((100.0, 0.99),),
        widths=widths | {"trunnion_diameter": 12.0},
    )
    monkeypatch.setattr(first_case, "CEMENTED", wide)
    monkeypatch.setattr(first_case, "CUT_ANGLES", (38.0,))
    with pytest.raises(InputError, match="no stem of 100 to 100 mm fits into this femur"):
        first_case.write(folder / "hip", folder / "labels.nii.gz", None, None, None)
