"""Pieces of a mesh."""

from __future__ import annotations

import numpy as np

from meshes.pieces import coincident


def test_pieces_coincident_nodes_in_any_order() -> None:
    rng = np.random.default_rng(3)
    x = rng.random((500, 3))
    again = rng.choice(500, 40, replace=False)
    both = np.vstack([x, x[again] + 1e-10])
    assert sorted(map(tuple, coincident(both).tolist())) == sorted(
        (int(k), 500 + i) for i, k in enumerate(again)
    )
