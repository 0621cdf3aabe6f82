"""A case on a dolfinx mesh of a script: both are written next to the results."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import meshes
from app.case.case import LoadedCase, load_case
from app.foundation.collective import on_root
from app.foundation.errors import InputError
from app.schema import yaml_file
from app.system.folders import write_text
from meshes.distribute import TaggedMesh, gather


def case_on(mesh: TaggedMesh, case: Mapping[str, object], folder: Path) -> LoadedCase:
    """Write ``<folder>.msh`` and ``<folder>.yaml``, and load the case; collective.

    Args:
        mesh: The mesh with its names.
        case: Sections of a case file. `geometry` may contain nothing but interfaces.
        folder: Folder of the results.

    Raises:
        InputError: The mesh has no names, the case is wrong, or its `geometry` has other keys.
    """
    if not isinstance(mesh, TaggedMesh):
        raise InputError(
            f"mesh: is a {type(mesh).__module__}.{type(mesh).__name__}; expected a TaggedMesh,"
            " which names the parts of a dolfinx mesh:"
            " from meshes.distribute import TaggedMesh, then"
            " TaggedMesh.from_markers(mesh, regions={NAME: marker}, boundaries={NAME: marker}), or"
            " from_tags (docs/howto/python.md)"
        )
    geometry = case.get("geometry", {})
    if not isinstance(geometry, Mapping) or geometry.keys() - {"interfaces"}:
        raise InputError(
            "geometry: the mesh is an argument of run; expected only the interfaces: "
            "{'interfaces': {NAME: [REGION, REGION]}}"
        )
    path = folder.with_name(f"{folder.name}.yaml")
    data = gather(mesh)

    def write() -> None:
        assert data is not None
        folder.parent.mkdir(parents=True, exist_ok=True)
        meshes.write_msh(data, path.with_suffix(".msh"))
        file = {"kind": "file", "path": f"{folder.name}.msh", **geometry}
        write_text(path, yaml_file.to_yaml({**case, "geometry": file}))

    on_root(mesh.mesh.comm, write)
    return load_case(path)
