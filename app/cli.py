"""The command line: ``mantle run | check | mesh | study | sweep | report | verify | ...``.

The one module that prints to standard output. It imports what a command needs when it needs it, so
that ``check`` works without MPI and starts at once.

Exit codes: 0 ok, 1 a verification problem fails or a benchmark cannot be measured, 2 input,
3 geometry or mesh, 4 not converged, 5 stopped, 69 environment, 70 internal.
"""

from __future__ import annotations

import argparse
import io
import os
import shlex
import sys
import textwrap
import time
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn, TextIO

from mantle import __version__
from mantle.errors import AloneError, EnvironmentProblem, InputError, MantleError, together
from mantle.schema import gmsh_file
from mantle.system import ranks

INTERNAL_ERROR = 70
STOPPED = 5
CHECK_FAILED = 1
GRACE = 1.0
# The rank of this process, by whatever started it; MPI itself is not up yet when input is checked.
RANK_VARIABLES = ("OMPI_COMM_WORLD_RANK", "PMIX_RANK", "PMI_RANK", "SLURM_PROCID")


def rank() -> int:
    """The MPI rank of this process as far as the environment tells, else 0."""
    for name in RANK_VARIABLES:
        if (value := os.environ.get(name, "")).isdigit():
            return int(value)
    return 0


class Parser(argparse.ArgumentParser):
    """Argparse that raises instead of leaving, and speaks on one rank only."""

    def error(self, message: str) -> NoReturn:
        """Report a wrong command line.

        Raises:
            InputError: Always.
        """
        raise InputError(f"{self.prog}: {message}; see {self.prog} --help")

    def _print_message(self, message: str, file: Any = None) -> None:
        if rank() == 0:
            super()._print_message(message, file)


