"""A run as requested: one case, or its variations one after another; prepare, solve, finish."""

from __future__ import annotations

import logging
import time as clock
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from mpi4py import MPI

from app.case.case import LoadedCase, PlannedRun, dump
from app.case.run_options import CheckpointOptions
from app.case.summary import Summary
from app.foundation.collective import agree, on_root
from app.foundation.errors import ConvergenceError, EnvironmentProblem, StoppedError
from app.foundation.layout import count, several
from app.foundation.verdict import Severity, Verdict, note
from app.numerics import lifetime
from app.numerics.krylov import condition_number
from app.numerics.newton import raw_options, unused
from app.results import closing_lines, error_estimate, run_table, verdicts
from app.results.path_tables import path_tables
from app.results.run_folder import Writer, provenance
from app.results.verdicts import UNUSABLE
from app.simulation import accuracy, bone_influence, checkpoint, finished_runs
from app.simulation.checkpoint import CheckpointWriter
from app.simulation.model import Model
from app.simulation.recorder import OnAccepted, Recorder
from app.soundness import preview, result_notes
from app.stepping.load_steps import Effort
from app.system import form_cache, ranks, stopping
from app.system.folders import FAILED_FILE, claim, prepare_run, remove, saved, write_text
from app.system.timing import Timing

log = logging.getLogger("mantle")

# The log announces that results are written if the run took longer [s].
LONG_RUN = 10.0


