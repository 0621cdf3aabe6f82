"""FEBio 2.5 to 4 ``.feb`` files: blocks of elements, surfaces, sets of nodes."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from app.arrays import Ints
from app.mesh_files.content import ONLY, Found, extend, left_out, rows_of

KIND = re.compile(r"(tet|tri)(3|4|6|10)(G\w+)?", re.IGNORECASE)


def read(path: Path) -> Found:
    """Nodes, cells and sets of a file.

    Raises:
        ValueError: A block is damaged or of another type, or a name is there twice.
    """
    found, root = Found(), ET.parse(path).getroot()
    mesh = [part for grid in root if grid.tag in ("Mesh", "Geometry") for part in grid]
    items = [node for part in mesh if part.tag == "Nodes" for node in part]
    found.points = _table("Nodes", (node.text or "" for node in items), 3, float)
    number = np.array([_attribute(node, "id", "Nodes") for node in items]).astype(np.int64)
    other = []
    materials: dict[str, str] = {}
    for part in mesh:
        material = part.get("mat", "")
        name = part.get("name", f"{part.tag}{material}")
        if part.tag == "Elements":
            kinds = {_attribute(part, "type", name)}
        else:
            kinds = {e.tag for e in part}
        known = [KIND.fullmatch(k) for k in kinds]
        if part.tag in ("Elements", "Surface") and not all(known):
            raise ValueError(f"{name}: is of type {', '.join(sorted(kinds))}; {ONLY}")
        if part.tag == "Elements" and known[0]:
            if materials.setdefault(name, material) != material:
                raise ValueError(f"{name}: two <Elements> of two materials have this name")
            table = _table(name, (e.text or "" for e in part), int(known[0][2]), int)
            cells = rows_of(number, table, "node")
            if known[0][1].lower() == "tri":
                extend(found.triangles, name, cells[:, :3])
            else:
                extend(found.sets, name, found.add(cells))
        elif part.tag == "Surface":
            corners = (",".join((e.text or "").split(",")[:3]) for e in part)
            extend(found.triangles, name, rows_of(number, _table(name, corners, 3, int), "node"))
        elif part.tag == "NodeSet":
            extend(found.nodes, name, rows_of(number, _members(part, name), "node"))
        elif part.tag != "Nodes":
            other.append(f"{part.tag} {name}")
    found.told += left_out("of the file's mesh are not read", other)
    return found


def _attribute(part: ET.Element, key: str, name: str) -> str:
    """Attribute of an element of the file.

    Raises:
        ValueError: It has none.
    """
    if key not in part.attrib:
        raise ValueError(f"{name}: <{part.tag}> has no attribute {key}")
    return part.attrib[key]


def _table(name: str, texts: Iterable[str], width: int, kind: type) -> Any:
    """Numbers apart by commas or blanks (n, width)."""
    words = " ".join(texts).replace(",", " ").split()
    try:
        numbers: Any = np.array(words, dtype=kind)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    if len(numbers) % width:
        text = f"{name}: {len(numbers)} numbers are no rows of {width}: is it cut short?"
        raise ValueError(text)
    return numbers.reshape(-1, width)


def _members(part: ET.Element, name: str) -> Ints:
    """Numbers in a set of nodes: single ones, and ranges ``first:last:step``."""
    words = (part.text or "").replace(",", " ").split()
    words += [_attribute(node, "id", name) for node in part]
    parts = [np.zeros(0, dtype=np.int64)]
    for word in words:
        match = re.fullmatch(r"(\d{1,9})(?::(\d{1,9}))?(?::(\d{1,9}))?", word)
        if not match or (match[3] and not int(match[3])):
            raise ValueError(f"{name}: '{word}' is no node, nor a range first:last:step")
        first = int(match[1])
        parts.append(np.arange(first, int(match[2] or first) + 1, int(match[3] or 1)))
    return np.concatenate(parts)
