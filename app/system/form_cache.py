"""The cache of compiled forms: what a killed run or damage has left there, and why compiling fails.

dolfinx trusts it: it waits for a compilation that was killed, for ten seconds and no longer for one
that goes on, and a module cut short takes the whole process down when it is loaded.
"""

from __future__ import annotations

import fcntl
import hashlib
import logging
import os
import re
import shutil
import stat
import struct
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import Any

from app import files
from app.captured import captured
from app.errors import EnvironmentProblem
from app.system.doctor import form_cache
from app.system.folders import seeded

log = logging.getLogger("mantle")

LOCK, COMPILING = "mantle.lock", "compiling.lock"
# Where the compiler puts what it needs for a moment, and stays if it is killed.
SCRATCH = "compiling"
# What is begun and not finished: of cffi (its own copy, the object), of ffcx.
UNFINISHED = re.compile(rf"\.c\.~\d+$|\.c\.failed$|{files.LEFT.pattern}")
POLL = 0.1  # s
SOURCES = ("ffcx/codegeneration/jit.py", "dolfinx/jit.py")
# Of a 64-bit ELF file: where its last table begins (offset 40), its entries' size and number (58).
HEADER, TABLE, ENTRIES = 64, 40, 58
_held: list[int] = []  # open while this process runs
_compiling: list[int] = []  # open while it compiles


def mend() -> None:
    """Remove modules that cannot be loaded; for one rank, before anything is compiled.

    Compilations that nobody is at work on any more are removed too, if no other run uses the cache.
    """
    folder = form_cache()
    with suppress(OSError):
        _own(folder)
        lock = files.lock_file(folder / LOCK)
        _held.append(lock)
        looked, now = os.stat(lock), time.time()
        alone = True
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            alone = False
        if alone:
            shutil.rmtree(folder / SCRATCH, ignore_errors=True)
        names = {entry.name: entry for entry in os.scandir(folder)}
        for name in names if alone else ():
            if UNFINISHED.search(name):
                (folder / name).unlink(missing_ok=True)
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
            # Where that was in the future the clock has been set: nothing is known.
            known = looked.st_size and looked.st_mtime <= now
            if module is None or (
                (not known or module.stat().st_mtime >= looked.st_mtime - 1.0)
                and not whole(Path(module.path))
            ):
                _remove(folder, source)
        os.pwrite(lock, b"1", 0)
        os.utime(lock, (now, now))
        fcntl.flock(lock, fcntl.LOCK_SH)


def share() -> None:
    """Have compilations that others are at work on waited for as long as they take, and no longer.

    Whoever compiles a module holds one byte of a file locked, which ends with its process. Files of
    options have no say in what is compiled.
    """
    from dolfinx import jit as of_dolfinx
    from ffcx import options
    from ffcx.codegeneration import jit

    # Those in the home and in the working folder, which may be another's.
    for module in (of_dolfinx, options):
        vars(module)["_load_options"] = lambda: ({}, {})
    if isinstance(jit.get_cached_module, partial):
        return
    jit.get_cached_module = partial(_wait, jit.get_cached_module)
    for name in ("compile_forms", "compile_expressions"):
        setattr(jit, name, partial(_let_go, getattr(jit, name)))


def _wait(
    get: Callable[..., Any], name: str, objects: list[str], folder: Path, timeout: int
) -> Any:
    """`ffcx.codegeneration.jit.get_cached_module`, when nobody compiles the module any more."""
    source = Path(folder) / f"{name}.c"
    _own(source.parent)
    if not usable(source.parent, name):
        with suppress(OSError):  # a file system without locks, or a folder that cannot be written
            file = files.lock_file(source.parent / COMPILING)
            _compiling.append(file)
            at, logged = int(hashlib.sha256(name.encode()).hexdigest()[:12], 16), False
            while not _locked(file, at):
                if not logged:
                    log.info("another run compiles the same form: waiting for it")
                logged = True
                time.sleep(POLL)
            # What was begun and is not ready now was left by one that was killed.
            if not usable(source.parent, name):
                _remove(source.parent, source.name)
                _seed(source.parent, name)
    return get(name, objects, folder, timeout)


def _own(folder: Path) -> None:
    """Make the folder of compiled forms, of this user alone.

    Raises:
        EnvironmentProblem: Others could change what it holds.
    """
    files.make_own(folder)
    if why := files.fault_of_folder(folder):
        raise EnvironmentProblem(
            f"compiled forms in {folder} are not used: {why}; remove it, or set XDG_CACHE_HOME to "
            "a folder of your own"
        )


def usable(folder: Path, name: str) -> bool:
    """Whether a module is compiled, and nobody but its user and root can have written it."""
    try:
        module = os.lstat(folder / (name + EXTENSION_SUFFIXES[0]))
    except OSError:
        return False
    why = files.fault_of(module) or ("" if stat.S_ISREG(module.st_mode) else "is no file")
    if why:
        log.warning("%s/%s is not used: it %s", folder, name, why)
    return not why and (folder / f"{name}.c.cached").exists()


def _seed(folder: Path, name: str) -> None:
    """Take a module from those of an image, if it is there."""
    suffixes = (EXTENSION_SUFFIXES[0], ".c", ".c.cached")  # the mark that it is whole comes last
    contents = [seeded("fenics", name + suffix) for suffix in suffixes]
    for suffix, content in zip(suffixes, contents, strict=True):
        if None not in contents:
            files.write_bytes(folder / (name + suffix), content or b"", 0o700)


def _locked(file: int, at: int) -> bool:
    """Lock a byte of a file, unless somebody has."""
    try:
        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, at)
    except (BlockingIOError, PermissionError):
        return False
    return True


def _let_go(compile: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
    """Compile, and let go of what `_wait` has locked for it."""
    before, scratch = os.environ.get("TMPDIR"), form_cache() / SCRATCH
    umask = os.umask(0o077)  # what others could have written is not used
    with suppress(OSError):
        scratch.mkdir(exist_ok=True)
        os.environ["TMPDIR"] = str(scratch)
    try:
        with captured("compiler") as written:
            try:
                return compile(*arguments, **options)
            except Exception as error:
                error.add_note("\n".join(written()))
                raise
    finally:
        os.umask(umask)
        os.environ.pop("TMPDIR", None)
        os.environ |= {} if before is None else {"TMPDIR": before}
        while _compiling:
            os.close(_compiling.pop())


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
    """Error that explains a failed compilation or load of a form; None for any other."""
    frames = traceback.extract_tb(error.__traceback__)
    if not any(frame.filename.endswith(SOURCES) for frame in frames):
        return None
    folder = form_cache()
    reason = next((line for line in str(error).splitlines() if line.strip()), type(error).__name__)
    said = "".join(f"  {n}\n" for n in getattr(error, "__notes__", ()) if n)
    free = ""
    with suppress(OSError):
        free = f", with {shutil.disk_usage(folder).free / 1e6:.0f} MB free"
    return EnvironmentProblem(
        f"a form cannot be compiled: {reason}\n{said}"
        f"mantle doctor tells whether there is a C compiler; compiled forms are kept in {folder}"
        f"{free} (XDG_CACHE_HOME names another place; what is there can be deleted)"
    )
