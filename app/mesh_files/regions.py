"""Regions and boundaries by the arrays of cells of VTU and XDMF files."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from app.foundation.arrays import Ints
from app.mesh_files.content import CellBlock, CellGrid, FileContent, extend, left_out

MOST_VALUES = 255  # different values of an array of regions, at most
# Names of arrays of regions, and of arrays that number cells, their kinds or processes.
REGIONS = re.compile(
    "material|region|label|part(?!ition)|tissue|domain|physical|segment|tags?$|^mat(_?id)?$",
    re.IGNORECASE,
)
BOOKKEEPING = re.compile(
    "global|element_?(type|id)|cell_?(ids?|type|number)|ghost|process|^ids?$|partition|rank|original"
    "|geometrical",
    re.IGNORECASE,
)

Names = tuple[str, ...]


def fill_regions(content: FileContent, grid: CellGrid, array: str = "") -> None:
    """Put cells into regions, and triangles into boundaries, by the values of their arrays.

    Blocks whose arrays have the same names use the same array, the given one if there is one. A
    grid may repeat the cells of another one with an array, as DOLFINx writes tags: these cells are
    taken once. Triangles of other grids make boundaries by all of their arrays.

    Raises:
        ValueError: No array has whole numbers of regions, or several arrays disagree.
    """
    content.points = grid.points
    content.notes += grid.notes
    solids, flats = ([b for b in grid.blocks if b.dim == dim] for dim in (3, 2))
    cells = _cells(grid.points, solids)
    keys = _keys(solids, cells, array)
    boundary_arrays = {names: _candidates(arrays) for names, arrays in _joined(flats).items()}
    boundary_arrays |= {
        names: [key] for names, key in keys.items() if key and names in boundary_arrays
    }
    regions = dict.fromkeys(key for key in keys.values() if key)
    boundaries = dict.fromkeys(
        key for keys_of_side in boundary_arrays.values() for key in keys_of_side
    )
    used_arrays = regions | boundaries
    title = {key: _title(key, grid.blocks) for key in used_arrays}
    tagged = [
        numbers_of_block
        for numbers_of_block, b in zip(cells, solids, strict=True)
        if keys[tuple(b.arrays)]
    ]
    tagged_cells = np.concatenate([np.zeros(0, dtype=np.int64), *tagged])
    for block, numbers in zip(solids, cells, strict=True):
        key = keys[tuple(block.arrays)]
        rows = np.flatnonzero(bool(key) | ~np.isin(numbers, tagged_cells))
        if len(rows):
            added_cells = content.add(block.data[rows])
            if key:
                _add_to_sets(content.sets, block.arrays[key], title[key], added_cells)
    for block in flats:
        for key in boundary_arrays[tuple(block.arrays)]:
            _add_to_sets(content.triangles, block.arrays[key], title[key], block.data[:, :3])
    only_boundaries = [key for key in boundaries if key not in regions]
    for title_of_kind, names in (("regions", regions), ("boundaries", only_boundaries)):
        content.notes += [
            f"geometry: {title_of_kind} are the values of the array {key}" for key in names
        ]
    all_names = [name for block in grid.blocks for name in block.arrays]
    content.notes += left_out(
        "arrays of cells that are not read", (name for name in all_names if name not in used_arrays)
    )


def _keys(solids: Sequence[CellBlock], cells: Sequence[Ints], array: str) -> dict[Names, str]:
    """Return the array that makes regions, "" for none, by the names of arrays of blocks."""
    blocks_by_names = _joined(solids)
    if array:
        return _given_array(array, blocks_by_names)
    keys = {names: choice(arrays) for names, arrays in blocks_by_names.items()}
    dropped = _overruled(solids, cells, keys)
    return {names: "" if key in dropped else key for names, key in keys.items()}


def _given_array(
    array: str, blocks_by_names: Mapping[Names, Mapping[str, np.ndarray]]
) -> dict[Names, str]:
    """Return the array that the case gives, "" where it is missing, by the names of arrays."""
    if not any(array in names for names in blocks_by_names):
        present_arrays = (
            ", ".join(dict.fromkeys(name for names in blocks_by_names for name in names)) or "none"
        )
        raise ValueError(f"has no array {array} of its cells; its arrays: {present_arrays}")
    if any(
        array in names and array not in _integer_arrays(arrays)
        for names, arrays in blocks_by_names.items()
    ):
        message = (
            f"does not number regions; expected whole numbers, at most {MOST_VALUES} different ones"
        )
        raise ValueError(f"its array {array} {message}")
    return {names: array if array in names else "" for names in blocks_by_names}


def _add_to_sets(
    sets: dict[str, Ints], values: np.ndarray, title: Callable[[float], list[str]], members: Ints
) -> None:
    """Add members to the sets of their values."""
    for value in np.unique(values[np.isfinite(values) & (values == np.round(values))]):
        extend(sets, title(value), members[values == value])


def _joined(blocks: Sequence[CellBlock]) -> dict[Names, dict[str, np.ndarray]]:
    """Concatenate the arrays of blocks with the same names of arrays; return them by these."""
    blocks_of_names: dict[Names, list[CellBlock]] = {}
    for block in blocks:
        blocks_of_names.setdefault(tuple(block.arrays), []).append(block)
    return {
        names: {name: np.concatenate([b.arrays[name] for b in group]) for name in names}
        for names, group in blocks_of_names.items()
    }


def _cells(points: np.ndarray, blocks: Sequence[CellBlock]) -> list[Ints]:
    """Return numbers of the cells of each block, equal for cells with the same corners.

    If all blocks have arrays of the same names, cells are not compared.
    """
    block_ends = np.cumsum([len(block.data) for block in blocks])
    if len({tuple(block.arrays) for block in blocks}) < 2:
        return np.split(np.arange(block_ends[-1]), block_ends[:-1]) if blocks else []
    place = np.unique(points, axis=0, return_inverse=True)[1].ravel()
    corners = np.concatenate([np.sort(place[block.data[:, :4]], axis=1) for block in blocks])
    number = np.unique(corners, axis=0, return_inverse=True)[1].ravel()
    return np.split(number, block_ends[:-1])


def _overruled(
    blocks: Sequence[CellBlock], cells: Sequence[Ints], keys: Mapping[Names, str]
) -> set[str]:
    """Return the arrays that divide the same cells as another array that `choice` prefers."""
    preferred: dict[str, tuple[Ints, np.ndarray]] = {}
    dropped: set[str] = set()
    for key in dict.fromkeys(key for key in keys.values() if key):
        block_rows = [k for k, block in enumerate(blocks) if keys[tuple(block.arrays)] == key]
        own_cells = np.concatenate([cells[k] for k in block_rows])
        values = np.concatenate([blocks[k].arrays[key] for k in block_rows])
        for other, (numbers, others) in list(preferred.items()):
            _, i, j = np.intersect1d(own_cells, numbers, return_indices=True)
            if len(i):
                best_key = choice({other: others[j], key: values[i]})
                dropped.add(key if best_key == other else other)
        preferred[key] = own_cells, values
        preferred = {name: pair for name, pair in preferred.items() if name not in dropped}
    return dropped


def _integer_arrays(arrays: Mapping[str, np.ndarray]) -> dict[str, Ints]:
    """Return the arrays of integers or floats that have few different whole numbers."""
    integer_arrays = {}
    for name, values in arrays.items():
        finite = values.ndim == 1 and values.dtype.kind in "iuf" and bool(np.isfinite(values).all())
        if finite and len(values) and (values == np.round(values)).all():
            if abs(values).max() < 2**53 and len(np.unique(values)) <= MOST_VALUES:
                integer_arrays[name] = values.astype(np.int64)
    return integer_arrays


def _candidates(arrays: Mapping[str, np.ndarray]) -> list[str]:
    """Return the names of arrays of few whole numbers that are no numbers or kinds of cells."""
    return [name for name in _integer_arrays(arrays) if not BOOKKEEPING.search(name)]


def choice(arrays: Mapping[str, np.ndarray]) -> str:
    """Return the name of the array that makes regions, "" if there are no arrays.

    Only arrays of few whole numbers are candidates. Arrays with the name of regions are preferred
    to others, and arrays that differ between cells to constant ones. Arrays of numbers and kinds
    of cells and processes are no regions.

    Raises:
        ValueError: No array has whole numbers, or several divide the cells differently.
    """
    integer_arrays = _integer_arrays(arrays)
    candidates = _candidates(arrays)
    named = [n for n in candidates if REGIONS.search(n) or "-" in n]
    pool = named or candidates
    differing = [n for n in pool if len(np.unique(integer_arrays[n])) > 1]
    if named and not differing:
        varying_arrays = [n for n in candidates if len(np.unique(integer_arrays[n])) > 1]
        differing = [*named[:1], *varying_arrays] if varying_arrays else []
    pool = differing or pool
    integers = [n for n in pool if arrays[n].dtype.kind in "iu"]
    pool = integers or pool
    if len(pool) > 1 and any(
        _divides(integer_arrays[n]) != _divides(integer_arrays[pool[0]]) for n in pool
    ):
        raise ValueError(
            f"its arrays {', '.join(pool)} give different regions; set `geometry.array` to one of "
            "them"
        )
    if pool or not arrays:
        return pool[0] if pool else ""
    raise ValueError(
        f"names no region: no array of its cells ({', '.join(arrays)}) has whole numbers with at "
        f"most {MOST_VALUES} different values; set `geometry.array` if one of them"
        " numbers the regions"
    )


def _title(key: str, blocks: Sequence[CellBlock]) -> Callable[[float], list[str]]:
    """Return the function that names the sets of a value: KEY_1, or a and b if it is called a-b."""
    names = key.split("-")
    largest = max(np.fmax.reduce(b.arrays[key], initial=0) for b in blocks if key in b.arrays)
    if largest >= len(names):
        return lambda value: [f"{key}_{int(value)}"]
    return lambda value: names[int(value) : int(value) + 1] if value >= 0 else []


def _divides(values: Ints) -> list[int]:
    """Return the first cell with the value of each cell: equal for arrays that divide alike."""
    _, first_rows, inverse = np.unique(values, return_index=True, return_inverse=True)
    return list(map(int, first_rows[inverse]))
