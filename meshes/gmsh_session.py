"""gmsh sessions, one for each mesh, and what meshers do in them.

After a failed mesh every later one of the same session comes out empty, even after
``gmsh.clear()``.
"""

from __future__ import annotations

import locale
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

import numpy as np

from app.foundation.arrays import Floats, Ints
from app.foundation.captured import captured
from app.foundation.errors import GeometryError, MantleError
from meshes.quality import untangle

MILLIMETRES = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}
LOG_LINES = 6  # of gmsh's log, quoted when it fails
# Messages of gmsh's recovery of surfaces, and their meaning.
CROSSING = "PLC Error"
CROSSING_TEXT = "surfaces of the geometry cross each other"
GROWTH = 0.4  # mm of element size per mm of distance from an interface


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
    os.environ["HOME"] = os.devnull  # FLTK would create a folder in HOME
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
