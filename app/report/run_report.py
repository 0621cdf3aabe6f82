"""``report.html`` of a run: main results first, then all numbers, curves and maps.

All content is read from the run directory, so the page can be made again later, on any machine.
"""

from __future__ import annotations

import json
import logging
import math
import re
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

from mpi4py import MPI

import matplotlib as mpl

import meshes
from app.case import quantities, summary_numbers
from app.case.case import Case, load_case
from app.case.number_text import in_print, printed, with_brackets
from app.case.quantities import TABLE
from app.case.summary import Numbers, Summary, name_of_implant
from app.foundation.collective import distribute_tasks, on_root
from app.foundation.layout import noted, plain_text
from app.foundation.verdict import Severity, recorded
from app.plots import curves, figures
from app.report import (
    case_picture,
    gruen,
    lead,
    page,
    path_curves,
    pictures,
    step_curves,
    sweep_figures,
    sweep_tables,
    viewer,
)
from app.report.input_spread import HEAD_OF_SPREAD, InputSpread, input_spread_of_run
from app.report.page import Block, Figure, PageSection, Verbatim, bullets, table
from app.report.sweep_results import CONVERGED, Json, SweptCase, headlines, named
from app.results import closing_lines as text
from app.results import cycles
from app.results.reading import Run
from app.results.verdicts import UNUSABLE
from app.system import folders
from app.system.folders import CASE_PICTURE, reading, write_text, writing
from app.system.ranks import rank

# Name of the page in the folder of a run.
PAGE = "report.html"
# Folder of the pictures as files.
PICTURES = "report"
# Largest time for the page, as a fraction of the run's time.
SHARE = 0.03
# Time of the maps of the interfaces [s].
MAPS = 1.2
# Time of the view in three dimensions [s].
VIEW = 0.3
# Titles of the sections of a summary.
TITLES = {
    "interfaces": "Interfaces",
    "regions": "Stresses",
    "bonds": "Bonded interfaces",
    "thermal.regions": "Temperatures",
    "thermal.interfaces": "Heat through the interfaces",
    "cure": "Cure of the cement",
    "stem": "Motion of the {implant} against the bone",
    "femur": "Axial strain of the cortex",
}
# Values for a run that was killed before it wrote its summary.
UNFINISHED = {
    "status": "not finished",
    "time": 0.0,
    "timing": {"total": 0.0},
    "interfaces": {},
}
# Words for keys of the section `solver` of a summary.
SOLVER = {
    "dofs": "unknowns",
    "blocks": "unknowns by kind",
    "newton_iterations": "Newton iterations",
    "linear_iterations": "Krylov iterations",
}
NOT_FINISHED = "There are no results: the run did not finish."
# Number of notes on the input above which they fold into one line.
MOST_NOTES = 3
# Number of rows above which a table folds into one line.
MOST_ROWS = 12
log = logging.getLogger("mantle")


def after_run(folder: Path, comm: MPI.Comm | None) -> None:
    """Write the pages at the end of a run (collective); a failure is only a warning.

    Args:
        folder: The run directory.
        comm: The ranks of the run. The ranks on the node of rank 0 see its files and share the
            pictures. None after a failure: other ranks may have ended, so rank 0 draws a few
            pictures alone.
    """
    if comm is None and rank() != 0:
        return
    all_ranks = comm or MPI.COMM_SELF
    node = all_ranks.Split_type(MPI.COMM_TYPE_SHARED)
    try:
        if node.bcast(all_ranks.rank) == 0:
            with mpl.rc_context():  # leaves the rcParams of the caller untouched
                write(folder, SHARE if comm else 0.0, comm=node)
    except Exception as error:  # a failed page must not cost the results
        if node.rank == 0:
            log.warning("%s was not written: %s: %s", folder / PAGE, type(error).__name__, error)
    finally:
        node.Free()


def is_run(folder: Path) -> bool:
    """Return True if a run or variations have written into a folder, finished or not."""
    return any((folder / name).exists() for name in ("case.yaml", "variations.json"))


