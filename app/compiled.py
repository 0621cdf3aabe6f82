"""The cache of compiled forms: what a killed run or damage has left there, and why compiling fails.

dolfinx trusts it: it waits for a compilation that was killed, and a module cut short takes the
whole process down when it is loaded.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import struct
import time
import traceback
from contextlib import suppress
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

from app.doctor import form_cache
from app.errors import EnvironmentProblem

LOCK = "mantle.lock"
SOURCES = ("ffcx/codegeneration/jit.py", "dolfinx/jit.py")
# Of a 64-bit ELF file: where its last table begins (offset 40), its entries' size and number (58).
HEADER, TABLE, ENTRIES = 64, 40, 58
_held: list[int] = []  # open while this process runs


def mend() -> None:
    """Remove modules that cannot be loaded; for one rank, before anything is compiled.

    Compilations that nobody is at work on any more are removed too, if no other run uses the cache.
    """
    folder = form_cache()
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
        _held.append(lock)
        with suppress(OSError):
            os.chmod(lock, 0o666)  # an image's cache is used by whoever runs it
        looked, now = os.stat(lock), time.time()
        alone = True
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            alone = False
        names = {entry.name: entry for entry in os.scandir(folder)}
        sources = [n for n in names if n.endswith(".c") or n.endswith(".c.cached")]
        for source in sorted({name.removesuffix(".cached") for name in sources}):
            if source not in names:
                # Of two that compiled the same: whoever compiles it next must not find the mark.
                (folder / f"{source}.cached").unlink(missing_ok=True)
                continue
            if f"{source}.cached" not in names:
                if alone:
                    _remove(folder, source)
                continue
            module = names.get(source.removesuffix(".c") + EXTENSION_SUFFIXES[0])
            # What was whole when it was looked at last, and has not been written to, still is.
            if module is None or (
                (looked.st_size == 0 or module.stat().st_mtime >= looked.st_mtime - 1.0)
                and not whole(Path(module.path))
            ):
                _remove(folder, source)
        os.pwrite(lock, b"1", 0)
        os.utime(lock, (now, now))
        fcntl.flock(lock, fcntl.LOCK_SH)


def whole(path: Path) -> bool:
    """Whether a module has all its bytes: the header of an ELF file tells where its last are."""
    with path.open("rb") as file:
        head = file.read(HEADER)
    if len(head) < HEADER or head[:5] != b"\x7fELF\x02":
        return False
    (begin,) = struct.unpack_from("<Q", head, TABLE)
    size, number = struct.unpack_from("<HH", head, ENTRIES)
    return bool(begin + size * number <= path.stat().st_size)


def _remove(folder: Path, source: str) -> None:
    """Remove a module and all that belongs to it."""
    for suffix in (".c.cached", EXTENSION_SUFFIXES[0], ".o", ".c"):
        with suppress(OSError):
            (folder / (source.removesuffix(".c") + suffix)).unlink(missing_ok=True)


def explain(error: BaseException) -> EnvironmentProblem | None:
    """What to say of an error met while a form was compiled or loaded; None for any other."""
    frames = traceback.extract_tb(error.__traceback__)
    if not any(frame.filename.endswith(SOURCES) for frame in frames):
        return None
    folder = form_cache()
    reason = next((line for line in str(error).splitlines() if line.strip()), type(error).__name__)
    free = ""
    with suppress(OSError):
        free = f", with {shutil.disk_usage(folder).free / 1e6:.0f} MB free"
    return EnvironmentProblem(
        f"a form cannot be compiled: {reason}\n"
        f"mantle doctor tells whether there is a C compiler; compiled forms are kept in {folder}"
        f"{free} (XDG_CACHE_HOME names another place; what is there can be deleted)"
    )
