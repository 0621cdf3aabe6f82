"""Where things go: the cache, the run folder, and files that are whole or not there."""

from __future__ import annotations

import csv
import fcntl
import hashlib
import io
import json
import logging
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from app import files
from app.errors import EnvironmentProblem, InputError
from app.files import write_bytes as write_bytes

log = logging.getLogger("mantle")

# How texts begin that spreadsheets take for formulas, if they are no numbers.
FORMULA = re.compile(r"[=@+\-\t\r](?!\d*\.?\d*(e[+-]?\d+)?$)", re.IGNORECASE)
# What stands in the folder of a variation that did not converge: why.
FAILED = "FAILED"
# Where an image, or a run that is isolated, has what caches begin with.
SEED = Path(os.environ.get("MANTLE_SEED") or "/var/cache/mantle")


def cache_home() -> Path:
    """The folder below which caches are."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())


def settle_cache() -> str:
    """Have this process and those it starts keep caches where nobody else can write.

    Returns:
        A message, if somebody else can, or nobody, where ``XDG_CACHE_HOME`` has them; then they
        are in a folder of this user's below ``/tmp``. They are there, too, without a home.

    Raises:
        EnvironmentProblem: There is no such folder.
    """
    try:
        places = [cache_home() / name for name in ("fenics", "mantle")]
    except RuntimeError:  # no home
        places = []
    found = [why for why in map(files.fault_of_folder, places) if why]
    cannot = files.make_own(places[0]) if places and not found else ""
    if places and not found and not cannot:
        return ""
    why = next(iter(found), cannot if "XDG_CACHE_HOME" in os.environ else "")
    own = Path(f"/tmp/mantle-{os.geteuid()}")
    if fault := files.make_own(own):
        raise EnvironmentProblem(f"no folder for caches: {fault}; set XDG_CACHE_HOME to one")
    os.environ["XDG_CACHE_HOME"] = str(own)
    os.environ.setdefault("MPLCONFIGDIR", str(own / "matplotlib"))
    return f"caches are in {own} now: {why}" if why else ""


def cache(name: str) -> Path | None:
    """The folder for cached data of a kind, made if necessary; of this user alone.

    Args:
        name: The kind, for example ``meshes``.

    Returns:
        ``$XDG_CACHE_HOME/mantle/<name>`` (default ``~/.cache``), or None if it cannot be written
        or others can write it.
    """
    try:
        folder = cache_home() / "mantle" / name
    except RuntimeError:  # no home
        return None
    if files.make_own(folder):
        if why := files.fault_of_folder(folder):
            _warn(f"{folder} is not used: {why}")
        return None
    return folder


@lru_cache
def _warn(message: str) -> None:
    """Warn of something, once."""
    log.warning("%s", message)


def seeded(kind: str, name: str) -> bytes | None:
    """A file that an image brings along for the caches of its users; None if there is none."""
    path = SEED / kind / name
    if not path.exists() or files.fault_of_folder(path.parent):
        return None
    try:
        return files.read_own(path)
    except OSError:
        return None


def prepare_run(folder: Path, force: bool) -> None:
    """Make the folder of a run, and refuse one that holds something already.

    Nothing is written into it: under MPI every rank comes here before the first collective call,
    and all have to see the same.

    Args:
        folder: The folder.
        force: Whether it may hold something.

    Raises:
        InputError: It is a file, not empty or not writable.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        holds_something = any(folder.iterdir())
    except FileExistsError:
        raise InputError(f"-o {folder}: is a file; expected a folder") from None
    except NotADirectoryError:
        raise InputError(f"-o {folder}: a folder above it is a file") from None
    except OSError as error:
        raise InputError(f"-o {folder}: cannot be made or read: {error.strerror}") from error
    if holds_something and not force:
        raise InputError(
            f"-o {folder}: is not empty; choose another folder, or --force to replace the results"
        )
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"-o {folder}: is not writable")


def claim(folder: Path) -> int:
    """Keep other runs out of a folder, until what is returned is closed or this process ends.

    Nothing is written for it.

    Args:
        folder: The folder of a run.

    Returns:
        A file descriptor.

    Raises:
        InputError: Another run has it.
    """
    try:
        held = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise InputError(f"-o {folder}: cannot be read: {error.strerror}") from error
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(held)
        text = "another run is writing into it; wait for its end, or choose another folder"
        raise InputError(f"-o {folder}: {text}") from None
    except OSError:
        pass  # a file system without locks
    return held


def saved(folder: Path) -> list[Path]:
    """The checkpoints in a run directory, the newest first."""
    found = {p: p.stem.removeprefix("checkpoint-") for p in folder.glob("checkpoint-*.state")}
    numbers = {p: int(n) for p, n in found.items() if n.isdigit()}
    return sorted(numbers, key=lambda p: numbers[p], reverse=True)


def remove(files: Iterable[Path]) -> None:
    """Remove files, if they are there."""
    for path in files:
        path.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a file under another name, flush it to disk and rename it; all of it or nothing."""
    write_bytes(path, text.encode())


def csv_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows as CSV below the names of all that any of them has.

    Texts that a spreadsheet would run as a formula have an apostrophe in front.
    """
    text = io.StringIO()
    names = dict.fromkeys(name for row in rows for name in row)
    table = csv.writer(text, lineterminator="\n")
    table.writerow(map(_cell, names))
    table.writerows([_cell(row.get(name, "")) for name in names] for row in rows)
    return text.getvalue()


def _cell(value: Any) -> Any:
    """A value, not as a formula."""
    return f"'{value}" if isinstance(value, str) and FORMULA.match(value) else value


def write_json(path: Path, content: Any) -> None:
    """Write a value as JSON, in the same way."""
    write_text(path, json.dumps(content, indent=1, ensure_ascii=False) + "\n")


def write_sealed(path: Path, content: Any) -> None:
    """Write a value as JSON into a cache, with a digest of it and of the name of the file."""
    text = json.dumps(content)
    sealed = {"content": text, "sha256": _seal(path, text)}
    write_bytes(path, json.dumps(sealed).encode(), 0o600)


def unsealed(path: Path, content: bytes) -> Any:
    """The value in a file of a cache.

    Raises:
        ValueError: It is not what was written under this name.
    """
    try:
        sealed = json.loads(content)
        text = sealed["content"]
        if sealed["sha256"] == _seal(path, text):
            return json.loads(text)
    except (AttributeError, KeyError, RecursionError, TypeError) as error:
        raise ValueError(f"{path} is damaged") from error
    raise ValueError(f"{path} is damaged")


def _seal(path: Path, text: str) -> str:
    return hashlib.sha256(f"{path.name}\0{text}".encode()).hexdigest()
