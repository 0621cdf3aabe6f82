"""The run directory: fields, history, summary, provenance, and the marker of completion.

Every file is written under another name and renamed; a directory without ``DONE`` is not a result.
Rank 0 writes; an error there is raised on every rank.
"""

from __future__ import annotations

import csv
import hashlib
import io
import platform
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any, TypeVar

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from app import __version__
from app.bodies import cell_tags
from app.errors import StoppedError, everywhere
from app.folders import write_json, write_text
from app.problem import Problem
from app.quantities import Samples, Stresses
from app.vtkhdf import QUADRATIC_NODES, QUADRATIC_TETRAHEDRON, TETRAHEDRON, GridFile

Floats = NDArray[np.float64]
T = TypeVar("T")

UNITS = {
    "length": "mm",
    "area": "mm^2",
    "volume": "mm^3",
    "force": "N",
    "stress": "MPa",
    "energy": "N mm",
    "angle": "deg",
    "time": "s",
    "temperature": "degC",
}
RESULTS = ("DONE", "summary.json", "provenance.json", "history.csv", "fields.vtkhdf")


def on_root(comm: MPI.Comm, action: Callable[[], T], share: bool = True) -> T | None:
    """Do something on rank 0; its errors are raised on every rank, so that none waits.

    Args:
        comm: Communicator.
        action: What rank 0 does.
        share: Whether the result goes to the other ranks, else None does.
    """
    result = everywhere(comm, lambda: action() if comm.rank == 0 else None)
    return comm.bcast(result) if share else result


@contextmanager
def _full_disk(what: str) -> Iterator[None]:
    """Turn a failed write into a stop."""
    try:
        yield
    except OSError as error:
        raise StoppedError(f"cannot write {what}: {error.strerror or error}") from error


def _write(comm: MPI.Comm, action: Callable[[], None], what: str) -> None:
    """Write something on rank 0; a failure stops every rank.

    Raises:
        StoppedError: The disk is full or the folder cannot be written.
    """

    def guarded() -> None:
        with _full_disk(what):
            action()

    on_root(comm, guarded, share=False)


