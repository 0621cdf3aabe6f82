"""Which physical volumes of a gmsh ``.msh`` file have cells, read without gmsh."""

from __future__ import annotations

import re
import struct
from collections.abc import Collection, Iterator

# Nodes of each type of element (gmsh's numbers), and the types of dimension 3.
NODES = {15: 1, 1: 2, 8: 3, 26: 4, 2: 3, 9: 6, 21: 10, 3: 4, 10: 9, 16: 8}
SOLID = {4: 4, 11: 10, 29: 20, 5: 8, 12: 27, 17: 20, 6: 6, 13: 18, 18: 15, 7: 5, 14: 14, 19: 13}


def with_cells(data: bytes, tags: Collection[int]) -> set[int]:
    """Tags of physical volumes that have cells.

    Args:
        data: The content of a file of format 2.2 or 4.1.
        tags: All tags of physical volumes.

    Returns:
        Some of `tags`; all of them where the file cannot be understood.
    """
    try:
        version, binary = data.split(b"\n", 2)[1].split()[:2]
        if version == b"4.1":
            volumes = dict(_binary_volumes(data) if binary == b"1" else _volumes(data))
            blocks = _binary_blocks(data) if binary == b"1" else _blocks(data)
            return {tag for entity in blocks for tag in volumes[entity]} & set(tags)
        if binary == b"1":
            return set(_binary_elements(data)) & set(tags)
        elements = _section(data, b"Elements")
        kinds = b"|".join(b"%d" % kind for kind in SOLID)
        row = rb"\n\d+ (?:%s) \d+ %d "
        return {tag for tag in tags if re.search(row % (kinds, tag), elements)}
    except (ValueError, IndexError, KeyError, struct.error):
        return set(tags)


def _section(data: bytes, name: bytes) -> bytes:
    """What stands between ``$name`` and ``$Endname``."""
    start = data.index(b"$%s\n" % name) + len(name) + 2
    return data[start : data.index(b"$End%s" % name, start)]


def _volumes(data: bytes) -> Iterator[tuple[int, list[int]]]:
    """Volumes and their physical tags, of text."""
    first, *rows = _section(data, b"Entities").split(b"\n")
    *lower, number = map(int, first.split())
    for row in rows[sum(lower) :][:number]:
        fields = row.split()
        yield int(fields[0]), [int(tag) for tag in fields[8 : 8 + int(fields[7])]]


def _blocks(data: bytes) -> Iterator[int]:
    """Volumes that have cells, of text."""
    first, *rows = _section(data, b"Elements").split(b"\n")
    at = 0
    for _ in range(int(first.split()[0])):
        dimension, entity, _, number = map(int, rows[at].split())
        if dimension == 3 and number:
            yield entity
        at += 1 + number


def _binary_volumes(data: bytes) -> Iterator[tuple[int, list[int]]]:
    at = data.index(b"$Entities\n") + 10
    numbers = struct.unpack_from("<4Q", data, at)
    at += 32
    for dimension, number in enumerate(numbers):
        for _ in range(number):
            (entity,) = struct.unpack_from("<i", data, at)
            at += 4 + 8 * (6 if dimension else 3)
            lists = []
            for _ in range(2 if dimension else 1):
                (length,) = struct.unpack_from("<Q", data, at)
                lists.append(list(struct.unpack_from(f"<{length}i", data, at + 8)))
                at += 8 + 4 * length
            if dimension == 3:
                yield entity, lists[0]


def _binary_blocks(data: bytes) -> Iterator[int]:
    at = data.index(b"$Elements\n") + 10
    (number,) = struct.unpack_from("<Q", data, at)
    at += 32
    for _ in range(number):
        dimension, entity, kind, length = struct.unpack_from("<3iQ", data, at)
        if dimension == 3 and length:
            yield entity
        at += 20 + 8 * length * (1 + (NODES | SOLID)[kind])


def _binary_elements(data: bytes) -> Iterator[int]:
    at = data.index(b"$Elements\n") + 10
    number = data[at : at + 20].partition(b"\n")[0]
    at += len(number) + 1
    left = int(number)
    while left > 0:
        kind, length, labels = struct.unpack_from("<3i", data, at)
        if min(length, labels) < 0:
            raise ValueError("a block that is less than empty")
        at += 12
        width = 4 * (1 + labels + (NODES | SOLID)[kind])
        if kind in SOLID:
            for element in range(length):
                yield struct.unpack_from("<i", data, at + element * width + 4)[0]
        at += length * width
        left -= max(length, 1)
