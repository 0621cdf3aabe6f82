"""Files ``.vtu`` and ``.pvtu``: encodings, pieces, ghost cells."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from app.mesh_files.vtu import lz4_decompress
from tests.mesh_files.spellings import (
    CELLS,
    MATERIALS,
    PACKERS,
    POINTS,
    TAGS,
    bonded,
    build,
    cut,
    messages_of,
    one_piece,
    pvtu,
    refused,
    vtu,
    whole,
)

# ---------------------------------------------------------------------------------------- .vtu


@pytest.mark.parametrize("pieces", [1, 3])
@pytest.mark.parametrize("packer", PACKERS)
@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("header", ["UInt32", "UInt64"])
@pytest.mark.parametrize("way", ["raw", "appended", "binary"])
def test_vtu_encodings_are_read(
    way: str, header: str, order: str, packer: str, pieces: int, tmp_path: Path
) -> None:
    data = build(tmp_path / "a.vtu", vtu(cut(pieces), way, header, order, packer))
    whole(data, *MATERIALS)
    assert len(data.cells) == len(CELLS)
    assert ("has 3 pieces, which are read as one mesh" in messages_of(data)) == (pieces == 3)


def test_vtu_in_text_and_in_two_pieces(tmp_path: Path) -> None:
    data = build(tmp_path / "a.vtu", vtu(cut(2)))
    whole(data, *MATERIALS)
    assert "has 2 pieces" in messages_of(data)


def test_vtu_ghost_and_doubled_cells_are_counted_once(tmp_path: Path) -> None:
    data = build(tmp_path / "twice.vtu", vtu(one_piece() * 2))
    whole(data, *MATERIALS)
    assert "12 cells stand twice" in messages_of(data)
    owned = one_piece(material=TAGS, vtkGhostType=np.zeros(12, "u1"))
    ghosts = [(POINTS, CELLS[:5], {"material": TAGS[:5], "vtkGhostType": np.ones(5, "u1")})]
    data = build(tmp_path / "ghost.vtu", vtu(owned + ghosts))
    whole(data, *MATERIALS)
    assert "5 ghost cells" in messages_of(data)


@pytest.mark.parametrize("below", ["", "box/"])
@pytest.mark.parametrize("parts", [1, 2, 3])
def test_vtu_parallel_pieces_of_all_files_are_joined(
    parts: int, below: str, tmp_path: Path
) -> None:
    path = pvtu(tmp_path, parts, below)
    data = bonded(path)
    whole(data, *MATERIALS)
    assert len(data.cells) == len(CELLS)
    assert (f"{parts} pieces, which are read as one mesh" in messages_of(data)) == (parts > 1)
    if parts > 1:
        doubled = sum(len(piece[0]) for piece in cut(parts)) - len(POINTS)
        assert f"{doubled} nodes are merged" in messages_of(data)


def test_vtu_parallel_pieces_that_are_missing_are_named(tmp_path: Path) -> None:
    path = pvtu(tmp_path, 3)
    for k in (0, 2):
        (tmp_path / f"box_{k}.vtu").unlink()
    assert "2 of its 3 pieces are not there: box_0.vtu, box_2.vtu" in refused(path)


def test_vtu_parallel_pieces_that_are_damaged_or_elsewhere_are_named(tmp_path: Path) -> None:
    path = pvtu(tmp_path, 2)
    text = path.read_text()
    piece = tmp_path / "box_1.vtu"
    raw = piece.read_bytes()
    piece.write_bytes(raw[:400])
    assert "its piece box_1.vtu: " in refused(path)
    piece.write_bytes(vtu([(*cut(2)[1][:2], {"other": cut(2)[1][2]["material"]})]))
    assert "its pieces have different arrays of cells" in refused(path)
    piece.write_bytes(raw)
    path.write_text(text.replace("box_1", "../box_1"))
    assert "its pieces ../box_1.vtu are not in its folder or below" in refused(path)
    path.write_text(text.replace("PUnstructured", "PPoly"))
    assert "is PPolyGrid; expected PUnstructuredGrid" in refused(path)


def test_vtu_lz4_blocks_with_copies() -> None:
    """The block has three letters, six copied from three before (overlapping), and a last one."""
    assert lz4_decompress(b"\x32abc\x03\x00\x10x") == b"abcabcabcx"