class Writer:
    """Writes a run directory step by step."""

    def __init__(
        self,
        problem: Problem,
        stresses: Stresses,
        folder: Path,
        resolved: str,
        fields: bool,
        record: Callable[[], dict[str, Any]],
    ) -> None:
        """Create the directory and the field file; collective.

        Args:
            problem: The problem, at rest.
            stresses: Its stresses.
            folder: The run directory; exists.
            resolved: The resolved configuration, as YAML.
            fields: Whether fields are written.
            record: Gives the provenance when the run ends.

        Raises:
            StoppedError: The directory cannot be written.
        """
        self._problem, self._stresses, self.folder = problem, stresses, folder
        self._comm, self._record = problem.comm, record
        self._rows: list[dict[str, Any]] = []

        def start() -> None:
            for name in RESULTS:
                (folder / name).unlink(missing_ok=True)
            write_text(folder / "case.yaml", resolved)

        _write(self._comm, start, str(folder))
        with _full_disk("fields.vtkhdf"):
            self._grids: tuple[_Fields, ...] = (
                (_Fields(problem, stresses, folder / "fields.vtkhdf"),) if fields else ()
            )

    def fields(self, time: float, samples: Samples | None) -> None:
        """Append a step to the field file; collective.

        Raises:
            StoppedError: The disk is full; earlier steps stay readable.
        """
        with _full_disk("fields.vtkhdf"):
            for grid in self._grids:
                grid.write(time, samples)

    def history(self, row: dict[str, Any]) -> None:
        """Add a row to history.csv; collective."""
        self._rows.append(row)
        text = io.StringIO()
        table = csv.DictWriter(text, fieldnames=list(self._rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(self._rows)
        path = self.folder / "history.csv"
        _write(self._comm, lambda: write_text(path, text.getvalue()), str(path))

    def finish(self, summary: dict[str, Any], done: bool) -> None:
        """Write summary and provenance, and the marker if the run is complete; collective."""

        def write() -> None:
            for name, content in (("summary", summary), ("provenance", self._record())):
                write_json(self.folder / f"{name}.json", content)
            if done:
                write_text(self.folder / "DONE", "")

        _write(self._comm, write, str(self.folder))


class _Fields:
    """The bodies with their own copies of interface nodes, so that gaps can be seen."""

    def __init__(self, problem: Problem, stresses: Stresses, path: Path) -> None:
        self._problem, self._stresses = problem, stresses
        mesh, bodies = problem.tagged.mesh, problem.bodies
        tags = cell_tags(problem.tagged)[: mesh.topology.index_map(3).size_local]
        dofs = problem.space.dofmap.list[: len(tags)]
        quadratic = problem.scene.order == 2
        body = bodies.of_tag[tags]
        # A node of each body it belongs to: (body, local dof) pairs.
        node = body[:, None] * (int(dofs.max(initial=0)) + 1) + dofs
        pairs, cells = np.unique(node, return_inverse=True)
        self._body, self._dof = np.divmod(pairs, int(dofs.max(initial=0)) + 1)
        cells = cells.reshape(dofs.shape)
        if quadratic:
            cells = cells[:, QUADRATIC_NODES]
        self._tags = tags
        self._point_of = self._contact_rows()
        self._grid = GridFile(
            problem.comm,
            path,
            problem.space.tabulate_dof_coordinates()[self._dof],
            cells,
            QUADRATIC_TETRAHEDRON if quadratic else TETRAHEDRON,
            {"region": tags.astype(np.int32)},
        )

    def _contact_rows(self) -> dict[int, NDArray[np.int64]]:
        """For each interface, the contact point of each node of the grid, -1 elsewhere."""
        rows: dict[int, NDArray[np.int64]] = {}
        index_map = self._problem.space.dofmap.index_map
        numbers = index_map.local_to_global(self._dof.astype(np.int32))
        for j in self._problem.jumps:
            p = j.points
            for i in range(len(self._problem.scene.contacts)):
                found = np.full(len(numbers), -1, dtype=np.int64)
                here = np.flatnonzero(p.interface == i)
                order = here[np.argsort(p.dof[here], kind="stable")]
                at = np.clip(np.searchsorted(p.dof[order], numbers), 0, max(len(order) - 1, 0))
                if len(order):
                    k = order[at]
                    match = (p.dof[k] == numbers) & (p.bodies[k] == self._body[:, None]).any(axis=1)
                    found[match] = k[match]
                rows[i] = found
        return rows

    def write(self, time: float, samples: Samples | None) -> None:
        """Append a step."""
        problem = self._problem
        u = np.zeros((len(self._dof), 3))
        for b, function in enumerate(problem.displacements()):
            at = self._body == b
            u[at] = function.x.array.reshape(-1, 3)[self._dof[at]]
        point: dict[str, Floats] = {"displacement": u}
        if samples is not None:
            for i, contact in enumerate(problem.scene.contacts):
                point |= self._interface(contact.name, samples, self._point_of[i])
        σ = np.zeros((len(self._tags), 9))
        for region, cells in self._stresses.cells.items():
            σ[cells] = self._stresses.mean(region).reshape(-1, 9)
        self._grid.write(time, point, {"stress": σ})

    @staticmethod
    def _interface(name: str, s: Samples, row: NDArray[np.int64]) -> dict[str, Floats]:
        """Fields of an interface at the grid's nodes: zero away from it, status -1."""
        on = row >= 0

        def spread(values: Floats, away: float = 0.0) -> Floats:
            out = np.full(len(row), away)
            out[on] = values[row[on]]
            return out

        return {
            f"{name}_gap": spread(s.gap.max(axis=1)),
            f"{name}_slip": spread(s.slip.max(axis=1)),
            f"{name}_pressure": spread(s.pressure),
            f"{name}_shear": spread(s.shear),
            f"{name}_status": spread(s.status.astype(float), -1.0),
        }


def provenance(
    problem: Problem, case_path: Path, overrides: list[str], mesh_hash: str, started: datetime
) -> dict[str, Any]:
    """Where a result comes from."""
    packages = {}
    for name in ("fenics-dolfinx", "petsc4py", "fenics-ufl", "fenics-basix", "mpi4py", "numpy"):
        try:
            packages[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return {
        "mantle": __version__,
        "command": sys.argv,
        "case": str(case_path),
        "case_sha256": hashlib.sha256(case_path.read_bytes()).hexdigest(),
        "overrides": overrides,
        "mesh_sha256": mesh_hash,
        "ranks": problem.comm.size,
        "host": platform.node(),
        "python": platform.python_version(),
        "packages": packages,
        "started": started.isoformat(timespec="seconds"),
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
    }
