"""The mesh of the block of `tests.numerics.blocks`."""

from __future__ import annotations

import pytest

from meshes.distribute import TaggedMesh
from tests import support
from tests.numerics.blocks import BLOCK


@pytest.fixture(scope="module")
def tagged() -> TaggedMesh:
    return support.mesh(support.case(BLOCK))
