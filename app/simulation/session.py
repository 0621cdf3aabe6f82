"""One run, from a configuration to a run directory: the straight line through the program."""

from __future__ import annotations

import logging
import os
import time as clock
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from mpi4py import MPI

from app.case.case import Case, LoadedCase, dump
from app.errors import (
    ConvergenceError,
    EnvironmentProblem,
    GeometryError,
    InputError,
    StoppedError,
    agree,
)
from app.numerics.condition import condition_number
from app.numerics.newton import raw_options
from app.results import closing_lines as text
from app.results import error_estimate
from app.results.run_folder import Writer, on_root, provenance
from app.simulation import checkpoint, finished_runs, variations
from app.simulation.checkpoint import CheckpointWriter
from app.simulation.model import Model
from app.simulation.recorder import OnAccepted, Recorder
from app.soundness import plausibility, well_posedness
from app.system import blas_check, form_cache, ranks, stopping
from app.system.folders import FAILED, claim, prepare_run, remove, saved, write_text
from app.system.timing import Timing

log = logging.getLogger("mantle")

# What ends a run is told at once if the run has taken so many seconds.
LONG = 10.0


def run(
    case: LoadedCase,
    output: Path,
    petsc_options: Sequence[str] = (),
    *,
    keep: bool = False,
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
        keep: Whether variations that are finished stay.
        restart: A checkpoint to go on from, ``auto`` or nothing.
        force: Whether it may be of another configuration.
        walltime: How long the run may take [s].
        signals: Whether SIGINT, SIGTERM, SIGHUP and SIGUSR1 stop the run, with its state saved.
        progress: Called on every rank after each accepted step.

    Raises:
        MantleError: With the last converged state on disk where there is one.
    """
    comm, started, begin = MPI.COMM_WORLD, datetime.now(UTC), clock.perf_counter()
    expected = ranks.world_size()
    if expected and expected != comm.size:
        raise EnvironmentProblem(
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
    session = Session(
        comm,
        case,
        raw_options(petsc_options),
        lambda: signalled() or late(),
        begin,
        started,
        partial(checkpoint.find, comm, restart, force=force) if restart else None,
        restart == "auto",
        progress,
    )
    session.note(plausibility.warnings(case.config))
    with case.file.placing(), _claimed(comm, output):
        if not case.config.variations:
            summary = session.solve(case.config, (), output)
            text.tell(summary)
            text.check_usable({output: summary})
        else:
            session.vary(output, keep)
    log.info("results in %s", output)


class Session:
    """One case, or its variations one after another."""

    def __init__(
        self,
        comm: MPI.Comm,
        case: LoadedCase,
        options: dict[str, str],
        stop: Callable[[], str],
        begin: float,
        started: datetime,
        restart: Callable[..., checkpoint.Checkpoint | None] | None,
        back: bool,
        progress: OnAccepted,
    ) -> None:
        """Begin.

        Args:
            comm: Communicator.
            case: The case and where it comes from.
            options: Raw PETSc options.
            stop: Returns the name of a pending stop signal, or "".
            begin: When the run began, by `time.perf_counter`.
            started: The same, by the clock.
            restart: Finds the checkpoint of a run directory (``folder``) and case, if wanted.
            back: Whether the one before is taken where one is damaged.
            progress: Called on every rank after each accepted step.
        """
        self._comm, self._case, self._options, self._stop = comm, case, options, stop
        self._begin, self._started, self._restart = begin, started, restart
        self._back, self._progress = back, progress
        self._timing = Timing()
        self._models: list[Model] = []
        self._noted: set[str] = set()

    def note(self, messages: Sequence[str]) -> None:
        """Tell what is suspicious, each thing once."""
        for message in messages:
            if message not in self._noted:
                log.warning("note: %s", message)
        self._noted.update(messages)

    def vary(self, output: Path, keep: bool) -> None:
        """Solve the variations of the case, each in a folder of its own; collective.

        Args:
            output: The folder above theirs.
            keep: Whether those that are finished stay.

        Raises:
            ConvergenceError: Some did not converge; the others are done.
            UnusableError: All did, but the numbers of some are not to be used.
            StoppedError: Those before are done.
        """
        varied = self._case.variations()
        chain = variations.order(self._case.config, varied)
        mark = output / "DONE"
        on_root(self._comm, lambda: mark.unlink(missing_ok=True), share=False)
        rows: dict[int, variations.Row] = {}
        solved: dict[Path, dict[str, Any]] = {}
        failed: dict[str, str] = {}
        if keep:
            finished = on_root(self._comm, lambda: finished_runs.summaries(output, varied)) or {}
            for i, old in finished.items():
                solved[output / varied[i].name] = old
                rows[i] = variations.row(varied[i], old, old["status"], old["timing"]["total"])
            log.info("%d of %d variations are finished already", len(rows), len(chain))
        for number, i in enumerate(chain):
            if i in rows:
                continue
            v, folder = varied[i], output / varied[i].name
            log.info("variation %d of %d: %s", number + 1, len(chain), v.name)
            on_root(self._comm, partial(_prepare, folder), share=False)
            summary: dict[str, Any] = {}
            try:
                summary = solved[folder] = self.solve(v.case, v.overrides, folder)
                status = summary["status"]
                text.tell(summary, table=False)
            except ConvergenceError as failure:
                status, failed[v.name] = "not converged", str(failure)
                log.warning("%s: %s", v.name, failure)
                why = partial(write_text, folder / FAILED, f"{failure}\n")
                on_root(self._comm, why, share=False)
            except StoppedError as stop:
                text_ = f"variation {v.name} (number {number + 1} of {len(chain)}): {stop}"
                raise StoppedError(text_) from stop
            rows[i] = variations.row(v, summary, status, clock.perf_counter() - self._begin)
            table = partial(variations.write, [rows[k] for k in sorted(rows)], output)
            on_root(self._comm, table, share=False)
            self._begin, self._started = clock.perf_counter(), datetime.now(UTC)
            self._timing.clear()
        done = [rows[k] for k in sorted(rows)]
        on_root(self._comm, partial(variations.write, done, output), share=False)
        log.info("%s", variations.table(done))
        if failed:
            names = ", ".join(failed)
            raise ConvergenceError(
                f"{len(failed)} of {len(chain)} variations did not converge: {names} (in {output})"
            )
        on_root(self._comm, partial(write_text, mark, ""), share=False)
        text.check_usable(solved)

    def solve(self, case: Case, changes: Sequence[str], output: Path) -> dict[str, Any]:
        """Solve a case and write its run directory; collective.

        Args:
            case: The case of the session, or a variation of it.
            changes: The overrides that make the variation.
            output: The run directory.

        Returns:
            Its summary.

        Raises:
            MantleError: With the last converged state on disk where there is one.
        """
        passed: list[Path] = []
        while self._restart:
            found = self._restart(folder=output, case=case, passed=passed)
            try:
                return self._solve(case, changes, output, found)
            except checkpoint.DamagedError as damaged:
                assert found is not None
                if not self._back:
                    raise InputError(f"--restart {found.path}: cannot be used: {damaged}") from None
                checkpoint.pass_over(found.path, damaged)
                passed.append(found.path)
                self._models.clear()  # with the one that has taken up some of it
        return self._solve(case, changes, output, None)

    def _solve(
        self,
        case: Case,
        changes: Sequence[str],
        output: Path,
        found: checkpoint.Checkpoint | None,
    ) -> dict[str, Any]:
        """Solve a case from a checkpoint, if there is one; collective."""
        comm, timing = self._comm, self._timing
        model = Model(case, comm, self._options, timing, self._stop, self._models)
        notes = [*plausibility.warnings(case), *model.judge()]
        self.note(notes)
        log.info(
            "%s: %d cells, unknowns %s, %d rank(s)",
            case.title or self._case.path.stem,
            model.tagged.mesh.topology.index_map(3).size_global,
            ", ".join(f"{n} {name}" for name, n in model.sizes().items()),
            comm.size,
        )
        started = self._started
        writer = Writer(
            model.tagged,
            model.layers(),
            output,
            dump(case),
            case.output.fields,
            lambda: provenance(
                comm.size,
                self._case.file.digests,
                [*self._case.overrides, *changes],
                model.mesh_hash,
                started,
            ),
            found is not None,
        )
        recorder = Recorder(case, model, writer, timing, self._begin, self._progress)
        keeper = CheckpointWriter(case, model, recorder, output, found)
        try:
            total = model.go(
                recorder.step,
                recorder.heat,
                lambda s: log.info("     %s", s),
                recorder.stage,
                keeper.mark,
                keeper.resume,
            )
        except ConvergenceError as failure:
            agree(comm, failure)
            recorder.close("not converged")
            raise ConvergenceError(f"{failure}\n{recorder.last_state()}") from failure
        except StoppedError as failure:
            agree(comm, failure)
            where = _saved(keeper)
            recorder.close("stopped")
            raise StoppedError(f"{failure}\n{recorder.last_state()}{where}") from failure
        blas_check.check(comm)  # once more: what has converged by wrong sums is no result
        if clock.perf_counter() - self._begin > LONG:
            log.info("     computing and writing results")
        with timing.phase("output"):
            recorder.flush()
            summary = recorder.summary("converged", total)
        summary["notes"] = [*notes, *well_posedness.doubts(case, summary["regions"])]
        summary["notes"] += [note for t in model.thermal for note in t.heating.notes]
        if text.reasons_not_to_use(summary):
            summary["status"] = text.UNUSABLE
        self.note(summary["notes"])
        if case.output.condition:
            for m in model.mechanics:
                A = m.solver.snes.getJacobian()[0]
                summary["solver"]["condition"] = condition_number(A)
        if companions := error_estimate.companions(case):
            # The numbers are safe before their errors are looked for.
            writer.finish(summary, done=False)
            try:
                with timing.phase("error"):
                    summary["error"] = _errors(companions, model, summary, case)
            except StoppedError as failure:
                agree(comm, failure)
                raise StoppedError(f"{failure}, in its companions{_saved(keeper)}") from failure
            summary["timing"] = recorder.seconds()
        writer.finish(summary, done=True)
        if not case.output.checkpoint.model_fields_set:
            # Those of interruptions are of no more use.
            on_root(comm, partial(remove, saved(output)), share=False)
        return summary


@contextmanager
def _claimed(comm: MPI.Comm, output: Path) -> Iterator[None]:
    """Keep other runs out of a folder meanwhile; collective.

    Raises:
        InputError: Another run has it.
    """
    held = on_root(comm, partial(claim, output), share=False)
    try:
        yield
    finally:
        if held is not None:
            os.close(held)


def _saved(keeper: CheckpointWriter) -> str:
    """Save the state; where it is, as the end of a message; collective."""
    path = keeper.save()
    return f"\nstate saved in {path}: --restart auto goes on from there" if path else ""


def _prepare(folder: Path) -> None:
    """Make the folder of a variation; that it failed once says nothing now.

    Raises:
        InputError: It cannot be written.
    """
    prepare_run(folder, force=True)
    (folder / FAILED).unlink(missing_ok=True)


def _errors(
    companions: Sequence[error_estimate.Companion],
    model: Model,
    summary: dict[str, Any],
    case: Case,
) -> dict[str, Any]:
    """Solve the companions of a run and put the errors of its numbers into its summary."""
    solved, failed = [], []
    for companion in companions:
        begin = clock.perf_counter()
        try:
            numbers = model.relative(companion.case)
        except (ConvergenceError, GeometryError) as failure:
            agree(model.tagged.mesh.comm, failure)
            log.warning(
                "error estimate: the companion run on %s failed: %s",
                companion,
                str(failure).splitlines()[0],
            )
            failed.append(str(companion))
            continue
        solved.append((companion, numbers))
        seconds = clock.perf_counter() - begin
        log.info("     error estimate: companion run on %s in %.1f s", companion, seconds)
    return {
        "companions": [str(c) for c, _ in solved],
        "of": error_estimate.error_sources([c for c, _ in solved]),
        "failed": failed,
        "unsettled": error_estimate.estimate(summary, case, solved),
    }
