"""Reader of ``.inp`` files of Abaqus and CalculiX.

Of 19 spellings of one mesh in `tests/meshes/test_mesh_formats.py` meshio 5.3.5 gets 15 wrong;
of 14 files with nodes in other axes it gets 13 wrong.
"""

from __future__ import annotations

import codecs
import csv
import difflib
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from app.foundation.arrays import Floats, Ints
from app.mesh_files.content import ONLY, FileContent, left_out, numbers_in, rows_of

# Types of elements: tetrahedra, triangles, and other volumes.
SOLID = re.compile(r"D?C3D(4|10)[A-Z]*")
FLAT = re.compile(r"(?:CPS|CPE|S|STRI|M3D|SFM3D|R3D|DS)(3|6|65)[A-Z]*")
OTHER = re.compile(r"\w*C3D\w*")
# Corners of the faces of a tetrahedron.
SIDES = {"S1": (0, 1, 2), "S2": (0, 3, 1), "S3": (1, 3, 2), "S4": (2, 3, 0)}
# Keywords that make or move nodes and cells, or take them from another file.
MOVING = {"INCLUDE", "NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY", "IMPORT"}
MOVING |= {"IMPERFECTION", "ADJUST", "SYMMETRICMODELGENERATION"}
READ = {"NODE", "ELEMENT", "ELSET", "NSET", "SURFACE", "SOLIDSECTION", "HEADING", "PREPRINT"}
READ |= {"PART", "INSTANCE", "ASSEMBLY", "ENDPART", "ENDINSTANCE", "ENDASSEMBLY", "ENDSTEP"}
READ |= {"SYSTEM"}
# Options without a value, which may stand alone in the second line of a keyword.
FLAGS = {"GENERATE", "INTERNAL", "UNSORTED", "NOPRINT"}
# Options that name or place something. Another option with a similar name is a misspelt one.
KNOWN = {"ELSET", "NSET", "TYPE", "NAME", "SYSTEM", "COMBINE", "GENERATE", "INSTANCE", "PART"}
KNOWN |= {"MATERIAL", "ORIENTATION", "INTERNAL", "UNSORTED", "LIBRARY", "CONTROLS", "COMPOSITE"}
# Least similarity of such names, as `difflib` measures it.
SIMILAR = 0.75
# Exponents as Fortran writes them.
EXPONENT = re.compile(r"(?<=[\d.])(?:[dD]|(?=[+-]))(?=[+-]?\d)")
# Least sine of the angle between the two directions that a coordinate system is made of.
ON_A_LINE = 1e-9
# Values in the line of a node: number and three coordinates; the same with a normal.
LEAST_OF_NODE = 4
MOST_OF_NODE = 7
# Most numbers of a range.
LONGEST_RANGE = 10**9

T = TypeVar("T", int, float)
# A set: its instance or part, "" for the assembly; its name in capitals.
Key = tuple[str, str]