@dataclass
class Setup:
    """Parts shared by successive runs.

    Attributes:
        comm: All ranks.
        loaded: The case as read from its file, with its variations.
        options: Raw PETSc options from the command line.
        stop: Returns the name of a pending stop signal, or "".
        progress: Called on every rank after each accepted step.
        restart: A checkpoint to restart from, ``auto`` or "".
        force: True to accept a checkpoint of another configuration.
        begin: Start of the run, by `time.perf_counter`.
        started: Date and time at the start (UTC).
        timing: Seconds by phase.
        model: Model of the last run, for reuse.
        noted: Notes that were logged.
        chosen: Mesh and order for the requested accuracy, in words; empty without a request.
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
    noted: set[Verdict] = field(default_factory=set)
    chosen: str = ""

    def log_notes(self, notes: Sequence[Verdict]) -> None:
        """Log notes on the case, each once."""
        for verdict in notes:
            if verdict not in self.noted:
                log.warning("%s", verdict)
        self.noted.update(notes)


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
    """Solve a case and write its run directory; arguments as in `mantle.run`; collective.

    Returns:
        The ranks of the run.

    Raises:
        MantleError: The run failed. The last converged state, if any, is on disk.
    """
    comm, started, begin = MPI.COMM_WORLD, datetime.now(UTC), clock.perf_counter()
    expected_ranks = ranks.world_size()
    if expected_ranks and expected_ranks != comm.size:
        raise EnvironmentProblem(
            f"started as one of {expected_ranks} ranks, but MPI sees {comm.size}: mpirun belongs "
            "to another MPI; use the one of this installation, or mantle run -n"
        )
    lifetime.begin_run(comm)
    signalled = stopping.signals() if signals else _never
    if signals:  # not in a host's process, whose handlers and options stay as they are
        form_cache.patch_ffcx()
    time_limit = _never if walltime is None else stopping.WallTime(begin, walltime)
    setup = Setup(
        comm,
        case,
        raw_options(petsc_options),
        stop=lambda: signalled() or time_limit(),
        progress=progress,
        restart=restart,
        force=force,
        begin=begin,
        started=started,
    )
    setup.log_notes([*case.file.notes, *preview.input_notes(case.config)])
    with case.file.placing(), ExitStack() as stack:
        on_root(comm, lambda: stack.enter_context(claim(output)), share=False)
        if case.config.variations:
            _solve_variations(setup, output)
        else:
            if case.config.output.accuracy:
                solve = partial(accuracy.numbers_with_errors, comm, setup.options, setup.stop)
                config, setup.chosen = accuracy.choose(comm, case.config, solve, walltime)
                setup.loaded = replace(case, config=config)
            summary = _CaseRun(setup, setup.loaded.itself, output).run()
            closing_lines.log_closing_lines(summary)
            verdicts.check_usable({output: summary})
    log.info("results in %s", output)
    return comm


def _never() -> str:
    """Name of a signal that never comes."""
    return ""


def _solve_variations(setup: Setup, output: Path) -> None:
    """Solve the variations of the case, each in a folder below ``output``; collective.

    Finished variations are not solved again, except with ``--force``.

    Raises:
        ConvergenceError: Some variations did not converge; the others are done.
        UnusableError: All converged, but the numbers of some must not be used.
        StoppedError: A signal stopped the run; earlier variations are done.
    """
    comm = setup.comm
    runs = setup.loaded.runs(output)
    done_mark = output / "DONE"
    on_root(comm, lambda: done_mark.unlink(missing_ok=True), share=False)
    summaries: dict[Path, Summary] = {}
    if not setup.force and setup.restart in ("", "auto"):
        summaries = on_root(comm, lambda: finished_runs.summaries(runs)) or {}
        log.info("%d of %d variations are finished already", len(summaries), len(runs))
    rows = {
        folder: run_table.row(
            runs[folder].point, old_summary, old_summary["status"], old_summary["timing"]["total"]
        )
        for folder, old_summary in summaries.items()
    }

    def write() -> list[run_table.RunRow]:
        return run_table.write_variations([rows[f] for f in runs if f in rows], output)

    for number, (folder, run) in enumerate(runs.items(), start=1):
        if folder in rows:
            continue
        log.info("variation %d of %d: %s", number, len(runs), run.name)
        try:
            summary = _solve_variation(setup, run, folder)
        except StoppedError as stop:
            place = f"variation {run.name} (number {number} of {len(runs)})"
            raise StoppedError(f"{place}: {stop}") from stop
        summaries[folder] = summary
        status = summary.get("status", "not converged")
        seconds = clock.perf_counter() - setup.begin
        rows[folder] = run_table.row(run.point, summary, status, seconds)
        on_root(comm, write, share=False)
        lifetime.release(comm)  # models on meshes that no later variation shares
        setup.begin, setup.started = clock.perf_counter(), datetime.now(UTC)
        setup.timing.clear()
    log.info("%s", run_table.text_of_runs(on_root(comm, write) or []))
    failed_names = [run.name for folder, run in runs.items() if not summaries[folder]]
    if failed_names:
        raise ConvergenceError(
            f"{len(failed_names)} of {len(runs)} variations did not converge:"
            f" {', '.join(failed_names)} "
            f"(in {output})"
        )
    on_root(comm, partial(write_text, done_mark, ""), share=False)
    verdicts.check_usable(summaries)


def _solve_variation(setup: Setup, run: PlannedRun, folder: Path) -> Summary:
    """Solve a variation; return its summary, empty if it does not converge; collective."""
    on_root(setup.comm, partial(prepare_run, folder, force=True), share=False)
    on_root(setup.comm, partial(remove, [folder / FAILED_FILE]), share=False)
    try:
        summary = _CaseRun(setup, run, folder).run()
    except ConvergenceError as failure:
        log.warning("%s: %s", run.name, failure)
        write_failure = partial(write_text, folder / FAILED_FILE, f"{failure}\n")
        on_root(setup.comm, write_failure, share=False)
        return {}
    closing_lines.log_closing_lines(summary, table=False)
    return summary


class _CaseRun:
    """One run: its model, its records and its checkpoints; made on all ranks."""

    def __init__(self, setup: Setup, run: PlannedRun, output: Path) -> None:
        case = run.case
        self._setup = setup
        self._case = case
        self._folder = output
        comm, loaded = setup.comm, setup.loaded
        saved_state = None
        if setup.restart:
            saved_state = checkpoint.checkpoint_to_resume(
                comm, setup.restart, output, case, setup.force
            )
        model = Model(
            case,
            comm,
            setup.options,
            setup.timing,
            setup.stop,
            reuse=setup.model,
            runs=max(1, len(loaded.variations)),
        )
        self._model = setup.model = model
        self._notes = [*preview.input_notes(case), *model.notes]
        setup.log_notes(self._notes)
        unused_options = unused(case.solver.petsc | setup.options)
        if unused_options:
            setup.log_notes(
                [note(f"PETSc did not use {', '.join(unused_options)}; is it misspelt?")]
            )
        log.info(
            "%s: %s, %s, %s",
            case.title or loaded.path.stem,
            several(model.tagged.mesh.topology.index_map(3).size_global, "cell"),
            _unknowns(model.sizes()),
            several(comm.size, "rank"),
        )
        field_groups = model.field_groups()
        data = model.parts.data if model.parts else None
        paths = path_tables(case, model.scene, model.tagged, field_groups, data)
        self._writer = Writer(
            model.tagged,
            field_groups,
            output,
            dump(case),
            case.output.fields,
            partial(
                provenance,
                comm.size,
                loaded.file.digests,
                run.overrides,
                model.mesh_hash,
                setup.started,
            ),
            saved_state is not None,
            paths,
        )
        self._recorder = Recorder(
            case, model, self._writer, setup.timing, setup.begin, setup.progress
        )
        self._checkpoints = CheckpointWriter(case, model, self._recorder, output, saved_state)

    @contextmanager
    def _last_state_kept(self, summary: Summary | None = None) -> Iterator[None]:
        """Write the last converged state to disk if a solve fails or is stopped; collective.

        Args:
            summary: Summary of that state, if it is known: auxiliary runs may change the model.
        """
        try:
            yield
        except (ConvergenceError, StoppedError) as failure:
            agree(self._setup.comm, failure)
            lines = [Verdict(self._recorder.last_state(), severity=Severity.PLAIN)]
            if isinstance(failure, ConvergenceError):
                self._recorder.close("not converged", failure.verdicts, summary)
                raise ConvergenceError([*failure.verdicts, *lines]) from failure
            path = self._checkpoints.save()
            if path:
                message = f"state saved in {path}; --restart auto continues from it"
                lines.append(Verdict(message, severity=Severity.PLAIN))
            self._recorder.close("stopped", failure.verdicts, summary)
            raise StoppedError([*failure.verdicts, *lines]) from failure

    def run(self) -> Summary:
        """Solve all stages and write the results; return the summary; collective.

        Raises:
            ConvergenceError: A solve failed. The last converged state, if any, is on disk.
            StoppedError: A signal stopped the run. That state and a checkpoint are on disk.
        """
        total = self._solve()
        summary, notes = self._recorded(total)
        self._add_condition_number(summary)
        self._add_errors(summary, notes)
        self._add_bone_influence(summary, notes)
        self._writer.finish(summary, complete=True)
        if self._case.output.checkpoint == CheckpointOptions():
            # No periodic checkpoints: those of interruptions are no longer needed.
            on_root(self._setup.comm, partial(remove, saved(self._folder)), share=False)
        return summary

    def _solve(self) -> Effort:
        """Solve all stages; collective."""
        with self._last_state_kept():
            return self._model.run(
                self._recorder.record_step,
                self._recorder.record_heat_step,
                lambda s: log.info("     %s", s),
                self._recorder.begin_stage,
                self._checkpoints.mark,
                self._checkpoints.resume,
            )

    def _recorded(self, total: Effort) -> tuple[Summary, list[Verdict]]:
        """Return the summary of the last state, with its verdicts, and its notes; collective."""
        setup, case, model = self._setup, self._case, self._model
        if clock.perf_counter() - setup.begin > LONG_RUN:
            log.info("     computing and writing results")
        with setup.timing.phase("output"):
            self._recorder.flush()
            summary = self._recorder.summary(total)
        notes = [
            *self._notes,
            *result_notes.of_results(case, summary),
            *model.warnings_of_floating_bodies(),
        ]
        verdicts.record_verdicts(summary, notes)
        if verdicts.reasons_not_to_use(summary):
            summary["status"] = UNUSABLE
        setup.log_notes(notes)
        return summary, notes

    def _add_condition_number(self, summary: Summary) -> None:
        """Add the condition number of the Jacobian at the last state, if requested; collective."""
        mechanics = self._model.mechanics
        if self._case.output.condition and mechanics:
            # The numbers are on disk before a factorization that may need too much memory.
            self._writer.finish(summary, complete=False)
            summary["solver"]["condition"] = condition_number(mechanics.solver.jacobian())

    def _add_errors(self, summary: Summary, notes: list[Verdict]) -> None:
        """Add estimated errors, if requested; collective."""
        setup, case = self._setup, self._case
        companions = error_estimate.companions(case)
        if not companions:
            return
        # The numbers are on disk before their errors are computed.
        self._writer.finish(summary, complete=False)
        with setup.timing.phase("error"), self._last_state_kept(summary):
            summary["error"] = accuracy.add_errors(summary, case, companions, self._model)
        if setup.chosen:
            summary["accuracy"] = accuracy.reached_text(setup.chosen, summary)
        summary["timing"] = self._recorder.seconds()
        verdicts.record_verdicts(summary, notes)

    def _add_bone_influence(self, summary: Summary, notes: list[Verdict]) -> None:
        """Add the influence of the assumed bone, if there is any; collective."""
        if not self._case.geometry.other_bones:
            return
        with self._setup.timing.phase("influence"), self._last_state_kept(summary):
            influence = bone_influence.bone_influence(self._case, self._model)
        if influence:
            summary["assumed_bone"] = influence
            verdicts.record_verdicts(summary, notes)


def _unknowns(sizes: Mapping[str, int]) -> str:
    """Number of unknowns, with the number of each kind in brackets."""
    kinds = ", ".join(f"{count(number)} {name}" for name, number in sizes.items())
    return f"{several(sum(sizes.values()), 'unknown')} ({kinds})"
