"""Reader of ``.inp`` files of Abaqus and CalculiX.

Of 19 spellings of one mesh in `tests/mesh_files/test_abaqus.py` meshio 5.3.5 gets 15 wrong;
of 14 files with nodes in other axes it gets 13 wrong.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from app.foundation.arrays import Floats, Ints
from app.mesh_files.content import (
    ONLY,
    FileContent,
    left_out,
    numbers_in,
    rows_of,
    same_facets,
)
from app.mesh_files.keywords import READ, Keyword, keywords

# Types of elements: tetrahedra, triangles, and other volumes.
SOLID_ELEMENT = re.compile(r"D?C3D(4|10)[A-Z]*")
FLAT_ELEMENT = re.compile(r"(?:CPS|CPE|S|STRI|M3D|SFM3D|R3D|DS)(3|6|65)[A-Z]*")
OTHER = re.compile(r"\w*C3D\w*")
# Corners of the faces of a tetrahedron.
CORNERS_OF_FACES = {"S1": (0, 1, 2), "S2": (0, 3, 1), "S3": (1, 3, 2), "S4": (2, 3, 0)}
# Least sine of the angle between the two directions that a coordinate system is made of.
ON_A_LINE = 1e-9
# Most numbers of a range.
LONGEST_RANGE = 10**9

# A set: its instance or part, "" for the assembly; its name in capitals.
Key = tuple[str, str]


def _cartesian(block: Keyword, coordinates: Floats) -> Floats:
    """Return Cartesian coordinates (n, 3) of nodes in the system of their keyword.

    R is Cartesian. C is cylindrical: radius, angle about z from x, z. S is spherical: radius, the
    same angle, angle from the xy-plane to z. Angles are in degrees.
    """
    system = block.options.get("SYSTEM", "R").upper()
    if system[:1] == "R":
        return coordinates
    if system[:1] not in ("C", "S"):
        raise ValueError(f"{block.place}: SYSTEM={system} is not read; expected R, C or S")
    radius, longitude = coordinates[:, 0], np.radians(coordinates[:, 1])
    height = coordinates[:, 2]
    if system[:1] == "S":
        latitude = np.radians(coordinates[:, 2])
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
            raise ValueError(f"{block.place}: has more than two lines")
        numbers: list[float] = []
        number_count = 0
        for (line_number, line), width in zip(block.lines, (6, 3), strict=False):
            cell_texts = block.fields(line.rstrip(", \t"))
            if len(cell_texts) > width:
                raise ValueError(
                    f"{block.place}: line {line_number}: {len(cell_texts)} numbers;"
                    f" expected at most {width}"
                )
            number_count = len(numbers) + len(cell_texts)
            numbers += [
                block.number(line_number, cell_text, float)
                for cell_text in [*cell_texts, *[""] * width][:width]
            ]
        origin, on_x, in_plane = np.array([*numbers, *[0.0] * 9][:9]).reshape(3, 3)
        if number_count <= 3:
            return cls(origin, np.eye(3))
        first_axis = on_x - origin
        second = in_plane - origin
        if number_count <= 6:
            first_axis = first_axis * [1, 1, 0]
            second = np.array([-first_axis[1], first_axis[0], 0.0])
        third = np.cross(first_axis, second)
        if not np.linalg.norm(third) > ON_A_LINE * np.linalg.norm(first_axis) * np.linalg.norm(
            second
        ):
            raise ValueError(
                f"{block.place}: its points are on a straight line and give no axes; correct them"
            )
        axes = np.stack([first_axis, np.cross(third, first_axis), third])
        return cls(origin, axes / np.linalg.norm(axes, axis=1, keepdims=True))

    def to_global(self, x: Floats) -> Floats:
        """Return the global coordinates of points (n, 3) in these axes."""
        return self.origin + x @ self.axes


class _Sets:
    """Sets by kind and name. A set may name sets that follow it in the file."""

    def __init__(self, instances: set[str]) -> None:
        self.instances = instances
        self.member_functions: dict[str, dict[Key, list[Callable[[], Ints]]]] = {
            kind: {} for kind in ("ELSET", "NSET", "SURFACE")
        }
        self.spelled: dict[Key, str] = {}
        self.known_members: dict[tuple[str, Key], Ints] = {}
        self.open: set[tuple[str, Key]] = set()

    def key(self, name: str, scope: str) -> Key:
        """Return scope and name of a set. The text before a dot is a scope if it is an instance."""
        instance_name, dot, name_in_instance = name.partition(".")
        while dot and instance_name.upper() not in self.instances:
            next_part, dot, name_in_instance = name_in_instance.partition(".")
            instance_name += f".{next_part}"
        if dot:
            return instance_name.upper(), name_in_instance.upper()
        return scope, name.upper()

    def add(self, kind: str, name: str, scope: str, part: Callable[[], Ints]) -> None:
        """Add a function that returns members of a set."""
        key = self.key(name, scope)
        self.spelled.setdefault(key, name if key[0] == scope else name[len(key[0]) + 1 :])
        self.member_functions[kind].setdefault(key, []).append(part)

    def existing_key(self, kind: str, name: str, scope: str, place: str) -> Key:
        """Return the key of a set that a keyword names; it may be in another scope.

        Raises:
            ValueError: There is no such set.
        """
        key = self.key(name, scope)
        if key in self.member_functions[kind]:
            return key
        same_named = [
            other_key for other_key in self.member_functions[kind] if other_key[1] == key[1]
        ]
        if len(same_named) != 1 or ("." in name and key[0] != scope):
            raise ValueError(f"{place}: the file has no set {name}")
        return same_named[0]

    def get(self, kind: str, name: str, scope: str, place: str) -> Ints:
        """Return the members of a set that a keyword names.

        Raises:
            ValueError: There is no such set.
        """
        return self.members(kind, self.existing_key(kind, name, scope, place))

    def members(self, kind: str, key: Key) -> Ints:
        """Return the members of a set.

        Raises:
            ValueError: It contains itself.
        """
        kind_and_key = (kind, key)
        if kind_and_key in self.open:
            raise ValueError(
                f"the set {self.spelled[key]} contains itself; remove its name from its list"
            )
        if kind_and_key not in self.known_members:
            self.open.add(kind_and_key)
            try:
                self.known_members[kind_and_key] = np.concatenate(
                    [part() for part in self.member_functions[kind][key]]
                )
            finally:
                self.open.discard(kind_and_key)
        return self.known_members[kind_and_key]


@dataclass(frozen=True)
class _Mesh:
    """Nodes and elements with their numbers in the file.

    Attributes:
        node: Number of each node (n,).
        element: Number of each tetrahedron (m,).
        cells: Nodes of each tetrahedron, as rows of the nodes (m, 4 or 10).
        shells: Number and corners of each triangle, by number (k, 4).
    """

    node: Ints
    element: Ints
    cells: Ints
    shells: Ints

    def shells_of(self, members: Ints) -> Ints:
        """Corners of the triangles among elements (k, 3), as rows of the nodes."""
        corners = self.shells[np.isin(self.shells[:, 0], members), 1:]
        return rows_of(self.node, corners, "node")


def read(path: Path) -> FileContent:
    """Read nodes, tetrahedra, triangles, sets and surfaces.

    Names are case-insensitive; the first spelling is kept. If several instances have a set of the
    same name, the name of the instance is put before it. Parts without an instance are left out.
    """
    content = FileContent()
    used_keywords, sets = _instanced(content, [*keywords(path)])
    node = _add_nodes(content, used_keywords, sets)
    mesh = _add_elements(content, used_keywords, sets, node)
    _add_sets(content, used_keywords, sets, mesh)
    _name(content, used_keywords, sets, mesh)
    return content


def _instanced(content: FileContent, all_keywords: list[Keyword]) -> tuple[list[Keyword], _Sets]:
    """Keywords that are used, each in the scope of its instance, and their empty sets."""
    instance = {b.option("NAME").upper(): b for b in all_keywords if b.key == "INSTANCE"}
    of_part: dict[str, str] = {}
    for name, b in instance.items():
        part = b.option("PART").upper()
        if part in of_part:
            raise ValueError(
                f"{b.place}: part {part} has two instances; export the model flat,"
                " without instances"
            )
        of_part[part] = name
    part_names = {
        b.options["NAME"].upper(): b.options["NAME"] for b in all_keywords if b.key == "PART"
    }
    unused = {part for part in part_names if instance and part not in of_part}
    missing_parts = [part_names[part] for part in part_names if part in unused]
    content.notes += left_out("parts without an instance", missing_parts)
    used_keywords = []
    for b in all_keywords:
        if b.scope not in unused:
            scope = b.options.get("INSTANCE", of_part.get(b.scope, b.scope)).upper()
            used_keywords.append(replace(b, scope=scope))
    content.notes += left_out(
        "keywords of the file that are not read",
        (f"*{b.key}" for b in used_keywords if b.key not in READ),
    )
    return used_keywords, _Sets({*instance} | {*part_names})


def _add_nodes(content: FileContent, used_keywords: list[Keyword], sets: _Sets) -> Ints:
    """Add the nodes and the sets that are given with them; return their numbers (n,)."""
    points: list[Floats] = [np.zeros((0, 3))]
    numbered: list[Ints] = [np.zeros(0, dtype=np.int64)]
    empty = 0
    axes: dict[str, _Axes] = {}
    for b in used_keywords:
        if b.key == "SYSTEM":
            axes[b.scope] = _Axes.of(b)
        if b.key != "NODE":
            continue
        rows, blank = b.coordinates()
        x = _cartesian(b, rows[:, 1:])
        points.append(axes[b.scope].to_global(x) if b.scope in axes else x)
        numbers = rows[:, 0].astype(np.int64)
        numbered.append(numbers)
        empty += blank
        if "NSET" in b.options:
            sets.add("NSET", b.option("NSET"), b.scope, partial(np.asarray, numbers))
    content.points = np.concatenate(points)
    if empty:
        content.notes.append(
            f"geometry: {empty} coordinates of nodes are empty, and are taken as 0"
        )
    return np.concatenate(numbered)


def _add_elements(
    content: FileContent, used_keywords: list[Keyword], sets: _Sets, node: Ints
) -> _Mesh:
    """Add the tetrahedra and the sets that are given with elements; return the whole mesh."""
    solids: list[Ints] = [np.zeros(0, dtype=np.int64)]
    shells: list[Ints] = [np.zeros((0, 4), dtype=np.int64)]
    unread: list[str] = []
    for b in used_keywords:
        if b.key != "ELEMENT":
            continue
        kind = b.option("TYPE").upper()
        if "ELSET" in b.options:
            b.option("ELSET")
        is_known = SOLID_ELEMENT.fullmatch(kind) or FLAT_ELEMENT.fullmatch(kind)
        if not is_known and OTHER.fullmatch(kind):
            raise ValueError(f"{b.place}: the cells are of type {kind}; {ONLY}")
        if not is_known:
            unread.append(kind)
            element_numbers = [b.fields(line)[0] for _, line in b.lines]
            numbers = np.array([int(w) for w in element_numbers if w.isdigit()], dtype=np.int64)
        else:
            rows = b.table(int(is_known[1].replace("65", "6")) + 1)
            numbers = rows[:, 0]
            if SOLID_ELEMENT.fullmatch(kind):
                content.add(rows_of(node, rows[:, 1:], "node"))
                solids.append(numbers)
            else:
                shells.append(rows[:, :4])
        if "ELSET" in b.options:
            sets.add("ELSET", b.option("ELSET"), b.scope, partial(np.asarray, numbers))
    content.notes += left_out("elements that are not read", unread)
    cells = content.cells if content.blocks else np.zeros((0, 4), dtype=np.int64)
    return _Mesh(node, np.concatenate(solids), cells, np.concatenate(shells))


def _add_sets(content: FileContent, used_keywords: list[Keyword], sets: _Sets, mesh: _Mesh) -> None:
    """Add sets of nodes and elements, and surfaces."""
    for b in used_keywords:
        if b.key == "NSET":
            members = partial(_node_set, b, sets, mesh)
            sets.add("NSET", b.option("NSET"), b.scope, members)
        elif b.key == "ELSET":
            sets.add("ELSET", b.option("ELSET"), b.scope, partial(_listed, b, "ELSET", sets))
        elif b.key == "SURFACE":
            kind, name = b.options.get("TYPE", "ELEMENT").upper(), b.option("NAME")
            if kind == "NODE":
                leading = [(line_number, b.fields(line)[0]) for line_number, line in b.lines]
                nodes = replace(b, lines=leading)
                sets.add("NSET", name, b.scope, partial(_listed, nodes, "NSET", sets))
            elif kind == "ELEMENT":
                sets.add("SURFACE", name, b.scope, partial(_facets, b, content, sets, mesh))
            else:
                content.notes += left_out(f"surfaces of TYPE={kind} are not read", [name])


def _listed(b: Keyword, kind: str, sets: _Sets) -> Ints:
    """Members of a set: of GENERATE ranges, or listed numbers and named sets."""
    member_arrays: list[Ints] = [np.zeros(0, dtype=np.int64)]
    if "GENERATE" in b.options:
        return np.concatenate(
            [*member_arrays, *(_range(b, line_number, line) for line_number, line in b.lines)]
        )
    single: list[int] = []
    for _, line in b.lines:
        for name in b.fields(line):
            plain_name = sets.key(name, "")[1]
            if plain_name.isdigit():
                single.append(int(plain_name))
            elif name:
                member_arrays.append(sets.get(kind, name, b.scope, b.place))
    return np.concatenate([*member_arrays, np.array(single, dtype=np.int64)])


def _range(b: Keyword, line_number: int, line: str) -> Ints:
    """Numbers of a range: from, to, step."""
    limits = [b.number(line_number, cell_text, int) for cell_text in b.fields(line.rstrip(", "))]
    if not 1 <= len(limits) <= 3 or (len(limits) == 3 and limits[2] < 1):
        raise ValueError(f"{b.place}: line {line_number}: is not a range; expected from, to, step")
    if len(limits) > 1 and limits[1] < limits[0]:
        raise ValueError(
            f"{b.place}: line {line_number}: the range ends below its first number {limits[0]}"
        )
    if len(limits) > 1 and limits[1] - limits[0] > LONGEST_RANGE:
        raise ValueError(
            f"{b.place}: line {line_number}: the range has more than {LONGEST_RANGE:,} numbers"
        )
    return numbers_in(*limits)


def _node_set(b: Keyword, sets: _Sets, mesh: _Mesh) -> Ints:
    """Numbers of the nodes of a set: listed ones, and those of a set of elements."""
    listed_nodes = _listed(b, "NSET", sets)
    if not b.options.get("ELSET"):
        return listed_nodes
    elements = sets.get("ELSET", b.options["ELSET"], b.scope, b.place)
    inside = mesh.cells[np.isin(mesh.element, elements)]
    return np.concatenate([listed_nodes, mesh.node[np.unique(inside)]])


def _facets(b: Keyword, content: FileContent, sets: _Sets, mesh: _Mesh) -> Ints:
    """Corners of the facets of a surface (n, 3), as rows of the nodes."""
    combine = b.options.get("COMBINE", "").upper()
    if combine:
        set_names = [w for _, line in b.lines for w in b.fields(line) if w]
        surfaces = [sets.get("SURFACE", name, b.scope, b.place) for name in set_names]
        return _combined(combine, surfaces, b.place)
    facets: list[Ints] = [np.zeros((0, 3), dtype=np.int64)]
    for line_number, line in b.lines:
        name, side = [*b.fields(line), ""][:2]
        side = side.upper().replace(" ", "")
        plain_name = sets.key(name, "")[1]
        if plain_name.isdigit():
            members = np.array([int(plain_name)])
        else:
            members = sets.get("ELSET", name, b.scope, b.place)
        solid = np.isin(mesh.element, members)
        if side in CORNERS_OF_FACES:
            rows = rows_of(mesh.element, members[np.isin(members, mesh.element)], "element")
            facets.append(mesh.cells[rows][:, CORNERS_OF_FACES[side]])
            if len(rows) < len(members):
                message = "surfaces with elements that are not tetrahedra of the file"
                content.notes += left_out(message, [b.options["NAME"]])
        elif side in ("SPOS", "SNEG") and not solid.any():
            facets.append(mesh.shells_of(members))
        elif not side:
            facets.append(mesh.shells_of(members))
            facets += [mesh.cells[solid][:, corners] for corners in CORNERS_OF_FACES.values()]
        else:
            raise ValueError(
                f"{b.place}: line {line_number}: {side} is not a face of a"
                " tetrahedron; expected S1 "
                "to S4, or none"
            )
    return np.concatenate(facets)


def _combined(operation: str, surfaces: list[Ints], place: str) -> Ints:
    """Return the union, intersection or difference of surfaces (n, 3)."""
    if operation not in ("UNION", "INTERSECTION", "DIFFERENCE") or not surfaces:
        raise ValueError(
            f"{place}: COMBINE={operation} is not read; expected UNION, INTERSECTION, DIFFERENCE"
        )
    if operation == "UNION":
        return np.concatenate(surfaces)
    first_surface, *other_surfaces = surfaces
    is_kept = np.ones(len(first_surface), dtype=bool)
    for other_surface in other_surfaces:
        known_facets = {tuple(corners) for corners in np.sort(other_surface, axis=1)}
        inside = [tuple(corners) in known_facets for corners in np.sort(first_surface, axis=1)]
        is_kept &= np.array(inside, dtype=bool) == (operation == "INTERSECTION")
    return first_surface[is_kept]


def _name(content: FileContent, used_keywords: list[Keyword], sets: _Sets, mesh: _Mesh) -> None:
    """Add regions and boundaries by the names of their sets."""
    sections = set()
    for b in used_keywords:
        if b.key == "SOLIDSECTION":
            sections.add(sets.existing_key("ELSET", b.option("ELSET"), b.scope, b.place))
    title = _titles(content, sets, "ELSET")
    solids: dict[Key, Ints] = {}
    for key in sets.member_functions["ELSET"]:
        members = sets.members("ELSET", key)
        solids[key] = np.unique(members[np.isin(members, mesh.element)])
        triangles = mesh.shells_of(members)
        if len(triangles):
            content.triangles[title[key]] = triangles
    regions = [key for key, members in solids.items() if len(members)]
    unused_sets = [k for k in regions if sections & {*regions} and k not in sections]
    content.notes += left_out(
        "sets without *SOLID SECTION, which are not regions",
        [title[k] for k in unused_sets],
    )
    for key in regions:
        if key not in unused_sets:
            content.sets[title[key]] = rows_of(mesh.element, solids[key], "element")
    boundary = _titles(content, sets, "SURFACE", "NSET")
    for key in sets.member_functions["SURFACE"]:
        corners = sets.members("SURFACE", key)
        if not len(corners):
            content.notes += left_out("surfaces without a facet", [boundary[key]])
        shells = content.triangles.get(boundary[key], corners)
        if not same_facets(shells, corners):
            message = "sets of shells that are not read, since surfaces have their names"
            content.notes += left_out(message, [boundary[key]])
        content.triangles[boundary[key]] = corners
    for key in sets.member_functions["NSET"]:
        content.nodes[boundary[key]] = rows_of(mesh.node, sets.members("NSET", key), "node")


def _titles(content: FileContent, sets: _Sets, *kinds: str) -> dict[Key, str]:
    """Names in the case, with the instance where several have a set of that name."""
    keys = dict.fromkeys(key for kind in kinds for key in sets.member_functions[kind])
    all_names = [name for _, name in keys]
    repeated = {key for key in keys if all_names.count(key[1]) > 1 and key[0]}
    titles = {k: f"{k[0]}.{sets.spelled[k]}" if k in repeated else sets.spelled[k] for k in keys}
    message = "sets of one name in several parts have the part before their name"
    content.notes += left_out(message, [titles[key] for key in keys if key in repeated])
    return titles
