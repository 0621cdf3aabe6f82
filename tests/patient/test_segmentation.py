"""The femur among the structures of a segmentation, by name and by number."""

from __future__ import annotations

from pathlib import Path

import nibabel
import numpy as np
import pytest

from app.foundation.errors import InputError
from app.patient import segmentation
from tests.patient import nrrd_files

TABLE = """<?xml version="1.0" encoding="UTF-8"?> <CaretExtension> <VolumeInformation Index="0">
<LabelTable> <Label Key="1" Alpha="1"><![CDATA[femur_left]]></Label>
<Label Key="2" Alpha="1"><![CDATA[hip_left]]></Label></LabelTable>
</VolumeInformation> </CaretExtension>"""


def nifti(path: Path, *numbers: int, table: str = "") -> Path:
    """An image whose first voxels have these numbers."""
    values = np.zeros((4, 5, 30), dtype=np.uint8)
    values.flat[: len(numbers)] = numbers
    image = nibabel.Nifti1Image(values, np.diag([1.0, 2.0, 3.0, 1.0]))
    if table:
        image.header.extensions.append(nibabel.nifti1.Nifti1Extension(0, table.encode()))
    image.to_filename(path)
    return path


def test_segmentation_femur_by_number_of_totalsegmentator(tmp_path: Path) -> None:
    """Numbers are those of version 2, and of version 1, which its hip bones reveal."""
    second = segmentation.femur_structure(nifti(tmp_path / "s.nii.gz", 75, 77, 51), None, None)
    assert (second.number, second.name, second.side) == (75, "femur_left", "left")
    first = segmentation.femur_structure(nifti(tmp_path / "s1.nii.gz", 89, 91, 51), None, None)
    assert (first.number, first.side) == (89, "right")
    assert "version 1" in first.source


@pytest.mark.parametrize(("largest", "femur"), [(104, 88), (117, 75)])
def test_segmentation_of_a_torso_by_totalsegmentator(
    tmp_path: Path, largest: int, femur: int
) -> None:
    """All structures of version 1 are 104, of version 2 117: 75 is a rib of the former."""
    path = nifti(tmp_path / "torso.nii.gz", *range(1, largest + 1))
    assert segmentation.femur_structure(path, "left", None).number == femur


def test_segmentation_given_number_has_no_side_by_chance(tmp_path: Path) -> None:
    """A left femur has the label 76. Next to label 75 it would be a right one."""
    path = nifti(tmp_path / "s.nii.gz", 5, 76)
    femur = segmentation.femur_structure(path, "left", "76")
    assert (femur.number, femur.name, femur.side) == (76, "", None)
    assert segmentation.femur_structure(path, None, None).side == "right"
    assert segmentation.femur_structure(nifti(path, 75, 76), None, "76").side == "right"


def test_segmentation_femur_by_name(tmp_path: Path) -> None:
    """Names are those of the table in NIfTI, of the file, of a folder, of segments of 3D Slicer."""
    table = segmentation.femur_structure(
        nifti(tmp_path / "t.nii.gz", 1, 2, table=TABLE), None, None
    )
    assert (table.number, table.name) == (1, "femur_left")
    one = nifti(tmp_path / "femur_right.nii.gz", 1)
    assert segmentation.femur_structure(one, None, None).side == "right"
    assert segmentation.femur_structure(tmp_path, "right", None).path == one
    values = np.zeros((3, 4, 5))
    values[0, 0, 0], values[1, 2, 3] = 3, 7
    names = [("Femur L", None, 7), ("medullary canal", None, 3)]
    path = nrrd_files.segmentation(tmp_path / "s.seg.nrrd", [values], names)
    bone = segmentation.femur_structure(path, None, None)
    assert (bone.number, bone.side) == (7, "left")
    canal = segmentation.canal_structure(path, bone)
    assert canal is not None
    assert canal.number == 3


@pytest.mark.parametrize(
    ("numbers", "side", "label", "message"),
    [
        ((51, 77), None, None, "no label is named femur; its labels are .*Give --label"),
        ((75, 76), None, None, "has 2 femora: .*choose one with --side left or --side right"),
        (
            (1, 2),
            None,
            "3",
            r"--label 3: \S+s\.nii\.gz has no such label; it has label 1, label 2$",
        ),
        ((75, 51), "right", None, "--side right: the femur is femur_left"),
        ((75, 76), "right", "75", "--side right: the femur is femur_left"),
    ],
)
def test_segmentation_refuses_no_femur_and_two(
    tmp_path: Path, numbers: tuple[int, ...], side: str | None, label: str | None, message: str
) -> None:
    path = nifti(tmp_path / "s.nii.gz", *numbers)
    with pytest.raises(InputError, match=message):
        segmentation.femur_structure(path, side, label)
    assert segmentation.femur_structure(nifti(path, 75, 76), "right", None).number == 76


def test_segmentation_refuses_folders_without_a_femur(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="contains no segmentation; expected files"):
        segmentation.femur_structure(tmp_path, None, None)
    nifti(tmp_path / "liver.nii.gz", 1)
    with pytest.raises(InputError, match="has no file of a femur"):
        segmentation.femur_structure(tmp_path, None, None)


def test_segmentation_structures_without_names_are_described_by_their_label() -> None:
    path = Path("scan/labels.nii.gz")
    unnamed = segmentation.Structure(path, 1, "", "")
    named = segmentation.Structure(path, 75, "femur_left", "by its file")
    assert str(unnamed) == "label 1 of labels.nii.gz"
    assert str(named) == "femur_left (label 75 of labels.nii.gz)"


@pytest.mark.parametrize(
    ("name", "side"),
    [
        ("LeftFemur", "left"),
        ("Femur R", "right"),
        ("femur_left", "left"),
        ("FEMUR-RIGHT", "right"),
        ("FemurL", "left"),
        ("femur", None),
        ("RightAndLeft", None),
        ("Larger femur", None),
    ],
)
def test_segmentation_side_follows_from_the_name(name: str, side: str | None) -> None:
    assert segmentation.Structure(Path("image.nii"), 1, name, "test").side == side


def test_segmentation_two_segments_of_one_name_are_both_there(tmp_path: Path) -> None:
    bone = np.arange(27).reshape(3, 3, 3) < 9
    ball = ~bone
    path = nrrd_files.segmentation(
        tmp_path / "s.seg.nrrd", [bone, ball], [("femur", 0, 1), ("femur", 1, 1)]
    )
    with pytest.raises(InputError, match=r"femora: femur \(label 1\), femur \(1\) \(label 2\)"):
        segmentation.femur_structure(path, None, None)