@dataclass(frozen=True)
class Keyword:
    """A keyword with its options and data.

    Attributes:
        at: Its place in the file, for messages.
        key: The keyword in capitals, without blanks.
        options: Its options by name.
        lines: Its lines of data with their numbers.
        scope: The part or instance that contains it, "" if none does.
    """

    at: str
    key: str
    options: dict[str, str]
    lines: list[tuple[int, str]]
    scope: str

    def option(self, name: str) -> str:
        """Return the value of a required option.

        Raises:
            ValueError: It is missing.
        """
        if self.options.get(name):
            return self.options[name]
        there = ", ".join(self.options) or "none"
        raise ValueError(f"{self.at}: has no option {name}=; its options: {there}")

    def fields(self, line: str) -> list[str]:
        """Return the fields of a line, separated by commas, or by blanks if it has no comma."""
        if "," not in line:
            return line.split() if '"' not in line else [line.strip().strip('"')]
        if '"' in line:
            (row,) = csv.reader([line], skipinitialspace=True)
            return [word.strip() for word in row]
        return [word.strip() for word in line.split(",")]

    def number(self, at: int, text: str, kind: Callable[[str], T]) -> T:
        """Return the number in a field of a line, 0 if the field is empty."""
        try:
            return kind(EXPONENT.sub("e", text) if kind is float else text) if text else kind("0")
        except ValueError:
            what = "number" if kind is float else "whole number"
            raise ValueError(f"{self.at}: line {at}: {text!r} is not a {what}") from None

    def coordinates(self) -> tuple[Floats, int]:
        """Return the number and coordinates of each node (n, 4), and the count of empty fields."""
        rows, empty = [], 0
        for at, line in self.lines:
            words = [*self.fields(line), "", "", ""][:4]
            if len(self.fields(line)) < 2 or not words[0]:
                raise ValueError(
                    f"{self.at}: line {at}: expected a node number and coordinates; is the "
                    "file cut short?"
                )
            self._check_commas(at, line)
            empty += words.count("")
            rows.append([self.number(at, w, float) for w in words])
        return np.array(rows, dtype=float).reshape(-1, 4), empty

    def _check_commas(self, at: int, line: str) -> None:
        """Refuse commas in place of decimal points.

        A node may have its normal after its coordinates. Abaqus writes these with points.
        """
        words = [word for word in self.fields(line) if word]
        whole = all(word.lstrip("+-").isdigit() for word in words)
        if len(words) > MOST_OF_NODE or (len(words) > LEAST_OF_NODE and whole):
            text = f"line {at}: {len(words)} numbers for a node and three coordinates"
            raise ValueError(f"{self.at}: {text}; write decimal points, not commas")

    def table(self, width: int) -> Ints:
        """Return the whole numbers of records, each on one line or several (n, width)."""
        rows: list[list[int]] = []
        record: list[int] = []
        at = 0
        for at, line in self.lines:
            words = self.fields(line.rstrip(", \t"))
            if "" in words:
                raise ValueError(f"{self.at}: line {at}: a node is missing")
            record += [self.number(at, w, int) for w in words]
            if len(record) > width:
                raise ValueError(f"{self.at}: line {at}: {len(record)} numbers instead of {width}")
            if len(record) == width:
                rows.append(record)
                record = []
        if record:
            text = f"{len(record)} numbers instead of {width}; is the file cut short?"
            raise ValueError(f"{self.at}: line {at}: {text}")
        return np.array(rows, dtype=np.int64).reshape(-1, width)


def text_of(path: Path) -> str:
    """Return the text of a file in UTF-8, UTF-16 with a byte-order mark, or Latin-1."""
    raw = path.read_bytes()
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return raw.decode("utf-16")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def _options(at: str, words: list[str]) -> dict[str, str]:
    pairs = (word.partition("=") for word in words if word.strip())
    named = {a.strip().upper(): b.strip().strip('"').strip() for a, _, b in pairs}
    if "INPUT" in named or "OFFSET" in named:
        raise ValueError(
            f"{at}: takes numbers from another file or with an offset; export the mesh as one file"
        )
    for name in named.keys() - KNOWN:
        close = difflib.get_close_matches(name, KNOWN - named.keys(), 1, SIMILAR)
        if close:
            raise ValueError(f"{at}: has no option {name}; did you mean {close[0]}?")
    return named


def _has_options(line: str) -> bool:
    """Return True if a line that follows a keyword has more of its options."""
    first = line.split(",")[0]
    return "=" in first or first.strip().upper() in FLAGS


def blocks(path: Path) -> Iterator[Keyword]:
    """Return the keywords of a file in their order.

    Raises:
        ValueError: It is no such file, or a keyword makes or moves nodes.
    """
    rows = enumerate(text_of(path).splitlines(), 1)
    lines = [(n, text.strip()) for n, text in rows if text.strip() and text.strip()[:2] != "**"]
    if not lines or lines[0][1][0] != "*":
        raise ValueError(
            "is not an .inp file of Abaqus or CalculiX: it does not begin with a keyword (*)"
        )
    heads = [k for k, (_, text) in enumerate(lines) if text[0] == "*"]
    scope = ""
    for head, end in zip(heads, [*heads[1:], len(lines)], strict=True):
        number, text = lines[head]
        first = head + 1
        while text.endswith(",") and first < end and _has_options(lines[first][1]):
            text += lines[first][1]
            first += 1
        (words,) = (
            csv.reader([text[1:]], quoting=csv.QUOTE_NONE)
            if '"' not in text
            else [re.findall(r'(?:[^,"]|"[^"]*")+', text[1:])]
        )
        name = " ".join(words[0].split()) if words else ""
        at, key = f"*{name} in line {number}", name.upper().replace(" ", "")
        block = Keyword(at, key, {}, lines[first:end], scope)
        if key in READ:
            block = Keyword(at, key, _options(at, words[1:]), lines[first:end], scope)
        if key in MOVING or (key == "INSTANCE" and (block.lines or "LIBRARY" in block.options)):
            raise ValueError(
                f"{at}: makes, moves or includes nodes; export the model flat, in one file "
                "without this keyword"
            )
        if key in ("PART", "INSTANCE"):
            scope = block.option("NAME").upper()
        elif key in ("ENDPART", "ENDINSTANCE"):
            scope = ""
        yield block


