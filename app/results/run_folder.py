"""The run directory: fields, history, summary, provenance, and the marker of completion.

Files are written under a temporary name and then renamed; fields are appended to one file. Only a
directory with the file ``DONE`` is a result. Rank 0 writes. Its errors are raised on every rank.
"""

from __future__ import annotations

import logging
import platform
import time as clock
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import TypedDict

from mpi4py import MPI

from app import __version__
from app.case import number_text
from app.case.summary import Summary
from app.foundation import files
from app.foundation.collective import on_root
from app.results.field_output import FieldGroup, Fields
from app.results.interface_numbers import ContactSamples
from app.results.path_tables import PathTables
from app.system import identity
from app.system.folders import (
    ENDS,
    RESULTS,
    csv_text,
    path_file,
    path_files,
    saved,
    write_json,
    write_text,
    writing,
)
from meshes.distribute import TaggedMesh

UNITS = {what.partition(" ")[2]: unit for unit, what in number_text.UNITS.items() if unit != "-"}
UNITS |= {"memory": "MB", "memory per unknown": "kB"}
# Shortest time between two writes of history.csv [s].
OFTEN = 1.0
PACKAGES = "fenics-dolfinx petsc4py fenics-ufl fenics-basix mpi4py numpy h5py".split()
log = logging.getLogger("mantle")


def _write(comm: MPI.Comm, action: Callable[[], None], what: str) -> None:
    """Write on rank 0; a full disk or a missing permission stops every rank."""

    def guarded() -> None:
        with writing(what):
            action()

    on_root(comm, guarded, share=False)


class Provenance(TypedDict):
    """Content of ``provenance.json``.

    Attributes:
        mantle: Version of the program.
        identity: Digests of the program and its libraries.
        case: Path of the case.
        case_sha256: Digest of the case.
        based_on_sha256: Digests of the files that the case builds upon, by path.
        overrides: Options ``--set``.
        mesh_sha256: Digest of the mesh.
        ranks: Number of ranks.
        processor: Name of the processor.
        python: Version of Python.
        packages: Versions of the main libraries.
        started: Time of the start (ISO 8601).
        finished: Time of the end (ISO 8601).
    """

    mantle: str
    identity: Mapping[str, str]
    case: str
    case_sha256: str
    based_on_sha256: Mapping[str, str]
    overrides: Sequence[str]
    mesh_sha256: str
    ranks: int
    processor: str
    python: str
    packages: Mapping[str, str]
    started: str
    finished: str


