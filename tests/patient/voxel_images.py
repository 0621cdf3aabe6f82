"""Images of a ball as files: NIfTI and DICOM, with changes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pydicom

SHAPE = (12, 10, 8)
PLACES = np.array([[-0.7, 0, 0, 9], [0, -0.8, 0, 8], [0, 0, 1.25, 7], [0, 0, 0, 1.0]])


# Labels

BALL = (np.indices((24, 24, 24)) - 12.0) ** 2
LABELS = (BALL.sum(axis=0) < 81.0) + 1 * (BALL.sum(axis=0) < 30.0)


def labelled(folder: Path, values: Any) -> Path:
    path = folder / "labels.npz"
    np.savez(path, values=values, affine=np.eye(4))
    return path


# Folders of DICOM slices

NUMBERS = np.random.default_rng(1).integers(-900, 1400, SHAPE).astype(float)


def change(path: Path, to: Path | None = None, **tags: Any) -> Path:
    """Write a slice with other tags, or without those that are None."""
    data = pydicom.dcmread(path)
    for tag, value in tags.items():
        if value is None:
            delattr(data, tag)
        else:
            setattr(data, tag, value)
    data.save_as(to or path)
    return to or path


def moved(folder: Path) -> None:
    change(folder / "1.2.3", FrameOfReferenceUID="1.99")


def frames(folder: Path) -> None:
    change(folder / "1.2.3", NumberOfFrames=8)
