"""Substructures: the shared nodes are a smallest vertex cover; each rank has the others."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from app.numerics.substructures import vertex_cover

PAIRS = st.lists(st.tuples(st.integers(0, 5), st.integers(6, 11)), min_size=1, max_size=14)


@given(PAIRS)
@settings(max_examples=200, deadline=None)
def test_substructures_vertex_cover_is_minimal(pairs: list[tuple[int, int]]) -> None:
    """The test tries all smaller sets of nodes."""
    cover = set(vertex_cover(np.array(pairs)).tolist())
    assert all(cover & set(pair) for pair in pairs)
    nodes = {node for pair in pairs for node in pair}
    for fewer in combinations(nodes, len(cover) - 1):
        assert not all(set(fewer) & set(pair) for pair in pairs)
