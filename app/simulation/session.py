"""A run as requested: one case, or its variations one after another; prepare, solve, finish."""

from __future__ import annotations

import logging
import time as clock
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from mpi4py import MPI

from app.case.case import Case, LoadedCase, Varied, dump
from app.case.run_options import CheckpointOptions
from app.foundation.errors import (
    ConvergenceError,
    EnvironmentProblem,
    GeometryError,
    StoppedError,
    agree,
    on_root,
)
from app.numerics import lifetime
from app.numerics.krylov import condition_number
from app.numerics.newton import raw_options, unused
from app.results import closing_lines as text
from app.results import error_estimate
from app.results.run_folder import Writer, provenance
from app.simulation import accuracy, checkpoint, finished_runs, variations
from app.simulation.checkpoint import CheckpointWriter
from app.simulation.model import Model
from app.simulation.recorder import OnAccepted, Recorder
from app.soundness import preview, well_posedness
from app.system import blas_check, form_cache, ranks, stopping
from app.system.folders import FAILED, claim, prepare_run, remove, saved, write_text
from app.system.timing import Timing

log = logging.getLogger("mantle")

# Writing results is announced if the run has taken so many seconds.
LONG = 10.0


@dataclass
class Setup:
    """Parts shared by successive runs.

    Attributes:
        stop: Returns the name of a pending stop signal, or "".
        progress: Called on every rank after each accepted step.
        restart: A checkpoint to restart from, ``auto`` or "".
        force: Whether to accept a checkpoint of another configuration.
        begin: Start of the run, by `time.perf_counter`.
        started: The same, by the clock.
        model: The model of the last run, for reuse.
        noted: Notes already logged.
        chosen: Mesh and order chosen for an accuracy, in words; empty unless one is asked for.
    """

    comm: MPI.Comm
    loaded: LoadedCase
    options: dict[str, str]
    stop: Callable[[], str]
    progress: OnAccepted
    restart: str
    force: bool
    begin: float
    started: datetime
    timing: Timing = field(default_factory=Timing)
    model: Model | None = None
    noted: set[str] = field(default_factory=set)
    chosen: str = ""

    def note(self, messages: Sequence[str]) -> None:
        """Log notes on the case, each once."""
        for message in messages:
            if message not in self.noted:
                log.warning("note: %s", message)
        self.noted.update(messages)


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
) -> MPI.Comm:
    """Solve a case and write its run directory; arguments as of `mantle.run`; collective.

    Returns:
        The ranks of the run.

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
    lifetime.begin_run(comm)
    blas_check.check(comm)
    signalled = stopping.signals() if signals else str
    if signals:  # the process is ours: a host's functions and options are left as they are
        form_cache.guard()
    late = str if walltime is None else stopping.WallTime(begin, walltime)
    options, asked = raw_options(petsc_options), (progress, restart, force)
    setup = Setup(comm, case, options, lambda: signalled() or late(), *asked, begin, started)
    setup.note(preview.warnings(case.config))
    with case.file.placing(), ExitStack() as held:
        on_root(comm, lambda: held.enter_context(claim(output)), share=False)
        if case.config.variations:
            _vary(setup, output)
        else:
            if case.config.output.accuracy:
                _choose(setup, walltime)
            summary = _CaseRun(setup, setup.loaded.config, (), output).run()
            text.report(summary)
            text.check_usable({output: summary})
    log.info("results in %s", output)
    return comm


def _choose(setup: Setup, longest: float | None) -> None:
    """Choose mesh and order for the accuracy that the case asks for; collective."""

    def solve(case: Case) -> dict[str, Any]:
        model = Model(case, setup.comm, setup.options, Timing("choosing"), setup.stop)
        numbers = model.relative(case)
        if _errors(error_estimate.companions(case), model, numbers, case)["failed"]:
            raise ConvergenceError("output.accuracy: the errors of cheap runs are unknown")
        return numbers

    config, setup.chosen = accuracy.choose(setup.loaded.config, solve, longest)
    setup.loaded = replace(setup.loaded, config=config)


def _vary(setup: Setup, output: Path) -> None:
    """Solve the variations of the case, each in a folder below ``output``; collective.

    Finished ones are not solved again, unless ``--force`` asks for it.

    Raises:
        ConvergenceError: Some did not converge; the others are done.
        UnusableError: All did, but the numbers of some are not to be used.
        StoppedError: Those before are done.
    """
    comm, varied = setup.comm, setup.loaded.variations
    mark = output / "DONE"
    on_root(comm, lambda: mark.unlink(missing_ok=True), share=False)
    solved: dict[int, dict[str, Any]] = {}
    if not setup.force and setup.restart in ("", "auto"):
        solved = on_root(comm, lambda: finished_runs.summaries(output, varied)) or {}
        log.info("%d of %d variations are finished already", len(solved), len(varied))
    rows = {
        i: variations.row(varied[i], old, old["status"], old["timing"]["total"])
        for i, old in solved.items()
    }
    for i, v in enumerate(varied):
        if i in rows:
            continue
        log.info("variation %d of %d: %s", i + 1, len(varied), v.name)
        try:
            solved[i] = _variation(setup, v, output / v.name)
        except StoppedError as stop:
            place = f"variation {v.name} (number {i + 1} of {len(varied)})"
            raise StoppedError(f"{place}: {stop}") from stop
        status = solved[i].get("status", "not converged")
        rows[i] = variations.row(v, solved[i], status, clock.perf_counter() - setup.begin)
        on_root(comm, partial(variations.write, rows, output), share=False)
        lifetime.release(comm)  # models on meshes that no later variation shares
        setup.begin, setup.started = clock.perf_counter(), datetime.now(UTC)
        setup.timing.clear()
    done = on_root(comm, partial(variations.write, rows, output)) or []
    log.info("%s", variations.table(done))
    if failed := [v.name for i, v in enumerate(varied) if not solved[i]]:
        raise ConvergenceError(
            f"{len(failed)} of {len(varied)} variations did not converge: {', '.join(failed)} "
            f"(in {output})"
        )
    on_root(comm, partial(write_text, mark, ""), share=False)
    text.check_usable({output / varied[i].name: summary for i, summary in solved.items()})


def _variation(setup: Setup, varied: Varied, folder: Path) -> dict[str, Any]:
    """Solve a variation; returns its summary, empty if it does not converge; collective."""
    on_root(setup.comm, partial(prepare_run, folder, force=True), share=False)
    on_root(setup.comm, partial(remove, [folder / FAILED]), share=False)
    try:
        summary = _CaseRun(setup, varied.case, varied.overrides, folder).run()
    except ConvergenceError as failure:
        log.warning("%s: %s", varied.name, failure)
        why = partial(write_text, folder / FAILED, f"{failure}\n")
        on_root(setup.comm, why, share=False)
        return {}
    text.report(summary, table=False)
    return summary


class _CaseRun:
    """The run of one case: its model, its records and its checkpoints; made on all ranks.

    ``case`` is the case of the file or a variation of it with overrides ``changes``.
    """

    def __init__(self, setup: Setup, case: Case, changes: Sequence[str], output: Path) -> None:
        self._setup, self._case, self._folder = setup, case, output
        comm, loaded = setup.comm, setup.loaded
        found = None
        if setup.restart:
            found = checkpoint.find(comm, setup.restart, output, case, setup.force)
        common = setup.options, setup.timing, setup.stop, setup.model
        model = Model(case, comm, *common, runs=max(1, len(loaded.variations)))
        self._model = setup.model = model
        self._notes = [*preview.warnings(case), *model.notes]
        setup.note(self._notes)
        if lost := unused(case.solver.petsc | setup.options):
            setup.note([f"PETSc has no use for {', '.join(lost)} here: misspelt?"])
        log.info(
            "%s: %d cells, unknowns %s, %d rank(s)",
            case.title or loaded.path.stem,
            model.tagged.mesh.topology.index_map(3).size_global,
            ", ".join(f"{n} {name}" for name, n in model.sizes().items()),
            comm.size,
        )
        overrides, digests = [*loaded.overrides, *changes], loaded.file.digests
        record = partial(provenance, comm.size, digests, overrides, model.mesh_hash, setup.started)
        again, fields = found is not None, case.output.fields
        writer = Writer(model.tagged, model.layers(), output, dump(case), fields, record, again)
        self._writer = writer
        self._recorder = Recorder(case, model, writer, setup.timing, setup.begin, setup.progress)
        self._checkpoints = CheckpointWriter(case, model, self._recorder, output, found)

    @contextmanager
    def _last_state_kept(self) -> Iterator[None]:
        """Write the last converged state to disk where a solve fails or is stopped; collective."""
        try:
            yield
        except (ConvergenceError, StoppedError) as failure:
            agree(self._setup.comm, failure)
            lines = [str(failure), self._recorder.last_state()]
            if isinstance(failure, ConvergenceError):
                self._recorder.close("not converged", lines[0])
                raise ConvergenceError("\n".join(lines)) from failure
            if path := self._checkpoints.save():
                lines.append(f"state saved in {path}: --restart auto goes on from there")
            self._recorder.close("stopped", lines[0])
            raise StoppedError("\n".join(lines)) from failure

    def run(self) -> dict[str, Any]:
        """Solve all stages and write the results; returns the summary; collective.

        Raises:
            ConvergenceError: With the last converged state on disk, if there is one.
            StoppedError: The same, and with a checkpoint.
        """
        setup, case, model = self._setup, self._case, self._model
        with self._last_state_kept():
            total = model.go(
                self._recorder.step,
                self._recorder.heat,
                lambda s: log.info("     %s", s),
                self._recorder.stage,
                self._checkpoints.mark,
                self._checkpoints.resume,
            )
        blas_check.check(setup.comm)  # once more: what has converged by wrong sums is no result
        if clock.perf_counter() - setup.begin > LONG:
            log.info("     computing and writing results")
        with setup.timing.phase("output"):
            self._recorder.flush()
            summary = self._recorder.summary("converged", total)
        summary["notes"] = [*self._notes, *well_posedness.doubts(case, summary)]
        if text.reasons_not_to_use(summary):
            summary["status"] = text.UNUSABLE
        setup.note(summary["notes"])
        if case.output.condition and model.mechanics:
            A = model.mechanics.solver.snes.getJacobian()[0]
            summary["solver"]["condition"] = condition_number(A)
        if companions := error_estimate.companions(case):
            # The numbers are safe before their errors are looked for.
            self._writer.finish(summary, done=False)
            with setup.timing.phase("error"), self._last_state_kept():
                summary["error"] = _errors(companions, model, summary, case)
            if setup.chosen:
                summary["accuracy"] = accuracy.reached(setup.chosen, summary)
            summary["timing"] = self._recorder.seconds()
        self._writer.finish(summary, done=True)
        if case.output.checkpoint == CheckpointOptions():
            # Those of interruptions are of no more use.
            on_root(setup.comm, partial(remove, saved(self._folder)), share=False)
        return summary


def _errors(
    companions: Sequence[error_estimate.Companion],
    model: Model,
    summary: dict[str, Any],
    case: Case,
) -> dict[str, Any]:
    solved, failed = [], []
    for companion in companions:
        begin = clock.perf_counter()
        try:
            solved.append((companion, model.relative(companion.case)))
        except (ConvergenceError, GeometryError) as failure:
            agree(model.tagged.mesh.comm, failure)
            why = str(failure).splitlines()[0]
            log.warning("error estimate: the companion run on %s failed: %s", companion, why)
            failed.append(str(companion))
            continue
        except StoppedError as stop:
            raise StoppedError(f"{stop}, in its companions") from stop
        seconds = clock.perf_counter() - begin
        log.info("     error estimate: companion run on %s in %.1f s", companion, seconds)
    return {
        "companions": [str(c) for c, _ in solved],
        "within": error_estimate.WITHIN[case.mesh.order - 1],
        "of": error_estimate.error_sources([c for c, _ in solved]),
        "failed": failed,
        "unsettled": error_estimate.estimate(summary, case, solved),
    }
