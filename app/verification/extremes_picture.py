"""The picture of ``mantle stress``: a cell for each case, by what became of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

Entry = dict[str, Any]

BLUE, RED, BLACK = "#4a90c4", "#d1343b", "#2b2b2b"
# Decades below its tolerance at which a deviation is as good as none.
DEEP = 6.0
# Cells side by side; what is longer goes on below.
WIDE = 11


def picture(entries: Sequence[Entry], path: Path) -> None:
    """Draw what `verification.extremes` found.

    Args:
        entries: The content of stress.json.
        path: The PNG to write.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, Normalize
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch, Rectangle

    greens = LinearSegmentedColormap.from_list("margin", ["#1b7837", "#7fbf7b", "#e6f5d0"])
    lines: dict[tuple[str, str], list[Entry]] = {}
    for e in entries:
        lines.setdefault((e["row"], e["line"]), []).append(e)
    rows = [
        ((f"{row}: {line}" if line else row) if k == 0 else "", members[k : k + WIDE])
        for (row, line), members in lines.items()
        for k in range(0, len(members), WIDE)
    ]
    columns = max(len(members) for _, members in rows)
    figure = Figure(figsize=(3.2 + 0.78 * columns, 1.7 + 0.33 * len(rows)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for y, (_, members) in enumerate(rows):
        for x, e in enumerate(members):
            colour, ink = _colours(e, greens)
            axes.add_patch(Rectangle((x, y), 0.96, 0.92, facecolor=colour, linewidth=0))
            text = (
                e["at"].replace(", ", ",\n").replace(" ", "\n", 1) if len(e["at"]) > 9 else e["at"]
            )
            axes.text(x + 0.48, y + 0.46, text, ha="center", va="center", fontsize=5.5, color=ink)
    axes.set_xlim(0, columns)
    axes.set_ylim(len(rows), 0)
    axes.set_yticks(
        [y + 0.46 for y in range(len(rows))], [label for label, _ in rows], fontsize=7.5
    )
    axes.set_xticks([])
    axes.tick_params(length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)
    counts = {s: sum(e["outcome"] == s for e in entries) for s in ("refused", "wrong", "failed")}
    right = sum(e["outcome"] == "correct" for e in entries)
    axes.set_title(f"{len(entries)} cases, {right} correct", fontsize=10, loc="left")
    bar = figure.colorbar(
        ScalarMappable(Normalize(-DEEP, 0), greens), ax=axes, shrink=0.35, aspect=14, pad=0.01
    )
    bar.set_ticks([-6, -4, -2, 0], labels=["1e-6 or less", "1e-4", "1e-2", "1"], fontsize=7)
    bar.set_label("correct: deviation / tolerance", fontsize=7.5)
    figure.legend(
        handles=[
            Patch(color=colour, label=f"{state} ({counts[state]})")
            for state, colour in zip(counts, (BLUE, RED, BLACK), strict=True)
        ],
        loc="outside lower center",
        ncols=3,
        fontsize=8,
        frameon=False,
    )
    figure.savefig(path, dpi=130)


def _colours(e: Entry, greens: Any) -> tuple[Any, str]:
    """Colour of a cell, and of what is written on it."""
    match e["outcome"]:
        case "refused":
            return BLUE, "white"
        case "wrong":
            return RED, "white"
        case "failed":
            return BLACK, "white"
    ratio = e["deviation"] / e["tolerance"] if e["deviation"] and e["tolerance"] else 0.0
    margin = math.log10(ratio) if ratio > 0 else -DEEP
    depth = min(max(1 + margin / DEEP, 0.0), 1.0)
    return greens(depth), "white" if depth < 0.4 else "black"
