"""The picture of ``mantle verify``: ladders with the slopes of theory, errors and tolerances."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

Entry = dict[str, Any]

COLOURS = ("#1b6ca8", "#d1495b", "#2e8b57", "#b8860b", "#6a4c93", "#444444")
PASS, FAIL = "#2e8b57", "#d1495b"


def picture(entries: Sequence[Entry], path: Path) -> None:
    """Draw what `verification.verify` measured.

    Args:
        entries: The content of verify.json.
        path: The PNG to write.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    ladders = _families([e for e in entries if e["sizes"] and e["errors"]])
    rows = max(1, len(ladders))
    height = max(3.4 * rows, 1.6 + 0.24 * len(entries))
    figure = Figure(figsize=(12.5 if ladders else 7.5, height), layout="constrained")
    FigureCanvasAgg(figure)
    if ladders:
        grid = figure.add_gridspec(rows, 2, width_ratios=(1.0, 1.15))
        for k, members in enumerate(ladders.values()):
            _ladder(figure.add_subplot(grid[k, 0]), members)
        _margins(figure.add_subplot(grid[:, 1]), entries)
    else:
        _margins(figure.add_subplot(), entries)
    figure.savefig(path, dpi=110)


def _families(entries: Sequence[Entry]) -> dict[str, list[Entry]]:
    """Ladders by what they have in common: the first word of their names."""
    families: dict[str, list[Entry]] = {}
    for e in entries:
        families.setdefault(e["name"].split("_")[0], []).append(e)
    return families


def _ladder(axes: Any, entries: Sequence[Entry]) -> None:
    """Errors over sizes, each with the slope that theory gives through its last point."""
    for e, colour in zip(entries, COLOURS, strict=False):
        sizes, errors = np.array(e["sizes"]), np.array(e["errors"], dtype=float)
        label = f"{e['name']}: order {e['order']:.2f} ({e['expected_order']:g})"
        axes.loglog(sizes, errors, "o-", color=colour, label=label, markersize=4.5)
        theory = errors[-1] * (sizes / sizes[-1]) ** e["expected_order"]
        axes.loglog(sizes, theory, ":", color=colour, linewidth=1.3)
    axes.plot([], [], ":", color="#777777", label="slope of theory")
    every = sorted({s for e in entries for s in e["sizes"]})
    axes.set_xticks(every, [f"{s:.3g}" for s in every])
    axes.xaxis.minorticks_off()
    decades = [m * 10.0**k for k in range(-9, 1) for m in (1, 2, 5)]
    low, high = axes.get_ylim()
    shown = [d for d in decades if low <= d <= high]
    axes.set_yticks(shown, [f"{d:.0e}".replace("e-0", "e-") for d in shown])
    axes.yaxis.minorticks_off()
    axes.set_xlabel(entries[0]["rung"])
    axes.set_ylabel("relative error")
    axes.set_title(entries[0]["quantity"], fontsize=9, loc="left")
    axes.legend(fontsize=8, frameon=False)
    axes.grid(True, which="major", alpha=0.25)


def _margins(axes: Any, entries: Sequence[Entry]) -> None:
    """Error over tolerance of every problem."""
    floor, worst = 1e-6, 30.0
    for k, e in enumerate(entries):
        # A problem that could not be measured is as bad as any; zero may be tolerated, and met.
        ratio = np.inf
        if e["error"] is not None:
            ratio = e["error"] / e["tolerance"] if e["tolerance"] else float(e["error"] > 0) * worst
        shown = np.clip(ratio, floor, worst)
        colour = PASS if e["passed"] else FAIL
        axes.plot([floor, shown], [k, k], color=colour, linewidth=1, alpha=0.5)
        axes.plot(shown, k, "o" if e["error"] is not None else "x", color=colour, markersize=5)
    axes.axvline(1.0, color="#444444", linewidth=1)
    axes.set_xscale("log")
    axes.set_xlim(floor / 1.5, 1.7 * worst)
    axes.set_yticks(range(len(entries)), [e["name"] for e in entries], fontsize=8)
    axes.set_ylim(len(entries) - 0.4, -0.6)
    axes.set_xlabel("error / tolerance")
    passed = sum(e["passed"] for e in entries)
    axes.set_title(f"{passed} of {len(entries)} pass", fontsize=10, loc="left")
    axes.grid(True, axis="x", alpha=0.25)
