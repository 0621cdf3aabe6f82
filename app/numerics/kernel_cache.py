"""Compiled laws found again by name: without UFL, which takes longer to build one than to run it.

dolfinx finds compiled code by a signature of the whole expression, so that the expression has to be
built and walked through at every start: seconds for the contact law at corners. A law whose text is
all in a few files is known by those files instead; a note beside the meshes says where its code is.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

from mpi4py import MPI

import dolfinx
import ffcx
import ufl
from dolfinx import jit

from app import files
from app.system import folders, form_cache

# Names that ffcx gives.
MODULE, SYMBOL = re.compile(r"libffcx_expressions_[0-9a-f]+"), re.compile(r"expression_[0-9a-f]+")


@dataclass(frozen=True)
class Kernel:
    """Code of several expressions in one.

    Attributes:
        module: Name of the compiled module.
        symbol: Name of the expression in it.
        inputs: Names of the coefficients, in the order of the code.
        shapes: Of the expressions.
    """

    module: str
    symbol: str
    inputs: tuple[str, ...]
    shapes: tuple[tuple[int, ...], ...]


def note_of(law: str, sources: Sequence[ModuleType]) -> Path | None:
    """Where the note of a law is, or would be; None without a cache.

    Args:
        law: What tells it from others made of the same sources.
        sources: All modules that say what it is.
    """
    folder = folders.cache("laws")
    if folder is None:
        return None
    digest = hashlib.sha256(law.encode())
    for module in sources:
        digest.update(Path(str(module.__file__)).read_bytes())
    versions = [m.__version__ for m in (dolfinx, ffcx, ufl)]
    options = {**jit.get_options(), **ffcx.get_options(), "cache_dir": None}
    digest.update(repr([versions, options]).encode())
    return folder / f"law-{digest.hexdigest()[:24]}.json"


def find(comm: MPI.Comm, note: Path | None) -> tuple[Kernel, Any, ModuleType] | None:
    """The code that a note tells of, its expression and module; collective.

    Returns:
        None, on all ranks, where it is missing on one.
    """
    found = None
    try:
        if note is not None:
            found = _load(json.loads(note.read_text()))
    except (OSError, ValueError, TypeError, KeyError, AttributeError, ImportError, RecursionError):
        found = None
    return found if comm.allreduce(found is not None, MPI.LAND) else None


def _load(noted: dict[str, Any]) -> tuple[Kernel, Any, ModuleType] | None:
    shapes = tuple(tuple(int(k) for k in shape) for shape in noted["shapes"])
    kernel = Kernel(noted["module"], noted["symbol"], tuple(noted["inputs"]), shapes)
    if not (MODULE.fullmatch(kernel.module) and SYMBOL.fullmatch(kernel.symbol)):
        return None
    folder = Path(jit.get_options()["cache_dir"])
    path = folder / (kernel.module + EXTENSION_SUFFIXES[0])
    # The mark that its compiler has finished, without which ffcx does not trust it either.
    if not form_cache.usable(folder, kernel.module):
        return None
    spec = spec_from_file_location(kernel.module, path)
    if spec is None or spec.loader is None:
        return None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return kernel, getattr(module.lib, kernel.symbol), module


def keep(comm: MPI.Comm, note: Path | None, kernel: Kernel) -> None:
    """Write a note; where that is not possible there is none."""
    if note is None or comm.rank != 0:
        return
    try:
        files.clear(note.parent, note.name)
        folders.write_json(note, asdict(kernel))
    except OSError:
        pass
