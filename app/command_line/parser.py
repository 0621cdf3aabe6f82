"""The grammar of the command line: a table of commands and a table of arguments."""

from __future__ import annotations

import argparse
import os
import re
from pathlib import Path
from typing import Any, NoReturn

from app import __version__
from app.foundation.errors import InputError
from app.schema.section import did_you_mean
from app.system.ranks import rank

EXIT_CODES = (
    "exit codes: 0 ok, 1 a verification problem fails or a benchmark cannot be measured, 2 input, "
    "3 geometry or mesh, 4 not converged, 5 stopped with the state saved, 6 solved but not to be "
    "used, 69 environment, 70 internal error"
)


def _number_of_ranks(text: str) -> int:
    if not re.fullmatch(r"[0-9]{1,6}", text) or int(text) == 0:
        raise InputError(f"-n: '{text}' is not a number of ranks; allowed: 1, 2, 3, ...")
    return int(text)


def _folder(text: str) -> Path:
    path = Path(text)
    if path.suffix[1:2].isalpha() and path.suffix != ".inp" and not path.exists():
        raise InputError(f"-o {path}: expected a folder, whose name does not end in {path.suffix}")
    return path


# Arguments of commands that read a case, of those that run many, and of suites.
CASE = "case --set --allow-scripts"
MANY = "-o --cores --dry-run --slurm"
SUITE = f"{MANY} -k --tier"
# Each command: its help and its arguments.
COMMANDS = {
    "init": ("write a short case to start from; it runs as it is", "name --kind --stem"),
    "run": ("solve a case", f"{CASE} -o -n --force --restart --walltime --error --accuracy -v"),
    "check": ("check a case and estimate its size, without solving", f"{CASE} --mesh -o"),
    "mesh": ("make the mesh of a case and pictures of it, or an .inp file", f"{CASE} -o"),
    "study": ("error against run time of a case, by a study file", f"{CASE} {SUITE}"),
    "sweep": (
        "run many cases of one base case, and compare them",
        f"sweep --set --allow-scripts {MANY}",
    ),
    "report": (
        "the page of a run, a sweep, or several runs side by side",
        "folders -o --spread --evidence --methods",
    ),
    "verify": ("solve the verification problems and compare with what is known", SUITE),
    "stress": ("stiff and extreme cases: right, refused with a reason, or wrong", SUITE),
    "bench": ("measure what contact costs, from 20 000 unknowns up (20 minutes)", SUITE),
    "explain": ("tell what a key of a case, or a name of the library, means", "key --schema"),
    "doctor": ("tell what mantle finds on this machine: MPI, BLAS, compiler, threads", ""),
}
OUTPUTS = {
    "check": "draw the case on its mesh, too: <name of CASE>.png",
    "mesh": "default: out, for <name of CASE>.msh; NAME.inp: the case, for CalculiX",
    "report": "of several runs; default: out, for compare.html",
    "run": "default: out/<name of CASE>",
    "study": "default: out/<name of the study>-study",
    "sweep": "default: out/<name>-sweep",
}
ARGUMENTS: dict[str, dict[str, Any]] = {
    "name": dict(type=Path, metavar="NAME", help="the case, NAME.yaml"),
    "case": dict(type=Path, metavar="CASE", help="the case, a YAML file"),
    "sweep": dict(type=Path, metavar="SWEEP", help="what varies, a YAML file"),
    "folders": dict(
        type=Path, nargs="+", metavar="DIR", help="written by mantle run or sweep; several: of runs"
    ),
    "key": dict(
        nargs="*",
        metavar="KEY",
        help="a key such as interfaces.friction_coefficient, a material or load of the library, or "
        "materials or loads for a list of them",
    ),
    "--evidence": dict(
        action="store_true",
        help="the credibility factors of ASME V&V 40 of a run: evidence.html and .json; further "
        "folders are of mantle verify",
    ),
    "--methods": dict(action="store_true", help="a section on methods of a run: methods.md"),
    "-o": dict(dest="output", type=_folder, metavar="FOLDER"),
    "-n": dict(
        type=_number_of_ranks, default=1, metavar="N", help="number of MPI ranks (default 1)"
    ),
    "-k": dict(dest="pattern", default="", metavar="NAME", help="only what has this in its name"),
    "-v": dict(
        dest="verbose", action="store_true", help="tell more: each phase, and what libraries print"
    ),
    "--set": dict(
        dest="overrides",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="override a key, e.g. mesh.size=2mm or regions.stem.rigid=true (repeatable)",
    ),
    "--allow-scripts": dict(
        action="store_true",
        help="mesh .geo scripts that do not come with mantle; a script is a program",
    ),
    "--force": dict(
        action="store_true",
        help="replace results in the output folder; take a checkpoint of another configuration",
    ),
    "--restart": dict(
        metavar="auto|FILE",
        default="",
        help="go on from a checkpoint: from the newest in the output folder, or from FILE",
    ),
    "--walltime": dict(
        metavar="TIME",
        help="stop in time, with the state saved and exit code 5: 2:00:00, 90 min or 2 h",
    ),
    "--error": dict(
        action="store_true",
        help="estimate the error of each number by coarser companions (as output.error: true)",
    ),
    "--accuracy": dict(metavar="PART", help="pick mesh size and order for errors below, e.g. 0.05"),
    "--mesh": dict(
        action="store_true",
        help="make the mesh and give exact sizes (always done if there are probes)",
    ),
    "--kind": dict(
        choices=("femur", "cylinders", "blocks", "head_cup", "file"),
        default="femur",
        help="its geometry (default femur, standing on one leg); file: a mesh of gmsh, NAME.msh",
    ),
    "--stem": dict(
        choices=("titanium", "cocr", "steel"),
        default="",
        help="what the stem is made of (default titanium)",
    ),
    "--cores": dict(
        type=int, metavar="N", help="cores to use (default: all that this process may)"
    ),
    "--dry-run": dict(action="store_true", help="list the runs and what they would cost"),
    "--slurm": dict(
        nargs="?",
        const="",
        metavar="OPTIONS",
        help="make each run a Slurm job, with these further options of sbatch in one word, "
        "e.g. --slurm='--partition=long --time=2:00:00'",
    ),
    "--tier": dict(
        choices=("quick", "default", "long"),
        default="default",
        help="how much: what takes seconds, the usual, or also what takes long",
    ),
    "--spread": dict(type=Path, metavar="SWEEP", help="a sweep over uncertain inputs of the run"),
    "--schema": dict(action="store_true", help="print the JSON schema of case files, for editors"),
}
LONG = {"-o": "--output"}


