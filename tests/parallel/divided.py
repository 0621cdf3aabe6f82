"""``mantle run`` on ranks with given cells, started by `test_ranks`."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx.cpp.graph import AdjacencyList_int32
from scipy.spatial import cKDTree

from app import cli
from app.foundation import dolfinx_features
from app.simulation import model
from meshes.data import MeshData
from meshes.distribute import TaggedMesh, distribute

Ints = np.ndarray


def between(data: MeshData) -> Ints:
    """Cells on either side of each facet between regions (n, 2)."""
    neighbours = data.neighbours
    cell = np.repeat(np.arange(len(data.cells)), 4)
    other = neighbours.ravel()
    on = (other >= 0) & (data.cell_tags[cell] != data.cell_tags[other])
    return np.column_stack([cell[on], other[on]])


def board(data: MeshData, ranks: int) -> Ints:
    """Cubes alternate between ranks, so all bodies and interfaces are cut many times."""
    x = data.points[data.cells[:, :4]].mean(axis=1)
    edge = np.ptp(x, axis=0).min() / 3.5
    owner = np.floor((x - x.min(axis=0)) / edge).astype(int).sum(axis=1) % ranks
    pairs = between(data)
    if len(pairs):
        assert len(set(owner[pairs[:, 0]])) == ranks, "not all have a part of the interfaces"
        assert (owner[pairs[:, 0]] != owner[pairs[:, 1]]).any()
    return np.asarray(owner)


def bodies(data: MeshData, ranks: int) -> Ints:
    """Each region is on one rank.

    No rank has cells on both sides of an interface, except ghosts.
    """
    owner = (data.cell_tags - data.cell_tags.min()) % ranks
    for tag in set(data.cell_tags):
        assert len(set(owner[data.cell_tags == tag])) == 1
    return np.asarray(owner)


def far(data: MeshData, ranks: int) -> Ints:
    """The last rank has a few cells far from all interfaces, the others those of `board`."""
    owner = board(data, max(ranks - 1, 1))
    near = np.unique(between(data))
    nodes = np.unique(data.cells[near, :4])
    x = data.points[data.cells[:, :4]].mean(axis=1)
    distance, _ = cKDTree(data.points[nodes]).query(x)
    distance[near] = -1.0
    few = np.argsort(distance)[-max(len(x) // 50, 5) :]
    owner[few[distance[few] > 0]] = ranks - 1
    assert ranks - 1 in owner
    return owner


WAYS: dict[str, Callable[[MeshData, int], Ints]] = {"board": board, "bodies": bodies, "far": far}


def destinations(data: MeshData, owner: Ints) -> AdjacencyList_int32:
    """Ranks of each cell: its owner first, then the owners of its neighbours."""
    neighbours = data.neighbours
    rows = []
    for mine, others in zip(owner, np.where(neighbours >= 0, owner[neighbours], -1), strict=True):
        rows.append([mine, *sorted(set(others) - {mine, -1})])
    offsets = np.cumsum([0, *map(len, rows)]).astype(np.int32)
    return AdjacencyList_int32(np.concatenate(rows).astype(np.int32), offsets)


def given(way: str) -> Callable[[MeshData | None, MPI.Comm], TaggedMesh]:
    """`distribute` with the destinations of a scheme."""

    def divided(data: MeshData | None, comm: MPI.Comm) -> TaggedMesh:
        def partitioner(*_: Any) -> AdjacencyList_int32:
            if data is None:
                return AdjacencyList_int32(np.zeros(0, np.int32), np.zeros(1, np.int32))
            return destinations(data, WAYS[way](data, comm.size))

        usual = dolfinx_features.partitioner
        dolfinx_features.partitioner = lambda ghosts: partitioner
        try:
            tagged = distribute(data, comm)
        finally:
            dolfinx_features.partitioner = usual
        mine = tagged.cell_tags.values[: tagged.mesh.topology.index_map(3).size_local]
        have = comm.gather([int((mine == tag).sum()) for tag in tagged.regions.values()])
        if comm.rank == 0:
            print("divided:", have, flush=True)
        return tagged

    return divided


if __name__ == "__main__":
    model.distribute = given(os.environ["DIVIDED"])
    sys.exit(cli.main())
