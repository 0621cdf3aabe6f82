"""gmsh sessions, one for each mesh; foreign files are read in a child process with limits.

After a failed mesh every later one of the same session comes out empty, even after
``gmsh.clear()``. Scripts are programs and damaged files crash gmsh: files are read in a separate
process, on copies, with limits of memory and time.
"""

from __future__ import annotations

import io
import json
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from app.arrays import Floats, Ints
from app.captured import captured
from app.errors import GeometryError, MantleError
from meshes.quality import untangle

MILLIMETRES = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}
LOG_LINES = 6  # of gmsh's log, quoted when it fails
# Messages of gmsh's recovery of surfaces, and their meaning.
CROSSING = "PLC Error"
CROSS = "surfaces of the geometry cross each other"
GROWTH = 0.4  # mm of element size per mm of distance from an interface
# How often the finest cells of a script may be in its diagonal; any more would never be meshed.
MOST_EDGES = 20_000
SECONDS = 3600
WRITTEN = 1 << 30  # bytes in a file
_NODES = {2: {2: 3, 9: 6}, 3: {4: 4, 11: 10}}  # of elements, by dimension and gmsh's type
_SERVE = "from meshes.gmsh_child import serve; serve()"


@contextmanager
def session(name: str) -> Iterator[Any]:
    """Open gmsh silently, without its signal handler or configuration files.

    Yields:
        The gmsh module, with a model of this name.

    Raises:
        GeometryError: gmsh failed; carries the last lines of its log.
    """
    import gmsh

    if gmsh.isInitialized():
        gmsh.finalize()
    home = os.environ.get("HOME")
    os.environ["HOME"] = os.devnull  # the toolkit of its windows would make a folder there
    try:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
    finally:
        del os.environ["HOME"]
        os.environ |= {"HOME": home} if home is not None else {}
    heard: list[str] = []
    try:
        for option, value in {
            "General.Terminal": 0,
            "General.NumThreads": 1,  # more threads: another mesh every time
            "Mesh.RandomSeed": 1,
            "Mesh.Algorithm": 6,
            "Mesh.Algorithm3D": 10,
            "Mesh.MeshSizeExtendFromBoundary": 0,
            "Mesh.MeshSizeFromPoints": 0,
            "Mesh.MeshSizeFromCurvature": 0,
        }.items():
            gmsh.option.setNumber(option, value)
        gmsh.logger.start()
        gmsh.model.add(name)
        with captured("gmsh") as written:
            try:
                yield gmsh
            finally:
                heard = written()
    except MantleError:
        raise
    except Exception as error:  # gmsh raises bare Exception with its last error line
        first = next((line for line in heard if CROSSING in line), None)
        why = "" if first is None else f"{CROSS}: {first.split(':', 1)[1].strip()}\n"
        log = "\n".join(f"  gmsh: {line}" for line in gmsh.logger.get()[-LOG_LINES:])
        raise GeometryError(f"{name}: the mesh generator failed: {error}\n{why}{log}") from error
    finally:
        gmsh.logger.stop()  # it would survive finalize() with the lines of this case
        gmsh.finalize()


def grade(gmsh: Any, distances: Sequence[str], size: float, far_size: float) -> None:
    """Set elements of ``size`` where a distance vanishes, growing to ``far_size`` [mm].

    ``distances`` are expressions in x, y, z [mm], one for each interface; without any the mesh is
    uniform.
    """
    fields = []
    for distance in distances or ["0"]:
        tag = gmsh.model.mesh.field.add("MathEval")
        slope = f"{size}+{GROWTH}*Fabs({distance})"
        # MathEval has no minimum: min(a, b) = (a + b - |a - b|)/2
        text = f"0.5*({slope}+{far_size}-Fabs({slope}-{far_size}))"
        gmsh.model.mesh.field.setString(tag, "F", text)
        fields.append(tag)
    smallest = gmsh.model.mesh.field.add("Min")
    gmsh.model.mesh.field.setNumbers(smallest, "FieldsList", fields)
    gmsh.model.mesh.field.setAsBackgroundMesh(smallest)


