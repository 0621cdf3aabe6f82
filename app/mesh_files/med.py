"""Reader of ``.med`` files of Salome: groups of volumes, faces and nodes of one mesh or several.

meshio is right for one mesh with families; what it does not read is prepared for it.
"""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from app.foundation.arrays import Floats, Ints
from app.mesh_files.content import ONLY, ORDER_MED, FileContent, Pick, extend, left_out

if TYPE_CHECKING:
    import h5py

TETRAHEDRA = ("tetra", "tetra10")


class MedBlock(Protocol):
    """Cells of one type."""

    dim: int
    type: str
    data: Ints


class MedMesh(Protocol):
    """A mesh as `meshio.med.read` returns it.

    Attributes:
        points: Nodes (n, 3).
        cells: Blocks of cells of one type.
        cell_data: Number of the family of each cell, by block.
        point_data: Number of the family of each node.
        cell_tags: Groups of each family of cells.
        point_tags: Groups of each family of nodes.
    """

    points: Floats
    cells: list[MedBlock]
    cell_data: dict[str, list[Ints]]
    point_data: dict[str, Ints]
    cell_tags: dict[int, list[str]]
    point_tags: dict[int, list[str]]


def read(path: Path, pick: Pick) -> FileContent:
    """Read the only mesh of tetrahedra, or the picked meshes.

    If several meshes have a group of the same name, the name of the mesh is put before it.

    Raises:
        ValueError: There are several meshes and none is picked, or a picked one is not there.
    """
    meshes = _meshes(path)
    solid = {
        name: sum(len(b.data) for b in mesh.cells if b.dim == 3) for name, mesh in meshes.items()
    }
    filled_meshes = [name for name, count in solid.items() if count]
    mesh_list = ", ".join(f"{name} ({count:,} tetrahedra)" for name, count in solid.items())
    missing_meshes = [name for name in pick.meshes if name not in meshes]
    if missing_meshes:
        raise ValueError(f"has no mesh {missing_meshes[0]}; it has the meshes {mesh_list}")
    if len(filled_meshes) > 1 and not pick.meshes:
        raise ValueError(f"has the meshes {mesh_list}: set `geometry.meshes` to those of the model")
    chosen_meshes = pick.meshes or filled_meshes or [*meshes]
    content = FileContent()
    content.notes += left_out(
        "meshes that are not read", (n for n in meshes if n not in chosen_meshes)
    )
    group_names = [group for name in chosen_meshes for group in _groups(meshes[name])]
    repeated = {group for group in group_names if group_names.count(group) > 1}
    shift = 0
    for name in chosen_meshes:
        titles = {g: f"{name}.{g}" if g in repeated else g for g in _groups(meshes[name])}
        _add(content, meshes[name], shift, titles)
        shift += len(meshes[name].points)
    message = "groups of one name in several meshes have the mesh before their name"
    content.notes += left_out(message, sorted(repeated))
    content.points = np.concatenate([meshes[name].points for name in chosen_meshes])
    return content


def _meshes(path: Path) -> dict[str, MedMesh]:
    """Return the meshes by name. meshio reads each from a file that has no other mesh."""
    import h5py
    import meshio

    meshes = {}
    with h5py.File(path, "r", locking=False) as file:
        for name in file["ENS_MAA"]:
            only_mesh = BytesIO()
            with h5py.File(only_mesh, "w") as copied_file:
                for part in ("ENS_MAA", "FAS"):
                    group = copied_file.create_group(part)
                    if name in file.get(part, ()):
                        file.copy(file[part][name], group, name)
                copied_file.visititems(_add_families)
            meshes[name] = meshio.med.read(only_mesh)
    if not meshes:
        raise ValueError("has no mesh")
    return meshes


def _add_families(_name: str, group: h5py.Group | h5py.Dataset) -> None:
    """Put nodes and cells without families into the family 0, which has no group."""
    for entity in ("COO", "NOD"):
        if entity in getattr(group, "keys", tuple)() and "FAM" not in group:
            group["FAM"] = np.zeros(group[entity].attrs["NBR"], dtype=np.int64)


def _groups(mesh: MedMesh) -> set[str]:
    """Names of the groups of a mesh."""
    families = [*mesh.cell_tags.values(), *mesh.point_tags.values()]
    return {name for names in families for name in names}


def _add(content: FileContent, mesh: MedMesh, shift: int, titles: dict[str, str]) -> None:
    """Add cells and groups of a mesh.

    Args:
        content: The content to which they are added.
        mesh: The mesh.
        shift: Number of its first node among the nodes of all meshes.
        titles: Names of its groups in the case.
    """
    families = mesh.cell_data["cell_tags"]
    for k, block in enumerate(mesh.cells):
        if block.dim == 3 and block.type not in TETRAHEDRA:
            raise ValueError(f"the cells are of type {block.type}; {ONLY}")
        if block.dim < 2:
            continue
        target_sets = content.sets if block.dim == 3 else content.triangles
        data = block.data + shift
        rows_of_block = content.add(data, ORDER_MED) if block.dim == 3 else data[:, :3]
        for family in np.unique(families[k]):
            names = [titles[name] for name in mesh.cell_tags.get(family, ())]
            extend(target_sets, names, rows_of_block[families[k].ravel() == family])
    for family, groups in mesh.point_tags.items():
        rows = np.flatnonzero(mesh.point_data["point_tags"] == family) + shift
        extend(content.nodes, [titles[name] for name in groups], rows)
