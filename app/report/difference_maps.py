"""Maps of the differences of interfaces between runs, on the surface of the first run.

Meshes and bones may differ. An interface of the first run is drawn in the plane: unrolled about the
stem's axis, or as it is if flat. The values of another run are interpolated at the same angle and
height, or at the same place of the plane. Where the other run has no interface, nothing is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from pathlib import Path

import numpy as np

from app.case.number_text import printed
from app.foundation.arrays import Floats
from app.plots import figures
from app.plots.maps import Interpolation
from app.report import pictures
from app.report.page import Figure
from app.report.pictures import Sheet
from app.report.sweep_results import QUANTITY_LABELS, SweptCase, named
from app.report.viewer import interface_fields, lengths
from app.results.reading import Run


def draw(runs: Sequence[tuple[str, SweptCase]], folder: Path) -> tuple[list[Figure], list[str]]:
    """Draw a picture for each interface that the first run has in common with others.

    Args:
        runs: Names and runs, the first one first.
        folder: Folder of the pictures.

    Returns:
        The pictures, and for each interface without one the reason in a sentence.
    """
    (first_title, _), *others = runs
    sheets = [_sheets(case) for _, case in runs]
    figures_drawn = []
    reasons = []
    for name in dict.fromkeys(chain.from_iterable(sheets)):
        first_sheet = sheets[0].get(name)
        columns = []
        for (title, _), by_name in zip(others, sheets[1:], strict=True):
            other_sheet = by_name.get(name)
            if first_sheet and other_sheet and first_sheet[1].round == other_sheet[1].round:
                columns.append((f"{title} − {first_title}", first_sheet, other_sheet))
        if not columns:
            reasons.append(f"no map of the difference of {name}: not the same surface in two runs")
            continue
        figure = _picture(name, columns, folder)
        if figure:
            figures_drawn.append(figure)
    return figures_drawn, reasons


def _sheets(case: SweptCase) -> dict[str, tuple[Run, Sheet]]:
    """Interfaces of a run that are unrolled or flat; none if the run cannot be read."""
    try:
        sheets = pictures.sheets(case)
    except pictures.UNREADABLE:
        return {}
    return {
        name: run_and_sheet
        for name, run_and_sheet in sheets.items()
        if run_and_sheet and not run_and_sheet[1].cup
    }


def _picture(
    name: str,
    columns: Sequence[tuple[str, tuple[Run, Sheet], tuple[Run, Sheet]]],
    folder: Path,
) -> Figure | None:
    """Draw the differences of an interface; None if no quantity is in two runs."""
    rows: list[pictures.Row] = []
    differences = [
        _differences(first_sheet, other_sheet, name) for _, first_sheet, other_sheet in columns
    ]
    for quantity in pictures.SHOWN:
        label, unit, _ = interface_fields()[quantity]
        values = [by_quantity.get(quantity) for by_quantity in differences]
        title = f"difference of {QUANTITY_LABELS.get(quantity, label)} ({printed(unit)})"
        rows.append((title, figures.SIGNED, values))
    file = f"difference_{name}.png"
    titled_sheets = [(title, *first_sheet) for title, first_sheet, _ in columns]
    labels = pictures.draw(folder / file, titled_sheets, rows, figures.PNG)
    if not labels:
        return None
    interface_title = f"{named(name)} interface"
    caption = (
        f"All maps of a row have the same colours, up to the {pictures.CLIP:g}th percentile. "
        "Blue is more than in the first run, red is less."
    )
    return Figure(file, interface_title, caption, f"{', '.join(labels)} on the {interface_title}")


def _differences(
    first_run: tuple[Run, Sheet], second_run: tuple[Run, Sheet], interface: str
) -> dict[str, Floats]:
    """Return the fields of the second run minus those of the first, by quantity.

    Quantities that only one run has are left out. The values are at the nodes of the first run
    (n,), in the unit of the field file, and nan outside the interface.
    """
    run, sheet = first_run
    other_run, other_sheet = second_run
    common = {*run.point_fields} & {*other_run.point_fields}
    fields = {
        quantity: f"{interface}_{quantity}"
        for quantity in pictures.SHOWN
        if f"{interface}_{quantity}" in common
    }
    if not fields:
        return {}
    factors = np.array([interface_fields()[quantity][2] for quantity in fields])
    first_values = factors * np.stack([lengths(run, field) for field in fields.values()], axis=1)
    values = factors * np.stack([lengths(other_run, field) for field in fields.values()], axis=1)
    interpolation = Interpolation(other_sheet.corners, values[other_sheet.nodes])
    on_both = interpolation.on_surface(sheet.corners)[..., None]
    differences = np.full_like(first_values, np.nan)
    differences[sheet.nodes] = (
        np.where(on_both, interpolation(sheet.corners), np.nan) - first_values[sheet.nodes]
    )
    return dict(zip(fields, differences.T, strict=True))
