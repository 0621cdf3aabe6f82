"""Abaqus and CalculiX ``.inp`` files: nodes, tetrahedra, triangles, sets and surfaces.

Keyword lines begin with ``*`` and go on after a comma at their end; data lines hold fields apart by
commas, and an empty field is zero. Names are case-insensitive; the first spelling is kept. Sets may
be used before they are defined: they are resolved when all are known.
"""

from __future__ import annotations

import codecs
import difflib
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from app.arrays import Floats, Ints
from app.mesh_files.content import ONLY, Found, left_out, rows_of

# Elements: tetrahedra, triangles, and others that have a volume.
SOLID = re.compile(r"D?C3D(4|10)[A-Z]*")
FLAT = re.compile(r"(?:CPS|CPE|S|STRI|M3D|SFM3D|R3D|DS)(3|6|65)[A-Z]*")
OTHER = re.compile(r"\w*C3D\w*")
# Corners of the faces of a tetrahedron.
SIDES = {"S1": (0, 1, 2), "S2": (0, 3, 1), "S3": (1, 3, 2), "S4": (2, 3, 0)}
# Sides of a shell: both are its triangle (CalculiX numbers them).
SHELL_SIDES = {"", "SPOS", "SNEG", "S1", "S2"}
# Keywords that make or move nodes and cells, or take them from elsewhere.
MOVING = {"INCLUDE", "SYSTEM", "NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY"}
MOVING |= {"IMPERFECTION", "IMPORT"}
# Keywords that are read, or that have nothing to read, with the options that matter.
READ: dict[str, set[str]] = {
    "NODE": {"NSET", "SYSTEM", "INPUT"},
    "ELEMENT": {"TYPE", "ELSET", "INPUT", "FILE", "OFFSET"},
    "ELSET": {"ELSET", "GENERATE", "INSTANCE", "INTERNAL", "UNSORTED"},
    "NSET": {"NSET", "ELSET", "GENERATE", "INSTANCE", "INTERNAL", "UNSORTED"},
    "SURFACE": {"NAME", "TYPE", "COMBINE", "INTERNAL"},
    "SOLIDSECTION": {"ELSET", "MATERIAL"},
    "PART": {"NAME"},
    "INSTANCE": {"NAME", "PART", "LIBRARY"},
}
SILENT = {"HEADING", "PREPRINT", "ASSEMBLY", "ENDPART", "ENDINSTANCE", "ENDASSEMBLY", "ENDSTEP"}
# Members of a range; more are a slip of the pen.
MOST_MEMBERS = 100_000_000
# Node and element numbers from here on are no exact floats.
MOST_NUMBERS = 2.0**53
# Commas that are not in quotes.
COMMA = re.compile(r',(?=(?:[^"]*"[^"]*")*[^"]*$)')
# An exponent that Fortran writes without its letter.
BARE_EXPONENT = re.compile(r"(?<=[\d.])([+-]\d+)$")


