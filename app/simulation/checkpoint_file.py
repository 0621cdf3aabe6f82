"""Checkpoints as files: the state of a run that is whole or not there, and back.

A checkpoint is a first block of 512 bytes, which holds the digest of the rest, then a text (JSON)
and arrays, one after the other. The text tells type and shape of each array, whose sizes have to
add up to that of the file. There is no link to other files, filter or compression in it.
Rows are those of all ranks in the order of their keys, so that any number of ranks reads them.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import stat
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

from app.errors import InputError
from app.numerics.saved_state import Array, Rows, State
from app.soundness import memory
from app.system.folders import write_bytes

# Of the layout of the file.
FORMAT = 4
# Bytes of the first block, and of what the length of the text and each array are padded to.
BLOCK, WORD = 512, 8
# What begins the files of the formats before.
HDF5 = b"\x89HDF"
# What stands for rows in the text of a state.
MARK = "@rows"
# Types of arrays, and levels of a text: a state has some ten.
TYPES = ("<f8", "<i8", "<i4", "|i1", "|b1")
DEEPEST = 40
# What a header holds, of which type.
HEADER: dict[str, type | tuple[type, ...]] = {
    **dict.fromkeys(("mantle", "mesh", "stage_name", "written"), str),
    **dict.fromkeys(("ranks", "stage", "step"), int),
    **dict.fromkeys(("time", "seconds"), (int, float)),
    "case": dict,
}


class DamagedError(InputError):
    """A file is no checkpoint, or not a whole one."""


@dataclass(frozen=True)
class Checkpoint:
    """One that was read.

    Attributes:
        path: Its file.
        header: What it is of.
        state: What was remembered.
    """

    path: Path
    header: Mapping[str, Any]
    state: State


def write(comm: MPI.Comm, path: Path, header: Mapping[str, Any], state: State) -> None:
    """Write a checkpoint: a new file, flushed to disk and renamed; collective.

    Args:
        comm: Communicator.
        path: The file.
        header: What it is of.
        state: What to remember, of each rank.

    Raises:
        OSError: It cannot be written (on every rank); what was there stays.
    """
    parts: list[Rows] = []
    tree = _without_rows(state, parts)
    pieces = [comm.gather((r.keys, r.values)) for r in parts]
    failure = None
    if comm.rank == 0:
        try:
            text = json.dumps([dict(header), tree], default=_number)
            image = _image(text, [_sorted(p) for p in pieces if p is not None])
            digest = hashlib.sha256(image).hexdigest()
            write_bytes(path, digest.encode().ljust(BLOCK) + image)
        except OSError as error:
            failure = error
    failure = comm.bcast(failure)
    if failure is not None:
        raise failure


def _without_rows(state: Any, parts: list[Rows]) -> Any:
    """The state with its rows moved to a list."""
    if isinstance(state, Rows):
        parts.append(state)
        return {MARK: len(parts) - 1}
    if isinstance(state, dict):
        return {key: _without_rows(value, parts) for key, value in state.items()}
    if isinstance(state, list | tuple):
        return [_without_rows(value, parts) for value in state]
    return state


def _number(value: Any) -> Any:
    """A number of numpy as one of Python."""
    return value.item()


def _sorted(pieces: list[tuple[Any, Any]]) -> Rows:
    """The rows of all ranks, keys rising."""
    keys = np.concatenate([k for k, _ in pieces])
    order = np.argsort(keys, kind="stable")
    # A rank that has none may not know of how many components.
    values = np.concatenate([v for k, v in pieces if len(k)] or [pieces[0][1]])
    return Rows(keys[order], values[order])


def _image(text: str, parts: list[Rows]) -> bytes:
    """The file behind its first block; keys that several rows have are written once."""
    arrays: list[Array] = []
    places: dict[bytes, int] = {}

    def place(array: Array) -> int:
        arrays.append(np.ascontiguousarray(array))
        return len(arrays) - 1

    rows = []
    for part in parts:
        digest = hashlib.sha256(part.keys.tobytes()).digest()
        if digest not in places:
            places[digest] = place(part.keys)
        rows.append((places[digest], place(part.values)))
    announced = [(a.dtype.str, a.shape) for a in arrays]
    head = f'{{"content": {text}, "arrays": {json.dumps(announced)}, "rows": {json.dumps(rows)}}}'
    pieces = [head.encode(), *(a.tobytes() for a in arrays)]
    padded = [piece.ljust(_padded(len(piece)), b" ") for piece in pieces]
    return b"".join([len(padded[0]).to_bytes(WORD, "little"), *padded])


def _padded(size: int) -> int:
    """A size, or the next that words fill."""
    return -(-size // WORD) * WORD


def read(path: Path) -> Checkpoint:
    """Read a checkpoint; not collective.

    Raises:
        OSError: It cannot be read.
        DamagedError: It is not whole, or nothing of this kind.
    """
    # Not to wait for what writes into a pipe.
    with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
        status = os.fstat(file.fileno())
        _need(stat.S_ISREG(status.st_mode), "it is not a file")
        large = f"its {status.st_size / 1e9:.3g} GB are more than this machine's memory"
        _need(status.st_size < memory.available({}), large)
        content = memoryview(file.read())
    image = content[BLOCK:]
    digest = hashlib.sha256(image).hexdigest().encode()
    _need(bytes(content[:BLOCK]).strip() == digest, "the file is damaged")
    _need(bytes(image[: len(HDF5)]) != HDF5, "written by another mantle in another format")
    try:
        return _parsed(path, image)
    except (ArithmeticError, LookupError, RecursionError, TypeError, ValueError) as error:
        raise DamagedError(f"it is no checkpoint ({type(error).__name__}: {error})") from error


def _need(fact: bool, fault: str) -> None:
    """Refuse a file without a fact.

    Raises:
        DamagedError: It is not so.
    """
    if not fact:
        raise DamagedError(fault)


def _parsed(path: Path, image: memoryview) -> Checkpoint:
    """What a file tells, of which nothing is believed: neither names, nor types, nor sizes."""
    begin = WORD + int.from_bytes(image[:WORD], "little")
    told = json.loads(bytes(image[WORD:begin]))
    header, tree = told["content"]
    _plain(header, "the header", [])
    if header["format"] != FORMAT:
        raise DamagedError(f"written by mantle {header['mantle']} in another format")
    for name, wanted in HEADER.items():
        value = header.get(name)
        fits = isinstance(value, wanted) and not isinstance(value, bool)
        _need(fits, f"{name} is missing in its header, or something else")
    _need(min(header["ranks"], header["stage"], header["step"]) >= 0, "its step is negative")
    _need(math.isfinite(header["time"] + header["seconds"]), "its time is not finite")
    sizes = []
    for kind, shape in told["arrays"]:
        _need(kind in TYPES, f"it has an array of type {str(kind)[:20]}")
        _need(all(type(n) is int and n >= 0 for n in shape), "it has an array without a shape")
        sizes.append(math.prod(shape) * np.dtype(kind).itemsize)
    whole = begin + sum(map(_padded, sizes))
    _need(whole == len(image), f"its arrays are of {whole} bytes, and the file has {len(image)}")
    arrays = []
    for (kind, shape), size in zip(told["arrays"], sizes, strict=True):
        array: Array = np.frombuffer(image[begin : begin + size], dtype=np.dtype(kind))
        arrays.append(array.reshape(shape))
        begin += _padded(size)
    parts = []
    for k, v in told["rows"]:
        keys, values = arrays[k], arrays[v]
        _need(keys.dtype == np.int64 and keys.ndim == 1, "it has rows without keys")
        _need(bool((np.diff(keys) >= 0).all()), "it has keys that do not rise")
        _need(values.ndim > 0 and len(values) == len(keys), "it has rows without keys")
        parts.append(Rows(keys, values))
    state = _plain(tree, "the state", parts)
    _need(isinstance(state, dict) and {*state} == {"model", "recorder"}, "it has no state")
    return Checkpoint(path, header, state)


def _plain(tree: Any, what: str, parts: list[Rows], level: int = 0) -> Any:
    """A text as it was parsed, with the rows in their places again."""
    _need(level < DEEPEST, f"{what} is nested too deeply")
    if isinstance(tree, dict):
        if tree.keys() == {MARK}:
            return parts[tree[MARK]]
        return {key: _plain(value, what, parts, level + 1) for key, value in tree.items()}
    if isinstance(tree, list):
        return [_plain(value, what, parts, level + 1) for value in tree]
    return tree
