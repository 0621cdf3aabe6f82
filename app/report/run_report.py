"""``report.html`` of a run: the main findings first, then all numbers, curves and maps.

Everything is read from the run directory, so that the page can be made again later and elsewhere.
"""

from __future__ import annotations

import json
import logging
import math
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from mpi4py import MPI

import matplotlib as mpl

import meshes
from app.case import quantities
from app.case.case import load
from app.case.quantities import TABLE, Quantity, in_print, printed
from app.foundation.errors import InputError, StoppedError, dealt, on_root
from app.foundation.verdict import Severity, recorded
from app.plots import curves, figures
from app.report import (
    case_picture,
    gruen,
    page,
    pictures,
    sentence,
    step_curves,
    sweep_figures,
    viewer,
)
from app.report.input_spread import HEAD, InputSpread, of_run
from app.report.page import Blocks, Figure, bullets, table
from app.report.sweep_results import CONVERGED, SweptCase
from app.results import closing_lines as text
from app.results import cycles
from app.results.reading import Run
from app.results.verdicts import UNUSABLE
from app.system import folders
from app.system.folders import CASE_PICTURE, write_text
from app.system.layout import noted, plain
from app.system.ranks import rank

# Name of the page in the folder of a run.
PAGE = "report.html"
# Folder of the pictures as files.
PICTURES = "report"
# Part of a run's time that its page may take.
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
    "stem": "Motion of the stem against the bone",
    "femur": "Motion of the head, strain of the cortex",
}
# Quantities that the closing table of a run has no room for.
MORE = {
    "interfaces": (
        *("area_gap_over_30um", "area_slip_over_30um", "area_motion_over_30um"),
        *("torque_max", "eccentricity", "dissipation_cycle", "slid_max", "friction_power"),
        *("wear_volume_million", "wear_depth_p99_million", "wear_depth_p99_master_million"),
    )
}
# What a run that was killed has not written.
UNFINISHED = {
    "status": "not finished",
    "time": 0.0,
    "timing": {"total": 0.0},
    "interfaces": {},
}
NO_NUMBERS = "There are no numbers: no step has converged, or the run did not come to its end."
log = logging.getLogger("mantle")


def after_run(folder: Path, comm: MPI.Comm | None) -> None:
    """Write the pages at the end of a run (collective); a failure is only a warning.

    Args:
        folder: The run directory.
        comm: The ranks of the run. Those on the node of rank 0, which have its files, share the
            pictures. None after a failure: rank 0 draws alone and little, as others may not come.
    """
    if comm is None and rank() != 0:
        return
    every = comm or MPI.COMM_SELF
    node = every.Split_type(MPI.COMM_TYPE_SHARED)
    try:
        if node.bcast(every.rank) == 0:
            with mpl.rc_context():  # those of the process that we are a guest of
                write(folder, SHARE if comm else 0.0, comm=node)
    except Exception as error:  # the results are there, whatever the page lacks
        if node.rank == 0:
            log.warning("%s was not written: %s: %s", folder / PAGE, type(error).__name__, error)
    finally:
        node.Free()


def is_run(folder: Path) -> bool:
    """Whether a run or variations have written into a folder, finished or not."""
    return any((folder / name).exists() for name in ("case.yaml", "variations.json"))


def write(
    folder: Path,
    share: float = math.inf,
    spread: Path | None = None,
    comm: MPI.Comm = MPI.COMM_SELF,
) -> list[Path]:
    """Write the page of a run, or of its variations and over them; collective.

    Args:
        folder: The run directory.
        share: Part of the run's time that may be spent; if infinite, pictures become files, too.
        spread: Folder of a sweep over uncertain inputs of the run's case.
        comm: The ranks that share the pictures.

    Returns:
        The pages and pictures, the page of the folder first; nothing on other ranks than 0.

    Raises:
        InputError: The results cannot be read, or the sweep does not fit.
        StoppedError: The page cannot be written.
    """
    try:
        if (folder / "variations.json").exists():
            return _variations(folder, share, comm)
        return _run(folder, share, comm, spread=spread)
    except OSError as error:
        text = f"cannot write {error.filename or f'the report in {folder}'}: {error.strerror}"
        raise StoppedError(text) from error
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{folder}: results that cannot be read: {error!r}") from error