@dataclass(frozen=True)
class _Block:
    """A keyword, its options, its data lines with their numbers, and the instance around it."""

    at: str
    key: str
    options: Mapping[str, str]
    lines: list[tuple[int, str]]
    instance: str = ""

    def option(self, name: str) -> str:
        """Value of an option that the keyword needs.

        Raises:
            ValueError: It has none.
        """
        value = self.options.get(name, "")
        if not value:
            raise ValueError(f"{self.at}: has no option {name}; expected {name}=...")
        return value

    def numbers(self, rows: list[tuple[int, list[str]]]) -> Floats:
        """Fields of rows as numbers (n, k); an empty field is zero."""
        flat = [text or "0" for _, row in rows for text in row]
        try:
            values = np.array(flat, dtype=float)
        except ValueError:
            values = np.array([self._number(text, n) for n, row in rows for text in row])
        return values.reshape(len(rows), -1)

    def _number(self, text: str, line: int) -> float:
        fortran = BARE_EXPONENT.sub(r"E\1", text.upper().replace("D", "E"))
        try:
            return float(fortran or "0")
        except ValueError as error:
            wrong = str(error).replace(fortran, text)
            raise ValueError(f"{self.at}: {wrong} in line {line}") from None

    def nodes(self, last: bool) -> Floats:
        """Numbers and coordinates of nodes, one a line (n, 4).

        ``last``: nothing stands after this block, so that a short line at its end is cut.
        """
        rows = [(n, (fields(line) + [""] * 4)[:4]) for n, line in self.lines]
        if last and rows:
            end, text = self.lines[-1]
            if len(fields(text)) < 4:
                raise ValueError(
                    f"{self.at}: line {end}, the last of the file, has {len(fields(text))} "
                    "numbers of 4: is it cut short?"
                )
        table = self.numbers(rows).reshape(-1, 4)
        self._whole(table[:, 0], [n for n, _ in rows])
        return table

    def _whole(self, values: Floats, lines: list[int]) -> None:
        wrong = np.flatnonzero(
            ~((values == np.round(values)) & (values > 0) & (values < MOST_NUMBERS))
        )
        if len(wrong):
            at = lines[wrong[0]]
            raise ValueError(
                f"{self.at}: {values[wrong[0]]:g} in line {at} is no number of a node or element"
            )

    def elements(self, width: int) -> Ints:
        """Numbers of elements and of their nodes, over one or several lines each (n, width)."""
        rows: list[tuple[int, list[str]]] = []
        for n, line in self.lines:
            new = fields(line)
            if rows and len(rows[-1][1]) < width:
                rows[-1][1].extend(new)
            else:
                rows.append((n, new))
            if len(rows[-1][1]) == width + 1 and not rows[-1][1][-1]:
                rows[-1][1].pop()
        for n, row in rows:
            if len(row) != width:
                raise ValueError(
                    f"{self.at}: {len(row)} numbers are no rows of {width} in line {n}: "
                    "is it cut short?"
                )
        table = self.numbers(rows).reshape(-1, width)
        self._whole(table.ravel(), [n for n, _ in rows for _ in range(width)])
        return table.astype(np.int64)


def fields(line: str) -> list[str]:
    """Fields of a data line, apart by commas or, without any, by blanks; one at the end is none."""
    if "," not in line and '"' not in line:
        return line.split()
    parts = [part.strip() for part in (COMMA.split(line) if '"' in line else line.split(","))]
    return parts if parts[-1] else parts[:-1]


def _name(text: str) -> str:
    return text.strip().replace('"', "")


Key = tuple[str, str]


@dataclass
class _Scoped:
    """Names of one kind by instance and capitals; those of the assembly have no instance."""

    instances: Mapping[str, str]
    spelled: dict[Key, str] = field(default_factory=dict)

    def key(self, block: _Block, name: str) -> Key:
        """Instance and name; what stands before a dot is an instance if there is one."""
        first, dot, rest = _name(name).partition(".")
        if dot and first.upper() in self.instances:
            return self.instances[first.upper()], rest.upper()
        return block.instance, _name(name).upper()

    def add(self, block: _Block, name: str) -> Key:
        """Key of a name that a block defines."""
        key = self.key(block, name)
        self.spelled.setdefault(key, _name(name)[-len(key[1]) :])
        return key

    def find(self, block: _Block, name: str) -> Key | None:
        """Key of a name that a block uses: of its instance, the assembly, or the only one."""
        key = self.key(block, name)
        any_instance = [other for other in self.spelled if other[1] == key[1]]
        keys = [k for k in (key, ("", key[1])) if k in self.spelled]
        return next(iter(keys or (any_instance if len(any_instance) == 1 else [])), None)

    def found(self, block: _Block, name: str) -> Key:
        """Key of a name that a block uses.

        Raises:
            ValueError: There is none.
        """
        key = self.find(block, name)
        if key is None:
            close = difflib.get_close_matches(_name(name).upper(), [n for _, n in self.spelled], 1)
            hint = f"; did you mean {close[0]}?" if close else ""
            raise ValueError(f"{block.at}: there is no set {_name(name)}{hint}")
        return key

    def names(self, parts: Mapping[Key, Ints], told: list[str]) -> dict[Key, str]:
        """Names outside: those that are two things get the instance before them."""
        several: dict[str, list[Key]] = {}
        for key in parts:
            several.setdefault(key[1], []).append(key)
        result: dict[Key, str] = {}
        for keys in several.values():
            first, others = parts[keys[0]], keys[1:]
            same = all(np.array_equal(first, parts[key]) for key in others)
            for key in keys:
                own = self.spelled[keys[0] if same else key]
                result[key] = own if same or not key[0] else f"{key[0]}.{own}"
            if not same:
                told += left_out(
                    "sets of one name in several instances are kept apart",
                    [result[key] for key in keys],
                )
        return result


