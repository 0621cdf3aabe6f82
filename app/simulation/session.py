"""A run as requested: one case, or its variations one after another."""

from __future__ import annotations

import logging
import os
import time as clock
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from mpi4py import MPI

from app import errors
from app.case.case import Case, LoadedCase, Varied
from app.numerics.newton import raw_options
from app.results import closing_lines as text
from app.results.run_folder import on_root
from app.simulation import checkpoint, finished_runs, variations
from app.simulation.checkpoint import Checkpoint
from app.simulation.recorder import OnAccepted
from app.simulation.run import CaseRun, Setup
from app.soundness import plausibility
from app.system import blas_check, form_cache, ranks, stopping
from app.system.folders import FAILED, claim, prepare_run, write_text

log = logging.getLogger("mantle")


def run(
    case: LoadedCase,
    output: Path,
    petsc_options: Sequence[str] = (),
    *,
    restart: str = "",
    force: bool = False,
    walltime: float | None = None,
    signals: bool = True,
    progress: OnAccepted = lambda step: None,
) -> None:
    """Solve a case and write its run directory; collective.

    Args:
        case: The case.
        output: The run directory.
        petsc_options: Raw PETSc options from the command line.
        restart: A checkpoint to restart from, ``auto`` or "".
        force: Whether to accept a checkpoint of another configuration.
        walltime: Time limit of the run [s].
        signals: Whether SIGINT, SIGTERM, SIGHUP and SIGUSR1 stop the run, with its state saved.
        progress: Called on every rank after each accepted step.

    Raises:
        MantleError: With the last converged state on disk where there is one.
    """
    comm, started, begin = MPI.COMM_WORLD, datetime.now(UTC), clock.perf_counter()
    expected = ranks.world_size()
    if expected and expected != comm.size:
        raise errors.EnvironmentProblem(
            f"started as one of {expected} ranks, but MPI sees {comm.size}: mpirun belongs to "
            "another MPI; use the one of this installation, or mantle run -n"
        )
    blas_check.check(comm)
    here = os.environ.get("OMPI_COMM_WORLD_LOCAL_SIZE", "")
    if crowd := blas_check.crowd(int(here) if here.isdigit() else comm.size):
        log.warning("note: %s", crowd)
    signalled = stopping.signals() if signals else str
    form_cache.guard()
    late = str if walltime is None else stopping.WallTime(begin, walltime)
    options = raw_options(petsc_options)
    setup = Setup(comm, case, options, lambda: signalled() or late(), progress, begin, started)
    setup.note(plausibility.warnings(case.config))
    session = Session(setup, restart, force)
    with case.file.placing(), _claimed(comm, output):
        if not case.config.variations:
            summary = session.solve(case.config, (), output)
            text.report(summary)
            text.check_usable({output: summary})
        else:
            session.vary(output, keep=not force and restart in ("", "auto"))
    log.info("results in %s", output)


class Session:
    """The run of a case, or of its variations one after another."""

    def __init__(self, setup: Setup, restart: str, force: bool) -> None:
        self._setup, self._comm = setup, setup.comm
        self._restart, self._force = restart, force

    def vary(self, output: Path, *, keep: bool) -> None:
        """Solve the variations of the case, each in a folder below ``output``; collective.

        With ``keep`` finished ones are not solved again.

        Raises:
            ConvergenceError: Some did not converge; the others are done.
            UnusableError: All did, but the numbers of some are not to be used.
            StoppedError: Those before are done.
        """
        varied = self._setup.loaded.variations()
        chain = variations.order(self._setup.loaded.config, varied)
        mark = output / "DONE"
        on_root(self._comm, lambda: mark.unlink(missing_ok=True), share=False)
        rows: dict[int, variations.Row] = {}
        solved: dict[Path, dict[str, Any]] = {}
        if keep:
            finished = on_root(self._comm, lambda: finished_runs.summaries(output, varied)) or {}
            for i, old in finished.items():
                solved[output / varied[i].name] = old
                rows[i] = variations.row(varied[i], old, old["status"], old["timing"]["total"])
            log.info("%d of %d variations are finished already", len(rows), len(chain))
        failed = []
        for number, i in enumerate(chain, 1):
            if i in rows:
                continue
            v, folder = varied[i], output / varied[i].name
            log.info("variation %d of %d: %s", number, len(chain), v.name)
            place = f"variation {v.name} (number {number} of {len(chain)})"
            if summary := self._variation(v, folder, place):
                solved[folder] = summary
            else:
                failed.append(v.name)
            status = summary.get("status", "not converged")
            rows[i] = variations.row(v, summary, status, clock.perf_counter() - self._setup.begin)
            self._write_table(rows, output)
            self._setup.begin_next()
        log.info("%s", variations.table(self._write_table(rows, output)))
        if failed:
            raise errors.ConvergenceError(
                f"{len(failed)} of {len(chain)} variations did not converge: {', '.join(failed)} "
                f"(in {output})"
            )
        on_root(self._comm, partial(write_text, mark, ""), share=False)
        text.check_usable(solved)

    def _variation(self, varied: Varied, folder: Path, place: str) -> dict[str, Any]:
        """Solve a variation; returns its summary, empty if it does not converge; collective."""
        on_root(self._comm, partial(_prepare, folder), share=False)
        try:
            summary = self.solve(varied.case, varied.overrides, folder)
        except errors.ConvergenceError as failure:
            log.warning("%s: %s", varied.name, failure)
            why = partial(write_text, folder / FAILED, f"{failure}\n")
            on_root(self._comm, why, share=False)
            return {}
        except errors.StoppedError as stop:
            raise errors.StoppedError(f"{place}: {stop}") from stop
        text.report(summary, table=False)
        return summary

    def _write_table(self, rows: dict[int, variations.Row], output: Path) -> list[variations.Row]:
        done = [rows[k] for k in sorted(rows)]
        on_root(self._comm, partial(variations.write, done, output), share=False)
        return done

    def solve(self, case: Case, changes: Sequence[str], output: Path) -> dict[str, Any]:
        """Solve the case or a variation, write its run directory; returns its summary; collective.

        ``changes`` are the overrides of the variation.

        Raises:
            MantleError: With the last converged state on disk where there is one.
        """
        passed: list[Path] = []
        while self._restart:
            found = checkpoint.find(self._comm, self._restart, output, case, self._force, passed)
            try:
                return self._solve(case, changes, output, found)
            except checkpoint.DamagedError as damaged:
                assert found is not None
                if self._restart != "auto":
                    raise errors.InputError(
                        f"--restart {found.path}: cannot be used: {damaged}"
                    ) from None
                checkpoint.pass_over(found.path, damaged)
                passed.append(found.path)
                self._setup.model = None  # it has taken up some of it
        return self._solve(case, changes, output, None)

    def _solve(
        self, case: Case, changes: Sequence[str], output: Path, found: Checkpoint | None
    ) -> dict[str, Any]:
        run = CaseRun(self._setup, case, changes, output, found)
        return run.finish(run.solve())


@contextmanager
def _claimed(comm: MPI.Comm, output: Path) -> Iterator[None]:
    held = on_root(comm, partial(claim, output), share=False)
    try:
        yield
    finally:
        if held is not None:
            os.close(held)


def _prepare(folder: Path) -> None:
    """Make the folder of a variation; remove the note of an earlier failure."""
    prepare_run(folder, force=True)
    (folder / FAILED).unlink(missing_ok=True)
