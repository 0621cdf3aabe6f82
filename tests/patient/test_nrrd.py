"""Images in NRRD files: encodings, numbers in other files, and refused files."""

from __future__ import annotations

import bz2
import gzip
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from app.foundation.errors import InputError
from app.patient import images
from tests.patient.nrrd_files import WAYS, header, save, segmentation

SHAPE = (3, 4, 5)
VALUES = np.random.default_rng(0).integers(-1000, 1500, SHAPE).astype("<i2")
RAW = VALUES.tobytes(order="F")
# To right, anterior, superior.
AFFINE = np.array([[-0.5, 0, 0, -10], [0, -0.6, 0, -20], [0, 0, 2, 30], [0, 0, 0, 1.0]])


def lines(encoding: str = "raw", **changes: str | None) -> list[str]:
    return header(SHAPE, "short", encoding=encoding, **changes)


def one_file(content: bytes, *head: str, newline: str = "\n") -> Callable[[Path], Path]:
    return lambda folder: save(folder / "a.nrrd", head, content, newline)


def detached(
    name: str, contents: dict[str, bytes], encoding: str = "raw", *more: str
) -> Callable[[Path], Path]:
    """Write a header that names other files."""

    def write(folder: Path) -> Path:
        for file, content in contents.items():
            (folder / file).write_bytes(content)
        path = folder / "a.nhdr"
        text = [*lines(encoding), f"data file: {name}", *more]
        path.write_text("\n".join(text) + "\n")
        return path

    return write


SLICES = {f"s{k}.raw": VALUES[:, :, k].tobytes(order="F") for k in range(5)}
WORDS = " ".join(map(str, VALUES.ravel(order="F"))).encode()
TITLES = [line.partition(":") for line in lines()]
READ: dict[str, Callable[[Path], Path]] = {
    "raw": one_file(RAW, *lines()),
    "gzip": one_file(gzip.compress(RAW), *lines("gzip")),
    "bzip2": one_file(bz2.compress(RAW), *lines("bzip2")),
    "words": one_file(WORDS, *lines("ascii", endian=None)),
    "hexadecimal": one_file(RAW.hex().encode(), *lines("hex")),
    "big endian": one_file(VALUES.astype(">i2").tobytes(order="F"), *lines(endian="big")),
    "lines of Windows": one_file(RAW, *lines(), newline="\r\n"),
    "capitals": one_file(RAW, *[name.upper() + mark + rest for name, mark, rest in TITLES]),
    "names without blanks": one_file(
        RAW, *[name.replace(" ", "") + mark + rest for name, mark, rest in TITLES]
    ),
    "bytes before": one_file(b"\1" * 16 + RAW, *lines(byte_skip="16")),
    "bytes before, from the end": one_file(b"\1" * 21 + RAW, *lines(byte_skip="-1")),
    "lines before": one_file(b"one\ntwo\n" + RAW, *lines(line_skip="2")),
    "unit": one_file(RAW, *lines(space_units='"mm" "mm" "mm"')),
    "layer": one_file(
        RAW, *header((1, *SHAPE), "short", encoding="raw", space_directions=f"none {WAYS}")
    ),
    "another file": detached("a.raw", {"a.raw": RAW}),
    "another file, gzip": detached("a.raw.gz", {"a.raw.gz": gzip.compress(RAW)}, "gzip"),
    "a file each slice": detached("LIST", SLICES, "raw", *SLICES),
    "numbered files": detached("s%d.raw 0 4 1", SLICES),
}


@pytest.mark.parametrize("name", READ)
def test_nrrd_of_each_spelling_has_equal_numbers(name: str, tmp_path: Path) -> None:
    """The voxel (0, 0, 0) is at (10, 20, 30) to left, posterior, superior."""
    image = images.read(READ[name](tmp_path))
    assert (image.values == VALUES).all()
    assert image.affine == pytest.approx(AFFINE)
    assert len(image.summary) == 1


def test_nrrd_bytes_after_the_voxels_are_counted(tmp_path: Path) -> None:
    image = images.read(save(tmp_path / "a.nrrd", lines(), RAW + b"\0" * 60))
    assert (image.values == VALUES).all()
    assert image.summary[1] == "60 bytes after its voxels left out"


def test_nrrd_other_file_is_read_again_when_it_changes(tmp_path: Path) -> None:
    path = READ["another file"](tmp_path)
    assert images.read(path).values[0, 0, 0] == VALUES[0, 0, 0]
    assert images.files_of(path) == [path, tmp_path / "a.raw"]
    (tmp_path / "a.raw").write_bytes(np.full(SHAPE, 7, dtype="<i2").tobytes())
    later = path.stat().st_mtime + 5
    os.utime(tmp_path / "a.raw", (later, later))
    assert (images.read(path).values == 7).all()


REFUSED: dict[str, tuple[Callable[[Path], Path], str]] = {
    "unit": (one_file(RAW, *lines(space_units='"cm" "cm" "cm"')), "its unit is cm; expected mm"),
    "space": (one_file(RAW, *lines(space="scanner-xyz")), "space `scanner-xyz` is not supported"),
    "type": (
        one_file(RAW, "NRRD0004", "type: block", *lines()[2:]),
        "type `block` is not supported",
    ),
    "encoding": (
        one_file(RAW, *lines("zrl")),
        "its encoding `zrl` is not supported; save it with gzip",
    ),
    "no axes": (one_file(RAW, *lines(space_directions=None)), "header has no space directions"),
    "short": (one_file(RAW[:-2], *lines()), "has only 118 of the 120 bytes"),
    "damaged": (one_file(gzip.compress(RAW)[:-9], *lines("gzip")), "its voxels are damaged"),
    "lost file": (
        detached("b.raw", {}),
        "1 of the 1 files of its voxels are missing, such as b.raw",
    ),
    "lost slice": (
        detached("s%d.raw 0 5 1", SLICES),
        "1 of the 6 files of its voxels are missing, such as s5.raw",
    ),
    "short file": (detached("a.raw", {"a.raw": RAW[:-2]}), "has only 118 of the 120 bytes"),
    "colours": (
        one_file(
            3 * RAW, *header((3, *SHAPE), "short", encoding="raw", space_directions=f"none {WAYS}")
        ),
        "has 3 numbers per voxel, such as colours or times; expected one",
    ),
    "times": (
        one_file(2 * RAW, *header((*SHAPE, 2), "short", encoding="raw")),
        "has 4 axes, 3 of them with a direction in space",
    ),
    "segments as a CT": (
        lambda folder: segmentation(
            folder / "a.seg.nrrd", [VALUES > 0, VALUES > 9], [("a", 0, 1), ("b", 1, 1)]
        ),
        "has 2 layers, since its segments overlap; expected one number per voxel",
    ),
    "layer beyond": (
        lambda folder: segmentation(folder / "a.seg.nrrd", [VALUES > 0] * 2, [("a", 2, 1)]),
        "its segment a is in layer 2 .from 0. of 2",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_nrrd_is_refused_with_the_reason(name: str, tmp_path: Path) -> None:
    write, message = REFUSED[name]
    with pytest.raises(InputError, match=message):
        images.read(write(tmp_path))