@dataclass
class _Sets(_Scoped):
    """Definitions of sets of elements or nodes; members are numbers."""

    definitions: dict[Key, list[tuple[_Block, Ints, list[str]]]] = field(default_factory=dict)
    resolved: dict[Key, Ints | None] = field(default_factory=dict)

    def define(self, block: _Block, name: str, numbers: Ints, names: Iterable[str] = ()) -> None:
        """Add numbers, and members of named sets, to a set."""
        key = self.add(block, name)
        # Names in a set of an assembly are those of the instance that it is in.
        inside = _name(block.options.get("INSTANCE", "")).upper()
        block = replace(block, instance=self.instances.get(inside, block.instance))
        self.definitions.setdefault(key, []).append((block, numbers, [*names]))

    def members(self, block: _Block, name: str) -> Ints:
        """Numbers in the set that a block names."""
        return self.members_of(self.found(block, name))

    def members_of(self, key: Key) -> Ints:
        """Numbers in a set, in ascending order (n,).

        Raises:
            ValueError: It contains itself, or a set that is not there.
        """
        if key not in self.resolved:
            self.resolved[key] = None
            parts: list[Ints] = [np.zeros(0, dtype=np.int64)]
            for block, numbers, names in self.definitions[key]:
                parts += [numbers, *(self.members(block, name) for name in names)]
            self.resolved[key] = np.unique(np.concatenate(parts))
        members = self.resolved[key]
        if members is None:
            block = self.definitions[key][0][0]
            raise ValueError(f"{block.at}: the set {self.spelled[key]} contains itself")
        return members

    def all(self) -> dict[Key, Ints]:
        """Members of all sets."""
        return {key: self.members_of(key) for key in self.definitions}


@dataclass
class _Mesh:
    """Elements of a file by their numbers, with the numbers of their corners."""

    solid: Ints
    cells: list[Ints]
    flat: Ints

    @cached_property
    def corners(self) -> Ints:
        """Corners of all tetrahedra (n, 4)."""
        parts: list[Ints] = [np.zeros((0, 4), dtype=np.int64)]
        return np.concatenate(parts + [cells[:, :4] for cells in self.cells])

    def nodes(self, elements: Ints) -> Ints:
        """Nodes of elements, in ascending order (n,)."""
        used = [self.flat[np.isin(self.flat[:, 0], elements), 1:].ravel()]
        numbers = np.split(self.solid, np.cumsum([*map(len, self.cells)]))
        for of_block, cells in zip(numbers, self.cells, strict=False):
            used.append(cells[np.isin(of_block, elements)].ravel())
        return np.unique(np.concatenate(used))

    def faces(self, block: _Block, line: int, elements: Ints, side: str) -> Ints:
        """Corners of faces of elements (n, 3), by the label of a face."""
        shells = self.flat[np.isin(self.flat[:, 0], elements)]
        solids = np.flatnonzero(np.isin(self.solid, elements))
        missing = np.setdiff1d(elements, np.concatenate([self.solid, self.flat[:, 0]]))
        if len(missing):
            raise ValueError(
                f"{block.at}: element {missing[0]} in line {line} is no tetrahedron or triangle "
                "of the file"
            )
        if len(shells) and side not in SHELL_SIDES:
            text = f"a triangle has no face {side}; expected SPOS or SNEG"
            raise ValueError(f"{block.at}: element {shells[0, 0]} in line {line}: {text}")
        if len(solids) and side and side not in SIDES:
            text = f"a tetrahedron has no face {side}; expected S1 to S4, or none for all free ones"
            raise ValueError(f"{block.at}: element {self.solid[solids[0]]} in line {line}: {text}")
        if not len(solids):
            return shells[:, 1:]
        if side:
            of_solids = self.corners[solids][:, SIDES[side]]
        else:
            free = self.free
            of_solids = free[np.isin(free[:, 0], solids), 1:]
        return np.concatenate([shells[:, 1:], of_solids])

    @cached_property
    def free(self) -> Ints:
        """Row of the cell and corners of each face that only one cell has (n, 4)."""
        faces = np.concatenate([self.corners[:, list(side)] for side in SIDES.values()])
        cell = np.tile(np.arange(len(self.corners)), len(SIDES))
        once = np.flatnonzero(_count(np.sort(faces, axis=1)) == 1)
        return np.column_stack([cell, faces])[once]


