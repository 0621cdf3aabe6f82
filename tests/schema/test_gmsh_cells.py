"""Headers of binary gmsh files that lie about themselves."""

from __future__ import annotations

import struct

import pytest

from mantle.schema.gmsh_cells import with_cells

HEAD = b"$MeshFormat\n2.2 1 8\n$EndMeshFormat\n$Elements\n1000\n"


@pytest.mark.parametrize("block", [(15, -1, 1), (4, 1, -6), (4, -2, 2)])
def test_a_block_that_leads_back_to_itself_is_not_followed(block: tuple[int, int, int]) -> None:
    """It would be read as often as the file says that there are elements: 10^18 times, say."""
    assert with_cells(HEAD + struct.pack("<3i", *block) * 4, [1, 2]) == {1, 2}
