"""The picture of a suite: ladders with the slopes of theory, and errors over tolerances."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from app.plots import figures
from app.plots.figures import COLOURS
from app.verification.check import CheckResult, by_group

# Of each outcome colour and marker.
LOOKS = {
    "passed": ("#2e8b57", "o"),
    "refused": ("#4a90c4", "s"),
    "missed": ("#d1343b", "D"),
    "failed": ("#2b2b2b", "X"),
}
# Errors over tolerances that are drawn at the margins.
LEAST, MOST = 1e-6, 30.0


def draw(outcomes: Sequence[CheckResult], path: Path) -> None:
    """Draw ladders with the slopes of theory, and the error over tolerance of every check."""
    groups = by_group(outcomes)
    ladders = by_group([o for o in outcomes if o.check.order and o.sample and o.sample.errors])
    rows, columns = max(1, len(ladders)), 2 if ladders else 1
    height = max(3.4 * rows if ladders else 0.0, 1.6 + 0.36 * len(groups))
    figure = figures.new(12.5 if ladders else 7.5, height)
    cells = figure.add_gridspec(rows, columns, width_ratios=(1.0, 1.15)[:columns])
    for k, members in enumerate(ladders.values()):
        _ladder(figure.add_subplot(cells[k, 0]), members)
    _margins(figure.add_subplot(cells[:, -1]), groups)
    figure.savefig(path, dpi=110)


def _ladder(axes: Any, outcomes: Sequence[CheckResult]) -> None:
    """Errors over sizes, each with the theoretical slope through its last point."""
    every: set[float] = set()
    for o, colour in zip(outcomes, COLOURS, strict=False):
        assert o.sample and o.check.order
        sizes, errors = np.array([r.size for r in o.check.runs]), np.array(o.sample.errors)
        label = f"{o.check.name}: order {o.order or np.nan:.2f} ({o.check.order:g})"
        axes.loglog(sizes, errors, "o-", color=colour, label=label, markersize=4.5)
        theory = errors[-1] * (sizes / sizes[-1]) ** o.check.order
        axes.loglog(sizes, theory, ":", color=colour, linewidth=1.3)
        every |= {*sizes}
    axes.plot([], [], ":", color="#777777", label="slope of theory")
    axes.set_xticks(sorted(every), [f"{s:.3g}" for s in sorted(every)])
    axes.xaxis.minorticks_off()
    axes.set(xlabel=outcomes[0].check.rung, ylabel="relative error")
    axes.set_title(outcomes[0].check.what, fontsize=9, loc="left")
    axes.legend(fontsize=8, frameon=False)
    figures.grid(axes)


def _margins(axes: Any, groups: dict[str, list[CheckResult]]) -> None:
    """Error over tolerance of every check, a line for each group, with the names of failures."""
    counts = Counter(o.outcome for members in groups.values() for o in members)
    for k, members in enumerate(groups.values()):
        for i, o in enumerate(members):
            colour, marker = LOOKS[o.outcome]
            # A refusal has no error; what failed is as bad as any.
            ratio = LEAST if o.outcome == "refused" else float(np.clip(o.ratio, LEAST, MOST))
            y = k + 0.7 * ((i + 0.5) / len(members) - 0.5)
            axes.plot(ratio, y, marker, color=colour, markersize=4.5, alpha=0.8)
            if o.outcome in ("missed", "failed"):
                name = f"{o.check.name} "
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
