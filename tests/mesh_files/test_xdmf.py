"""Files ``.xdmf``: grids, arrays, included parts, faults."""

from __future__ import annotations

import re
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

from app.case.mesh_names import content_hash
from app.foundation.errors import GeometryError
from app.mesh_files import named
from meshes.data import region_volumes
from tests.mesh_files.spellings import (
    AREA,
    BOTTOM_SIDES,
    CELLS,
    GRIDS,
    MATERIALS,
    MESH,
    MIXED,
    NODES_OF_MESH,
    ODD,
    POINTS,
    TAGS,
    VOLUMES,
    attribute,
    build,
    geometry,
    grid,
    include,
    messages_of,
    refused,
    topology,
    whole,
    xdmf,
)


@pytest.mark.parametrize("name", GRIDS)
def test_xdmf_grids_are_one_mesh(name: str, tmp_path: Path) -> None:
    text, sets, note = GRIDS[name]
    data = build(tmp_path / "a.xdmf", text)
    areas = whole(data, *MATERIALS)
    assert len(data.cells) == len(CELLS)
    assert "belong to no region" not in messages_of(data) and note in messages_of(data)
    assert (f"its grids have {sets} sets of nodes" in messages_of(data)) == (sets > 1)
    assert areas == pytest.approx({"material_5": AREA} if name == "mixed" else {})


def test_xdmf_cells_of_a_grid_without_an_array_are_counted(tmp_path: Path) -> None:
    bone = grid(geometry(), topology(CELLS[:6]), attribute(np.full(6, 4)))
    rest = grid(NODES_OF_MESH.replace("[@Name='mesh']", ""), topology(CELLS[6:]))
    data = build(tmp_path / "a.xmf", xdmf(bone, rest))
    assert region_volumes(data) == pytest.approx({"material_4": VOLUMES["bone"]})
    assert "6 of 12 cells of the file belong to no region" in messages_of(data)


def test_xdmf_arrays_of_several_grids_on_the_same_cells(tmp_path: Path) -> None:
    """An array called material has priority. Otherwise the case must name one of several arrays."""
    path = tmp_path / "a.xdmf"

    def tagged(first: str, second: str) -> str:
        tags = [
            grid(NODES_OF_MESH, topology(), attribute(values, name))
            for name, values in ((first, ODD), (second, TAGS))
        ]
        return xdmf(MESH, *tags)

    whole(build(path, tagged("a", "material")), *MATERIALS)
    text = tagged("a", "b")
    assert "its arrays a, b give different regions" in refused(path, text)
    data = build(path, text, array="b")
    whole(data, "b_3", "b_8")
    assert "arrays of cells that are not read: a" in messages_of(data)


def test_xdmf_arrays_of_triangles_are_all_boundaries(tmp_path: Path) -> None:
    triangles = topology(BOTTOM_SIDES, "Triangle")
    walls = grid(
        NODES_OF_MESH,
        triangles,
        attribute(np.array([1, 1]), "wall"),
        attribute(np.array([1, 2]), "half"),
        attribute(np.array([0.1, 0.2]), "pressure"),
    )
    tags = grid(NODES_OF_MESH, topology(), attribute(TAGS))
    data = build(tmp_path / "a.xdmf", xdmf(MESH, tags, walls))
    expected = {"wall_1": AREA, "half_1": AREA / 2, "half_2": AREA / 2}
    assert whole(data, *MATERIALS) == pytest.approx(expected)
    assert "boundaries are the values of the array wall" in messages_of(data)
    assert "arrays of cells that are not read: pressure" in messages_of(data)


@pytest.mark.parametrize("form", ["HDF", "Binary", "Binary big"])
def test_xdmf_arrays_in_other_files(form: str, tmp_path: Path) -> None:
    """Arrays are read from any folder, and are part of the content."""
    arrays = {"x y": POINTS, "cells": CELLS.astype("i8"), "tags": TAGS.astype("i8")}
    order = ">" if "big" in form else "<"
    endian = ' Endian="Big"' if "big" in form else ' Endian="Little"'
    with h5py.File(tmp_path / "me & my data.h5", "w") as file:
        for name, values in arrays.items():
            file[f"mesh/{name}"] = values
            raw = values.astype(values.dtype.newbyteorder(order)).tobytes()
            (tmp_path / f"{name}.bin").write_bytes(b"skip" + raw)
    text = xdmf(grid(geometry(), topology(), attribute(TAGS)))
    for name, item in zip(arrays, re.findall(r"<DataItem.*?<", text), strict=True):
        place = f"me &amp; my data.h5:/mesh/{name}" if form == "HDF" else f"{name}.bin"
        head = item[: item.index(">")].replace("XML", form.split()[0])
        head += "" if form == "HDF" else f'{endian} Seek="4"'
        text = text.replace(item, f"{head}> {place} <")
    path = tmp_path / "a.xdmf"
    whole(build(path, text), *MATERIALS)
    files = {*named.names(path)}
    other = {"me & my data.h5"} if form == "HDF" else {f"{name}.bin" for name in arrays}
    assert files == {"a.xdmf", *other}
    outside = text.replace("> ", "> ../", 1)
    assert "is not in its folder or below" in refused(tmp_path / "b.xdmf", outside)
    (tmp_path / min(other)).unlink()
    assert f"its file {min(other)} is missing" in refused(path)