def parser() -> argparse.ArgumentParser:
    """The commands and their options."""
    top = Parser(
        prog="mantle",
        description="Thermomechanics of cemented joint replacements.",
        epilog="exit codes: 0 ok, 1 a verification problem fails or a benchmark cannot be "
        "measured, 2 input, 3 geometry or mesh, 4 not converged, 5 stopped with the state saved, "
        "69 environment, 70 internal error",
        allow_abbrev=False,
    )
    top.add_argument("--version", action="version", version=f"mantle {__version__}")
    commands = top.add_subparsers(
        dest="command", required=True, metavar="COMMAND", parser_class=Parser
    )

    def add(name: str, summary: str, **more: Any) -> argparse.ArgumentParser:
        return commands.add_parser(
            name,
            help=summary,
            description=f"{summary[0].upper()}{summary[1:]}.",
            allow_abbrev=False,
            **more,
        )

    def add_file(command: argparse.ArgumentParser, name: str, what: str, key: str) -> None:
        command.add_argument(name, type=Path, metavar=name.upper(), help=f"{what}, a YAML file")
        command.add_argument(
            "--set",
            dest="overrides",
            action="append",
            default=[],
            metavar="KEY=VALUE",
            help=f"override {key}, e.g. mesh.size=2mm or regions.stem.rigid=true (repeatable)",
        )
        command.add_argument(
            "--allow-scripts",
            action="store_true",
            help="mesh .geo scripts that do not come with mantle: they can run any program",
        )

    def add_case(command: argparse.ArgumentParser) -> None:
        add_file(command, "case", "the case", "a key")

    run = add(
        "run",
        "solve a case",
        usage="mantle run CASE [-o DIR] [--set KEY=VALUE] [-n N] [--force | --keep] [--error] "
        "[--restart auto|FILE] [--walltime H:MM:SS] [--allow-scripts] [-- PETSC OPTIONS]",
        epilog="What follows -- goes to PETSc, e.g. -- -ksp_monitor -log_view",
    )
    add_case(run)
    run.add_argument("-o", "--output", type=Path, metavar="DIR", help="default: out/<name of CASE>")
    run.add_argument("-n", metavar="N", help="number of MPI ranks (default 1)")
    existing = run.add_mutually_exclusive_group()
    existing.add_argument(
        "--force",
        action="store_true",
        help="replace results in the output folder; take a checkpoint of another configuration",
    )
    existing.add_argument(
        "--keep",
        action="store_true",
        help="the same, but leave what is finished with this very configuration",
    )
    run.add_argument(
        "--restart",
        metavar="auto|FILE",
        help="go on from a checkpoint: from the newest in the output folder, or from FILE",
    )
    run.add_argument(
        "--walltime",
        metavar="H:MM:SS",
        help="stop in time, with the state saved and exit code 5",
    )
    run.add_argument(
        "--error",
        action="store_true",
        help="estimate the error of each number by coarser companions (as output.error: true)",
    )
    run.add_argument(
        "--log-level",
        choices=("debug", "info", "warning", "error"),
        default="info",
        help="how much to tell (default info)",
    )
    check = add("check", "check a case and estimate its size, without solving")
    add_case(check)
    check.add_argument("--mesh", action="store_true", help="make the mesh and give exact sizes")
    mesh = add("mesh", "make the mesh of a case, a .msh file and a picture of sections through it")
    add_case(mesh)
    mesh.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="PATH",
        help="a folder, or a file name ending in .msh (default: out/<name of CASE>.msh)",
    )
    mesh.add_argument(
        "--pictures",
        type=Path,
        metavar="DIR",
        help="also draw a stem's mantle: DIR/sections.png and DIR/interfaces.png",
    )
    study = add("study", "error against run time of a case, by its study section")
    add_case(study)
    study.add_argument(
        "-o", "--output", type=Path, metavar="DIR", help="default: out/<name of CASE>-study"
    )
    sweep = add("sweep", "run many cases of one base case, and compare them")
    add_file(sweep, "sweep", "what varies", "a key of every case")
    sweep.add_argument("-o", "--output", type=Path, metavar="DIR", help="default: out/<name>-sweep")
    sweep.add_argument(
        "--dry-run", action="store_true", help="list the cases and what they would cost"
    )
    sweep.add_argument(
        "--slurm",
        nargs="?",
        const="",
        metavar="OPTIONS",
        help="run each case as a Slurm job, with these further options of sbatch in one word, "
        "e.g. --slurm='--partition=long --time=2:00:00'",
    )
    report = add("report", "figures, tables and verdicts of a sweep, as a page")
    report.add_argument("folder", type=Path, metavar="DIR", help="written by mantle sweep")
    verify = add("verify", "solve the verification problems and compare with what is known")
    verify.add_argument("-k", dest="pattern", default="", metavar="NAME", help="only these")
    verify.add_argument("-o", "--output", type=Path, default=Path("out/verify"), metavar="DIR")
    verify.add_argument("--fine", action="store_true", help="finer meshes too, for the orders")
    stress = add("stress", "stiff and extreme cases: right, refused with a reason, or wrong")
    stress.add_argument("-k", dest="pattern", default="", metavar="NAME", help="only these")
    stress.add_argument("-o", "--output", type=Path, default=Path("out/stress"), metavar="DIR")
    stress.add_argument("--full", action="store_true", help="the long ones too")
    bench = add("bench", "measure what contact costs, from 50 000 unknowns up (20 minutes)")
    bench.add_argument("-k", dest="pattern", default="", metavar="NAME", help="only these")
    bench.add_argument("-o", "--output", type=Path, default=Path("out/bench"), metavar="DIR")
    bench.add_argument("--full", action="store_true", help="a million unknowns too")
    for command in (study, sweep, verify, stress):
        command.add_argument(
            "--cores",
            type=int,
            default=len(os.sched_getaffinity(0)),
            metavar="N",
            help="cores to use (default: all that this process may)",
        )
    add("schema", "print the JSON schema of case files, for editors")
    add("doctor", "tell what mantle finds on this machine: MPI, BLAS, compiler, threads")
    return top


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        arguments: The command line without the program's name; that of the process by default.

    Returns:
        The exit code.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):
        # Paths can hold what is no text.
        sys.stdout.reconfigure(line_buffering=True, errors="backslashreplace")
    os.environ["OMP_NUM_THREADS"] = os.environ.get("OMP_NUM_THREADS") or "1"
    ranks.find_program()
    ranks.keep_quiet()
    ranks.end_with_parent()
    try:
        return _dispatch(list(sys.argv[1:] if arguments is None else arguments))
    except MantleError as error:
        return _leave(error)
    except KeyboardInterrupt:
        if rank() == 0:
            print("stopped", file=sys.stderr, flush=True)
        _abort(STOPPED)
        return STOPPED
    except BrokenPipeError:
        _silence(sys.stdout)
        return 0
    except Exception as error:
        if (problem := _explain(error)) is not None:
            return _leave(problem)
        print(
            f"mantle: internal error on rank {rank()}; please report it with what follows\n"
            + traceback.format_exc(),
            file=sys.stderr,
            flush=True,
        )
        _abort(INTERNAL_ERROR)
        return INTERNAL_ERROR


