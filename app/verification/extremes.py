"""``mantle stress``: stiff and extreme cases, each answered, refused with a reason, or wrong.

Writes ``stress.json`` and ``stress.png`` beside the runs. Finished runs are not done again. Every
run is a process of its own: none is to begin from the answer that it is compared with.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mantle.campaigns import batch
from mantle.errors import ConvergenceError, GeometryError, InputError, Reason
from mantle.results.reading import Run
from mantle.schema import config
from mantle.system.folders import write_json
from mantle.verification.extremes_case import CONFIGS, ExtremeCase, Wanted
from mantle.verification.extremes_cases import trials
from mantle.verification.extremes_picture import picture

log = logging.getLogger("mantle")

CORRECT, REFUSED, WRONG, FAILED = STATES = ("correct", "refused", "wrong", "failed")
# Exit codes of a refusal.
REFUSALS = tuple(e.exit_code for e in (InputError, GeometryError, ConvergenceError))


@dataclass(frozen=True)
class ExtremeResult:
    """Result of a case.

    Attributes:
        trial: The case.
        state: One of `STATES`.
        explanation: Why, in words.
        deviation: How far off the answer is; None if there is none.
        seconds: Wall time of its own run, the first.
    """

    trial: ExtremeCase
    state: str
    explanation: str
    deviation: float | None
    seconds: float

    def as_json(self) -> dict[str, Any]:
        """The entry of stress.json."""
        finite = self.deviation is not None and math.isfinite(self.deviation)
        return {
            "case": self.trial.name,
            "parameters": self.trial.parameters,
            "outcome": self.state,
            "explanation": self.explanation,
            "deviation": self.deviation if finite else None,
            "seconds": round(self.seconds, 2),
            "tolerance": self.trial.tolerance if self.trial.judge else None,
            "row": self.trial.row,
            "line": self.trial.line,
            "at": self.trial.at,
        }


def run(pattern: str, folder: Path, full: bool, cores: int) -> bool:
    """Run the cases and judge them.

    Args:
        pattern: Part of the names of the cases wanted; empty for all.
        folder: Where runs and results go.
        full: Whether the long ones are run too.
        cores: How many cores to use at most.

    Returns:
        Whether every case is correct or refused.

    Raises:
        InputError: No case has such a name, or the folder cannot be written.
    """
    everything = trials(full)
    chosen = [t for t in everything if pattern in t.name]
    if not chosen:
        rows = ", ".join(dict.fromkeys(t.row.replace(" ", "_") for t in everything))
        raise InputError(f"-k {pattern}: no case has this in its name; rows: {rows}")
    jobs, refused = _jobs(chosen, folder)
    results = dict(zip(jobs, batch.run(list(jobs.values()), folder, cores), strict=True))
    outcomes = [
        judge(t, [refused[w] if w in refused else results[w] for w in t.runs]) for t in chosen
    ]
    log.info("%s", table(outcomes))
    entries = [outcome.as_json() for outcome in outcomes]
    write_json(folder / "stress.json", entries)
    picture(entries, folder / "stress.png")
    log.info("%s\nresults in %s", verdict(outcomes), folder)
    return all(o.state in (CORRECT, REFUSED) for o in outcomes)


def _jobs(
    chosen: Sequence[ExtremeCase], folder: Path
) -> tuple[dict[Wanted, batch.Job], dict[Wanted, batch.Result]]:
    """The runs of all cases, each once, and those that are refused before they begin."""
    jobs: dict[Wanted, batch.Job] = {}
    refused: dict[Wanted, batch.Result] = {}
    for t in chosen:
        for k, wanted in enumerate(t.runs):
            if wanted in jobs or wanted in refused:
                continue
            path, overrides = CONFIGS / wanted.case, wanted.overrides
            name = t.name if k == 0 else f"{t.name}_reference"
            job = batch.Job(name, path, overrides)
            try:
                case = config.load(path, overrides)
                if wanted.mesh:
                    from mantle.verification.changed_meshes import change  # needs gmsh

                    changed = change(case, wanted.mesh, folder / "meshes")
                    job = batch.Job(name, path, (*changed, *overrides))
                jobs[wanted] = job
            except InputError as error:
                code = error.exit_code
                refused[wanted] = batch.Result(job, folder, code, 0.0, {}, str(error))
    return jobs, refused


def judge(t: ExtremeCase, results: Sequence[batch.Result]) -> ExtremeResult:
    """Say what became of a case.

    Args:
        t: The case.
        results: Of its runs, in their order.
    """
    seconds = results[0].seconds
    failed = next((r for r in results if r.exit_code), None)
    if failed is not None:
        explained = failed is results[0] and failed.exit_code in REFUSALS
        if explained and t.refused in Reason.within(failed.message):
            return ExtremeResult(t, REFUSED, failed.message, None, seconds)
        why = f"{failed.job.name}: exit code {failed.exit_code}: {failed.message}"
        return ExtremeResult(t, FAILED, why, None, seconds)
    if t.judge is None:
        return ExtremeResult(t, WRONG, "converged, though there is no answer", None, seconds)
    try:
        judged = t.judge([Run(r.folder) for r in results])
    except Exception as error:  # of any kind: the other cases are still to be reported
        log.debug("%s", t.name, exc_info=True)
        return ExtremeResult(t, FAILED, f"cannot be judged: {error!r}", None, seconds)
    right = judged.deviation <= t.tolerance
    return ExtremeResult(t, CORRECT if right else WRONG, judged.note, judged.deviation, seconds)


def table(outcomes: Sequence[ExtremeResult]) -> str:
    """A line for each row; then every case that is not as it should be."""
    rows = list(dict.fromkeys(o.trial.row for o in outcomes))
    width = max(map(len, (*rows, "row")))
    counts = " ".join(f"{state:>8}" for state in STATES)
    lines = [f"{'row':<{width}} {'cases':>6} {counts} {'seconds':>8}  worst deviation"]
    for row in rows:
        own = [o for o in outcomes if o.trial.row == row]
        numbers = " ".join(f"{sum(o.state == s for o in own):>8}" for s in STATES)
        known = [o for o in own if o.deviation is not None]
        worst = max(known, key=_badness, default=None)
        words = (
            f"{worst.deviation:.1e} of {worst.trial.tolerance:.1e}: {worst.trial.name}"
            if worst
            else ""
        )
        seconds = sum(o.seconds for o in own)
        lines.append(f"{row:<{width}} {len(own):>6} {numbers} {seconds:>8.1f}  {words}")
    for o in outcomes:
        if o.state in (WRONG, FAILED):
            off = f" by {o.deviation:.2e}" if o.deviation is not None else ""
            lines.append(f"{o.trial.name} is {o.state}{off}: {o.explanation}".replace("\n", "\n  "))
    return "\n".join(lines)


def _badness(o: ExtremeResult) -> float:
    """Deviation over tolerance; none is worse than one that is no number."""
    if o.deviation is None or math.isnan(o.deviation):
        return math.inf
    return o.deviation / o.trial.tolerance if o.trial.tolerance else o.deviation * math.inf


def verdict(outcomes: Sequence[ExtremeResult]) -> str:
    """One sentence."""
    counts = {s: sum(o.state == s for o in outcomes) for s in STATES}
    said = ", ".join(f"{n} {state}" for state, n in counts.items() if n)
    return f"{len(outcomes)} cases: {said}"
