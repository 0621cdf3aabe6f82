"""Error against run time as a picture: a panel for each quantity."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from app.campaigns.study_model import FLAT, Measured, Report, percent
from app.system import style
from app.system.style import COLOURS, MARKERS

MOST_PANELS = 6
EXACT = 1e-16  # what an error of zero is drawn as


def picture(report: Report, path: Path) -> bool:
    """Draw the first six quantities that have an error.

    Args:
        report: The study.
        path: The PNG to write.

    Returns:
        Whether there is any.
    """
    shown = [m for m in report.quantities if m.compared][:MOST_PANELS]
    if not shown:
        return False
    columns = 2 if len(shown) in (1, 2, 4) else 3
    panels(path, shown, lambda axes, m: _panel(axes, report, m), columns, (5.2, 4.2))
    return True


def panels(
    path: Path,
    shown: Sequence[Measured],
    panel: Callable[[Any, Measured], None],
    columns: int,
    size: tuple[float, float],
) -> None:
    """Draw a panel for each quantity, and one legend for all.

    Args:
        path: The PNG to write.
        shown: The quantities.
        panel: Draws one of them into its axes.
        columns: How many stand beside each other, at most.
        size: Width and height of a panel [inch].
    """
    figure, every = style.panels(len(shown), columns, *size)
    for axes, m in zip(every, shown, strict=True):
        axes.set_title(m.name, fontsize=11, loc="left")
        style.grid(axes)
        panel(axes, m)
    handles = style.handles(every)
    if "failed" in handles:
        handles["failed"] = handles.pop("failed")  # last
    figure.legend(
        handles.values(),
        handles,
        loc="outside lower center",
        ncols=min(len(handles), 5),
        frameon=False,
    )
    figure.savefig(path, dpi=130)


def _panel(axes: Any, report: Report, m: Measured) -> None:
    """One quantity: its lines, the front, the target, and what failed."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axes.set(xscale="log", yscale="log", xlabel="run time (s)", ylabel="error")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda t, _: f"{t:g}"))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda e, _: f"{100 * e:g} %"))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_minor_formatter(NullFormatter())
    axes.grid(True, which="minor", color="0.96")
    error = [None if e is None else max(e, EXACT) for e in m.errors]
    for k, name in enumerate(m.exponents):
        _line(axes, report, m, error, name, k)
    _front(axes, m, error)
    _limits(axes, report, m, error)
    axes.axhline(
        report.target, color="0.3", lw=1, ls=(0, (5, 3)), label=f"target {percent(report.target)}"
    )
    if m.reference is not None and m.reference.uncertainty and m.reference.value:
        own = m.reference.uncertainty / abs(m.reference.value)
        axes.axhspan(
            axes.get_ylim()[0],
            own,
            color="0.88",
            lw=0,
            zorder=0,
            label="below the reference's own error",
        )
    if all(e is None for e in error):
        axes.text(0.5, 0.5, "no known error", transform=axes.transAxes, ha="center", color="0.4")


def _front(axes: Any, m: Measured, error: list[float | None]) -> None:
    """The Pareto front as steps: what can be had by a time."""
    time = [m.points[i].time for i in m.front]
    if time:
        axes.step(
            time,
            [error[i] for i in m.front],
            where="post",
            color="#f2c14e",
            lw=6,
            alpha=0.55,
            solid_capstyle="round",
            solid_joinstyle="round",
            label="Pareto front",
            zorder=1,
        )


def _line(
    axes: Any, report: Report, m: Measured, error: list[float | None], name: str, k: int
) -> None:
    """The k-th line with its labels and its order; failed runs as crosses at the top."""
    from matplotlib.patheffects import withStroke

    halo = [withStroke(linewidth=2.5, foreground="white")]
    colour, marker = COLOURS[k % len(COLOURS)], MARKERS[k % len(MARKERS)]
    above = k % 2 == 0  # so that the labels of two lines side by side can be read
    own = [i for i, r in enumerate(report.runs) if r.line == name]
    good = [i for i in own if error[i] is not None and m.points[i].time is not None]
    style.curve(axes, [m.points[i].time for i in good], [error[i] for i in good], k, name)
    for i in good:
        hollow = not m.points[i].trusted
        if hollow:
            axes.plot(m.points[i].time, error[i], marker, mfc="white", mec=colour, ms=6, zorder=4)
        axes.annotate(
            m.points[i].label,
            (m.points[i].time, error[i]),
            xytext=(5, 5 if above else -10),
            textcoords="offset points",
            fontsize=7,
            color=colour,
            path_effects=halo,
            zorder=2,
        )
    exponent = m.exponents[name]
    if good and exponent is not None and abs(exponent) >= FLAT:
        letter = "h" if report.runs[own[0]].key == "mesh.size" else "x"
        middle = good[len(good) // 2]
        axes.annotate(
            rf"$\sim {letter}^{{{exponent:.1f}}}$",
            (m.points[middle].time, error[middle]),
            xytext=(-8, -14) if above else (8, 6),
            textcoords="offset points",
            ha="right" if above else "left",
            fontsize=10,
            color=colour,
            path_effects=halo,
            zorder=2,
        )
    failed = [r.result for r in (report.runs[i] for i in own) if r.result.exit_code]
    style.crosses(axes, [max(result.seconds, 1e-2) for result in failed], k, 0.97)


def _limits(axes: Any, report: Report, m: Measured, error: list[float | None]) -> None:
    """At least a decade of error, with room for labels and crosses."""
    known = [e for e in error if e is not None] or [report.target]
    low, high = min(*known, report.target), max(*known, report.target)
    axes.set_ylim(low / 2.5, max(high, 10 * low) * 3)
    times = [r.time or r.result.seconds for r in report.runs]
    axes.set_xlim(max(min(times), 1e-2) / 1.6, max(times) * 2.2)