def _explain(error: Exception) -> EnvironmentProblem | None:
    """The machine's part in an error, if it has any."""
    from mantle.soundness import sizing
    from mantle.system import form_cache

    if (problem := sizing.explain(error) or form_cache.explain(error)) is not None:
        return problem
    if type(error).__name__ == "LinAlgError":
        from mantle.system import blas_check

        return blas_check.problem()
    return None


def _leave(error: MantleError) -> int:
    """Say what is wrong, once, and leave together; ranks that do not come too are ended.

    Returns:
        The exit code.
    """
    if rank() == 0:
        print(error, file=sys.stderr, flush=True)
    else:
        # The first rank to leave has mpirun end the others, of which one is about to speak.
        time.sleep(GRACE)
    world = _world()
    if world is not None and (isinstance(error, AloneError) or not together(world)):
        if rank() != 0:
            print(f"rank {rank()}: {error}", file=sys.stderr, flush=True)
        _abort(error.exit_code)
    return error.exit_code


def _world() -> Any:
    """The communicator of all ranks, if there are others."""
    mpi = sys.modules.get("mpi4py.MPI")
    if mpi is None or not mpi.Is_initialized() or mpi.Is_finalized():
        return None
    return mpi.COMM_WORLD if mpi.COMM_WORLD.size > 1 else None


def _abort(code: int) -> None:
    """End all ranks, if there are others: they may be waiting for this one."""
    if (world := _world()) is not None:
        sys.stdout.flush()
        world.Abort(code)


def _dispatch(arguments: list[str]) -> int:
    """Parse the command line and call the command."""
    count, rest = ranks.split(arguments)
    cut = rest.index("--") if "--" in rest else len(rest)
    petsc_options = rest[cut + 1 :]
    options = parser().parse_args(rest[:cut])
    if count is not None and options.command != "run":
        hint = "; --cores N uses N cores" if "cores" in options else ""
        raise InputError(
            f"mantle {options.command}: -n {count}: only mantle run starts ranks{hint}"
        )
    if getattr(options, "allow_scripts", False):
        os.environ[gmsh_file.ALLOWED] = "1"
    if petsc_options and options.command != "run":
        raise InputError(f"mantle {options.command}: there is nothing to solve that -- could tune")
    match options.command:
        case "run":
            return _run(options, petsc_options, count, rest)
        case "check":
            return _check(options)
        case "mesh":
            return _mesh(options)
        case "study":
            return _study(options)
        case "sweep":
            return _sweep(options)
        case "report":
            return _report(options)
        case "verify":
            return _verify(options)
        case "stress":
            return _stress(options)
        case "bench":
            return _bench(options)
        case "schema":
            return _schema()
        case _:
            return _doctor()


