"""What the header of a gmsh ``.msh`` file, or the text of a ``.geo``, tells without gmsh."""

from __future__ import annotations

import hashlib
import re
import struct
from functools import lru_cache
from pathlib import Path

ENTRY = re.compile(rb'\s*(\d+)\s+(\d+)\s+"(.*)"\s*')
# The sections before the nodes are short; a file without names is not read to its end.
HEADER = 4 << 20
# Scripts: comments go, text in quotes stays.
COMMENT = re.compile(r'("[^"\n]*")|//[^\n]*|/\*.*?\*/', re.DOTALL)
GROUP = re.compile(r'\bPhysical\s+(Volume|Surface)\s*\(\s*"([^"\n]*)"')
DIMENSIONS = {"Volume": 3, "Surface": 2}


def is_script(path: Path) -> bool:
    """Whether a file is a ``.geo`` script, still to be meshed."""
    return path.suffix == ".geo"


def physical_names(path: Path, dimension: int) -> tuple[str, ...]:
    """Names of the physical groups of one dimension.

    Args:
        path: A ``.msh`` file of format 2.2 or 4.1, ASCII or binary, or a ``.geo`` script.
        dimension: 3 for volumes, 2 for surfaces.

    Returns:
        The names, in the order of the file.

    Raises:
        ValueError: The file is not of this format, or the script does not use its parameter.
    """
    return tuple(name for d, name in _names(path, path.stat().st_mtime_ns) if d == dimension)


@lru_cache(maxsize=8)
def _names(path: Path, modified: int) -> tuple[tuple[int, str], ...]:
    """(dimension, name) of every physical group; `modified` renews the cache."""
    if is_script(path):
        return _groups(path.read_bytes())
    with path.open("rb") as file:
        header = file.read(HEADER)
    if not header.startswith(b"$MeshFormat"):
        raise ValueError("not a gmsh .msh file (it does not start with $MeshFormat)")
    version = header.split(b"\n", 2)[1].split()[:1]
    if version not in ([b"2.2"], [b"4.1"]):
        raise ValueError("not of .msh format 2.2 or 4.1; save it again with gmsh")
    _, found, rest = header.partition(b"$PhysicalNames")
    if not found:
        return ()
    section = rest.partition(b"$EndPhysicalNames")[0]
    matches = (ENTRY.fullmatch(line) for line in section.split(b"\n"))
    return tuple((int(m[1]), m[3].decode("utf-8", "replace")) for m in matches if m)


def _groups(content: bytes) -> tuple[tuple[int, str], ...]:
    """(dimension, name) of the groups that a script names."""
    text = COMMENT.sub(lambda m: m[1] or " ", content.decode("utf-8", "replace"))
    if not re.search(r"\bsize\b", text):
        raise ValueError("the script has no parameter 'size'; expected DefineConstant[ size = 1 ];")
    return tuple(dict.fromkeys((DIMENSIONS[m[1]], m[2]) for m in GROUP.finditer(text)))


def content(path: Path) -> str:
    """Hash of a file, and of the files that a script names (geometry that it merges)."""
    raw = path.read_bytes()
    digest = hashlib.sha256(raw)
    if is_script(path):
        for name in re.findall(r'"([^"\n]+)"', raw.decode("utf-8", "replace")):
            other = path.parent / name
            if other.is_file():
                digest.update(name.encode() + other.read_bytes())
    return digest.hexdigest()


def counts(path: Path) -> int:
    """Number of elements of all dimensions that the file announces, or 0 if it cannot be told."""
    if is_script(path):
        return 0
    data = path.read_bytes()
    version, binary = data.split(b"\n", 2)[1].split()[:2]
    _, found, rest = data.partition(b"$Elements\n")
    if not found:
        return 0
    if version == b"4.1" and binary == b"1":
        return int(struct.unpack_from("<QQ", rest)[1])
    fields = rest.split(b"\n", 1)[0].split()
    return int(fields[1] if version == b"4.1" else fields[0])
