"""Page of a fit: fitted keys, targets or constraints, verdicts, and the path of the search."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from app.campaigns import fit_results
from app.campaigns.fit_results import FitRecord, FitRow
from app.case import number_text, quantities
from app.case.points import Range, short_keys
from app.foundation.layout import duration, several, two_digits
from app.foundation.verdict import Severity, recorded, texts_of
from app.plots import curves, figures
from app.plots.curves import Line
from app.plots.figures import PNG
from app.report import page
from app.report.page import Cell, Figure, LargeNumber, Link, PageSection, bullets, folded, table
from app.system.folders import read_json, reading, write_text, writing

# Content, page and picture in the folder of a fit.
RECORD = "fit.json"
PAGE = "report.html"
PICTURE = "fit.png"
# Directions of a drawn ellipse.
DIRECTIONS = 120
# 95th percentile of chi-square with two degrees of freedom.
CHI_SQUARE = 5.991
# Most large numbers of a page.
MOST_LARGE = 3
# Misfit below which a fit is exact; drawn in its place.
LEAST_MISFIT = 1e-3


def write(folder: Path) -> Path:
    """Write the page of a fit; return the file.

    Raises:
        InputError: ``fit.json`` cannot be read.
        StoppedError: The page cannot be written.
    """
    path = folder / RECORD
    with reading(path):
        record: FitRecord = read_json(path)
        sections = _sections(record)
    with writing(folder):
        _draw(record, folder / PICTURE)
        figure = Figure(PICTURE, "Steps and result", _caption(record), "Path of the search")
        picture = PageSection("path", "Path of the search", page.figures([figure], folder))
        verdicts = recorded(record)
        html = page.page(
            record["title"],
            [*sections[:1], picture, *sections[1:]],
            bullets([_end(record), *(verdict.text for verdict in verdicts)]),
            facts=_facts(record),
            lead=_lead(record),
            large=_large(record),
        )
        write_text(folder / PAGE, html)
    return folder / PAGE


def _sections(record: FitRecord) -> list[PageSection]:
    """Sections with tables."""
    head, rows = fit_results.run_rows(record)
    pages = [run["folder"] and f"{run['folder']}/{PAGE}" for run in record["runs"]]
    linked: list[list[Cell]] = []
    for (name, *cells), address in zip(rows, pages, strict=True):
        linked.append([Link(name, address) if address else name, *cells])
    numbers = "Targets" if record["aim"] == "targets" else "Numbers"
    return [
        PageSection("keys", "Fitted keys", table(*fit_results.key_rows(record))),
        PageSection("numbers", numbers, table(*fit_results.number_rows(record))),
        PageSection(
            "influence",
            "Change of the numbers over the range of each key",
            table(*_influence(record)),
        ),
        PageSection("correlation", "Correlation", table(*fit_results.correlation_rows(record))),
        PageSection("runs", "All runs", folded(several(len(rows), "run"), table(head, linked))),
        PageSection("repeat", "To repeat the best run", bullets([record["command"]])),
    ]


def _influence(record: FitRecord) -> tuple[list[str], list[list[str]]]:
    """Head and rows: change of each number over the range of each key, in its printed unit."""
    short_names = short_keys(list(record["keys"]))
    rows = []
    for name, row in record["numbers"].items():
        q = quantities.quantity_or_fail(name)
        cells = []
        for key in record["keys"]:
            change = row["derivatives"].get(key)
            cells.append("-" if change is None else f"{q.factor * change:+.3g}")
        if any(cell != "-" for cell in cells):
            rows.append([quantities.label_with_unit(name), *cells])
    return ["number", *short_names.values()], rows


def _facts(record: FitRecord) -> str:
    seconds = sum(run["seconds"] for run in record["runs"])
    took = f"{len(record['runs'])} runs, {duration(seconds)} in all"
    return " · ".join((record["file"], took, f"mantle {record['program'][:18]}"))


def _end(record: FitRecord) -> str:
    """Return the end of the search in a sentence."""
    number = len(record["runs"])
    if not record["converged"]:
        return f"not converged after {number} runs"
    if record["misfit"] is None:
        return f"converged after {number} runs"
    misfit_text = f"misfit {record['misfit']:.3g} of {len(record['numbers'])} targets"
    return f"converged after {number} runs: {misfit_text}"


def _lead(record: FitRecord) -> str:
    """Return the result in a sentence."""
    if texts_of(recorded(record), Severity.ERROR):
        return "Do not use these values; the first lines below give the reason."
    if record["aim"] == "targets":
        largest = max(abs(row["deviation"]) for row in record["numbers"].values())
        return f"The keys reach all targets within {largest:.1f} of their uncertainties."
    extreme = "smallest" if record["aim"] == "minimise" else "largest"
    return f"{record['objective']} is the {extreme} of all runs that meet the constraints."


def _large(record: FitRecord) -> list[LargeNumber]:
    """Fitted keys as large numbers."""
    large = []
    short_names = short_keys(list(record["keys"]))
    for key, row in [*record["keys"].items()][:MOST_LARGE]:
        error = ""
        if row["uncertainty"] is not None:
            error = f"± {two_digits(row['uncertainty'])}"
        elif record["aim"] == "targets":
            error = "not determined"
        caption = short_names[key].replace("_", " ")
        large.append(LargeNumber(f"{row['number']:.4g}", row["unit"], caption, error, key))
    return large


def _caption(record: FitRecord) -> str:
    if record["aim"] != "targets":
        return "Crosses are failed runs; the star is the best run that meets the constraints."
    return (
        "Misfit: sum of the squares of the deviations over the uncertainties of the targets. "
        "Crosses are failed runs, the star is the result. The dashed ellipse holds 95 % of the "
        "probability of the keys."
    )


def _draw(record: FitRecord, path: Path) -> None:
    """Draw misfit or objective over the runs, keys over the runs, and two keys over each other."""
    keys = [*record["keys"]]
    figure, all_axes = figures.figure_of_panels(2 + (len(keys) > 1), 3, 4.6, 3.7)
    _draw_aim(all_axes[0], record)
    _draw_keys(all_axes[1], record)
    if len(keys) > 1:
        _draw_plane(all_axes[2], record)
    figures.legend_below(figure, 5, last=curves.FAILED_ENTRY)
    figures.save_figure(figure, path, curves.DPI, PNG)


def _steps(record: FitRecord) -> list[tuple[int, FitRow]]:
    """Steps of the search with their number; runs for derivatives are left out."""
    return [
        (i, run)
        for i, run in enumerate(record["runs"], start=1)
        if "," not in run["name"] or run["name"] == record["best"]
    ]


def _draw_aim(axes: Axes, record: FitRecord) -> None:
    """Draw the misfit or the objective over the number of the run."""
    figures.grid(axes)
    axes.set_xlabel("run")
    value_of_run = {}
    if record["aim"] == "targets":
        figures.set_title(axes, "Misfit")
        value_of_run = {i: r["misfit"] for i, r in _steps(record) if r["misfit"] is not None}
        axes.set_yscale("log")
        value_of_run = {i: max(value, LEAST_MISFIT) for i, value in value_of_run.items()}
    else:
        objective = record["objective"]
        figures.set_title(axes, _title(record, objective))
        for i, run in _steps(record):
            value = _value(record, run, objective)
            if value is not None:
                value_of_run[i] = value
    curves.draw_line(axes, Line("steps", 5, [*value_of_run], [*value_of_run.values()]))
    for i, run in enumerate(record["runs"], start=1):
        if run["name"] == record["best"] and i in value_of_run:
            curves.draw_line(axes, Line("result", 4, [i], [value_of_run[i]], look="stars"))
    failed_runs = [i for i, run in enumerate(record["runs"], start=1) if run["exit_code"]]
    curves.crosses(axes, failed_runs, 1, 0.97)


def _value(record: FitRecord, run: FitRow, name: str) -> float | None:
    """Number of a run in its printed unit, or the value of a key; None if the run failed."""
    if name in record["keys"]:
        fraction = run["shares"][[*record["keys"]].index(name)]
        return None if run["exit_code"] else _of_share(record, name, fraction)
    value = run["numbers"].get(name)
    return None if value is None else quantities.quantity_or_fail(name).factor * value


def _of_share(record: FitRecord, key: str, fraction: float) -> float:
    """Value of a key at a fraction of its range, as drawn."""
    row = record["keys"][key]
    return Range(low=row["low"], high=row["high"], scale=row["scale"]).number(fraction)


def _title(record: FitRecord, name: str) -> str:
    """Label of a number or a key with its unit."""
    if name not in record["keys"]:
        return quantities.label_with_unit(name)
    unit = record["keys"][name]["unit"]
    key_title = short_keys(list(record["keys"]))[name].replace("_", " ")
    return number_text.with_brackets(key_title, unit)


def _draw_keys(axes: Axes, record: FitRecord) -> None:
    """Draw the keys as fractions of their ranges over the number of the run."""
    figures.set_title(axes, "Keys, as fractions of their ranges")
    figures.grid(axes)
    axes.set(xlabel="run", ylim=(-0.05, 1.05))
    steps = _steps(record)
    numbers = [i for i, _ in steps]
    for k, key_name in enumerate(short_keys(list(record["keys"])).values()):
        fractions = [run["shares"][k] for _, run in steps]
        curves.draw_line(axes, Line(key_name.replace("_", " "), k, numbers, fractions))


def _draw_plane(axes: Axes, record: FitRecord) -> None:
    """Draw the steps in the plane of the first two keys, with the ellipse of 95 %."""
    first_key, second_key = [*record["keys"]][:2]
    figures.set_title(axes, "Path in the plane of two keys")
    figures.grid(axes)
    axes.set(xlabel=_title(record, first_key), ylabel=_title(record, second_key))

    def places(fraction_pairs: Sequence[Sequence[float]]) -> tuple[list[float], list[float]]:
        x = [_of_share(record, first_key, fraction_pair[0]) for fraction_pair in fraction_pairs]
        y = [_of_share(record, second_key, fraction_pair[1]) for fraction_pair in fraction_pairs]
        return x, y

    x, y = places([run["shares"] for _, run in _steps(record)])
    curves.draw_line(axes, Line("steps", 5, x, y))
    best_run = next(run for run in record["runs"] if run["name"] == record["best"])
    x, y = places([best_run["shares"]])
    curves.draw_line(axes, Line("result", 4, x, y, look="stars"))
    failed_fractions = [run["shares"] for run in record["runs"] if run["exit_code"]]
    if failed_fractions:
        axes.plot(*places(failed_fractions), "x", color=figures.colour(1), ms=8.5, mew=2.1)
    have_uncertainties = all(
        record["keys"][key]["uncertainty"] is not None for key in (first_key, second_key)
    )
    if record["covariance"] and have_uncertainties:
        covariance = np.array(record["covariance"])[:2, :2]
        angles = np.linspace(0.0, 2.0 * math.pi, DIRECTIONS)
        circle = math.sqrt(CHI_SQUARE) * np.array([np.cos(angles), np.sin(angles)])
        ellipse = np.array(best_run["shares"][:2]) + (np.linalg.cholesky(covariance) @ circle).T
        clipped_ellipse = [[float(v) for v in place] for place in np.clip(ellipse, 0.0, 1.0)]
        axes.plot(*places(clipped_ellipse), color="0.3", lw=1, ls=(0, (5, 3)), label="95 %")
