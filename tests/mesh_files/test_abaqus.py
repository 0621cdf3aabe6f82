"""Files ``.inp`` of Abaqus and CalculiX: names, instances, coordinate systems, faults."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from app.case.geometries import MeshFile
from tests.mesh_files.spellings import (
    ALL_FREE,
    AREA,
    BOTTOM,
    CELLS,
    FACES,
    FREE,
    ORIGIN,
    POINTS,
    TOP,
    build,
    deck,
    messages_of,
    nodes,
    on,
    refused,
    surface,
    system,
    whole,
)

# ---------------------------------------------------------------------------------------- .inp


def test_abaqus_names_that_become_equal_are_refused(tmp_path: Path) -> None:
    for raw in ("utf-8", "latin-1"):
        (tmp_path / "a.inp").write_bytes(deck("Schraube_ä", "Schraube_ö").encode(raw))
        with pytest.raises(
            ValueError, match="Schraube_ä and Schraube_ö are both called Schraube__"
        ):
            MeshFile(path=tmp_path / "a.inp")


def test_abaqus_dots_are_characters_without_an_instance(tmp_path: Path) -> None:
    more = surface("load.top", TOP) + surface("fix.top", BOTTOM)
    areas = whole(
        build(tmp_path / "a.inp", deck("bone_v1.2", "cement_v1.2", more)),
        "bone_v1_2",
        "cement_v1_2",
    )
    assert areas == pytest.approx({"load_top": AREA, "fix_top": AREA})


SECTIONS = "".join(f"*SOLID SECTION, ELSET={n}\n" for n in ("bone", "cement"))


def test_abaqus_parts_without_an_instance_are_ignored(tmp_path: Path) -> None:
    unused = "*PART, NAME=unused\n*NODE\n901,0,0,0\n902,1,0,0\n903,0,1,0\n904,0,0,1\n"
    unused += "*ELEMENT, TYPE=C3D4, ELSET=spare\n901,901,902,903,904\n*END PART\n"
    text = f"{unused}*PART, NAME=P\n{deck(more=SECTIONS)}*END PART\n*ASSEMBLY, NAME=A\n"
    text += "*INSTANCE, NAME=I-1, PART=P\n*END INSTANCE\n*ELSET, ELSET=both, INSTANCE=I-1\n"
    text += "I-1.bone, cement\n*SURFACE, NAME=all\nboth\n*END ASSEMBLY\n"
    data = build(tmp_path / "a.inp", text)
    assert whole(data)["all"] == pytest.approx(ALL_FREE)
    assert "parts without an instance: unused" in messages_of(data)


def test_abaqus_dots_begin_with_an_instance_where_it_is_one(tmp_path: Path) -> None:
    text = f"*PART, NAME=hip\n{deck('bone_v1.2', 'cement_v1.2')}*END PART\n*ASSEMBLY, NAME=a\n"
    text += "*INSTANCE, NAME=hip-1, PART=hip\n*END INSTANCE\n"
    text += "*SURFACE, NAME=load.top\nhip-1.cement_v1.2\n*END ASSEMBLY\n"
    areas = whole(build(tmp_path / "a.inp", text), "bone_v1_2", "cement_v1_2")
    assert areas["load_top"] == pytest.approx(ALL_FREE - FREE)


def test_abaqus_sets_of_one_name_in_two_instances_are_kept_apart(tmp_path: Path) -> None:
    text = ""
    for part, first, cells in (("P", 0, range(6)), ("Q", 100, range(6, 12))):
        used = np.unique(CELLS[list(cells)])
        text += f"*PART, NAME={part}\n*NODE\n"
        text += "".join(f"{k + 1 + first}, {', '.join(map(str, POINTS[k]))}\n" for k in used)
        text += "*ELEMENT, TYPE=C3D4, ELSET=Set-1\n"
        for k in cells:
            text += f"{k + 1}, " + ", ".join(str(v + 1 + first) for v in CELLS[k]) + "\n"
        text += "*SOLID SECTION, ELSET=Set-1\n*END PART\n"
    text += "*ASSEMBLY, NAME=A\n"
    for part in "PQ":
        text += f"*INSTANCE, NAME={part}-1, PART={part}\n*END INSTANCE\n"
    data = build(tmp_path / "a.inp", f"{text}*SURFACE, NAME=s\nQ-1.Set-1\n*END ASSEMBLY\n")
    assert whole(data, "P-1_Set-1", "Q-1_Set-1")["s"] == pytest.approx(ALL_FREE - FREE)
    assert "before their name: P-1.Set-1, Q-1.Set-1" in messages_of(data)


def in_system(system: str, points: np.ndarray) -> np.ndarray:
    """Coordinates in a system of *NODE: cylindrical, spherical."""
    x, y, z = points.T
    theta = np.degrees(np.arctan2(y, x))
    if system == "C":
        return np.column_stack([np.hypot(x, y), theta, z])
    latitude = np.degrees(np.arctan2(z, np.hypot(x, y)))
    return np.column_stack([np.linalg.norm(points, axis=1), theta, latitude])


@pytest.mark.parametrize("option", ["R", "C", "S", "c", "Spherical"])
def test_abaqus_coordinates_in_other_systems(option: str, tmp_path: Path) -> None:
    system = option[0].upper()
    given = POINTS if system == "R" else in_system(system, POINTS)
    text = deck(start=nodes(given, f", SYSTEM={option}"))
    data = build(tmp_path / "a.inp", text)
    whole(data)
    np.testing.assert_allclose(data.points, POINTS, atol=1e-12)


def test_abaqus_spherical_angles_are_longitude_and_latitude(tmp_path: Path) -> None:
    """phi is 0 in the plane across the polar axis, theta in the plane of x and that axis."""
    rows = np.array([[2, 30, 60], [2, 0, 0], [2, 90, 0], [2, 45, 90]])
    text = nodes(rows, ", SYSTEM=S") + "*ELEMENT, TYPE=C3D4, ELSET=a\n1, 1, 2, 3, 4\n"
    data = build(tmp_path / "a.inp", text)
    expected = [[3**0.5 / 2, 0.5, 3**0.5], [2, 0, 0], [0, 2, 0], [0, 0, 2]]
    np.testing.assert_allclose(in_order(data.points), in_order(expected), atol=1e-12)


def in_order(points: object) -> np.ndarray:
    """Points by their coordinates."""
    return np.array(sorted(np.round(points, 9).tolist()))


TURN = Rotation.from_euler("xyz", [25, -40, 70], degrees=True).as_matrix()
UPRIGHT = Rotation.from_euler("z", 115, degrees=True).as_matrix()


# Lines of *SYSTEM, and the directions of its axes in columns.
SYSTEMS = {
    "moved": (system(ORIGIN), np.eye(3)),
    "upright": (system([ORIGIN, ORIGIN + 2 * UPRIGHT[:, 0] + [0, 0, 3]]), UPRIGHT),
    "turned": (
        system([ORIGIN, ORIGIN + 2 * TURN[:, 0]], ORIGIN + 0.3 * TURN[:, 0] + 1.7 * TURN[:, 1]),
        TURN,
    ),
}


@pytest.mark.parametrize("kind", ["R", "C", "S"])
@pytest.mark.parametrize("name", SYSTEMS)
def test_abaqus_nodes_in_axes_of_a_system(name: str, kind: str, tmp_path: Path) -> None:
    """Nodes from the fifth on are in the axes of the system, the last four in the global ones."""
    start, axes = SYSTEMS[name]
    local = (POINTS - ORIGIN) @ axes
    local = local if kind == "R" else in_system(kind, local)
    lines = nodes(local, f", SYSTEM={kind}").splitlines(keepends=True)
    plain = nodes().splitlines(keepends=True)
    text = "".join([*plain[:5], start, lines[0], *lines[5:9], "*SYSTEM\n", plain[0], *plain[9:]])
    data = build(tmp_path / "a.inp", deck(start=text))
    whole(data)
    np.testing.assert_allclose(data.points, POINTS, atol=1e-12)


def test_abaqus_axes_of_a_system_end_with_their_part(tmp_path: Path) -> None:
    other = "*PART, NAME=b\n*NODE\n31, 0, 0, 9\n32, 1, 0, 9\n33, 0, 1, 9\n34, 0, 0, 10\n"
    other += "*ELEMENT, TYPE=C3D4, ELSET=small\n91, 31, 32, 33, 34\n*END PART\n"
    first = f"*PART, NAME=a\n{deck(start=system(ORIGIN) + nodes(POINTS - ORIGIN))}*END PART\n"
    ends = "".join(f"*INSTANCE, NAME={p}-1, PART={p}\n*END INSTANCE\n" for p in "ab")
    text = f"{first}{other}*ASSEMBLY, NAME=A\n{ends}*END ASSEMBLY\n"
    data = build(tmp_path / "a.inp", text, interfaces={"between": ["bone", "cement"]})
    expected = np.concatenate([POINTS, [[0, 0, 9], [1, 0, 9], [0, 1, 9], [0, 0, 10]]])
    np.testing.assert_allclose(in_order(data.points), in_order(expected), atol=1e-12)


TOP_BY_SETS = "".join(
    f"*ELSET, ELSET=top{s}\n{', '.join(str(e) for e, t in on(TOP) if t == s)}\n"
    for s in {s for _, s in on(TOP)}
)
TOP_FIRST = "*SURFACE, NAME=top\n"
TOP_FIRST += "".join(f"top{s}, S{s}\n" for s in sorted({s for _, s in on(TOP)}))
BLANK = re.sub(r"(?<!\d)0\.0", "", deck())
SKIN = "*ELEMENT, TYPE=S3, ELSET=skin\n90,1,2,4\n91,1,4,3\n*SURFACE, NAME=s\nskin, "
COMBINED = """*SURFACE, NAME=u, COMBINE=UNION
a, b
*SURFACE, NAME=d, COMBINE=DIFFERENCE
u, a
*SURFACE, NAME=i, COMBINE=INTERSECTION
u, b
*SURFACE, NAME=none, COMBINE=INTERSECTION
a, b
*SURFACE, NAME=free
bone
cement
*SURFACE, NAME=rest, COMBINE=DIFFERENCE
free
u
"""
COMBINED_AREAS = {"a": AREA, "b": AREA, "u": 2 * AREA, "d": AREA, "i": AREA}
COMBINED_AREAS |= {"free": ALL_FREE, "rest": ALL_FREE - 2 * AREA}
NESTED = "*ELSET, ELSET=a\nb\n*ELSET, ELSET=b\nbone\n*SURFACE, NAME=s\na\n"
OF_ELEMENTS = "*NSET, NSET=n, ELSET=bone\n*SURFACE, TYPE=NODE, NAME=n2\nn, 1.0\n"
FIRST = "*SURFACE, NAME=free\nall\n*ELSET, ELSET=all\nbone, cement\n" + SECTIONS
# An end of each kind of spelling: text, areas of boundaries.
SPELLINGS = {
    "plain": (deck(), {}),
    "empty fields": (BLANK, {}),
    "later sets": (deck(more=TOP_FIRST + TOP_BY_SETS + SECTIONS), {"top": AREA}),
    "sets of sets": (deck(more=NESTED + SECTIONS), {"s": FREE}),
    "sets before all": (FIRST + deck(), {"free": ALL_FREE}),
    "Fortran": (deck().replace("3.0", "3.0D+00").replace("5.0", "0.5d1"), {}),
    "combined": (
        deck(more=surface("a", BOTTOM) + surface("b", TOP) + COMBINED),
        COMBINED_AREAS,
    ),
    "combined before": (
        deck(more=COMBINED + surface("a", BOTTOM) + surface("b", TOP)),
        COMBINED_AREAS,
    ),
    "continued": (deck().replace("C3D4, ELSET=bone", "C3D4,\n  ELSET=bone"), {}),
    "two lines": (deck().replace("ELSET=bone\n1, ", "ELSET=bone\n1,\n"), {}),
    "tabs": (deck().replace("*ELEMENT,", "*ELEMENT\t,\t").replace(", ", ",\t"), {}),
    "mark": ("\ufeff" + deck(), {}),
    "quotes": (deck('"bone"', '"cement"'), {}),
    "normals": (re.sub(r"(?m)(\.0)$", r"\1, 0., 0., 1.", deck()), {}),
    "lower case": (deck().lower().replace("\n", "\r\n"), {}),
    "comments": (deck().replace("*ELEMENT", "** of the mesh\n\n*Element"), {}),
    "SPOS": (deck(more=f"{SKIN}SPOS\n"), {"skin": AREA, "s": AREA}),
    "SNEG": (deck(more=f"{SKIN}SNEG\n"), {"skin": AREA, "s": AREA}),
    "SPOS of quotes": (
        deck(more=f"{SKIN}SPOS\n".replace("skin", '"skin of it"')),
        {"skin_of_it": AREA, "s": AREA},
    ),
    "nodes of elements": (deck(more=OF_ELEMENTS), {"n": FREE, "n2": FREE}),
}


@pytest.mark.parametrize("name", SPELLINGS)
def test_abaqus_spellings(name: str, tmp_path: Path) -> None:
    text, areas = SPELLINGS[name]
    data = build(tmp_path / "a.inp", text)
    assert whole(data) == pytest.approx(areas)
    assert ("coordinates of nodes are empty" in messages_of(data)) == (name == "empty fields")


def test_abaqus_blanks_in_quotes_count(tmp_path: Path) -> None:
    more = '*SURFACE, NAME="its skin"\n"upper one"\n'
    data = build(tmp_path / "a.inp", deck('"upper one"', "cement", more))
    assert whole(data, "upper_one") == pytest.approx({"its_skin": FREE})


@pytest.mark.parametrize("encoding", ["utf-16", "latin-1"])
def test_abaqus_encodings(encoding: str, tmp_path: Path) -> None:
    whole(build(tmp_path / "a.inp", deck("Knochen_ä").encode(encoding)), "Knochen__")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            deck().replace("TYPE=C3D4, ELSET=bone", "ELSET=bone"),
            "*ELEMENT in line 14: has no option TYPE=; its options: ELSET",
        ),
        (deck().replace("=bone", "="), "*ELEMENT in line 14: has no option ELSET="),
        (
            deck().replace("ELSET=bone", "ELSE=bone"),
            "line 14: has no option ELSE; did you mean ELSET",
        ),
        (deck(more="*ELSET, NAME=x\n1\n"), "line 28: has no option ELSET"),
        (deck(more="*SURFACE, NAME=x\nbone, S7\n"), "line 29: S7 is not a face of a tetrahedron"),
        (
            deck(more="*SURFACE, NAME=x\nbone, SPOS\n"),
            "line 29: SPOS is not a face of a tetrahedron",
        ),
        (deck(more="*ELSET, ELSET=x\ny\n*ELSET, ELSET=y\nx\n"), "contains itself"),
        (deck(more="*ELSET, ELSET=x\nbonn\n"), "the file has no set bonn"),
        (
            deck(more="*ELSET, ELSET=x, GENERATE\n4, 1\n*SOLID SECTION, ELSET=x\n1.0\n"),
            "line 29: the range ends below its first number 4",
        ),
        (deck().replace("*NODE", "*NODE, INPUT=b.txt"), "takes numbers from another file"),
        (deck().replace("*NODE", "*NODE, SYSTEM=P"), "SYSTEM=P is not read; expected R, C or S"),
        (f"*SYSTEM\n0, 0, 0, 1, x\n{deck()}", "*SYSTEM in line 1: line 2: 'x' is not a number"),
        (
            f"*SYSTEM\n0, 0, 0, 1, 0, 0\n2, 0, 0\n{deck()}",
            "line 1: its points are on a straight line",
        ),
        (f"*SYSTEM\n0, 0, 0, 0, 0, 1\n{deck()}", "line 1: its points are on a straight line"),
        (f"*SYSTEM\n0, 0, 0, 1, 0, 0, 0, 1, 0\n{deck()}", "line 2: 9 numbers; expected at most 6"),
        (f"*SYSTEM\n0, 0, 0\n0, 1, 0\n1, 0, 0\n{deck()}", "line 1: has more than two lines"),
        (re.sub(r"(?<=\d)\.(?=\d)", ",", deck()), "line 2: 7 numbers for a node and three"),
        (deck().replace("3.0", "3.x"), "line 3: '3.x' is not a number"),
        (deck(more="*SOLID SECTION, ELSET=bon\n1.0\n"), "the file has no set bon"),
    ],
)
def test_abaqus_faults_name_the_line(text: str, words: str, tmp_path: Path) -> None:
    assert words in refused(tmp_path / "a.inp", text)


@pytest.mark.parametrize("height", [BOTTOM, TOP])
def test_abaqus_surface_and_shells_of_one_name(height: float, tmp_path: Path) -> None:
    facets = [CELLS[e - 1][list(FACES[side - 1])] + 1 for e, side in on(height)]
    shells = [", ".join(map(str, [900 + k, *facet])) for k, facet in enumerate(facets)]
    rows = "\n".join(["*ELEMENT, TYPE=S3, ELSET=load", *shells, ""])
    data = build(tmp_path / "a.inp", deck(more=surface("load", TOP) + rows))
    assert whole(data)["load"] == pytest.approx(AREA)
    note = "geometry: sets of shells that are not read, since surfaces have their names: load"
    assert (note in data.notes["messages"]) == (height != TOP)
