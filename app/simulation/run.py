"""One case, from its configuration to its run directory: prepare, solve, finish."""

from __future__ import annotations

import logging
import time as clock
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from mpi4py import MPI

from app.case.case import Case, LoadedCase, dump
from app.errors import ConvergenceError, GeometryError, StoppedError, agree
from app.numerics.condition import condition_number
from app.results import closing_lines as text
from app.results import error_estimate
from app.results.run_folder import Writer, on_root, provenance
from app.simulation.checkpoint import Checkpoint, CheckpointWriter
from app.simulation.model import Model, Observer
from app.simulation.recorder import OnAccepted, Recorder
from app.soundness import plausibility, well_posedness
from app.stepping.load_steps import Summary
from app.system import blas_check
from app.system.folders import remove, saved
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
        begin: Start of the run, by `time.perf_counter`.
        started: The same, by the clock.
        model: The model of the last run, for reuse.
        noted: Notes already logged.
    """

    comm: MPI.Comm
    loaded: LoadedCase
    options: dict[str, str]
    stop: Callable[[], str]
    progress: OnAccepted
    begin: float
    started: datetime
    timing: Timing = field(default_factory=Timing)
    model: Model | None = None
    noted: set[str] = field(default_factory=set)

    def note(self, messages: Sequence[str]) -> None:
        """Log notes on the case, each once."""
        for message in messages:
            if message not in self.noted:
                log.warning("note: %s", message)
        self.noted.update(messages)

    def begin_next(self) -> None:
        """Start the clocks of another run."""
        self.begin, self.started = clock.perf_counter(), datetime.now(UTC)
        self.timing.clear()


class CaseRun:
    """The run of one case: its model, its records and its checkpoints; made on all ranks.

    ``case`` is the case of the file or a variation of it with overrides ``changes``, ``found`` the
    checkpoint to restart from.
    """

    def __init__(
        self,
        setup: Setup,
        case: Case,
        changes: Sequence[str],
        output: Path,
        found: Checkpoint | None,
    ) -> None:
        comm, self._setup, self._case, self._folder = setup.comm, setup, case, output
        self._model = Model(case, comm, setup.options, setup.timing, setup.stop, setup.model)
        setup.model = self._model
        self._notes = [*plausibility.warnings(case), *self._model.judge()]
        setup.note(self._notes)
        log.info(
            "%s: %d cells, unknowns %s, %d rank(s)",
            case.title or setup.loaded.path.stem,
            self._model.tagged.mesh.topology.index_map(3).size_global,
            ", ".join(f"{n} {name}" for name, n in self._model.sizes().items()),
            comm.size,
        )
        record = partial(
            provenance,
            comm.size,
            setup.loaded.file.digests,
            [*setup.loaded.overrides, *changes],
            self._model.mesh_hash,
            setup.started,
        )
        self._writer = Writer(
            self._model.tagged,
            self._model.layers(),
            output,
            dump(case),
            case.output.fields,
            record,
            found is not None,
        )
        self._recorder = Recorder(
            case, self._model, self._writer, setup.timing, setup.begin, setup.progress
        )
        self._checkpoints = CheckpointWriter(case, self._model, self._recorder, output, found)

    def solve(self) -> Summary:
        """Solve all stages; returns a summary of the effort; collective.

        Raises:
            ConvergenceError: With the last converged state on disk, if there is one.
            StoppedError: The same, and with a checkpoint.
        """
        with self._last_state_kept():
            return self._model.go(
                Observer(
                    self._recorder.step,
                    self._recorder.heat,
                    lambda s: log.info("     %s", s),
                    self._recorder.stage,
                    self._checkpoints.mark,
                    self._checkpoints.resume,
                )
            )

    @contextmanager
    def _last_state_kept(self) -> Iterator[None]:
        """Write the last converged state to disk where a solve fails or is stopped; collective."""
        try:
            yield
        except (ConvergenceError, StoppedError) as failure:
            agree(self._setup.comm, failure)
            lines = [str(failure), self._recorder.last_state()]
            if isinstance(failure, ConvergenceError):
                self._recorder.close("not converged")
                raise ConvergenceError("\n".join(lines)) from failure
            if path := self._checkpoints.save():
                lines.append(f"state saved in {path}: --restart auto goes on from there")
            self._recorder.close("stopped")
            raise StoppedError("\n".join(lines)) from failure

    def finish(self, total: Summary) -> dict[str, Any]:
        """Write the results of a converged run; returns its summary; collective."""
        setup, case, model = self._setup, self._case, self._model
        blas_check.check(setup.comm)  # once more: what has converged by wrong sums is no result
        if clock.perf_counter() - setup.begin > LONG:
            log.info("     computing and writing results")
        with setup.timing.phase("output"):
            self._recorder.flush()
            summary = self._recorder.summary("converged", total)
        summary["notes"] = [*self._notes, *well_posedness.doubts(case, summary["regions"])]
        summary["notes"] += model.thermal.heating.notes if model.thermal else []
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
            summary["timing"] = self._recorder.seconds()
        self._writer.finish(summary, done=True)
        if not case.output.checkpoint.model_fields_set:
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
        except StoppedError as stop:
            raise StoppedError(f"{stop}, in its companions") from stop
        solved.append((companion, numbers))
        seconds = clock.perf_counter() - begin
        log.info("     error estimate: companion run on %s in %.1f s", companion, seconds)
    return {
        "companions": [str(c) for c, _ in solved],
        "of": error_estimate.error_sources([c for c, _ in solved]),
        "failed": failed,
        "unsettled": error_estimate.estimate(summary, case, solved),
    }
