"""Arrays of a mesh."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from meshes.data import connected


def test_data_connected_components_equal_those_of_scipy() -> None:
    rng = np.random.default_rng(3)
    for n, pairs in ((1, 0), (40, 25), (200, 190), (300, 900)):
        a, b = rng.integers(0, n, (2, pairs))
        graph = coo_array((np.ones(pairs), (a, b)), shape=(n, n))
        _, expected = connected_components(graph, directed=False)
        np.testing.assert_array_equal(connected(n, a, b), expected)
