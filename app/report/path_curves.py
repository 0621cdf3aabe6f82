"""Panels of fields along paths: of a run at the ends of its stages, and of several runs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import chain

import numpy as np

from app.case.number_text import FACTOR_OF_UNIT, printed
from app.foundation.arrays import Floats
from app.foundation.layout import plain_text
from app.plots.curves import ROUNDED, Line, Panel, drawing
from app.report import page
from app.report.page import Block, bullets
from app.report.sweep_results import SweptCase, named
from app.results.path_tables import ARC, PLACES, REGION
from app.results.reading import PathTable
from app.scene.path_fields import field_of

# Largest number of steps of a run in one panel.
MOST_STEPS = 5
ABSCISSA = "distance along the path (mm)"
# Columns that are not fields.
ABOUT = ("step", "time [-]", "seconds [s]", ARC, *PLACES, REGION)
GAPS = "Curves have gaps where the path is outside."


def path_blocks_of_run(case: SweptCase) -> list[Block]:
    """Draw the paths of a run: a panel for each field, a curve for each drawn step (`_steps`)."""
    blocks: list[Block] = []
    for name, table in case.paths.items():
        drawings = [drawing(panel) for panel in panels_of_path(table, stages_of(case))]
        caption = GAPS if (table[REGION] == "").any() else ""
        blocks += page.titled(named(name), page.drawings(drawings, caption))
    return blocks


def stages_of(case: SweptCase) -> list[str]:
    """Names of the stages of a run."""
    return [str(stage["name"]) for stage in case.data.get("stages", [])]


def panels_of_path(table: PathTable, stages: Sequence[str], title: str = "") -> list[Panel]:
    """Return a panel for each field of a path.

    Args:
        table: Columns of the file of the path.
        stages: Names of the stages of the run.
        title: Beginning of the titles.
    """
    steps = _steps(table, stages)
    all_panels = []
    for column in fields_of(table):
        lines: list[Line] = []
        for k, (step, label) in enumerate(steps.items()):
            lines += _lines(table, column, step, label, k)
        if lines:
            all_panels.append(_panel(column, lines, title))
    return all_panels


def fields_of(table: PathTable) -> list[str]:
    """Titles of the columns of fields."""
    return [title for title in table if title not in ABOUT]


def path_blocks_of_runs(names: Sequence[str], cases: Sequence[SweptCase]) -> list[Block]:
    """Draw the paths that several runs have at their last steps, and list the others."""
    blocks: list[Block] = []
    unshared_paths: list[str] = []
    for path in dict.fromkeys(chain.from_iterable(case.paths for case in cases)):
        runs = [k for k, case in enumerate(cases) if path in case.paths]
        if len(runs) < 2:
            unshared_paths.append(f"path {path}: only in {names[runs[0]]}")
            continue
        tables = [cases[k].paths[path] for k in runs]
        drawings = []
        for column in dict.fromkeys(chain.from_iterable(map(fields_of, tables))):
            lines: list[Line] = []
            for k, table in zip(runs, tables, strict=True):
                if column in table:
                    lines += _lines(table, column, table["step"].max(), names[k], k)
            if lines:
                drawings.append(drawing(_panel(column, lines)))
        keys = [_definition(cases[k], path) for k in runs]
        caption = ""
        if any(key != keys[0] for key in keys):
            keys_of_runs = (
                f"{names[k]}: {plain_text(key)}" for k, key in zip(runs, keys, strict=True)
            )
            caption = f"The keys of the path differ: {'; '.join(keys_of_runs)}"
        blocks += page.titled(named(path), page.drawings(drawings, caption))
    return blocks + bullets(unshared_paths)


def _definition(case: SweptCase, path: str) -> Mapping[str, object]:
    """Keys of a path in the case of a run, without those that choose columns and points."""
    keys = case.data.get("output", {}).get("paths", {}).get(path, {})
    return {key: value for key, value in keys.items() if key not in ("points", "fields")}


def _steps(table: PathTable, stages: Sequence[str]) -> dict[int, str]:
    """Steps to draw with their names.

    They are the last steps of the stages. A run of a single stage with time has some steps at equal
    distances in time.
    """
    last_of_time = {float(t): int(s) for t, s in zip(table["time [-]"], table["step"], strict=True)}
    time_of_stage_end: dict[int, float] = {}
    for time in last_of_time:
        time_of_stage_end[math.ceil(time - 1e-9)] = time
    if len(time_of_stage_end) > 1:
        stage_ends = list(time_of_stage_end.items())[-MOST_STEPS:]
        return {last_of_time[time]: named(stages[k - 1]) for k, time in stage_ends}
    seconds = table.get("seconds [s]")
    last_step = int(table["step"].max())
    if seconds is None or len(last_of_time) == 1:
        return {last_step: ""}
    by_step = {int(s): float(t) for s, t in zip(table["step"], seconds, strict=True)}
    target_times = np.linspace(min(by_step.values()), max(by_step.values()), MOST_STEPS)
    steps = {min(by_step, key=lambda s: abs(by_step[s] - time)) for time in target_times}
    return {step: f"{by_step[step]:.4g} s" for step in sorted(steps)}


def _panel(column: str, lines: Sequence[Line], title: str = "") -> Panel:
    """A panel of a field."""
    label, unit = _shown(column)
    panel_title = page.spelled_out(f"{title}{label}")
    return Panel(panel_title, printed(unit), lines, ABSCISSA, log="", from_rest=True)


def _shown(column: str) -> tuple[str, str]:
    """Label of a column of a file, and its unit as in the table of fields."""
    name, _, unit = column.removesuffix("]").partition(" [")
    key, _, axis = name.partition(".")
    field = field_of(key)
    label = f"{field.label} {axis}".strip() if field else name.replace("_", " ")
    return label, (field.shown if field and field.unit == unit else "") or unit


def _lines(table: PathTable, column: str, step: float, label: str, style: int) -> list[Line]:
    """Curve of a field at a step, in pieces between gaps; only the first has a label."""
    is_at_step = table["step"] == step
    x: Floats = table[ARC][is_at_step]
    factor = FACTOR_OF_UNIT.get(_shown(column)[1], 1.0)
    y: Floats = factor * table[column][is_at_step]
    y = np.where(np.abs(y) < ROUNDED.get(printed(_shown(column)[1]), 0.0), 0.0, y)
    is_known = np.isfinite(y)
    row_groups = np.split(np.arange(len(y)), np.flatnonzero(np.diff(is_known.astype(int))) + 1)
    lines: list[Line] = []
    for rows in row_groups:
        if len(rows) and is_known[rows[0]]:
            points = [float(v) for v in x[rows]], [float(v) for v in y[rows]]
            lines.append(Line("" if lines else label, style, *points, look="line"))
    return lines
