"""Output of a run, step by step: rows of history.csv, fields, and in the end the summary.

`step_log` has the lines of the log, `history_row` the columns of history.csv, `run_summary` the
sections of the summary.
"""

from __future__ import annotations

import logging
import time as clock
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from app.case.case import Case
from app.case.summary import Numbers, Summary
from app.foundation.arrays import Floats, Ints
from app.foundation.errors import StoppedError
from app.foundation.verdict import Verdict
from app.mechanics.contact import TrialState
from app.results.balance import Balance
from app.results.cycles import Cycles
from app.results.interface_numbers import ContactSamples
from app.results.run_folder import UNITS, Writer
from app.scene.scene import Stage
from app.simulation import run_summary
from app.simulation.history_row import Row, mechanical_columns, stem_columns
from app.simulation.model import Mechanical, Model
from app.simulation.step_log import StepLog
from app.soundness.critical_friction import critical_friction_of_interfaces
from app.stepping.heat_state import HeatStep
from app.stepping.load_steps import Effort, LoadStep
from app.system.timing import Timing

log = logging.getLogger("mantle")


@dataclass(frozen=True)
class AcceptedStep:
    """A step that has converged and is recorded.

    Attributes:
        folder: Run directory; for a variation, its subfolder.
        number: 1 for the first: its row in history.csv.
        stage: Name of its stage.
        time: Time at its end: stage k runs from k to k + 1.
        end: Time at the end of the last stage.
        wall_seconds: Wall time since the run began [s].
        row: Row in history.csv: numbers by column title, with units.
    """

    folder: Path
    number: int
    stage: str
    time: float
    end: float
    wall_seconds: float
    row: Row


OnAccepted = Callable[[AcceptedStep], None]


