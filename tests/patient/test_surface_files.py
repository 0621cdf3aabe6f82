"""Surface files of many programs: equal triangles, or a refusal with its reason."""

from __future__ import annotations

import random
import struct
import warnings
from pathlib import Path

import numpy as np
import pytest

from app.foundation.errors import GeometryError, InputError
from app.patient import bone_surface, landmarks, surface_files
from app.patient.bone_surface import BoneSurface
from tests.patient.bones import opened, parametric_femur, write
from tests.patient.surface_text import (
    CORNERS,
    PLACE,
    damaged,
    obj_faces,
    obj_vertices,
    ply_binary,
    ply_header,
    ply_text,
    put,
    stl_text,
    volume,
)

# A box of 2 x 3 x 5 as six quads, outward.
X = np.array([[x, y, z] for x in (0, 2) for y in (0, 3) for z in (0, 5)], dtype=float)
QUADS = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
TRIANGLES = [[q[0], q[k], q[k + 1]] for q in QUADS for k in (1, 2)]
BOX = BoneSurface(X, np.array(TRIANGLES))
VOLUME = 30.0
VERTICES = obj_vertices(X)
ALL = obj_faces(TRIANGLES)
STL = stl_text(BOX.corners)
HALVES = stl_text(BOX.corners[:6], "shaft"), stl_text(BOX.corners[6:], "head")
BINARY = (
    b"solid in the header of a binary file".ljust(80)
    + struct.pack("<I", 12)
    + b"".join(struct.pack("<12fH", 0, 0, 0, *x.ravel(), 7) for x in BOX.corners)
)


