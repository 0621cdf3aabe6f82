"""Physical groups of ``.msh`` files of format 2.2.

In these files a group belongs to an element. gmsh gives groups to entities: where elements of
several groups have the same entity, as other programs write them, all are in all of the groups.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np

FORMAT = b"2.2"


class _Element(NamedTuple):
    """An element as the file has it; without tags its group and entity are 0."""

    number: int
    kind: int
    group: int
    entity: int
    nodes: tuple[int, ...]


def keep_apart(path: Path, gmsh: ModuleType) -> None:
    """Give elements of different groups different entities, in place.

    A file of another format, or whose elements need no change or cannot be read, stays as it is.
    """
    file_bytes = path.read_bytes()
    head, begin_mark, after_begin = file_bytes.partition(b"$Elements")
    body, end_mark, tail = after_begin.partition(b"$EndElements")
    format_words = head.partition(b"$MeshFormat")[2].split(maxsplit=3)
    if not end_mark or format_words[:1] != [FORMAT]:
        return
    is_binary = format_words[1] == b"1"
    try:
        if is_binary:
            order = "<" if format_words[3][:4] == b"\1\0\0\0" else ">"
            integer = np.dtype(f"{order}i4")
            elements = [*_binary(body, integer, gmsh)]
        else:
            elements = [*_text(body)]
        kinds = {element.kind for element in elements}
        dimension = {kind: gmsh.model.mesh.getElementProperties(kind)[1] for kind in kinds}
    except Exception:  # gmsh raises bare Exception; it has a message for what is damaged
        return
    groups_of_entity: dict[tuple[int, int], set[int]] = {}
    for element in elements:
        groups_of_entity.setdefault((dimension[element.kind], element.entity), set()).add(
            element.group
        )
    if all(len(of_entity) == 1 for of_entity in groups_of_entity.values()):
        return
    pairs = {
        pair: k
        for k, pair in enumerate(
            sorted({(element.group, element.entity) for element in elements}), 1
        )
    }
    lines = [
        _line(element, pairs[element.group, element.entity], is_binary) for element in elements
    ]
    if is_binary:
        new_body = b"".join(np.array(line, dtype=integer).tobytes() for line in lines)
    else:
        new_body = "".join(" ".join(map(str, line)) + "\n" for line in lines).encode()
    path.write_bytes(
        b"%s%s\n%d\n%s\n%s%s" % (head, begin_mark, len(elements), new_body, end_mark, tail)
    )


def _line(element: _Element, entity: int, is_binary: bool) -> list[int]:
    """Numbers of an element in the file, in an entity; a binary one is a block of one element."""
    leading = (
        [element.kind, 1, 2, element.number] if is_binary else [element.number, element.kind, 2]
    )
    return [*leading, element.group, entity, *element.nodes]


def _text(body: bytes) -> Iterator[_Element]:
    """Elements of text: number, type, number of tags, tags, nodes."""
    for line in body.split(b"\n")[2:]:
        if line.strip():
            number, kind, tag_count, *values = map(int, line.split())
            yield _element(number, kind, values, tag_count)


def _binary(body: bytes, integer: np.dtype, gmsh: ModuleType) -> Iterator[_Element]:
    """Elements in blocks: type, number of elements, number of tags, then each element."""
    block = body.split(b"\n", 2)[2]
    values = np.frombuffer(block[: len(block) // 4 * 4], dtype=integer)
    announced = int(body.split(b"\n", 2)[1])
    node_counts: dict[int, int] = {}
    position = 0
    while announced > 0:
        kind, element_count, tag_count = map(int, values[position : position + 3])
        if kind not in node_counts:
            node_counts[kind] = gmsh.model.mesh.getElementProperties(kind)[3]
        width = 1 + tag_count + node_counts[kind]
        position += 3
        rows = values[position : position + element_count * width].reshape(element_count, width)
        position += element_count * width
        announced -= element_count
        for row in rows:
            yield _element(int(row[0]), kind, [int(value) for value in row[1:]], tag_count)


def _element(number: int, kind: int, values: list[int], tag_count: int) -> _Element:
    group, entity = [*values[:tag_count], 0, 0][:2]
    return _Element(number, kind, group, entity, tuple(values[tag_count:]))
