"""Cells that a mesh is divided at: a table of their centres, written and read."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from functools import lru_cache
from pathlib import Path

Point3 = tuple[float, float, float]

COLUMNS = ("pass", "x_mm", "y_mm", "z_mm")


def text(passes: Iterable[Iterable[Sequence[float]]]) -> str:
    """The table of centres [mm], pass by pass."""
    rows = [
        f"{k},{x:.6f},{y:.6f},{z:.6f}"
        for k, places in enumerate(passes, start=1)
        for x, y, z in places
    ]
    return "\n".join([",".join(COLUMNS), *rows, ""])


def read(path: Path) -> tuple[tuple[Point3, ...], ...]:
    """Centres [mm] of the cells of each pass.

    Raises:
        OSError: The file cannot be read.
        ValueError: It is not such a table; with the line.
    """
    return _read(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=8)
def _read(path: Path, modified: int) -> tuple[tuple[Point3, ...], ...]:
    """The same; `modified` renews it."""
    with path.open(encoding="utf-8", newline="") as file:
        title, *rows = [*csv.reader(file)] or [[]]
    if tuple(title) != COLUMNS:
        raise ValueError(f"does not begin with the line {','.join(COLUMNS)}")
    passes: list[list[Point3]] = []
    for line, row in enumerate(rows, start=2):
        try:
            number, (x, y, z) = int(row[0]), map(float, row[1:])
            if not all(map(math.isfinite, (x, y, z))):
                raise ValueError
        except (ValueError, IndexError):
            raise ValueError(f"line {line} is not a pass and three coordinates") from None
        if number not in (len(passes), len(passes) + 1) or not number:
            raise ValueError(f"line {line}: passes are not numbered 1, 2, .. in turn")
        if number > len(passes):
            passes.append([])
        passes[-1].append((x, y, z))
    return tuple(map(tuple, passes))
