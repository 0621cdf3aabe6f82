"""C code compiled on first use, in the cache of compiled forms."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import cffi
from dolfinx import jit

from app.foundation.captured import captured
from app.system import form_cache


def compiled(
    name: str,
    declarations: str,
    source: str,
    *,
    version: str = "",
    libraries: Sequence[str] = (),
    flags: Sequence[str] = (),
) -> Any:
    """Load a module of C code; compile it first unless the cache has it.

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
    text = "\n".join([declarations, source, version, *libraries, *flags])
    name = f"mantle_{name}_{hashlib.sha256(text.encode()).hexdigest()[:12]}"
    folder = Path(jit.get_options()["cache_dir"])
    if form_cache.usable(folder, name):
        with suppress(ImportError):  # a damaged module is compiled again
            return form_cache.load_module(folder, name)
    folder.mkdir(parents=True, exist_ok=True)
    ffi = cffi.FFI()
    ffi.cdef(declarations)
    ffi.set_source(name, source, libraries=list(libraries), extra_compile_args=list(flags))
    with tempfile.TemporaryDirectory(dir=folder) as build:
        with captured("compiler") as compiler_output:
            try:
                module = Path(ffi.compile(tmpdir=build))
            except cffi.VerificationError as error:
                error.add_note("\n".join(compiler_output()))
                raise
        # Other processes may compile the same: files come whole, the mark of completeness last.
        mark = module.with_name(f"{name}.c.cached")
        mark.write_text(str(module.stat().st_size))
        for path in (module.with_name(f"{name}.c"), module, mark):
            os.replace(path, folder / path.name)
    return form_cache.load_module(folder, name)