def generate(gmsh: Any, curved: bool = False) -> None:
    """Mesh the model, and curve the elements when asked.

    gmsh improves elements while it meshes; doing it again (its own optimiser, Relocate3D, a higher
    threshold) was measured to change nothing, and Debian's gmsh has no Netgen optimiser.
    """
    gmsh.model.mesh.generate(3)
    if curved:
        gmsh.model.mesh.setOrder(2)


def extract(gmsh: Any) -> tuple[Floats, Ints, npt.NDArray[np.int64]]:
    """Read nodes (n, 3), tetrahedra (m, 4 or 10) and the volume entity of each cell (m,).

    Curved cells are untangled.
    """
    node_tags, coordinates, _ = gmsh.model.mesh.getNodes()
    row = np.full(int(node_tags.max()) + 1, -1, dtype=np.int64)
    row[node_tags.astype(np.int64)] = np.arange(len(node_tags))
    volumes = [volume for _, volume in gmsh.model.getEntities(3)]
    blocks = [_elements(gmsh, 3, [volume], "the mesh") for volume in volumes]
    entities = np.repeat(volumes, [*map(len, blocks)])
    if not len(entities):
        raise GeometryError("the mesh has no tetrahedra")
    points = coordinates.reshape(-1, 3)
    cells = row[np.concatenate([block for block in blocks if len(block)])]
    if cells.shape[1] == 10:
        points = untangle(points, cells)
    return points, cells, entities


# ------------------------------------------------------------------------------- files of others