def _count(rows: Ints) -> Ints:
    """How often each row is there (n,)."""
    _, inverse, counts = np.unique(rows, axis=0, return_inverse=True, return_counts=True)
    return np.asarray(counts[inverse.ravel()])


def read(path: Path) -> Found:
    """Nodes, cells and sets of a file.

    Regions are the sets of ``*SOLID SECTION``, without any all sets of tetrahedra.

    Raises:
        ValueError: A keyword or a number is wrong, with its line.
    """
    found = Found()
    blocks, instances = _of_the_model(list(_blocks(path)), found)
    unread = (f"*{b.key}" for b in blocks if b.key not in READ and b.key not in SILENT)
    found.told += left_out("of the file are not read", unread)
    element_sets, node_sets = _Sets(instances), _Sets(instances)
    node = _nodes(blocks, node_sets, found)
    mesh, unread_sets = _elements(blocks, element_sets, found)
    for cells in mesh.cells:
        found.add(rows_of(node, cells, "node"))
    for b in (b for b in blocks if b.key in ("ELSET", "NSET")):
        sets = element_sets if b.key == "ELSET" else node_sets
        sets.define(b, b.option(b.key), *_listed(b))
    for b in (b for b in blocks if b.key == "NSET" and "ELSET" in b.options):
        of_set = element_sets.members(b, b.option("ELSET"))
        node_sets.define(b, b.option("NSET"), mesh.nodes(of_set))
    surfaces = _surfaces(blocks, mesh, element_sets, node_sets, found)

    sections = set()
    for b in (b for b in blocks if b.key == "SOLIDSECTION"):
        name = b.option("ELSET")
        if element_sets.find(b, name) or _name(name).upper() not in unread_sets:
            sections.add(element_sets.found(b, name))
    members = element_sets.all()
    names = element_sets.names(members, found.told)
    chosen = {names[key] for key in sections if np.isin(members[key], mesh.solid).any()}
    left = []
    for key, numbers in members.items():
        name = names[key]
        of_solids = numbers[np.isin(numbers, mesh.solid)]
        of_shells = mesh.flat[np.isin(mesh.flat[:, 0], numbers), 1:]
        if len(of_shells):
            found.triangles[name] = rows_of(node, of_shells, "node")
        if len(of_solids) and chosen and name not in chosen:
            left.append(name)
        elif len(of_solids):
            found.sets[name] = rows_of(mesh.solid, of_solids, "element")
    found.told += left_out("sets without *SOLID SECTION are no regions", left)
    for key, name in node_sets.names(node_sets.all(), found.told).items():
        found.nodes[name] = rows_of(node, node_sets.members_of(key), "node")
    hidden = []
    for name, corners in surfaces.items():
        rows = rows_of(node, corners, "node")
        if name in found.triangles and _keys(found.triangles[name]) != _keys(rows):
            hidden.append(name)
        found.triangles[name] = rows
    found.told += left_out("triangles of sets with the name of a *SURFACE are left out", hidden)
    return found


