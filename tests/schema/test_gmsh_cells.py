"""Headers of gmsh files that lie about themselves, and scripts that are not closed."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from app.case import gmsh_header
from app.case.gmsh_cells import with_cells

HEAD = b"$MeshFormat\n2.2 1 8\n$EndMeshFormat\n$Elements\n1000\n"


@pytest.mark.parametrize("block", [(15, -1, 1), (4, 1, -6), (4, -2, 2)])
def test_a_block_that_leads_back_to_itself_is_not_followed(block: tuple[int, int, int]) -> None:
    """It would be read as often as the file says that there are elements: 10^18 times, say."""
    assert with_cells(HEAD + struct.pack("<3i", *block) * 4, [1, 2]) == {1, 2}


def test_an_open_comment_lasts_to_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in gmsh; to look for its end anew from each took time by the square of their number."""
    monkeypatch.setenv(gmsh_header.ALLOWED, "1")
    script = tmp_path / "open.geo"
    script.write_text("size = 1;\n" + "/* open " * 20_000 + '\nPhysical Volume("x") = {1};')
    assert gmsh_header.physical_names(script, 3) == ()