def opened(folder: Path, **more: Any) -> SweptCase:
    """Open a run directory, that of a failed run as well."""
    return SweptCase(folder.name, folder, **{"status": CONVERGED} | more)


def _run(
    folder: Path,
    share: float,
    comm: MPI.Comm = MPI.COMM_SELF,
    alone: bool = True,
    spread: Path | None = None,
) -> list[Path]:
    """Write the page of a run; of one among many, as its share of time allows."""
    case = opened(folder)

    def time() -> float:
        summary = UNFINISHED | _json(folder / "summary.json")
        return float(share * summary["timing"]["total"])

    spent = on_root(comm, time) or 0.0
    whole = alone or spent >= VIEW
    # The view first: rank 0, which also writes the page, has the least to draw.
    tasks: list[Callable[[], Any]] = [
        lambda: _view(folder) if whole else ("", []),
        lambda: _model(folder) if whole else [],
        lambda: _pictures(case, spent),
    ]
    parts = dealt(comm, tasks)
    if comm.rank:
        return []
    (view, lacking), model, (sides, maps, files) = parts
    summary = UNFINISHED | _json(folder / "summary.json")
    record = _json(folder / "provenance.json")
    over = of_run(spread, case) if spread else None
    panels = step_curves.over_time(case.step_record)
    drawn = [curves.drawing(panel) for panel in panels]
    stressed = [curves.drawing(panel) for panel in step_curves.tension(summary)]
    if share == math.inf and panels:
        (folder / PICTURES).mkdir(exist_ok=True)
        files = curves.draw(folder / PICTURES / "curves.png", panels, 3) + files
    case_file = _text(folder / "case.yaml")
    verbatim: Blocks = [("verbatim", {"text": case_file})] if case_file else []
    curves_over_time: Blocks = [("drawings", {"drawings": drawn})] if panels else []
    under_tension: Blocks = [("drawings", {"drawings": stressed})] if stressed else []
    sections = [
        ("model", "Bodies, supports and loads", model),
        ("numbers", "Numbers", _numbers(summary, over)),
        ("sides", "From three sides", sides),
        ("curves", "Over time", curves_over_time),
        ("tension", "Cement under tension", under_tension),
        ("maps", "Maps of the interfaces", maps),
        ("gruen", "Gruen zones", gruen.blocks([("", case)])),
        ("mantle", "Cement mantle", table(*gruen.mantles([case]))),
        (
            "all",
            "All numbers",
            page.folded("every quantity, with its error where known", _tables(summary, every=True)),
        ),
        ("solver", "Convergence of the solver", _solver(case, summary)),
        ("case", "Input", page.folded("the case with all defaults", verbatim)),
        ("provenance", "Provenance", page.folded("program, machine, digests", _pairs(record))),
    ]
    lead = sentence.sentence(summary, case) if summary["time"] else NO_NUMBERS
    html = page.page(
        case.data.get("title") or folder.name,
        sections,
        facts=_facts(folder, record),
        lead=f"{lead} {over.sentence(case)}" if over else lead,
        summary=[*_verdict(summary), *lacking],
        view=view,
    )
    write_text(folder / PAGE, html)
    return [folder / PAGE, *files]


def _model(folder: Path) -> Blocks:
    """The picture of the case, which is drawn once; without it, why."""
    words = "Pale: the outside. Arrows are the longer the larger the force, as its square root."
    try:
        if not (folder / CASE_PICTURE).exists():
            case = load(folder / "case.yaml").config
            data = meshes.build(case.geometry, case.mesh, folders.cache("meshes"))
            case_picture.draw(case, data, folder / CASE_PICTURE)
        return page.figures([Figure(CASE_PICTURE, "", words, "The case in two views")], folder)
    except Exception as error:  # a mesh that is not there any more must not cost the page
        return bullets([f"note: no picture of the case: {type(error).__name__}: {error}"])


