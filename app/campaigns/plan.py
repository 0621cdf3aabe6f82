"""Options of commands that make many runs, and the plan that ``--dry-run`` prints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from app.campaigns import batch
from app.campaigns.runs import Job
from app.case.case import load
from app.soundness import cost
from app.system import layout

# Factor for cores that are idle at the end of a batch, as runs differ in length.
IDLE = 1.1


@dataclass(frozen=True)
class Options:
    """Options of a command that makes many runs.

    Attributes:
        folder: Folder of the results; finished runs in it are not repeated.
        pattern: Part of the names wanted; empty for all.
        tier: quick, default or long.
        slurm: Options of sbatch, to make each run a Slurm job; None to run here.
    """

    folder: Path
    cores: int
    pattern: str = ""
    tier: str = "default"
    slurm: Sequence[str] | None = None


def describe(title: str, jobs: Sequence[Job], options: Options) -> str:
    """Table of the runs with size, cost and what is done, below a title; runs nothing.

    Raises:
        InputError: Any job is wrong.
    """
    results = batch.results_so_far(jobs, options.folder, options.cores)
    rows, wall, seen = [], 0.0, set[object]()
    for job, result in zip(jobs, results, strict=True):
        case = load(job.case, job.overrides).config
        seconds = cost.seconds(case, result.process not in seen)  # of one core
        alone = seconds / min(job.ranks, options.cores)
        about = layout.duration(alone)
        note = f"shares the matrices of {result.process}" if result.process in seen else ""
        if result.folder in seen:
            note, about = "the same as one above", "-"
        elif result.summary:
            note, about = f"done in {layout.duration(result.seconds)}", "-"
        seen |= {result.process, result.folder}
        if about != "-":
            wall += alone if job.alone else seconds / options.cores
        size = layout.count(round(cost.unknowns(case), -2))
        rows.append((job.name, job.ranks, size, about, note))
    listed = layout.table(("case", "ranks", "unknowns", "about", ""), rows)
    about = layout.duration(IDLE * wall)
    return f"{title}\n\n{listed}\n\nabout {about} for what is not done, on {options.cores} cores"
