"""A table as a picture: a row for each group, a dot for each member on a logarithmic axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes

from app.plots import figures

# Height of a row over which its dots are spread.
SPREAD_OF_DOTS = 0.7
# Font size of names of rows and entries of the legend.
FONT_SIZE_OF_ROWS = 8
# Font size of the names of dots.
FONT_SIZE_OF_DOTS = 7


@dataclass(frozen=True)
class Kind:
    """A kind of dots: its name in the legend, its colour and its marker."""

    name: str
    colour: str
    marker: str


@dataclass(frozen=True)
class Dot:
    """A member of a row: its value, its kind, and its name if that is written."""

    value: float
    kind: Kind
    name: str = ""


def dots(
    axes: Axes, rows: Mapping[str, Sequence[Dot]], limits: tuple[float, float], bound: float
) -> None:
    """Draw the dots of rows, by the names of the rows.

    Args:
        axes: Axes to draw in.
        rows: Dots of each row.
        limits: Values beyond which a dot stands at the margin.
        bound: Value of a line through all rows.
    """
    lowest, highest = limits
    counts: dict[Kind, int] = {}
    for k, row_dots in enumerate(rows.values()):
        for i, dot in enumerate(row_dots):
            x = min(max(dot.value, lowest), highest)
            y = k + SPREAD_OF_DOTS * ((i + 0.5) / len(row_dots) - 0.5)
            axes.plot(x, y, dot.kind.marker, color=dot.kind.colour, markersize=4.5, alpha=0.8)
            counts[dot.kind] = counts.get(dot.kind, 0) + 1
            if dot.name:
                axes.annotate(
                    f"{dot.name} ", (x, y), ha="right", va="center", fontsize=FONT_SIZE_OF_DOTS
                )
    axes.axvline(bound, color="0.27", linewidth=1)
    axes.set(xscale="log", xlim=(lowest / 1.5, 1.7 * highest), ylim=(len(rows) - 0.4, -0.6))
    axes.set_yticks(range(len(rows)), list(rows), fontsize=FONT_SIZE_OF_ROWS)
    for kind, count in counts.items():
        label = f"{kind.name} ({count})"
        axes.plot([], [], kind.marker, color=kind.colour, label=label)
    axes.legend(
        fontsize=FONT_SIZE_OF_ROWS,
        frameon=False,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=max(1, len(counts)),
    )
    figures.grid(axes)
