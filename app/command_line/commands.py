"""One function for each command. The one module that prints to standard output.

A command imports what only it needs: pictures take half a second to import, campaigns and suites
one, the solver two, and every run would wait for them.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import shlex
import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import meshes
from app.case import explanations, keys, mesh_names, new_case, overlay
from app.case.case import LoadedCase, load_case, valid_parts
from app.command_line import actions
from app.command_line.parser import options_of_commands, parser
from app.command_line.streams import configure_log, painted, pass_colours
from app.foundation import verdict
from app.foundation.errors import EnvironmentProblem, InputError, stack_needed
from app.schema.section import did_you_mean
from app.simulation import finished_runs
from app.soundness import cost, memory
from app.system import doctor, ranks, stopping
from app.system.folders import prepare_run, writing
from app.system.ranks import rank
from meshes.placement import NO_POSITION

if TYPE_CHECKING:
    from app.campaigns.batch import Options

CHECK_FAILED = 1

log = logging.getLogger("mantle")


def dispatch(arguments: list[str]) -> int:
    """Parse the command line, call the command and return its exit code."""
    cut = arguments.index("--") if "--" in arguments else len(arguments)
    petsc_options = arguments[cut + 1 :]
    options = parser().parse_args(arguments[:cut])
    if getattr(options, "allow_scripts", False):
        os.environ[mesh_names.ALLOWED] = "1"
    if options.command == "run":
        return _run(options, petsc_options, arguments)
    if petsc_options:
        raise InputError(f"mantle {options.command}: this command takes no PETSc options after --")
    return COMMANDS[options.command](options)


def _run(options: argparse.Namespace, petsc_options: list[str], arguments: list[str]) -> int:
    size, count = ranks.world_size(), options.n
    configure_log("debug" if options.verbose else "info")
    # The input is checked before ranks are started: its errors come at once, and once.
    overrides = list(options.overrides)
    if options.error:
        overrides.append("output.error=true")
    if options.accuracy:
        overrides.append(f"output.accuracy={options.accuracy}")
    options.overrides = overrides  # the list of the options is the next command's, too
    case = _load(options)
    output = options.output or case.output
    walltime = stopping.seconds_of_duration(options.walltime) if options.walltime else None
    if finished_runs.prepare(case, output, force=options.force, restart=options.restart):
        if rank() == 0:
            print(f"{output} has the finished results of this case already; --force runs it again")
        return 0
    if size is None and count > 1:
        print(f"starting {count} ranks", flush=True)
        cores = len(os.sched_getaffinity(0))
        if count > cores:
            message = f"note: {count} ranks share {cores} cores, which is slower than -n {cores}"
            print(painted(message, "doubtful", sys.stderr), file=sys.stderr, flush=True)
        pass_colours()
        return ranks.launch(count, [sys.executable, "-m", "mantle", *arguments])
    if size is not None and count not in (1, size) and rank() == 0:
        print(
            f"mantle: -n {count} is ignored: mpirun has started {size or 'some'} ranks",
            file=sys.stderr,
        )
    actions.solve_in_prepared_folder(
        case,
        output,
        force=options.force,
        restart=options.restart,
        walltime=walltime,
        signals=True,
        petsc_options=petsc_options,
    )
    return 0


def _case_path(path: Path) -> Path:
    """File of the case of a command: a file, or a shipped case by its name alone."""
    shipped = overlay.base_file(path.parent, str(path))
    # A folder of results may have the name of a shipped case.
    if shipped.exists() and not path.is_file():
        return shipped
    if path.exists():
        return path
    hint = "" if path.suffix else did_you_mean(str(path), overlay.shipped_cases())
    if hint:
        raise InputError(f"{path}: no such file or shipped case{hint}")
    return path


def _load(options: argparse.Namespace) -> LoadedCase:
    """Load the case of a command."""
    return load_case(_case_path(options.case), options.overrides)


# Options of `mantle init` that describe a segmentation, and those that describe another geometry.
OF_LABELS = ("ct", "side", "label")
OF_KINDS = ("kind", "stem")
# Geometry of a new case without `--kind` and `--labels`.
DEFAULT_KIND = "femur"


def _check_init(options: argparse.Namespace) -> None:
    """Raise InputError if options of `mantle init` do not belong together."""
    other_options = OF_KINDS if options.labels else OF_LABELS
    given = ", ".join(f"--{name}" for name in other_options if getattr(options, name))
    if given and options.labels:
        raise InputError(
            f"{given}: has no effect with --labels, which makes a case of a segmentation (kind:"
            " patient); leave one of them out"
        )
    if given:
        raise InputError(f"{given}: needs --labels FILE, the segmentation of the femur; add it")
    images = {name: getattr(options, name) for name in ("labels", "ct")}
    missing = [
        f"--{name} {path}: no such file or folder"
        for name, path in images.items()
        if path and not path.exists()
    ]
    if missing:
        raise InputError(missing)


def _init(options: argparse.Namespace) -> int:
    _check_init(options)
    if options.labels:
        label_options = options.labels, options.ct, options.side, options.label
        write = new_case.labels_writer()
        path, assumed = write(options.name, *label_options, options.cementless)
        for line in assumed:
            print(f"- {line}")
    else:
        kind = options.kind or DEFAULT_KIND
        path = new_case.write(options.name, kind, options.stem, meshes.meeting, options.cementless)
    name, folder = shlex.quote(str(path)), shlex.quote(str(Path("out") / path.stem))
    program = shlex.quote(os.environ.get("MANTLE_CALLED", "mantle"))
    print(f"{path} is written; next:")
    print(f"  {program} check {name}")
    print(f"  {program} run {name} -o {folder}")
    print(f"  open {folder}/report.html in a browser")
    return 0


def _check(options: argparse.Namespace) -> int:
    case = _load(options)
    checked = actions.check(case)
    print(checked.description)
    if options.mesh or options.output:
        configure_log("info", sys.stderr)
        checked = actions.check(case, meshed=True)
    print(checked.size)
    if case.config.geometry.placement_details:
        program = shlex.quote(os.environ.get("MANTLE_CALLED", "mantle"))
        name = shlex.quote(str(options.case))
        print(f"to place the stem by eye:\n  {program} place {name}")
        # The stem of a patient is checked when the case is read.
        if case.config.geometry.kind == "femur" and not (options.mesh or options.output):
            print(f"to check that the stem fits:\n  {program} check {name} --mesh")
    if options.output:
        from app.report import case_picture

        prepare_run(options.output, force=True)
        path = options.output / f"{options.case.stem}.png"
        case_picture.draw(case.config, actions.mesh(case), path)
        print(path)
    for note in checked.notes:
        print(painted(note, note.tone, sys.stderr), file=sys.stderr)
    return 0


def _mesh(options: argparse.Namespace) -> int:
    case = _load(options)
    memory.check(case.file, case.config)
    deck = options.output if options.output and options.output.suffix == ".inp" else None
    folder = deck.parent if deck else options.output or Path("out")
    prepare_run(folder, force=True)
    path = deck or folder / f"{options.case.stem}.msh"
    configure_log("info", sys.stderr)
    log.info("meshing")
    data = actions.mesh(case)
    if deck:
        with stack_needed():
            from app.simulation import calculix
        for line in calculix.write(case, data, deck):
            print(painted(f"note: {line}", "doubtful", sys.stderr), file=sys.stderr)
        print(deck)
        return 0
    from app.plots import sections, surface_views
    from app.report import case_picture

    draw_case = partial(case_picture.draw, case.config)
    drawings: dict[Path, Callable[..., None]] = {path.with_suffix(".png"): draw_case}
    if case.config.geometry.mantles or case.config.geometry.laws_to_write:
        for name, draw in (
            ("sections", sections.draw_sections),
            ("interfaces", surface_views.draw_interfaces),
        ):
            file = path.with_name(f"{path.stem}_{name}.png")
            is_mirrored = case.config.geometry.is_mirrored
            drawings[file] = partial(draw, title=surface_views.MIRRORED if is_mirrored else "")
    with writing(path):
        meshes.write_msh(data, path)
        print(path)
        for file, draw in drawings.items():
            draw(data, file)
            print(file)
    print(cost.exact_size(case.config, data, memory.available_memory()))
    for message in data.notes.get("messages", ()):
        print(f"note: {message}")
    return 0


def _place(options: argparse.Namespace) -> int:
    from app.report import placement_page

    source = _case_path(options.case)
    file = overlay.read(source, options.overrides)
    # A stem without room is no fault here: it is to be placed.
    case, faults = valid_parts(file.data, source.parent)
    insertion = ("geometry", "insertion")
    unplaced = [f for f in faults if f.path[:2] == insertion and f.text.startswith(NO_POSITION)]
    if unplaced:
        case, faults = valid_parts(_unsearched(file.data), source.parent)
    file.raise_all(faults)
    for fault in unplaced:
        line = verdict.note(
            f"{fault.text}. The page shows the stem at the position as given", "insertion: best"
        )
        print(painted(line, "doubtful", sys.stderr), file=sys.stderr)
    page = options.output or Path("out") / f"{source.stem}-place.html"
    with file.placing():
        print(placement_page.write(case, source, page))
    return 0


def _unsearched(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return a case whose stem is in its given position, which is not searched."""
    geometry = dict(data["geometry"])
    insertion = geometry.pop("insertion")
    if isinstance(insertion, Mapping):
        geometry["insertion"] = {key: v for key, v in insertion.items() if key != "best"}
    return {**data, "geometry": geometry}


