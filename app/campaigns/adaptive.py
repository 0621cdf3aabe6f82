"""A mesh that is graded for one number: solve, estimate its error, divide cells, and again."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

from app.case import loaded_case, quantities
from app.case.loaded_case import LoadedCase
from app.errors import ConvergenceError, InputError
from app.results.closing_lines import goal_said
from app.results.reading import Results
from app.results.run_folder import DIVIDED
from app.soundness import memory
from app.system import layout
from app.system.folders import csv_text, write_text
from app.system.ranks import rank

log = logging.getLogger("mantle")

# Half of the error is in the cells that are divided, so that each pass takes a third off it or
# more: after so many it does not converge.
MOST = 12


def run(
    case: LoadedCase, output: Path, to: float, solve: Callable[[LoadedCase, Path], Results]
) -> None:
    """Divide cells until the error of ``output.goal`` is small enough; collective.

    Each pass is a run in a folder of its own, ``pass-0`` and so on, with the table of the cells
    that the next one divides. ``adapt.csv`` has a row for each.

    Args:
        case: The case, with a goal.
        output: The folder above those of the passes.
        to: Error of the goal over itself at which to stop.
        solve: Solves a case into a run directory.

    Raises:
        ConvergenceError: The error does not get there, or the mesh not into the memory.
        MantleError: As a run.
    """
    goal, rows = case.config.output.goal, list[dict[str, Any]]()
    assert goal is not None
    q = quantities.find(goal)
    if rank() == 0:
        (output / "DONE").unlink(missing_ok=True)
    while True:
        folder = output / f"pass-{len(rows)}"
        summary = solve(case, folder).summary
        found = summary.get("goal")
        if found is None:
            raise InputError(f"--adapt {goal}: {folder} has no error of it; --force solves again")
        part = found["error"] / abs(found["value"]) if found["value"] else float("inf")
        rows.append(
            {
                "pass": len(rows),
                "cells": found["cells"],
                "unknowns": summary["solver"]["dofs"],
                f"{goal} [{q.unit}]": found["value"],
                f"error [{q.unit}]": found["error"],
                "error [%]": round(100 * part, 3),
                "cpu [s]": round(sum(summary["cpu"].values()), 1),
            }
        )
        if rank() == 0:
            write_text(output / "adapt.csv", csv_text(rows))
        log.info("pass %d: %s", len(rows) - 1, goal_said(found))
        if part <= to:
            break
        if len(rows) > MOST:
            raise ConvergenceError(_short(goal, part, to, f"in {MOST} passes", folder))
        divided = f"mesh.divided={(folder / DIVIDED).resolve()}"
        case = loaded_case.load(case.path, [*case.overrides, divided])
        try:
            memory.check(case.file, case.config)
        except InputError as error:
            where = f"on this machine: {error}"
            raise ConvergenceError(_short(goal, part, to, where, folder)) from None
    if rank() == 0:
        write_text(output / "DONE", "")
    log.info("%s", layout.table(list(rows[0]), (list(row.values()) for row in rows)))
    log.info("results in %s", folder)


def _short(goal: str, part: float, to: float, where: str, folder: Path) -> str:
    """Why the error is not reached, and what there is."""
    return (
        f"--adapt {goal}: known to {100 * part:.2g} %, not to {100 * to:.2g} %, {where}\n"
        f"last pass: {folder}; try mesh.order: 2, or a finer mesh.size to begin with"
    )