def write(
    folder: Path,
    share: float = math.inf,
    spread: Path | None = None,
    comm: MPI.Comm = MPI.COMM_SELF,
) -> list[Path]:
    """Write the page of a run; of variations, a page each and one over all of them (collective).

    Args:
        folder: The run directory.
        share: Largest time for the page as a fraction of the run's time. If it is infinite, all
            pictures are drawn and also written as files.
        spread: Folder of a sweep over uncertain inputs of the run's case.
        comm: The ranks that share the pictures.

    Returns:
        The pages and pictures, the page of the folder first; nothing on other ranks than 0.

    Raises:
        InputError: The results cannot be read, or the sweep does not fit.
        StoppedError: The page cannot be written.
    """
    with reading(folder), writing(folder):
        if (folder / "variations.json").exists():
            pages = _variations(folder, share, comm)
        else:
            pages = _run(folder, share, comm, spread=spread)
    return pages


def opened(folder: Path) -> SweptCase:
    """Open a run directory; the run may have failed."""
    return SweptCase(folder.name, folder, CONVERGED)


def _run(
    folder: Path,
    share: float,
    comm: MPI.Comm = MPI.COMM_SELF,
    is_alone: bool = True,
    spread: Path | None = None,
) -> list[Path]:
    """Write the page of a run with the pictures that its share of time allows."""
    case = opened(folder)
    config, reason = _read_config(folder)

    def view() -> tuple[str, list[str]]:
        try:
            return viewer.viewer({"": folder}), []
        except Exception as error:  # with unreadable fields there is still a page
            return "", [f"note: no view in three dimensions: {type(error).__name__}: {error}"]

    def time() -> float:
        summary = UNFINISHED | _json(folder / "summary.json")
        return float(share * summary["timing"]["total"])

    time_allowed = on_root(comm, time) or 0.0
    has_viewer = is_alone or time_allowed >= VIEW
    # The view is first, so that it goes to rank 0: this rank also writes the page.
    tasks: list[Callable[[], Any]] = [
        lambda: view() if has_viewer else ("", []),
        lambda: _model(folder, config, reason) if has_viewer else [],
        lambda: _pictures(case, time_allowed),
    ]
    page_parts = distribute_tasks(comm, tasks)
    if comm.rank:
        return []
    (view_html, no_view), model, (sides, maps, files) = page_parts
    summary = UNFINISHED | _json(folder / "summary.json")
    record = _json(folder / "provenance.json")
    input_spread = input_spread_of_run(spread, case) if spread else None
    panels = step_curves.forces(config, case.step_record) if config else []
    loads = case.data.get("loads", {}).values()
    is_grown_from_zero = bool(case.data) and not any(load.get("cycle_table") for load in loads)
    panels += step_curves.over_time(case.step_record, at_rest=is_grown_from_zero)
    if share == math.inf and panels:
        (folder / PICTURES).mkdir(exist_ok=True)
        files = curves.draw(folder / PICTURES / "curves.png", panels, 3) + files
    if share == math.inf:
        files = _path_files(case) + files
    sections = [
        PageSection("model", "Bodies, supports and loads", model),
        PageSection("numbers", "Numbers", _numbers(summary, input_spread)),
        PageSection("sides", "The interfaces from three sides", sides),
        PageSection("curves", "Over time", page.drawings([curves.drawing(p) for p in panels])),
        *_result_sections(case, summary, maps),
        *_record_sections(case, summary, record),
    ]
    solved = bool(summary["time"])
    sentences = [lead.loads(case, summary) if solved else _no_results(summary)]
    if input_spread:
        sentences.append(input_spread.sentence(case))
    html = page.page(
        case.data.get("title") or folder.name,
        sections,
        [*_status(summary), *bullets(no_view)],
        facts=_facts(folder, record),
        lead=" ".join(filter(None, sentences)),
        large=lead.large_numbers(summary) if solved else [],
        view=view_html,
        note=_mirrored(config) if config else "",
    )
    write_text(folder / PAGE, html)
    return [folder / PAGE, *files]


def _result_sections(case: SweptCase, summary: Summary, maps: list[Block]) -> list[PageSection]:
    """Return the sections of results by place: paths, cement, maps, Gruen zones."""
    tension = [curves.drawing(panel) for panel in step_curves.tension(summary)]
    return [
        PageSection("paths", "Along paths", path_curves.path_blocks_of_run(case)),
        PageSection("tension", "Cement under tension", page.drawings(tension)),
        PageSection("maps", "Maps of the interfaces", maps),
        PageSection("gruen", "Gruen zones", gruen.blocks([("", case)])),
        PageSection("mantle", "Cement mantle", table(*gruen.mantles([case]))),
    ]