def _cartesian(block: Keyword, given: Floats) -> Floats:
    """Return Cartesian coordinates (n, 3) of nodes in the system of their keyword.

    R is Cartesian. C is cylindrical: radius, angle about z from x, z. S is spherical: radius, the
    same angle, angle from the xy-plane to z. Angles are in degrees.
    """
    system = block.options.get("SYSTEM", "R").upper()
    if system[:1] == "R":
        return given
    if system[:1] not in ("C", "S"):
        raise ValueError(f"{block.at}: SYSTEM={system} is not read; expected R, C or S")
    radius, longitude = given[:, 0], np.radians(given[:, 1])
    height = given[:, 2]
    if system[:1] == "S":
        latitude = np.radians(given[:, 2])
        height = radius * np.sin(latitude)
        radius = radius * np.cos(latitude)
    return np.column_stack([radius * np.cos(longitude), radius * np.sin(longitude), height])


@dataclass(frozen=True)
class _Axes:
    """Axes of ``*SYSTEM``, in which the next nodes are given: origin (3,), axes in rows (3, 3)."""

    origin: Floats
    axes: Floats

    @classmethod
    def of(cls, block: Keyword) -> _Axes:
        """Return the axes of a keyword by its points: origin, one on x, one in the xy-plane.

        Without the third point z is the global z, and x is projected on its normal plane. Without
        the second one the axes are the global ones. A keyword without lines ends an earlier one.
        """
        if len(block.lines) > 2:
            raise ValueError(f"{block.at}: has more than two lines")
        numbers: list[float] = []
        given = 0
        for (at, line), width in zip(block.lines, (6, 3), strict=False):
            words = block.fields(line.rstrip(", \t"))
            if len(words) > width:
                raise ValueError(
                    f"{block.at}: line {at}: {len(words)} numbers; expected at most {width}"
                )
            given = len(numbers) + len(words)
            numbers += [block.number(at, word, float) for word in [*words, *[""] * width][:width]]
        origin, on_x, in_plane = np.array([*numbers, *[0.0] * 9][:9]).reshape(3, 3)
        if given <= 3:
            return cls(origin, np.eye(3))
        first = on_x - origin
        other = in_plane - origin
        if given <= 6:
            first = first * [1, 1, 0]
            other = np.array([-first[1], first[0], 0.0])
        third = np.cross(first, other)
        if not np.linalg.norm(third) > ON_A_LINE * np.linalg.norm(first) * np.linalg.norm(other):
            raise ValueError(
                f"{block.at}: its points are on a straight line and give no axes; correct them"
            )
        axes = np.stack([first, np.cross(third, first), third])
        return cls(origin, axes / np.linalg.norm(axes, axis=1, keepdims=True))

    def to_global(self, x: Floats) -> Floats:
        """Return the global coordinates of points (n, 3) in these axes."""
        return self.origin + x @ self.axes