def _run(
    options: argparse.Namespace, petsc_options: list[str], count: int | None, rest: list[str]
) -> int:
    """Solve a case, on several ranks if asked for."""
    size = ranks.world_size()
    # The input is checked before ranks are started: its errors come at once, and once.
    options.overrides += ["output.error=true"] if options.error else []
    file, case = _case(options)
    output = options.output or Path("out") / options.case.stem
    from mantle.system import folders, stopping

    walltime = stopping.seconds(options.walltime) if options.walltime else None
    if options.restart not in (None, "auto") and case.variations:
        raise InputError("--restart FILE: a case of variations has one for each; allowed: auto")
    keep = options.keep or (options.restart == "auto" and not options.force)
    folders.prepare_run(output, options.force or keep or bool(options.restart))
    if keep:
        from mantle.simulation import keep_finished

        if keep_finished.everything(output, case, options.case, options.overrides):
            if rank() == 0:
                print(f"{output} is finished already")
            return 0
    if size is None and count is not None and count > 1:
        return ranks.launch(count, [sys.executable, "-m", "mantle", *rest])
    if size is not None and count not in (None, size) and rank() == 0:
        print(f"mantle: -n {count} is ignored: there are {size or 'some'} ranks", file=sys.stderr)
    _configure_log(options.log_level)
    if size is None:
        ranks.alone()
    from mantle.system import form_cache

    if rank() == 0:
        form_cache.mend()
    with _stack():
        from mantle.simulation.session import run

        form_cache.share()
    with file.placing():
        return run(
            case,
            options.case,
            output,
            petsc_options,
            options.overrides,
            keep,
            options.restart or "",
            options.force,
            walltime,
        )


def _case(options: argparse.Namespace) -> tuple[Any, Any]:
    """The file, and the case in it, which has to fit this machine."""
    from mantle.schema import case_file, config
    from mantle.soundness import sizing

    file = case_file.read(options.case, options.overrides)
    case = config.resolve(file, options.case.parent)
    sizing.check(file, case)
    return file, case


def _check(options: argparse.Namespace) -> int:
    """Tell how a case was understood."""
    from mantle.schema import case_file, config
    from mantle.soundness import preview, sizing

    file = case_file.read(options.case, options.overrides)
    case = config.resolve(file, options.case.parent)
    print(preview.describe(case, file.data))
    notes = preview.warnings(case)
    if options.mesh:
        sizing.check(file, case)
        data = _build(case)
        print(preview.exact_size(case, data))
        with _stack():
            from mantle.soundness import case_on_mesh
        with file.placing():
            notes += case_on_mesh.judge(case, case_on_mesh.look(case, data))
    else:
        print(preview.estimated_size(case))
    for message in notes:
        print(f"note: {message}", file=sys.stderr)
    return 0


def _mesh(options: argparse.Namespace) -> int:
    """Write the mesh and a picture of it."""
    _, case = _case(options)
    if options.pictures and not case.geometry.mantles:
        raise InputError("--pictures: only of stems with a mantle of cement; this case has none")
    path = _mesh_path(options.output, options.case.stem)
    data = _build(case)
    from mantle import meshes
    from mantle.meshes.picture import picture
    from mantle.soundness import preview

    try:
        meshes.write_msh(data, path)
        print(path)
        picture(data, path.with_suffix(".png"))
        print(path.with_suffix(".png"))
    except OSError as error:
        raise InputError(f"-o {path}: cannot be written: {error.strerror}") from error
    if options.pictures:
        _mantle_pictures(data, options.pictures)
    print(preview.exact_size(case, data))
    return 0


def _mantle_pictures(data: Any, folder: Path) -> None:
    """Draw the sections and the interfaces of a mantle.

    Raises:
        InputError: They cannot be written.
    """
    from mantle.meshes import mantle_picture

    try:
        folder.mkdir(parents=True, exist_ok=True)
        for draw in (mantle_picture.sections, mantle_picture.interfaces):
            path = folder / f"{draw.__name__}.png"
            draw(data, path)
            print(path)
    except OSError as error:
        raise InputError(f"--pictures {folder}: cannot be written: {error.strerror}") from error


def _mesh_path(output: Path | None, stem: str) -> Path:
    """The file to write the mesh to; its folder is made.

    Raises:
        InputError: It cannot be written.
    """
    path = output or Path("out") / f"{stem}.msh"
    if path.is_dir() or path.suffix != ".msh":
        path = path / f"{stem}.msh"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"-o {path.parent}: cannot be made: {error.strerror}") from error
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise InputError(f"-o {path}: is not writable")
    return path


def _build(case: Any) -> Any:
    """The mesh of a case, cached."""
    with _stack():
        import gmsh  # noqa: F401  (only to tell early that it is missing)
    from mantle import meshes
    from mantle.system import folders

    return meshes.build(case.geometry, case.mesh, folders.cache("meshes"))


