"""Fields over time on a constant mesh, in one VTKHDF file.

VTKHDF is the HDF5 format of ParaView and VTK (``UnstructuredGrid``, version 2.0, VTK 9.3 or later).
The geometry and constant cell data are stored once, and every step adds its rows to each field.
Format: https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format/index.html

Rank 0 gathers and writes one step at a time. Collective HDF5 would need no gathering, but its ranks
wait for each other forever if the disk is full. Serial HDF5 crashes at exit after a write error. So
space for a step is reserved first, and a full disk is an ordinary ``OSError``. The file is open
only while a step is written, so that it is readable if the run is killed.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mpi4py import MPI  # before h5py, which may be built for MPI

import h5py
import numpy as np
import numpy.typing as npt

from app.foundation import files
from app.foundation.collective import on_root

Array = npt.NDArray[Any]

# VTK's type of a cell by its number of nodes: triangle, tetrahedron, quadratic tetrahedron.
CELL_TYPES = {3: 5, 4: 10, 10: 24}
# Index in basix's order (edges 23 13 12 03 02 01) of each node in VTK's (01 12 02 03 13 23).
QUADRATIC_NODES = (0, 1, 2, 3, 9, 6, 8, 7, 5, 4)
# HDF5 metadata per array [bytes]: 168 kB were measured for the first offsets of 50 fields.
_METADATA = 1 << 20


@dataclass(frozen=True)
class Grid:
    """Points and cells of a rank. A rank without cells has empty arrays of the same types.

    Points and cells are in the file in the order of their keys, so that the file does not depend on
    the ranks. Several ranks may have the same point, with the same values.

    Attributes:
        points: Coordinates (n, 3) [mm].
        point_keys: Keys of the points (n,).
        cells: Points of each cell (m, nodes per cell), in VTK's node order.
        cell_keys: Keys of the cells (m,); each cell is on one rank.
        cell_data: Constant values in the cells (m,) or (m, components).
        texts: Lists of words, constant over the grid.
    """

    points: Array
    point_keys: Array
    cells: Array
    cell_keys: Array
    cell_data: Mapping[str, Array] = field(default_factory=dict)
    texts: Mapping[str, Sequence[str]] = field(default_factory=dict)


class GridFile:
    """File of a grid and its fields over time, from the arrays of each rank.

    Args:
        comm: The ranks.
        path: Path of the file.
        grid: Points and cells of this rank.
        steps: Number of steps of an existing file that are kept; later ones are overwritten.

    Raises:
        OSError: The file cannot be written, or has too few steps of such a grid (on every rank).
    """

    def __init__(self, comm: MPI.Comm, path: Path, grid: Grid, steps: int = 0) -> None:
        self.comm, self.path, self.steps = comm, path, steps
        self._constant, self._texts = frozenset(grid.cell_data), tuple(grid.texts)
        self._names: tuple[frozenset[str], frozenset[str]] | None = None
        # Rows of the file among the gathered rows of all ranks, on rank 0.
        keys, points = np.unique(self._gather(grid.point_keys), return_index=True)
        cells = np.argsort(self._gather(grid.cell_keys))
        self._rows = {"PointData": points, "CellData": cells}
        if steps:
            on_root(comm, lambda: _cut(path, len(points), len(cells), steps))
            return
        x, nodes = self._gather(grid.points), self._gather(grid.point_keys[grid.cells])
        cell_data = {name: self._gather(values)[cells] for name, values in grid.cell_data.items()}
        cells = np.searchsorted(keys, nodes[cells])
        full_grid = replace(grid, points=x[points], cells=cells, cell_data=cell_data)
        on_root(comm, lambda: _create(path, full_grid))

    def write(self, time: float, point: Mapping[str, Array], cell: Mapping[str, Array]) -> None:
        """Add one step (collective); the file is complete and closed when this returns.

        After an error the file has the earlier steps, and the step may be written again.

        Args:
            time: Time of the step in stages [-]. With `fracture_step` it may fall.
            point: Values at this rank's points, shape (n,) or (n, components).
            cell: Values in this rank's cells, shape (m,) or (m, components). VTK takes nine
                components as a tensor by rows, and six as xx, yy, zz, xy, yz, xz.

        Raises:
            OSError: The file cannot be written (on every rank).
            ValueError: Names or components of fields differ from those of the first step.
        """
        field_names = frozenset(point), frozenset(cell)
        if self._names not in (None, field_names) or not self._constant.isdisjoint(cell):
            raise ValueError(
                f"{self.path}: every step writes the same fields, once: not {field_names}"
            )
        arrays = {}
        for group_name, fields in (("PointData", point), ("CellData", cell)):
            for name, values in fields.items():
                arrays[f"{group_name}/{name}"] = self._gather(values), self._rows[group_name]
        start_rows = {name: self.steps * len(rows) for name, (_, rows) in arrays.items()}
        start_rows |= {f"CellData/{name}": 0 for name in self._constant}
        start_rows |= {f"FieldData/{name}": 0 for name in self._texts}

        def write() -> None:
            with _edit(self.path, sum(values.nbytes for values, _ in arrays.values())) as root:
                for name, (values, rows) in arrays.items():
                    _put(root, name, values[rows], start_rows[name], chunk=len(rows))
            _commit(self.path, self.steps, time, start_rows)

        on_root(self.comm, write, share=False)
        self._names = field_names
        self.steps += 1

    def _gather(self, values: Array) -> Array:
        """Return the rows of all ranks on rank 0, nothing on other ranks."""
        rank_values = self.comm.gather(values)
        return values[:0] if rank_values is None else np.concatenate(rank_values)


def _create(path: Path, grid: Grid) -> None:
    points, cells = grid.points, grid.cells
    with h5py.File(path.name, "w", driver="core", backing_store=False) as file:
        root = file.create_group("VTKHDF")
        root.attrs["Version"] = (2, 0)
        root.attrs["Type"] = np.bytes_("UnstructuredGrid")
        root["NumberOfPoints"] = np.array([len(points)])
        root["NumberOfCells"] = np.array([len(cells)])
        root["NumberOfConnectivityIds"] = np.array([cells.size])
        root["Points"] = np.asarray(points, np.float64)
        root["Connectivity"] = cells.ravel()
        root["Offsets"] = cells.shape[1] * np.arange(len(cells) + 1)
        root["Types"] = np.full(len(cells), CELL_TYPES[cells.shape[1]], np.uint8)
        for name in ("PointData", "CellData", "FieldData"):
            root.create_group(name)
            root.create_group(f"Steps/{name}Offsets")
        for name, values in grid.cell_data.items():
            root[f"CellData/{name}"] = values
        for name, texts in grid.texts.items():
            # VTK reads only this encoding.
            ascii_words = [text.encode("ascii", "replace") for text in texts]
            text_type = h5py.string_dtype("ascii")
            root.create_dataset(f"FieldData/{name}", data=ascii_words, dtype=text_type)
        root["Steps"].attrs["NSteps"] = 0
        file.flush()
        files.write_bytes(path, file.id.get_file_image())


def write_last_step(path: Path, target: Path) -> None:
    """Write the last step of a closed file to a file without time, which is replaced.

    Raises:
        OSError: The file cannot be written.
    """
    with (
        h5py.File(path, "r", locking=False) as file,
        h5py.File(target.name, "w", driver="core", backing_store=False) as new_file,
    ):
        source, root = file["VTKHDF"], new_file.create_group("VTKHDF")
        root.attrs.update(source.attrs)
        for name in source.keys() - {"Steps", "PointData", "CellData"}:
            source.copy(name, root)
        for group_name, rows in (("PointData", "Points"), ("CellData", "Types")):
            for name, values in source[group_name].items():
                start_row = int(source[f"Steps/{group_name}Offsets/{name}"][-1])
                root[f"{group_name}/{name}"] = values[start_row : start_row + len(source[rows])]
        new_file.flush()
        files.write_bytes(target, new_file.id.get_file_image())


def _cut(path: Path, points: int, cells: int, steps: int) -> None:
    """Truncate a file to some steps; OSError if it is damaged, or its grid or steps differ."""
    try:
        with _edit(path, 0) as root:
            steps_in_file = int(root["Steps"].attrs["NSteps"])
            is_same_size = (len(root["Points"]), len(root["Types"])) == (points, cells)
            if not is_same_size or steps_in_file < steps:
                raise OSError(errno.EINVAL, "not the file that was written", str(path))
            root["Steps"].attrs.modify("NSteps", steps)
    except KeyError as error:
        raise OSError(errno.EIO, str(error), str(path)) from error


def _commit(path: Path, step: int, time: float, start_rows: Mapping[str, int]) -> None:
    """Make a step visible to readers, after its values; they start at a row of each array."""
    rows: dict[str, Array] = {"Values": np.array([float(time)]), "NumberOfParts": np.array([1])}
    rows |= {name: np.array([0]) for name in ("PartOffsets", "PointOffsets")}
    rows |= {name: np.array([[0]]) for name in ("CellOffsets", "ConnectivityIdOffsets")}
    rows |= {name.replace("/", "Offsets/"): np.array([row]) for name, row in start_rows.items()}
    with _edit(path, 0) as root:
        for name, values in rows.items():
            _put(root, f"Steps/{name}", values, step, chunk=64)
        root.file.flush()
        root["Steps"].attrs.modify("NSteps", step + 1)


def _put(root: h5py.Group, name: str, values: Array, start_row: int, chunk: int) -> None:
    """Write rows into a dataset from row ``start`` on; create or enlarge it."""
    shape = values.shape[1:]
    try:
        data_id = h5py.h5d.open(root.id, name.encode())
    except KeyError:
        chunks, largest_shape = (max(chunk, 1), *shape), (None, *shape)
        dataset = root.create_dataset(
            name, (0, *shape), values.dtype, maxshape=largest_shape, chunks=chunks
        )
        data_id = dataset.id
    if data_id.shape[1:] != shape:
        raise ValueError(f"{name}: components {shape} instead of {data_id.shape[1:]}")
    # The low-level interface, because h5py's indexing takes longer than writing a small array.
    data_id.set_extent((start_row + len(values), *shape))
    rows = data_id.get_space()
    rows.select_hyperslab((start_row, *(0 for _ in shape)), values.shape)
    data_id.write(h5py.h5s.create_simple(values.shape), rows, values)


@contextmanager
def _edit(path: Path, size: int) -> Iterator[h5py.Group]:
    """Open the file to add arrays of a size [bytes]; OSError if there is no space for them."""
    with path.open("r+b") as plain_file:
        file_end = plain_file.seek(0, os.SEEK_END)
        try:
            os.posix_fallocate(plain_file.fileno(), file_end, size + _METADATA)
        except OSError as error:
            plain_file.truncate(file_end)
            raise OSError(error.errno, error.strerror, str(path)) from error
    # No lock, because a reader that has the file open must not stop the run. No cache, so that an
    # error occurs where values are written. Closing the file frees unused space.
    file = h5py.File(path, "r+", locking=False, rdcc_nbytes=0)
    try:
        yield file["VTKHDF"]
        file.flush()
    except (OSError, RuntimeError) as error:
        # HDF5 would crash later on data that it cannot write, so this data remains in memory.
        with open(os.memfd_create(path.name), "wb") as memory:
            os.dup2(memory.fileno(), file.id.get_vfd_handle())
        code = getattr(error, "errno", None) or errno.EIO
        raise OSError(code, os.strerror(code), str(path)) from error
    finally:
        file.close()
