"""Labels of segmentations: layers of overlapping segments, and images without labels."""

from __future__ import annotations

from dataclasses import dataclass
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


@dataclass(frozen=True)
class Layers:
    """A file of 3D Slicer, and its labels as they are read.

    Attributes:
        values: Labels of each layer.
        segments: Name, layer and label of each segment; None in old files.
        femur: Label of the femur.
        canal: Label of the canal.
        list_first: The axis of the layers is the first one.
    """

    values: list[Any]
    segments: list[tuple[str, int | None, int | None]]
    femur: int
    canal: int
    list_first: bool = True


LAYERS = {
    "equal labels": Layers([BONE, CANAL], [("Femur L", 0, 1), ("canal", 1, 1)], 1, 2),
    "list last": Layers([BONE, CANAL], [("Femur L", 0, 1), ("canal", 1, 1)], 1, 2, False),
    "other order": Layers([CANAL, BONE], [("canal", 0, 1), ("Femur L", 1, 1)], 2, 1),
    "other labels": Layers([BONE * 4, CANAL * 7], [("Femur L", 0, 4), ("canal", 1, 7)], 4, 7),
    "labels in one layer": Layers(
        [BONE * 1 + BALL * ~BONE * 2, CANAL],
        [("Femur L", 0, 1), ("pelvis", 0, 2), ("canal", 1, 1)],
        1,
        3,
    ),
    "old files": Layers(
        [BONE, CANAL, BALL],
        [("Femur L", None, None), ("canal", None, None), ("pelvis", None, None)],
        1,
        2,
    ),
}


@pytest.mark.parametrize("name", LAYERS)
def test_label_image_segments_that_overlap_are_whole(name: str, tmp_path: Path) -> None:
    """3D Slicer writes overlapping segments in layers.

    Labels repeat, or each segment has a layer.
    """
    file = LAYERS[name]
    path = nrrd_files.segmentation(
        tmp_path / "s.seg.nrrd", file.values, file.segments, file.list_first
    )
    femur = segmentation.femur_structure(path, None, None)
    canal = segmentation.canal_structure(path, femur)
    assert (femur.number, femur.side) == (file.femur, "left")
    assert canal is not None
    assert canal.number == file.canal
    labels = label_image.read(path)
    assert (labels.inside(femur.number) == BONE).all()
    assert (labels.inside(canal.number) == CANAL).all()
    repeat = any("labels repeat in its layers" in note for note in labels.notes)
    assert repeat == (name != "other labels")
    with pytest.raises(InputError, match="has no label 9; it has "):
        labels.inside(9)


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