def _nodes(blocks: list[_Block], sets: _Sets, found: Found) -> Ints:
    """Read nodes and the sets that their keywords name; return the numbers (n,)."""
    tables: list[Floats] = [np.zeros((0, 4))]
    for b in (b for b in blocks if b.key == "NODE"):
        table = b.nodes(b is blocks[-1])
        if "NSET" in b.options:
            sets.define(b, b.option("NSET"), table[:, 0].astype(np.int64))
        tables.append(_cartesian(b, table, found.told))
    nodes = np.concatenate(tables)
    found.points = nodes[:, 1:]
    return nodes[:, 0].astype(np.int64)


def _elements(blocks: list[_Block], sets: _Sets, found: Found) -> tuple[_Mesh, set[str]]:
    """Read elements and the sets that their keywords name; return those sets of other types."""
    flat: list[Ints] = [np.zeros((0, 4), dtype=np.int64)]
    solid: list[Ints] = [np.zeros(0, dtype=np.int64)]
    cells: list[Ints] = []
    unread_sets = set()
    unread = []
    for b in (b for b in blocks if b.key == "ELEMENT"):
        kind, name = b.option("TYPE").upper(), b.options.get("ELSET", "")
        known = SOLID.fullmatch(kind) or FLAT.fullmatch(kind)
        if OTHER.fullmatch(kind) and not known:
            raise ValueError(f"{b.at}: the cells are of type {kind}; {ONLY}")
        if not known:
            unread.append(kind)
            unread_sets.add(_name(name).upper())
            continue
        table = b.elements(int(known[1].replace("65", "6")) + 1)
        if name:
            sets.define(b, name, table[:, 0])
        if SOLID.fullmatch(kind):
            cells.append(table[:, 1:])
            solid.append(table[:, 0])
        else:
            flat.append(table[:, :4])
    found.told += left_out("elements that are not read", unread)
    return _Mesh(np.concatenate(solid), cells, np.concatenate(flat)), unread_sets


def _keys(triangles: Ints) -> set[tuple[int, ...]]:
    return {(int(a), int(b), int(c)) for a, b, c in np.sort(triangles, axis=1)}


def _cartesian(block: _Block, table: Floats, told: list[str]) -> Floats:
    """Numbers and Cartesian coordinates of nodes; angles are in degrees."""
    system = block.options.get("SYSTEM", "R").upper()
    if system == "R":
        return table
    if system not in ("C", "S"):
        raise ValueError(f"{block.at}: SYSTEM={system} is not one of R, C, S")
    number, radius, theta = table[:, 0], table[:, 1], np.radians(table[:, 2])
    third = table[:, 3]
    if system == "S":
        told += left_out(
            "spherical coordinates are read as radius, angle about z, angle from the xy plane",
            [block.at],
        )
        radius, third = radius * np.cos(np.radians(third)), radius * np.sin(np.radians(third))
    return np.column_stack([number, radius * np.cos(theta), radius * np.sin(theta), third])


def _listed(block: _Block) -> tuple[Ints, list[str]]:
    """Numbers in a set, and the names of sets in it."""
    if "GENERATE" in block.options:
        parts = [np.zeros(0, dtype=np.int64)]
        for line, text in block.lines:
            words = fields(text)
            if not 2 <= len(words) <= 3 or not all(re.fullmatch(r"\d+", w) for w in words):
                raise ValueError(
                    f"{block.at}: '{text}' in line {line} is no range; expected first, last, step"
                )
            first, last, step = [*map(int, words), 1][:3]
            if step < 1 or last < first or last - first > step * MOST_MEMBERS:
                raise ValueError(
                    f"{block.at}: '{text}' in line {line} is no range; expected first, last, step"
                )
            parts.append(np.arange(first, last + 1, step))
        return np.concatenate(parts), []
    numbers, names = [], []
    for _, text in block.lines:
        for word in fields(text):
            if re.fullmatch(r"\d+", word, re.ASCII):
                numbers.append(int(word[:18]))
            elif word:
                names.append(word)
    return np.array(numbers, dtype=np.int64), names


