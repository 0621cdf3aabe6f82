"""``mantle report``: figures, maps and tables of a sweep, as one page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from app.campaigns import uncertainty
from app.foundation.layout import duration, noted
from app.report import gruen, lead, page, pictures, sweep_figures, sweep_tables
from app.report.page import Block, PageSection, bullets, table
from app.report.sweep_results import STATUSES, SweepResults, SweptCase, by_part, headlines, read
from app.report.viewer import viewer
from app.system.folders import remove, write_text, writing

# Name of the page in the folder of a sweep.
PAGE = "report.html"
# Folder of the pictures.
PICTURES = "report"
# Files that an earlier report may have left in the folder of pictures.
OURS = ("over_*.*", "map_*.*", "shielding.*")


def run(folder: Path) -> tuple[list[Path], Sequence[SweptCase]]:
    """Write the report of a sweep; its files and its cases.

    Raises:
        InputError: The folder is not that of a sweep.
        StoppedError: The report cannot be written.
    """
    sweep = read(folder)
    chosen_cases = pictures.ends(sweep)
    drawings = folder / PICTURES
    with writing(folder):
        drawings.mkdir(exist_ok=True)
        remove(old_file for pattern in OURS for old_file in drawings.glob(pattern))
        curves, curve_files = sweep_figures.draw_over_keys(sweep.on_axes, drawings)
        mapped, unmapped = pictures.maps(chosen_cases, drawings)
        shields = gruen.shielding_picture(dict(chosen_cases), gruen.intact(sweep.cases), drawings)
        notes = noted((c.name, c.notes) for c in sweep.cases)
        sections = [
            PageSection("varied", "Curves over the varied keys", curves),
            PageSection(
                "sensitive",
                "Strongest dependencies",
                table(*sweep_tables.sensitivity(sweep.cases)),
            ),
            PageSection("uncertain", "Effect of uncertain inputs", _uncertain(sweep)),
            PageSection("cases", "All cases", _parts(sweep)),
            PageSection("notes", "Notes of the runs", bullets(notes)),
            PageSection(
                "maps",
                "Maps of the interfaces",
                page.figures(mapped, drawings) + bullets(unmapped),
            ),
            PageSection(
                "gruen", "Gruen zones", page.figures(shields, drawings) + gruen.blocks(chosen_cases)
            ),
            PageSection("mantle", "Cement mantles", table(*gruen.mantles(sweep.cases))),
        ]
        html = page.page(
            sweep.title,
            sections,
            bullets(_summary(sweep)),
            facts=_facts(sweep),
            lead=_dependence(sweep.cases),
            large=lead.ranges_over_runs(sweep.cases, headlines(sweep.cases)),
            view=viewer({name: case.folder for name, case in chosen_cases[:2]}),
        )
        write_text(folder / PAGE, html)
    figures = page.files((*mapped, *shields), drawings)
    return [folder / PAGE, *figures, *curve_files], sweep.cases


def _uncertain(sweep: SweepResults) -> list[Block]:
    """Return tables of the spread of numbers over samples of uncertain inputs."""
    blocks: list[Block] = []
    for part, samples in sweep.uncertainty.items():
        samples_title = f"{samples['samples']} samples{f' ({part})' if part else ''}"
        blocks += page.titled(
            samples_title, table(uncertainty.HEAD_OF_SPREAD, uncertainty.rows_of_spread(samples))
        )
        indices = table(uncertainty.INDEX_HEAD, uncertainty.index_rows(samples))
        blocks += page.titled("Sobol' indices: shares of the variance", indices)
    return blocks


def _facts(sweep: SweepResults) -> str:
    took = f"{duration(sweep.seconds)} on {sweep.cores} core{'s' * (sweep.cores > 1)}"
    facts = (sweep.file, took if sweep.seconds else "", f"mantle {sweep.program[:18]}")
    return " · ".join(filter(None, facts))


def _summary(sweep: SweepResults) -> list[str]:
    """Texts at the top of the page: varied keys, failures, warnings."""
    counts = Counter(c.status for c in sweep.cases)
    states = ", ".join(f"{counts[s]} {s}" for s in STATUSES if counts[s])
    lines = [f"{len(sweep.cases)} cases: {states}.", *sweep_tables.axes_in_words(sweep.cases)]
    failed_cases = [c.name for c in sweep.cases if not c.done]
    if failed_cases:
        lines.append(
            f"Without results: {', '.join(failed_cases)}. The table of all cases has the messages."
        )
    cases_with_notes = sum(bool(c.notes) for c in sweep.cases)
    if cases_with_notes:
        lines.append(
            f"{cases_with_notes} of {len(sweep.cases)} cases have notes: see below the table of"
            " all cases."
        )
    return lines


def _dependence(cases: Sequence[SweptCase]) -> str:
    """Return the key that the first main number depends on most, in a sentence."""
    for number_title, (strongest_text, *_) in sweep_tables.sensitivity(cases)[1][:1]:
        rank, _, key = strongest_text.partition(" ")
        return f"{number_title} depends most on {key} (rank correlation {rank})."
    return ""


def _parts(sweep: SweepResults) -> list[Block]:
    """Return the table of cases of each part."""
    tables: list[Block] = []
    for part, cases in by_part(sweep.cases).items():
        names = headlines(cases)
        tables += page.titled(part, sweep_tables.cases_table(cases, names, sweep.folder))
    return tables
