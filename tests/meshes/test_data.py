"""Arrays of a mesh."""

from __future__ import annotations

import numpy as np

from meshes.data import connected


def test_data_connected_components_are_numbered_by_their_first_nodes() -> None:
    """Nodes 0 and 4, 1 and 3 and 5 are joined, a pair twice, and 2 is joined to itself."""
    a, b = np.array([(4, 0), (5, 3), (3, 1), (1, 3), (2, 2)]).T
    assert connected(6, a, b).tolist() == [0, 1, 2, 1, 0, 1]
    without_pairs = np.zeros(0, dtype=int)
    assert connected(2, without_pairs, without_pairs).tolist() == [0, 1]
    assert connected(0, without_pairs, without_pairs).tolist() == []
