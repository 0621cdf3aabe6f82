"""Checkpoints of a run: writing, reading, and the choice of one for a restart.

A checkpoint is an ``npz`` file of numpy: arrays with checksums, and a header in JSON. An array has
the rows of all ranks in the order of their keys. Any number of ranks can read it.
"""

from __future__ import annotations

import hashlib
import io
import json
import logging
import time as clock
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import NotRequired, TypedDict

from mpi4py import MPI

import numpy as np

from app import __version__
from app.case.case import Case, plain_data
from app.foundation.collective import everywhere, on_root
from app.foundation.errors import InputError
from app.foundation.files import write_bytes
from app.foundation.layout import leaves, several
from app.numerics.saved_state import Array, Rows, collect, restore, restored_object
from app.simulation.model import Model
from app.simulation.recorder import Recorder
from app.system import folders

log = logging.getLogger("mantle")

# Version of the file layout.
FORMAT = 14
# Key in the header, in place of rows, with the names of their arrays.
ROWS = "@rows"
# Number of checkpoints that stay on disk.
KEPT = 2
# Number of differences listed in a message.
MOST_LISTED = 12


class DamagedError(InputError):
    """A file is not a complete checkpoint."""


class Header(TypedDict):
    """Header of a checkpoint.

    Attributes:
        mantle: Version of the program.
        case: Data of the case on which its states depend.
        mesh: Digest of the mesh.
        ranks: Number of ranks that wrote it.
        stage: Number of the stage, from 0.
        stage_name: Name of the stage.
        step: Number of recorded steps.
        time: Time of the last step.
        seconds: Wall time by phase [s].
        written: Time of writing (ISO 8601).
        format: Version of the file layout.
    """

    mantle: str
    case: dict[str, object]
    mesh: str
    ranks: int
    stage: int
    stage_name: str
    step: int
    time: float
    seconds: dict[str, float]
    written: NotRequired[str]
    format: NotRequired[int]


@dataclass(frozen=True)
class Checkpoint:
    """A checkpoint that was read: file, header and saved state (`numerics.saved_state`)."""

    path: Path
    header: Header
    state: Mapping[str, object]


# Files


def write(comm: MPI.Comm, path: Path, header: Header, state: object) -> None:
    """Write a checkpoint: a new file, flushed to disk and renamed; collective.

    Raises:
        OSError: It cannot be written (on every rank); an earlier file stays.
    """
    arrays: dict[str, Array] = {}

    def gathered(rows: Rows) -> dict[str, list[str]]:
        """Move the rows of all ranks to arrays on rank 0; keys on several rows occur once."""
        rank_rows = comm.gather(rows)
        if rank_rows is None:
            return {}
        keys, first_rows = np.unique(np.concatenate([p.keys for p in rank_rows]), return_index=True)
        array_names = [
            f"keys {hashlib.sha256(keys.tobytes()).hexdigest()[:16]}",
            f"rows {len(arrays)}",
        ]
        arrays[array_names[0]] = keys
        arrays[array_names[1]] = np.concatenate([p.values for p in rank_rows])[first_rows]
        return {ROWS: array_names}

    # All ranks meet the rows in the same order.
    header_text = json.dumps({**header, "format": FORMAT, "state": state}, default=gathered)

    def whole() -> None:
        file = io.BytesIO()
        np.savez(
            file, allow_pickle=False, **arrays, header=np.frombuffer(header_text.encode(), np.uint8)
        )
        write_bytes(path, file.getvalue())

    on_root(comm, whole, share=False)


def read(path: Path) -> Checkpoint:
    """Read a checkpoint; not collective.

    Raises:
        DamagedError: It cannot be read, is incomplete, or is no checkpoint.
    """
    try:
        path.stat()
        if not (path.is_file() and zipfile.is_zipfile(path)):
            raise DamagedError("it is not a checkpoint, or it is incomplete")
        with np.load(path, allow_pickle=False) as file:
            arrays = dict(file)

        def with_rows(data: dict[str, list[str]]) -> Rows | dict[str, list[str]]:
            return Rows(*(arrays[name] for name in data[ROWS])) if ROWS in data else data

        header = json.loads(arrays["header"].tobytes(), object_hook=with_rows)
        if header["format"] != FORMAT:
            raise DamagedError(f"written by mantle {header['mantle']} in another format")
        return Checkpoint(path, header, header.pop("state"))
    except OSError as error:
        raise DamagedError(error.strerror or str(error)) from error
    except (zipfile.BadZipFile, EOFError, LookupError, TypeError, ValueError) as error:
        raise DamagedError(f"the file is damaged ({error})") from error


