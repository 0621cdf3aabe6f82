"""``mantle report``: figures, maps and tables of a sweep, as one page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from app.campaigns import uncertainty
from app.foundation.errors import StoppedError
from app.report import gruen, page, pictures, sweep_figures
from app.report.page import Blocks, bullets, table
from app.report.sentence import spread
from app.report.sweep_results import STATUSES, SweepResults, SweptCase, by_part, read
from app.report.viewer import viewer
from app.system.folders import remove, write_text
from app.system.layout import duration, noted

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
    chosen = pictures.ends(sweep)
    drawings = folder / PICTURES
    try:
        drawings.mkdir(exist_ok=True)
        remove(old for pattern in OURS for old in drawings.glob(pattern))
        curves, drawn = sweep_figures.multiples(sweep.cases, drawings)
        mapped, unmapped = pictures.maps(chosen, drawings)
        shields = gruen.shielding_picture(dict(chosen), gruen.intact(sweep.cases), drawings)
        sections = [
            ("varied", "What varies", curves),
            ("sensitive", "What matters most", table(*sweep_figures.sensitivity(sweep.cases))),
            ("uncertain", "What is not known well", _uncertain(sweep)),
            ("cases", "All cases", _parts(sweep)),
            ("notes", "Notes of the runs", bullets(noted((c.name, c.notes) for c in sweep.cases))),
            ("maps", "Maps of the interfaces", page.figures(mapped, drawings) + bullets(unmapped)),
            ("gruen", "Gruen zones", page.figures(shields, drawings) + gruen.blocks(chosen)),
            ("mantle", "Mantles", table(*gruen.mantles(sweep.cases))),
        ]
        head = {"facts": _facts(sweep), "lead": _lead(sweep.cases), "summary": _summary(sweep)}
        head["view"] = viewer({name: case.folder for name, case in chosen[:2]})
        write_text(folder / PAGE, page.page(sweep.title, sections, **head))
    except OSError as error:
        text = f"cannot write {error.filename or f'the report in {folder}'}: {error.strerror}"
        raise StoppedError(text) from error
    figures = page.files((*mapped, *shields), drawings)
    return [folder / PAGE, *figures, *drawn], sweep.cases


def _uncertain(sweep: SweepResults) -> Blocks:
    """Spread of numbers over samples of uncertain inputs."""
    parts: Blocks = []
    for part, of in sweep.uncertainty.items():
        words = f"{of['samples']} samples{f' ({part})' if part else ''}"
        parts += page.titled(words, table(uncertainty.HEAD, uncertainty.rows(of)))
    return parts


def _facts(sweep: SweepResults) -> str:
    took = f"{duration(sweep.seconds)} on {sweep.cores} core{'s' * (sweep.cores > 1)}"
    facts = (sweep.file, took if sweep.seconds else "", f"mantle {sweep.program[:18]}")
    return " · ".join(filter(None, facts))


def _summary(sweep: SweepResults) -> list[str]:
    """Summary at the top of the page: varied keys, failures, warnings."""
    counts = Counter(c.status for c in sweep.cases)
    states = ", ".join(f"{counts[s]} {s}" for s in STATUSES if counts[s])
    lines = [f"{len(sweep.cases)} cases: {states}.", *sweep_figures.axes_in_words(sweep.cases)]
    failed = [c.name for c in sweep.cases if not c.done]
    if failed:
        lines.append(f"Without results: {', '.join(failed)}. Why stands in the table of all cases.")
    warned = sum(bool(c.notes) for c in sweep.cases)
    if warned:
        lines.append(f"Notes were made of {warned} cases; they stand below the table of all cases.")
    return lines


def _lead(cases: Sequence[SweptCase]) -> str:
    """Range of the main numbers over all cases, and what the first depends on most."""
    found = [spread(cases, sweep_figures.headlines(cases), "cases")]
    for words, (most, *_) in sweep_figures.sensitivity(cases)[1][:1]:
        rank, _, key = most.partition(" ")
        found.append(f"By rank correlation ({rank}) {words} depends most on {key}.")
    return " ".join(found)


def _parts(sweep: SweepResults) -> Blocks:
    found: Blocks = []
    for part, own in by_part(sweep.cases).items():
        names = sweep_figures.headlines(own)
        found += page.titled(part, sweep_figures.cases_table(own, names, sweep.folder))
    return found
