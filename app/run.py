"""One run, from a configuration to a run directory: the straight line through the program."""

from __future__ import annotations

import hashlib
import logging
import signal
import time as clock
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from types import FrameType
from typing import Any

from mpi4py import MPI

import numpy as np

import meshes
from app import config, error, folders, preview, quantities, ranks, scene, stepping, uniqueness
from app import log as text
from app.balance import Balance
from app.errors import ConvergenceError, EnvironmentProblem, GeometryError, StoppedError
from app.field_output import MechanicalFields
from app.motion import Motion, Step, Summary
from app.output import UNITS, Writer, on_root, provenance
from app.problem import Problem, Trial
from app.quantities import Samples, Stresses
from app.solver import Solver
from app.systems import mechanical
from app.timing import Timing
from forms.contact import OPEN, SLIP
from meshes.data import MeshData
from meshes.distribute import distribute

log = logging.getLogger("mantle")


def run(
    case: config.Case,
    case_path: Path,
    output: Path,
    petsc_options: list[str],
    overrides: list[str],
) -> int:
    """Solve a case and write its run directory; collective.

    Args:
        case: The configuration.
        case_path: Where it came from, for the record.
        output: The run directory.
        petsc_options: Raw PETSc options from the command line.
        overrides: ``--set`` options, for the record.

    Returns:
        0.

    Raises:
        MantleError: With the last converged state on disk where there is one.
    """
    comm, started, begin = MPI.COMM_WORLD, datetime.now(UTC), clock.perf_counter()
    expected = ranks.world_size()
    if expected and expected != comm.size:
        raise EnvironmentProblem(
            f"started as one of {expected} ranks, but MPI here sees {comm.size}: that mpirun is of "
            "another MPI; use this one's, or mantle run -n"
        )
    for message in preview.warnings(case):
        log.warning("note: %s", message)
    timing = Timing()
    model = _Model(case, raw_options(petsc_options), timing, _watch_signals())
    problem, solver = model.problem, model.solver
    with timing.phase("assemble"):
        balance = Balance(problem, np.array(getattr(case.geometry, "head_centre", (0.0, 0.0, 0.0))))
    log.info(
        "%s: %d cells, unknowns %s, %d rank(s)",
        case.title or case_path.stem,
        problem.tagged.mesh.topology.index_map(3).size_global,
        ", ".join(f"{n} {name}" for name, n in solver.block_sizes.items()),
        comm.size,
    )
    writer = Writer(
        problem.tagged,
        (MechanicalFields(problem, model.stresses),),
        output,
        config.dump(case),
        case.output.fields,
        lambda: provenance(comm.size, case_path, overrides, model.mesh_hash, started),
    )
    recorder = _Recorder(case, model, balance, writer, timing, begin)
    log.info("%s", text.step_header())
    try:
        motion = Motion(problem, solver, recorder.step, lambda s: log.info("     %s", s))
        stepping.run(problem.scene.stages, motion)
    except (ConvergenceError, StoppedError) as failure:
        recorder.close("stopped" if isinstance(failure, StoppedError) else "not converged")
        raise type(failure)(f"{failure}\n{recorder.last_state()}") from failure
    recorder.flush()
    summary = recorder.summary("converged", motion.total)
    if case.output.condition:
        summary["solver"]["condition"] = solver.condition()
    if companions := error.companions(case):
        # The numbers are safe before their errors are looked for.
        writer.finish(summary, done=False)
        with timing.phase("error"):
            summary["error"] = _errors(companions, model, summary, case.mesh.order)
        summary["timing"] = recorder.seconds()
    writer.finish(summary, done=True)
    log.info("%s", text.closing_table(summary))
    log.info("results in %s", output)
    return 0


