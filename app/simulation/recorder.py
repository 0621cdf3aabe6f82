"""Output of a run: lines of the log, rows of tables, fields and the summary."""

from __future__ import annotations

import logging
import time as clock
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from app.case.case import Case
from app.case.quantities import TABLE, Quantity
from app.case.section_loads import section_loads
from app.case.summary import Numbers, Summary, merge
from app.foundation.arrays import Floats, Ints
from app.foundation.errors import StoppedError
from app.foundation.verdict import Verdict
from app.mechanics.contact import TrialState
from app.results import closing_lines
from app.results.balance import Balance
from app.results.cycles import Cycles
from app.results.interface_numbers import ContactSamples
from app.results.run_folder import UNITS, Writer
from app.scene.scene import Stage
from app.simulation.model import Mechanical, Model
from app.soundness.critical_friction import critical_friction_of_interfaces
from app.stepping.heat_state import HeatStep
from app.stepping.load_steps import Effort, LoadStep
from app.system.timing import Timing, peak_memory
from forms.contact import OPEN, SLIP

log = logging.getLogger("mantle")


@dataclass(frozen=True)
class AcceptedStep:
    """A step that has converged and is recorded.

    Attributes:
        folder: Run directory; the folder of a variation has its name.
        number: 1 for the first: its row in history.csv.
        stage: Name of its stage.
        time: Time at its end: stage k runs from k to k + 1.
        end: Time at the end of the last stage.
        seconds: Wall time since the run began [s].
        row: Row in history.csv: numbers by column title, with units.
    """

    folder: Path
    number: int
    stage: str
    time: float
    end: float
    seconds: float
    row: Mapping[str, float | None]


# Row in history.csv: numbers by column title, with units.
Row = dict[str, float | None]
OnAccepted = Callable[[AcceptedStep], None]


