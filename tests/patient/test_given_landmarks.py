"""Landmarks that a case gives: wrong ones are refused with the likely reason."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import pytest
from pydantic import ValidationError

from app.foundation.errors import GeometryError
from app.patient import landmarks
from app.soundness import preview
from tests import support
from tests.patient.bones import moved, parametric_femur, write
from tests.patient.patients import patient
from tests.patient.scans import NUMBERS, scan

# Apex of the lesser trochanter and centre of the head, detected on the parametric femur [mm].
APEX = (24.4, -7.6, 2.8)
HEAD = (41.7, 11.2, 54.1)
HINT = "would be right: image software .* to left and posterior"


def others(*point: float) -> tuple[float, ...]:
    """The point in axes to left and posterior."""
    return (-point[0], -point[1], *point[2:])


@pytest.mark.parametrize("shift", [0.0, 300.0])
@pytest.mark.parametrize(
    ("name", "point"), [("lesser_trochanter", APEX), ("head_centre", HEAD)], ids=str
)
def test_given_landmarks_in_other_axes_are_refused_with_hint(
    name: str, point: tuple[float, float, float], shift: float
) -> None:
    """The origin is near, so an apex with other signs is near the surface on the lateral side."""
    bone = moved(parametric_femur(), np.eye(3), np.full(3, shift))
    x = tuple(np.add(point, shift))
    assert landmarks.find_landmarks(bone, {name: x}).side == "left"
    words = rf"geometry\.landmarks\.{name}: \(-.*{HINT}"
    with pytest.raises(GeometryError, match=words):
        landmarks.find_landmarks(bone, {name: others(*x)})


def test_given_landmarks_shaft_in_other_axes_is_refused_with_hint() -> None:
    bone = moved(parametric_femur(), np.eye(3), np.array([300.0, 300.0, 0.0]))
    line = (300.0, 300.0, -100.0), (300.0, 300.0, -20.0)
    landmarks.find_landmarks(bone, {"shaft": line})
    with pytest.raises(
        GeometryError, match=rf"landmarks\.shaft: \(-300, .*passes the bone.*{HINT}"
    ):
        landmarks.find_landmarks(bone, {"shaft": tuple(others(*x) for x in line)})


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"lesser_trochanter": (-500, 700, 2)}, "lesser_trochanter: .* 83. mm from .* most 10 mm"),
        ({"head_centre": (25, 11, 54)}, "head_centre: .* is 6 mm below .* at least 7 mm"),
        ({"shaft": ((0, 0, 0), (50, 0, -20))}, "shaft: the given axis deviates by 107 deg"),
        (
            {"shaft": ((0, 0, -20), (0, 0, -90))},
            "shaft: .* by 175 deg.* Give the distal point first",
        ),
        ({"shaft": ((0, 0, -20), (0, 0, -20))}, "shaft: its points are equal"),
        ({"shaft": ((60, 0, -60), (60, 0, -20))}, "shaft: .* at a distance of .* two points"),
        ({"condyles": ((20, -20, 0), (-20, -80, -30))}, "condyles: .* 6. mm from .* most 10 mm"),
    ],
    ids=str,
)
def test_given_landmarks_beside_the_bone_are_refused(given: dict[str, Any], words: str) -> None:
    """There is no hint, because other signs of x and y do not move them onto the bone."""
    with pytest.raises(GeometryError, match=rf"^geometry\.landmarks\.{words}") as caught:
        landmarks.find_landmarks(parametric_femur(), given)
    assert "posterior" not in str(caught.value)


def test_given_landmarks_below_the_scan_are_accepted() -> None:
    """Condyles are in another part of the scan."""
    below = parametric_femur().points[:, 2].min() - 100.0
    frame = landmarks.find_landmarks(
        parametric_femur(), {"condyles": ((25, 0, below), (-25, 0, below))}
    )
    assert frame.given == ("condyles",)


def test_given_landmarks_that_are_unusual_have_notes() -> None:
    """The centre of the head is off the sphere, or the apex is off the neck. Notes name both."""
    bone = parametric_femur()
    frame = landmarks.find_landmarks(bone, {"head_centre": (34.0, 9.0, 52.0)})
    (doubt,) = frame.given_doubts
    assert doubt[0] == "head_centre" and "8 mm from the centre of the sphere" in doubt[1]
    assert ", given, radius" in frame.details["head"]
    (angle,) = frame.doubts(bone)
    assert "Is a given landmark wrong (landmarks.head_centre)" in angle
    frame = landmarks.find_landmarks(bone, {"lesser_trochanter": (25.0, -7.0, 28.0)})
    (doubt,) = frame.given_doubts
    assert doubt[0] == "lesser_trochanter" and "27 mm below the head's centre" in doubt[1]
    assert frame.details["lesser trochanter"].endswith("mm, given")
    found = landmarks.find_landmarks(bone)
    assert not found.given_doubts and "given" not in " ".join(found.details.values())


def test_given_landmarks_are_named_where_the_stem_has_no_room(tmp_path: Path) -> None:
    write(tmp_path / "bone.stl", parametric_femur())
    words = "axis is outside the bone .* Given landmarks may be wrong: landmarks.lesser_trochanter"
    with pytest.raises(ValidationError, match=words) as caught:
        patient(tmp_path, landmarks={"lesser_trochanter": [25, -7, 28]}, insertion="best")
    assert "geometry.geometry" not in str(caught.value)
    with pytest.raises(ValidationError, match=r"'25 mm' is not a number; .* number in mm, without"):
        patient(tmp_path, landmarks={"lesser_trochanter": ["25 mm", "-7 mm", "2 mm"]})


@pytest.mark.parametrize("mirrored", [False, True])
def test_given_landmarks_side_against_the_image_is_noted(tmp_path: Path, mirrored: bool) -> None:
    """Front and back are exchanged. `mantle check` and `run` give the note, not only `init`."""
    folder = scan(tmp_path, 120.0, edges=(1.5, 1.5, 1.5))
    image = nibabel.load(folder / "labels.nii.gz")
    values = np.asarray(image.dataobj)
    nibabel.Nifti1Image(values[:, ::-1] if mirrored else values, image.affine).to_filename(
        folder / "labels.nii.gz"
    )
    bone = {"image": "labels.nii.gz", "label": NUMBERS["left"]}
    geometry = patient(folder, bone=bone, canal={"ream": "broach"})
    case = support.case("base: stance").model_copy(update={"geometry": geometry})
    notes = [v.what for v in preview.input_notes(case) if "by the axes of the image" in v.what]
    assert bool(notes) == mirrored
