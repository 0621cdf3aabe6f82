"""The field file: values read equal values written, also after interruptions of the run."""

from __future__ import annotations

import errno
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

from mpi4py import MPI

import h5py
import numpy as np
import pytest
from dolfinx import fem, mesh

from app.numerics import saved_state
from app.results import vtkhdf
from tests import support

STEPS = 3
EDGES = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))  # of VTK's quadratic tetrahedron


def displacement(x, step):
    return (step + 1.0) * np.array([x[0] ** 2, x[1] * x[2], x[0] - x[1]])


def temperature(x, step):
    return step + x[0] * x[1]


def stress(x, step):
    return np.array([(i + 1) * x[i % 3] + step for i in range(9)])


def write_cube(path, order):
    order = int(order)
    cube = mesh.create_unit_cube(MPI.COMM_WORLD, 3, 2, 2)
    space = fem.functionspace(cube, ("Lagrange", order))
    cells = cube.topology.index_map(3).size_local
    points, keys = space.tabulate_dof_coordinates(), saved_state.node_keys(space)
    middle = mesh.compute_midpoints(cube, 3, np.arange(cells, dtype=np.int32))
    nodes = space.dofmap.list[:cells]
    if order == 2:
        nodes = nodes[:, vtkhdf.QUADRATIC_NODES]
    region = {"region": (middle[:, 2] > 0.5).astype(np.int32)}
    numbers = cube.topology.original_cell_index[:cells]
    grid = vtkhdf.Grid(points, keys, nodes, numbers, region, {"names": ("one", "two")})
    file = vtkhdf.GridFile(cube.comm, path, grid)
    for step in range(STEPS):
        u, t = displacement(points.T, step).T, temperature(points.T, step)
        cell = {"stress": stress(middle.T, step).T, "height": middle[:, 2] + step}
        file.write(0.5 * step, {"displacement": u, "temperature": t}, cell)


def strip(path):
    """Triangles on [0, ranks] x [0, 2]. A rank has the column of squares right of x = rank."""
    comm = MPI.COMM_WORLD
    points = np.array([[comm.rank + x, y, 0.0] for x in (0, 1) for y in range(3)])
    quads = [(i, 3 + i, 4 + i, i + 1) for i in range(2)]
    triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    # Backwards: the file has the order of the keys.
    keys, numbers = -(points @ [3, 1, 0]).astype(int), -4 * comm.rank - np.arange(4)
    return vtkhdf.GridFile(comm, path, vtkhdf.Grid(points, keys, triangles, numbers)), points


def write_strip(path, steps=STEPS):
    file, points = strip(path)
    for step in range(steps):
        file.write(step, {"gap": points[:, 0] + step, "slip": points * step}, {})
    return file, points


def die_in_the_third_step(path):
    file, points = write_strip(path, 2)
    vtkhdf._commit = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
    file.write(2, {"gap": points[:, 0] + 2, "slip": points * 2}, {})


def fill_the_disk(path, reserve):
    """A limit on the size of a file replaces a full disk, because the same calls fail."""
    file, points = strip(path)
    values = np.repeat(points[:, 0], 3000).reshape(-1, 3000)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    if reserve == "no":  # as on a file system that promises room it does not have
        make_memory = os.memfd_create
        os.posix_fallocate = lambda *_: None
        # The limit holds for files in memory too, a full disk does not.
        os.memfd_create = lambda name: (
            resource.setrlimit(resource.RLIMIT_FSIZE, limits) or make_memory(name)
        )
    if MPI.COMM_WORLD.rank == 0:
        resource.setrlimit(resource.RLIMIT_FSIZE, (2_000_000, limits[1]))
    steps = 0
    try:
        while steps < 100:
            file.write(steps, {"values": values + steps}, {})
            steps += 1
    except OSError as error:
        assert error.errno == errno.EFBIG and str(path) in str(error), error
    assert 0 < steps < 100
    resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    MPI.COMM_WORLD.barrier()
    file.write(steps, {"values": values + steps}, {})
    assert file.steps == steps + 1


@pytest.fixture(params=[1, pytest.param(2, marks=pytest.mark.parallel)], ids=["serial", "2 ranks"])
def ranks(request):
    return request.param


def rows(root, kind, name, step):
    """The rows of a field at a step, for a reader."""
    start = root[f"Steps/{kind}Offsets/{name}"][step]
    count = root["NumberOfPoints" if kind == "PointData" else "NumberOfCells"][0]
    return root[f"{kind}/{name}"][start : start + count]


def offsets_are_zero(root):
    steps = root["Steps"]
    assert (steps["NumberOfParts"][:] == 1).all()
    for name in ("PartOffsets", "PointOffsets", "CellOffsets", "ConnectivityIdOffsets"):
        assert not steps[name][:].any() and len(steps[name]) == steps.attrs["NSteps"]
    assert steps["CellOffsets"].ndim == 2
    assert steps["ConnectivityIdOffsets"].ndim == 2


def strips_are_whole(root, steps):
    assert root["Steps"].attrs["NSteps"] == steps
    for step in range(steps):
        assert (rows(root, "PointData", "gap", step) == root["Points"][:, 0] + step).all()
        assert (rows(root, "PointData", "slip", step) == root["Points"][:] * step).all()