class Recorder:
    """Recorder of converged steps as log lines, table rows, fields and summary; on all ranks.

    Args:
        case: Case of the run.
        model: Model of the case.
        writer: Writer of the run directory.
        timing: Times of the run by phase.
        begin: Start of the run by `time.perf_counter` [s].
        progress: Called after each row of history.csv.

    Attributes:
        samples: Contact points after the last step, if there are any.
        time: Time at the end of the last step.
        step_count: Number of recorded steps, which is that of rows in history.csv.
        increment_count: Number of recorded steps that end an increment of their stage.
        step_of_last_fields: Number of the last step with fields.
        effort: Iterations of the recorded steps.
        mechanical_row: Columns of the last step of the mechanics.
        pressures_and_status: Pressures and status of contact points after that step.
        balance: Balances after that step, if a region deforms.
        cycles: Numbers at the peaks and valleys of the loads.
        valley: Jumps at the last valley.
        writer: Writer of the run directory.
    """

    saved = (
        "step_count",
        "time",
        "increment_count",
        "step_of_last_fields",
        "effort",
        "mechanical_row",
        "pressures_and_status",
        "balance",
        "writer",
        "cycles",
        "valley",
    )

    def __init__(
        self,
        case: Case,
        model: Model,
        writer: Writer,
        timing: Timing,
        begin: float,
        progress: OnAccepted,
    ) -> None:
        self._case, self._model, self.writer = case, model, writer
        self._progress = progress
        self._timing, self._begin = timing, begin
        centre_of_moments = np.array(case.geometry.points.get("head_centre", (0.0, 0.0, 0.0)))
        self.balance: Balance | None = None
        self._critical_friction: dict[str, float] = {}
        mechanics = model.mechanics
        if mechanics:
            with timing.phase("assemble"):
                self.balance = mechanics.balance(centre_of_moments)
                critical = critical_friction_of_interfaces(mechanics.problem)
            self._critical_friction = {c.interface: c.smallest for c in critical}
            for warning in (w for c in critical for w in c.warnings()):
                log.warning("%s", warning)
        self.samples: ContactSamples | None = None
        self.pressures_and_status: dict[str, Floats | Ints] = {}
        self.time = 0.0
        self.step_count = self.step_of_last_fields = self.increment_count = 0
        self.effort = Effort()
        self._stage = Stage(name="rest")
        self._step_log = StepLog(len(model.scene.stages))
        self.cycles = Cycles()
        self.valley: dict[str, Floats] = {}
        self.mechanical_row: Row = {}

    @property
    def row_keys(self) -> dict[str, Ints]:
        """Keys of owned contact points."""
        mechanics = self._model.mechanics
        contact = mechanics.problem.contact if mechanics else None
        return (
            dict.fromkeys(("pressures_and_status", "valley"), contact.row_keys) if contact else {}
        )

    def restored(self) -> None:
        """Compute the balance and the samples of a restored state; collective.

        `saved_state.restore` calls this method after it has restored the model.
        """
        # A run that was saved before the first step of its mechanics has nothing to compute.
        mechanics = self._model.mechanics
        if self.mechanical_row and mechanics and self.balance:
            u, q = mechanics.solver.u_and_q()
            trial = mechanics.problem.trial(u, q) if q is not None else None
            self.balance.continue_from(u, trial)
            if trial is not None:
                pressures = self.pressures_and_status["pressures"].astype(np.float64)
                status = self.pressures_and_status["status"].astype(np.int64)
                forces = replace(trial.forces, pressures=pressures, status=status)
                self._set_samples(mechanics, replace(trial, forces=forces))
        if self.writer.fields and not self.writer.field_steps:
            self.step_of_last_fields = 0

    def _set_samples(self, mechanics: Mechanical, trial: TrialState) -> None:
        """Sample the contact points of a state; collective."""
        jump_at_valley = self.valley.get("jump")
        self.samples = ContactSamples(mechanics.problem, trial, jump_at_valley, mechanics.surfaces)

    def add_time(self, seconds: Mapping[str, float]) -> None:
        """Add the wall time before a restart, by phase as in `seconds` [s]."""
        self._begin -= seconds["total"]
        for phase in [p for p in seconds if p != "total"]:
            self._timing.seconds[phase] = self._timing.seconds.get(phase, 0.0) + seconds[phase]

    def begin_stage(self, stage: Stage) -> None:
        """Begin a stage."""
        self._stage = stage
        if not stage.has_valleys:  # inducible motion is that of the last cycle of the run
            self.valley = {}
        self._step_log.begin_stage(stage)

    def record_step(self, step: LoadStep, trial: TrialState | None) -> None:
        """Record a step of the mechanics; collective."""
        with self._timing.phase("output"):
            mechanics, balance = self._model.mechanics, self.balance
            assert mechanics is not None and balance is not None
            balance.update(mechanics.solver.u_and_q()[0], trial)
            if trial is not None:
                self.pressures_and_status = {
                    "pressures": trial.forces.pressures,
                    "status": trial.forces.status,
                }
                self._set_samples(mechanics, trial)
            self.effort.count(step.outcome)
            stem_motion = mechanics.stem(self._case.side)
            self.mechanical_row = mechanical_columns(
                self._model, step, balance, self.samples, stem_motion
            )
            stem = {q.key: stem_motion[q.key] for q in stem_columns(stem_motion)}
            self._record_reversal(step, stem, trial)
            # In stages that take time, rows are written at the more frequent steps of heat.
            if not self._stage.takes_time:
                self._write_row(step)
                solve_seconds = self._timing.seconds.get("solve", 0.0)
                self._step_log.log_step(step, self.samples, self._wall(), solve_seconds)

    def _record_reversal(self, step: LoadStep, stem: Numbers, trial: TrialState | None) -> None:
        """Store the numbers at peaks and valleys of a stage with cycles."""
        stage = self._stage
        if not (stage.has_valleys and step.ends_increment and stage.reversal(step.time)):
            return
        self.cycles.add(step.stage, stem, self.samples.step_numbers if self.samples else {})
        if trial is not None and stage.is_valley(step.time):
            self.valley = {"jump": trial.jump.copy()}

    def record_heat_step(self, step: LoadStep, heat_step: HeatStep) -> None:
        """Record a step of the heat, with the mechanics at its end; collective."""
        with self._timing.phase("output"):
            self.effort.count(heat_step.outcome)
            t = self._model.thermal
            if t:
                self._step_log.log_heat_step(step.number, heat_step, t.row(), self._wall())
            self._write_row(step)

    def _wall(self) -> float:
        """Wall time since the run began [s]."""
        return clock.perf_counter() - self._begin

    def _write_row(self, step: LoadStep) -> None:
        """Write a row of history.csv: the columns of mechanics, then those of heat."""
        self.time = step.time
        self.step_count += 1
        row: Row = {"step": self.step_count, "time [-]": step.time, **self.mechanical_row}
        t = self._model.thermal
        if t:
            row |= t.row()
        wall = self._wall()
        row["wall [s]"] = round(wall, 3)
        self.writer.add_row(row)
        if step.ends_increment:
            self.increment_count += 1
            if self.increment_count % self._case.output.every == 0:
                self._fields()
        end, folder = float(len(self._case.stages)), self.writer.folder
        self._progress(AcceptedStep(folder, self.step_count, step.stage, step.time, end, wall, row))

    def _fields(self) -> None:
        # Set first: if the disk is full, the step is not written again.
        self.step_of_last_fields = self.step_count
        row = self._model.thermal.row() if self._model.thermal else {}
        seconds = row.get("seconds [s]")
        self.writer.write_fields(self.step_count, self.time, seconds, self.samples)

    def flush(self) -> None:
        """Write the fields of the last step if missing, and `final.vtkhdf` with that step alone."""
        if self.step_of_last_fields < self.step_count:
            self._fields()
        self.writer.last_fields()

    def summary(self, total: Effort) -> Summary:
        """Summary of a converged run; collective.

        Args:
            total: Effort of the whole run, with its failed attempts.
        """
        return self._summary("converged", total, total.rejected)

    def unfinished_summary(self, status: str) -> Summary:
        """Summary of the last committed state of a run that has failed or stopped; collective.

        Its effort is that of the recorded steps. The number of rejected steps is None.
        """
        return self._summary(status, self.effort, None)

    def _summary(self, status: str, effort: Effort, rejected: int | None) -> Summary:
        model, comm = self._model, self._model.tagged.mesh.comm
        numbers = run_summary.at_rest()
        if self.step_count:
            numbers = run_summary.numbers_of_state(
                self._case, model, self.samples, self.cycles, self._critical_friction, self.time
            )
        solver = run_summary.solver_numbers(model, self.step_count, effort, rejected)
        return {
            "status": status,
            "title": self._case.title,
            "units": UNITS,
            "time": self.time,
            **numbers,
            "balance": run_summary.balances(self.balance, model.thermal),
            "solver": solver,
            "timing": self.seconds(),
            "cpu": run_summary.cpu_seconds(comm, self._timing),
            "memory": run_summary.memory(comm, solver["dofs"]),
        }

    def seconds(self) -> dict[str, float]:
        """Wall seconds so far, by phase."""
        phases = dict.fromkeys(("mesh", "compile", "assemble", "solve", "output"), 0.0)
        total = {"total": self._wall()}
        return {k: round(v, 3) for k, v in (phases | self._timing.seconds | total).items()}

    def close(
        self, status: str, verdicts: Sequence[Verdict], summary: Summary | None = None
    ) -> None:
        """Write the last converged state and the verdicts, if the disk allows; collective.

        Args:
            status: Status of the run.
            verdicts: Reasons why it ends.
            summary: Summary of that state, if it is known. Its fields are then on disk.
        """

        def finish() -> None:
            unfinished = self.unfinished_summary(status) if summary is None else summary
            records = [verdict.record() for verdict in verdicts]
            self.writer.finish(unfinished | {"status": status, "verdicts": records}, complete=False)

        writes: tuple[Callable[[], None], ...] = (finish,)
        if summary is None:
            self._model.return_to_last_step()
            if self.step_count:
                writes = (self.flush, finish)
        for write in writes:
            try:
                write()
            except StoppedError as error:
                log.warning("%s", error)

    def last_state(self) -> str:
        """Sentence on the last converged state and its folder."""
        if not self.step_count:
            return f"no step has converged: {self.writer.folder} has the case, but no numbers"
        return (
            f"last converged state: time {self.time:.4g} (step {self.step_count}) "
            f"in {self.writer.folder}"
        )