class _Model:
    """A case made ready to be solved."""

    def __init__(
        self, case: config.Case, options: dict[str, str], timing: Timing, stop: Callable[[], str]
    ) -> None:
        """Mesh, assemble and set the solver up; collective."""
        comm = MPI.COMM_WORLD
        self.options, self.stop = options, stop
        with timing.phase("mesh"):
            data = on_root(
                comm,
                lambda: meshes.build(case.geometry, case.mesh, folders.cache("meshes")),
                share=False,
            )
            tagged = distribute(data, comm)
            self.mesh_hash = comm.bcast(_mesh_hash(data) if data is not None else "")
        with timing.phase("assemble"):
            self.problem = Problem(
                scene.build(case), tagged, case.solver.augmentation_factor, timing
            )
            self.solver = Solver(
                mechanical(self.problem),
                case.solver.tolerance,
                case.solver.max_iterations,
                case.solver.linear,
                dict(case.solver.petsc) | options,
                timing,
                stop,
            )
            self.stresses = Stresses(self.problem, timing)

    def numbers(self, samples: Samples | None) -> dict[str, Any]:
        """What is published of the state last committed; collective."""
        return {
            "interfaces": self.interfaces(samples),
            "regions": {
                e.region: self.stresses.region(e.region) for e in self.problem.scene.elastic
            },
            "stem": quantities.stem_motion(self.problem),
        }

    def interfaces(self, samples: Samples | None) -> dict[str, dict[str, Any]]:
        """What is published of the interfaces; collective."""
        if samples is None:
            return {}
        return {
            c.name: quantities.interface(self.problem, samples, i)
            for i, c in enumerate(self.problem.scene.contacts)
        }

    def relative(self, case: config.Case) -> dict[str, Any]:
        """Solve another case in the same way, for its numbers only; collective."""
        other = _Model(case, self.options, Timing(), self.stop)
        last: list[Samples | None] = [None]

        def keep(step: Step, trial: Trial | None) -> None:
            if step.time == len(other.problem.scene.stages):
                last[0] = Samples(other.problem, trial) if trial is not None else None

        stages = other.problem.scene.stages
        motion = Motion(other.problem, other.solver, keep, lambda s: log.debug("     %s", s))
        stepping.run(stages, motion)
        return other.numbers(last[0])


def _errors(
    companions: Sequence[error.Companion], model: _Model, summary: dict[str, Any], order: int
) -> dict[str, Any]:
    """Solve the companions of a run and put the errors of its numbers into its summary."""
    solved, failed = [], []
    for companion in companions:
        begin = clock.perf_counter()
        try:
            numbers = model.relative(companion.case)
        except (ConvergenceError, GeometryError) as failure:
            log.warning("no companion on %s: %s", companion, str(failure).splitlines()[0])
            failed.append(str(companion))
            continue
        solved.append((companion, numbers))
        seconds = clock.perf_counter() - begin
        log.info("     error: companion on %s in %.1f s", companion, seconds)
    return {
        "companions": [str(c) for c, _ in solved],
        "failed": failed,
        "unsettled": error.estimate(summary, order, solved),
    }


