"""gmsh sessions, one for each mesh; foreign files are read in a child process with limits.

After a failed mesh every later one of the same session comes out empty, even after
``gmsh.clear()``. Scripts are programs and damaged files crash gmsh: files are read in a separate
process, on copies, with limits of memory and time.
"""

from __future__ import annotations

import json
import locale
import os
import resource
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from app import mesh_files
from app.foundation.arrays import Floats, Ints
from app.foundation.captured import captured
from app.foundation.errors import GeometryError, MantleError
from meshes import msh_groups
from meshes.quality import untangle

MILLIMETRES = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}
LOG_LINES = 6  # of gmsh's log, quoted when it fails
# Messages of gmsh's recovery of surfaces, and their meaning.
CROSSING = "PLC Error"
CROSSING_TEXT = "surfaces of the geometry cross each other"
GROWTH = 0.4  # mm of element size per mm of distance from an interface
# How often the finest cells of a script may be in its diagonal; any more would never be meshed.
MOST_EDGES = 20_000
MOST_BYTES = 1 << 30  # bytes in a file


class ReadRequest(TypedDict):
    """Request to read a mesh file. Lengths are in mm; ``unit`` is the file's unit in mm.

    ``parameters`` are constants of a script, as it reads them.
    """

    path: str
    script: bool
    size: float
    far_size: float
    curved: bool | None
    unit: float
    parameters: dict[str, float]
    regions: tuple[str, ...]


@contextmanager
def session(name: str) -> Iterator[ModuleType]:
    """Open gmsh silently, with a model, without its signal handler or configuration files.

    Raises:
        GeometryError: gmsh failed; carries the last lines of its log.
    """
    import gmsh

    if gmsh.isInitialized():
        gmsh.finalize()
    home, language = str(Path.home()), locale.setlocale(locale.LC_ALL)
    os.environ["HOME"] = os.devnull  # the toolkit of its windows would make a folder there
    try:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
    finally:
        os.environ["HOME"] = home
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
        with captured("gmsh") as captured_log:
            try:
                yield gmsh
            except MantleError:
                raise
            except Exception as error:  # gmsh raises bare Exception with its last error line
                crossing = [line.partition(":")[2] for line in captured_log() if CROSSING in line]
                lines = [f"{name}: the mesh generator failed: {error}"]
                lines += [f"{CROSSING_TEXT}:{crossing_text}" for crossing_text in crossing[:1]]
                lines += [f"  gmsh: {line}" for line in gmsh.logger.get()[-LOG_LINES:]]
                raise GeometryError("\n".join(lines)) from error
    finally:
        gmsh.logger.stop()  # it would survive finalize() with the lines of this case
        gmsh.finalize()
        locale.setlocale(locale.LC_ALL, language)  # gmsh takes that of the environment


def grade(gmsh: ModuleType, distances: Sequence[str], size: float, far_size: float) -> None:
    """Set elements of ``size`` where a distance vanishes, growing to ``far_size`` [mm].

    ``distances`` are expressions in x, y, z [mm], one for each interface; without any the mesh is
    uniform.
    """
    fields = []
    for distance in distances or ["0"]:
        tag = gmsh.model.mesh.field.add("MathEval")
        slope = f"{size}+{GROWTH}*Fabs({distance})"
        # MathEval has no minimum: min(a, b) = (a + b - |a - b|)/2
        expression = f"0.5*({slope}+{far_size}-Fabs({slope}-{far_size}))"
        gmsh.model.mesh.field.setString(tag, "F", expression)
        fields.append(tag)
    smallest = gmsh.model.mesh.field.add("Min")
    gmsh.model.mesh.field.setNumbers(smallest, "FieldsList", fields)
    gmsh.model.mesh.field.setAsBackgroundMesh(smallest)


def tetrahedra(gmsh: ModuleType, curved: bool) -> tuple[Floats, Ints, Ints]:
    """Mesh the model, with curved elements when asked, which are untangled.

    gmsh improves elements while it meshes; doing it again (its optimiser, Relocate3D, a higher
    threshold) was measured to change nothing, and Debian's gmsh has no Netgen optimiser.

    Returns:
        Nodes (n, 3), tetrahedra (m, 4 or 10) and the volume entity of each (m,).
    """
    gmsh.model.mesh.generate(3)
    if curved:
        gmsh.model.mesh.setOrder(2)
    points, row = nodes(gmsh)
    volumes = [volume for _, volume in gmsh.model.getEntities(3)]
    blocks = [elements(gmsh, 11 if curved else 4, [volume], row) for volume in volumes]
    cells = np.concatenate(blocks)
    if curved:
        points = untangle(points, cells)
    return points, cells, np.repeat(volumes, [*map(len, blocks)])


def nodes(gmsh: ModuleType) -> tuple[Floats, Ints]:
    """Nodes (n, 3), and the row of each by its number, which begin with 1 from then on (n,)."""
    gmsh.model.mesh.renumberNodes()
    numbers, coordinates, _ = gmsh.model.mesh.getNodes()
    return coordinates.reshape(-1, 3), np.argsort(numbers)


def elements(gmsh: ModuleType, kind: int, entities: Iterable[int], row: Ints) -> Ints:
    """Nodes of the elements of a type in entities (k, nodes)."""
    blocks = [gmsh.model.mesh.getElementsByType(kind, entity)[1] for entity in entities]
    width = gmsh.model.mesh.getElementProperties(kind)[3]
    return row[np.concatenate(blocks).astype(np.int64) - 1].reshape(-1, width)


