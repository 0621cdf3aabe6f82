"""The picture of a suite: ladders with the slopes of theory, and errors over tolerances."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from app import figures
from app.system import style
from app.system.style import COLOURS

Entry = dict[str, Any]
# By outcome: colour and marker.
LOOKS = {
    "passed": ("#2e8b57", "o"),
    "refused": ("#4a90c4", "s"),
    "missed": ("#d1343b", "D"),
    "failed": ("#2b2b2b", "X"),
}
# Errors over tolerances that are drawn at the margins.
LEAST, MOST = 1e-6, 30.0


def draw(entries: Sequence[Entry], path: Path) -> None:
    """Draw what `verification.engine` found.

    Args:
        entries: The content of its JSON file.
        path: The PNG to write.
    """
    groups = _grouped(entries)
    ladders = _grouped([e for e in entries if e["sizes"] and e["errors"]])
    rows = max(1, len(ladders))
    height = max(3.4 * rows if ladders else 0.0, 1.6 + 0.36 * len(groups))
    figure = figures.new(12.5 if ladders else 7.5, height)
    columns = 2 if ladders else 1
    cells = figure.add_gridspec(rows, columns, width_ratios=(1.0, 1.15)[:columns])
    for k, members in enumerate(ladders.values()):
        _ladder(figure.add_subplot(cells[k, 0]), members)
    _margins(figure.add_subplot(cells[:, -1]), groups)
    figure.savefig(path, dpi=110)


def _grouped(entries: Sequence[Entry]) -> dict[str, list[Entry]]:
    groups: dict[str, list[Entry]] = {}
    for e in entries:
        groups.setdefault(e["group"], []).append(e)
    return groups


def _ladder(axes: Any, entries: Sequence[Entry]) -> None:
    """Errors over sizes, each with the slope that theory gives through its last point."""
    for e, colour in zip(entries, COLOURS, strict=False):
        sizes, errors = np.array(e["sizes"]), np.array(e["errors"], dtype=float)
        label = f"{e['name']}: order {e['order'] or np.nan:.2f} ({e['expected_order']:g})"
        axes.loglog(sizes, errors, "o-", color=colour, label=label, markersize=4.5)
        theory = errors[-1] * (sizes / sizes[-1]) ** e["expected_order"]
        axes.loglog(sizes, theory, ":", color=colour, linewidth=1.3)
    axes.plot([], [], ":", color="#777777", label="slope of theory")
    every = sorted({s for e in entries for s in e["sizes"]})
    axes.set_xticks(every, [f"{s:.3g}" for s in every])
    axes.xaxis.minorticks_off()
    axes.set_xlabel(entries[0]["rung"])
    axes.set_ylabel("relative error")
    axes.set_title(entries[0]["quantity"], fontsize=9, loc="left")
    axes.legend(fontsize=8, frameon=False)
    style.grid(axes)


def _margins(axes: Any, groups: dict[str, list[Entry]]) -> None:
    """Error over tolerance of every check, a line for each group; the names of what is off."""
    counts = dict.fromkeys(LOOKS, 0)
    for k, members in enumerate(groups.values()):
        for i, e in enumerate(members):
            colour, marker = LOOKS[e["outcome"]]
            counts[e["outcome"]] += 1
            x, y = _ratio(e), k + 0.7 * ((i + 0.5) / len(members) - 0.5)
            axes.plot(x, y, marker, color=colour, markersize=4.5, alpha=0.8)
            if e["outcome"] in ("missed", "failed"):
                axes.annotate(f"{e['name']} ", (x, y), ha="right", va="center", fontsize=7)
    axes.axvline(1.0, color="#444444", linewidth=1)
    axes.set(xscale="log", xlim=(LEAST / 1.5, 1.7 * MOST), ylim=(len(groups) - 0.4, -0.6))
    axes.set_yticks(range(len(groups)), list(groups), fontsize=8)
    axes.set_xlabel("error / tolerance")
    handles = [
        axes.plot([], [], marker, color=colour, label=f"{outcome} ({counts[outcome]})")[0]
        for outcome, (colour, marker) in LOOKS.items()
        if counts[outcome]
    ]
    above = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "ncols": len(handles)}
    axes.legend(handles=handles, fontsize=8, frameon=False, **above)
    style.grid(axes)


def _ratio(e: Entry) -> float:
    """Where a check is drawn; a refusal has no error, what failed is as bad as any."""
    if e["outcome"] == "refused":
        return LEAST
    if e["error"] is None:
        return MOST
    # Zero may be tolerated, and met.
    ratio = e["error"] / e["tolerance"] if e["tolerance"] else float(e["error"] > 0) * MOST
    return float(np.clip(ratio, LEAST, MOST))
