"""NRRD files as 3D Slicer writes them."""

from __future__ import annotations

import gzip
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

# Axes of voxels of 0.5 x 0.6 x 2 mm to left, posterior, superior.
WAYS = "(0.5,0,0) (0,0.6,0) (0,0,2)"
ORIGIN = "(10,20,30)"


def header(shape: Sequence[int], type: str = "unsigned char", **changes: str | None) -> list[str]:
    """Lines of a header. `changes` replace fields, with underlines for blanks, or drop them."""
    fields: dict[str, str | None] = {
        "type": type,
        "dimension": str(len(shape)),
        "space": "left-posterior-superior",
        "sizes": " ".join(map(str, shape)),
        "space_directions": WAYS,
        "kinds": "domain domain domain",
        "endian": "little",
        "encoding": "gzip",
        "space_origin": ORIGIN,
    }
    fields |= changes
    lines = [f"{key.replace('_', ' ')}: {value}" for key, value in fields.items() if value]
    return ["NRRD0004", *lines]


def save(path: Path, lines: Sequence[str], content: bytes = b"", newline: str = "\n") -> Path:
    """Write a header and data after it."""
    path.write_bytes(newline.join([*lines, "", ""]).encode() + content)
    return path


def segmentation(
    path: Path,
    layers: Sequence[Any],
    segments: Sequence[tuple[str, int | None, int | None]],
    list_first: bool = True,
) -> Path:
    """Write layers of labels, and segments by name, layer and label.

    Layer and label may be unknown.
    """
    values = np.stack(layers, axis=0 if list_first else -1).astype(np.uint8)
    ways = f"none {WAYS}" if list_first else f"{WAYS} none"
    lines = header(values.shape, space_directions=ways, kinds=None)
    for k, (name, layer, label) in enumerate(segments):
        lines += [f"Segment{k}_Name:={name}", f"Segment{k}_ID:=Segment_{k}"]
        if layer is not None:
            lines.append(f"Segment{k}_Layer:={layer}")
        if label is not None:
            lines.append(f"Segment{k}_LabelValue:={label}")
    return save(path, lines, gzip.compress(values.tobytes(order="F")))