class _Sets:
    """Sets by kind and name. A set may name sets that follow it in the file."""

    def __init__(self, instances: set[str]) -> None:
        self.instances = instances
        self.made: dict[str, dict[Key, list[Callable[[], np.ndarray]]]] = {
            kind: {} for kind in ("ELSET", "NSET", "SURFACE")
        }
        self.spelled: dict[Key, str] = {}
        self.done: dict[tuple[str, Key], np.ndarray] = {}
        self.open: set[tuple[str, Key]] = set()

    def key(self, name: str, scope: str) -> Key:
        """Return scope and name of a set. The text before a dot is a scope if it is an instance."""
        before, dot, after = name.partition(".")
        while dot and before.upper() not in self.instances:
            more, dot, after = after.partition(".")
            before += f".{more}"
        if dot:
            return before.upper(), after.upper()
        return scope, name.upper()

    def add(self, kind: str, name: str, scope: str, part: Callable[[], np.ndarray]) -> None:
        """Add a function that returns members of a set."""
        key = self.key(name, scope)
        self.spelled.setdefault(key, name if key[0] == scope else name[len(key[0]) + 1 :])
        self.made[kind].setdefault(key, []).append(part)

    def get(self, kind: str, name: str, scope: str, at: str) -> np.ndarray:
        """Return the members of a set that a keyword names.

        Raises:
            ValueError: There is no such set.
        """
        key = self.key(name, scope)
        if key not in self.made[kind]:
            others = [k for k in self.made[kind] if k[1] == key[1]]
            if len(others) != 1 or ("." in name and key[0] != scope):
                raise ValueError(f"{at}: the file has no set {name}")
            key = others[0]
        return self.members(kind, key)

    def members(self, kind: str, key: Key) -> np.ndarray:
        """Return the members of a set.

        Raises:
            ValueError: It contains itself.
        """
        what = (kind, key)
        if what in self.open:
            raise ValueError(
                f"the set {self.spelled[key]} contains itself; remove its name from its list"
            )
        if what not in self.done:
            self.open.add(what)
            try:
                self.done[what] = np.concatenate([part() for part in self.made[kind][key]])
            finally:
                self.open.discard(what)
        return self.done[what]


def read(path: Path) -> FileContent:
    """Read nodes, tetrahedra, triangles, sets and surfaces.

    Names are case-insensitive; the first spelling is kept. If several instances have a set of the
    same name, the name of the instance is put before it. Parts without an instance are left out.
    """
    content, everything = FileContent(), [*blocks(path)]
    instance = {b.option("NAME").upper(): b for b in everything if b.key == "INSTANCE"}
    of_part: dict[str, str] = {}
    for name, b in instance.items():
        part = b.option("PART").upper()
        if part in of_part:
            raise ValueError(
                f"{b.at}: part {part} has two instances; export the model flat, without instances"
            )
        of_part[part] = name
    parts = {b.options["NAME"].upper(): b.options["NAME"] for b in everything if b.key == "PART"}
    unused = {p for p in parts if instance and p not in of_part}
    content.notes += left_out("parts without an instance", [parts[p] for p in parts if p in unused])
    used = [b for b in everything if b.scope not in unused]
    content.notes += left_out(
        "keywords of the file that are not read", (f"*{b.key}" for b in used if b.key not in READ)
    )
    sets = _Sets({*instance} | {*parts})

    def scope(b: Keyword) -> str:
        return b.options.get("INSTANCE", of_part.get(b.scope, b.scope)).upper()

    points: list[Floats] = [np.zeros((0, 3))]
    numbered: list[Ints] = [np.zeros(0, dtype=np.int64)]
    empty = 0
    axes: dict[str, _Axes] = {}
    for b in (b for b in used if b.key in ("NODE", "SYSTEM")):
        if b.key == "SYSTEM":
            axes[b.scope] = _Axes.of(b)
            continue
        rows, blank = b.coordinates()
        x = _cartesian(b, rows[:, 1:])
        points.append(axes[b.scope].to_global(x) if b.scope in axes else x)
        numbered.append(rows[:, 0].astype(np.int64))
        empty += blank
        if "NSET" in b.options:
            here = numbered[-1]
            sets.add("NSET", b.option("NSET"), scope(b), lambda n=here: n)  # type: ignore[misc]
    content.points, node = np.concatenate(points), np.concatenate(numbered)
    if empty:
        content.notes.append(
            f"geometry: {empty} coordinates of nodes are empty, and are taken as 0"
        )
    _elements(content, used, sets, node, scope)
    return content


