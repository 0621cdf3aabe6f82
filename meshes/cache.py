"""Cache of meshes and positions, by the content of their input."""

from __future__ import annotations

import fcntl
import hashlib
import io
import json
import logging
import re
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from app.foundation import files
from meshes.data import MeshData
from meshes.geometry import is_file

if TYPE_CHECKING:
    from app.case.shapes import MeshOptions, Shape

log = logging.getLogger("mantle")

MESHER_VERSION = 46  # raise it whenever the same input gives another mesh or other notes


def mesh_hash(geometry: Shape, mesh: MeshOptions) -> str:
    """Hash of everything the mesh depends on; of files their content, not their names."""
    content = geometry_content(geometry)
    content["mesh"] = mesh.model_dump()
    # The order of the displacement does not change the mesh.
    content["mesh"].pop("order", None)
    is_meshed = True
    if is_file(geometry):
        content["apart"] = geometry.apart
        is_meshed = geometry.is_script
    if is_meshed:
        content["gmsh"] = _gmsh_version()
    return hash_of(content)


def geometry_content(geometry: Shape) -> dict[str, Any]:
    """Content of a geometry and its files, and the version of the meshers."""
    keys = _without_paths(geometry.model_dump())
    return {"geometry": keys, "files": geometry.content, "version": MESHER_VERSION}


def hash_of(content: dict[str, Any]) -> str:
    """Hash of the input of a file in the cache, used as its name."""
    json_text = json.dumps(content, sort_keys=True, default=str)
    return hashlib.sha256(json_text.encode()).hexdigest()[:24]


def _without_paths(keys: dict[str, Any]) -> dict[str, Any]:
    """Geometry keys without file paths."""
    return {
        key: _without_paths(value) if isinstance(value, dict) else value
        for key, value in keys.items()
        if not isinstance(value, Path)
    }


def _gmsh_version() -> str:
    """Version of gmsh, read from its text: importing it takes longer than reading a mesh."""
    spec = find_spec("gmsh")
    source = Path(spec.origin).read_text() if spec and spec.origin else ""
    return "".join(re.findall(r'^GMSH_API_VERSION = "(.+)"', source, re.M))


# Parts of a mesh in the cache.
ARRAYS = ("points", "cells", "cell_tags", "facets", "facet_tags")
NAMED_PARTS = ("regions", "boundaries", "interfaces", "notes")


def cached_mesh(path: Path) -> MeshData | None:
    """Read a cached mesh; None when there is none or it is damaged (it is remade)."""
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as archive:
            named_parts = json.loads(str(archive["names"]))
            arrays = {k: archive[k] for k in ARRAYS}
        named_parts["boundaries"] = {k: tuple(v) for k, v in named_parts["boundaries"].items()}
        named_parts["interfaces"] = {
            k: (tuple(a), tuple(b)) for k, (a, b) in named_parts["interfaces"].items()
        }
        return MeshData(**arrays, **named_parts)
    except Exception:  # damaged archives fail in any way
        return None


@contextmanager
def lock(path: Path) -> Iterator[None]:
    """Lock a mesh while it is made: many runs at once often need the same one."""
    with ExitStack() as stack:
        try:
            file = stack.enter_context(open(files.lock_file(path.with_suffix(".lock")), "w"))
            fcntl.flock(file, fcntl.LOCK_EX)
            files.clear(path.parent, path.name)
        except OSError:
            pass  # without a lock every run makes the mesh itself
        yield


def store(data: MeshData, path: Path) -> None:
    """Write the mesh under another name and rename it; skipped where the folder is not writable."""
    named_parts = json.dumps({name: getattr(data, name) for name in NAMED_PARTS})
    arrays = {name: getattr(data, name) for name in ARRAYS}
    content = io.BytesIO()
    np.savez(content, **arrays, names=np.array(named_parts))
    try:
        files.write_bytes(path, content.getvalue(), 0o600)
    except OSError as error:
        log.warning("the mesh cannot be kept in %s: %s", path.parent, error.strerror or error)