@pytest.mark.parametrize("order", [1, 2])
def test_vtkhdf_steps_are_read_back(tmp_path, ranks, order):
    path = tmp_path / "fields.vtkhdf"
    support.on_ranks(ranks, __file__, "write_cube", path, str(order))
    with h5py.File(path) as file:
        root = file["VTKHDF"]
        assert tuple(root.attrs["Version"]) == (2, 0)
        assert root.attrs["Type"] == b"UnstructuredGrid"
        nodes, kind = {1: (4, 10), 2: (10, 24)}[order]
        points = root["Points"][:]
        cells = root["Connectivity"][:].reshape(-1, nodes)
        sizes = [root[f"NumberOf{what}"][0] for what in ("Points", "Cells", "ConnectivityIds")]
        assert sizes == [(3 * order + 1) * (2 * order + 1) ** 2, 6 * 12, 6 * 12 * nodes]
        assert sizes == [len(points), len(cells), cells.size]
        assert (root["Offsets"][:] == nodes * np.arange(len(cells) + 1)).all()
        assert root["Types"].dtype == np.uint8 and set(root["Types"][:]) == {kind}
        assert len(np.unique(points.round(9), axis=0)) == len(points)
        corners = points[cells[:, :4]]
        volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
        assert np.isclose(np.abs(volumes).sum(), 1)
        for column, edge in zip(range(4, nodes), EDGES, strict=False):
            assert np.allclose(points[cells[:, column]], corners[:, edge].mean(axis=1))
        assert root["Steps"].attrs["NSteps"] == STEPS
        assert (root["Steps/Values"][:] == 0.5 * np.arange(STEPS)).all()
        offsets_are_zero(root)
        middle = corners.mean(axis=1)
        assert len(root["CellData/region"]) == len(cells)
        for step in range(STEPS):
            arrays = {k: rows(root, "PointData", k, step) for k in root["PointData"]}
            assert (arrays["displacement"] == displacement(points.T, step).T).all()
            assert (arrays["temperature"] == temperature(points.T, step)).all()
            arrays = {k: rows(root, "CellData", k, step) for k in root["CellData"]}
            assert np.allclose(arrays["stress"], stress(middle.T, step).T)
            assert np.allclose(arrays["height"], middle[:, 2] + step)
            assert (arrays["region"] == (middle[:, 2] > 0.5)).all()


def test_vtkhdf_surface_of_arrays(tmp_path, ranks):
    """Points and cells are in the order of their keys, on any number of ranks."""
    path = tmp_path / "surface.vtkhdf"
    support.on_ranks(ranks, __file__, "write_strip", path)
    with h5py.File(path) as file:
        root = file["VTKHDF"]
        points, cells = root["Points"][:], root["Connectivity"][:].reshape(-1, 3)
        assert (points == [(x, y, 0) for x in range(ranks, -1, -1) for y in (2, 1, 0)]).all()
        a, b, c = (points[cells[:, i]] for i in range(3))
        assert np.isclose(np.cross(b - a, c - a)[:, 2].sum() / 2, 2 * ranks)
        strips_are_whole(root, STEPS)


def test_vtkhdf_of_a_killed_run_has_finished_steps(tmp_path, ranks):
    path = tmp_path / "killed.vtkhdf"
    command = support.mpirun(ranks, __file__, "die_in_the_third_step", path)
    done = subprocess.run(command, env=support.environment(), capture_output=True, timeout=120)
    assert done.returncode != 0
    with h5py.File(path) as file:
        root = file["VTKHDF"]
        offsets_are_zero(root)
        strips_are_whole(root, 2)


@pytest.mark.parametrize("reserve", ["yes", "no"])
def test_vtkhdf_full_disk_is_an_error_on_every_rank(tmp_path, ranks, reserve):
    path = tmp_path / "full.vtkhdf"
    support.on_ranks(ranks, __file__, "fill_the_disk", path, reserve)
    with h5py.File(path) as file:
        root = file["VTKHDF"]
        for step in range(root["Steps"].attrs["NSteps"]):
            x = root["Points"][:, :1]
            assert (rows(root, "PointData", "values", step) == x + step).all()


def test_vtkhdf_refuses_wrong_fields(tmp_path):
    file, points = strip(tmp_path / "fields.vtkhdf")
    x = points[:, 0]
    file.write(0.0, {"u": x}, {})
    with pytest.raises(ValueError, match="every step writes the same fields"):
        file.write(1.0, {"w": x}, {})
    with pytest.raises(ValueError, match="PointData/u: components"):
        file.write(1.0, {"u": points}, {})
    file.write(1.0, {"u": x}, {})
    with h5py.File(tmp_path / "fields.vtkhdf") as hdf5:
        assert hdf5["VTKHDF/Steps"].attrs["NSteps"] == 2
    with pytest.raises(FileNotFoundError):
        write_strip(tmp_path / "no folder" / "surface.vtkhdf")


if __name__ == "__main__":
    globals()[sys.argv[1]](Path(sys.argv[2]), *sys.argv[3:])
