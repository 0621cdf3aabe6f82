"""The canal by CT numbers: its threshold, and images that are not the CT of the labels."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import nibabel
import numpy as np
import pytest

from app.foundation.arrays import Floats
from app.foundation.errors import InputError, MantleError
from app.patient import bone_surface, ct_canal, label_surface, landmarks
from app.patient.bone_surface import BoneSurface
from tests.patient.scans import CORTEX, MARROW, NUMBERS, scan

Reader = Callable[[Path, float], BoneSurface]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scan that ends 76 mm below the lesser trochanter."""
    return scan(tmp_path_factory.mktemp("scan"), 130.0)


@pytest.fixture(scope="module")
def read(folder: Path) -> Reader:
    """Return the function that reads the canal of a CT by a threshold."""
    labels, number = folder / "labels.nii.gz", NUMBERS["left"]
    surface = bone_surface.read(labels, None, number)
    frame = landmarks.find_landmarks(surface)
    bone, body = frame.surface(surface), label_surface.body(labels, number)
    return lambda ct, threshold: ct_canal.read(ct, body, threshold, frame, bone)


def changed(folder: Path, change: Callable[[Floats], Floats]) -> Path:
    """Write the CT with changed numbers."""
    image = nibabel.load(folder / "ct.nii.gz")
    path = folder / "changed.nii.gz"
    values = change(np.asarray(image.dataobj, dtype=float)).astype(np.int16)
    nibabel.Nifti1Image(values, image.affine).to_filename(path)
    return path


@pytest.mark.parametrize("threshold", [500.0, 600.0, 700.0])
def test_ct_canal_of_a_usual_threshold_has_no_doubts(
    threshold: float, folder: Path, read: Reader
) -> None:
    assert read(folder / "ct.nii.gz", threshold).doubts == ()


def test_ct_canal_too_thick_a_cortex_names_the_threshold(folder: Path, read: Reader) -> None:
    """The canal is measured in a part of the shaft only. Numpy prints no warnings."""

    def without_canal(numbers: Floats) -> Floats:
        """CT numbers with cancellous bone in the upper part of the canal."""
        numbers = numbers.copy()
        upper = numbers[:, :, 30:]
        upper[upper < 350.0] = 350.0
        return numbers

    ct = changed(folder, without_canal)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        canal = read(ct, 200.0)
    (doubt,) = canal.doubts
    assert "geometry.canal.threshold: 200 the cortex of the shaft is" in doubt
    top = canal.points[:, 2].max()
    assert f"up to z = {top:.0f} mm" in canal.notes[0]


def test_ct_canal_too_high_a_threshold_is_named(folder: Path, read: Reader) -> None:
    """The message does not blame the CT if its cortex is above the usual threshold."""
    ct = folder / "ct.nii.gz"
    (doubt, *_) = read(ct, CORTEX).doubts
    assert "Is geometry.canal.threshold too high?" in doubt and "mirrored" not in doubt
    with pytest.raises(MantleError, match=r"^geometry\.canal\.threshold: is too high for ct"):
        read(ct, CORTEX + 200.0)


def test_ct_canal_too_low_a_threshold_is_quoted_as_given(folder: Path, read: Reader) -> None:
    """The message does not blame the CT. The canal at a threshold lower by 100 is tried, too."""
    ct = folder / "ct.nii.gz"
    words = r"no CT number inside the bone is below -500; they are .* threshold is too low; use"
    with pytest.raises(MantleError, match=words) as caught:
        read(ct, -500.0)
    assert "-600" not in str(caught.value) and "image a CT" not in str(caught.value)
    with pytest.raises(MantleError, match=r"below 0, the threshold of 100 less 100; they are"):
        read(changed(folder, lambda numbers: np.maximum(numbers, 50.0)), 100.0)


def test_ct_canal_share_of_the_cortex_is_rounded_down(tmp_path: Path) -> None:
    """Of 1000 numbers, 748 are too few, because 75 % are expected."""
    numbers = np.repeat([700.0, 100.0], [748, 252])
    (doubt,) = ct_canal._cortex_doubts(tmp_path / "ct.nii.gz", numbers, 600.0)
    assert "only 74 % of the shaft" in doubt and "expected at least 75 %" in doubt


def test_ct_canal_added_number_is_named(folder: Path, read: Reader) -> None:
    ct = changed(folder, lambda numbers: numbers + 1024.0)
    words = r"threshold: changed\.nii\.gz: no CT number .* they are 9\d\d to .* Was 1024 added"
    with pytest.raises(MantleError, match=words):
        read(ct, 600.0)
    assert MARROW + 1024.0 < 1000.0
    assert read(ct, 1624.0).doubts == ()


def test_ct_canal_of_bone_alone_is_no_ct(folder: Path, read: Reader) -> None:
    ct = changed(folder, lambda numbers: np.maximum(numbers, 700.0))
    with pytest.raises(MantleError, match=r"changed\.nii\.gz: no CT number .* the image a CT"):
        read(ct, 600.0)


def test_ct_canal_of_a_file_that_is_no_image_has_its_own_reason(folder: Path, read: Reader) -> None:
    """The message has the path once, and does not mention the femur."""
    with pytest.raises(InputError, match="has no slices") as caught:
        read(folder, 600.0)
    assert str(caught.value).count(str(folder)) == 1
    assert "labelled femur" not in str(caught.value)