def _campaign(options: argparse.Namespace) -> int:
    configure_log("info")
    from app.campaigns import study, sweep

    module, path = (sweep, options.sweep) if options.command == "sweep" else (study, options.case)
    folder = Path("out") / f"{path.stem}-{options.command}"
    module.run(path, options.overrides, _batch_options(options, folder))
    return 0


def _fit(options: argparse.Namespace) -> int:
    configure_log("info")
    from app.campaigns import fit, fit_verdicts
    from app.report import fit_report

    batch_options = _batch_options(options, Path("out") / f"{options.fit.stem}-fit")
    record = fit.run(options.fit, options.overrides, batch_options)
    if record is not None:
        print(fit_report.write(batch_options.folder))
        fit_verdicts.raise_faults(record)
    return 0


def _suite(options: argparse.Namespace) -> int:
    """Run a suite; 1 if a problem fails."""
    configure_log("info")
    from app.verification import suite

    if options.command == "verify":
        with stack_needed():
            problem = doctor.wrong_blas()
        if problem:
            raise EnvironmentProblem(problem)
    batch_options = _batch_options(options, Path("out") / options.command)
    return 0 if suite.run(options.command, batch_options) else CHECK_FAILED


def _validate(options: argparse.Namespace) -> int:
    """Run experiments; 1 if this version computes other values than the committed predictions."""
    configure_log("info")
    from app.validation import campaign

    batch_options = _batch_options(options, Path("out") / "validate")
    return 0 if campaign.run(batch_options, record=options.record) else CHECK_FAILED


