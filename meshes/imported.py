"""Meshes from and to gmsh files, by physical names; scripts are meshed first."""

from __future__ import annotations

import io
import json
import pickle
import resource
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mantle.arrays import Ints
from mantle.errors import GeometryError

from .curving import bent, untangle
from .data import MeshData, cell_volumes, exterior_facets
from .quality import overlapping, places
from .session import generate, session
from .tags import assemble, number

MILLIMETRES = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}
# How often the finest cells of a script may be in its diagonal; any more would never be meshed.
MOST_EDGES = 20_000
# Exchanging the first two vertices of a tetrahedron mirrors it; its edge nodes follow.
_MIRROR = {4: [1, 0, 2, 3], 10: [1, 0, 2, 3, 4, 6, 5, 9, 8, 7]}
_TETRAHEDRA, _TRIANGLES = {4: 4, 11: 10}, {2: 3, 9: 6}


def build(geometry: Any, mesh: Any) -> MeshData:
    """Read a ``.msh`` file (2.2 or 4.1) of straight or quadratic tetrahedra, or run a script.

    Args:
        geometry: ``path``, ``unit`` and ``interfaces`` (name to the regions on either side).
        mesh: ``size``, ``far_size`` [mm], ``curved`` for a ``.geo`` script (where nothing bends its
            cells are straight); a ``.msh`` file decides by itself.

    Returns:
        Regions are the named physical volumes, boundaries the named physical surfaces on the
        exterior. ``notes`` names surfaces that lie inside (they are no boundaries), counts the
        cells without a region, which are left out, and says (``told``) what was repaired or
        ignored.

    Raises:
        GeometryError: No such file, a script that fails, no tetrahedra, other elements, missing or
            overlapping physical groups (with the names found), cells that overlap.
    """
    path = Path(geometry.path)
    if not path.is_file():
        raise GeometryError(f"{path}: no such mesh file")
    # gmsh crashes on some damaged files; scripts are its own language.
    parts = _parts(geometry, mesh) if geometry.is_script else _apart(geometry, mesh)
    return _named(geometry, *parts)


