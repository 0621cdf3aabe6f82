"""Checkpoints of a run: when they are written, which one a restart takes, and whether it fits."""

from __future__ import annotations

import json
import logging
import math
import time as clock
from collections.abc import Collection, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from mpi4py import MPI  # before h5py, which may be built for MPI

import numpy as np

from app.case.case import Case, plain
from app.errors import InputError, agree, everywhere
from app.numerics.saved_state import Rows, State
from app.results.run_folder import on_root
from app.simulation.checkpoint_file import FORMAT, Checkpoint, DamagedError, read, write
from app.simulation.model import Model
from app.simulation.recorder import Recorder
from app.system import folders
from app.version import __version__

log = logging.getLogger("mantle")

# Checkpoints that are kept.
KEPT = 2
# Number of differences listed in a message.
TOLD = 12


# Which one


def find(
    comm: MPI.Comm,
    wanted: str,
    folder: Path,
    case: Case,
    force: bool,
    passed: Collection[Path] = (),
) -> Checkpoint | None:
    """The checkpoint to go on from, if there is one; collective.

    Args:
        comm: Communicator.
        wanted: A file, or ``auto``: the newest in the run directory that can be read.
        folder: The run directory.
        case: The configuration.
        force: Whether that of the checkpoint may be another one.
        passed: What ``auto`` passes over.

    Raises:
        InputError: It is of another configuration, or the file cannot be read.
    """
    path = on_root(comm, lambda: _choose(wanted, folder, case, force, passed))
    return None if path is None else everywhere(comm, lambda: _readable(path))


def _choose(
    wanted: str, folder: Path, case: Case, force: bool, passed: Collection[Path]
) -> Path | None:
    """Which file."""
    if wanted != "auto":
        found = _readable(Path(wanted))
        _refuse_another(found, case, force)
        return found.path
    paths = folders.saved(folder)
    for path in (p for p in paths if p not in passed):
        try:
            found = read(path)
        except (OSError, DamagedError) as error:
            pass_over(path, error)
            continue
        _refuse_another(found, case, force)
        return path
    none = "no usable checkpoint" if paths else "no checkpoint"
    log.info("restart: %s in %s; starting from the beginning", none, folder)
    return None


def pass_over(path: Path, error: Exception) -> None:
    """Tell that ``auto`` does not take a checkpoint, and why."""
    log.warning("%s cannot be used: %s; trying the one before", path, error)


def _readable(path: Path) -> Checkpoint:
    """Read a file that was asked for.

    Raises:
        InputError: It cannot be.
    """
    try:
        return read(path)
    except OSError as error:
        why = error.strerror or str(error)
    except DamagedError as error:
        why = str(error)
    raise InputError(f"--restart {path}: cannot be used: {why}")


def _refuse_another(found: Checkpoint, case: Case, force: bool) -> None:
    """Refuse a checkpoint of another version or configuration.

    Raises:
        InputError: It is, with what differs.
    """
    if found.header["mantle"] != __version__ and not force:
        raise InputError(
            f"--restart: {found.path} was written by mantle {found.header['mantle']}, this is "
            f"{__version__}: results may differ (--force: use it all the same)"
        )
    before, now = (dict(_leaves(c)) for c in (found.header["case"], described(case)))
    absent = "nothing"
    differ = [
        f"  {key}: {now.get(key, absent)}; in the checkpoint {before.get(key, absent)}"
        for key in dict.fromkeys([*now, *before])
        if now.get(key, absent) != before.get(key, absent)
    ]
    if not differ:
        return
    more = [f"  and {len(differ) - TOLD} more"] if len(differ) > TOLD else []
    said = [*differ[:TOLD], *more]
    if force:
        log.warning("%s is of another configuration:\n%s", found.path, "\n".join(said))
        return
    message = f"--restart: {found.path} is of another configuration (--force: use it all the same)"
    raise InputError([message, *said])


def described(case: Case) -> dict[str, Any]:
    """All of a case that its states depend on."""
    data = plain(case)
    data.pop("title", None)
    data["output"] = {"probes": data.get("output", {}).get("probes", {})}
    data["geometry"].pop("path", None)  # the mesh has a digest of its own, wherever it lies
    return dict(json.loads(json.dumps(data)))