# Dialects of a box: file, triangles, a note.
SOUND: dict[str, tuple[str, str | bytes, int, str]] = {
    "normals": ("a.obj", VERTICES + "vn 0 0 1\n" + obj_faces(TRIANGLES, "{}//1".format), 12, ""),
    "texture": ("a.obj", VERTICES + "vt 0 0\n" + obj_faces(TRIANGLES, "{}/1".format), 12, ""),
    "both": (
        "a.obj",
        "mtllib a.mtl\no X\n"
        + VERTICES
        + "vt 0 0\nvn 0 0 1\ng x y\nusemtl m\ns off\n"
        # Not all faces have them.
        + obj_faces(TRIANGLES[:5], "{}/1/1".format)
        + "g z\n"
        + obj_faces(TRIANGLES[5:]),
        12,
        "",
    ),
    "colours": ("a.obj", obj_vertices(X, lambda k: " 0.5 0.5 0.5") + ALL, 12, ""),
    "weights": ("a.obj", obj_vertices(X, lambda k: " 1.0") + ALL, 12, ""),
    "half coloured": ("a.obj", obj_vertices(X, lambda k: " .1 .2 .3" * (k % 2)) + ALL, 12, ""),
    "negative": ("a.obj", VERTICES + obj_faces(TRIANGLES, lambda i: str(i - 9)), 12, ""),
    "negative, in blocks": (
        "a.obj",
        VERTICES
        + obj_faces(TRIANGLES[:6], lambda i: str(i - 9))
        + "v 9 9 9\nv 8 8 8\n"
        + obj_faces(TRIANGLES[6:], lambda i: str(i - 11)),
        12,
        "2 vertices without a face left out",
    ),
    "quads": ("a.obj", VERTICES + obj_faces(QUADS), 12, "6 faces with more than three corners"),
    "mixed": ("a.obj", VERTICES + obj_faces([*QUADS[:3], *TRIANGLES[6:]]), 12, "3 faces with more"),
    "lines": ("a.obj", VERTICES + "l 1 2\np 1\n" + ALL, 12, "not read: 1 of l, 1 of p"),
    "comments": ("a.obj", "# x\n\n" + VERTICES + ALL.replace("\n", " # y\n"), 12, ""),
    "tabs": ("A.OBJ", (VERTICES + ALL).replace(" ", "\t").replace("\n", "\r\n"), 12, ""),
    "continued": ("a.obj", VERTICES + ALL.replace(" 3\n", " \\\n 3\n"), 12, ""),
    "faces first": ("a.obj", ALL + VERTICES, 12, ""),
    "obj commas": (
        "a.obj",
        VERTICES.replace("v ", "v 0,").replace("v 0,2", "v 2,0").replace("v 0,0", "v 0,0") + ALL,
        12,
        "decimal commas",
    ),
    "vertex_index": ("a.ply", ply_text(BOX, None, ["list uchar int vertex_index"]), 12, ""),
    "vertex_index, binary": (
        "a.ply",
        ply_binary(BOX, None, ["list uchar int vertex_index"]),
        12,
        "binary PLY",
    ),
    "big endian": ("a.ply", ply_binary(BOX, order=">"), 12, ""),
    "colours of faces": (
        "a.ply",
        ply_binary(BOX, None, [*CORNERS, "uchar red", "uchar green"], after=b"\1\2"),
        12,
        "",
    ),
    "scalar before": ("a.ply", ply_binary(BOX, None, ["uchar f", *CORNERS], b"\7"), 12, ""),
    "scalar before, text": ("a.ply", ply_text(BOX, None, ["uchar f", *CORNERS], "7 "), 12, ""),
    "texture of faces": (
        "a.ply",
        ply_binary(
            BOX,
            None,
            [*CORNERS, "list uchar float texcoord"],
            after=struct.pack("<B6f", 6, *range(6)),
        ),
        12,
        "",
    ),
    "texture of no face": (
        "a.ply",
        ply_binary(BOX, None, [*CORNERS, "list uchar float texcoord"], after=b"\0"),
        12,
        "",
    ),
    "ply quads": ("a.ply", ply_text(BOX, QUADS), 12, "6 faces with more"),
    "ply quads, binary": ("a.ply", ply_binary(BOX, QUADS), 12, "6 faces with more"),
    "ply mixed": ("a.ply", ply_binary(BOX, [*QUADS[:3], *TRIANGLES[6:]]), 12, "3 faces with more"),
    "edges": (
        "a.ply",
        ply_text(BOX).replace("end_header", "element edge 1\nproperty int vertex1\nend_header")
        + "5\n",
        12,
        "elements that are not read: edge",
    ),
    "material before": (
        "a.ply",
        ply_text(BOX)
        .replace(
            "element vertex", "element material 2\nproperty list uchar uchar a\nelement vertex"
        )
        .replace("end_header\n", "end_header\n2 8 9\n0\n"),
        12,
        "not read: material",
    ),
    "text": ("a.stl", STL, 12, "text STL"),
    "capitals": ("a.STL", STL.upper(), 12, ""),
    "mark": ("a.stl", b"\xef\xbb\xbf" + STL.encode(), 12, ""),
    "utf-16": ("a.stl", STL.encode("utf-16"), 12, ""),
    "end solid": ("a.stl", STL.replace("endsolid", "end solid").replace("\n", "\r\n"), 12, ""),
    "no last newline": ("a.stl", STL.rstrip(), 12, ""),
    "commas": ("a.stl", STL.replace("2", "2,0").replace("3", "3,0"), 12, "decimal commas"),
    "name of keywords": ("a.stl", STL.replace(" femur", " vertex group 3 endsolid"), 12, ""),
    "no name": ("a.stl", STL.replace(" femur", ""), 12, ""),
    "bad normals": ("a.stl", STL.replace("normal 0 0 0", "normal -nan(ind) 1.#QNAN x"), 12, ""),
    "two solids": ("a.stl", "".join(HALVES), 12, "in 2 solids"),
    "binary": ("a.stl", BINARY, 12, "12 triangles of a binary STL"),
    "count 0": ("a.stl", BINARY[:80] + b"\0" * 4 + BINARY[84:], 12, "not from its header"),
    "count -1": ("a.stl", BINARY[:80] + b"\xff" * 4 + BINARY[84:], 12, "not from its header"),
    "bytes after": ("a.stl", BINARY + b"colours." * 10, 12, "80 bytes after its end"),
    "zeros after": ("a.stl", BINARY + b"\0" * 100, 12, "100 bytes after its end"),
}


@pytest.mark.parametrize("name", SOUND)
def test_surface_files_dialects_have_equal_triangles(name: str, tmp_path: Path) -> None:
    file, content, count, note = SOUND[name]
    corners, notes = surface_files.read(put(tmp_path, file, content))
    assert len(corners) == count
    assert volume(corners) == pytest.approx(VOLUME, rel=1e-6)
    assert note in "; ".join(notes)
    assert not note or len(notes) <= 3


