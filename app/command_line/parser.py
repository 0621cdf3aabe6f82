"""The grammar of the command line: every command with its options."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from app.errors import InputError
from app.system.ranks import rank
from app.version import __version__

# Options and commands of earlier versions, and the words that replace them; until 0.2.
REMOVED = {
    "run --goal": "use --error, or a finer mesh",
    "run --adapt": "use --error, or a finer mesh",
    "run --isolate": "use the container: docker run --network none --read-only",
    "run --private": "provenance.json has neither host nor command line any more",
    "bench --peers": "docs/verification.md has what was measured",
    "doctor --sbom": "use dpkg-query -W and pip list",
}


def refuse_removed(arguments: Sequence[str]) -> None:
    """Say what replaces a command or option that an earlier version had.

    Raises:
        InputError: The command line has one.
    """
    command = arguments[0] if arguments else ""
    for word in [command, *(f"{command} {a.partition('=')[0]}" for a in arguments[1:])]:
        if word in REMOVED:
            raise InputError(f"mantle {word} has been removed: {REMOVED[word]}")


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
            help="mesh .geo scripts that do not come with mantle; a script is a program",
        )

    def add_case(command: argparse.ArgumentParser) -> None:
        add_file(command, "case", "the case", "a key")

    def add_many(command: argparse.ArgumentParser, folder: str) -> None:
        command.add_argument("-o", "--output", type=Path, metavar="DIR", help=f"default: {folder}")
        command.add_argument(
            "--cores",
            type=int,
            default=len(os.sched_getaffinity(0)),
            metavar="N",
            help="cores to use (default: all that this process may)",
        )
        command.add_argument(
            "--dry-run", action="store_true", help="list the runs and what they would cost"
        )
        command.add_argument(
            "--slurm",
            nargs="?",
            const="",
            metavar="OPTIONS",
            help="make each run a Slurm job, with these further options of sbatch in one word, "
            "e.g. --slurm='--partition=long --time=2:00:00'",
        )

    init = add("init", "write a short case to start from; it runs as it is")
    init.add_argument("name", type=Path, metavar="NAME", help="the case, NAME.yaml")
    init.add_argument(
        "--kind",
        choices=("femur", "cylinders", "blocks", "file"),
        default="femur",
        help="its geometry (default femur, standing on one leg); file: a mesh of gmsh",
    )
    init.add_argument(
        "--stem",
        choices=("titanium", "cocr", "steel"),
        default="",
        help="what the stem is made of (default titanium)",
    )
    init.add_argument(
        "--mesh", type=Path, metavar="FILE", help="the mesh of --kind file (default NAME.msh)"
    )
    run = add(
        "run",
        "solve a case",
        usage="mantle run CASE [-o DIR] [--set KEY=VALUE] [-n N] [--force | --keep] [--error] "
        "[--restart auto|FILE] [--walltime H:MM:SS] "
        "[--allow-scripts] [-- PETSC OPTIONS]",
        epilog="What follows -- goes to PETSc, e.g. -- -ksp_monitor -ksp_view",
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
        help="how much to tell (default info); debug: also what libraries print",
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
    sweep = add("sweep", "run many cases of one base case, and compare them")
    add_file(sweep, "sweep", "what varies", "a key of every case")
    report = add("report", "the results of a run or a sweep as a page, report.html")
    report.add_argument("folder", type=Path, metavar="DIR", help="written by mantle run or sweep")
    compare = add("compare", "runs side by side in one page, compare.html: fields and numbers")
    compare.add_argument("folders", type=Path, nargs="+", metavar="DIR", help="of mantle run")
    compare.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("out/compare.html"),
        metavar="FILE",
        help="default: out/compare.html; an older one is replaced",
    )
    verify = add("verify", "solve the verification problems and compare with what is known")
    stress = add("stress", "stiff and extreme cases: right, refused with a reason, or wrong")
    bench = add("bench", "measure what contact costs, from 20 000 unknowns up (20 minutes)")
    add_many(study, "out/<name of CASE>-study")
    add_many(sweep, "out/<name>-sweep")
    suites = {
        verify: ("verify", "--fine"),
        stress: ("stress", "--full"),
        bench: ("bench", "--full"),
    }
    for command, (name, old) in suites.items():
        add_many(command, f"out/{name}")
        command.add_argument(old, action="store_true", help=argparse.SUPPRESS)  # until 0.2
    for command, what in (
        (study, "lines of this name"),
        *((suite, "checks of this name") for suite in suites),
    ):
        command.add_argument(
            "-k", dest="pattern", default="", metavar="NAME", help=f"only {what}, or a part of it"
        )
        command.add_argument(
            "--tier",
            choices=("quick", "default", "long"),
            default="default",
            help="how much: what takes seconds, the usual, or also what takes long",
        )
    library = add("library", "list the materials and loads that have names, or print one")
    library.add_argument(
        "name", nargs="?", default="", metavar="NAME", help="print it with its source"
    )
    library.add_argument("--file", type=Path, metavar="FILE", help="a library of your own")
    explain = add("explain", "tell what a key of a case means: value, unit, default, an example")
    explain.add_argument("key", metavar="KEY", help="e.g. interfaces.friction_coefficient")
    schema = add("schema", "print the JSON schema of case files, for editors")
    schema.add_argument(
        "--markdown", action="store_true", help="print the reference of the keys instead, to read"
    )
    add("doctor", "tell what mantle finds on this machine: MPI, BLAS, compiler, threads")
    add("version", "print the version")
    return top
