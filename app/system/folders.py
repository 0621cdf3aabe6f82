"""Cache and run folders, and files written whole or not at all."""

from __future__ import annotations

import csv
import fcntl
import io
import json
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from app.foundation import files
from app.foundation.errors import EnvironmentProblem, InputError, StoppedError

# File in the folder of a variation that did not converge, with the reason.
FAILED_FILE = "FAILED"
# Initial caches of users of an image.
SEED = Path("/var/cache/mantle")

CASE_PICTURE = "case.png"
# Files written at the end, and all of a run directory but the case.
ENDS = ("DONE", "summary.json", "provenance.json", "final.vtkhdf", CASE_PICTURE, "report.html")
# Beginning of the names of the files of paths.
PATH_FILE = "path_"
RESULTS = (*ENDS, "history.csv", "fields.vtkhdf")


def cache_home() -> Path:
    """Parent folder of all caches."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())


def form_cache() -> Path:
    """The folder in which dolfinx keeps compiled forms (as in ``dolfinx.jit``)."""
    return cache_home() / "fenics"


def settle_cache() -> str:
    """Put the caches of this process and its children into folders of this user alone.

    A new cache starts from the compiled forms of the image, if there are any.

    Returns:
        A message, if ``XDG_CACHE_HOME`` cannot be written; caches are below ``/tmp`` then, as
        without a home.

    Raises:
        EnvironmentProblem: No such folder can be made.
    """
    try:
        for name in ("fenics", "mantle/laws"):
            seed, folder = SEED / name, cache_home() / name
            if seed.is_dir() and not folder.exists():
                _copy(seed, folder)
        files.make_private(form_cache())
        return ""
    except RuntimeError:  # no home
        reason = ""
    except OSError as error:
        reason = f"{error.filename}: {error.strerror}" if "XDG_CACHE_HOME" in os.environ else ""
    private = Path(f"/tmp/mantle-{os.geteuid()}")
    try:
        files.make_private(private)
    except OSError as error:
        raise EnvironmentProblem(
            f"no folder for caches: {private}: {error.strerror}; set XDG_CACHE_HOME to one"
        ) from error
    os.environ["XDG_CACHE_HOME"] = str(private)
    os.environ.setdefault("MPLCONFIGDIR", str(private / "matplotlib"))
    return f"caches are in {private} now: {reason}" if reason else ""


def _copy(seed: Path, folder: Path) -> None:
    with suppress(OSError):
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent) as scratch:
            shutil.copytree(seed, Path(scratch) / "copy").rename(folder)


def cache(name: str) -> Path | None:
    """The folder for cached data of a kind, made if necessary; of this user alone.

    It is ``$XDG_CACHE_HOME/mantle/<name>`` (default ``~/.cache``); None if it cannot be written.
    """
    with suppress(OSError, RuntimeError):  # RuntimeError: no home
        folder = cache_home() / "mantle" / name
        files.make_private(folder)
        return folder
    return None


def prepare_run(folder: Path, force: bool) -> None:
    """Make the folder of a run; refuse one that is not empty.

    Nothing is written into it: under MPI every rank comes here before the first collective call,
    and all have to see the same.

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
        # Of variations some may be finished, and one was interrupted.
        left_over = saved(folder) or [*folder.glob("*/checkpoint-*.state"), *folder.glob("*/DONE")]
        restart_text = "--restart auto to continue from its checkpoint, " if left_over else ""
        raise InputError(
            f"-o {folder}: is not empty; choose another folder, {restart_text}or --force to "
            "replace the results"
        )
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"-o {folder}: is not writable")
    raise_if_taken(folder)


def raise_if_taken(folder: Path) -> None:
    """Refuse folders where a run directory has files.

    Raises:
        InputError: There are some; names each.
    """
    taken_names = [folder / name for name in ("case.yaml", *RESULTS) if (folder / name).is_dir()]
    if taken_names:
        message = "is a folder, but a file of results has this name; move it, or choose another one"
        raise InputError([f"{path}: {message}" for path in taken_names])


@contextmanager
def claim(folder: Path) -> Iterator[None]:
    """Lock a folder of results for the block; the end of this process frees it too.

    Raises:
        InputError: Another run has locked it.
    """
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise InputError(f"-o {folder}: cannot be read: {error.strerror}") from error
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            message = "another run writes into it; wait until it ends, or choose another folder"
            raise InputError(f"-o {folder}: {message}") from None
        except OSError:
            pass  # a file system without locks
        yield
    finally:
        os.close(descriptor)


def saved(folder: Path) -> list[Path]:
    """The checkpoints in a run directory, the newest first."""
    states = [p for p in folder.glob("checkpoint-*.state") if p.stem.partition("-")[2].isdigit()]
    return sorted(states, key=lambda p: int(p.stem.partition("-")[2]), reverse=True)


def path_file(name: str) -> str:
    """Name of the file of a path in a run directory."""
    return f"{PATH_FILE}{name}.csv"


def path_files(folder: Path) -> dict[str, Path]:
    """Files of paths in a run directory, by the names of the paths."""
    files = sorted(folder.glob(path_file("*")))
    return {file.stem.removeprefix(PATH_FILE): file for file in files}


def remove(paths: Iterable[Path]) -> None:
    """Remove files, if they are there."""
    for path in paths:
        path.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a file under another name, flush it to disk and rename it; all of it or nothing."""
    files.write_bytes(path, text.encode())


@contextmanager
def writing(path: Path | str) -> Iterator[None]:
    """Turn a failed write of a file or into a folder into an error.

    Raises:
        StoppedError: The disk is full or read-only, or a permission is missing.
    """
    try:
        yield
    except OSError as error:
        file = files.LEFT.sub("", os.fsdecode(error.filename or path))
        raise StoppedError(f"cannot write {file}: {error.strerror or error}") from error


@contextmanager
def reading(path: Path | str) -> Iterator[None]:
    """Turn a failed reading of results into an error.

    Raises:
        InputError: They are missing, damaged or of another version.
    """
    try:
        yield
    except (OSError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path}: cannot be read: {error!r}") from error


def csv_text(rows: Sequence[Mapping[str, object]]) -> str:
    """Rows as CSV, with a column for every key of any row."""
    buffer = io.StringIO()
    column_names = list(dict.fromkeys(name for row in rows for name in row))
    table = csv.DictWriter(buffer, column_names, lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    return buffer.getvalue()


def write_json(path: Path, content: object) -> None:
    """Write a value as JSON, whole or not at all."""
    write_text(path, json.dumps(content, indent=1, ensure_ascii=False) + "\n")


def read_json(path: Path) -> Any:
    """The value in a JSON file."""
    return json.loads(path.read_text(encoding="utf-8"))