# Choice for a restart


def checkpoint_to_resume(
    comm: MPI.Comm, requested: str, folder: Path, case: Case, force: bool
) -> Checkpoint | None:
    """Checkpoint to restart from, or None; collective.

    ``requested`` is a file, or ``auto``: the newest readable one in the run directory. With
    ``force`` a checkpoint of another configuration is accepted.

    Raises:
        InputError: It is the checkpoint of another case, or the file cannot be read.
    """

    def choose() -> Path | None:
        all_checkpoints = folders.saved(folder) if requested == "auto" else [Path(requested)]
        for path in all_checkpoints:
            try:
                saved_checkpoint = read(path)
            except DamagedError as error:
                if requested != "auto":
                    raise InputError(f"--restart {path}: cannot be used: {error}") from error
                log.warning("%s cannot be used: %s; trying the previous one", path, error)
                continue
            _refuse_another(saved_checkpoint, case, force)
            return path
        not_found = "no usable checkpoint" if all_checkpoints else "no checkpoint"
        log.info("restart: %s in %s; starting from the beginning", not_found, folder)
        return None

    path = on_root(comm, choose)
    return None if path is None else everywhere(comm, lambda: read(path))


def _refuse_another(saved_checkpoint: Checkpoint, case: Case, force: bool) -> None:
    """Raise InputError for a checkpoint of another version or configuration."""
    if saved_checkpoint.header["mantle"] != __version__ and not force:
        raise InputError(
            f"--restart: {saved_checkpoint.path} was written by mantle"
            f" {saved_checkpoint.header['mantle']}, this is "
            f"{__version__}: results may differ (--force uses it nevertheless)"
        )
    saved_values, case_values = (
        dict(leaves(c)) for c in (saved_checkpoint.header["case"], data_of_states(case))
    )
    pairs = {
        key: (case_values.get(key, "nothing"), saved_values.get(key, "nothing"))
        for key in case_values | saved_values
    }
    differ = [f"  {key}: {a}; in the checkpoint {b}" for key, (a, b) in pairs.items() if a != b]
    if not differ:
        return
    if len(differ) > MOST_LISTED:
        differ = [*differ[:MOST_LISTED], f"  and {len(differ) - MOST_LISTED} more"]
    message = f"{saved_checkpoint.path} is the checkpoint of another case"
    if not force:
        raise InputError([f"--restart: {message}; --force uses it nevertheless", *differ])
    log.warning("%s:\n%s", message, "\n".join(differ))


def data_of_states(case: Case) -> dict[str, object]:
    """All data of a case on which its states depend."""
    data = plain_data(case)
    data.pop("title", None)
    output = data.get("output", {})
    data["output"] = {key: output.get(key, {}) for key in ("probes", "paths")}
    data["geometry"].pop("path", None)  # the digest identifies the mesh, not its path
    return dict(json.loads(json.dumps(data)))


# A run