class Parser(argparse.ArgumentParser):
    """Argparse that raises instead of exiting, and prints on one rank only."""

    def error(self, message: str) -> NoReturn:
        """Raise InputError for a wrong command line."""
        if message.startswith("unrecognized arguments: -n"):
            message += "; only mantle run starts ranks, --cores N uses N cores"
        unknown = re.search(r"COMMAND: invalid choice: '(.*?)'", message)
        if unknown:
            message += did_you_mean(unknown[1], list(COMMANDS))
        raise InputError(f"{self.prog}: {message}; see {self.prog} --help")

    def _print_message(self, message: str, file: Any = None) -> None:
        if rank() == 0:
            super()._print_message(message, file)


def parser() -> argparse.ArgumentParser:
    """The commands and their options."""
    top = Parser(
        prog="mantle",
        description="Thermomechanics of cemented joint replacements.",
        epilog=EXIT_CODES,
        allow_abbrev=False,
    )
    top.add_argument("--version", action="version", version=f"mantle {__version__}")
    commands = top.add_subparsers(
        dest="command", required=True, metavar="COMMAND", parser_class=Parser
    )
    for name, (summary, arguments) in COMMANDS.items():
        command = commands.add_parser(
            name,
            help=summary,
            description=f"{summary[0].upper()}{summary[1:]}.",
            allow_abbrev=False,
        )
        for word in arguments.split():
            options = ARGUMENTS[word]
            if word == "-o":
                options = options | {"help": f"({OUTPUTS.get(name, f'default: out/{name}')})"}
            elif word == "--cores":
                options = options | {"default": len(os.sched_getaffinity(0))}
            command.add_argument(*[word, LONG[word]] if word in LONG else [word], **options)
    commands.choices["run"].epilog = "What follows -- goes to PETSc, e.g. -- -ksp_monitor -ksp_view"
    return top