def serve(reader: Callable[[Any], Mapping[str, ArrayLike]], seconds: int) -> None:
    """Answer the request on standard input, within the limits: arrays by name, or an error."""
    request = json.load(sys.stdin)
    answer = os.dup(1)
    os.dup2(2, 1)  # scripts print
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    for resource_limit, value in (
        (resource.RLIMIT_AS, memory),
        (resource.RLIMIT_CPU, seconds),
        (resource.RLIMIT_FSIZE, MOST_BYTES),
        (resource.RLIMIT_CORE, 0),
    ):
        resource.setrlimit(resource_limit, (value, value))
    try:
        arrays: dict[str, Any] = {**reader(request)}
    except GeometryError as error:
        arrays = {"error": str(error)}
    with open(answer, "wb") as pipe:
        np.savez(pipe, **arrays)


def read(request: ReadRequest) -> dict[str, ArrayLike]:
    """Read a ``.msh`` file, or mesh a script.

    Returns:
        ``points``: nodes (n, 3), in the unit of the file; ``cells NAME``: cells of a region (m, 4
        or 10); ``surfaces NAME``: triangles of a physical surface (k, 3 or 6); ``everything``:
        number of cells, including cells without a region.
    """
    path = Path(request["path"])
    with session(path.name) as gmsh:
        if request["script"]:
            _run_script(gmsh, request)
        else:
            msh_groups.keep_apart(Path(path.name), gmsh)
            try:
                gmsh.merge(path.name)
            except Exception as error:  # gmsh raises bare Exception
                fault = "is damaged or cut short; export it again"
                raise GeometryError(f"{path}: {fault} (gmsh: {error})") from error
        groups_of_surfaces, groups_of_volumes = _physical_groups(gmsh, 2), _physical_groups(gmsh, 3)
        listing = (
            f"{path}: physical volumes: {_listed(groups_of_volumes)}; "
            f"physical surfaces: {_listed(groups_of_surfaces)}"
        )
        surfaces, regions = (
            {name: group for name, group in groups.items() if name}
            for groups in (groups_of_surfaces, groups_of_volumes)
        )
        if not regions:
            raise GeometryError(
                f"{listing}; name every region (and boundary) with a physical group"
            )
        is_quadratic = _are_quadratic(gmsh, path, regions)
        mesh = gmsh.model.mesh
        numbers, x, _ = mesh.getNodes()
        bad_nodes = numbers[~np.isfinite(x.reshape(-1, 3)).all(axis=1)]
        if len(bad_nodes):
            raise GeometryError(
                f"{path}: node {bad_nodes[0]} has a coordinate that is not a number; export the "
                "mesh again"
            )
        points, row = nodes(gmsh)
        tet, triangle = (11, 9) if is_quadratic else (4, 2)
        cells = {name: elements(gmsh, tet, group, row) for name, group in sorted(regions.items())}
        filled_regions = {mesh_files.word(name) for name, block in cells.items() if len(block)}
        absent = [name for name in request["regions"] if name not in filled_regions]
        if absent:
            raise GeometryError(
                f"{listing}; the volumes {_listed(absent)} have no cells; mesh them, or "
                "leave them out"
            )
        _, tags, _ = mesh.getElements(3)
        arrays: dict[str, ArrayLike] = {"points": points, "everything": sum(map(len, tags))}
        arrays |= {f"cells {name}": block for name, block in cells.items() if len(block)}
        for name, group in surfaces.items():
            arrays[f"surfaces {name}"] = elements(gmsh, triangle, group, row)
        return arrays


def _physical_groups(gmsh: ModuleType, dim: int) -> dict[str, list[int]]:
    """Entities of the physical groups of a dimension, by the name of the group."""
    groups: dict[str, list[int]] = {}
    for _, tag in gmsh.model.getPhysicalGroups(dim):
        name = gmsh.model.getPhysicalName(dim, tag)
        groups.setdefault(name, []).extend(gmsh.model.getEntitiesForPhysicalGroup(dim, tag))
    return groups


def _are_quadratic(gmsh: ModuleType, path: Path, regions: dict[str, list[int]]) -> bool:
    """Return True if the cells of the regions are quadratic tetrahedra, False if straight.

    Raises:
        GeometryError: The cells are of other types, or of both.
    """
    mesh = gmsh.model.mesh
    volumes = [volume for group in regions.values() for volume in group]
    kinds = {int(kind) for volume in volumes for kind in mesh.getElementTypes(3, volume)}
    if len(kinds) > 1 or not kinds <= {4, 11}:
        labels = ", ".join(sorted(mesh.getElementProperties(kind)[0] for kind in kinds))
        raise GeometryError(
            f"{path}: the cells are of type {labels}; only straight tetrahedra, or only "
            "quadratic ones, can be used"
        )
    return 11 in kinds


def _run_script(gmsh: ModuleType, request: ReadRequest) -> None:
    size, unit = request["size"], request["unit"]
    gmsh.parser.setNumber("size", [size / unit])
    gmsh.parser.setNumber("far_size", [request["far_size"] / unit])
    for name, value in request["parameters"].items():
        gmsh.parser.setNumber(name, [value])
    for source in ("ExtendFromBoundary", "FromPoints"):  # gmsh's defaults, which scripts count on
        gmsh.option.setNumber(f"Mesh.MeshSize{source}", 1)
    gmsh.merge(Path(request["path"]).name)
    box = np.array(gmsh.model.getBoundingBox(-1, -1))
    edges = np.linalg.norm(box[3:] - box[:3]) * unit / size
    if not edges <= MOST_EDGES:
        raise GeometryError(
            f"mesh.size: {size:g} mm: the diagonal of {request['path']} is {edges:.1g} cells "
            f"long; at most {MOST_EDGES}: use a larger size, or correct `unit`"
        )
    gmsh.model.mesh.generate(3)
    if request["curved"]:
        gmsh.model.mesh.setOrder(2)


def _listed(names: Iterable[str]) -> str:
    return ", ".join(name or "(unnamed)" for name in names) or "none"