def _pictures(case: SweptCase, spent: float) -> tuple[Blocks, Blocks, list[Path]]:
    """Interfaces from three sides, and their maps; the files, if time is not limited."""
    if not (case.folder / "fields.vtkhdf").exists():
        return [], [], []
    if spent < MAPS:
        later = f"mantle report {case.folder} draws them: after a short run they take too long"
        return [], bullets([later]), []
    whole = spent == math.inf
    with tempfile.TemporaryDirectory() as scratch:
        folder = case.folder / PICTURES if whole else Path(scratch)
        folder.mkdir(exist_ok=True)
        try:
            suffixes = figures.SUFFIXES[: None if whole else 1]
            maps, missing = pictures.maps([("", case)], folder, suffixes)
        except (KeyError, OSError) as error:
            maps, missing = [], [f"fields that cannot be read: {error}"]
        sides = pictures.sides(Run(case.folder), folder) if whole else []
        files = page.files((*sides, *maps), folder)
        blocks = [page.figures(found, folder) for found in (sides, maps)]
    return blocks[0], blocks[1] + bullets(missing), files if whole else []


def _view(folder: Path) -> tuple[str, list[str]]:
    """The view in three dimensions, or why there is none: its failure must not cost the page."""
    try:
        return viewer.viewer({"": folder}), []
    except Exception as error:  # whatever is wrong with the fields
        return "", [f"note: no view in three dimensions: {type(error).__name__}: {error}"]


def _facts(folder: Path, record: dict[str, Any]) -> str:
    when = str(record.get("finished", "")).replace("T", " ")[:16]
    program = f"mantle {record['mantle']}" if "mantle" in record else ""
    return " · ".join(filter(None, (folder.resolve().name, when and f"{when} UTC", program)))


def _verdict(summary: dict[str, Any]) -> list[str]:
    """The verdicts on a run: reasons not to use its numbers first, notes last."""
    status = summary["status"]
    verdicts = recorded(summary)
    if status in (CONVERGED, UNUSABLE):
        lines = [f"{UNUSABLE}: {v}" for v in verdicts if v.severity is Severity.ERROR]
        lines += [str(v) for v in verdicts if v.severity is not Severity.ERROR]
    else:
        last = ""
        if summary["time"]:
            time = f"at time {summary['time']:.4g}"
            last = f": the numbers are those of the last converged state, {time}"
        lines = [f"{status}{last}", *map(str, verdicts)]
    return [in_print(line) for line in lines]


def _numbers(summary: dict[str, Any], spread: InputSpread | None) -> Blocks:
    """The numbers of the closing table, a column for each interface, region and so on."""
    found = _tables(summary, every=False, spread=spread)
    for stage, own in summary.get("cycles", {}).items():
        head = ["", "permanent", "inducible"]
        rows = [[in_print(name), *both] for name, *both in cycles.rows(own)]
        found += page.titled(f"Cycles of {stage}", table(head, rows))
        found += bullets([*cycles.friction(own)])
    found += page.titled("Peaks that still change with the mesh", _unsettled(summary))
    note = summary.get("thermal", {}).get("note")
    if note:
        found += bullets([note])
    return found


