"""Pictures of predictions beside measurements, both with their bands."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes

from app.plots import figures
from app.plots.figures import PNG
from app.validation import metrics
from app.validation.records import MeasuredQuantity, Prediction

# A quantity: its name, its prediction and its measurement.
Pair = tuple[str, Prediction, MeasuredQuantity | None]

# Colours of predictions and of measurements, by number.
PREDICTED = 0
MEASURED = 1
# Font size of names of quantities.
FONT_SIZE_OF_QUANTITIES = 8
# Least end of a band over its value, on logarithmic axes.
LEAST_END_RATIO = 1 / 30
# Fraction of the width of the axes beyond which a name stands to the left of its point.
NEAR_END = 0.85
# Height of a row [inch].
ROW = 0.42


def draw_all(pairs: Sequence[Pair], path: Path) -> None:
    """Draw predicted against measured values, on logarithmic axes.

    Values without a logarithm are left out, and counted. Bands end at `LEAST_END_RATIO` of the
    value.
    """
    figure = figures.new(6.8, 6.4)
    axes = figure.add_subplot()
    points: list[tuple[str, float, float]] = []
    left_out = 0
    for name, prediction, measured in pairs:
        if measured is None:
            continue
        lowest_predicted, highest_predicted = metrics.predicted_band(prediction)
        lowest_measured, highest_measured = metrics.measured_range(measured)
        if min(measured.middle, prediction.value) <= 0:
            left_out += 1
            continue
        lowest_predicted = max(lowest_predicted, LEAST_END_RATIO * prediction.value)
        lowest_measured = max(lowest_measured, LEAST_END_RATIO * measured.middle)
        colour = figures.colour(PREDICTED if metrics.inside(prediction, measured) else MEASURED)
        axes.plot(
            [lowest_measured, highest_measured], [prediction.value] * 2, color=colour, linewidth=1.2
        )
        axes.plot(
            [measured.middle] * 2,
            [lowest_predicted, highest_predicted],
            color=colour,
            linewidth=1.2,
        )
        axes.plot(measured.middle, prediction.value, "o", color=colour, markersize=5)
        points.append((name, measured.middle, prediction.value))
    axes.set(xscale="log", yscale="log")
    axes.set_xlabel("measured, with its range")
    axes.set_ylabel("predicted, 5th to 95th percentile of the inputs ± mesh")
    if points:
        limits = [*axes.get_xlim(), *axes.get_ylim()]
        diagonal = [min(limits), max(limits)]
        axes.plot(diagonal, diagonal, color="0.3", linewidth=0.8)
        axes.set(xlim=diagonal, ylim=diagonal)
    for name, x, y in points:
        # A name near the right end stands to the left of its point.
        is_near_end = (
            axes.transAxes.inverted().transform(axes.transData.transform((x, y)))[0] > NEAR_END
        )
        axes.annotate(
            f" {name} ",
            (x, y),
            fontsize=FONT_SIZE_OF_QUANTITIES - 1,
            va="bottom",
            ha="right" if is_near_end else "left",
        )
    title = f"{len(points)} quantities with a measurement; blue: inside, orange: outside"
    if left_out:
        title += f"; {left_out} not positive"
    figures.set_title(axes, title)
    figures.grid(axes)
    figures.save_figure(figure, path, 110, PNG)


def draw_one(title: str, pairs: Sequence[Pair], path: Path) -> None:
    """Draw the quantities of an experiment as rows, relative to the predicted values."""
    figure = figures.new(7.4, 1.3 + ROW * len(pairs))
    axes = figure.add_subplot()
    for row, (_, prediction, measured) in enumerate(pairs):
        _row(axes, row, prediction, measured)
    axes.axvline(1.0, color="0.3", linewidth=0.8)
    units = {"-": ""}
    values = [f"{p.value:.3g} {units.get(p.unit, p.unit)}".rstrip() for _, p, _ in pairs]
    row_labels = [f"{name}\n{value}" for (name, *_), value in zip(pairs, values, strict=True)]
    axes.set_yticks(range(len(pairs)), row_labels, fontsize=FONT_SIZE_OF_QUANTITIES)
    axes.set_ylim(len(pairs) - 0.4, -0.6)
    axes.set_xlabel("over the predicted value")
    legend_entries = [(PREDICTED, "predicted")]
    if any(measured for *_, measured in pairs):
        legend_entries.append((MEASURED, "measured"))
    for k, label in legend_entries:
        axes.plot([], [], "o-", color=figures.colour(k), label=label)
    axes.legend(
        fontsize=FONT_SIZE_OF_QUANTITIES,
        frameon=False,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=2,
    )
    axes.set_title(title, loc="right", fontsize=FONT_SIZE_OF_QUANTITIES)
    figures.grid(axes)
    figures.save_figure(figure, path, 110, PNG)


def _row(axes: Axes, row: int, prediction: Prediction, measured: MeasuredQuantity | None) -> None:
    """Draw the two bands of a quantity."""
    scale = prediction.value or 1.0
    bands = [(PREDICTED, -0.12, prediction.value, metrics.predicted_band(prediction))]
    if measured is not None:
        bands.append((MEASURED, 0.12, measured.middle, metrics.measured_range(measured)))
    for k, shift, middle, interval in bands:
        colour = figures.colour(k)
        axes.plot([end / scale for end in interval], [row + shift] * 2, color=colour, linewidth=3)
        axes.plot(middle / scale, row + shift, "o", color=colour, markersize=5)
