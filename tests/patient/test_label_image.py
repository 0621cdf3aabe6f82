"""Labels of segmentations: layers of overlapping segments, and images without labels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import zoom

from app.foundation.errors import InputError
from app.patient import label_image, segmentation
from tests.patient import nrrd_files

GRID = np.indices((24, 24, 24)) - 12.0
SQUARE = (GRID**2).sum(axis=0)
BONE = SQUARE < 100.0
CANAL = SQUARE < 30.0
BALL = np.abs(GRID - np.array([0, 0, 9])[:, None, None, None]).max(axis=0) < 2.5


def labelled(folder: Path, values: Any) -> Path:
    path = folder / "labels.npz"
    np.savez(path, values=values, affine=np.eye(4))
    return path


LAYERS: dict[str, tuple[list[Any], list[tuple[str, int | None, int | None]], bool, int, int]] = {
    "equal labels": ([BONE, CANAL], [("Femur L", 0, 1), ("canal", 1, 1)], True, 1, 2),
    "list last": ([BONE, CANAL], [("Femur L", 0, 1), ("canal", 1, 1)], False, 1, 2),
    "other order": ([CANAL, BONE], [("canal", 0, 1), ("Femur L", 1, 1)], True, 2, 1),
    "other labels": ([BONE * 4, CANAL * 7], [("Femur L", 0, 4), ("canal", 1, 7)], True, 4, 7),
    "labels in one layer": (
        [BONE * 1 + BALL * ~BONE * 2, CANAL],
        [("Femur L", 0, 1), ("pelvis", 0, 2), ("canal", 1, 1)],
        True,
        1,
        3,
    ),
    "old files": (
        [BONE, CANAL, BALL],
        [("Femur L", None, None), ("canal", None, None), ("pelvis", None, None)],
        True,
        1,
        2,
    ),
}


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
def test_label_image_side_follows_from_the_name(name: str, side: str | None) -> None:
    assert segmentation.Structure(Path("image.nii"), 1, name, "test").side == side


@pytest.mark.parametrize("name", LAYERS)
def test_label_image_segments_that_overlap_are_whole(name: str, tmp_path: Path) -> None:
    """3D Slicer writes overlapping segments in layers.

    Labels repeat, or each segment has a layer.
    """
    layers, segments, list_first, number, canal_number = LAYERS[name]
    path = nrrd_files.segmentation(tmp_path / "s.seg.nrrd", layers, segments, list_first)
    femur = segmentation.femur(path, None, None)
    canal = segmentation.canal(path, femur)
    assert (femur.number, femur.side) == (number, "left")
    assert canal is not None
    assert canal.number == canal_number
    labels = label_image.read(path)
    assert (labels.inside(femur.number) == BONE).all()
    assert (labels.inside(canal.number) == CANAL).all()
    repeat = any("labels repeat in its layers" in note for note in labels.notes)
    assert repeat == (name != "other labels")
    with pytest.raises(InputError, match="has no label 9; it has "):
        labels.inside(9)


def test_label_image_two_segments_of_one_name_are_both_there(tmp_path: Path) -> None:
    path = nrrd_files.segmentation(
        tmp_path / "s.seg.nrrd", [BONE, BALL], [("femur", 0, 1), ("femur", 1, 1)]
    )
    with pytest.raises(InputError, match=r"femora: femur \(label 1\), femur \(1\) \(label 2\)"):
        segmentation.femur(path, None, None)


def test_label_image_background_may_be_negative(tmp_path: Path) -> None:
    labels = label_image.read(labelled(tmp_path, np.where(BONE, 1, -1)))
    assert labels.numbers == [1]


@pytest.mark.parametrize(
    ("values", "label"),
    [
        (np.clip(50.0 + 10.0 * (10.0 - np.sqrt(SQUARE)), 0.0, 100.0).astype(np.uint8), 100),
        (np.round(zoom(75.0 * BONE, 1.13, order=1)).astype(np.uint8), 75),
    ],
    ids=["probabilities", "interpolated and rounded"],
)
def test_label_image_numbers_of_interpolation_are_no_label(
    values: Any, label: int, tmp_path: Path
) -> None:
    labels = label_image.read(labelled(tmp_path, values))
    with pytest.raises(InputError, match=f"label {label} is surrounded by numbers .* neighbour"):
        labels.inside(label)


def test_label_image_smaller_labels_around_a_label_are_accepted(tmp_path: Path) -> None:
    """Eight muscles surround a bone, like sectors."""
    sector = 1 + (4.0 + 4.0 * np.arctan2(GRID[1], GRID[0]) / np.pi).astype(int) % 8
    labels = label_image.read(labelled(tmp_path, np.where(BONE, 20, sector)))
    assert (labels.inside(20) == BONE).all()


def test_label_image_refuses_a_ct(tmp_path: Path) -> None:
    """A few voxels of the CT have the number 1."""
    numbers = np.random.default_rng(0).integers(-1000, 1500, BONE.shape, dtype=np.int16)
    path = labelled(tmp_path, numbers)
    for read in (label_image.read, segmentation.segments):
        with pytest.raises(InputError, match=r"different numbers, from -.* Is it a CT"):
            read(path)