def _apart(geometry: Any, mesh: Any) -> Any:
    """Call `_parts` in a process of its own.

    Raises:
        GeometryError: As `_parts`, or gmsh crashes.
    """
    done = subprocess.run(
        [sys.executable, "-P", "-c", "from mantle.meshes.imported import serve; serve()"],
        input=pickle.dumps((geometry, mesh)),
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    if done.returncode:
        raise GeometryError(f"{geometry.path}: gmsh crashed: the file is damaged or too large")
    head, _, arrays = done.stdout.partition(b"\n")
    told = json.loads(head)
    if "error" in told:
        raise GeometryError(told["error"])
    with np.load(io.BytesIO(arrays), allow_pickle=False) as found:
        cells, surfaces = (
            {name: found[f"{kind} {k}"] for k, name in enumerate(told[kind])}
            for kind in ("cells", "surfaces")
        )
        nodes = found["nodes"], found["points"]
    return told["regions"], *nodes, cells, surfaces, told["everything"]


def serve() -> None:
    """Read a mesh file: what is asked comes from standard input, the answer goes to the output.

    The answer is a line of JSON and arrays, no pickle: a file may have made gmsh do what it wants.
    """
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    geometry, mesh = pickle.load(sys.stdin.buffer)
    arrays = io.BytesIO()
    try:
        regions, nodes, points, cells, surfaces, everything = _parts(geometry, mesh)
    except GeometryError as error:
        told: dict[str, Any] = {"error": str(error)}
    else:
        parts = {"cells": cells, "surfaces": surfaces}
        blocks = {
            f"{kind} {k}": block
            for kind, named in parts.items()
            for k, block in enumerate(named.values())
        }
        np.savez(arrays, nodes=nodes, points=points, **blocks)
        told = {kind: list(named) for kind, named in parts.items()}
        told |= {"regions": regions, "everything": everything}
    sys.stdout.buffer.write(json.dumps(told).encode() + b"\n" + arrays.getvalue())


def _parts(geometry: Any, mesh: Any) -> Any:
    """Read the regions, nodes, cells and surfaces of a file by gmsh.

    Returns:
        Numbers of the regions; tags and coordinates of the nodes; cells of each region; triangles
        of each surface; how many cells there are in all.
    """
    path = Path(geometry.path)
    with session(path.name) as gmsh:
        if geometry.is_script:
            _run_script(gmsh, path, mesh, MILLIMETRES[geometry.unit])
        else:
            gmsh.merge(str(path))
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
        if absent := [name for name in geometry.region_names if name not in regions]:
            raise GeometryError(f"{found}; no cells in the volumes {_listed(absent)}")
        needed = {r for sides in geometry.interfaces.values() for side in sides for r in side}
        if needed - set(regions):
            raise GeometryError(
                f"{found}; interfaces need the volumes {_listed(sorted(needed - set(regions)))}"
            )
        node_tags, coordinates, _ = gmsh.model.mesh.getNodes()
        surfaces = {name: _elements(gmsh, 2, name, _TRIANGLES, path) for name in names[2] if name}
        everything = _count(gmsh)
    return regions, node_tags, coordinates.reshape(-1, 3), cells, surfaces, everything


def _run_script(gmsh: Any, path: Path, mesh: Any, unit: float) -> None:
    """Mesh what a script makes, with its parameters set to the sizes in its unit [mm]."""
    gmsh.parser.clear()  # of what a script before it in this process has defined
    gmsh.parser.setNumber("size", [mesh.size / unit])
    gmsh.parser.setNumber("far_size", [(mesh.far_size or 4 * mesh.size) / unit])
    for source in ("ExtendFromBoundary", "FromPoints"):  # gmsh's defaults, which scripts count on
        gmsh.option.setNumber(f"Mesh.MeshSize{source}", 1)
    gmsh.merge(str(path))
    box = np.array(gmsh.model.getBoundingBox(-1, -1))
    edges = np.linalg.norm(box[3:] - box[:3]) * unit / mesh.size
    if not edges <= MOST_EDGES:
        raise GeometryError(
            f"mesh.size: {mesh.size:g} mm: the diagonal of {path} is {edges:.1g} cells long; "
            f"at most {MOST_EDGES}"
        )
    generate(gmsh, mesh.curved)


def _named(
    geometry: Any,
    regions: dict[str, int],
    node_tags: Any,
    points: Any,
    cells_by_name: dict[str, Ints],
    surfaces: dict[str, Ints],
    everything: int,
) -> MeshData:
    """Put the pieces of the file together."""
    if not len(node_tags):
        raise GeometryError(f"{geometry.path}: the mesh has no nodes")
    order = np.argsort(node_tags, kind="stable")
    tags = node_tags[order].astype(np.int64)

    def rows(wanted: Ints) -> Ints:
        """Rows of nodes by their tags, which may be any numbers."""
        at = np.searchsorted(tags, wanted).clip(max=len(tags) - 1)
        if (tags[at] != wanted).any():
            raise GeometryError(f"{geometry.path}: cells have nodes that the file does not list")
        return np.asarray(order[at])

    widths = {block.shape[1] for block in cells_by_name.values() if len(block)}
    if len(widths) != 1:
        what = (
            "mixes straight and quadratic cells" if widths else "has no tetrahedra in its regions"
        )
        raise GeometryError(f"{geometry.path}: the mesh {what}")
    width = widths.pop()
    cells = rows(np.concatenate([block.reshape(-1, width) for block in cells_by_name.values()]))
    cell_tags = np.concatenate(
        [np.full(len(block), regions[n], dtype=np.int32) for n, block in cells_by_name.items()]
    )
    if len(np.unique(np.sort(cells[:, :4], axis=1), axis=0)) < len(cells):
        raise GeometryError(f"{geometry.path}: some cells belong to two physical volumes")
    points = points * MILLIMETRES[geometry.unit]
    if width == 10 and geometry.is_script and not bent(points, cells):
        cells, width = cells[:, :4], 4
    negative = cell_volumes(points, cells) < 0
    cells[negative] = cells[negative][:, _MIRROR[width]]
    try:
        overlap = overlapping(cells)
        exterior = exterior_facets(cells)
    except ValueError as error:
        raise GeometryError(f"{geometry.path}: {error}; the mesh is not conforming") from error
    if len(overlap):
        where = places(points, cells, cell_tags, regions, overlap)
        raise GeometryError(
            f"{geometry.path}: {len(overlap)} of {len(cells)} cells overlap their neighbours: both "
            "lie on the same side of the face between them, or bend it differently; a node is in "
            "the wrong place:\n" + "\n".join(where) + "\nRepair the mesh file."
        )
    if width == 10 and geometry.is_script:
        points = untangle(points, cells)
    told = [
        f"geometry: the physical volume '{name}' of the file has no cells: it is ignored"
        for name in geometry.empty_volumes
    ]
    if turned := int(negative.sum()):
        told.append(
            f"geometry: {turned} of {len(cells)} cells of the file list their nodes inside out: "
            "they are turned, and no cell overlaps its neighbours"
        )
    masks = {name: _among(exterior[0], rows(block[:, :3])) for name, block in surfaces.items()}
    inside = sorted(name for name, mask in masks.items() if not mask.any())
    data = assemble(
        points,
        cells,
        cell_tags,
        regions,
        geometry.interfaces,
        {name: mask for name, mask in masks.items() if mask.any()},
        exterior,
    )
    notes = {
        "file": str(geometry.path),
        "interior_surfaces": inside,
        "cells_without_region": everything - len(cells),
        "told": told,
    }
    return replace(data, notes=notes)


def _listed(names: Any) -> str:
    return ", ".join(name or "(unnamed)" for name in names) or "none"


def _count(gmsh: Any) -> int:
    """Number of all cells of dimension 3."""
    _, tags, _ = gmsh.model.mesh.getElements(3)
    return sum(len(block) for block in tags)


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


def _among(facets: Ints, wanted: Ints) -> Any:
    """Which of the facets have the three corners of one of the wanted; shape (k,)."""
    both = np.sort(np.concatenate([facets[:, :3], wanted]), axis=1)
    _, label = np.unique(both, axis=0, return_inverse=True)
    label = label.ravel()
    return np.isin(label[: len(facets)], label[len(facets) :])


def write(data: MeshData, path: Path) -> None:
    """Write a binary gmsh 4.1 file whose physical names are the regions and boundaries.

    Text would take five times as long and not keep every bit of the coordinates.

    Args:
        data: The mesh; a patch that belongs to several boundaries is in several groups.
        path: The file to write, ``.msh``; coordinates are in mm.

    Raises:
        GeometryError: gmsh could not write it.
    """
    nodes = np.arange(1, len(data.points) + 1)
    tet, triangle = (11, 9) if data.curved else (4, 2)
    with session(Path(path).stem) as gmsh:
        model = gmsh.model
        holder = min(data.regions.values())
        for tag in data.regions.values():
            model.addDiscreteEntity(3, tag)
        model.mesh.addNodes(3, holder, nodes, data.points.ravel())
        for tag in data.regions.values():
            model.mesh.addElementsByType(
                tag, tet, [], data.cells[data.cell_tags == tag].ravel() + 1
            )
        for tag in sorted({t for tags in data.boundaries.values() for t in tags}):
            model.addDiscreteEntity(2, tag)
            own = data.facets[data.facet_tags == tag]
            model.mesh.addElementsByType(tag, triangle, [], own.ravel() + 1)
        for name, tag in data.regions.items():
            model.addPhysicalGroup(3, [tag], name=name)
        for name, tags in data.boundaries.items():
            model.addPhysicalGroup(2, list(tags), name=name)
        gmsh.option.setNumber("Mesh.MshFileVersion", 4.1)
        gmsh.option.setNumber("Mesh.Binary", 1)
        gmsh.option.setNumber("Mesh.SaveAll", 0)
        gmsh.write(str(path))