def _record_sections(case: SweptCase, summary: Summary, record: Json) -> list[PageSection]:
    """Return the sections that document a run: all numbers, convergence, input, provenance."""
    every_number = _tables(summary, all_parts=True)
    case_file = _text(case.folder / "case.yaml")
    verbatim = [Verbatim(case_file)] if case_file else []
    provenance = page.pairs(record)
    return [
        PageSection("all", "All numbers", page.folded("every number with its error", every_number)),
        PageSection("solver", "Convergence of the solver", _solver(case, summary)),
        PageSection("case", "Input", page.folded("the case with all defaults", verbatim)),
        PageSection(
            "provenance", "Provenance", page.folded("program, machine, checksums", provenance)
        ),
    ]


def _read_config(folder: Path) -> tuple[Case | None, str]:
    """Return the configuration, or None and the reason: files that it names may be gone."""
    try:
        return load_case(folder / "case.yaml").config, ""
    except Exception as error:  # there is still a page
        return None, f"{type(error).__name__}: {error}"


def _path_files(case: SweptCase) -> list[Path]:
    """Draw the curves of each path as files; return them."""
    stages = path_curves.stages_of(case)
    files = []
    for name, path in case.paths.items():
        (case.folder / PICTURES).mkdir(exist_ok=True)
        panels = path_curves.panels_of_path(path, stages)
        files += curves.draw(case.folder / PICTURES / f"path_{name}.png", panels, 3)
    return files


def _model(folder: Path, config: Case | None, reason: str) -> list[Block]:
    """Return the picture of the case, or the reason why there is none, and its landmarks.

    Args:
        folder: The run directory.
        config: The case.
        reason: The reason if the case cannot be read.
    """
    caption = (
        "Pale: the outside. Black lines: outlines of the bodies in the section. The length of an "
        "arrow is proportional to the square root of the force."
    )
    figure = Figure(CASE_PICTURE, "", caption, "The case in two views", halves=True)
    try:
        if config and not (folder / CASE_PICTURE).exists():
            data = meshes.build(config.geometry, config.mesh, folders.cache("meshes"))
            case_picture.draw(config, data, folder / CASE_PICTURE)
        picture = page.figures([figure], folder)
    except Exception as error:  # without the mesh there is still a page
        reason = reason or f"{type(error).__name__}: {error}"
        picture = bullets([f"note: no picture of the case: {reason}"])
    return picture + (_landmarks(config) if config else [])


def _landmarks(config: Case) -> list[Block]:
    """Return landmarks and the position of the stem."""
    details = config.geometry.details | config.geometry.placement_details
    return bullets([f"{name}: {plain_text(detail)}" for name, detail in details.items()])


def _pictures(case: SweptCase, time_allowed: float) -> tuple[list[Block], list[Block], list[Path]]:
    """Return the interfaces from three sides, their maps, and the files that were written.

    Args:
        case: The run.
        time_allowed: Time that may be spent [s]; files are written if it is infinite.
    """
    if not (case.folder / "fields.vtkhdf").exists():
        return [], [], []
    if time_allowed < MAPS:
        hint = f"Not drawn for short runs. `mantle report {case.folder}` adds them (30 s)."
        return [], bullets([hint]), []
    is_unlimited = time_allowed == math.inf
    with tempfile.TemporaryDirectory() as scratch:
        folder = case.folder / PICTURES if is_unlimited else Path(scratch)
        folder.mkdir(exist_ok=True)
        try:
            suffixes = figures.SUFFIXES[: None if is_unlimited else 1]
            maps, reasons = pictures.maps([("", case)], folder, suffixes)
        except (KeyError, OSError) as error:
            maps, reasons = [], [f"fields that cannot be read: {error}"]
        sides = pictures.sides(Run(case.folder), folder) if is_unlimited else []
        files = page.files((*sides, *maps), folder)
        from_sides, on_maps = page.figures(sides, folder), page.figures(maps, folder)
    return from_sides, on_maps + bullets(reasons), files if is_unlimited else []


def _mirrored(config: Case) -> str:
    """Return a sentence on the pictures of a right femur; empty for others."""
    if not config.geometry.is_mirrored:
        return ""
    return (
        "This is a right femur. The model and all pictures are mirrored, so that it looks like a"
        " left one. Medial, lateral, anterior and posterior are those of the patient."
    )


def _facts(folder: Path, record: Json) -> str:
    when = str(record.get("finished", "")).replace("T", " ")[:16]
    program = f"mantle {record['mantle']}" if "mantle" in record else ""
    return " · ".join(filter(None, (folder.resolve().name, when and f"{when} UTC", program)))


