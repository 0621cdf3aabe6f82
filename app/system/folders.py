"""Where things go: the cache, the run folder, and files that are whole or not there."""

from __future__ import annotations

import csv
import fcntl
import io
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from mantle.errors import InputError

# What stands in the folder of a variation that did not converge: why.
FAILED = "FAILED"


def cache(name: str) -> Path | None:
    """The folder for cached data of a kind, made if necessary.

    Args:
        name: The kind, for example ``meshes``.

    Returns:
        ``$XDG_CACHE_HOME/mantle/<name>`` (default ``~/.cache``), or None if it cannot be written.
    """
    base = os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()
    folder = Path(base) / "mantle" / name
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):
        return None
    return folder if os.access(folder, os.W_OK | os.X_OK) else None


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


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file under another name, flush it to disk and rename it; all of it or nothing."""
    temporary = path.with_name(path.name + ".partial")
    try:
        with temporary.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise


def csv_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows as CSV below the names of all that any of them has."""
    text = io.StringIO()
    names = dict.fromkeys(name for row in rows for name in row)
    table = csv.DictWriter(text, list(names), lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    return text.getvalue()


def write_json(path: Path, content: Any) -> None:
    """Write a value as JSON, in the same way."""
    write_text(path, json.dumps(content, indent=1, ensure_ascii=False) + "\n")