def _surfaces(
    blocks: Iterable[_Block], mesh: _Mesh, element_sets: _Sets, node_sets: _Sets, found: Found
) -> dict[str, Ints]:
    """Corners of the triangles of surfaces by name; surfaces of nodes become sets of nodes."""
    scope = _Scoped(element_sets.instances)
    plain: dict[Key, Ints] = {}
    combined: dict[Key, _Block] = {}
    for b in (b for b in blocks if b.key == "SURFACE"):
        name, kind = b.option("NAME"), b.options.get("TYPE", "ELEMENT").upper()
        if "COMBINE" in b.options:
            combined[scope.add(b, name)] = b
        elif kind == "NODE":
            # A field after the name is an area.
            first = [(n, fields(text)[0]) for n, text in b.lines if fields(text)]
            numbers, names = _listed(replace(b, lines=first, options={}))
            own = node_sets.key(b, name)
            names = [other for other in names if node_sets.find(b, other) != own]
            node_sets.define(b, name, numbers, names)
        elif kind == "ELEMENT":
            key = scope.add(b, name)
            faces = _faces(b, mesh, element_sets)
            plain[key] = np.concatenate([plain.get(key, faces[:0]), faces])
        else:
            found.told += left_out("surfaces that are not read", [f"{_name(name)} ({kind})"])

    def triangles(key: Key, seen: tuple[Key, ...]) -> Ints:
        if key in plain:
            return plain[key]
        b = combined[key]
        if key in seen:
            raise ValueError(f"{b.at}: the surface {scope.spelled[key]} contains itself")
        keys = [scope.found(b, word) for _, text in b.lines for word in fields(text)]
        return _combine(b, [triangles(inner, (*seen, key)) for inner in keys])

    for key, b in combined.items():
        words = [word for _, text in b.lines for word in fields(text)]
        of_nodes = [w for w in words if not scope.find(b, w) and node_sets.find(b, w)]
        if of_nodes and of_nodes == words and b.options["COMBINE"].upper() == "UNION":
            node_sets.define(b, b.option("NAME"), np.zeros(0, dtype=np.int64), words)
            continue
        plain[key] = triangles(key, ())
    outside = scope.names(plain, found.told)
    return {outside[key]: corners for key, corners in plain.items()}


def _combine(block: _Block, parts: list[Ints]) -> Ints:
    """Union, intersection or difference of surfaces (n, 3)."""
    way = block.option("COMBINE").upper()
    if way not in ("UNION", "INTERSECTION", "DIFFERENCE"):
        raise ValueError(f"{block.at}: COMBINE={way} is not one of UNION, INTERSECTION, DIFFERENCE")
    if not parts or (way != "UNION" and len(parts) != 2):
        count = "surfaces" if way == "UNION" else "two surfaces"
        raise ValueError(f"{block.at}: expected the names of {count}, not {len(parts)}")
    if way == "UNION":
        both = np.concatenate(parts)
        _, first = np.unique(np.sort(both, axis=1), axis=0, return_index=True)
        return both[np.sort(first)]
    _, label = np.unique(np.sort(np.concatenate(parts), axis=1), axis=0, return_inverse=True)
    first, second = np.split(label.ravel(), [len(parts[0])])
    inside = np.isin(first, second)
    return parts[0][inside if way == "INTERSECTION" else ~inside]


def _faces(block: _Block, mesh: _Mesh, element_sets: _Sets) -> Ints:
    """Corners of the faces that a surface lists (n, 3)."""
    everything = np.concatenate([mesh.solid, mesh.flat[:, 0]])
    by_side: dict[tuple[str, int], list[int]] = {}
    parts: list[Ints] = [np.zeros((0, 3), dtype=np.int64)]
    if not block.lines:
        parts.append(mesh.faces(block, 0, everything, ""))
    for line, text in block.lines:
        words = [*fields(text), "", ""]
        name, side = words[0], words[1].upper()
        if re.fullmatch(r"\d+", name, re.ASCII):
            by_side.setdefault((side, 0), []).append(int(name[:18]))
            continue
        members = element_sets.members(block, name) if name else everything
        parts.append(mesh.faces(block, line, members, side))
    for (side, _), numbers in by_side.items():
        parts.append(mesh.faces(block, block.lines[0][0], np.array(numbers), side))
    return np.concatenate(parts)