class _Recorder:
    """Turns converged steps into lines, rows, fields and the summary."""

    def __init__(
        self,
        case: config.Case,
        model: _Model,
        balance: Balance,
        writer: Writer,
        timing: Timing,
        begin: float,
    ) -> None:
        self._case, self._model = case, model
        self._problem, self._solver = model.problem, model.solver
        self._balance, self._writer = balance, writer
        self._timing, self._begin = timing, begin
        self._samples: Samples | None = None
        self._time = 0.0
        self._steps = 0
        self._critical = uniqueness.check(model.problem)
        self._written = 0
        self._newton = 0

    def step(self, step: Step, trial: Trial | None) -> None:
        """Record a committed step; collective."""
        with self._timing.phase("output"):
            self._step(step, trial)

    def _step(self, step: Step, trial: Trial | None) -> None:
        problem = self._problem
        self._balance.update(self._solver.parts()[0], trial)
        self._samples = Samples(problem, trial) if trial is not None else None
        interfaces = self._model.interfaces(self._samples)
        self._time, self._steps = step.time, step.number
        self._newton += step.outcome.iterations
        wall = clock.perf_counter() - self._begin
        rate = (len(problem.scene.stages) - step.time) / step.time
        solved = self._timing.seconds.get("solve", 0.0)
        log.info(
            "%s",
            text.step_line(
                step.number,
                step.time,
                step.outcome.iterations,
                step.outcome.linear_iterations,
                step.outcome.residuals[-1],
                self._fraction(OPEN),
                self._fraction(SLIP),
                max((q["penetration_max"] for q in interfaces.values()), default=0.0),
                wall,
                solved * rate,
            ),
        )
        row: dict[str, Any] = {
            "step": step.number,
            "time [-]": step.time,
            "newton [-]": step.outcome.iterations,
            "krylov [-]": step.outcome.linear_iterations,
            "residual [-]": step.outcome.residuals[-1],
            "augmentation [-]": step.augmentation,
            "force balance [-]": self._balance.force,
            "moment balance [-]": self._balance.moment,
            "energy balance [-]": self._balance.energy,
        }
        columns = {
            "gap_max": "mm",
            "gap_p99": "mm",
            "slip_max": "mm",
            "slip_p99": "mm",
            "pressure_max": "MPa",
            "pressure_p99": "MPa",
            "shear_max": "MPa",
            "shear_p99": "MPa",
            "penetration_max": "mm",
            "open_fraction": "-",
            "stick_fraction": "-",
            "slip_fraction": "-",
            "dissipation": "N mm",
            "dissipation_min": "N mm",
            "contact_work": "N mm",
        }
        for name, q in interfaces.items():
            row |= {f"{name} {key} [{unit}]": q[key] for key, unit in columns.items()}
        self._writer.history(row | {"wall [s]": round(wall, 3)})
        if step.number % self._case.output.every == 0:
            self._fields()

    def _fraction(self, status: int) -> float:
        s = self._samples
        if s is None:
            return 0.0
        return float(s.weight[s.status == status].sum() / s.weight.sum())

    def _fields(self) -> None:
        self._written = self._steps  # a step that does not fit the disk is not tried again
        self._writer.fields(self._time, self._samples)

    def flush(self) -> None:
        """Write the fields of the last step, unless they are."""
        if self._written < self._steps:
            self._fields()

    def summary(self, status: str, total: Summary | None) -> dict[str, Any]:
        """The summary of the state last committed; collective."""
        problem, solver = self._problem, self._solver
        sizes = solver.block_sizes
        result = {
            "status": status,
            "title": self._case.title,
            "units": UNITS,
            "time": self._time,
            **self._model.numbers(self._samples),
            "balance": {
                "force": self._balance.force,
                "moment": self._balance.moment,
                "energy": self._balance.energy,
            },
            "solver": {
                "dofs": sum(sizes.values()),
                "blocks": sizes,
                "steps": self._steps,
                "newton_iterations": total.newton_iterations if total else self._newton,
                "linear_iterations": total.linear_iterations if total else None,
                "rejected_steps": total.rejected if total else None,
                "augmentation": problem.augmentation(),
                "ranks": problem.comm.size,
            },
        }
        for name, value in self._critical.items():
            result["interfaces"][name]["critical_friction"] = value
        result["timing"] = self.seconds()
        return result

    def seconds(self) -> dict[str, float]:
        """Wall seconds so far, by phase."""
        seconds = {k: 0.0 for k in ("mesh", "compile", "assemble", "solve", "output")}
        seconds |= self._timing.seconds
        seconds["total"] = clock.perf_counter() - self._begin
        return {k: round(v, 3) for k, v in seconds.items()}

    def close(self, status: str) -> None:
        """Leave the last converged state on disk, as far as the disk allows; collective."""
        if not self._steps:
            return
        self._problem.set_time(self._time)  # the loads of the step that failed are not this state's
        for write in (
            self.flush,
            lambda: self._writer.finish(self.summary(status, None), done=False),
        ):
            try:
                write()
            except StoppedError as error:
                log.warning("%s", error)

    def last_state(self) -> str:
        """Where the last converged state is."""
        if not self._steps:
            return "no step has converged: nothing is on disk"
        return (
            f"last converged state: time {self._time:.4g} (step {self._steps}) "
            f"in {self._writer.folder}"
        )


def raw_options(arguments: list[str]) -> dict[str, str]:
    """PETSc options from the command line: ``-name value`` or ``-name``."""
    options: dict[str, str] = {}
    key = ""
    for word in arguments:
        if word.startswith("-") and not word[1:2].isdigit():
            key = word.lstrip("-")
            options[key] = ""
        elif key:
            options[key], key = word, ""
    return options


def _mesh_hash(data: MeshData) -> str:
    digest = hashlib.sha256()
    for array in (data.points, data.cells, data.cell_tags, data.facets, data.facet_tags):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _watch_signals() -> Callable[[], str]:
    """Note signals that ask the run to stop; they are looked at between Newton iterations.

    Returns:
        A function that names the signal received so far, or gives an empty text.
    """
    received: list[str] = []

    def note(number: int, frame: FrameType | None) -> None:
        received.append(signal.Signals(number).name)

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1):
        signal.signal(number, note)
    return lambda: received[0] if received else ""