CUBE = np.arange(8)[None]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (xdmf(grid(topology(), attribute(TAGS), name="x")), "its grid x has no Geometry"),
        (xdmf(grid(geometry(), name="x")), "its grid x has no Topology"),
        (
            xdmf(grid(geometry().replace("XYZ", "XY"), topology(), attribute(TAGS))),
            "its nodes are of type XY; expected XYZ",
        ),
        (
            xdmf(grid(geometry(), topology(CUBE, "Hexahedron"))),
            "the cells are of type Hexahedron; only straight tetrahedra",
        ),
        (
            xdmf(grid(geometry(), topology(np.insert(CUBE, 0, 9), "Mixed"))),
            "the cells are of type hexahedron; only straight tetrahedra",
        ),
        (
            xdmf(grid(geometry(), topology(np.insert(CUBE, 0, 99), "Mixed"))),
            "has a cell of type 99",
        ),
        (xdmf(grid(geometry(), topology(MIXED[:-2], "Mixed"))), "mixed cells are cut short"),
        (xdmf(grid(geometry(), topology(np.array([2, -2, 0]), "Mixed"))), "a cell of type 0"),
        (
            xdmf(grid(geometry(), topology(CELLS + 1), attribute(TAGS), name="x")),
            "its grid x: a cell has a node that is not in the file",
        ),
        (
            xdmf(grid(geometry(), topology(), attribute(TAGS[:5]))),
            "its array material does not have one value for each of 12 cells",
        ),
        (
            xdmf(grid(include("xpointer(/Xdmf/Domain/Grid/Nodes)"), topology())),
            "refers to /Xdmf/Domain/Grid/Nodes, which is not in the file",
        ),
        (
            xdmf(grid('<xi:include href="b.xmf"/>', geometry(), topology())),
            "includes parts of other files; save it as one file",
        ),
        (
            xdmf(grid(geometry(), topology(), attribute(TAGS))).replace(
                "<DataItem", '<DataItem ItemType="HyperSlab"'
            ),
            "an array is a HyperSlab, which is not read",
        ),
        (
            xdmf(grid(geometry(), topology(), attribute(TAGS))).replace('"12 3"', '"13 3"'),
            "an array has 36 values for 13 x 3",
        ),
    ],
)
def test_xdmf_useless_file_is_refused_with_reason(text: str, words: str, tmp_path: Path) -> None:
    assert words in refused(tmp_path / "a.xdmf", text)


def test_xdmf_grids_that_overlap_are_refused(tmp_path: Path) -> None:
    """The second grid has cells on the faces of the first, at new nodes."""
    (a, b, c, d), n = CELLS[0], len(POINTS)
    apart = np.vstack([POINTS, POINTS[d] + 0.1, POINTS[d] + 0.2])
    cells, tags = np.vstack([CELLS, [[a, b, c, n], [a, b, c, n + 1]]]), np.append(TAGS, [1, 1])
    text = xdmf(grid(geometry(apart), topology(cells), attribute(tags)))
    with pytest.raises(GeometryError, match="a face belongs to more than two cells"):
        build(tmp_path / "a.xdmf", text)


def test_xdmf_with_numbers_in_the_file_is_hashed_in_linear_time(tmp_path: Path) -> None:
    numbers = " ".join(map(repr, np.random.default_rng(3).random(100_000).tolist()))
    path = tmp_path / "a.xdmf"
    path.write_text(
        f'<Xdmf><DataItem Format="XML">{numbers}</DataItem><D> my data.h5:/x</D></Xdmf>'
    )
    start = time.process_time()
    before = content_hash(path)
    assert time.process_time() - start < 1.0
    (tmp_path / "my data.h5").write_bytes(b"1")
    assert content_hash(path) != before
    assert named.names(path) == ["a.xdmf", "my data.h5"]
