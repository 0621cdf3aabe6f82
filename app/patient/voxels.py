"""Contents of an image file, as its reader returns them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from app.foundation.arrays import Floats


@dataclass(frozen=True)
class LabelSegment:
    """Voxels of a structure in a segmentation.

    Attributes:
        value: Number of its voxels.
        layer: Layer that has them. Segments that overlap are in different layers.
    """

    value: int
    layer: int = 0


@dataclass(frozen=True)
class Voxels:
    """Numbers of an image, and their places.

    Attributes:
        values: Numbers (i, j, k), or several in each voxel (i, j, k, n).
        affine: Matrix from (i, j, k, 1) to the middle of a voxel (4, 4) [mm].
        kind: Format and origin of the axes, in words.
        left_out: Parts of the file that are left out, in words.
        doubts: Doubts about it.
        segments: Segments by their names, if the file has names. None is the background.
    """

    values: Any
    affine: Floats
    kind: str
    left_out: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    segments: Mapping[str, LabelSegment] | None = None