def _no_results(summary: Summary) -> str:
    """Return the cause of a failure and its remedy, in sentences."""
    verdicts = recorded(summary)
    if not verdicts:
        return NOT_FINISHED
    first_verdict = verdicts[0]
    sentence = (
        f"{first_verdict.where}: {first_verdict.what}."
        if first_verdict.where
        else f"{first_verdict.what}."
    )
    if first_verdict.remedy:
        sentence += f" What to do: {first_verdict.remedy}."
    return in_print(f"{sentence[0].upper()}{sentence[1:]}")


def _status(summary: Summary) -> list[Block]:
    """Return the verdicts on a run: errors and warnings first, then checks, then notes."""
    status = summary["status"]
    verdicts = recorded(summary)
    places = [*summary["interfaces"], *summary.get("regions", {})]
    notes = [in_print(str(v)) for v in verdicts if v.severity is Severity.NOTE]
    graver_verdicts = [v for v in verdicts if v.severity is not Severity.NOTE]
    solved = status in (CONVERGED, UNUSABLE)
    if solved:
        lines = [f"{UNUSABLE}: {v}" for v in graver_verdicts if v.severity is Severity.ERROR]
        lines += [str(v) for v in graver_verdicts if v.severity is not Severity.ERROR]
    elif summary["time"]:
        time = f"{summary['time']:.4g}"
        lines = [f"{status}: the numbers are those of the last converged state, at time {time}"]
        lines += map(str, graver_verdicts)
    else:
        # The lead of the page names the cause of a failure.
        lines = [status, *map(str, graver_verdicts[1:])]
    status_lines = bullets([_with_words(in_print(line), places) for line in lines])
    return status_lines + _notes(notes)


def _with_words(line: str, owners: Sequence[str]) -> str:
    """Write names of interfaces and regions in words; keys and quoted names are unchanged."""
    for owner in owners:
        line = re.sub(rf"(?<![\w.`']){owner}(?!\.?[\w`'])", named(owner), line)
    return line


def _notes(notes: Sequence[str]) -> list[Block]:
    """Return notes on the input; many of them fold into one line."""
    if len(notes) <= MOST_NOTES:
        return bullets(notes)
    return page.folded(f"{len(notes)} notes on the input", bullets(notes))


def _numbers(summary: Summary, spread: InputSpread | None) -> list[Block]:
    """Return a table of numbers for each section, with a column for each body or interface."""
    blocks = _tables(summary, all_parts=False, spread=spread)
    for stage, numbers in summary.get("cycles", {}).items():
        head = ["", "permanent", "inducible"]
        rows = [[in_print(name), *values] for name, *values in cycles.rows_of_cycles(numbers)]
        blocks += page.titled(f"Cycles of {stage}", table(head, rows))
        blocks += bullets([*cycles.friction(numbers)])
    head, peaks = _unsettled(summary)
    changing: list[Block] = table(head, peaks)
    if len(peaks) > MOST_ROWS:
        changing = page.folded(f"{len(peaks)} maxima by mesh", changing)
    blocks += page.titled("Maxima that still change with the mesh", changing)
    note = summary.get("thermal", {}).get("note")
    if note:
        blocks += bullets([note])
    return blocks


def _tables(summary: Summary, all_parts: bool, spread: InputSpread | None = None) -> list[Block]:
    """Return a table for each section: of all numbers, or of the main numbers with their spread."""
    sections: dict[str, dict[str, Numbers]] = {}
    for section, name, numbers in summary_numbers.numbers_of(summary, parts=all_parts):
        sections.setdefault(section, {})[name] = numbers
    blocks: list[Block] = []
    titles = TITLES | {section.name: section.title for section in quantities.ADDED.values()}
    for section in (s for s in titles if s in sections):
        quantity_by_key, by_owner = TABLE[section], sections[section]
        added_keys = [k for k, q in quantity_by_key.items() if q.compute]
        page_keys = [k for k, q in quantity_by_key.items() if q.on_page]
        keys = [] if all_parts else [*text.keys(section), *page_keys, *added_keys]
        keys += [k for k in quantity_by_key if spread and k.startswith("necrosis")]
        shown_quantities = [
            quantity_by_key[k] for k in keys or quantity_by_key if not quantity_by_key[k].vector
        ]
        rows = []
        for q in shown_quantities:
            number_texts = [q.text(numbers) for numbers in by_owner.values()]
            rows.append([with_brackets(q.label, printed(q.shown)), *number_texts])
        if spread:
            rows = []
            for q in shown_quantities:
                for owner, numbers in by_owner.items():
                    rows.append(spread.cells(f"{owner}.{q.key}", q, numbers))
        rows = [row for row in rows if set(row[1:]) != {"-"}]
        head = HEAD_OF_SPREAD if spread else ["", *map(named, by_owner)]
        title = titles[section].format(implant=name_of_implant(summary))
        blocks += page.titled(title, table(head, rows))
        if section == "thermal.regions" and not all_parts and not spread:
            blocks += page.titled("Dead bone", _necrosis(by_owner))
    return blocks


