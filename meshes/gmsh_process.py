"""gmsh on a file that somebody else may have written: in a process that can do nothing else.

Scripts are programs, and damaged files crash gmsh.
"""

from __future__ import annotations

import io
import json
import logging
import os
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from app import confined
from app.arrays import Floats, Ints
from app.errors import GeometryError
from meshes.session import generate, session
from meshes.tags import number

log = logging.getLogger("mantle")

MILLIMETRES = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}
# How often the finest cells of a script may be in its diagonal; any more would never be meshed.
MOST_EDGES = 20_000
SECONDS = 3600
_TETRAHEDRA, _TRIANGLES = {4: 4, 11: 10}, {2: 3, 9: 6}
_SERVE = "from meshes.gmsh_process import serve; serve()"


@dataclass(frozen=True)
class Content:
    """What gmsh found in a file.

    Attributes:
        regions: Numbers of the regions.
        node_tags: Numbers of the nodes (n,), any.
        points: Their coordinates (n, 3), in the unit of the file.
        cells: Nodes of the cells of each region (m, 4 or 10), by number.
        surfaces: Nodes of the triangles of each physical surface (k, 3 or 6), by number.
        everything: How many cells there are, those without a region included.
    """

    regions: dict[str, int]
    node_tags: Ints
    points: Floats
    cells: dict[str, Ints]
    surfaces: dict[str, Ints]
    everything: int


@dataclass(frozen=True)
class _Request:
    """What the process is asked.

    Attributes:
        path: The file as messages call it.
        folder: Where it lies now.
        script: Whether it is a script, which is meshed with the sizes that follow.
        unit: Of the file [mm].
        regions: That must have cells.
        sides: Regions that interfaces need.
    """

    path: str
    folder: str
    script: bool
    size: float
    far_size: float
    curved: bool
    unit: float
    regions: tuple[str, ...]
    sides: tuple[str, ...]


def read(geometry: Any, mesh: Any) -> Content:
    """Read a ``.msh`` file, or mesh a script, in a process that sees only copies of its files.

    Args:
        geometry: ``path``, ``unit``, ``interfaces``, ``content`` and ``copy_files``.
        mesh: ``size``, ``far_size`` [mm], ``curved`` for a script.

    Raises:
        GeometryError: No tetrahedra, other elements, missing physical groups (with the names
            found), gmsh fails, the file changes meanwhile.
    """
    path = geometry.path
    with tempfile.TemporaryDirectory(prefix="mantle-gmsh-") as folder:
        if geometry.copy_files(Path(folder)) != geometry.content:
            raise GeometryError(f"{path} has changed since it was looked at: run it again")
        for copy in (Path(folder), *Path(folder).rglob("*")):
            copy.chmod(0o555)  # for everybody, who may be somebody else then
        request = _Request(
            str(path),
            folder,
            geometry.is_script,
            mesh.size,
            mesh.far_size or 4 * mesh.size,
            mesh.curved,
            MILLIMETRES[geometry.unit],
            tuple(geometry.region_names),
            tuple({r for sides in geometry.interfaces.values() for side in sides for r in side}),
        )
        try:
            done = subprocess.run(
                [sys.executable, "-P", "-c", _SERVE],
                input=json.dumps(asdict(request)).encode(),
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                timeout=SECONDS,
            )
        except subprocess.TimeoutExpired as error:
            raise GeometryError(f"{path}: gmsh took more than {SECONDS} s") from error
    if done.returncode:
        raise GeometryError(
            f"{path}: gmsh crashed: the file is damaged or too large (limits are {SECONDS} s and "
            "the memory of the machine)"
        )
    return _decoded(path, io.BytesIO(done.stdout))


def _decoded(path: Path, answer: io.BytesIO) -> Content:
    """What the process answers: a line of JSON and arrays. No pickle: a file may have forged it.

    Raises:
        GeometryError: As the process says.
    """
    told = json.loads(answer.readline())
    if "error" in told:
        raise GeometryError(told["error"])
    if not told["confined"]:
        log.warning("%s: this machine confines gmsh by limits of memory and time alone", path)
    node_tags, points = np.load(answer), np.load(answer)
    cells, surfaces = (
        {name: np.load(answer) for name in told[kind]} for kind in ("cells", "surfaces")
    )
    return Content(told["regions"], node_tags, points, cells, surfaces, told["everything"])


