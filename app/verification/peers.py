"""``mantle bench --peers``: mantle beside other programs on the same meshes.

The stem that `mantle bench` times, at first order, by each program that is installed. Slip and
penetration are taken from the displacement of the nodes by one function, and slip is compared with
that of second order on a finer mesh. Writes ``peers.json``, ``peers.csv`` and ``peers.png``.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from app import figures
from app.campaigns.many import Options
from app.case.case import Case, dump, load
from app.errors import InputError
from app.system import layout, style
from app.system.folders import csv_text, remove, write_json, write_text
from app.verification.benchmarks import STEM
from app.verification.check import CONFIGS
from app.verification.peer_model import PeerModel, build, contact_numbers
from app.verification.peer_programs import (
    CalculiX,
    GetFem,
    MantleItself,
    Program,
    measured,
    of_run,
)

log = logging.getLogger("mantle")

# Mesh sizes [mm] of each tier. Facets of the stem meet at less than 30 degrees, so that mantle has
# one normal at a node, as the others.
SIZES = {"quick": (4.0,), "default": (4.0, 3.0, 1.93), "long": (4.0, 3.0, 1.93)}
REFERENCE = {"quick": 3.0, "default": 1.5, "long": 1.3}  # second order [mm]
LIMIT = 1800  # CPU seconds that a program has
PROGRAMS: tuple[Program, ...] = (MantleItself(), GetFem(), CalculiX(1e4, 1e3), CalculiX(1e5, 1e4))


@dataclass(frozen=True)
class PeerRow:
    """A program on a mesh; numbers are None where it has not come to the end.

    Attributes:
        program: Its name.
        size: Mesh size [mm].
        unknowns: Components of displacement.
        cpu: CPU seconds of its whole process.
        ratio: The same over mantle's on this mesh.
        memory: Largest resident memory [MB].
        penetration: Largest overlap at a node of any interface [mm].
        slip_mean: Mean slip by area of the interface that slips most [mm].
        slip_p99: Its percentile.
        error: Of the mean slip, relative to the reference.
        error_p99: The same of the percentile.
        note: Why there are no numbers.
    """

    program: str
    size: float
    unknowns: int
    cpu: float | None = None
    ratio: float | None = None
    memory: float | None = None
    penetration: float | None = None
    slip_mean: float | None = None
    slip_p99: float | None = None
    error: float | None = None
    error_p99: float | None = None
    note: str = ""


@dataclass(frozen=True)
class SlipReference:
    """Slip of the interface that slips most on a finer mesh of second order.

    Attributes:
        interface: Its name.
        size: Mesh size [mm].
        slip_mean: Mean by area [mm].
        slip_p99: Percentile [mm].
    """

    interface: str
    size: float
    slip_mean: float
    slip_p99: float


def run(options: Options) -> bool:
    """Measure all programs, write what was found and tell it.

    Args:
        options: Where it goes, and how much.

    Returns:
        Whether all that are installed came to the end.

    Raises:
        InputError: The folder cannot be made, no program has such a name, or mantle cannot solve
            the reference.
    """
    if options.slurm is not None:
        raise InputError("--peers: runs on this machine alone; expected no --slurm")
    try:
        options.folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"-o {options.folder}: cannot be made: {error.strerror}") from error
    if not (there := [p for p in PROGRAMS if options.pattern.lower() in p.name.lower()]):
        names = ", ".join(p.name for p in PROGRAMS)
        raise InputError(f"-k {options.pattern}: no program has this in its name; allowed: {names}")
    reference = _reference(REFERENCE[options.tier], options.folder)
    rows: list[PeerRow] = []
    for size in SIZES[options.tier]:
        overrides = _sized(size)
        model, case = build(CONFIGS / STEM, overrides), load(CONFIGS / STEM, overrides).config
        own: float | None = None
        for program in there:
            folder = options.folder / "peers" / f"{program.key}-{size:g}"
            row = measure(program, model, case, size, folder, reference, own)
            own = row.cpu if isinstance(program, MantleItself) else own
            rows.append(row)
            log.info("%s", _told(row))
    _write(options.folder, rows, reference)
    log.info("%s", table(rows))
    log.info(
        "slip of %s beside second order at %g mm: mean %.2f um, p99 %.2f um\nresults in %s",
        *(reference.interface, reference.size, 1e3 * reference.slip_mean),
        *(1e3 * reference.slip_p99, options.folder),
    )
    return all(row.cpu is not None or row.note.startswith("not installed") for row in rows)


def dry_run(options: Options) -> str:
    """The programs and the meshes that `run` would measure them on, as a table."""
    sizes = ", ".join(f"{size:g}" for size in SIZES[options.tier])
    wanted = [p for p in PROGRAMS if options.pattern.lower() in p.name.lower()]
    return layout.table(
        ("program", "sizes [mm]", "times", "note"),
        [(p.name, sizes, p.times, p.missing()) for p in wanted],
    )


def _sized(size: float) -> tuple[str, ...]:
    return f"mesh.size={size:g} mm", f"mesh.far_size={size:g} mm"


def _reference(size: float, folder: Path) -> SlipReference:
    """Solve the reference, or take it from the folder.

    Slip is taken from it at its corners, by the same function as from all programs.
    """
    place = folder / "peers" / f"reference-{size:g}"
    place.mkdir(parents=True, exist_ok=True)
    overrides = _sized(size)
    case = load(CONFIGS / STEM, (*overrides, "mesh.order=2")).config
    program, model = MantleItself(), build(CONFIGS / STEM, overrides)
    known, text = place / "case.yaml", dump(case)
    same = known.exists() and known.read_text(encoding="utf-8") == text
    if not (same and (place / "run" / "DONE").exists()):
        log.info("reference: second order at %g mm", size)
        cost = measured(program.command(model, case, place), place, 2 * LIMIT)
        if cost.exit_code:
            raise InputError(f"the reference has failed: see {place / 'log'}")
    numbers = contact_numbers(model, of_run(model, place / "run"))
    name = max(numbers, key=lambda n: numbers[n]["slip_mean"])
    return SlipReference(name, size, numbers[name]["slip_mean"], numbers[name]["slip_p99"])


def measure(
    program: Program,
    model: PeerModel,
    case: Case,
    size: float,
    folder: Path,
    reference: SlipReference,
    own: float | None,
) -> PeerRow:
    """Run a program on a model.

    Args:
        program: The program.
        model: The model.
        case: The case that it is of.
        size: Its mesh size [mm].
        folder: Where it runs.
        reference: What its slip is compared with.
        own: CPU seconds of mantle, if they are known.
    """
    base = (program.name, size, model.unknowns)
    if why := program.missing():
        return PeerRow(*base, note=why)
    folder.mkdir(parents=True, exist_ok=True)
    command = program.command(model, case, folder)
    costs = [measured(command, folder, LIMIT) for _ in range(program.times)]
    cost = sorted(costs, key=lambda c: c.cpu)[len(costs) // 2]
    own = cost.cpu if isinstance(program, MantleItself) else own
    try:
        if cost.exit_code:
            raise InputError(f"exit code {cost.exit_code} after {cost.cpu:.0f} CPU s")
        numbers = contact_numbers(model, program.displacement(model, folder))
    except (OSError, InputError) as error:
        return PeerRow(*base, note=f"{error}; see {folder / 'log'}")
    slip = numbers[reference.interface]
    return PeerRow(
        *base,
        cpu=round(cost.cpu, 2),
        ratio=round(cost.cpu / own, 2)
        if own
        else 1.0
        if isinstance(program, MantleItself)
        else None,
        memory=round(cost.memory, 1),
        penetration=max(n["penetration"] for n in numbers.values()),
        slip_mean=slip["slip_mean"],
        slip_p99=slip["slip_p99"],
        error=slip["slip_mean"] / reference.slip_mean - 1,
        error_p99=slip["slip_p99"] / reference.slip_p99 - 1,
    )


def table(rows: Sequence[PeerRow]) -> str:
    """A line for each program and mesh."""
    head = (
        *("program", "size", "unknowns", "CPU s", "over mantle", "MB", "penetration [um]"),
        *("slip mean [um]", "p99", "error mean [%]", "p99", ""),
    )
    return layout.table(head, map(_cells, rows))


def _cells(row: PeerRow) -> tuple[object, ...]:
    def text(value: float | None, form: str, factor: float = 1.0) -> str:
        return "-" if value is None else format(factor * value, form)

    return (
        *(row.program, f"{row.size:g} mm", row.unknowns, text(row.cpu, ".1f")),
        *(text(row.ratio, ".1f"), text(row.memory, ".0f"), text(row.penetration, ".1e", 1e3)),
        *(text(row.slip_mean, ".2f", 1e3), text(row.slip_p99, ".2f", 1e3)),
        *(text(row.error, ".1f", 1e2), text(row.error_p99, ".1f", 1e2), row.note),
    )


def _told(row: PeerRow) -> str:
    end = row.note or f"{row.cpu:.1f} CPU s, {row.memory:.0f} MB"
    return f"{row.program}, {row.size:g} mm, {layout.count(row.unknowns)} unknowns: {end}"


def _write(folder: Path, rows: Sequence[PeerRow], reference: SlipReference) -> None:
    """Write JSON, CSV and picture."""
    drawing = folder / "peers.png"
    remove([drawing])  # should the new one fail, the old one is not beside new numbers
    entries = [asdict(row) for row in rows]
    write_json(folder / "peers.json", {"reference": asdict(reference), "rows": entries})
    write_text(folder / "peers.csv", csv_text(entries))
    draw(rows, drawing)


def draw(rows: Sequence[PeerRow], path: Path) -> None:
    """Error of the mean slip over CPU seconds, a curve for each program.

    Args:
        rows: What was found.
        path: The PNG to write.
    """
    from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

    figure = figures.new(7.5, 5.0)
    axes = figure.add_subplot()
    for k, name in enumerate(dict.fromkeys(row.program for row in rows)):
        own = [row for row in rows if row.program == name]
        points = [(r.cpu, 100 * abs(r.error), r.size) for r in own if r.cpu and r.error]
        if not points:
            continue
        x, y, _ = zip(*points, strict=True)
        style.curve(axes, x, y, k, name)
        for cpu, error, size in points:
            place = {"xytext": (6, 5 if k else -11), "textcoords": "offset points"}
            axes.annotate(f"{size:g} mm", (cpu, error), fontsize=7, **place)
    axes.set(xscale="log", yscale="log", xlabel="CPU time of the whole process (s)")
    axes.set_ylabel("error of the mean slip (%)")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(ScalarFormatter())
        axis.set_minor_formatter(NullFormatter())
    if axes.lines:
        axes.legend(frameon=False, fontsize=8)
    style.grid(axes)
    figure.savefig(path, dpi=110)