def _tables(summary: dict[str, Any], every: bool, spread: InputSpread | None = None) -> Blocks:
    """Tables of the numbers by section, of all of them or of the main ones with their spread."""
    sections: dict[str, dict[str, dict[str, Any]]] = {}
    for section, name, numbers in quantities.numbers_of(summary, parts=every):
        sections.setdefault(section, {})[name] = numbers
    found: Blocks = []
    titles = TITLES | {section.name: section.title for section in quantities.ADDED.values()}
    for section in (s for s in titles if s in sections):
        own, named = TABLE[section], sections[section]
        added = [k for k, q in own.items() if q.compute]
        keys = [] if every else [*text.keys(section), *MORE.get(section, ()), *added]
        keys += [k for k in own if spread and k.startswith("necrosis")]
        shown = [own[k] for k in keys or own if not own[k].vector]
        rows = [[_label(q), *(q.text(numbers) for numbers in named.values())] for q in shown]
        if spread:
            rows = [spread.cells(f"{o}.{q.key}", q, n) for q in shown for o, n in named.items()]
        rows = [row for row in rows if set(row[1:]) != {"-"}]
        found += page.titled(titles[section], table(HEAD if spread else ["", *named], rows))
        if section == "thermal.regions" and not every and not spread:
            found += page.titled("Dead bone", _necrosis(named))
    return found


def _label(q: Quantity) -> str:
    unit = printed(q.shown)
    return f"{q.label} ({unit})" if unit else q.label


def _unsettled(summary: dict[str, Any]) -> Blocks:
    """Peaks that do not converge, by mesh."""
    found = {k: dict(v) for k, v in summary.get("error", {}).get("unsettled", {}).items()}
    sizes = sorted({size for values in found.values() for size in values})
    rows = [
        [quantities.titled(name), *(q.text({q.key: values.get(s)}) for s in sizes)]
        for name, values in found.items()
        if (q := quantities.get(name))
    ]
    return table(["", *(f"{s:g} mm" for s in sizes)], rows)


def _necrosis(regions: dict[str, dict[str, Any]]) -> Blocks:
    bones, rows = text.necrosis(regions)
    head = ["", *(f"{name}, {what}" for name in bones for what in ("volume (mm³)", "depth (mm)"))]
    return table(head, [[in_print(words), *texts] for words, *texts in rows] if bones else [])


def _solver(case: SweptCase, summary: dict[str, Any]) -> Blocks:
    """Iterations and balances of each step, and seconds by phase."""
    parts = step_curves.steps(case.step_record)
    parts += page.titled("Sizes", _pairs(summary.get("solver", {})))
    parts += page.titled("Seconds", _pairs(summary.get("timing", {})))
    return page.folded("each step, sizes, times", parts)


def _pairs(values: dict[str, Any]) -> Blocks:
    return table(["", ""], [[str(k).replace("_", " "), plain(v)] for k, v in values.items()])


def _variations(folder: Path, share: float, comm: MPI.Comm) -> list[Path]:
    rows = on_root(comm, lambda: _json(folder / "variations.json")) or []
    solved = [f for f in (folder / row["name"] for row in rows) if (f / "summary.json").exists()]
    written = dealt(comm, [partial(_run, own, share, alone=False) for own in solved])
    if comm.rank:
        return []
    pages = [folder / PAGE, *(page for page, *_ in written)]
    cases = []
    for row in rows:
        more = {k: row[k] for k in ("overrides", "status", "seconds", "numbers")}
        notes = tuple(row.get("notes", ()))
        cases.append(opened(folder / row["name"], **more, notes=notes))
    every = sweep_figures.headlines(cases)
    names = [n for n in every if not ((q := quantities.get(n)) and q.exact)]
    drawings = folder / PICTURES
    whole = share == math.inf
    if whole:
        drawings.mkdir(exist_ok=True)
    drawn, files = sweep_figures.multiples(cases, drawings if whole else None)
    sections = [
        ("cases", "All variations", sweep_figures.cases_table(cases, names, folder)),
        ("curves", "What varies", drawn),
        ("notes", "Notes of the runs", bullets(noted((c.name, c.notes) for c in cases))),
    ]
    done = sum(c.done for c in cases)
    bad = [f"{c.status}: {c.name}" for c in cases if not c.done]
    html = page.page(
        f"Variations: {folder.resolve().name}",
        sections,
        lead=sentence.spread(cases, names, "variations"),
        summary=[f"{done} of {len(cases)} variations converged", *bad],
    )
    write_text(folder / PAGE, html)
    return pages + files


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""


def _json(path: Path) -> Any:
    return json.loads(_text(path) or "{}")
