"""The picture of a suite: fitted orders with the slopes of theory, and errors over tolerances."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from app.plots import figures
from app.plots.figures import COLOURS
from app.verification.problem import FAILED, MISSED, PASSED, REFUSED, Row, by_group

# Of each outcome colour and marker.
LOOKS = {
    PASSED: ("#2e8b57", "o"),
    REFUSED: ("#4a90c4", "s"),
    MISSED: ("#d1343b", "D"),
    FAILED: ("#2b2b2b", "X"),
}
# Errors over tolerances that are drawn at the margins.
LEAST = 1e-6
MOST = 30.0


def draw(rows: Sequence[Row], path: Path) -> None:
    """Draw fitted orders with the slopes of theory, and the error over tolerance of every row."""
    groups = by_group(rows)
    ladders = by_group([row for row in rows if row.order and row.comparison and row.errors])
    if ladders:
        figure = figures.new(12.5, max(3.4 * len(ladders), 1.6 + 0.36 * len(groups)))
        cells = figure.add_gridspec(len(ladders), 2, width_ratios=(1.0, 1.15))
    else:
        figure = figures.new(7.5, 1.6 + 0.36 * len(groups))
        cells = figure.add_gridspec(1, 1)
    for k, members in enumerate(ladders.values()):
        _ladder(figure.add_subplot(cells[k, 0]), members)
    _margins(figure.add_subplot(cells[:, -1]), groups)
    figure.savefig(path, dpi=110)


def _ladder(axes: Any, rows: Sequence[Row]) -> None:
    """Errors over sizes, each with the theoretical slope through its last point."""
    every: set[float] = set()
    for row, colour in zip(rows, COLOURS, strict=False):
        assert row.order
        sizes = np.array(row.sizes)
        errors = np.array(row.errors)
        label = f"{row.name}: order {row.fitted or np.nan:.2f} ({row.order:g})"
        axes.loglog(sizes, errors, "o-", color=colour, label=label, markersize=4.5)
        theory = errors[-1] * (sizes / sizes[-1]) ** row.order
        axes.loglog(sizes, theory, ":", color=colour, linewidth=1.3)
        every.update(row.sizes)
    axes.plot([], [], ":", color="#777777", label="slope of theory")
    axes.set_xticks(sorted(every), [f"{s:.3g}" for s in sorted(every)])
    axes.xaxis.minorticks_off()
    axes.set(xlabel=rows[0].rung, ylabel="relative error")
    axes.set_title(rows[0].quantity, fontsize=9, loc="left")
    axes.legend(fontsize=8, frameon=False)
    figures.grid(axes)


def _margins(axes: Any, groups: Mapping[str, Sequence[Row]]) -> None:
    """Error over tolerance of every row, a line for each group, with the names of failures."""
    counts = Counter(row.outcome for members in groups.values() for row in members)
    for k, members in enumerate(groups.values()):
        for i, row in enumerate(members):
            colour, marker = LOOKS[row.outcome]
            # A refusal has no error; a failure is as bad as any error.
            ratio = LEAST if row.outcome == REFUSED else float(np.clip(row.ratio, LEAST, MOST))
            y = k + 0.7 * ((i + 0.5) / len(members) - 0.5)
            axes.plot(ratio, y, marker, color=colour, markersize=4.5, alpha=0.8)
            if row.outcome in (MISSED, FAILED):
                name = f"{row.name} "
                axes.annotate(name, (ratio, y), ha="right", va="center", fontsize=7)
    axes.axvline(1.0, color="#444444", linewidth=1)
    axes.set(xscale="log", xlim=(LEAST / 1.5, 1.7 * MOST), ylim=(len(groups) - 0.4, -0.6))
    axes.set_yticks(range(len(groups)), list(groups), fontsize=8)
    axes.set_xlabel("error / tolerance")
    for outcome, (colour, marker) in LOOKS.items():
        if counts[outcome]:
            axes.plot([], [], marker, color=colour, label=f"{outcome} ({counts[outcome]})")
    above = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "ncols": len(counts)}
    axes.legend(fontsize=8, frameon=False, **above)
    figures.grid(axes)
