"""Maps of a few cases of a sweep: gap, slip, pressure and temperature on unrolled interfaces."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from app.arrays import Floats
from app.case.case import read_geometry
from app.case.geometries import Geometry
from app.errors import MantleError
from app.report.curves import Figure
from app.report.sweep_results import QUANTITIES, WORDS, SweepResults, SweptCase
from app.results import unrolled
from app.results.reading import Run
from app.results.unrolled import MapRow, Sheet

log = logging.getLogger("mantle")

Chosen = list[tuple[str, SweptCase]]

SHOWN = {"gap": "YlGnBu", "slip": "YlGnBu", "motion": "YlGnBu", "pressure": "YlOrRd"}


def ends(sweep: SweepResults) -> list[Chosen]:
    """The first and the last case with fields, as one group to draw."""
    done = [c for c in sweep.cases if c.done and (c.folder / "fields.vtkhdf").exists()]
    return [[(c.name, c) for c in done[:1] + done[1:][-1:]]] if done else []


def draw(groups: Sequence[Chosen], folder: Path) -> tuple[list[Figure], list[str]]:
    """Draw the maps of each group, a picture for each interface.

    Returns:
        The figures, and why there is none of some case.
    """
    figures: list[Figure] = []
    missing: list[str] = []
    for number, group in enumerate(groups, 1):
        opened = []
        for title, case in group:
            if not (case.folder / "fields.vtkhdf").exists():
                missing.append(f"no map of {case.name}: it wrote no fields")
                continue
            try:
                opened.append((title, case, Run(case.folder), _geometry(case)))
            except (OSError, KeyError, ValueError, MantleError) as error:
                missing.append(f"no map of {case.name}: {_first_line(error)}")
        names = dict.fromkeys(name for _, _, _, g in opened for name in g.interface_sides)
        for name in names:
            columns = [
                (title, run, sheet)
                for title, _, run, g in opened
                if name in g.interface_sides
                and (sheet := unrolled.sheet(run, g.kind, g.interface_sides[name], g.region_names))
            ]
            if not columns:
                missing.append(f"no map of {name}: it neither surrounds a stem nor is flat")
                continue
            file = f"map{number}_{name}.png"
            labels = unrolled.draw(folder / file, columns, _rows(name, columns))
            if labels:
                figures.append(_figure(file, name, columns, labels))
    return figures, missing


def _geometry(case: SweptCase) -> Geometry:
    geometry = read_geometry(case.data, case.folder)
    if geometry is None:
        raise ValueError("its case.yaml has no geometry")
    return geometry


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def _rows(name: str, columns: Sequence[tuple[str, Run, Sheet]]) -> list[MapRow]:
    rows = []
    for quantity, colours in SHOWN.items():
        unit, factor = QUANTITIES[quantity]
        rows.append(
            MapRow(f"{WORDS[quantity]} ({unit})", colours, _contact(name, quantity, factor))
        )
    sheets = {id(run): own for _, run, own in columns}
    hottest = MapRow(
        "temperature (°C)", "inferno", lambda run: _hottest(run, sheets[id(run)]), False
    )
    return [*rows, hottest]


def _contact(name: str, quantity: str, factor: float) -> Callable[[Run], Floats | None]:
    def values(run: Run) -> Floats | None:
        if name not in run.contacts:
            return None
        found = run.at_interface(name, quantity)
        return factor * (np.linalg.norm(found, axis=1) if found.ndim == 2 else found)

    return values


def _hottest(run: Run, own: Sheet) -> Floats | None:
    """The temperature at the written step at which the interface is hottest."""
    if not run.hot:
        return None
    steps = [run.temperature(k) for k in range(len(run.times))]
    return max(steps, key=lambda T: float(np.max(T[own.nodes])))


def _figure(
    file: str, name: str, columns: Sequence[tuple[str, Run, Sheet]], labels: Sequence[str]
) -> Figure:
    what = WORDS.get(name, name.replace("_", "-"))
    titles = [title for title, _, _ in columns if title]
    common = "are common to all cases and " if len(columns) > 1 else ""
    caption = f"The colours of a row {common}end at the 99.5th percentile. "
    if all(s.round for _, _, s in columns):
        caption += (
            "Unrolled about the stem's axis, cut open posteriorly; end faces are left out, grey is "
            "beyond the resection."
        )
    if any(label.startswith("temperature") for label in labels):
        caption += " Temperature: of the second body, at the hottest step that was written."
    place = f"{what} interface"
    of, to = (f"{word}{'; '.join(titles)}" if titles else "" for word in (" of ", ": "))
    return Figure(file, place + to, caption, f"{', '.join(labels)} on the {place}{of}")
