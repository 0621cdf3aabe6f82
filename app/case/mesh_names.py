"""Names of regions and surfaces in a mesh file, read without gmsh.

Files are ``.msh``, ``.geo``, and those of other programs.
"""

from __future__ import annotations

import hashlib
import os
import re
import struct
from functools import lru_cache
from pathlib import Path

import configs
from app import mesh_files
from app.mesh_files import EVERYTHING, Pick, named

ENTRY = re.compile(rb'\s*(\d+)\s+\d+\s+"(.*)"\s*')
# The sections before the nodes are short; a file without names is not read to its end.
HEADER = 4 << 20
# Scripts: comments go, text in quotes stays.
COMMENT = re.compile(r"""("[^"\n]*"|'[^'\n]*')|//[^\n]*|/\*.*?(?:\*/|\Z)""", re.DOTALL)
# A declaration of constants, and each constant in it.
DECLARATION = re.compile(r"\bDefineConstant\s*\[(.*?)\]\s*;", re.DOTALL)
CONSTANT = re.compile(r"(?:^|,)\s*([A-Za-z_]\w*)\s*(?==)")
GROUP = re.compile(r'\bPhysical\s+(Volume|Surface)\s*\(\s*"([^"\n]*)"')
DIMENSIONS = {"Volume": 3, "Surface": 2}
# Environment variable: the user trusts the scripts of this command.
ALLOWED = "MANTLE_ALLOW_SCRIPTS"


def physical_names(path: Path, dimension: int, pick: Pick = EVERYTHING) -> tuple[str, ...]:
    """Names of the physical groups of one dimension, in the order of the file.

    It is a ``.msh`` file of format 2.2 or 4.1, a ``.geo`` script, or of another program, of which
    parts may be picked.

    Raises:
        ValueError: The file is not of this format; the script does not use its parameter, or is
            not allowed to run.
    """
    mesh_files.check(path, pick)
    if path.suffix.lower() in mesh_files.READERS:
        mesh_file = mesh_files.read(path, pick)
        return tuple(mesh_file.sets if dimension == 3 else mesh_file.triangles | mesh_file.nodes)
    dimensions_and_names = _groups(path, path.stat().st_mtime_ns)
    return tuple(
        mesh_files.case_names(
            name for group_dimension, name in dimensions_and_names if group_dimension == dimension
        ).values()
    )


@lru_cache(maxsize=8)
def _groups(path: Path, modified: int) -> tuple[tuple[int, str], ...]:
    """Dimension and name of every physical group; `modified` invalidates the cache."""
    readers = {".geo": _groups_of_script, ".msh": _groups_of_mesh}
    suffix = path.suffix.lower()
    if suffix not in readers:
        other_formats = ", ".join([*readers, *mesh_files.READERS])
        raise ValueError(f"is not one of {other_formats}; gmsh or ParaView can convert it")
    return tuple(dict.fromkeys(readers[suffix](path)))


def _groups_of_mesh(path: Path) -> list[tuple[int, str]]:
    with path.open("rb") as file:
        header = file.read(HEADER)
    if not header.startswith(b"$MeshFormat"):
        raise ValueError("not a gmsh .msh file (it does not start with $MeshFormat)")
    if header.split(b"\n", 2)[1].split()[:1] not in ([b"2.2"], [b"4.1"]):
        raise ValueError("not of .msh format 2.2 or 4.1; save it again with gmsh")
    section = header.partition(b"$PhysicalNames")[2].partition(b"$EndPhysicalNames")[0]
    matches = map(ENTRY.fullmatch, section.split(b"\n"))
    try:
        return [(int(m[1]), m[2].decode()) for m in matches if m]
    except UnicodeDecodeError as error:
        name = error.object.decode("latin-1")
        raise ValueError(
            f"a name in it is not text in UTF-8, perhaps {name}; save it as UTF-8, or rename it"
        ) from error


def _groups_of_script(path: Path) -> list[tuple[int, str]]:
    if not (os.environ.get(ALLOWED) or path.resolve().is_relative_to(configs.FOLDER)):
        raise ValueError(
            "a gmsh script is a program that can change files; add --allow-scripts to run it"
        )
    script_text = _script(path)
    if not re.search(r"\bsize\b", script_text):
        raise ValueError("the script has no parameter 'size'; expected DefineConstant[ size = 1 ];")
    return [(DIMENSIONS[m[1]], m[2]) for m in GROUP.finditer(script_text)]


def _script(path: Path) -> str:
    """Text of a script without its comments."""
    return COMMENT.sub(lambda m: m[1] or " ", path.read_text("utf-8", "replace"))


def constants(path: Path) -> tuple[str, ...]:
    """Names of the constants that a ``.geo`` script declares, in its order."""
    blocks = DECLARATION.findall(_script(path))
    return tuple(name for block in blocks for name in CONSTANT.findall(block))


def content_hash(path: Path, copies: Path | None = None) -> str:
    """Hash of a file and of the files that it names; copy them to a folder on demand."""
    digest = hashlib.sha256()
    for name in named.names(path):
        file_bytes = (path.parent / name).read_bytes()
        digest.update(
            f"{len(file_bytes)} {name if name != path.name else ''}\0".encode() + file_bytes
        )
        if copies:
            copied_file = copies / name
            copied_file.parent.mkdir(parents=True, exist_ok=True)
            copied_file.write_bytes(file_bytes)
    return digest.hexdigest()


def counts(path: Path, pick: Pick) -> int:
    """Number of cells, in a ``.msh`` file of all dimensions as announced; 0 if unknown."""
    if path.suffix.lower() in mesh_files.READERS:
        return len(mesh_files.read(path, pick).cells)
    data = path.read_bytes()
    elements = data.partition(b"$Elements\n")[2]
    try:
        version, binary = data.split(b"\n", 2)[1].split()[:2]
        if version == b"4.1" and binary == b"1":
            announced = int(struct.unpack_from("<QQ", elements)[1])
        else:
            announced = int(elements.split(maxsplit=2)[1 if version == b"4.1" else 0])
    except (ValueError, IndexError, struct.error):
        return 0
    # An element takes at least a byte: a file that announces more is damaged.
    return min(max(announced, 0), len(data))
