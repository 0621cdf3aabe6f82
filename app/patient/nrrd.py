"""Images in NRRD files, as 3D Slicer and ITK write them, and the names of their segments.

A header of lines of text is followed by the numbers, or names the files that have them. Source:
Definition of NRRD File Format, version 5, teem.sourceforge.net/nrrd/format.html. A segmentation of
3D Slicer (``.seg.nrrd``) has keys ``Segment0_Name``, ``Segment0_LabelValue`` and
``Segment0_Layer`` for each of its segments. Segments that overlap are in different layers: an axis
of the numbers that has no direction in space.
"""

from __future__ import annotations

import bz2
import gzip
import re
import zlib
from pathlib import Path

import numpy as np

from app.foundation.arrays import Numbers
from app.foundation.errors import InputError
from app.patient.voxels import LabelSegment, Voxels

MAGIC = b"NRRD"
LONGEST_HEADER = 10_000_000  # bytes
CHUNK = 65_536  # bytes of it that are read at once
# Types of numbers by their names, in the order of the standard.
TYPES = {
    "i1": "signed char,int8,int8_t",
    "u1": "uchar,unsigned char,uint8,uint8_t",
    "i2": "short,short int,signed short,signed short int,int16,int16_t",
    "u2": "ushort,unsigned short,unsigned short int,uint16,uint16_t",
    "i4": "int,signed int,int32,int32_t",
    "u4": "uint,unsigned int,uint32,uint32_t",
    "i8": "longlong,long long,long long int,signed long long,int64,int64_t",
    "u8": "ulonglong,unsigned long long,unsigned long long int,uint64,uint64_t",
    "f4": "float",
    "f8": "double",
}
# Factors from axes of spaces to right, anterior, superior.
SPACES = {
    "right-anterior-superior": (1.0, 1.0, 1.0),
    "ras": (1.0, 1.0, 1.0),
    "left-posterior-superior": (-1.0, -1.0, 1.0),
    "lps": (-1.0, -1.0, 1.0),
    "left-anterior-superior": (-1.0, 1.0, 1.0),
    "las": (-1.0, 1.0, 1.0),
}
TEXT_ENCODINGS = ("ascii", "text", "txt")  # encodings of numbers as words
# Fields without which voxels have no places.
REQUIRED_FIELDS = ("type", "sizes", "space directions", "space origin")


def read(path: Path) -> Voxels:
    """Read numbers, their affine to right, anterior, superior [mm], and the segments.

    Raises:
        InputError: The file has no axes, a format that is not read, or not all numbers.
    """
    header, keys, _, header_end = _header(path)
    files = data_files(path)
    contents = [file.read_bytes() for file in files] if files else [path.read_bytes()[header_end:]]
    sizes = [int(n) for n in header["sizes"].split()]
    type_code = next((k for k, names in TYPES.items() if header["type"] in names.split(",")), None)
    space = header.get("space", "").lower()
    if type_code is None or space not in SPACES:
        unsupported = f"type `{header['type']}`" if type_code is None else f"space `{space}`"
        raise InputError(
            f"{path}: its {unsupported} is not supported; save it as NIfTI in 3D Slicer"
        )
    units = {*re.findall(r'"([^"]*)"', header.get("spaceunits", ""))} - {"", "mm", "none"}
    if units:
        raise InputError(f"{path}: its unit is {', '.join(sorted(units))}; expected mm")
    directions = re.findall(r"\([^)]*\)|none", header["spacedirections"])
    layer_axes = [axis for axis, direction in enumerate(directions) if direction == "none"]
    if (
        len(directions) != len(sizes)
        or len(directions) - len(layer_axes) != 3
        or len(layer_axes) > 1
    ):
        raise InputError(
            f"{path}: has {len(sizes)} axes, {len(directions) - len(layer_axes)}"
            " of them with a direction in"
            " space; expected 3, and at most one axis of layers"
        )
    dtype = np.dtype((">" if header.get("endian") == "big" else "<") + type_code)
    numbers, left_out = _numbers(path, header, contents, dtype, int(np.prod(sizes)))
    values = numbers.reshape(sizes, order="F")
    for axis in layer_axes:
        values = np.moveaxis(values, axis, -1)
    affine = np.eye(4)
    vectors = [_vector(direction) for direction in directions if direction != "none"]
    affine[:3] = np.column_stack([*vectors, _vector(header["spaceorigin"])])
    affine[:3] *= np.array(SPACES[space])[:, None]
    segments = _segments(path, keys, sizes[layer_axes[0]] if layer_axes else 1)
    return Voxels(values, affine, f"NRRD, axes by its {space}", left_out, segments=segments)


def _segments(path: Path, keys: dict[str, str], layers: int) -> dict[str, LabelSegment] | None:
    """Return the segments of a file by their names; None without names.

    Old files have no key for the layer: each segment has one, in their order.

    Raises:
        InputError: A segment has a layer that is none of the file.
    """
    numbers = [m[1] for m in (re.fullmatch(r"Segment(\d+)_Name", key) for key in keys) if m]
    segments = dict[str, LabelSegment]()
    for position, number in enumerate(sorted(numbers, key=int)):
        name = keys[f"Segment{number}_Name"]
        value = int(keys.get(f"Segment{number}_LabelValue", "1"))
        layer = int(keys.get(f"Segment{number}_Layer", f"{position if layers > 1 else 0}"))
        if not 0 <= layer < layers:
            fault = f"its segment {name} is in layer {layer} (from 0) of {layers}"
            raise InputError(f"{path}: {fault}; is the file damaged?")
        if name in segments:
            name = f"{name} ({number})"
        segments[name] = LabelSegment(value, layer)
    return segments or None