def _elements(
    content: FileContent,
    used: list[Keyword],
    sets: _Sets,
    node: Ints,
    scope: Callable[[Keyword], str],
) -> None:
    """Add cells, triangles and the sets that contain them."""
    numbers: list[np.ndarray] = [np.zeros(0, dtype=np.int64)]
    flat: list[np.ndarray] = [np.zeros((0, 4), dtype=np.int64)]
    unread: list[str] = []
    for b in (b for b in used if b.key == "ELEMENT"):
        kind = b.option("TYPE").upper()
        if "ELSET" in b.options:
            b.option("ELSET")
        known = SOLID.fullmatch(kind) or FLAT.fullmatch(kind)
        if not known and OTHER.fullmatch(kind):
            raise ValueError(f"{b.at}: the cells are of type {kind}; {ONLY}")
        if not known:
            unread.append(kind)
            first = [b.fields(line)[0] for _, line in b.lines]
            here = np.array([int(w) for w in first if w.isdigit()], dtype=np.int64)
        else:
            rows = b.table(int(known[1].replace("65", "6")) + 1)
            here = rows[:, 0]
            if SOLID.fullmatch(kind):
                content.add(rows_of(node, rows[:, 1:], "node"))
                numbers.append(here)
            else:
                flat.append(rows[:, :4])
        if "ELSET" in b.options:
            sets.add("ELSET", b.option("ELSET"), scope(b), lambda n=here: n)  # type: ignore[misc]
    content.notes += left_out("elements that are not read", unread)
    element, shells = np.concatenate(numbers), np.concatenate(flat)
    cells = content.cells if content.blocks else np.zeros((0, 4), dtype=np.int64)

    def listed(kind: str, b: Keyword, other: str = "") -> np.ndarray:
        """Return the members of a set: of GENERATE ranges, or listed numbers and named sets.

        ``other`` is a set of elements whose nodes are members too.
        """
        out: list[np.ndarray] = [np.zeros(0, dtype=np.int64)]
        if "GENERATE" in b.options:
            for at, line in b.lines:
                limits = [b.number(at, w, int) for w in b.fields(line.rstrip(", "))]
                if not 1 <= len(limits) <= 3 or (len(limits) == 3 and limits[2] < 1):
                    raise ValueError(f"{b.at}: line {at}: is not a range; expected from, to, step")
                if len(limits) > 1 and limits[1] - limits[0] > LONGEST_RANGE:
                    raise ValueError(
                        f"{b.at}: line {at}: the range has more than {LONGEST_RANGE:,} numbers"
                    )
                out.append(numbers_in(*limits))
            return np.concatenate(out)
        single: list[int] = []
        for _, line in b.lines:
            for w in b.fields(line):
                alone = sets.key(w, "")[1]
                if alone.isdigit():
                    single.append(int(alone))
                elif w:
                    out.append(sets.get(kind, w, scope(b), b.at))
        if other:
            members = sets.get("ELSET", other, scope(b), b.at)
            out.append(node[np.unique(cells[np.isin(element, members)])])
        return np.concatenate([*out, np.array(single, dtype=np.int64)])

    def faces(b: Keyword) -> np.ndarray:
        """Return the corners of the facets of a surface (n, 3), as rows of nodes."""
        out: list[np.ndarray] = [np.zeros((0, 3), dtype=np.int64)]
        combine = b.options.get("COMBINE", "").upper()
        if combine:
            names = [w for _, line in b.lines for w in b.fields(line) if w]
            each = [sets.get("SURFACE", name, scope(b), b.at) for name in names]
            return _combined(combine, each, b.at)
        for at, line in b.lines:
            name, side = [*b.fields(line), ""][:2]
            side = side.upper().replace(" ", "")
            alone = sets.key(name, "")[1]
            if alone.isdigit():
                members = np.array([int(alone)])
            else:
                members = sets.get("ELSET", name, scope(b), b.at)
            triangles = rows_of(node, shells[np.isin(shells[:, 0], members), 1:], "node")
            solid = np.isin(element, members)
            if side in SIDES:
                rows = rows_of(element, members[np.isin(members, element)], "element")
                out.append(cells[rows][:, SIDES[side]])
                if len(rows) < len(members):
                    text = "surfaces with elements that are not tetrahedra of the file"
                    content.notes += left_out(text, [b.options["NAME"]])
            elif side in ("SPOS", "SNEG"):
                if solid.any():
                    text = f"{side} is not a face of a tetrahedron; expected S1 to S4, or none"
                    raise ValueError(f"{b.at}: line {at}: {text}")
                out.append(triangles)
            elif not side:
                out += [triangles, *(cells[solid][:, f] for f in SIDES.values())]
            else:
                raise ValueError(
                    f"{b.at}: line {at}: {side} is not a face of a tetrahedron; expected S1 "
                    "to S4, or none"
                )
        return np.concatenate(out)

    for b in used:
        if b.key == "NSET":
            of = b.options.get("ELSET", "")
            sets.add("NSET", b.option("NSET"), scope(b), lambda b=b, of=of: listed("NSET", b, of))  # type: ignore[misc]
        elif b.key == "ELSET":
            sets.add("ELSET", b.option("ELSET"), scope(b), lambda b=b: listed("ELSET", b))  # type: ignore[misc]
        elif b.key == "SURFACE":
            kind, name = b.options.get("TYPE", "ELEMENT").upper(), b.option("NAME")
            if kind == "NODE":
                leading = [(at, b.fields(line)[0]) for at, line in b.lines]
                alone = Keyword(b.at, b.key, b.options, leading, b.scope)
                sets.add("NSET", name, scope(b), lambda b=alone: listed("NSET", b))  # type: ignore[misc]
            elif kind == "ELEMENT":
                sets.add("SURFACE", name, scope(b), lambda b=b: faces(b))  # type: ignore[misc]
            else:
                content.notes += left_out(f"surfaces of TYPE={kind} are not read", [name])
    _named(content, used, sets, scope, node, element, shells)


