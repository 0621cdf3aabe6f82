"""``mantle sweep``: many cases from one, with one table for all of them.

Everything goes into one folder, that of a batch (`app/campaigns/batch.py`), and beside it::

    folder/sweep.csv     a row for each case: what varies, numbers and their errors, cost
    folder/sweep.json    the same with overrides, folders and messages; seconds of all calls
    folder/sweep.yaml    the sweep as read
"""

from __future__ import annotations

import json
import logging
import os
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from app.campaigns import batch, uncertainty
from app.campaigns.batch import Options
from app.campaigns.runs import Job, Result
from app.case import quantities
from app.case import sweep as sweep_file
from app.case.sweep import PlannedRun, Sweep
from app.errors import InputError, gravest
from app.results.closing_lines import UNUSABLE
from app.schema import yaml_file
from app.simulation import variations
from app.system import identity, layout
from app.system.folders import csv_text, write_json, write_text

log = logging.getLogger("mantle")

STATUS = {0: "converged", 4: "not converged", 5: "stopped", 6: UNUSABLE}
FAILED = "failed"
NOT_CONVERGED = "no convergence"


def run(path: Path, overrides: Sequence[str], options: Options) -> None:
    """Run the cases of a sweep that are not done yet, and write their table.

    Args:
        path: The sweep file.
        overrides: ``--set`` options for every case; keys that vary are refused.
        options: Folder, cores, Slurm.

    Raises:
        InputError: Every error of the file and its cases, before anything runs.
        MantleError: Some cases failed; with the gravest exit code. The others are done.
        StoppedError: Interrupted; the same command continues.
    """
    sweep, planned = sweep_file.read(path, overrides)
    jobs, folder = [_job(p) for p in planned], options.folder
    begin = time.monotonic() - _spent(folder)
    log.info("%s: %d cases", sweep.title or path.stem, len(planned))

    def write(results: Sequence[Result]) -> list[dict[str, Any]]:
        return _write(sweep, path, overrides, planned, results, options, begin)

    rows = write(batch.run(jobs, folder, options.cores, options.slurm, write))
    log.info("%s", _table(rows))
    for text in layout.noted([(r["name"], r["notes"]) for r in rows]):
        log.warning("note: %s", text)
    if spread := uncertainty.table(uncertainty.of_parts(rows, sweep.uncertain())):
        log.info("\n%s", spread)
    log.info(
        "written in %s: sweep.csv, sweep.json; mantle report %s makes figures and tables",
        folder,
        folder,
    )
    failed = [row for row in rows if row["exit_code"]]
    if failed:
        reasons = [f"{r['name']}: {_reason(r['message'])} (in {r['folder']})" for r in failed]
        text = "\n".join(
            [f"{len(failed)} of {len(rows)} cases failed or are not to be used:", *reasons]
        )
        raise gravest([r["exit_code"] for r in failed], text)


def dry_run(path: Path, overrides: Sequence[str], options: Options) -> str:
    """Plan of `run` as a table: cases, their size and cost.

    Raises:
        InputError: As `run`.
    """
    sweep, planned = sweep_file.read(path, overrides)
    title = f"{sweep.title or path.stem}: {len(planned)} cases"
    return batch.plan(title, [_job(p) for p in planned], options)


def _spent(folder: Path) -> float:
    """Wall time of earlier calls [s]."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        text = (folder / "sweep.json").read_text(encoding="utf-8")
        return float(json.loads(text)["seconds"])
    return 0.0


def _job(p: PlannedRun) -> Job:
    return Job(p.point.name, p.base, p.overrides, p.ranks, share=True)


def _write(
    sweep: Sweep,
    path: Path,
    overrides: Sequence[str],
    planned: Sequence[PlannedRun],
    results: Sequence[Result],
    options: Options,
    begin: float,
) -> list[dict[str, Any]]:
    """Write the tables; return the rows."""
    folder = options.folder
    rows = [_row(p, r, folder) for p, r in zip(planned, results, strict=True)]
    keys = list(dict.fromkeys(key for p in planned for key in p.point.varied))
    try:
        write_json(
            folder / "sweep.json",
            {
                "title": sweep.title or path.stem,
                "file": str(path),
                "compare_with": sweep.compare_with or "",
                "overrides": list(overrides),
                "program": identity.program(),
                "cores": options.cores,
                "seconds": round(time.monotonic() - begin, 1),
                "uncertainty": uncertainty.of_parts(rows, sweep.uncertain()),
                "cases": rows,
            },
        )
        write_text(folder / "sweep.csv", _csv(rows, keys))
        # The file may have changed since.
        data = sweep.model_dump(mode="json", exclude_unset=True)
        write_text(folder / "sweep.yaml", yaml_file.to_yaml(data))
    except OSError as error:
        raise InputError(f"-o {folder}: cannot be written: {error.strerror}") from error
    return rows


def _row(p: PlannedRun, result: Result, folder: Path) -> dict[str, Any]:
    summary = result.summary
    status = STATUS.get(result.exit_code, FAILED)
    row = variations.row(p.point, summary, status, result.seconds)
    errors = {name: quantities.read(summary, name, "_error") for name in row["numbers"]}
    return row | {
        "part": p.point.part,
        "folder": os.path.relpath(result.folder, folder),
        "ranks": p.ranks,
        "exit_code": result.exit_code,
        "message": result.message,
        "unknowns": summary.get("solver", {}).get("dofs"),
        "errors": {name: value for name, value in errors.items() if value is not None},
    }


def _csv(rows: Sequence[Mapping[str, Any]], keys: Sequence[str]) -> str:
    flat = []
    for r in rows:
        numbers = {}
        for name, value in r["numbers"].items():
            unit = quantities.find(name).unit
            numbers[f"{name} [{unit}]"] = value
            if name in r["errors"]:
                numbers[f"{name} error [{unit}]"] = r["errors"][name]
        flat.append(
            {
                "case": r["name"],
                "status": r["status"],
                "notes": "; ".join(r["notes"]),
                **{key: r["overrides"].get(key, "") for key in keys},
                **numbers,
                "unknowns [-]": r["unknowns"],
                "newton [-]": r["newton_iterations"],
                "krylov [-]": r["linear_iterations"],
                "wall [s]": r["seconds"],
                "folder": r["folder"],
            }
        )
    return csv_text(flat)


def _table(rows: Sequence[Mapping[str, Any]]) -> str:
    lines = []
    for r in rows:
        size, newton = ("-" if r[k] is None else r[k] for k in ("unknowns", "newton_iterations"))
        said = r["status"] if r["exit_code"] else variations.most(r["numbers"])
        lines.append((r["name"], size, newton, layout.duration(r["seconds"]), said))
    return layout.table(("case", "unknowns", "newton", "wall", "most"), lines)


def _reason(message: str) -> str:
    """Essential line of a message: where nothing converged, else the last."""
    lines = [line.strip() for line in message.splitlines() if line.strip()]
    return next((line for line in lines if line.startswith(NOT_CONVERGED)), ["", *lines][-1])