def _study(options: argparse.Namespace) -> int:
    """Error against run time of a case."""
    _configure_log("info")
    from mantle.campaigns import study

    output = options.output or Path("out") / f"{options.case.stem}-study"
    study.run(options.case, options.overrides, output, options.cores)
    return 0


def _sweep(options: argparse.Namespace) -> int:
    """Run the cases of a sweep."""
    _configure_log("info")
    from mantle.campaigns import sweep

    output = options.output or Path("out") / f"{options.sweep.stem}-sweep"
    if options.dry_run:
        print(sweep.plan(options.sweep, options.overrides, output, options.cores))
    else:
        slurm = None if options.slurm is None else shlex.split(options.slurm)
        sweep.run(options.sweep, options.overrides, output, options.cores, slurm)
    return 0


def _report(options: argparse.Namespace) -> int:
    """Write the report of a sweep; say where, and how the paper's trends fare."""
    _configure_log("info")
    with _stack():
        from mantle.report import sweep_report

    written = sweep_report.run(options.folder)
    wide = max((len(t.name) for t in written.trends), default=0)
    for t in written.trends:
        by_maxima = f" (by maxima {t.peaks})" if t.peaks else ""
        claim = textwrap.shorten(t.claim, 90, placeholder=" ...")
        print(f"{t.name:<{wide}}  {t.verdict + by_maxima:<32}  {claim}")
    print(f"{written.done} of {written.cases} cases have results")
    page, *others = written.files
    print(f"{page}, and {len(others)} files in {page.parent / sweep_report.PICTURES}")
    return 0


def _verify(options: argparse.Namespace) -> int:
    """Compare with what is known; 1 if a problem fails."""
    _configure_log("info")
    from mantle.verification import verify

    passed = verify.run(options.pattern, options.output, options.fine, options.cores)
    return 0 if passed else CHECK_FAILED


def _stress(options: argparse.Namespace) -> int:
    """Stiff and extreme cases; 1 if any is wrong or fails unexplained."""
    _configure_log("info")
    from mantle.verification import extremes

    stable = extremes.run(options.pattern, options.output, options.full, options.cores)
    return 0 if stable else CHECK_FAILED


def _bench(options: argparse.Namespace) -> int:
    """Measure what contact costs; 1 if anything cannot be measured."""
    _configure_log("info")
    from mantle.verification import bench

    measured = bench.run(options.pattern, options.output, options.full)
    return 0 if measured else CHECK_FAILED


def _schema() -> int:
    """Print the schema."""
    import json

    from mantle.schema import config

    print(json.dumps(config.schema(), indent=2, ensure_ascii=False))
    return 0


def _doctor() -> int:
    """Print what is found on this machine."""
    from mantle.system import doctor

    print(doctor.report())
    return 0


def _silence(stream: TextIO) -> None:
    """The reader of a stream (head, less) has left: there is nobody to say anything to."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _configure_log(level: str) -> None:
    """Send progress to standard output and warnings to standard error, from rank 0 only."""
    import logging

    logger = logging.getLogger("mantle")
    logger.propagate = False
    logger.setLevel(level.upper() if rank() == 0 else logging.CRITICAL)

    class Handler(logging.StreamHandler[TextIO]):
        """Goes on without its reader: what a run is for stands in its folder."""

        def handleError(self, record: logging.LogRecord) -> None:
            if isinstance(sys.exc_info()[1], BrokenPipeError):
                _silence(self.stream)
            else:
                super().handleError(record)

    progress, trouble = Handler(sys.stdout), Handler(sys.stderr)
    progress.addFilter(lambda record: record.levelno < logging.WARNING)
    trouble.setLevel(logging.WARNING)
    logger.handlers = [progress, trouble]


class _stack:
    """Turns a missing package of the solver stack into an environment problem."""

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, ModuleNotFoundError) and not (error.name or "").startswith("mantle"):
            raise EnvironmentProblem(
                f"the package {error.name} is missing; ./mantle doctor tells what is there"
            ) from error