def _combined(how: str, each: list[np.ndarray], at: str) -> np.ndarray:
    """Return the union, intersection or difference of surfaces (n, 3)."""
    if how not in ("UNION", "INTERSECTION", "DIFFERENCE") or not each:
        raise ValueError(
            f"{at}: COMBINE={how} is not read; expected UNION, INTERSECTION, DIFFERENCE"
        )
    if how == "UNION":
        return np.concatenate(each)
    first, *others = each
    keys = [{tuple(sorted(f)) for f in other.tolist()} for other in others]
    wanted = how == "INTERSECTION"
    keep = [all((tuple(sorted(f)) in k) == wanted for k in keys) for f in first.tolist()]
    return first[np.array(keep, dtype=bool)]


def _named(
    content: FileContent,
    used: list[Keyword],
    sets: _Sets,
    scope: Callable[[Keyword], str],
    node: Ints,
    element: Ints,
    shells: Ints,
) -> None:
    """Add regions and boundaries by the names of their sets."""

    def titles(*kinds: str) -> dict[Key, str]:
        """Return names in the case, with the instance where several have a set of that name."""
        keys = dict.fromkeys(k for kind in kinds for k in sets.made[kind])
        often = [name for _, name in keys]
        twice = {k for k in keys if often.count(k[1]) > 1 and k[0]}
        titled = {k: f"{k[0]}.{sets.spelled[k]}" if k in twice else sets.spelled[k] for k in keys}
        text = "sets of one name in several parts have the part before their name"
        content.notes.extend(left_out(text, [titled[k] for k in keys if k in twice]))
        return titled

    sections = set()
    for b in (b for b in used if b.key == "SOLIDSECTION"):
        key = sets.key(b.option("ELSET"), scope(b))
        others = [k for k in sets.made["ELSET"] if k[1] == key[1]]
        if key not in sets.made["ELSET"] and len(others) == 1:
            key = others[0]
        if key not in sets.made["ELSET"]:
            raise ValueError(f"{b.at}: the file has no set {b.option('ELSET')}")
        sections.add(key)
    title = titles("ELSET")
    solids: dict[Key, np.ndarray] = {}
    for key in sets.made["ELSET"]:
        members = sets.members("ELSET", key)
        solids[key] = np.unique(members[np.isin(members, element)])
        triangles = shells[np.isin(shells[:, 0], members), 1:]
        if len(triangles):
            content.triangles[title[key]] = rows_of(node, triangles, "node")
    regions = [key for key, members in solids.items() if len(members)]
    left = [k for k in regions if sections & {*regions} and k not in sections]
    content.notes += left_out(
        "sets without *SOLID SECTION, which are not regions", [title[k] for k in left]
    )
    for key in regions:
        if key not in left:
            content.sets[title[key]] = rows_of(element, solids[key], "element")
    boundary = titles("SURFACE", "NSET")
    for key in sets.made["SURFACE"]:
        corners = sets.members("SURFACE", key)
        if not len(corners):
            content.notes += left_out("surfaces without a facet", [boundary[key]])
        content.triangles[boundary[key]] = corners
    for key in sets.made["NSET"]:
        content.nodes[boundary[key]] = rows_of(node, sets.members("NSET", key), "node")
