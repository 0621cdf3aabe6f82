"""Cache of compiled forms: removal of incomplete modules, waiting, reasons why compiling fails.

ffcx waits ten seconds for a form that another process compiles, whether that was killed or needs
longer, and loads a module that was cut short, which takes the whole process down.
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
from pathlib import Path
from typing import TypeVar

from app.foundation import files
from app.foundation.captured import captured
from app.foundation.errors import EnvironmentProblem
from app.system.folders import form_cache

T = TypeVar("T")

log = logging.getLogger("mantle")

LOCK = "compiling.lock"
SOURCES = ("ffcx/codegeneration/jit.py", "dolfinx/jit.py")
_compiling: list[int] = []  # the lock, open while this process compiles
_announced: list[str] = []  # the first module compiled here, once the log says so


def guard() -> None:
    """Compile forms in one process at a time, and compile broken ones again.

    Files of options in the home and in the working folder, which may be another's, are ignored.
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
    jit.get_cached_module = partial(_find, jit.get_cached_module)
    jit._compile_objects = partial(_mark, jit._compile_objects)
    for name in ("compile_forms", "compile_expressions"):
        setattr(jit, name, partial(_compile, getattr(jit, name)))


def usable(folder: Path, name: str) -> bool:
    """Return True if a module is compiled and has the size noted by its compiler."""
    module, source = folder / (name + EXTENSION_SUFFIXES[0]), folder / f"{name}.c"
    try:
        size = (folder / f"{name}.c.cached").read_text(errors="replace")
        is_whole = not size.isdigit() or int(size) == module.stat().st_size
        return is_whole and source.exists() and module.exists()
    except OSError:
        return False


def _find(get: Callable[..., T], name: str, objects: list[str], folder: Path, timeout: int) -> T:
    """`ffcx.codegeneration.jit.get_cached_module`, once no process compiles the module any more.

    A compiling process locks one byte of a file, which ends with the process.
    """
    folder = Path(folder)
    if usable(folder, name):
        try:
            return get(name, objects, folder, timeout)
        except ImportError:  # damaged
            _remove(folder, name)
    with suppress(OSError):  # a file system without locks, or a folder that cannot be written
        _compiling.append(files.lock_file(folder / LOCK))
        fcntl.lockf(_compiling[-1], fcntl.LOCK_EX, 1, int(name[-12:], 16))
        # An incomplete module without a lock was left by a killed process.
        if not usable(folder, name):
            _remove(folder, name)
    return get(name, objects, folder, timeout)


def _mark(compile: Callable[..., T], *arguments: object, **options: object) -> T:
    """Compile a module, and note its size in the mark of completion."""
    name, folder = str(arguments[3]), Path(str(arguments[5]))
    if not _announced:
        log.info("     compiling forms; later runs reuse them")
        _announced.append(name)
    with captured("compiler") as compiler_output:
        try:
            code = compile(*arguments, **options)
        except Exception as error:
            error.add_note("\n".join(compiler_output()))
            raise
    size = (folder / (name + EXTENSION_SUFFIXES[0])).stat().st_size
    (folder / f"{name}.c.cached").write_text(str(size))
    return code


def _compile(compile: Callable[..., T], *arguments: object, **options: object) -> T:
    """Compile forms, and release the lock in the end."""
    try:
        return compile(*arguments, **options)
    finally:
        while _compiling:
            os.close(_compiling.pop())


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