def _batch_options(options: argparse.Namespace, folder: Path) -> Options:
    from app.campaigns.batch import Options

    return Options(
        folder=options.output or folder,
        cores=options.cores,
        pattern=getattr(options, "pattern", ""),
        tier=getattr(options, "tier", "default"),
        slurm=None if options.slurm is None else shlex.split(options.slurm),
        dry_run=options.dry_run,
    )


def _report(options: argparse.Namespace) -> int:
    configure_log("info")
    with stack_needed():
        from app.report import compare, evidence, fit_report, motion, run_report, sweep_report

    folder, *further_folders = options.folders
    several_folders = further_folders and not options.evidence
    if options.spread and (several_folders or not (folder / "case.yaml").exists()):
        raise InputError("--spread: expected one DIR, the folder of a run")
    if options.field and not options.gif:
        raise InputError("--field: is the field of a film; expected --gif FILE with it")
    if options.gif:
        if further_folders:
            raise InputError("--gif: expected one DIR, the folder of a run")
        print(motion.write(folder, options.gif, options.field or ""))
        return 0
    if options.evidence or options.methods:
        files = evidence.write(options.folders, options.spread) if options.evidence else []
        files += [evidence.methods(folder)] if options.methods else []
        print(*files, sep="\n")
        return 0
    if further_folders:
        page = options.output or Path("out")
        prepare_run(page, force=True)
        print(compare.write(options.folders, page / "compare.html"))
        return 0
    if run_report.is_run(folder):
        for path in run_report.write(folder, spread=options.spread):
            print(path)
        return 0
    if (folder / fit_report.RECORD).exists():
        print(fit_report.write(folder))
        return 0
    files, cases = sweep_report.run(folder)
    print(f"{sum(c.done for c in cases)} of {len(cases)} cases have results")
    print(f"{files[0]}, and {len(files) - 1} files in {folder / sweep_report.PICTURES}")
    return 0


def _explain(options: argparse.Namespace) -> int:
    if options.schema:
        print(json.dumps(keys.json_schema(), indent=2, ensure_ascii=False))
    else:
        print(explanations.explained(" ".join(options.key), options_of_commands()))
    return 0


def _doctor(options: argparse.Namespace) -> int:
    print(doctor.report_on_machine())
    return 0


COMMANDS: dict[str, Callable[[argparse.Namespace], int]] = {
    "init": _init,
    "check": _check,
    "mesh": _mesh,
    "place": _place,
    "study": _campaign,
    "sweep": _campaign,
    "fit": _fit,
    "report": _report,
    "verify": _suite,
    "stress": _suite,
    "bench": _suite,
    "validate": _validate,
    "explain": _explain,
    "doctor": _doctor,
}