def _of_the_model(blocks: list[_Block], found: Found) -> tuple[list[_Block], dict[str, str]]:
    """Blocks in the model, with the instance of each, and the names of instances by capitals.

    Of a file with instances, parts without one are left out.

    Raises:
        ValueError: A part has two instances, or is not in the file.
    """
    spelled: dict[str, str] = {}
    of_part: dict[str, str] = {}
    parts = {_name(b.option("NAME")).upper() for b in blocks if b.key == "PART"}
    for b in (b for b in blocks if b.key == "INSTANCE"):
        name, part = _name(b.option("NAME")), _name(b.option("PART")).upper()
        if part not in parts:
            raise ValueError(f"{b.at}: there is no part {_name(b.option('PART'))} in the file")
        if part in of_part:
            raise ValueError(
                f"{b.at}: the part {_name(b.option('PART'))} has two instances; save the mesh as "
                "one part"
            )
        spelled[name.upper()] = name
        of_part[part] = name
    kept, left, part, instance = [], [], "", ""
    for b in blocks:
        if b.key == "PART":
            part = _name(b.option("NAME")).upper()
            if of_part and part not in of_part:
                left.append(_name(b.option("NAME")))
        elif b.key == "INSTANCE":
            instance = _name(b.option("NAME"))
        if not (of_part and part and part not in of_part):
            kept.append(replace(b, instance=instance or of_part.get(part, "")))
        if b.key == "ENDPART":
            part = ""
        elif b.key == "ENDINSTANCE":
            instance = ""
    found.told += left_out("parts without an instance are not in the model", left)
    return kept, spelled


def _text(path: Path) -> str:
    """Text of a file in UTF-8, UTF-16 with its mark, or else Latin-1."""
    raw = path.read_bytes()
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return raw.decode("utf-16", "replace")
    if raw[:64].count(0) > 8:
        raise ValueError("is of UTF-16 or binary; save it as text in UTF-8")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.removeprefix(codecs.BOM_UTF8).decode("latin-1")


def _blocks(path: Path) -> Iterator[_Block]:
    """Keywords of a file with their options and data lines.

    Raises:
        ValueError: It does not begin with a keyword, or one makes or moves nodes.
    """
    numbered = ((n, line.strip()) for n, line in enumerate(re.split(r"\r\n?|\n", _text(path)), 1))
    heads: list[tuple[int, str, list[tuple[int, str]]]] = []
    goes_on = False
    for n, line in numbered:
        if not line or line.startswith("**"):
            continue
        if goes_on and not line.startswith("*"):
            first, head, lines = heads[-1]
            heads[-1] = (first, f"{head} {line}", lines)
            goes_on = line.endswith(",")
        elif line.startswith("*"):
            heads.append((n, line, []))
            goes_on = line.endswith(",")
        elif not heads:
            break
        else:
            heads[-1][2].append((n, line))
    if not heads:
        raise ValueError("no .inp file of Abaqus or CalculiX: it does not begin with a keyword")
    for n, head, lines in heads:
        yield _block(n, head, lines)


def _block(line: int, head: str, lines: list[tuple[int, str]]) -> _Block:
    words = [word.strip() for word in COMMA.split(head[1:])]
    shown = " ".join(words[0].split())
    key = "".join(words[0].upper().split())
    at = f"*{shown} in line {line}"
    options = {}
    for word in words[1:]:
        name, _, value = word.partition("=")
        options["".join(name.upper().split())] = _name(value)
    if key in MOVING or (key == "INSTANCE" and (lines or "LIBRARY" in options)):
        raise ValueError(f"{at}: makes or moves nodes; save the mesh as one file without it")
    if {"INPUT", "FILE", "OFFSET"} & options.keys() and key in ("NODE", "ELEMENT"):
        raise ValueError(
            f"{at}: takes its lines from another file, or changes numbers; save the "
            "mesh as one file without it"
        )
    for name in options:
        close = difflib.get_close_matches(name, READ.get(key, ()), 1, 0.7)
        if close and name not in READ[key] and close[0] not in options:
            raise ValueError(f"{at}: has no option {name}; did you mean {close[0]}?")
    return _Block(at, key, options, lines)
