"""Regions by the arrays of cells."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
import pytest

from tests.mesh_files.spellings import (
    CELLS,
    ODD,
    POINTS,
    TAGS,
    attribute,
    bonded,
    build,
    deck,
    elements,
    geometry,
    grid,
    messages_of,
    nodes,
    one_piece,
    refused,
    topology,
    vtu,
    whole,
    xdmf,
)


def test_regions_of_cells_without_a_region_are_counted(tmp_path: Path) -> None:
    more = "*SOLID SECTION, ELSET=bone\n1.0\n"
    data = build(tmp_path / "a.inp", deck(more=more))
    assert "6 of 12 cells of the file belong to no region" in messages_of(data)
    text = nodes() + elements(0, 6, "bone") + elements(6, 9, "cement") + elements(9, 12)
    data = build(tmp_path / "b.inp", text)
    assert "3 of 12 cells of the file belong to no region" in messages_of(data)


@pytest.mark.parametrize(
    ("data", "name"),
    [
        ({"material": TAGS.astype(np.float32)}, "material"),
        ({"constant": np.full(12, 10), "x": TAGS}, "x"),
        ({"flag": np.arange(12) % 2, "region": TAGS}, "region"),
        *(
            ({before: values, name: TAGS.astype(kind)}, name)
            for kind in ("f8", "f4", "i8")
            for before, values, name in (
                ("GlobalCellIds", np.arange(12), "material"),
                ("ElementType", np.full(12, 10), "label"),
                ("temperature", np.arange(12) / 7, "material"),
            )
        ),
    ],
)
def test_regions_are_named_by_an_array(data: dict, name: str, tmp_path: Path) -> None:
    blocks = {k: [v] for k, v in data.items()}
    (tmp_path / "a.vtu").write_bytes(vtu(one_piece(**data)))
    meshio.Mesh(POINTS, [("tetra", CELLS)], cell_data=blocks).write(tmp_path / "a.xdmf")
    for suffix in ("vtu", "xdmf"):
        mesh = bonded(tmp_path / f"a.{suffix}")
        whole(mesh, f"{name}_3", f"{name}_8")
        assert f"values of the array {name}" in messages_of(mesh)
        others = ", ".join(k for k in data if k != name)
        assert f"arrays of cells that are not read: {others}" in messages_of(mesh) or not others


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"a": TAGS, "b": ODD}, "a, b give different regions; set `geometry.array`"),
        ({"GlobalCellIds": np.arange(12)}, r"no array of its cells (GlobalCellIds) has"),
        ({"strain": np.linspace(0, 1, 12)}, r"no array of its cells (strain) has"),
    ],
)
def test_regions_by_disagreeing_arrays_are_refused(
    arrays: dict, words: str, tmp_path: Path
) -> None:
    assert words in refused(tmp_path / "a.vtu", vtu(one_piece(**arrays)))


@pytest.mark.parametrize("suffix", ["vtu", "xdmf"])
def test_regions_array_can_be_given(suffix: str, tmp_path: Path) -> None:
    """The file has several arrays, or one array with an unusual name."""
    path = tmp_path / f"a.{suffix}"
    arrays = {"material": ODD, "global_part": TAGS, "strain": np.linspace(0, 1, 12)}
    path.write_bytes(vtu(one_piece(**arrays)))
    if suffix == "xdmf":
        parts = [attribute(values, name) for name, values in arrays.items()]
        path.write_text(xdmf(grid(geometry(), topology(), *parts)))
    data = bonded(path, array="global_part")
    whole(data, "global_part_3", "global_part_8")
    assert "arrays of cells that are not read: material, strain" in messages_of(data)
    assert "has no array part of its cells; its arrays: material, global_part" in refused(
        path, array="part"
    )
    assert "its array strain does not number regions" in refused(path, array="strain")


def test_regions_parts_can_be_given(tmp_path: Path) -> None:
    path = tmp_path / "a.inp"
    path.write_text(deck())
    assert "`array` applies only to .vtu, .pvtu, .xdmf, .xmf" in refused(path, array="x")
    assert "`meshes` applies only to .med" in refused(path, meshes=["x"])
