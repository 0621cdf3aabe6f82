"""Segmentations as DICOM objects: segments by number and name, and omitted planes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pydicom
import pytest

from app.foundation.errors import InputError
from app.patient import images, label_image, label_surface, segmentation
from tests.patient.bones import part, slices

AFFINE = np.array([[-0.7, 0, 0, 9], [0, -0.8, 0, 8], [0, 0, 1.25, 7], [0, 0, 0, 1.0]])
GRID = np.indices((20, 22, 24)) - np.array([10.0, 11.0, 12.0])[:, None, None, None]
SQUARE = (GRID**2).sum(axis=0)
BONE = SQUARE < 81.0
CANAL = SQUARE < 25.0
LOW = BONE & (GRID[2] < 0)
HIGH = BONE & (GRID[2] >= 0)
GAP = BONE & (np.abs(GRID[2]) > 1)


def save(path: Path, masks: Sequence[Any], names: Sequence[str]) -> Path:
    """Write masks (i, j, k) as the segments of one file, without their empty planes."""
    source = slices(path.parent / "ct", np.zeros(BONE.shape), AFFINE)
    files = [pydicom.dcmread(file) for file in source.iterdir()]
    files.sort(key=lambda file: float(file.ImagePositionPatient[2]))
    whole = files[0].copy()
    whole.SOPClassUID = whole.file_meta.MediaStorageSOPClassUID = "1.2.840.10008.5.1.4.1.1.66.4"
    whole.Modality, whole.SegmentationType = "SEG", "BINARY"
    whole.SegmentSequence, groups, bits = [], [], []
    for number, (mask, name) in enumerate(zip(masks, names, strict=True), 1):
        segment = pydicom.Dataset()
        segment.SegmentNumber, segment.SegmentLabel = number, name
        whole.SegmentSequence.append(segment)
        for k in np.flatnonzero(mask.any(axis=(0, 1))):
            group = pydicom.Dataset()
            group.PlanePositionSequence = [part(files[k], "ImagePositionPatient")]
            group.SegmentIdentificationSequence = [pydicom.Dataset()]
            group.SegmentIdentificationSequence[0].ReferencedSegmentNumber = number
            groups.append(group)
            bits.append(mask[:, :, k].T.ravel())
    shared = pydicom.Dataset()
    shared.PixelMeasuresSequence = [part(whole, "PixelSpacing")]
    shared.PlaneOrientationSequence = [part(whole, "ImageOrientationPatient")]
    whole.SharedFunctionalGroupsSequence = [shared]
    whole.PerFrameFunctionalGroupsSequence, whole.NumberOfFrames = groups, len(groups)
    for tag in ("ImagePositionPatient", "ImageOrientationPatient", "PixelSpacing"):
        delattr(whole, tag)
    del whole.RescaleSlope, whole.RescaleIntercept, whole.PixelPaddingValue
    whole.BitsAllocated, whole.BitsStored, whole.HighBit, whole.PixelRepresentation = 1, 1, 0, 0
    packed = np.packbits(np.concatenate(bits), bitorder="little").tobytes()
    whole.PixelData = packed + b"\0" * (len(packed) % 2)
    whole.save_as(path)
    return path


@pytest.mark.parametrize(
    ("masks", "layers"),
    [
        ([BONE], 1),
        ([LOW, HIGH], 1),
        ([BONE & ~CANAL, CANAL], 1),
        ([BONE, CANAL], 2),
        ([GAP], 1),
        ([CANAL, BONE, LOW], 3),
    ],
    ids=["one", "one above the other", "beside", "overlapping", "empty planes between", "three"],
)
def test_dicom_segmentation_has_the_voxels_of_each_segment(
    masks: list[Any], layers: int, tmp_path: Path
) -> None:
    path = save(tmp_path / "seg.dcm", masks, [f"s{k}" for k in range(len(masks))])
    image = images.read_layers(path)
    labels = label_image.read(path)
    assert labels.layers.shape[3] == layers
    # The first plane that has a voxel is the first one of the image.
    low = int(np.flatnonzero(np.any(masks, axis=(0, 1, 2)))[0])
    expected = AFFINE.copy()
    expected[:3, 3] = (AFFINE @ [0, 0, low, 1])[:3]
    assert image.affine == pytest.approx(expected, abs=1e-3)
    for number, mask in enumerate(masks, 1):
        inside = labels.inside(number)
        assert (inside == mask[:, :, low : low + inside.shape[2]]).all()
        assert inside.sum() == mask.sum()


def test_dicom_segmentation_femur_by_name(tmp_path: Path) -> None:
    path = save(tmp_path / "seg.dcm", [CANAL, BONE], ["Medullary canal", "Femur right"])
    femur = segmentation.femur_structure(path, None, None)
    canal = segmentation.canal_structure(path, femur)
    assert (femur.number, femur.side, canal and canal.number) == (2, "right", 1)
    body = label_surface.body(path, 2)
    assert body.notes[0].startswith("26 DICOM frames of 2 segments (SEG): 20 x 22 x ")
    assert "in 2 layers" in body.notes[0]


def test_dicom_segmentation_is_no_part_of_its_ct(tmp_path: Path) -> None:
    path = save(tmp_path / "seg.dcm", [BONE], ["Femur"])
    path.rename(tmp_path / "ct" / "seg.dcm")
    image = images.read(tmp_path / "ct")
    assert image.values.shape == BONE.shape
    assert "1 segmentations left out: seg.dcm" in image.summary


def fractions(data: Any) -> None:
    data.SegmentationType = "FRACTIONAL"


def uneven(data: Any) -> None:
    places = data.PerFrameFunctionalGroupsSequence[5].PlanePositionSequence[0]
    x, y, z = places.ImagePositionPatient
    places.ImagePositionPatient = [x, y, float(z) + 0.5]


def unknown(data: Any) -> None:
    data.SegmentSequence[0].SegmentNumber = 4


REFUSED: dict[str, tuple[Callable[[Any], None], str]] = {
    "fractions": (fractions, "its masks are fractional .* export binary masks"),
    "uneven planes": (
        uneven,
        r"planes are 0\.5 to 1\.75 mm apart|is not at a multiple of one step",
    ),
    "unknown segment": (unknown, "17 frames belong to no segment"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_dicom_segmentation_is_refused_with_the_reason(name: str, tmp_path: Path) -> None:
    alter, message = REFUSED[name]
    path = save(tmp_path / "seg.dcm", [BONE], ["Femur"])
    data = pydicom.dcmread(path)
    alter(data)
    data.save_as(path)
    with pytest.raises(InputError, match=message):
        images.read(path)