def _leaves(data: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted keys and their values."""
    if isinstance(data, dict) and data:
        for name, value in data.items():
            yield from _leaves(value, f"{key}.{name}" if key else name)
    elif isinstance(data, list) and any(isinstance(v, dict | list) for v in data):
        for k, value in enumerate(data):
            yield from _leaves(value, f"{key}.{k}")
    else:
        yield key, data


# A run


class CheckpointWriter:
    """Keeps the last state of a run where it may be taken up again, and saves it when it is due."""

    def __init__(
        self,
        case: Case,
        model: Model,
        recorder: Recorder,
        folder: Path,
        found: Checkpoint | None,
    ) -> None:
        """Begin.

        Args:
            case: The configuration.
            model: The model, at rest.
            recorder: What is recorded of it.
            folder: The run directory.
            found: The checkpoint to go on from.
        """
        self._case, self._model, self._recorder = case, model, recorder
        self._folder, self._found = folder, found
        self._comm = model.tagged.mesh.comm
        self._options = case.output.checkpoint
        self._state: State | None = None
        self._saved, self._when = 0, clock.monotonic()

    def resume(self) -> int:
        """Take up the checkpoint, if there is one; the stage it is in; collective.

        Raises:
            InputError: It is of another mesh, or of other unknowns.
            DamagedError: It is of this case, but not what a run of it saves.
        """
        if self._found is None:
            return 0
        header, state = self._found.header, self._found.state
        self._refuse_misfits(self._found)
        k = header["stage"]
        try:
            _check_numbers(state)
            self._model.resume(state["model"], k)
            self._recorder.resume(state["recorder"])
            restored = _restored(self._found, self._comm.size)
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            log.debug("%s", self._found.path, exc_info=True)
            damaged = DamagedError(f"its state does not fit ({type(error).__name__}: {error})")
            agree(self._comm, damaged)
            raise damaged from error
        self._saved = header["step"]
        self._state = {"stage": k, "time": header["time"], "state": self._now()}
        log.info("%s", restored)
        self._found = None
        return k

    def _refuse_misfits(self, found: Checkpoint) -> None:
        """Refuse a checkpoint whose rows are not those of the model; collective.

        Raises:
            InputError: They are not.
        """
        stages = len(self._model.scene.stages)
        where = f"--restart: {found.path}"
        if found.header["mesh"] != self._model.mesh_hash:
            raise InputError(
                f"{where}: checkpoint of another mesh ({found.header['mesh'][:12]}; this case has "
                f"{self._model.mesh_hash[:12]}); restart with the mesh it was written on"
            )
        if found.header["stage"] >= stages:
            raise InputError(
                f"{where}: checkpoint is in stage {found.header['stage'] + 1}; this case has "
                f"{stages} stages"
            )
        faults = list(_misfits(self._model.state(), found.state["model"], ""))
        sizes = self._comm.allreduce(np.array([own for _, _, own in faults]))
        bad = [
            name
            for (name, there, _), here in zip(faults, sizes, strict=True)
            if there is None or here != there
        ]
        bad = sorted(set().union(*self._comm.allgather(bad)))
        if bad and found.header["case"] == described(self._case):
            raise DamagedError(f"its state does not fit in {', '.join(bad[:TOLD])}")
        if bad:
            raise InputError(
                f"{where}: checkpoint of another model, with other unknowns or records in "
                f"{', '.join(bad[:TOLD])}; allowed: cases of the same interfaces, heat and cure"
            )

    def _now(self) -> State:
        return {"model": self._model.state(), "recorder": self._recorder.state()}

    def mark(self, k: int) -> None:
        """Remember the state, which is in a stage, and save it if that is due; collective."""
        state = self._now()
        now = state["recorder"]
        self._state = {"stage": k, "time": now["time"], "state": state}
        steps, minutes = self._options.steps, self._options.minutes
        due = bool(steps and now["step"] - self._saved >= steps)
        if minutes and not due:
            # By one clock: all ranks save, or none does.
            waited = clock.monotonic() - self._when
            due = bool(self._comm.bcast(waited >= 60 * minutes))
        if due:
            self.save()

    def save(self) -> Path | None:
        """Save what was remembered last, unless it is; where it is; collective."""
        kept = self._state
        if kept is None:
            return None
        recorded = kept["state"]["recorder"]
        path = self._folder / f"checkpoint-{recorded['step']}.state"
        if recorded["step"] == self._saved and on_root(self._comm, path.exists):
            return path
        header = {
            "format": FORMAT,
            "mantle": __version__,
            "case": described(self._case),
            "mesh": self._model.mesh_hash,
            "ranks": self._comm.size,
            "stage": kept["stage"],
            "stage_name": self._model.scene.stages[kept["stage"]].name,
            "step": recorded["step"],
            "time": kept["time"],
            "seconds": recorded["seconds"],
            "written": datetime.now(UTC).isoformat(timespec="seconds"),
        }
        try:
            write(self._comm, path, header, kept["state"])
        except OSError as error:
            log.warning("checkpoint %s cannot be written: %s", path, error.strerror or error)
            return None
        on_root(self._comm, lambda: _keep(self._folder, path), share=False)
        self._saved, self._when = recorded["step"], clock.monotonic()
        log.debug("     %s", path)
        return path


def _keep(folder: Path, newest: Path) -> None:
    """Leave the newest checkpoints; what is said to be newer is of another try."""
    every = folders.saved(folder)
    place = every.index(newest)
    for path in [*every[:place], *every[place + KEPT :]]:
        path.unlink(missing_ok=True)


def _misfits(here: Any, there: Any, name: str) -> Iterator[tuple[str, int | None, int]]:
    """For all of a state at rest: name, number of rows in a checkpoint if it fits, own number."""
    if isinstance(here, Rows):
        # A rank that has none may not know of how many components.
        fits = isinstance(there, Rows) and (
            not len(here.keys) or (_kind(here) == _kind(there) and there.has(here.keys))
        )
        yield name, len(there.keys) if fits else None, len(here.keys)
    elif isinstance(here, dict):
        if not isinstance(there, dict) or here.keys() - there.keys():
            yield name, None, 0
            return
        for key, value in here.items():
            yield from _misfits(value, there[key], f"{name}.{key}" if name else key)
    elif isinstance(here, list):
        # What comes with time is not there at rest.
        parts = name in ("mechanics", "thermal", "motion", "march") or name.endswith("contact")
        if not isinstance(there, list) or (len(here) != len(there) if parts else False):
            yield name, None, 0
            return
        for a, b in zip(here, there, strict=False):
            yield from _misfits(a, b, name)
    elif isinstance(here, int | float) and not isinstance(there, int | float):
        yield name, None, 0


def _kind(rows: Rows) -> tuple[Any, ...]:
    """What rows are of: type and shape."""
    return rows.values.dtype, rows.values.shape[1:]


def _check_numbers(state: State) -> None:
    """Refuse steps and rows of the table that no run has.

    Raises:
        ValueError: There are some.
    """
    model, recorded = state["model"], state["recorder"]
    ways = [m["way"]["step"] for m in model["motion"] if m["way"]]
    ways += [h["controller"]["next"] for h in model["march"] if h["controller"]]
    if not all(math.isfinite(step) and step > 0 for step in ways):
        raise ValueError("a step that goes nowhere")
    counts = [*recorded["total"].values(), *recorded["timing"].values()]
    counts += [recorded[name] for name in ("step", "frames", "written", "time", "seconds")]
    counts += [value for balance in recorded["balances"] for value in balance.values()]
    if not all(isinstance(count, int | float) for count in counts):
        raise ValueError("a count that is no number")
    values = [value for _, value in _leaves(model)]
    if any(
        isinstance(v, str)
        for value in values
        for v in (value if isinstance(value, list) else [value])
    ):
        raise ValueError("a text among numbers")
    cells = [*recorded["mechanical"].values()]
    cells += [cell for row in recorded["writer"]["rows"] for cell in row.values()]
    if not all(cell is None or isinstance(cell, int | float) for cell in cells):
        raise ValueError("a row of history.csv that is not of numbers")


def _restored(found: Checkpoint, ranks: int) -> str:
    """List of what is restored, as a line of the log."""
    header, state = found.header, found.state
    model, recorded = state["model"], state["recorder"]
    what = []
    for m in model["mechanics"]:
        x = m["solver"]["x"]
        what.append(f"displacement of {len(x['displacement']['nodes'].keys)} nodes")
        if "jump" in x:
            what.append(f"jump, friction and slip of {len(x['jump'].keys)} contact points")
        if m["problem"]["setting"]:
            what.append("stress of what sets")
    for t in model["thermal"]:
        heating = t["heating"]
        what.append(
            f"temperature of {len(heating['state']['parts'][0].keys)} nodes at "
            f"{heating['seconds']:.6g} s, with peaks and doses"
        )
        if heating["strains"]:
            what.append("cure")
    for h in model["march"]:
        if h["controller"]:
            what.append(f"next time step {h['controller']['next']:.4g} s")
    for m in model["motion"]:
        if m["way"]:
            what.append(f"next load step {m['way']['step']:.4g} of the stage")
    writer = recorded["writer"]
    what.append(f"{len(writer['rows'])} rows of history.csv")
    what += [f"{f['steps']} steps of fields" for f in writer["fields"]]
    by = "" if header["ranks"] == ranks else f" by {header['ranks']} rank(s)"
    return (
        f"restart from {found.path}, written {header['written']}{by}: step {header['step']}, "
        f"time {header['time']:.6g} in stage '{header['stage_name']}', "
        f"{header['seconds']:.1f} s of work\n     restored: {'; '.join(what)}"
    )
