"""gmsh, opened for one case and closed after it.

One session per case: after a failed mesh every later case of the same session comes out empty,
even after ``gmsh.clear()``.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import numpy.typing as npt

from app.arrays import Floats, Ints
from app.captured import captured
from app.errors import GeometryError, MantleError
from meshes.curving import untangle

LOG_LINES = 6  # of gmsh's log, quoted when it fails
# What gmsh's recovery of surfaces prints, and what it means.
CROSSING = "PLC Error"
CROSS = "surfaces of the geometry cross each other"
GROWTH = 0.4  # mm of element size per mm of distance from an interface


@contextmanager
def session(name: str) -> Iterator[Any]:
    """Open gmsh silently, without its signal handler or configuration files.

    Args:
        name: Of the model, for messages.

    Yields:
        The gmsh module.

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
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("General.NumThreads", 1)  # more threads: another mesh every time
        gmsh.option.setNumber("Mesh.RandomSeed", 1)
        gmsh.option.setNumber("Mesh.Algorithm", 6)
        gmsh.option.setNumber("Mesh.Algorithm3D", 10)
        gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 0)
        gmsh.option.setNumber("Mesh.MeshSizeFromPoints", 0)
        gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", 0)
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
        first = next((n for n, line in enumerate(heard) if CROSSING in line), None)
        why = "" if first is None else f"{CROSS}: {heard[first].split(':', 1)[1].strip()}\n"
        log = "\n".join(f"  gmsh: {line}" for line in gmsh.logger.get()[-LOG_LINES:])
        raise GeometryError(f"{name}: the mesh generator failed: {error}\n{why}{log}") from error
    finally:
        gmsh.logger.stop()  # it would survive finalize() with the lines of this case
        gmsh.finalize()


def grade(gmsh: Any, distances: Sequence[str], size: float, far_size: float) -> None:
    """Elements of ``size`` where a distance vanishes, growing to ``far_size``.

    Args:
        gmsh: The open session.
        distances: Expressions in x, y, z [mm], each the distance to an interface; none: uniform.
        size: At the interfaces [mm].
        far_size: Far from them [mm].
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
    """Read the tetrahedra of the model; curved ones are untangled.

    Returns:
        Nodes (n, 3), cells (m, 4 or 10) and the volume entity of each cell (m,).
    """
    node_tags, coordinates, _ = gmsh.model.mesh.getNodes()
    number = np.full(int(node_tags.max()) + 1, -1, dtype=np.int64)
    number[node_tags.astype(np.int64)] = np.arange(len(node_tags))
    cells, entities = [], []
    for _, volume in gmsh.model.getEntities(3):
        types, _, nodes = gmsh.model.mesh.getElements(3, volume)
        for kind, connectivity in zip(types, nodes, strict=True):
            if kind not in (4, 11):
                raise GeometryError(f"element type {kind}: only tetrahedra can be used")
            block = number[connectivity.astype(np.int64)].reshape(-1, 4 if kind == 4 else 10)
            cells.append(block)
            entities.append(np.full(len(block), volume, dtype=np.int64))
    if not cells:
        raise GeometryError("the mesh has no tetrahedra")
    points, connectivity = coordinates.reshape(-1, 3), np.concatenate(cells)
    if connectivity.shape[1] == 10:
        points = untangle(points, connectivity)
    return points, connectivity, np.concatenate(entities)