class Recorder:
    """Recorder of converged steps as log lines, table rows, fields and summary; on all ranks.

    ``begin`` is the start of the run by `time.perf_counter`.

    Attributes:
        samples: Contact points after the last step, if there are any.
        step_count: Number of recorded steps, which is that of rows in history.csv.
        time: Time at the end of the last step.
    """

    saved = (
        "step_count",
        "time",
        "whole_steps",
        "fields_at",
        "total",
        "mechanical_row",
        "contact_state",
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
        self.contact_state: dict[str, Floats | Ints] = {}
        self.time = 0.0
        self.step_count = self.fields_at = self.whole_steps = 0
        self.total = Effort()
        self._stage, self._header = Stage(name="rest"), ""
        self.cycles = Cycles()
        self.valley: dict[str, Floats] = {}
        self.mechanical_row: Row = {}

    @property
    def row_keys(self) -> dict[str, Ints]:
        """Keys of owned contact points."""
        mechanics = self._model.mechanics
        contact = mechanics.problem.contact if mechanics else None
        return dict.fromkeys(("contact_state", "valley"), contact.row_keys) if contact else {}

    def restored(self) -> None:
        """Continue from a restored model; collective."""
        # Before the first solve of the mechanics the balance is at rest, without temperatures.
        mechanics = self._model.mechanics
        if self.mechanical_row and mechanics and self.balance:
            u, q = mechanics.solver.u_and_q()
            trial = mechanics.problem.trial(u, q) if q is not None else None
            self.balance.continue_from(u, trial)
            if trial is not None:
                pressures = self.contact_state["pressures"].astype(np.float64)
                status = self.contact_state["status"].astype(np.int64)
                forces = replace(trial.forces, pressures=pressures, status=status)
                self._set_samples(mechanics, replace(trial, forces=forces))
        if self.writer.fields and not self.writer.field_steps:
            self.fields_at = 0

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
        """Begin a stage: its first log line gets a header."""
        self._stage = stage
        if not _has_valleys(stage):  # inducible motion is that of the last cycle of the run
            self.valley = {}
        columns = closing_lines.HEAT if stage.takes_time else closing_lines.STEP
        self._header = closing_lines.aligned_line(columns, columns)

    def record_step(self, step: LoadStep, trial: TrialState | None) -> None:
        """Record a step of the mechanics; collective."""
        with self._timing.phase("output"):
            mechanics, balance = self._model.mechanics, self.balance
            assert mechanics is not None and balance is not None
            balance.update(mechanics.solver.u_and_q()[0], trial)
            if trial is not None:
                self.contact_state = {
                    "pressures": trial.forces.pressures,
                    "status": trial.forces.status,
                }
                self._set_samples(mechanics, trial)
            self.total.count(step.outcome)
            stem_motion = mechanics.stem(self._case.side)
            self.mechanical_row = self._mechanical_columns(step, balance, stem_motion)
            stem_columns = _stem_columns(stem_motion)
            self._record_reversal(step, {q.key: stem_motion[q.key] for q in stem_columns}, trial)
            # In stages that take time, rows are written at the more frequent steps of heat.
            if not self._stage.takes_time:
                self._write_row(step)
                self._log_step(step)

    def _record_reversal(self, step: LoadStep, stem: Numbers, trial: TrialState | None) -> None:
        """Store the numbers at peaks and valleys of a stage with cycles."""
        reversal = self._stage.reversal(step.time)
        if not (_has_valleys(self._stage) and step.ends_increment and reversal):
            return
        self.cycles.add(step.stage, stem, self.samples.step_numbers if self.samples else {})
        if trial is not None and reversal % 2 == 0:
            self.valley = {"jump": trial.jump.copy()}

    def record_heat_step(self, step: LoadStep, accepted: HeatStep) -> None:
        """Record a step of the heat, with the mechanics at its end; collective."""
        with self._timing.phase("output"):
            self.total.count(accepted.outcome)
            wall = clock.perf_counter() - self._begin
            t = self._model.thermal
            if t:
                self._log(closing_lines.heat_line(step.number, accepted, t.row(), wall))
            self._write_row(step)

    def _log_step(self, step: LoadStep) -> None:
        interfaces = self.samples.step_numbers if self.samples else {}
        fractions = self._fraction(OPEN), self._fraction(SLIP)
        deepest = max((q["penetration_max"] for q in interfaces.values()), default=0.0)
        wall = clock.perf_counter() - self._begin
        rate = (len(self._model.scene.stages) - step.time) / step.time
        time_left = self._timing.seconds.get("solve", 0.0) * rate
        self._log(closing_lines.step_line(step, fractions, deepest, wall, time_left))

    def _log(self, line: str) -> None:
        """Log the line of a step, and before the first one of a stage the header."""
        if self._header:
            log.info("%s", self._header)
            self._header = ""
        log.info("%s", line)

    def _mechanical_columns(self, step: LoadStep, balance: Balance, stem_motion: Numbers) -> Row:
        """Columns of history.csv that mechanics computes.

        They are those of the solver and of creep, of probes, of interfaces, bonds and the stem
        (rows of `case.quantities` with `step_record`), and of records (`results.records`).
        """
        row: Row = {
            "newton [-]": step.outcome.iterations,
            "krylov [-]": step.outcome.linear_iterations,
            "residual [-]": step.outcome.residuals[-1],
            "step [s]": round(step.seconds, 3),
            "augmentation [-]": step.outcome.augmentation,
            "force balance [-]": balance.force,
            "moment balance [-]": balance.moment,
            "energy balance [-]": balance.energy,
        }
        mechanics = self._model.mechanics
        creep = mechanics.problem.creep if mechanics else None
        if creep:
            row[f"creep {creep.measure} [{creep.unit}]"] = creep.elapsed
            row["creep dissipation [N mm]"] = creep.dissipated
        probes = self._model.probes
        row |= probes.step_record() if probes else {}
        columns = [c for c in TABLE["interfaces"].values() if c.step_record]
        for name, q in (self.samples.step_numbers if self.samples else {}).items():
            row |= {f"{name} {c.key} [{c.unit}]": q[c.key] for c in columns if c.key in q}
        for name, q in mechanics.bonds.numbers(strong=True).items() if mechanics else ():
            columns = [c for c in TABLE["bonds"].values() if c.step_record]
            row |= {f"{name} {c.key} [{c.unit}]": q[c.key] for c in columns}
        row |= {f"stem {q.key} [{q.unit}]": stem_motion[q.key] for q in _stem_columns(stem_motion)}
        for record in self._model.records.values():
            row |= record.step_record()
        return row

    def _write_row(self, step: LoadStep) -> None:
        """Write a row of history.csv: the columns of mechanics, then those of heat."""
        self.time = step.time
        self.step_count += 1
        row: Row = {"step": self.step_count, "time [-]": step.time, **self.mechanical_row}
        t = self._model.thermal
        if t:
            row |= t.row()
        wall = clock.perf_counter() - self._begin
        row["wall [s]"] = round(wall, 3)
        self.writer.add_row(row)
        if step.ends_increment:
            self.whole_steps += 1
            if self.whole_steps % self._case.output.every == 0:
                self._fields()
        end, folder = float(len(self._case.stages)), self.writer.folder
        self._progress(AcceptedStep(folder, self.step_count, step.stage, step.time, end, wall, row))

    def _fraction(self, status: int) -> float:
        s = self.samples
        return float(s.weight[s.status == status].sum() / s.weight.sum()) if s else 0.0

    def _fields(self) -> None:
        self.fields_at = self.step_count  # if the disk is full, the step is not written again
        row = self._model.thermal.row() if self._model.thermal else {}
        seconds = row.get("seconds [s]")
        self.writer.write_fields(self.step_count, self.time, seconds, self.samples)

    def flush(self) -> None:
        """Write pending fields of the last step, also to a separate file."""
        if self.fields_at < self.step_count:
            self._fields()
        self.writer.last_fields()

    def summary(self, status: str, total: Effort | None) -> Summary:
        """The summary of the last committed state; collective."""
        model, counted = self._model, total or self.total
        mechanics = model.mechanics
        contact = mechanics and mechanics.problem.contact
        comm, sizes = model.tagged.mesh.comm, model.sizes()
        b, t = self.balance, model.thermal
        balance = {"force": b.force, "moment": b.moment, "energy": b.energy} if b else {}
        balance |= {"heat": t.balance.heat, "heat_quadrature": t.balance.quadrature} if t else {}
        numbers: Summary = {"interfaces": {}, "regions": {}, "probes": {}}
        if self.step_count:  # at rest all numbers are zero
            numbers = model.numbers(self.samples)
            cycles = self.cycles.summary()
            if cycles:
                merge(numbers, {"cycles": cycles})
            sections = section_loads(self._case, model.scene.load_time(self.time))
            if sections:
                numbers["section_loads"] = [asdict(section) for section in sections]
        summary_numbers: Summary = {
            "status": status,
            "title": self._case.title,
            "units": UNITS,
            "time": self.time,
            **numbers,
            "balance": balance,
            "solver": {
                "dofs": sum(sizes.values()),
                "blocks": sizes,
                "steps": self.step_count,
                "newton_iterations": counted.newton_iterations,
                "linear_iterations": counted.linear_iterations,
                "rejected_steps": total.rejected if total else None,
                "augmentation": contact.augmentation() if contact else {},
                "ranks": comm.size,
            },
        }
        for name, value in self._critical_friction.items():
            if name in summary_numbers["interfaces"]:
                summary_numbers["interfaces"][name]["critical_friction"] = value
        cpu, memory = comm.allgather(self._timing.cpu), comm.allreduce(peak_memory())
        per_unknown = round(1e3 * memory / sum(sizes.values()), 2)
        summary_numbers["timing"] = self.seconds()
        summary_numbers["cpu"] = {k: round(sum(c.get(k, 0.0) for c in cpu), 3) for k in cpu[0]}
        summary_numbers["memory"] = {"peak": round(memory, 1), "per_unknown": per_unknown}
        return summary_numbers

    def seconds(self) -> dict[str, float]:
        """Wall seconds so far, by phase."""
        phases = dict.fromkeys(("mesh", "compile", "assemble", "solve", "output"), 0.0)
        total = {"total": clock.perf_counter() - self._begin}
        return {k: round(v, 3) for k, v in (phases | self._timing.seconds | total).items()}

    def close(self, status: str, verdicts: Sequence[Verdict]) -> None:
        """Write the last converged state and the verdicts, if the disk allows; collective."""
        mechanics = self._model.mechanics
        if mechanics:
            # The problem still has the loads of the failed step.
            mechanics.problem.set_time(self.time)

        def finish() -> None:
            summary = self.summary(status, None)
            summary["verdicts"] = [verdict.record() for verdict in verdicts]
            self.writer.finish(summary, complete=False)

        for write in (self.flush, finish) if self.step_count else (finish,):
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


def _stem_columns(stem_motion: Numbers) -> list[Quantity]:
    """Quantities of the stem in history.csv, those that the run has."""
    return [q for key, q in TABLE["stem"].items() if q.step_record and key in stem_motion]


def _has_valleys(stage: Stage) -> bool:
    """Return True if loads return in a stage; those of cycle tables do not."""
    return stage.load_segments > stage.cycles
