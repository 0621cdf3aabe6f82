"""Child process in which gmsh reads foreign files.

Scripts are programs, and damaged files crash gmsh. So files are read in a separate process, on
copies, with limits of memory and time.
"""

from __future__ import annotations

import json
import os
import resource
import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from app import mesh_files
from app.foundation.errors import GeometryError
from meshes import msh_groups
from meshes.gmsh_session import elements, nodes, session

# Largest ratio of the diagonal of a script's model to the cell size: larger meshes do not end.
MOST_EDGES = 20_000
# Largest size of a written file [bytes].
MOST_BYTES = 1 << 30


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