def data_files(path: Path) -> list[Path]:
    """Return the files that have the numbers of a header; none if they follow it in the same file.

    Raises:
        InputError: The header is damaged, or one of the files is missing.
    """
    header, _, listed_names, _ = _header(path)
    data_words = header.get("datafile", "").split()
    if not data_words:
        return []
    if data_words[0] == "LIST":
        names = listed_names
    elif "%" in data_words[0]:
        first_number, last_number, step = (int(word) for word in data_words[1:4])
        names = [
            data_words[0] % k
            for k in range(first_number, last_number + (1 if step > 0 else -1), step)
        ]
    else:
        names = [header["datafile"]]
    files = [path.parent / name for name in names]
    missing_files = [file.name for file in files if not file.is_file()]
    if missing_files or not files:
        fault = f"{len(missing_files)} of the {len(files)} files of its voxels are missing"
        raise InputError(
            f"{path}: {fault}, such as {', '.join(missing_files[:3])}; copy them to its folder"
        )
    return files


def _header(path: Path) -> tuple[dict[str, str], dict[str, str], list[str], int]:
    """Return fields and keys of the header, the list of data files, and the byte after it.

    Names of fields are in small letters and without blanks, because both do not matter.

    Raises:
        InputError: The header is damaged.
    """
    header_bytes, header_end = b"", None
    with path.open("rb") as file:
        while header_end is None and len(header_bytes) < LONGEST_HEADER:
            chunk = file.read(CHUNK)
            header_bytes += chunk
            header_end = (
                re.search(rb"\r?\n\r?\n", header_bytes)
                if chunk
                else re.search(rb"\Z", header_bytes)
            )
    if not header_bytes.startswith(MAGIC) or header_end is None:
        raise InputError(f"{path}: is not an NRRD file, or its header is incomplete")
    fields = dict[str, str]()
    keys = dict[str, str]()
    listed_names = list[str]()
    for line in header_bytes[: header_end.start()].decode("utf-8", "replace").splitlines()[1:]:
        name, separator, value = line.partition(":")
        if fields.get("datafile", "").startswith("LIST"):
            listed_names.append(line.strip())
        elif separator and value.startswith("="):
            keys[name] = value[1:].strip()
        elif separator and not line.startswith("#"):
            fields[name.lower().replace(" ", "")] = value.strip()
    missing_fields = [name for name in REQUIRED_FIELDS if name.replace(" ", "") not in fields]
    if missing_fields:
        raise InputError(f"{path}: its header has no {' and no '.join(missing_fields)}")
    return fields, keys, [name for name in listed_names if name], header_end.end()


def _numbers(
    path: Path, header: dict[str, str], contents: list[bytes], dtype: np.dtype, number: int
) -> tuple[Numbers, tuple[str, ...]]:
    """Return the numbers (n,), and a note on bytes after them.

    Raises:
        InputError: Numbers are missing or damaged.
    """
    encoding = header.get("encoding", "raw").lower()
    skipped_bytes, skipped_lines = (int(header.get(key, "0")) for key in ("byteskip", "lineskip"))
    blocks = list[bytes]()
    block_size = number * dtype.itemsize // len(contents)
    for content in contents:
        for _ in range(skipped_lines):
            content = content.partition(b"\n")[2]
        block = _unpacked(path, encoding, content)
        blocks.append(block[-block_size:] if skipped_bytes < 0 else block[skipped_bytes:])
    if encoding in TEXT_ENCODINGS:
        words = np.array(b" ".join(blocks).split())
        raw_bytes = words.astype(dtype.newbyteorder("=")).tobytes()
        dtype = dtype.newbyteorder("=")
    else:
        raw_bytes = b"".join(blocks)
    expected_bytes = number * dtype.itemsize
    if len(raw_bytes) < expected_bytes or (
        len(blocks) > 1 and any(len(block) != block_size for block in blocks)
    ):
        raise InputError(
            f"{path}: has only {len(raw_bytes):,} of the {expected_bytes:,} bytes of its voxels;"
            " copy it again"
        )
    extra_bytes = len(raw_bytes) - expected_bytes
    left_out = (f"{extra_bytes:,} bytes after its voxels left out",) if extra_bytes else ()
    return np.frombuffer(raw_bytes, dtype, number).astype(dtype.newbyteorder("=")), left_out


def _unpacked(path: Path, encoding: str, content: bytes) -> bytes:
    """Return the bytes of the numbers; those of texts are words.

    Raises:
        InputError: Another encoding, or a damaged one.
    """
    try:
        match encoding:
            case "raw" | "ascii" | "text" | "txt":
                return content
            case "gzip" | "gz":
                return gzip.decompress(content)
            case "bzip2" | "bz2":
                return bz2.decompress(content)
            case "hex":
                return bytes.fromhex(content.decode("ascii"))
    except (OSError, EOFError, ValueError, zlib.error) as error:
        raise InputError(f"{path}: its voxels are damaged: {error}") from error
    raise InputError(f"{path}: its encoding `{encoding}` is not supported; save it with gzip")


def _vector(text: str) -> list[float]:
    """Return the numbers of ``(1,0,0)``."""
    return [float(part) for part in text.strip("() ").split(",")]
