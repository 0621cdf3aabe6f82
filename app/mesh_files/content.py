"""Content of a mesh file of another program, and what its readers share."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from app.arrays import Floats, Ints

# Middle nodes in gmsh's order: other programs exchange the last two.
ORDER = [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]
ONLY = "only straight tetrahedra, or only quadratic ones, can be used"
# Names that a message lists.
LISTED = 10


@dataclass
class Found:
    """Nodes (n, 3), cells (m, 4 or 10) in gmsh's order, and named sets of a file.

    Sets of cells are rows of ``cells``; triangles (k, 3) and sets of nodes rows of ``points``.
    ``told`` are notes on what was left out or chosen.
    """

    points: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    blocks: list[Ints] = field(default_factory=list)
    sets: dict[str, Ints] = field(default_factory=dict)
    triangles: dict[str, Ints] = field(default_factory=dict)
    nodes: dict[str, Ints] = field(default_factory=dict)
    told: list[str] = field(default_factory=list)

    @property
    def cells(self) -> Ints:
        """All cells (m, 4 or 10).

        Raises:
            ValueError: There are none, or straight and quadratic ones.
        """
        if not self.blocks:
            raise ValueError("names no region: it has no set of tetrahedra with a name")
        if len({block.shape[1] for block in self.blocks}) > 1:
            raise ValueError(f"has straight and quadratic cells; {ONLY}")
        return np.concatenate(self.blocks).astype(np.int64)

    def add(self, cells: Ints, order: list[int] = ORDER) -> Ints:
        """Add cells in a program's order; return their rows."""
        before = sum(map(len, self.blocks))
        self.blocks.append(cells[:, order[: cells.shape[1]]])
        return np.arange(before, before + len(cells))


def left_out(what: str, names: Iterable[str]) -> list[str]:
    """A note on names that are left out, if there are any."""
    names = list(dict.fromkeys(names))
    more = f" and {len(names) - LISTED} more" if names[LISTED:] else ""
    return [f"geometry: {what}: {', '.join(names[:LISTED])}{more}"] if names else []


def extend(sets: dict[str, Ints], name: str, part: Ints) -> None:
    """Add members to a set, which is made if it is new."""
    sets[name] = np.concatenate([sets.get(name, part[:0]), part])


def rows_of(numbers: Ints, wanted: Ints, what: str) -> Ints:
    """Rows of the nodes or cells with the wanted numbers, in the shape of ``wanted``.

    Raises:
        ValueError: A number is there twice, or is missing.
    """
    by = np.argsort(numbers, kind="stable")
    again = np.flatnonzero(np.diff(numbers[by]) == 0)
    if len(again):
        text = f"{what} {numbers[by][again[0]]} is there twice"
        raise ValueError(f"{text}; save a model of parts as one, without parts and instances")
    if not len(by) and wanted.size:
        raise ValueError(f"{what} {wanted.flat[0]} is used, but is not in the file")
    at = by[np.searchsorted(numbers, wanted, sorter=by).clip(max=len(by) - 1)]
    wrong = numbers[at] != wanted
    if wrong.any():
        raise ValueError(f"{what} {wanted[wrong][0]} is used, but is not in the file")
    return np.asarray(at)