def _unsettled(summary: Summary) -> tuple[list[str], list[list[str]]]:
    """Return head and rows of maxima that do not converge: their values on meshes of each size."""
    unsettled = summary.get("error", {}).get("unsettled", {})
    peaks: dict[str, dict[float, float]] = {}
    for name, pairs in unsettled.items():
        peaks[name] = {size: value for size, value in pairs}
    sizes = sorted(set(chain.from_iterable(peaks.values())))
    rows = []
    for name, values in peaks.items():
        q = quantities.quantity_of(name)
        if q:
            value_texts = (q.text({q.key: values.get(size)}) for size in sizes)
            rows.append([quantities.label_with_unit(name), *value_texts])
    return ["", *(f"{s:g} mm" for s in sizes)], rows


def _necrosis(regions: dict[str, Numbers]) -> list[Block]:
    bones, rows = text.necrosis(regions)
    measures = ("volume (mm³)", "depth (mm)")
    if not bones:
        return []
    head = [""]
    for bone in bones:
        head += [f"{named(bone)}, {measure}" for measure in measures]
    return table(head, [[in_print(criterion), *values] for criterion, *values in rows])


def _solver(case: SweptCase, summary: Summary) -> list[Block]:
    """Return iterations and balances of each step, and seconds by phase."""
    step_blocks = step_curves.steps(case.step_record)
    sizes = {SOLVER.get(key, key): value for key, value in summary.get("solver", {}).items()}
    step_blocks += page.titled("Sizes", page.pairs(sizes))
    step_blocks += page.titled("Seconds", page.pairs(summary.get("timing", {})))
    return page.folded("each step, sizes, times", step_blocks)


def _variations(folder: Path, share: float, comm: MPI.Comm) -> list[Path]:
    rows = on_root(comm, lambda: _json(folder / "variations.json")) or []
    run_folders = [folder / row["name"] for row in rows]
    solved_folders = [run for run in run_folders if (run / "summary.json").exists()]
    pages_of_runs = distribute_tasks(
        comm, [partial(_run, run, share, is_alone=False) for run in solved_folders]
    )
    if comm.rank:
        return []
    pages = [folder / PAGE, *(page for page, *_ in pages_of_runs)]
    cases = []
    for row in rows:
        case = SweptCase(
            row["name"],
            folder / row["name"],
            row["status"],
            overrides=row["overrides"],
            seconds=row["seconds"],
            numbers=row["numbers"],
            notes=tuple(row.get("notes", ())),
        )
        cases.append(case)
    all_names = headlines(cases)
    quantity_by_name = {name: quantities.quantity_of(name) for name in all_names}
    names = [name for name, q in quantity_by_name.items() if not (q and q.exact)]
    drawings = folder / PICTURES
    is_unlimited = share == math.inf
    if is_unlimited:
        drawings.mkdir(exist_ok=True)
    curve_blocks, files = sweep_figures.draw_over_keys(cases, drawings if is_unlimited else None)
    sections = [
        PageSection("cases", "All variations", sweep_tables.cases_table(cases, names, folder)),
        PageSection("curves", "Curves over the varied keys", curve_blocks),
        PageSection("notes", "Notes of the runs", bullets(noted((c.name, c.notes) for c in cases))),
    ]
    converged_count = sum(c.done for c in cases)
    failed_lines = [f"{c.status}: {c.name}" for c in cases if not c.done]
    titles = [c.data["title"] for c in cases if c.data.get("title") and "title" not in c.overrides]
    title = titles[0].partition("; changed: ")[0] if titles else folder.resolve().name
    html = page.page(
        f"Variations: {title}",
        sections,
        bullets([f"{converged_count} of {len(cases)} variations converged", *failed_lines]),
        large=lead.ranges_over_runs(cases, names),
    )
    write_text(folder / PAGE, html)
    return pages + files


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""


def _json(path: Path) -> Any:
    return json.loads(_text(path) or "{}")