def serve() -> None:
    """Answer the request that comes from standard input; gmsh is confined before it reads."""
    request = _Request(**json.load(sys.stdin))
    answer = os.dup(sys.stdout.fileno())
    for stream in (0, 1):
        os.dup2(2, stream)  # scripts print
    # What gmsh imports when it is used: no file can be opened later.
    import gmsh  # noqa: F401
    import numpy.ctypeslib  # noqa: F401

    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    told: dict[str, Any] = {"confined": confined.enter(Path(request.folder), memory, SECONDS)}
    arrays: list[Any] = []
    try:
        found = _found(request)
    except GeometryError as error:
        told["error"] = str(error)
    else:
        told |= {"regions": found.regions, "everything": found.everything}
        told |= {"cells": list(found.cells), "surfaces": list(found.surfaces)}
        arrays = [found.node_tags, found.points, *found.cells.values(), *found.surfaces.values()]
    content = io.BytesIO(json.dumps(told).encode() + b"\n")
    content.seek(0, io.SEEK_END)
    for array in arrays:
        np.save(content, array, allow_pickle=False)
    with open(answer, "wb") as pipe:
        pipe.write(content.getbuffer())


def _found(request: _Request) -> Content:
    """Open the file and take from it what is asked.

    Raises:
        GeometryError: No tetrahedra, other elements, missing physical groups, gmsh fails.
    """
    path = Path(request.path)
    with session(path.name) as gmsh:
        if request.script:
            _run_script(gmsh, request)
        else:
            gmsh.merge(path.name)
        names = {
            dim: [
                gmsh.model.getPhysicalName(d, tag) for d, tag in gmsh.model.getPhysicalGroups(dim)
            ]
            for dim in (2, 3)
        }
        found = (
            f"{path}: physical volumes: {_listed(names[3])}; physical surfaces: {_listed(names[2])}"
        )
        if not any(names[3]):
            raise GeometryError(f"{found}; name every region (and boundary) with a physical group")
        cells = {
            name: _elements(gmsh, 3, name, _TETRAHEDRA, path) for name in sorted({*names[3]} - {""})
        }
        cells = {name: block for name, block in cells.items() if len(block)}
        regions = number(cells)
        if absent := [name for name in request.regions if name not in regions]:
            raise GeometryError(f"{found}; no cells in the volumes {_listed(absent)}")
        if absent := sorted(set(request.sides) - set(regions)):
            raise GeometryError(f"{found}; interfaces need the volumes {_listed(absent)}")
        node_tags, coordinates, _ = gmsh.model.mesh.getNodes()
        surfaces = {name: _elements(gmsh, 2, name, _TRIANGLES, path) for name in names[2] if name}
        _, tags, _ = gmsh.model.mesh.getElements(3)
        everything = sum(map(len, tags))
    return Content(regions, node_tags, coordinates.reshape(-1, 3), cells, surfaces, everything)


def _run_script(gmsh: Any, request: _Request) -> None:
    """Mesh what a script makes, with its parameters set to the sizes in its unit.

    Raises:
        GeometryError: The mesh would never be finished.
    """
    unit = request.unit
    gmsh.parser.setNumber("size", [request.size / unit])
    gmsh.parser.setNumber("far_size", [request.far_size / unit])
    for source in ("ExtendFromBoundary", "FromPoints"):  # gmsh's defaults, which scripts count on
        gmsh.option.setNumber(f"Mesh.MeshSize{source}", 1)
    gmsh.merge(Path(request.path).name)
    box = np.array(gmsh.model.getBoundingBox(-1, -1))
    edges = np.linalg.norm(box[3:] - box[:3]) * unit / request.size
    if not edges <= MOST_EDGES:
        raise GeometryError(
            f"mesh.size: {request.size:g} mm: the diagonal of {request.path} is {edges:.1g} cells "
            f"long; at most {MOST_EDGES}"
        )
    generate(gmsh, request.curved)


def _listed(names: Any) -> str:
    return ", ".join(name or "(unnamed)" for name in names) or "none"


def _elements(gmsh: Any, dim: int, name: str, kinds: dict[int, int], path: Path) -> Ints:
    """Node tags of all elements of the physical groups of this name."""
    blocks = []
    for d, tag in gmsh.model.getPhysicalGroups(dim):
        if gmsh.model.getPhysicalName(d, tag) != name:
            continue
        for entity in gmsh.model.getEntitiesForPhysicalGroup(d, tag):
            types, _, nodes = gmsh.model.mesh.getElements(d, entity)
            for kind, connectivity in zip(types, nodes, strict=True):
                if kind not in kinds:
                    label = gmsh.model.mesh.getElementProperties(kind)[0]
                    raise GeometryError(
                        f"{path}: {name!r} has elements of type {label!r}; only straight or"
                        " quadratic tetrahedra (and their triangles) can be used"
                    )
                blocks.append(connectivity.astype(np.int64).reshape(-1, kinds[kind]))
    if len({block.shape[1] for block in blocks}) > 1:
        raise GeometryError(f"{path}: {name!r} mixes straight and quadratic elements")
    return np.concatenate(blocks) if blocks else np.zeros((0, 4 if dim == 3 else 3), dtype=np.int64)
