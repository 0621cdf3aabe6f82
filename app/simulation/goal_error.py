"""The error of the number that a case names as its goal, at the end of a run."""

from __future__ import annotations

import logging
import time as clock
from functools import partial
from pathlib import Path
from typing import Any

from app.case import divided_cells, quantities
from app.case.case import Case
from app.results import goal
from app.results.interface_numbers import ContactSamples
from app.results.run_folder import DIVIDED, GOAL_MAP, on_root
from app.simulation.model import Model
from app.system.folders import write_text

log = logging.getLogger("mantle")


def add(
    case: Case,
    model: Model,
    samples: ContactSamples | None,
    summary: dict[str, Any],
    folder: Path,
) -> None:
    """Put the error of ``output.goal`` into a summary, and its map into the run directory.

    Collective. ``divided.csv`` names the cells that carry half of the error, after those that are
    divided already: ``mesh.divided`` takes it.

    Args:
        case: The case.
        model: Its model, at the end of the run.
        samples: Of its contact points, if there are any.
        summary: Of the run; changed on every rank.
        folder: The run directory.
    """
    name = case.output.goal
    assert name is not None
    (m,) = model.mechanics
    if not m.solver.met:
        log.warning("note: %s: no error without a step since the restart", name)
        return
    begin = clock.perf_counter()
    found = goal.missing(m.problem, m.solver, m.stresses, case, samples)
    goal.write_map(folder / GOAL_MAP, model.tagged, found.volumes, found.cells)
    places = goal.to_divide(model.tagged, found.cells)
    table = divided_cells.text([*case.mesh.passes, places])
    on_root(model.tagged.mesh.comm, partial(write_text, folder / DIVIDED, table), share=False)
    q, missing = quantities.find(name), found.inside + found.interfaces
    summary["goal"] = {
        "name": name,
        "value": quantities.read(summary, name),
        "unit": q.unit,
        "error": abs(missing),
        "missing": missing,
        "inside": found.inside,
        "interfaces": found.interfaces,
        "cells": model.tagged.mesh.topology.index_map(3).size_global,
        "krylov_iterations": found.iterations,
        "seconds": round(clock.perf_counter() - begin, 3),
    }
