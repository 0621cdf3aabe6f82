"""``mantle sweep``: many cases that differ in some keys, with one table of their results.

The folder is that of a batch (`app/campaigns/batch.py`) with these files in addition::

    folder/sweep.csv     a row for each case: what varies, numbers and their errors, cost
    folder/sweep.json    the same with overrides, folders and messages
    folder/sweep.yaml    the sweep as read
"""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import TypedDict

from app.campaigns import batch, uncertainty
from app.campaigns.batch import Options
from app.campaigns.runs import Result, reason
from app.campaigns.uncertainty import PartSpread
from app.case import sweep as sweep_file
from app.foundation import layout
from app.foundation.errors import ConvergenceError, StoppedError, UnusableError, worst_error
from app.results import run_table
from app.results.run_table import SweepRow
from app.results.verdicts import UNUSABLE
from app.schema import yaml_file
from app.system import identity
from app.system.folders import write_json, write_text, writing

log = logging.getLogger("mantle")

# Status of a run by its exit code; other runs have failed.
STATUS = {
    0: "converged",
    ConvergenceError.exit_code: "not converged",
    StoppedError.exit_code: "stopped",
    UnusableError.exit_code: UNUSABLE,
}
FAILED = "failed"


class SweepRecord(TypedDict):
    """Content of ``sweep.json``.

    Attributes:
        title: Title of the sweep.
        file: Its file.
        overrides: Options ``--set``.
        program: Version and hash of the program.
        cores: Number of cores; None without a limit.
        uncertainty: Spread over uncertain inputs, by part.
        cases: Rows of all cases.
    """

    title: str
    file: str
    overrides: list[str]
    program: str
    cores: int | None
    uncertainty: dict[str, PartSpread]
    cases: list[SweepRow]


def run(path: Path, overrides: Sequence[str], options: Options) -> None:
    """Run the cases of a sweep that are not done yet, and write their table.

    Options ``--set`` apply to all cases; an option with a key that varies is refused.

    Raises:
        InputError: The file or its cases have errors (all are in one message, before anything
            runs).
        MantleError: Some cases failed; the error has the highest exit code. The others are done.
        StoppedError: Interrupted; the same command continues.
    """
    sweep, planned = sweep_file.read(path, overrides)
    folder, name = options.folder, sweep.title or path.stem
    if options.dry_run:
        log.info(
            "%s", batch.table_of_planned_runs(f"{name}: {len(planned)} cases", planned, options)
        )
        return
    keys = list(dict.fromkeys(chain.from_iterable(p.point.varied for p in planned)))
    log.info("%s: %s", name, layout.several(len(planned), "case"))

    def write(results: Sequence[Result]) -> SweepRecord:
        rows = [_row(result, folder) for result in results]
        record: SweepRecord = {
            "title": name,
            "file": str(path),
            "overrides": list(overrides),
            "program": identity.program(),
            "cores": options.cores,
            "uncertainty": uncertainty.of_parts(rows, sweep.uncertain_inputs()),
            "cases": rows,
        }
        with writing(folder):
            write_json(folder / "sweep.json", record)
            write_text(folder / "sweep.csv", run_table.csv_of_runs(rows, keys, "case"))
            # A copy, because the file may have changed since it was read.
            data = sweep.model_dump(mode="json", exclude_unset=True)
            write_text(folder / "sweep.yaml", yaml_file.to_yaml(data))
        return record

    record = write(batch.run(planned, folder, options.cores, options.slurm, write))
    rows = record["cases"]
    log.info("%s", run_table.text_of_runs(rows))
    for note_line in layout.noted([(r["name"], r["notes"]) for r in rows]):
        log.warning("note: %s", note_line)
    spread_table = uncertainty.tables_of_spread(record["uncertainty"])
    if spread_table:
        log.info("\n%s", spread_table)
    log.info("sweep.csv and sweep.json are written in %s", folder)
    log.info("mantle report %s makes figures and tables", folder)
    failed_rows = [row for row in rows if row["exit_code"]]
    if failed_rows:
        reasons = [f"{r['name']}: {reason(r['message'])} (in {r['folder']})" for r in failed_rows]
        heading = f"{len(failed_rows)} of {len(rows)} cases failed or are not to be used:"
        raise worst_error([r["exit_code"] for r in failed_rows], "\n".join([heading, *reasons]))


def _row(result: Result, folder: Path) -> SweepRow:
    status = STATUS.get(result.exit_code, FAILED)
    planned = result.planned
    row = run_table.row(planned.point, result.summary, status, result.seconds)
    return {
        **row,
        "part": planned.point.part,
        "folder": os.path.relpath(result.folder, folder),
        "ranks": planned.ranks,
        "exit_code": result.exit_code,
        "message": result.message,
    }
