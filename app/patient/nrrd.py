"""Images in NRRD files, as 3D Slicer writes them, and the names of their segments.

A header of lines of text is followed by the numbers, with gzip or without. Source: Definition of
NRRD File Format, version 5, teem.sourceforge.net/nrrd/format.html. A segmentation of 3D Slicer
(``.seg.nrrd``) has a key ``Segment0_Name`` and ``Segment0_LabelValue`` for each of its segments.
"""

from __future__ import annotations

import gzip
import re
import zlib
from pathlib import Path

import numpy as np

from app.foundation.arrays import Floats, Numbers
from app.foundation.errors import InputError

MAGIC = b"NRRD"
LONGEST_HEADER = 10_000_000  # bytes
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


def read(path: Path) -> tuple[Numbers, Floats, list[str], list[str]]:
    """Read numbers (i, j, k), their affine to right, anterior, superior [mm], format and doubts.

    Raises:
        InputError: The file has no axes, a format that is not read, or not all numbers.
    """
    header, content = _parts(path)
    sizes = [int(n) for n in header["sizes"].split()]
    if len(sizes) != 3:
        layers = sizes[0] if len(sizes) == 4 else 0
        text = f"its segments overlap, in {layers} layers" if layers else f"has {len(sizes)} axes"
        raise InputError(
            f"{path}: {text}; expected one number in each voxel: in 3D Slicer export the segments"
            " as a labelmap"
        )
    kind = next((k for k, names in TYPES.items() if header["type"] in names.split(",")), None)
    space = header.get("space", "").lower()
    if kind is None or space not in SPACES:
        what = f"type `{header['type']}`" if kind is None else f"space `{space}`"
        raise InputError(f"{path}: its {what} is not read; save it as NIfTI in 3D Slicer")
    raw = _unpacked(path, header.get("encoding", "raw"), content)
    dtype = np.dtype((">" if header.get("endian") == "big" else "<") + kind)
    number = int(np.prod(sizes))
    if len(raw) < number * dtype.itemsize:
        raise InputError(
            f"{path}: has {len(raw):,} of {number * dtype.itemsize:,} bytes of its voxels: was it"
            " copied whole?"
        )
    values = np.frombuffer(raw, dtype, number).reshape(sizes, order="F")
    affine = np.eye(4)
    ways = [_vector(text) for text in re.findall(r"\([^)]*\)|none", header["space directions"])]
    affine[:3] = np.column_stack([*ways, _vector(header["space origin"])])
    affine[:3] *= np.array(SPACES[space])[:, None]
    return values.astype(dtype.newbyteorder("=")), affine, [f"NRRD, axes by its {space}"], []


def segments(path: Path) -> dict[str, int]:
    """Return the labels of the segments of a file by their names; none without names."""
    header, _ = _parts(path)
    names = {
        key.removesuffix("_Name"): name
        for key, name in header.items()
        if re.fullmatch(r"Segment\d+_Name", key)
    }
    return {name: int(header.get(f"{key}_LabelValue", "1")) for key, name in names.items()}


def _parts(path: Path) -> tuple[dict[str, str], bytes]:
    """Return fields and keys of the header, and the bytes after it.

    Raises:
        InputError: The header is damaged, or the numbers are in another file.
    """
    whole = path.read_bytes()
    end = re.search(rb"\r?\n\r?\n", whole[:LONGEST_HEADER])
    if not whole.startswith(MAGIC) or end is None:
        raise InputError(f"{path}: is no NRRD file, or its header is incomplete")
    header = dict[str, str]()
    for line in whole[: end.start()].decode("utf-8", "replace").splitlines()[1:]:
        if not line.startswith("#"):
            key, _, value = line.partition(":")
            header[key] = value.removeprefix("=").strip()
    if "data file" in header or "datafile" in header:
        raise InputError(f"{path}: its voxels are in another file; save it as one .nrrd")
    lost = [k for k in ("type", "sizes", "space directions", "space origin") if k not in header]
    if lost:
        raise InputError(f"{path}: its header has no {' and no '.join(lost)}")
    return header, whole[end.end() :]


def _unpacked(path: Path, encoding: str, content: bytes) -> bytes:
    """Return the bytes of the numbers.

    Raises:
        InputError: Another encoding, or a damaged one.
    """
    if encoding == "raw":
        return content
    if encoding not in ("gzip", "gz"):
        raise InputError(f"{path}: its encoding `{encoding}` is not read; save it with gzip")
    try:
        return gzip.decompress(content)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"{path}: its voxels are damaged: {error}") from error


def _vector(text: str) -> list[float]:
    """Return the numbers of ``(1,0,0)``."""
    return [float(part) for part in text.strip("() ").split(",")]