class Writer:
    """Writer of a run directory, step by step.

    Args:
        groups: Sources of the fields: mechanics and heat, or one of them.
        resolved: The resolved configuration, as YAML.
        record: Function that returns the provenance when the run ends.
        resumed: True if the run restarts, so that existing files stay.
        paths: Files of paths, if the case has some.

    Attributes:
        fields: The field file, if fields are written.
        field_steps: Number of steps in it.

    Raises:
        StoppedError: The directory cannot be written.
    """

    saved = ("columns", "rows", "field_steps", "paths")

    def __init__(
        self,
        tagged: TaggedMesh,
        groups: Sequence[FieldGroup],
        folder: Path,
        resolved: str,
        fields: bool,
        record: Callable[[], Provenance],
        resumed: bool = False,
        paths: PathTables | None = None,
    ) -> None:
        self.folder, self._comm, self._record = folder, tagged.mesh.comm, record
        self.paths = paths
        # Rows are kept as text, because a run may have thousands of steps.
        self.columns, self.rows = list[str](), ""
        self._written = self._paths_written = -OFTEN

        def start() -> None:
            files.clear(folder)
            for name in ENDS if resumed else RESULTS:
                (folder / name).unlink(missing_ok=True)
            for old_file in () if resumed else (*saved(folder), *path_files(folder).values()):
                old_file.unlink()
            write_text(folder / "case.yaml", resolved)

        _write(self._comm, start, str(folder))
        self.field_steps = 0
        self.fields = Fields(tagged, groups, folder / "fields.vtkhdf") if fields else None
        if not resumed:
            self._begin()

    def _begin(self) -> None:
        self.field_steps = 0
        if self.fields:
            with writing("fields.vtkhdf"):
                self.fields.open()

    def restored(self) -> None:
        """Continue the files of a restored run; collective.

        Raises:
            StoppedError: The directory cannot be written.
        """
        self._table()
        self._path_tables()
        if self.fields and self.field_steps:
            try:
                self.fields.open(self.field_steps)
                return
            except OSError:
                log.info("fields.vtkhdf is missing or not usable: a new one starts here")
        self._begin()

    def write_fields(
        self, step: int, time: float, seconds: float | None, samples: ContactSamples | None
    ) -> None:
        """Append a step to the field file and to the files of paths; collective.

        Raises:
            StoppedError: The disk is full; earlier steps stay readable.
        """
        if self.paths:
            self.paths.add(step, time, seconds, samples)
            self._path_tables(OFTEN)
        if self.fields:
            with writing("fields.vtkhdf"):
                self.fields.write(time, samples)
            self.field_steps += 1

    def last_fields(self) -> None:
        """Write the last written step of the fields, if any, to a separate file; collective.

        Raises:
            StoppedError: The disk is full.
        """
        if self.fields and self.field_steps:
            _write(self._comm, self.fields.close, "final.vtkhdf")

    def add_row(self, row: Mapping[str, float | None]) -> None:
        """Add a row to history.csv, which is written at most once in `OFTEN`; collective."""
        new_columns = [name for name in row if name not in self.columns]
        if new_columns:
            self.columns += new_columns
            self.rows = self.rows.replace("\n", "," * len(new_columns) + "\n")
        full_row = {name: row.get(name, "") for name in self.columns}
        self.rows += csv_text([full_row]).partition("\n")[2]
        self._table(OFTEN)

    def _table(self, often: float = 0.0) -> None:
        path = self.folder / "history.csv"

        def write() -> None:
            if clock.monotonic() - self._written >= often:
                header = csv_text([dict.fromkeys(self.columns)]).partition("\n")[0]
                write_text(path, f"{header}\n{self.rows}")
                self._written = clock.monotonic()

        _write(self._comm, write, str(path))

    def _path_tables(self, often: float = 0.0) -> None:
        """Write the files of paths if the last time was ``often`` or longer ago; collective."""
        rows = self.paths.rows if self.paths else {}

        def write() -> None:
            if clock.monotonic() - self._paths_written >= often:
                for name, file_text in rows.items():
                    write_text(self.folder / path_file(name), file_text)
                self._paths_written = clock.monotonic()

        _write(self._comm, write, "files of paths")

    def finish(self, summary: Summary, complete: bool) -> None:
        """Write summary and provenance, and the marker if the run is complete; collective."""
        if self.rows:
            self._table()
            self._path_tables()

        def write() -> None:
            if self.fields and not self.field_steps:  # a file without any step
                (self.folder / "fields.vtkhdf").unlink(missing_ok=True)
            write_json(self.folder / "summary.json", summary)
            write_json(self.folder / "provenance.json", self._record())
            if complete:
                write_text(self.folder / "DONE", "")

        _write(self._comm, write, str(self.folder))


def provenance(
    ranks: int,
    digests: Mapping[str, str],
    overrides: Sequence[str],
    mesh_hash: str,
    started: datetime,
) -> Provenance:
    """Return the provenance of a result.

    The first entry of ``digests`` is that of the case. Those of the files that it builds upon
    follow. Files have the digests with which they were read.
    """
    (case, digest), *other_digests = digests.items()
    return {
        "mantle": __version__,
        "identity": identity.versions(),
        "case": case,
        "case_sha256": digest,
        "based_on_sha256": dict(other_digests),
        "overrides": overrides,
        "mesh_sha256": mesh_hash,
        "ranks": ranks,
        "processor": _processor(),
        "python": platform.python_version(),
        "packages": _packages(),
        "started": started.isoformat(timespec="seconds"),
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
    }


@cache
def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):
        lines = []
    models = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(models, platform.machine())


@cache
def _packages() -> dict[str, str]:
    versions = {}
    for name in PACKAGES:
        for distribution in metadata.distributions(name=name):
            versions[name] = distribution.version
    return versions
