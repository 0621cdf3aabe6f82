"""Content of a mesh file of another program: nodes, cells and named sets."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from app.arrays import Floats, Ints

# These programs number the middles of edges alike, and that of 13 before that of 23, unlike gmsh.
ORDER = [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]
# The cells of MED are inside out, too.
ORDER_MED = [0, 2, 1, 3, 6, 5, 4, 7, 8, 9]
ONLY = "only straight tetrahedra, or only quadratic ones, can be used"


@dataclass(frozen=True)
class Pick:
    """Parts of a file that make the model: an array of cells, meshes; empty: the only ones."""

    array: str = ""
    meshes: tuple[str, ...] = ()


@dataclass
class CellBlock:
    """Simplices of one dimension, nodes as rows of the grid's (n, k), with their data (n, ...)."""

    dim: int
    data: Ints
    arrays: dict[str, np.ndarray] = field(default_factory=dict)


@dataclass
class CellGrid:
    """Nodes (n, 3), blocks of cells, and notes on what was left out."""

    points: Floats
    blocks: list[CellBlock]
    notes: list[str]


@dataclass
class Found:
    """Content of a mesh file: nodes (n, 3), cells (m, 4 or 10) in gmsh's order, and named sets.

    Sets of cells are rows of ``cells``; triangles (k, 3) and sets of nodes rows of ``points``.
    """

    points: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    blocks: list[Ints] = field(default_factory=list)
    sets: dict[str, Ints] = field(default_factory=dict)
    triangles: dict[str, Ints] = field(default_factory=dict)
    nodes: dict[str, Ints] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    @property
    def cells(self) -> Ints:
        """All cells."""
        if not self.blocks:
            raise ValueError("names no region: it has no set of tetrahedra with a name")
        if len({block.shape[1] for block in self.blocks}) > 1:
            raise ValueError(f"has straight and quadratic cells; {ONLY}")
        return np.concatenate(self.blocks).astype(np.int64)

    def add(self, cells: Ints, order: list[int] = ORDER) -> Ints:
        """Add cells; returns their rows."""
        self.blocks.append(cells[:, order[: cells.shape[1]]])
        return np.arange(len(cells)) + sum(map(len, self.blocks[:-1]))


def left_out(what: str, names: Iterable[str]) -> list[str]:
    """A line about what is left out, if anything is."""
    names = list(dict.fromkeys(names))
    more = f" and {len(names) - 10} more" if names[10:] else ""
    return [f"geometry: {what}: {', '.join(names[:10])}{more}"] if names else []


def word(name: str) -> str:
    """Name that a case can have."""
    clean = re.sub(r"[^A-Za-z0-9_-]", "_", name)
    return clean if re.match("[A-Za-z_]", clean) else f"_{clean}"


def case_names(names: Iterable[str]) -> dict[str, str]:
    """Names that a case can have, by the names in the file.

    Raises:
        ValueError: Two different names would be the same.
    """
    clean: dict[str, str] = {}
    by_clean: dict[str, str] = {}
    for name in names:
        clean[name] = word(name)
        other = by_clean.setdefault(clean[name], name)
        if other != name:
            raise ValueError(
                f"its sets {other} and {name} are both called {clean[name]} here; "
                "rename one of them"
            )
    return clean


def rows_of(numbers: Ints, wanted: Ints, what: str) -> Ints:
    """Rows of the nodes or cells that have some numbers, in the shape of those."""
    by = np.argsort(numbers, kind="stable")
    again = np.flatnonzero(np.diff(numbers[by]) == 0)
    if len(again):
        text = f"{what} {numbers[by][again[0]]} is there twice"
        raise ValueError(f"{text}; save a model of parts as one, without parts and instances")
    at = by[np.searchsorted(numbers, wanted, sorter=by).clip(max=len(by) - 1)]
    wrong = numbers[at] != wanted
    if wrong.any():
        raise ValueError(f"{what} {wanted[wrong][0]} is used, but is not in the file")
    return np.asarray(at)


def extend(sets: dict[str, Ints], names: Iterable[str], part: Ints) -> None:
    """Add members to sets, which are made where they are not there."""
    for name in names:
        sets[name] = np.concatenate([sets.get(name, part[:0]), part])
