"""Figure of quantities over a parameter other than mesh size (a penalty, load steps)."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

from app.campaigns.study_model import Measured, Report, percent
from app.campaigns.study_picture import MOST_PANELS, panels
from app.case.quantities import printed
from app.system import style

# Largest over smallest value from which an axis is logarithmic.
DECADES = 30.0
# Values smaller than the largest by this factor are zero to rounding.
ROUNDING = 1e-9


def lines(report: Report) -> dict[str, list[int]]:
    """Lines that vary a number other than the mesh, with the indices of their runs."""
    found: dict[str, list[int]] = {}
    for i, r in enumerate(report.runs):
        found.setdefault(r.line, []).append(i)
    return {
        name: own
        for name, own in found.items()
        if all(report.runs[i].x and not report.runs[i].key.startswith("mesh.") for i in own)
    }


def picture(report: Report, path: Path) -> bool:
    """Draw the first six quantities over the number that varies, each line as a curve.

    Args:
        report: The study.
        path: The PNG to write.

    Returns:
        Whether any line varies such a number.
    """
    varying = lines(report)
    if not varying:
        return False
    shown = report.quantities[:MOST_PANELS]
    panels(path, shown, lambda axes, m: _panel(axes, report, m, varying), 2, (4.6, 2.9))
    return True


def _panel(axes: Any, report: Report, m: Measured, varying: dict[str, list[int]]) -> None:
    """One quantity: its reference, its curves, and what failed."""
    factor = m.quantity.factor
    title = f"{m.name} ({printed(m.quantity.shown)})".removesuffix(" ()")
    axes.set_title(title, fontsize=11, loc="left")
    axes.set(xscale="log", xlabel=_label(report, varying))
    reference = None if m.reference is None else factor * m.reference.value
    if reference is not None:
        label = f"reference ± {percent(report.target)}"
        band = report.target * abs(reference)
        axes.axhspan(reference - band, reference + band, color="0.88", lw=0, zorder=0, label=label)
        axes.axhline(reference, color="0.45", lw=1, zorder=1, label=label)
    known = {
        i: factor * value
        for own in varying.values()
        for i in own
        if (value := m.points[i].value) is not None
    }
    for k, (name, own) in enumerate(varying.items()):
        good = [i for i in own if i in known]
        style.curve(axes, [report.runs[i].x for i in good], [known[i] for i in good], k, name)
        failed = [report.runs[i].x for i in own if report.runs[i].result.exit_code]
        style.crosses(axes, failed, k, 0.93 - 0.08 * k)  # two lines may fail at the same number
    _ticks(axes.xaxis, [report.runs[i].x or 1.0 for own in varying.values() for i in own])
    _scale(axes, [*known.values(), *([] if reference is None else [reference])])


def _scale(axes: Any, values: list[float]) -> None:
    """A logarithmic axis for values that span decades; what is zero to rounding is at its zero."""
    largest = max(map(abs, values), default=0.0)
    positive = [v for v in values if v > ROUNDING * largest]
    if not positive or min(values) < -ROUNDING * largest or largest < DECADES * min(positive):
        return
    if len(positive) < len(values):
        smallest = 10 ** math.floor(math.log10(min(positive)))
        axes.set_yscale("symlog", linthresh=smallest)
        axes.set_ylim(bottom=-0.3 * smallest)
        return
    axes.set_yscale("log")
    _ticks(axes.yaxis, positive)


def _ticks(axis: Any, values: list[float]) -> None:
    """Ticks within the decades of a logarithmic axis where these are few."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    if max(values) < 1e3 * min(values):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda v, _: _text(v)))
    axis.set_minor_formatter(NullFormatter())


def _text(value: float) -> str:
    """A tick: 5, 200, 2 x 10^5."""
    if 1e-3 <= value < 1e4:
        return f"{value:g}"
    digits, exponent = f"{value:.0e}".split("e")
    return rf"${digits} \times 10^{{{int(exponent)}}}$"


def _label(report: Report, varying: dict[str, list[int]]) -> str:
    """Names and units of the varied numbers: ``penalty, augmentation (MPa/mm)``."""
    names: dict[str, list[str]] = {}
    for own in varying.values():
        run = report.runs[own[0]]
        name = re.sub(r".*\.", "", run.key)
        same = names.setdefault(run.unit, [])
        same += [name] if name not in same else []
    return ", ".join(", ".join(n) + (f" ({unit})" if unit else "") for unit, n in names.items())
