"""The picture of a suite: fitted orders with the slopes of theory, and errors over tolerances."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from app.plots import figures
from app.plots.curves import Line, Panel, draw_panel
from app.plots.figures import PNG
from app.plots.tables import Dot, Kind, dots
from app.verification.problem import FAILED, MISSED, PASSED, REFUSED, Row, by_group

# Dots of each outcome, in the order of the legend.
DOT_OF_OUTCOME = {
    PASSED: Kind(PASSED, "#2e8b57", "o"),
    REFUSED: Kind(REFUSED, "#4a90c4", "s"),
    MISSED: Kind(MISSED, "#d1343b", "D"),
    FAILED: Kind(FAILED, "#2b2b2b", "X"),
}
# Smaller errors over tolerances are drawn at the left margin [-].
SMALLEST_ERROR_RATIO = 1e-6
# Larger errors over tolerances are drawn at the right margin [-].
LARGEST_ERROR_RATIO = 30.0
# Style of the entry of theory in the legend: grey.
GREY = 5


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
    for k, rows_of_ladder in enumerate(ladders.values()):
        axes = figure.add_subplot(cells[k, 0])
        draw_panel(axes, _orders(rows_of_ladder))
        axes.legend(fontsize=8, frameon=False)
    axes = figure.add_subplot(cells[:, -1])
    by_name = {name: [_dot(row) for row in group] for name, group in groups.items()}
    dots(axes, by_name, (SMALLEST_ERROR_RATIO, LARGEST_ERROR_RATIO), 1.0)
    axes.set_xlabel("error / tolerance")
    figures.save_figure(figure, path, 110, PNG)


def _orders(rows: Sequence[Row]) -> Panel:
    """Errors over sizes, each with the theoretical slope through its last point."""
    lines: list[Line] = []
    for k, row in enumerate(rows):
        assert row.order
        label = f"{row.name}: order {row.fitted or np.nan:.2f} ({row.order:g})"
        lines.append(Line(label, k, row.sizes, row.errors))
        theory = [row.errors[-1] * (size / row.sizes[-1]) ** row.order for size in row.sizes]
        lines.append(Line("", k, row.sizes, theory, look="dotted"))
    lines.append(Line("slope of theory", GREY, [], [], look="dotted"))
    return Panel(rows[0].quantity, "relative error", lines, rows[0].rung, log="xy")


def _dot(row: Row) -> Dot:
    """The error over the tolerance: none of a refusal, as bad as any of a failure."""
    ratio = SMALLEST_ERROR_RATIO if row.outcome == REFUSED else row.ratio
    name = row.name if row.outcome in (MISSED, FAILED) else ""
    return Dot(ratio, DOT_OF_OUTCOME[row.outcome], name)
