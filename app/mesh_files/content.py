"""Content of a mesh file of another program: nodes, cells and named sets."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from app.foundation.arrays import Floats, Ints
from app.foundation.layout import shortened_list

# Order of the nodes of a cell for gmsh. Unlike gmsh, these programs have the middle of the edge 13
# before that of the edge 23.
ORDER = [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]
# The cells of MED are inside out, too.
ORDER_MED = [0, 2, 1, 3, 6, 5, 4, 7, 8, 9]
# Ends of messages.
ONLY = "only straight tetrahedra, or only quadratic ones, can be used"
AGAIN = "export it again from the program that made it"
NO_REGION = "names no region: it has no set of tetrahedra with a name"
NOT_READ = "geometry: cells that are no tetrahedra or triangles are not read"


@dataclass(frozen=True)
class Pick:
    """Parts of a file that make the model: an array of cells, meshes. Empty if it has only one."""

    array: str = ""
    meshes: tuple[str, ...] = ()


@dataclass
class CellBlock:
    """Simplices of one dimension.

    Attributes:
        dim: 2 for triangles, 3 for tetrahedra.
        data: Their nodes, as rows of the nodes of the grid (n, k).
        arrays: Their values by name (n, ...).
    """

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
class FileContent:
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
            raise ValueError(NO_REGION)
        if len({block.shape[1] for block in self.blocks}) > 1:
            raise ValueError(f"has straight and quadratic cells; {ONLY}")
        return np.concatenate(self.blocks).astype(np.int64)

    def add(self, cells: Ints, order: list[int] = ORDER) -> Ints:
        """Add cells; returns their rows."""
        self.blocks.append(cells[:, order[: cells.shape[1]]])
        return np.arange(len(cells)) + sum(map(len, self.blocks[:-1]))


def left_out(title: str, names: Iterable[str]) -> list[str]:
    """Return a note with the first names that are left out; none without a name."""
    names = list(dict.fromkeys(names))
    return [f"geometry: {title}: {shortened_list(names, 10)}"] if names else []


def word(name: str) -> str:
    """Return a name with the characters that a case allows."""
    clean = re.sub(r"[^A-Za-z0-9_-]", "_", name)
    return clean if re.match("[A-Za-z_]", clean) else f"_{clean}"


def case_names(names: Iterable[str]) -> dict[str, str]:
    """Return the names in a case by the names in the file.

    Raises:
        ValueError: Two different names would be the same.
    """
    clean: dict[str, str] = {}
    by_clean: dict[str, str] = {}
    for name in names:
        clean[name] = word(name)
        other_name = by_clean.setdefault(clean[name], name)
        if other_name != name:
            raise ValueError(
                f"its sets {other_name} and {name} are both called {clean[name]} in a case, which "
                "allows letters, digits, _ and -; rename one of them"
            )
    return clean


def rows_of(numbers: Ints, requested: Ints, kind: str) -> Ints:
    """Return the rows of the nodes or cells with the requested numbers, in their shape.

    Raises:
        ValueError: A number occurs twice, or a requested one is missing.
    """
    order = np.argsort(numbers, kind="stable")
    repeated_rows = np.flatnonzero(np.diff(numbers[order]) == 0)
    if len(repeated_rows):
        message = f"{kind} {numbers[order][repeated_rows[0]]} is defined twice"
        raise ValueError(f"{message}; export the model flat, without parts and instances")
    rows = order[np.searchsorted(numbers, requested, sorter=order).clip(max=len(order) - 1)]
    missing_numbers = numbers[rows] != requested
    if missing_numbers.any():
        raise ValueError(
            f"{kind} {requested[missing_numbers][0]} is used, but the file does not define it:"
            f" {AGAIN}"
        )
    return np.asarray(rows)


def same_facets(a: Ints, b: Ints) -> bool:
    """Return True if two lists of triangles (n, 3) are the same surface."""
    first_facets, second_facets = (np.unique(np.sort(block, axis=1), axis=0) for block in (a, b))
    return np.array_equal(first_facets, second_facets)


def extend(sets: dict[str, Ints], names: Iterable[str], part: Ints) -> None:
    """Add members to sets; make sets that are not there."""
    for name in names:
        sets[name] = np.concatenate([sets.get(name, part[:0]), part])


def numbers_in(first: int, last: int | None = None, step: int = 1) -> Ints:
    """Return the numbers of a range; without a last number, the first one."""
    return np.arange(first, (first if last is None else last) + 1, step)
