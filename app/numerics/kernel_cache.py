"""Cache of compiled laws by name, without UFL, which takes longer to build one than to run it.

dolfinx finds compiled code by a signature of the whole expression, which has to be built and
traversed at every start: seconds for the contact law at corners. A law defined in a few files is
identified by their text instead; a note beside the meshes names its compiled code.
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
    """Compiled code of several expressions.

    Attributes:
        module: Name of the compiled module.
        symbol: Name of the expression in it.
        inputs: Names of the coefficients, in the order of the code.
        shapes: Shapes of the expressions.
    """

    module: str
    symbol: str
    inputs: tuple[str, ...]
    shapes: tuple[tuple[int, ...], ...]


def note_of(law: str, sources: Sequence[ModuleType]) -> Path | None:
    """Path of the note of a law; None without a cache.

    Args:
        law: Key that tells it from others of the same sources.
        sources: All modules that define it.
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
    """Noted code of a law, its expression and module; None if missing on any rank; collective."""
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
    # ffcx writes this mark when its compiler has finished, and trusts no module without it.
    if not form_cache.usable(folder, kernel.module):
        return None
    spec = spec_from_file_location(kernel.module, path)
    if spec is None or spec.loader is None:
        return None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return kernel, getattr(module.lib, kernel.symbol), module


def keep(comm: MPI.Comm, note: Path | None, kernel: Kernel) -> None:
    """Write a note; a failure to write is ignored."""
    if note is None or comm.rank != 0:
        return
    try:
        files.clear(note.parent, note.name)
        folders.write_json(note, asdict(kernel))
    except OSError:
        pass
