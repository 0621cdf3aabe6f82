"""Meshes from files by the names in them, and to gmsh files; scripts are meshed first."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from app import mesh_files
from app.foundation import confined
from app.foundation.arrays import Floats, Ints
from app.foundation.errors import GeometryError
from meshes.data import (
    MeshData,
    cell_volumes,
    connected,
    exterior_facets,
    interface_facets,
    mesh_data_of,
    number,
    same_triangles,
)
from meshes.gmsh_reader_process import ReadRequest
from meshes.gmsh_session import MILLIMETRES, session
from meshes.pieces import coincident
from meshes.quality import bent, overlapping, places, untangle

if TYPE_CHECKING:
    from app.case.geometries import MeshFile
    from app.case.shapes import MeshOptions

# Exchanging the first two vertices of a tetrahedron mirrors it; its edge nodes follow.
_MIRROR = {4: [1, 0, 2, 3], 10: [1, 0, 2, 3, 4, 6, 5, 9, 8, 7]}


@dataclass(frozen=True)
class FileMesh:
    """Content of a mesh file, by the names in it.

    Attributes:
        points: Nodes, in the unit of the file (n, 3).
        cells: Nodes of the cells of each region (m, 4 or 10).
        surfaces: Nodes of the triangles of each surface (k, 3 or 6).
        everything: Number of cells, including those without a region.
        messages: Notes on what was left out or merged.
    """

    points: Floats
    cells: dict[str, Ints]
    surfaces: dict[str, Ints]
    everything: int
    messages: list[str] = field(default_factory=list)


def build(geometry: MeshFile, mesh: MeshOptions) -> MeshData:
    """Read a file of straight or quadratic tetrahedra, or run a script.

    Args:
        geometry: ``path``, ``unit`` and ``interfaces`` (name to the regions on either side).
        mesh: ``size``, ``far_size`` [mm], ``curved`` for a ``.geo`` script (where nothing bends its
            cells are straight); a ``.msh`` file decides by itself.

    Returns:
        Regions are the named physical volumes, boundaries the named physical surfaces on the
        exterior. ``notes`` name interior surfaces (no boundaries), count cells without a region
        (left out), and list repairs (``messages``).

    Raises:
        GeometryError: A script that fails, no tetrahedra, other elements, missing or overlapping
            physical groups (with the names in the file), cells that overlap, a file that changes.
    """
    path = geometry.path
    mesh_file = _read(geometry, mesh)
    blocks, surfaces = mesh_file.cells, mesh_file.surfaces
    try:
        case_names = mesh_files.case_names(blocks)
        blocks = {case_names[name]: block for name, block in blocks.items()}
        case_names = mesh_files.case_names(surfaces)
        surfaces = {case_names[name]: block for name, block in surfaces.items()}
    except ValueError as error:
        raise GeometryError(f"{path}: {error}") from error
    regions, cells = number(blocks), np.concatenate([*blocks.values()])
    cell_tags = np.repeat([*regions.values()], [*map(len, blocks.values())]).astype(np.int32)
    if len(np.unique(np.sort(cells[:, :4], axis=1), axis=0)) < len(cells):
        raise GeometryError(
            f"{path}: some cells belong to two physical volumes; give each volume one "
            "physical group"
        )
    points = mesh_file.points * MILLIMETRES[geometry.unit]
    if cells.shape[1] == 10 and geometry.is_script and not bent(points, cells):
        cells = cells[:, :4]
    negative = cell_volumes(points, cells) < 0
    cells[negative] = cells[negative][:, _MIRROR[cells.shape[1]]]
    try:
        overlap, (facets, _) = overlapping(cells), exterior_facets(cells)
    except ValueError as error:
        raise GeometryError(f"{path}: {error}; remove overlapping and duplicate cells") from error
    if len(overlap):
        overlap_places = "\n".join(places(points, cells, cell_tags, regions, overlap))
        raise GeometryError(
            f"{path}: {len(overlap)} of {len(cells)} cells overlap their neighbours; probably a "
            f"node is in the wrong place:\n{overlap_places}\nRepair the mesh file."
        )
    if cells.shape[1] == 10 and geometry.is_script:
        points = untangle(points, cells)
    masks = {
        name: np.isin(*same_triangles(facets[:, :3], block[:, :3]))
        for name, block in surfaces.items()
    }
    boundaries = {name: mask for name, mask in masks.items() if mask.any()}
    data = mesh_data_of(points, cells, cell_tags, regions, geometry.interfaces, boundaries, facets)
    notes = {
        "file": str(path),
        "interior_surfaces": sorted({*masks} - {*boundaries}),
        "cells_without_region": mesh_file.everything - len(cells),
        "messages": _messages(mesh_file, len(cells), int(negative.sum())),
    }
    return replace(data, notes=notes)


def _messages(mesh_file: FileMesh, cells: int, inverted: int) -> list[str]:
    """Notes on repairs: inverted cells, the reader's notes, cells without a region.

    Args:
        mesh_file: The file.
        cells: Number of cells in regions.
        inverted: Number of cells that were inside out.
    """
    messages = []
    if inverted:
        messages.append(
            f"geometry: {inverted} of {cells} cells of the file list their nodes "
            "inside out: they are turned, and no cell overlaps its neighbours"
        )
    messages += mesh_file.messages
    everything = mesh_file.everything
    if everything > cells:
        messages.append(
            f"geometry: {everything - cells} of {everything} cells of the file belong to no "
            "region: they are left out"
        )
    return messages


def _read(geometry: MeshFile, mesh: MeshOptions) -> FileMesh:
    """Read the file; gmsh reads in a child process (`meshes.gmsh_reader_process.read`)."""
    path = geometry.path
    with tempfile.TemporaryDirectory(prefix="mantle-gmsh-") as folder:
        if not (path.is_file() and geometry.copy_files(Path(folder)) == geometry.content):
            raise GeometryError(f"{path} has changed since the case was read; run the case again")
        if path.suffix.lower() in mesh_files.READERS:
            return _of_others(path, geometry)
        request: ReadRequest = {
            "path": str(path),
            "script": geometry.is_script,
            "size": mesh.size,
            "far_size": mesh.far_size or 4 * mesh.size,
            "curved": mesh.curved,
            "unit": MILLIMETRES[geometry.unit],
            "parameters": dict(geometry.parameters),
            "regions": geometry.region_names,
        }
        arrays = confined.ask("meshes.gmsh_reader_process:read", request, folder)
    cells, surfaces = (
        {key.removeprefix(kind): block for key, block in arrays.items() if key.startswith(kind)}
        for kind in ("cells ", "surfaces ")
    )
    return FileMesh(arrays["points"], cells, surfaces, int(arrays["everything"]))


def _of_others(path: Path, geometry: MeshFile) -> FileMesh:
    """Read a file of another program.

    Boundaries of sets of nodes have the facets whose nodes are all in the set. Coincident nodes are
    merged, except between the regions on the two sides of ``apart`` of the geometry.
    """
    content = mesh_files.read(path, geometry.pick)
    points, cells = content.points, content.cells
    try:
        facets = exterior_facets(cells)[0][:, :3]
    except ValueError as error:
        raise GeometryError(f"{path}: {error}; remove overlapping and duplicate cells") from error
    facets_of_set = {
        n: facets[np.isin(facets, rows).all(axis=1)] for n, rows in content.nodes.items()
    }
    empty = [
        n for n, block in facets_of_set.items() if not len(block) and n not in content.triangles
    ]
    hidden = [
        n
        for n, block in facets_of_set.items()
        if len(block) and not mesh_files.same_facets(block, content.triangles.get(n, block))
    ]
    pairs = coincident(points)
    for sides in geometry.apart:
        on_first, on_second = (
            np.isin(pairs, cells[np.concatenate([content.sets[n] for n in side])]) for side in sides
        )
        pairs = pairs[~(on_first & on_second[:, ::-1]).any(axis=1)]
    label = connected(len(points), *pairs.T)
    row = np.unique(label, return_index=True)[1][label]
    notes = content.notes + mesh_files.left_out("sets of nodes without a facet", empty)
    ignored_sets = "sets of nodes that are not read, since surfaces have their names"
    notes += mesh_files.left_out(ignored_sets, hidden)
    merged_count = int((row != np.arange(len(row))).sum())
    if merged_count:
        notes.append(f"geometry: {merged_count} nodes are merged with others at their places")
    blocks = dict[str, Ints]()
    repeated = 0
    for name, rows in content.sets.items():
        block = row[cells[rows]]
        first_rows = np.unique(np.sort(block[:, :4], axis=1), axis=0, return_index=True)[1]
        repeated += len(block) - len(first_rows)
        blocks[name] = block[np.sort(first_rows)]
    if repeated:
        notes.append(f"geometry: {repeated} cells stand twice in the file: one of each is kept")
    surfaces = {name: row[rows] for name, rows in (facets_of_set | content.triangles).items()}
    return FileMesh(points, blocks, surfaces, len(cells) - repeated, notes)


def write(data: MeshData, path: Path) -> None:
    """Write a binary gmsh 4.1 file [mm] with physical names of regions, boundaries, interfaces.

    Text would take five times as long and not keep every bit of the coordinates. A patch of
    several boundaries is in several groups.

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
        patches = {int(tag): data.facets[data.facet_tags == tag] for tag in set(data.facet_tags)}
        surfaces = {name: list(tags) for name, tags in data.boundaries.items()}
        for name in data.interfaces:
            surfaces[name] = [max(patches, default=0) + 1]
            patches |= {surfaces[name][0]: interface_facets(data, name)[0]}
        for tag, facets in sorted(patches.items()):
            model.addDiscreteEntity(2, tag)
            model.mesh.addElementsByType(tag, triangle, [], facets.ravel() + 1)
        for name, tag in data.regions.items():
            model.addPhysicalGroup(3, [tag], name=name)
        for name, tags in surfaces.items():
            model.addPhysicalGroup(2, tags, name=name)
        gmsh.option.setNumber("Mesh.MshFileVersion", 4.1)
        gmsh.option.setNumber("Mesh.Binary", 1)
        gmsh.option.setNumber("Mesh.SaveAll", 0)
        gmsh.write(str(path))