class CheckpointWriter:
    """Writer of periodic checkpoints, which also restores one."""

    def __init__(
        self, case: Case, model: Model, recorder: Recorder, folder: Path, saved: Checkpoint | None
    ) -> None:
        self._case, self._model, self._recorder = case, model, recorder
        self._folder, self._restored_from = folder, saved
        self._comm = model.tagged.mesh.comm
        self._options = case.output.checkpoint
        self._last_mark: tuple[Header, object] | None = None
        self._saved, self._when = 0, clock.monotonic()

    def resume(self) -> int:
        """Restore the checkpoint, if there is one; return its stage; collective.

        Raises:
            InputError: The checkpoint has another mesh or other unknowns.
        """
        saved_checkpoint = self._restored_from
        if saved_checkpoint is None:
            return 0
        header = saved_checkpoint.header
        saved_objects = self._model.saved_parts() | {"recorder": self._recorder}
        everywhere(self._comm, lambda: self._fill(saved_checkpoint, saved_objects))
        restore(saved_objects)
        self._recorder.add_time(header["seconds"])
        self._saved = header["step"]
        self._last_mark = self._current_state(header["stage"])
        by_ranks = (
            "" if header["ranks"] == self._comm.size else f" by {several(header['ranks'], 'rank')}"
        )
        log.info(
            "restart from %s, written %s%s: step %d, time %.6g in stage '%s', %.1f s of work",
            *(saved_checkpoint.path, header["written"], by_ranks, header["step"], header["time"]),
            *(header["stage_name"], header["seconds"]["total"]),
        )
        return int(header["stage"])

    def _fill(self, saved_checkpoint: Checkpoint, saved_objects: dict[str, object]) -> None:
        """Fill the parts; raise InputError for a checkpoint of another mesh or other unknowns."""
        mesh, stage = saved_checkpoint.header["mesh"], saved_checkpoint.header["stage"]
        mesh_hash, stages = self._model.mesh_hash, len(self._model.scene.stages)
        checkpoint = f"--restart: {saved_checkpoint.path}: checkpoint"
        if mesh != mesh_hash:
            raise InputError(
                f"{checkpoint} of another mesh ({mesh[:12]}; this case has {mesh_hash[:12]}); "
                "restart with the mesh it was written on"
            )
        if stage >= stages:
            raise InputError(f"{checkpoint} is in stage {stage + 1}; this case has {stages} stages")
        try:
            restored_object(saved_objects, saved_checkpoint.state["parts"])
        except (AttributeError, LookupError, TypeError, ValueError) as error:
            raise InputError(
                f"{checkpoint} of another model, with other unknowns or records ({error}); "
                "allowed: cases of the same interfaces, heat and cure"
            ) from error

    def _current_state(self, k: int) -> tuple[Header, object]:
        """Header and state of the last recorded step, in stage k."""
        header: Header = {
            "mantle": __version__,
            "case": data_of_states(self._case),
            "mesh": self._model.mesh_hash,
            "ranks": self._comm.size,
            "stage": k,
            "stage_name": self._model.scene.stages[k].name,
            "step": self._recorder.step_count,
            "time": self._recorder.time,
            "seconds": self._recorder.seconds(),
        }
        return header, collect({"parts": self._model.saved_parts() | {"recorder": self._recorder}})

    def mark(self, k: int) -> None:
        """Remember the state, in stage k, and save it if that is due; collective."""
        self._last_mark = self._current_state(k)
        steps, minutes = self._options.steps, self._options.minutes
        is_due = bool(steps and self._recorder.step_count - self._saved >= steps)
        if minutes and not is_due:
            # All ranks use one clock, so that all save or none.
            waited = clock.monotonic() - self._when
            is_due = bool(self._comm.bcast(waited >= 60 * minutes))
        if is_due:
            self.save()

    def save(self) -> Path | None:
        """Save the last remembered state unless it is saved; return its file; collective."""
        if self._last_mark is None:
            return None
        header, state = self._last_mark
        path = self._folder / f"checkpoint-{header['step']}.state"
        if header["step"] == self._saved and on_root(self._comm, path.exists):
            return path
        written_at = datetime.now(UTC).isoformat(timespec="seconds")
        try:
            write(self._comm, path, {**header, "written": written_at}, state)
        except OSError as error:
            log.warning("checkpoint %s cannot be written: %s", path, error.strerror or error)
            return None
        on_root(self._comm, lambda: _delete_older(self._folder, path), share=False)
        self._saved, self._when = header["step"], clock.monotonic()
        log.debug("     %s", path)
        return path


def _delete_older(folder: Path, newest: Path) -> None:
    """Delete all but the newest checkpoints. Those later than `newest` are of an earlier run."""
    all_checkpoints = folders.saved(folder)
    place = all_checkpoints.index(newest)
    for path in [*all_checkpoints[:place], *all_checkpoints[place + KEPT :]]:
        path.unlink(missing_ok=True)
