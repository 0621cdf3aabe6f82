"""Cache of compiled forms: removal of incomplete modules, waiting, reasons why compiling fails.

ffcx waits ten seconds for a form that another process compiles, even if that process was killed. It
loads truncated modules, which crashes the process. `patch_ffcx` replaces functions of ffcx, so that
one process compiles at a time, and incomplete modules are compiled again.
"""

from __future__ import annotations

import fcntl
import logging
import os
import shutil
import traceback
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import TypeVar

from app.foundation import files
from app.foundation.captured import captured
from app.foundation.errors import EnvironmentProblem
from app.system.folders import form_cache

T = TypeVar("T")

log = logging.getLogger("mantle")

LOCK = "compiling.lock"
# Files that compile, by which an error in them is recognized.
SOURCES = ("ffcx/codegeneration/jit.py", "dolfinx/jit.py", "app/numerics/compiled.py")
# File descriptors of the lock file, open while this process compiles.
_locks: list[int] = []
# Name of the first module compiled here, once the log says so.
_announced: list[str] = []


def patch_ffcx() -> None:
    """Let ffcx compile a form in one process at a time, and compile incomplete modules again.

    It also ignores files of options in the home and in the working folder, which may belong to
    somebody else. A second call changes nothing.
    """
    from dolfinx import jit as of_dolfinx
    from ffcx import options
    from ffcx.codegeneration import jit

    for module in (of_dolfinx, options):
        vars(module)["_load_options"] = lambda: ({}, {})
    if isinstance(jit.get_cached_module, partial):
        return
    with suppress(OSError, RuntimeError):
        files.make_private(form_cache())
    jit.get_cached_module = partial(_get_or_lock, jit.get_cached_module)
    jit._compile_objects = partial(_compile_and_note_size, jit._compile_objects)
    for name in ("compile_forms", "compile_expressions"):
        setattr(jit, name, partial(_compile_then_unlock, getattr(jit, name)))


def usable(folder: Path, name: str) -> bool:
    """Return True if a module is compiled and has the size noted by its compiler."""
    module, source = folder / (name + EXTENSION_SUFFIXES[0]), folder / f"{name}.c"
    try:
        size = (folder / f"{name}.c.cached").read_text(errors="replace")
        is_whole = not size.isdigit() or int(size) == module.stat().st_size
        return is_whole and source.exists() and module.exists()
    except OSError:
        return False


def load_module(folder: Path, name: str) -> ModuleType:
    """Load a compiled module.

    Raises:
        ImportError: It is missing or damaged.
    """
    spec = spec_from_file_location(name, folder / (name + EXTENSION_SUFFIXES[0]))
    if spec is None or spec.loader is None:
        raise ImportError(f"{name}: no module can be loaded from its file")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _get_or_lock(
    get: Callable[..., T], name: str, objects: list[str], folder: Path, timeout: int
) -> T:
    """Get a module from the cache, or lock its name, so that this process compiles it.

    It replaces `ffcx.codegeneration.jit.get_cached_module`, which is ``get``. A process that
    compiles a module locks one byte of a file. The lock ends with the process. A module that is
    incomplete although no process compiles it is removed.
    """
    folder = Path(folder)
    if usable(folder, name):
        try:
            return get(name, objects, folder, timeout)
        except ImportError:  # damaged
            _remove(folder, name)
    with suppress(OSError):  # a file system without locks, or a folder that cannot be written
        _locks.append(files.lock_file(folder / LOCK))
        fcntl.lockf(_locks[-1], fcntl.LOCK_EX, 1, int(name[-12:], 16))
        # An incomplete module without a lock was left by a killed process.
        if not usable(folder, name):
            _remove(folder, name)
    return get(name, objects, folder, timeout)


def _compile_and_note_size(
    compile_objects: Callable[..., T], *arguments: object, **options: object
) -> T:
    """Compile a module, and note its size in the file by which ffcx marks it as complete.

    It replaces `ffcx.codegeneration.jit._compile_objects`. An error has the compiler's output.
    """
    name, folder = str(arguments[3]), Path(str(arguments[5]))
    if not _announced:
        log.info("     compiling forms; later runs reuse them")
        _announced.append(name)
    with captured("compiler") as compiler_output:
        try:
            code = compile_objects(*arguments, **options)
        except Exception as error:
            error.add_note("\n".join(compiler_output()))
            raise
    size = (folder / (name + EXTENSION_SUFFIXES[0])).stat().st_size
    (folder / f"{name}.c.cached").write_text(str(size))
    return code


def _compile_then_unlock(
    compile_forms: Callable[..., T], *arguments: object, **options: object
) -> T:
    """Compile forms or expressions, and release the locks in the end."""
    try:
        return compile_forms(*arguments, **options)
    finally:
        while _locks:
            os.close(_locks.pop())


def _remove(folder: Path, name: str) -> None:
    for suffix in (".c.cached", EXTENSION_SUFFIXES[0], ".o", ".c"):
        with suppress(OSError):
            (folder / (name + suffix)).unlink(missing_ok=True)


def error_of_compilation(error: BaseException) -> EnvironmentProblem | None:
    """Error that explains a failed compilation or load of a form; None for any other."""
    frames = traceback.extract_tb(error.__traceback__)
    if not any(frame.filename.endswith(SOURCES) for frame in frames):
        return None
    folder = form_cache()
    reason = str(error).strip().partition("\n")[0] or type(error).__name__
    details = "".join(f"  {n}\n" for n in getattr(error, "__notes__", ()) if n)
    free_space = ""
    with suppress(OSError):
        free_space = f", with {shutil.disk_usage(folder).free / 1e6:.0f} MB free"
    return EnvironmentProblem(
        f"a form cannot be compiled: {reason}\n{details}"
        f"mantle doctor checks the C compiler; compiled forms are kept in {folder}"
        f"{free_space} (XDG_CACHE_HOME sets another folder; it can be deleted)"
    )