STRIPS = ply_header("ascii", [("vertex", 3, PLACE), ("tristrips", 1, CORNERS)])
REFUSED: dict[str, tuple[str, str | bytes, str]] = {
    "off": ("a.off", "OFF\n", "ending `.off`; expected one of .stl, .ply, .obj"),
    "vtp": ("a.vtp", "<VTKFile>", "ending `.vtp`; expected"),
    "no suffix": ("a", STL, "ending ``; expected"),
    "off as stl": ("a.stl", "OFF\n8 6 0\n", "is an OFF file; expected one of .stl, .ply, .obj"),
    "pointer": ("a.stl", "version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
    "zip": ("a.ply", b"PK\x03\x04", "ZIP archive"),
    "page": ("a.obj", "<!DOCTYPE html>", "page of HTML"),
    "ply as stl": ("a.stl", ply_binary(BOX), "is a PLY file by its content; rename it"),
    "obj as stl": ("a.stl", VERTICES + ALL, "is an OBJ file by its content"),
    "stl as obj": ("a.obj", BINARY, "is an STL file by its content"),
    "text stl as ply": ("a.ply", STL, "is an STL file by its content"),
    "outside": ("a.obj", VERTICES + "f 1 2 99\n", "line 9: the face has a corner that is none"),
    "zero": ("a.obj", VERTICES + "f 0 1 2\n", "line 9: the face has a corner that is none"),
    "too far back": ("a.obj", VERTICES + "f -9 1 2\n", "line 9: the face has a corner"),
    "nan": ("a.obj", VERTICES.replace("v 2", "v nan") + ALL, "4 of its vertices are not numbers"),
    "two corners": ("a.obj", VERTICES + "f 1 2\n" + ALL, "line 9: the face has 2 corners"),
    "no numbers": ("a.obj", "v 1 x 2\n", "line 1: `v 1 x 2`: a vertex has three numbers"),
    "no faces": ("a.obj", VERTICES + "surf 1 2\n", "has no faces .*; it has lines of surf"),
    "ply of lists": (
        "a.ply",
        ply_text(BOX).replace("property float x", "property list uchar float x"),
        "`property list uchar float x`: a coordinate is not a list",
    ),
    "ply cut": (
        "a.ply",
        ply_text(BOX)[:-12],
        "element face has 12 rows in the header, but only 10",
    ),
    "ply cut, binary": (
        "a.ply",
        ply_binary(BOX)[:-20],
        "12 rows in the header, but only 10 in the file",
    ),
    "ply cut in vertices": ("a.ply", ply_binary(BOX)[:-220], "element vertex has 8 rows"),
    "ply of more": ("a.ply", ply_text(BOX) + "3 0 1 2\n", "4 words follow the rows"),
    "ply of more, binary": ("a.ply", ply_binary(BOX) + b"\1" * 13, "13 bytes follow the rows"),
    "ply outside": ("a.ply", ply_text(BOX, [[0, 1, 2], [0, 1, 8]]), "face 2 has a corner that"),
    "ply negative": ("a.ply", ply_binary(BOX, [[0, 1, -2]]), "face 1 has a corner that is none"),
    "cloud": ("a.ply", ply_header("ascii", [("vertex", 0, PLACE)]), "has no faces; its elements"),
    "strips": ("a.ply", STRIPS + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "are strips"),
    "no corners": ("a.ply", ply_text(BOX, None, ["list uchar int edges"]), "have no list vertex_"),
    "no header": ("a.ply", "ply\nformat ascii 1.0\n", "no line `end_header`"),
    "solid without end": (
        "a.stl",
        HALVES[0].replace("endsolid shaft\n", "") + HALVES[1],
        "solid that begins in line 1 has no `endsolid` after 6 facets",
    ),
    "cut on a facet": (
        "a.stl",
        "".join(HALVES).rpartition("facet normal")[0],
        "solid that begins in line 45 has no `endsolid` after 11 facets; is the file cut short",
    ),
    "cut in a facet": ("a.stl", STL[:-60], "cut short or damaged in a facet, after 11 facets"),
    "four corners": (
        "a.stl",
        STL.replace("vertex", "vertex 0 0 0\n vertex", 1),
        "line 2: expected a facet of three vertices, or `endsolid`",
    ),
    "word": ("a.stl", STL.replace("vertex 2 ", "vertex 2mm ", 1), "`2mm` is not a number"),
    "binary cut": ("a.stl", BINARY[:-50], "has 11 of the 12 triangles in its header"),
    "binary of more": ("a.stl", BINARY + BINARY[-50:], "header gives 12 triangles, .* contains 13"),
    "big endian": (
        "a.stl",
        BINARY[:80] + struct.pack(">I", 12) + BINARY[84:],
        "its 12 triangles are in big-endian order; .* Write it again",
    ),
    "small letters": ("a.stl", "<!doctype html><html>", "page of HTML"),
    "dicom": (
        "a.stl",
        bytes(128) + b"DICM" + bytes(99),
        "is an image of DICOM: give it as `image`",
    ),
    "two files": ("a.stl", BINARY + BINARY, "a second STL file follows its 12 triangles"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_surface_files_are_refused_with_the_reason(name: str, tmp_path: Path) -> None:
    file, content, message = REFUSED[name]
    with pytest.raises(GeometryError, match=message):
        surface_files.read(put(tmp_path, file, content))


def test_surface_files_damaged_are_read_or_refused(tmp_path: Path) -> None:
    """There is no other error and no warning in 240 files.

    Landmarks are sought on readable ones.
    """
    surface = opened(parametric_femur(), -150.0)
    whole = {
        "bone.stl": write(tmp_path / "a.stl", surface).read_bytes(),
        "text.stl": stl_text(surface.corners).encode(),
        "bone.obj": (obj_vertices(surface.points) + obj_faces(surface.triangles)).encode(),
        "bone.ply": ply_text(surface).encode(),
        "binary.ply": ply_binary(surface),
        "lists.ply": ply_binary(
            surface, None, [*CORNERS, "list uchar float t"], after=struct.pack("<Bf", 1, 0.5)
        ),
    }
    sought = 0
    for seed in range(240):
        rng = random.Random(seed)
        name = rng.choice(sorted(whole))
        path = put(tmp_path, name, damaged(rng, whole[name]))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                bone = bone_surface.read(path)
                if sought < 6 and bone.notes:
                    sought += 1
                    landmarks.find_landmarks(bone)
        except (GeometryError, InputError) as error:
            assert str(path) in str(error) or "geometry.bone" in str(error)
        except BaseException as error:
            raise AssertionError(f"seed {seed}: {name}") from error


def listed(binary: bool) -> bytes:
    """A PLY file of the box whose vertices have a list of other numbers, longer at some."""
    rows = [
        ("vertex", len(BOX.points), ("float x", "list uchar int marks", "float y", "float z")),
        ("face", len(TRIANGLES), CORNERS),
    ]
    numbers = [[k] * (k % 3) for k in range(len(BOX.points))]
    points = zip(BOX.points.tolist(), numbers, strict=True)
    if not binary:
        body = "".join(f"{x} {len(n)} {' '.join(map(str, n))} {y} {z}\n" for (x, y, z), n in points)
        body += "".join(f"3 {a} {b} {c}\n" for a, b, c in TRIANGLES)
        return (ply_header("ascii", rows) + body).encode()
    of_points = (struct.pack(f"<fB{len(n)}iff", x, len(n), *n, y, z) for (x, y, z), n in points)
    faces = (struct.pack("<B3i", 3, *t) for t in TRIANGLES)
    return ply_header("binary_little_endian", rows).encode() + b"".join([*of_points, *faces])


@pytest.mark.parametrize("binary", [False, True])
def test_surface_files_vertices_with_lists(binary: bool, tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(listed(binary))
    triangles, _ = surface_files.read(tmp_path / "a.ply")
    np.testing.assert_allclose(triangles, BOX.points[TRIANGLES], rtol=1e-6)


@pytest.mark.parametrize("header", [b"OFFSET surface", b"# vtk export", b"PK\x03\x04", b"<html"])
def test_surface_files_binary_stl_with_any_header(header: bytes, tmp_path: Path) -> None:
    corners = BOX.points[TRIANGLES].astype("<f4")
    body = b"".join(bytes(12) + t.tobytes() + bytes(2) for t in corners)
    path = tmp_path / "a.stl"
    path.write_bytes(header.ljust(80) + struct.pack("<I", len(corners)) + body)
    triangles, _ = surface_files.read(path)
    np.testing.assert_allclose(triangles, corners, rtol=1e-6)
    path.write_bytes(header.ljust(80) + struct.pack("<I", len(corners)) + body[:-60])
    with pytest.raises(GeometryError):
        surface_files.read(path)
