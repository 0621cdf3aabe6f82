"""Meshes of other programs: Abaqus and CalculiX ``.inp``, FEBio ``.feb``, MED, VTU, XDMF.

Regions are sets of cells by their names; boundaries are surfaces, sets of triangles, and sets of
nodes that contain whole facets. VTU and XDMF name nothing: an array of whole numbers NAME makes
NAME_1, NAME_2, or a and b if it is called a-b, as meshio writes sets. Notes say what is not read.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np

from app.arrays import Ints
from app.mesh_files import arrays, feb, inp
from app.mesh_files.content import Found, left_out

READERS = {
    ".inp": inp.read,
    ".feb": feb.read,
    ".med": arrays.read,
    ".vtu": arrays.read,
    ".xdmf": arrays.read,
}

__all__ = ["READERS", "Found", "left_out", "read"]


@lru_cache(maxsize=1)
def read(path: Path, modified: int) -> Found:
    """Content of a file as it was modified last; its sets of cells are the regions.

    Raises:
        ValueError: The file is damaged or of no use; what is wrong, in words.
    """
    try:
        found = READERS[path.suffix](path)
        found.points = np.asarray(found.points, dtype=float)
        bad = np.flatnonzero(~np.isfinite(found.points).all(axis=1))
        if len(bad):
            raise ValueError(f"node {bad[0] + 1}: its coordinates are no numbers")
        _divide(found)
        for sets in (found.sets, found.triangles, found.nodes):
            _distinct(sets)
    except Exception as error:  # of a damaged file there is no telling which
        cause = f"damaged, or no {path.suffix} file ({type(error).__name__} {error})"
        raise ValueError(str(error) if type(error) is ValueError else cause) from error
    found.told += _hidden(found)
    for kind in ("sets", "triangles", "nodes"):
        setattr(found, kind, {_word(n): part for n, part in getattr(found, kind).items()})
    return found


def _word(name: str) -> str:
    """A name that a case can have."""
    word = re.sub(r"[^A-Za-z0-9_-]", "_", name)
    return word if re.match("[A-Za-z_]", word) else f"_{word}"


def _distinct(sets: Mapping[str, Ints]) -> None:
    """Refuse names that a case cannot tell apart."""
    spelled: dict[str, str] = {}
    for name in sets:
        other = spelled.setdefault(_word(name), name)
        if other != name:
            raise ValueError(
                f"its sets {other} and {name} are both called {_word(name)} here: give one of "
                "them another name; only letters, digits, _ and - count"
            )


def _hidden(found: Found) -> list[str]:
    """A note on sets of nodes whose names are those of surfaces with other nodes."""
    surfaces = {_word(name): part for name, part in found.triangles.items()}
    both = [name for name in found.nodes if _word(name) in surfaces]
    corners = found.cells[:, :4] if both else np.zeros(0)
    hidden = []
    for name in both:
        # A set of nodes holds the middles of edges, too.
        rows = found.nodes[name][np.isin(found.nodes[name], corners)]
        if not np.array_equal(np.unique(surfaces[_word(name)]), np.unique(rows)):
            hidden.append(name)
    return left_out("sets of nodes with the name of a surface of other nodes are left out", hidden)


def _divide(found: Found) -> None:
    """Keep the sets of cells that are regions: not those that smaller and later ones fill."""
    free = np.ones(len(found.cells), dtype=bool)
    left = []
    for name, rows in sorted(reversed(found.sets.items()), key=lambda item: len(item[1])):
        if not free[rows].any():
            left.append(name)
        elif not free[rows].all():
            raise ValueError(
                f"its set {name} shares some cells with smaller ones: keep those sets alone that "
                "are regions, or name them by *SOLID SECTION in an .inp file"
            )
        free[rows] = False
    found.told += left_out("sets without cells of their own are no regions", left)
    if free.all():
        raise ValueError("names no region: it has no set of tetrahedra with a name")
    found.sets = {name: rows for name, rows in found.sets.items() if name not in left}