def read(geometry: Any, mesh: Any) -> dict[str, Any]:
    """Read a ``.msh`` file, or mesh a script, in a child process.

    Args:
        geometry: ``path``, ``unit``, ``interfaces``, ``content`` and ``copy_files``.
        mesh: ``size``, ``far_size`` [mm], ``curved`` for a script.

    Returns:
        ``node_tags``: numbers of the nodes (n,), any; ``points``: their coordinates (n, 3), in the
        unit of the file; ``cells NAME``: nodes of the cells of a region (m, 4 or 10), by number;
        ``surfaces NAME``: nodes of the triangles of a physical surface (k, 3 or 6), by number;
        ``everything``: number of cells, including cells without a region.

    Raises:
        GeometryError: No tetrahedra, other elements, missing physical groups (with the names
            found), gmsh fails, the file changes meanwhile.
    """
    path = geometry.path
    with tempfile.TemporaryDirectory(prefix="mantle-gmsh-") as folder:
        if geometry.copy_files(Path(folder)) != geometry.content:
            raise GeometryError(f"{path} has changed since it was looked at: run it again")
        request = {
            "path": str(path),
            "script": geometry.is_script,
            "size": mesh.size,
            "far_size": mesh.far_size or 4 * mesh.size,
            "curved": mesh.curved,
            "unit": MILLIMETRES[geometry.unit],
            "regions": geometry.region_names,
            "sides": [r for sides in geometry.interfaces.values() for side in sides for r in side],
        }
        try:
            done = subprocess.run(
                [sys.executable, "-P", "-c", _SERVE],
                input=json.dumps(request).encode(),
                cwd=folder,
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
    # No pickle: a file may have forged the answer.
    with np.load(io.BytesIO(done.stdout), allow_pickle=False) as answer:
        found = dict(answer)
    if "error" in found:
        raise GeometryError(str(found["error"]))
    return found


def serve() -> None:
    """Answer the request on standard input, within the limits."""
    request = json.load(sys.stdin)
    answer = os.dup(sys.stdout.fileno())
    for stream in (0, 1):
        os.dup2(2, stream)  # scripts print
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    for limit, most in (
        (resource.RLIMIT_AS, memory),
        (resource.RLIMIT_CPU, SECONDS),
        (resource.RLIMIT_FSIZE, WRITTEN),
        (resource.RLIMIT_CORE, 0),
    ):
        resource.setrlimit(limit, (most, most))
    try:
        found = _arrays(request)
    except GeometryError as error:
        found = {"error": np.array(str(error))}
    content = io.BytesIO()
    np.savez(content, **found)
    with open(answer, "wb") as pipe:
        pipe.write(content.getbuffer())


def _arrays(request: Mapping[str, Any]) -> dict[str, Any]:
    """Read the requested arrays from the file, by name."""
    path = Path(request["path"])
    with session(path.name) as gmsh:
        if request["script"]:
            _run_script(gmsh, request)
        else:
            gmsh.merge(path.name)
        names: dict[int, list[str]] = {2: [], 3: []}
        blocks: dict[int, dict[str, list[int]]] = {2: {}, 3: {}}
        for dim, tag in gmsh.model.getPhysicalGroups(2) + gmsh.model.getPhysicalGroups(3):
            names[dim].append(name := gmsh.model.getPhysicalName(dim, tag))
            entities = gmsh.model.getEntitiesForPhysicalGroup(dim, tag)
            blocks[dim].setdefault(name, []).extend(entities)
        found = (
            f"{path}: physical volumes: {_listed(names[3])}; physical surfaces: {_listed(names[2])}"
        )
        if not any(names[3]):
            raise GeometryError(f"{found}; name every region (and boundary) with a physical group")
        surfaces, cells = (
            {n: _elements(gmsh, dim, on, f"{path}: {n!r}") for n, on in blocks[dim].items() if n}
            for dim in (2, 3)
        )
        cells = {name: block for name, block in sorted(cells.items()) if len(block)}
        if absent := [name for name in request["regions"] if name not in cells]:
            raise GeometryError(f"{found}; no cells in the volumes {_listed(absent)}")
        if absent := sorted({*request["sides"]} - set(cells)):
            raise GeometryError(f"{found}; interfaces need the volumes {_listed(absent)}")
        node_tags, coordinates, _ = gmsh.model.mesh.getNodes()
        _, tags, _ = gmsh.model.mesh.getElements(3)
    return {
        "node_tags": node_tags,
        "points": coordinates.reshape(-1, 3),
        "everything": np.array(sum(map(len, tags))),
        **{f"cells {name}": block for name, block in cells.items()},
        **{f"surfaces {name}": block for name, block in surfaces.items()},
    }


def _run_script(gmsh: Any, request: Mapping[str, Any]) -> None:
    size, unit = request["size"], request["unit"]
    gmsh.parser.setNumber("size", [size / unit])
    gmsh.parser.setNumber("far_size", [request["far_size"] / unit])
    for source in ("ExtendFromBoundary", "FromPoints"):  # gmsh's defaults, which scripts count on
        gmsh.option.setNumber(f"Mesh.MeshSize{source}", 1)
    gmsh.merge(Path(request["path"]).name)
    box = np.array(gmsh.model.getBoundingBox(-1, -1))
    edges = np.linalg.norm(box[3:] - box[:3]) * unit / size
    if not edges <= MOST_EDGES:
        raise GeometryError(
            f"mesh.size: {size:g} mm: the diagonal of {request['path']} is {edges:.1g} cells "
            f"long; at most {MOST_EDGES}"
        )
    generate(gmsh, request["curved"])


def _listed(names: Any) -> str:
    return ", ".join(name or "(unnamed)" for name in names) or "none"


def _elements(gmsh: Any, dim: int, entities: Iterable[int], what: str) -> Ints:
    """Nodes of the triangles or tetrahedra of entities (k, 3, 4, 6 or 10), by number."""
    blocks = []
    for entity in entities:
        types, _, nodes = gmsh.model.mesh.getElements(dim, entity)
        for kind, connectivity in zip(types, nodes, strict=True):
            if kind not in _NODES[dim]:
                label = gmsh.model.mesh.getElementProperties(kind)[0]
                raise GeometryError(
                    f"{what} has elements of type {label!r}; only straight or"
                    " quadratic tetrahedra (and their triangles) can be used"
                )
            blocks.append(connectivity.astype(np.int64).reshape(-1, _NODES[dim][kind]))
    if len({block.shape[1] for block in blocks}) > 1:
        raise GeometryError(f"{what} mixes straight and quadratic elements")
    return np.concatenate(blocks) if blocks else np.zeros((0, dim + 1), dtype=np.int64)
