"""Labels of the voxels of a segmentation: whole numbers, in layers where segments overlap."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import ndimage

from app.foundation.arrays import Bools, Floats, Numbers
from app.foundation.errors import InputError
from app.patient import images
from app.patient.voxels import LabelSegment

# An image with more numbers is no segmentation; they are counted in about so many voxels.
MOST_LABELS = 500
COUNTED_VOXELS = 1_000_000
WHOLE_TOLERANCE = 0.05  # largest difference of a label from a whole number
# A label that was interpolated and then rounded is surrounded by at least as many smaller numbers,
LEAST_NUMBERS = 5
# on at least this part of its surface,
LEAST_SHARE = 0.5
# and a voxel of them has fewer neighbours with its number than this, on average.
LEAST_NEIGHBOURS = 1.5


@dataclass(frozen=True)
class LabelImage:
    """Labels of voxels.

    Attributes:
        path: The file or folder.
        layers: Labels (i, j, k, n), whole numbers.
        segments: Layers and values of the labels by their numbers; None: numbers are values.
        names: Numbers of the labels by their names; None: the file has no names.
        affine: Matrix from (i, j, k, 1) to the middle of a voxel (4, 4) [mm].
        notes: What was read and left out, in words.
        doubts: Doubts about it.
    """

    path: Path
    layers: Numbers
    segments: Mapping[int, LabelSegment] | None
    names: Mapping[str, int] | None
    affine: Floats
    notes: tuple[str, ...]
    doubts: tuple[str, ...]

    @property
    def numbers(self) -> list[int]:
        """Numbers of the labels that have voxels; the background is 0 or negative."""
        layers = np.moveaxis(self.layers, -1, 0)
        values = [{int(value) for value in np.unique(layer) if value > 0} for layer in layers]
        if self.segments is None:
            return sorted(set().union(*values))
        present = {
            n for n, segment in self.segments.items() if segment.value in values[segment.layer]
        }
        return sorted(present)

    def inside(self, number: int) -> Bools:
        """Return True in the voxels of a label (i, j, k).

        Raises:
            InputError: There is no such label, or it was interpolated.
        """
        segment = LabelSegment(number)
        if self.segments is not None:
            segment = self.segments.get(number, LabelSegment(0, -1))
        values = self.layers[..., segment.layer]
        inside: Bools = values == segment.value
        if segment.layer < 0 or not inside.any():
            present_numbers = self.numbers
            if self.segments is None:
                present_numbers = [int(value) for value in np.unique(self.layers)]
            labels = ", ".join(str(value) for value in present_numbers[:9])
            raise InputError(f"{self.path}: has no label {number}; it has {labels}")
        self._check_sharp(values, inside, number)
        return inside

    def _check_sharp(self, values: Numbers, inside: Bools, number: int) -> None:
        """Raise InputError if a label is surrounded by numbers that interpolation made of it."""
        shell = ndimage.binary_dilation(inside) & ~inside
        is_between = shell & (values > 0) & (values < number)
        if is_between.sum() < LEAST_SHARE * shell.sum():
            return
        rim_values = values[is_between]
        if len(np.unique(rim_values)) < LEAST_NUMBERS:
            return
        equal_neighbours = np.zeros(len(rim_values))
        padded = np.pad(values, 1)
        positions = np.argwhere(is_between) + 1
        for axis in range(3):
            for step in (-1, 1):
                neighbours = positions.copy()
                neighbours[:, axis] += step
                equal_neighbours += padded[tuple(neighbours.T)] == rim_values
        if equal_neighbours.mean() < LEAST_NEIGHBOURS:
            raise InputError(
                f"{self.path}: the label {number} is surrounded by numbers from"
                f" {rim_values.min():g} to"
                f" {rim_values.max():g} that differ from voxel to voxel; are they probabilities or"
                " interpolated labels? Export labels, or resample them by nearest neighbour"
            )


def read(path: Path) -> LabelImage:
    """Read the labels of a segmentation.

    Segments in several layers have the numbers that the file gives them. If these repeat, they are
    numbered in their order.

    Raises:
        InputError: The image cannot be read, is a CT, or has values between whole numbers.
    """
    image = images.read_layers(path)
    if image.segments is None:
        _check_labels(path, image.values)
    values, rounded = as_whole_numbers(path, image.values)
    notes = [*image.summary, *rounded]
    names = {name: segment.value for name, segment in (image.segments or {}).items()}
    segments = None
    if values.ndim > 3 and image.segments:
        if len({*names.values()}) < len(names):
            names = {name: number for number, name in enumerate(names, 1)}
            numbered = ", ".join(f"{number} {name}" for name, number in names.items())
            notes.append(f"labels repeat in its layers; its segments are numbered: {numbered}")
        segments = {names[name]: segment for name, segment in image.segments.items()}
    layers = values if values.ndim > 3 else values[..., None]
    known_names = names if image.segments is not None else None
    return LabelImage(path, layers, segments, known_names, image.affine, tuple(notes), image.notes)


def _check_labels(path: Path, values: Numbers) -> None:
    """Raise InputError if an image has so many numbers that it is a CT."""
    some_values = values.ravel()[:: 1 + values.size // COUNTED_VOXELS]
    numbers = np.unique(some_values[np.isfinite(some_values)])
    if len(numbers) > MOST_LABELS and (numbers == np.round(numbers)).all():
        raise InputError(
            f"{path}: has {len(numbers):,} different numbers, from {numbers[0]:g} to"
            f" {numbers[-1]:g}. Is it a CT? Expected the labels of a segmentation; a CT is given as"
            " geometry.canal.ct, or with --ct of mantle init"
        )


def as_whole_numbers(path: Path, values: Numbers) -> tuple[Numbers, list[str]]:
    """Return labels as whole numbers, and notes on those that were rounded.

    Raises:
        InputError: There are values between whole numbers, as interpolation makes them.
    """
    if values.dtype.kind != "f":
        return values, []
    finite = np.isfinite(values)
    numbers = np.where(finite, values, 0.0)
    rounded = np.round(numbers)
    differences = np.abs(numbers - rounded)
    is_fraction = differences > WHOLE_TOLERANCE
    if is_fraction.any():
        raise InputError(
            f"{path}: {int(is_fraction.sum()):,} voxels have values that are not"
            " whole numbers, such as"
            f" {numbers[is_fraction][0]:.4g}; resample the segmentation by nearest neighbour"
        )
    notes = []
    if differences.any():
        notes.append(f"labels rounded by up to {differences.max():.2g}")
    lost_count = int((~finite).sum())
    if lost_count:
        notes.append(f"{lost_count:,} voxels are not numbers; they count as 0")
    return rounded, notes
