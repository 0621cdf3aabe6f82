"""One run, from a configuration to a run directory: the straight line through the program."""

from __future__ import annotations

import logging
import signal
import time as clock
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from types import FrameType
from typing import Any

from mpi4py import MPI

from app import config, error, preview, ranks
from app import log as text
from app.errors import ConvergenceError, EnvironmentProblem, GeometryError, StoppedError
from app.model import Model
from app.output import Writer, provenance
from app.recorder import Recorder
from app.timing import Timing

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
    model = Model(case, comm, raw_options(petsc_options), timing, _watch_signals())
    log.info(
        "%s: %d cells, unknowns %s, %d rank(s)",
        case.title or case_path.stem,
        model.tagged.mesh.topology.index_map(3).size_global,
        ", ".join(f"{n} {name}" for name, n in model.sizes().items()),
        comm.size,
    )
    writer = Writer(
        model.tagged,
        model.layers(),
        output,
        config.dump(case),
        case.output.fields,
        lambda: provenance(comm.size, case_path, overrides, model.mesh_hash, started),
    )
    recorder = Recorder(case, model, writer, timing, begin)
    try:
        total = model.go(
            recorder.step, recorder.heat, lambda s: log.info("     %s", s), recorder.stage
        )
    except (ConvergenceError, StoppedError) as failure:
        recorder.close("stopped" if isinstance(failure, StoppedError) else "not converged")
        raise type(failure)(f"{failure}\n{recorder.last_state()}") from failure
    recorder.flush()
    summary = recorder.summary("converged", total)
    if case.output.condition:
        for m in model.mechanics:
            summary["solver"]["condition"] = m.solver.condition()
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


def _errors(
    companions: Sequence[error.Companion], model: Model, summary: dict[str, Any], order: int
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
