"""``mantle report``: figures, maps, tables and a verdict on a sweep, as one page."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from app.campaigns import uncertainty
from app.case.quantities import printed
from app.errors import StoppedError
from app.report import gruen, page, paper, paper_claims, paper_numbers, pictures, sweep_figures
from app.report.page import Blocks, bullets, table
from app.report.paper_claims import Trend
from app.report.paper_numbers import ComparedNumber
from app.report.sentence import spread
from app.report.sweep_results import STATUSES, SweepResults, SweptCase, by_part, named, read
from app.report.viewer import viewer
from app.system.folders import remove, write_text
from app.system.layout import duration, noted

PAGE, PAPER, PICTURES = "report.html", "paper.html", "report"
# Files that an earlier report may have left in the folder of pictures.
OURS = ("figure[3-8].*", "over_*.*", "map[0-9]_*.png", "shielding.png")


def run(folder: Path) -> tuple[list[Path], Sequence[Trend], Sequence[SweptCase]]:
    """Write the report of a sweep; its files, verdicts on the paper's trends, and its cases.

    Raises:
        InputError: The folder is not that of a sweep.
        StoppedError: The report cannot be written.
    """
    sweep = read(folder)
    cases = paper.Cases(sweep)
    groups = cases.representative() or pictures.ends(sweep)
    chosen = [pair for group in groups for pair in group]
    drawings = folder / PICTURES
    try:
        drawings.mkdir(exist_ok=True)
        remove(old for pattern in OURS for old in drawings.glob(pattern))
        curves, drawn = sweep_figures.multiples(sweep.cases, drawings)
        mapped, unmapped = pictures.maps(groups, drawings)
        shown = cases.over("stem") or dict(chosen)
        shields = gruen.shielding_picture(shown, gruen.intact(sweep.cases), drawings)
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
        papers, trends = _paper(cases, sweep, drawings) if cases else ([], [])
        summary = _summary(sweep)
        if papers:
            summary.append(f"The paper's figures, numbers and trends are beside it, in {PAPER}.")
        head = {"facts": _facts(sweep), "lead": _lead(sweep.cases), "summary": summary}
        head["view"] = viewer({name: case.folder for name, case in chosen[:2]})
        write_text(folder / PAGE, page.page(sweep.title, sections, **head))
    except OSError as error:
        raise StoppedError(f"cannot write the report in {folder}: {error.strerror}") from error
    figures = (drawings / f.name for f in (*mapped, *shields))
    return [folder / PAGE, *papers, *figures, *drawn], trends, sweep.cases


def _paper(
    cases: paper.Cases, sweep: SweepResults, folder: Path
) -> tuple[list[Path], Sequence[Trend]]:
    """Write the page that compares the sweep with the paper; return its files and verdicts."""
    figures, missing = paper_numbers.figures(cases, folder)
    rows = paper_numbers.compare(cases)
    trends = paper_claims.judge(cases)
    compared = {"rows": rows, "named": named, "printed": printed}
    sections = [
        ("trends", "Trends", [("trends", {"trends": trends})]),
        ("paper", "The paper's figures", page.figures(figures, folder) + bullets(missing)),
        ("comparison", "Number by number", [("comparison", compared)]),
    ]
    names = {v: [t.name for t in trends if t.verdict == v] for v in paper_claims.VERDICTS}
    each = "; ".join(f"{len(own)} {v}: {', '.join(own)}" for v, own in names.items() if own)
    summary = [f"Trends that the paper reports: {each}.", *_ratios(rows)]
    title = f"{sweep.title}: the paper beside it"
    text = page.page(title, sections, facts=_facts(sweep), summary=summary)
    files = [sweep.folder / PAPER, *(folder / f.name for f in figures)]
    write_text(files[0], text)
    return files, trends


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
    if warned := sum(bool(c.notes) for c in sweep.cases):
        lines.append(f"Notes were made of {warned} cases; they stand below the table of all cases.")
    return lines


def _ratios(rows: Sequence[ComparedNumber]) -> list[str]:
    """Ratios of mantle's numbers to the paper's, over all peaks of the stance."""
    of_stance = [r for r in rows if r.fact.kind == "peak" and r.fact.model == "stance"]
    found = [r.ratios for r in of_stance if not r.quantity]
    peaks = [p for p, _ in found if p is not None]
    settled = [q for _, q in found if q is not None]
    if not peaks or not settled:
        return []
    near = sum(0.5 <= p <= 2.0 for p in peaks)
    return [
        f"Over {len(peaks)} peaks of single-limb stance, mantle's largest value is "
        f"{statistics.median(peaks):.2g} times the paper's in the median (from {min(peaks):.2g} to "
        f"{max(peaks):.2g}; {near} within a factor of 2), its percentile "
        f"{statistics.median(settled):.2g} times."
    ]


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
