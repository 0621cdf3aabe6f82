"""Panels of a run: forces, numbers over time, cement under tension, steps of the solver."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import chain

import numpy as np

from app.case.case import Case
from app.case.number_text import FACTOR_OF_UNIT, printed
from app.case.quantities import TABLE, TENSION_LEVELS
from app.case.summary import Summary
from app.foundation.arrays import Floats
from app.foundation.layout import plain_text
from app.plots.curves import ROUNDED, Line, Panel, sparse
from app.report import page
from app.report.page import Block
from app.report.sweep_results import named
from app.scene.scene import build_scene

# Title and printed unit of the quantities drawn, by key in history.csv.
BEFORE = {
    "temperature_max": ("highest temperature", "degC"),
    "temperature_max_second": ("highest temperature, second side", "degC"),
    "degree_min": ("least degree of cure", "%"),
    "": ("temperature at probes", "degC"),
}
AFTER = {
    **{f"force.{axis}": (f"force in {axis}", "N") for axis in "xyz"},
    "subsidence": ("subsidence", "um"),
    "retroversion": ("retroversion", "deg"),
    **{f"displacement.{axis}": (f"displacement in {axis} at probes", "um") for axis in "xyz"},
    "strain": ("strain of gauges", "um/m"),
}
# Columns of time in history.csv.
SECONDS = "seconds [s]"
TIME = "time [-]"
# First letters of the columns that belong to the solver.
SOLVER = (SECONDS, TIME, "step", "newton", "krylov", "residual", "augmentation", "wall")
# Units of quantities that vanish without loads.
VANISHING = ("um", "um/m", "mm", "deg", "N", "N mm", "MPa")
# Value below which a quantity counts as zero, in its printed unit.
ROUNDING_OF_QUANTITIES = 1e-9
StepRecord = Mapping[str, Floats]


def curves_shown() -> dict[str, tuple[str, str]]:
    """Title and printed unit of the quantities drawn, by key, in the order of the panels."""
    of_interfaces = {
        key: (q.label, q.shown)
        for key, q in TABLE["interfaces"].items()
        if q.step_record and (q.curve or (q.headline and not q.exact))
    }
    return BEFORE | of_interfaces | AFTER


def over_time(step_record: StepRecord, at_rest: bool = False) -> list[Panel]:
    """Return panels of the quantities that change.

    Args:
        step_record: Columns of history.csv by their titles.
        at_rest: True if all loads are zero at time 0. Curves of lengths, angles, forces and
            stresses over the stages then begin at zero there.

    The abscissa is time in seconds if each recorded step has a different time, else the stages.
    """
    drawn_quantities = curves_shown()
    seconds = step_record.get(SECONDS, np.empty(0))
    is_timed = 0 < len(seconds) == len(np.unique(seconds))
    times = step_record.get(SECONDS if is_timed else TIME, np.empty(0))
    if len(times) < 2:
        return []
    lines: dict[str, dict[str, tuple[list[float], list[float]]]] = {}
    for column, values in step_record.items():
        place, key, unit = _parts(column)
        if key not in drawn_quantities or not place or (not key and unit != "degC"):
            continue
        printed_unit = drawn_quantities[key][1]
        scaled = FACTOR_OF_UNIT.get(printed_unit, 1.0) * values
        is_known = np.isfinite(values)
        if np.abs(scaled[is_known]).max(initial=0.0) > ROUNDED.get(
            printed(printed_unit), ROUNDING_OF_QUANTITIES
        ):
            x, y = times[is_known].tolist(), scaled[is_known].tolist()
            if at_rest and not is_timed and printed_unit in VANISHING:
                x, y = [0.0, *x], [0.0, *y]
            lines.setdefault(key, {})[place] = x, y
    places = list(dict.fromkeys(chain.from_iterable(lines.values())))
    panels = []
    for key, (title, unit) in drawn_quantities.items():
        if key in lines:
            curves = [
                Line(named(place), places.index(place), *points)
                for place, points in lines[key].items()
            ]
            x_title = "time (s)" if is_timed else "time (each stage takes 1)"
            panel_title = page.spelled_out(title)
            panels.append(Panel(panel_title, printed(unit), curves, x_title, from_rest=True))
    return panels


def forces(case: Case, step_record: StepRecord) -> list[Panel]:
    """Return the panel of the magnitudes of the forces at the steps.

    Nothing if the forces only grow, in a single stage without cycles. In a stage that repeats cycle
    tables, the abscissa is the time of the cycles in seconds.
    """
    scene = build_scene(case)
    times = step_record.get(TIME, np.empty(0))
    k = next((k for k, stage in enumerate(scene.stages) if stage.repeats), None)
    if k is not None:
        times = np.union1d(times[(times > k) & (times <= k + 1)], [k])
        x = (times - k) * scene.stages[k].cycles * scene.period
        x_title = f"time in the stage {named(scene.stages[k].name)} (s)"
    elif len(scene.stages) > 1 or any(stage.cycles > 1 for stage in scene.stages):
        x = times = np.union1d(times, [0.0])
        x_title = "time (each stage takes 1)"
    else:
        return []
    forces = scene.force_sizes(times)
    lines = [
        Line(named(name), i, [*map(float, x)], [*map(float, sizes)])
        for i, (name, sizes) in enumerate(forces.items())
        if sizes.any()
    ]
    return [Panel("forces", "N", lines, x_title, log="", from_rest=True)] if lines else []


def tension(summary: Summary) -> list[Panel]:
    """Return the panel of the cement volume above each level of tension; none if it is zero."""
    lines: list[Line] = []
    levels = [float(level) for level in TENSION_LEVELS]
    keys = [f"volume_over_{level}_MPa" for level in TENSION_LEVELS]
    for region, q in summary.get("regions", {}).items():
        if q.get(keys[0]):
            volumes = [q[key] for key in keys]
            errors = [q.get(f"{key}_error") or 0.0 for key in keys]
            lines.append(Line(named(region), len(lines), levels, volumes, errors))
    if not lines:
        return []
    title = "volume with more tension"
    return [Panel(title, printed("mm^3"), lines, "than a tension of (MPa)", from_rest=True)]


def _parts(column: str) -> tuple[str, str, str]:
    """Place, key and unit of a column; the place is empty for numbers of the whole run."""
    name, _, unit = column.removesuffix("]").partition(" [")
    place, _, key = name.partition(" ")
    is_of_run = column.startswith(SOLVER) or key == "balance"
    return ("" if is_of_run else place), key, unit


def steps(step_record: StepRecord) -> list[Block]:
    """Return a table of the solver's columns, by step."""
    columns = {
        column: v
        for column, v in step_record.items()
        if not _parts(column)[0] and np.isfinite(v).any()
    }
    rows = sparse([*zip(*columns.values(), strict=True)])
    row_texts = []
    for row in rows:
        row_texts.append([plain_text(float(f"{value:.3g}")) for value in row])
    return page.table([*columns], row_texts)
