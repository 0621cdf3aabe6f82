"""C code compiled on first use, in the cache of compiled forms."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import tempfile
from collections.abc import Sequence
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import Any

import cffi
from dolfinx import jit

from app.foundation.captured import captured


def compiled(
    name: str,
    declarations: str,
    source: str,
    *,
    version: str = "",
    libraries: Sequence[str] = (),
    flags: Sequence[str] = (),
) -> Any:
    """Compile C code by cffi, unless the cache has it, and load the module.

    Args:
        name: Beginning of the module's name.
        declarations: What Python calls, for `cffi.FFI.cdef`.
        source: The code.
        version: Version of what the code includes; another one compiles it again.
        libraries: Libraries to link.
        flags: Options of the compiler.

    Raises:
        cffi.VerificationError: The code does not compile.
        ImportError: The module cannot be loaded.
        OSError: The cache cannot be written.
    """
    folder = Path(jit.get_options()["cache_dir"])
    text = "\n".join([declarations, source, version, *libraries, *flags])
    name = f"mantle_{name}_{hashlib.sha256(text.encode()).hexdigest()[:12]}"
    path = folder / (name + EXTENSION_SUFFIXES[0])
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        ffi = cffi.FFI()
        ffi.cdef(declarations)
        ffi.set_source(name, source, libraries=list(libraries), extra_compile_args=list(flags))
        with tempfile.TemporaryDirectory(dir=folder) as build, captured("cffi"):
            os.replace(ffi.compile(tmpdir=build), path)
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
