"""The picture of ``mantle bench``: time, memory and iterations over unknowns."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mantle.campaigns.work_precision import fitted_order

Row = dict[str, Any]

# Curves by the first word of a row's name.
CURVES = {
    "contact": ("#d1682c", "s", "contact"),
    "bonded": ("#1f5fa8", "o", "bonded"),
}
PANELS = (
    ("solution [CPU s]", "assembly, set-up and solution (CPU s)", True),
    ("memory [MB]", "peak memory (MB)", True),
    ("newton", "Newton iterations", False),
    ("krylov", "Krylov iterations", False),
)


def picture(rows: Sequence[Row], path: Path) -> bool:
    """Draw the curves of runs on one rank.

    Args:
        rows: Those of bench.csv.
        path: The PNG to write.

    Returns:
        Whether there was anything to draw.
    """
    curves = {
        name: sorted(own, key=lambda row: row["unknowns"])
        for name in CURVES
        if (own := [r for r in rows if r["name"].startswith(f"{name}_") and r["ranks"] == 1])
    }
    if not curves:
        return False
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.4, 7.6), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(2, 2).ravel()
    for axes, (key, title, logarithmic) in zip(panels, PANELS, strict=True):
        _panel(axes, curves, key, logarithmic)
        axes.set_title(title, fontsize=11, loc="left")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    figure.savefig(path, dpi=130)
    return True


def _panel(axes: Any, curves: dict[str, list[Row]], key: str, logarithmic: bool) -> None:
    """One quantity over unknowns, with the exponents of what grows."""
    from matplotlib.ticker import EngFormatter, LogLocator, NullFormatter

    for name, rows in curves.items():
        colour, marker, label = CURVES[name]
        x, y = [r["unknowns"] for r in rows], [r[key] for r in rows]
        axes.plot(x, y, color=colour, marker=marker, ms=5.5, lw=1.5, label=label)
        if logarithmic and len(rows) > 2:
            axes.annotate(
                rf"$\sim n^{{{fitted_order(x, y):.2f}}}$",
                (x[-1], y[-1]),
                xytext=(7, -10),
                textcoords="offset points",
                fontsize=10,
                color=colour,
            )
    axes.set(xscale="log", xlabel="unknowns")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(EngFormatter(sep=" "))
    axes.xaxis.set_minor_formatter(NullFormatter())
    if logarithmic:
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(lambda v, _: f"{v:g}")
        axes.yaxis.set_minor_formatter(NullFormatter())
    else:
        axes.set_ylim(bottom=0)
    axes.margins(x=0.17)
    axes.grid(True, which="major", color="0.9")
    axes.set_axisbelow(True)
