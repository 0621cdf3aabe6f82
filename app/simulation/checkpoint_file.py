"""Checkpoints as files: the state of a run that is whole or not there, and back.

A checkpoint is one HDF5 file behind a first block of 512 bytes, which holds the digest of the rest.
Rows are those of all ranks in the order of their keys, so that any number of ranks reads them.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI  # before h5py, which may be built for MPI

import h5py
import numpy as np

from mantle.numerics.state import Rows, State
from mantle.system.folders import write_bytes

# Of the layout of the file.
FORMAT = 3
# The first block, of a size that HDF5 looks behind.
BLOCK = 512
# What stands for rows in the text of a state.
MARK = "@rows"


class DamagedError(Exception):
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
            text = json.dumps([dict(header), tree], default=_plain)
            image = _image(text, [_sorted(p) for p in pieces if p is not None])
            digest = hashlib.sha256(image).hexdigest()
            write_bytes(path, digest.encode().ljust(BLOCK) + image)
        except OSError as error:
            path.with_name(path.name + ".partial").unlink(missing_ok=True)
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


def _with_rows(tree: Any, parts: list[Rows]) -> Any:
    """The rows in their places again."""
    if isinstance(tree, dict):
        if tree.keys() == {MARK}:
            return parts[tree[MARK]]
        return {key: _with_rows(value, parts) for key, value in tree.items()}
    if isinstance(tree, list):
        return [_with_rows(value, parts) for value in tree]
    return tree


def _plain(value: Any) -> Any:
    """Numbers of numpy."""
    return value.item()


def _sorted(pieces: list[tuple[Any, Any]]) -> Rows:
    """The rows of all ranks, keys rising."""
    keys = np.concatenate([k for k, _ in pieces])
    order = np.argsort(keys, kind="stable")
    # A rank that has none may not know of how many components.
    values = np.concatenate([v for k, v in pieces if len(k)] or [pieces[0][1]])
    return Rows(keys[order], values[order])


def _image(text: str, parts: list[Rows]) -> bytes:
    """The HDF5 file."""
    with h5py.File("checkpoint", "w", driver="core", backing_store=False) as file:
        file["state"] = np.frombuffer(text.encode(), dtype=np.uint8)
        for k, r in enumerate(parts):
            name = "keys/" + hashlib.sha256(r.keys.tobytes()).hexdigest()[:16]
            if name not in file:
                file[name] = r.keys
            file[f"rows/{k}"] = r.values
            file[f"rows/{k}"].attrs["keys"] = name
        file.flush()
        return bytes(file.id.get_file_image())


def read(path: Path) -> Checkpoint:
    """Read a checkpoint; not collective.

    Raises:
        OSError: It cannot be read.
        DamagedError: It is not whole, or nothing of this kind.
    """
    content = path.read_bytes()
    image = content[BLOCK:]
    if content[:BLOCK].strip() != hashlib.sha256(image).hexdigest().encode():
        raise DamagedError("the file is damaged")
    with h5py.File(io.BytesIO(image), "r") as file:
        header, tree = json.loads(bytes(file["state"][:]))
        if header["format"] != FORMAT:
            raise DamagedError(f"written by mantle {header['mantle']} in another format")
        keys = {f"keys/{name}": file["keys"][name][:] for name in file.get("keys", ())}
        count = len(file.get("rows", ()))
        parts = [
            Rows(keys[file[f"rows/{k}"].attrs["keys"]], file[f"rows/{k}"][:]) for k in range(count)
        ]
    return Checkpoint(path, header, _with_rows(tree, parts))
