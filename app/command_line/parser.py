"""The grammar of the command line: a table of commands and a table of arguments."""

from __future__ import annotations

import argparse
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from app import __version__
from app.foundation.errors import EXIT_CODES, InputError
from app.schema.section import did_you_mean
from app.system.ranks import rank

if TYPE_CHECKING:
    from _typeshed import SupportsWrite

# Last lines of ``mantle --help``.
EPILOG = """\
first steps:
  mantle init hip                  write a case, hip.yaml
  mantle check hip.yaml            describe it, estimate its size
  mantle run hip.yaml -o out/hip   solve it; then open out/hip/report.html
  mantle explain friction          explain a key, a result or a term

exit codes:
"""
EPILOG += "\n".join(f"{code:>4}  {meaning}" for code, meaning in EXIT_CODES.items())


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
CASE_ARGUMENTS = "case --set --allow-scripts"
MANY = "-o --cores --dry-run --slurm"
SUITE = f"{MANY} -k --tier"
# Each command: its help and its arguments.
COMMANDS = {
    "init": (
        "write a short case file to start from; it runs as it is",
        "name --kind --stem --cementless --labels --ct --side --label",
    ),
    "run": (
        "solve a case and write its results, with a page report.html",
        f"{CASE_ARGUMENTS} -o -n --force --restart --walltime --error --accuracy -v",
    ),
    "check": (
        "check and describe a case and estimate its size; solves nothing",
        f"{CASE_ARGUMENTS} --mesh -o",
    ),
    "mesh": ("mesh a case and draw it, or write it for CalculiX (.inp)", f"{CASE_ARGUMENTS} -o"),
    "place": (
        "write a page for a browser, in which you place the stem of a hip by eye",
        f"{CASE_ARGUMENTS} -o",
    ),
    "study": (
        "measure error against run time of a case on several meshes",
        f"{CASE_ARGUMENTS} {SUITE}",
    ),
    "sweep": (
        "run many cases that vary one base case, and compare them",
        f"sweep --set --allow-scripts {MANY}",
    ),
    "fit": (
        "find values of keys that reproduce measured numbers, or that minimize or maximize one",
        f"fit --set --allow-scripts {MANY}",
    ),
    "report": (
        "write the page and figures of a run, sweep or fit again, or compare several runs",
        "folders -o --spread --evidence --methods --gif --field",
    ),
    "verify": ("solve problems with known answers and compare", SUITE),
    "stress": (
        "solve extreme cases: each must be solved correctly or refused with a reason",
        SUITE,
    ),
    "bench": ("measure the cost of contact on meshes from 20,000 unknowns (20 minutes)", SUITE),
    "validate": (
        "predict published experiments and compare with the measurements",
        f"{SUITE} --record",
    ),
    "explain": ("explain a key, a result or a term, such as E, fixed or friction", "key --schema"),
    "doctor": ("check this machine: MPI, BLAS, compiler, threads", ""),
}
OUTPUTS = {
    "check": "also mesh the case and draw it: FOLDER/<name of CASE>.png",
    "fit": "folder of the results, default: out/<name of FIT>-fit",
    "mesh": "folder of <name of CASE>.msh, default: out; or NAME.inp, a CalculiX deck of the case",
    "place": "the page, default: out/<name of CASE>-place.html",
    "report": "folder of compare.html, for several runs; default: out",
    "run": "folder of the results, default: out/<name of CASE>",
    "study": "folder of the results, default: out/<name of CASE>-study",
    "sweep": "folder of the results, default: out/<name of SWEEP>-sweep",
}
ARGUMENTS: dict[str, dict[str, Any]] = {
    "name": dict(type=Path, metavar="NAME", help="name of the new case: writes NAME.yaml"),
    "case": dict(
        type=Path,
        metavar="CASE",
        help="case file (YAML), or the name of a shipped case, such as stance",
    ),
    "sweep": dict(
        type=Path, metavar="SWEEP", help="sweep file (YAML): a base case and the keys that vary"
    ),
    "fit": dict(
        type=Path, metavar="FIT", help="fit file (YAML): a base case, keys with bounds, and an aim"
    ),
    "folders": dict(
        type=Path,
        nargs="+",
        metavar="DIR",
        help="folder that mantle run, sweep or fit has written; several folders of runs are "
        "compared",
    ),
    "key": dict(
        nargs="*",
        metavar="WORD",
        help="a key such as interfaces.friction_coefficient; a result such as slip; a term such as "
        "mesh size; a name of the library; 'materials', 'loads' or 'contexts' for lists",
    ),
    "--evidence": dict(
        action="store_true",
        help="write the 25 credibility factors of a run with their grades: evidence.html and "
        ".json; further folders are those of mantle verify, --spread is a sweep of the case",
    ),
    "--methods": dict(
        action="store_true", help="write the methods section of a paper on a run: methods.md"
    ),
    "-o": dict(dest="output", type=_folder, metavar="FOLDER"),
    "-n": dict(
        type=_number_of_ranks, default=1, metavar="N", help="number of MPI ranks (default 1)"
    ),
    "-k": dict(
        dest="pattern",
        default="",
        metavar="NAME",
        help="only problems or runs with NAME in their names",
    ),
    "-v": dict(
        dest="verbose",
        action="store_true",
        help="print more: each phase, and the output of libraries",
    ),
    "--set": dict(
        dest="overrides",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="change a key, e.g. mesh.size=2mm or regions.stem.rigid=true (repeatable)",
    ),
    "--allow-scripts": dict(
        action="store_true",
        help="run gmsh scripts (.geo) that do not come with mantle; a script is a program",
    ),
    "--force": dict(
        action="store_true",
        help="replace results in the output folder; accept a checkpoint of another case",
    ),
    "--restart": dict(
        metavar="auto|FILE",
        default="",
        help="continue from the newest checkpoint in the output folder (auto), or from FILE",
    ),
    "--walltime": dict(
        metavar="TIME",
        help="save the state and stop with exit code 5 before TIME: 2:00:00, 90 min or 2 h",
    ),
    "--error": dict(
        action="store_true",
        help="estimate the error of each number by coarser runs (as output.error: true)",
    ),
    "--accuracy": dict(
        metavar="SHARE", help="choose mesh size and order for a largest relative error, e.g. 0.05"
    ),
    "--mesh": dict(
        action="store_true",
        help="make the mesh and count instead of estimating (always with probes or paths)",
    ),
    "--kind": dict(
        choices=("femur", "cylinders", "blocks", "head_cup", "file"),
        help="geometry (default: femur, standing on one leg); file: your own mesh, NAME.msh",
    ),
    "--stem": dict(
        choices=("titanium", "cocr", "steel"),
        default="",
        help="material of the stem (default: titanium)",
    ),
    "--cementless": dict(
        action="store_true",
        help="a stem without cement that fills the canal, of a femur or with --labels",
    ),
    "--labels": dict(
        type=Path,
        metavar="FILE",
        help="make the case of the femur in a segmentation: NIfTI, NRRD, DICOM, or a folder with "
        "a file for each structure",
    ),
    "--ct": dict(
        type=Path, metavar="FILE", help="CT from which the labels were made; it gives the canal"
    ),
    "--side": dict(choices=("left", "right"), help="side of the femur, if --labels has both"),
    "--label": dict(metavar="NAME", help="name or number of the femur in --labels"),
    "--cores": dict(type=int, metavar="N", help="cores to use (default: all available)"),
    "--dry-run": dict(
        action="store_true", help="list the runs and their estimated cost; run nothing"
    ),
    "--slurm": dict(
        nargs="?",
        const="",
        metavar="OPTIONS",
        help="submit each run as a Slurm job, with these options of sbatch in quotes, "
        "e.g. --slurm='--partition=long --time=2:00:00'",
    ),
    "--tier": dict(
        choices=("quick", "default", "long"),
        default="default",
        help="quick: seconds; default; long: also problems that take long",
    ),
    "--record": dict(
        action="store_true",
        help="write the predictions of these runs into docs/validation/predictions.json",
    ),
    "--spread": dict(
        type=Path,
        metavar="SWEEP",
        help="show the spread of a sweep over uncertain inputs next to the errors",
    ),
    "--gif": dict(
        type=Path,
        metavar="FILE",
        help="write the recorded steps of a run as a film: .gif, or .mp4 with ffmpeg",
    ),
    "--field": dict(
        metavar="NAME",
        help="the field of --gif, such as stem_cement_slip or temperature; default: the page's",
    ),
    "--schema": dict(action="store_true", help="print the JSON schema of case files, for editors"),
}
LONG_OPTIONS = {"-o": "--output"}
# Commands whose output is no folder, with the word for it.
WRITES = {"place": "FILE", "mesh": "PATH"}


def options_of_commands() -> dict[str, str]:
    """Meaning of each option of each command, by ``mantle run --restart``."""
    meanings = {}
    for command, (_, arguments) in COMMANDS.items():
        for argument in arguments.split():
            if argument.startswith("--"):
                meanings[f"mantle {command} {argument}"] = ARGUMENTS[argument]["help"]
    return meanings


class Parser(argparse.ArgumentParser):
    """Argparse that raises instead of exiting, and prints on one rank only."""

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse, and raise InputError with the command whose arguments are unknown."""
        options, unknown_arguments = self.parse_known_args(args, namespace)
        if unknown_arguments:
            command = Parser(prog=f"{self.prog} {options.command}")
            command.error(f"unrecognized arguments: {' '.join(unknown_arguments)}")
        return options

    def error(self, message: str) -> NoReturn:
        """Raise InputError for a wrong command line."""
        if message.startswith("unrecognized arguments: -n"):
            message += "; only mantle run starts ranks, --cores N uses N cores"
        unknown_command = re.search(r"COMMAND: invalid choice: '(.*?)'", message)
        if unknown_command:
            message += did_you_mean(unknown_command[1], list(COMMANDS))
        raise InputError(f"{self.prog}: {message}; see {self.prog} --help")

    def _print_message(self, message: str, file: SupportsWrite[str] | None = None) -> None:
        if rank() == 0:
            super()._print_message(message, file)


def parser() -> argparse.ArgumentParser:
    """The commands and their options."""
    main_parser = Parser(
        prog="mantle",
        description="Finite elements for cemented joint replacements: contact, heat, setting.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    main_parser.add_argument("--version", action="version", version=f"mantle {__version__}")
    commands = main_parser.add_subparsers(
        dest="command", required=True, metavar="COMMAND", parser_class=Parser
    )
    for name, (summary, arguments) in COMMANDS.items():
        command = commands.add_parser(
            name,
            help=summary,
            description=f"{summary[0].upper()}{summary[1:]}.",
            allow_abbrev=False,
        )
        for argument in arguments.split():
            options = ARGUMENTS[argument]
            if argument == "-o":
                options = options | {
                    "help": OUTPUTS.get(name, f"folder of the results, default: out/{name}")
                }
                if name in WRITES:
                    options["metavar"] = WRITES[name]
                if name == "place":
                    options["type"] = Path
            elif argument == "--cores":
                options = options | {"default": len(os.sched_getaffinity(0))}
            command.add_argument(
                *[argument, LONG_OPTIONS[argument]] if argument in LONG_OPTIONS else [argument],
                **options,
            )
    commands.choices[
        "run"
    ].epilog = "Options after -- are passed to PETSc, e.g. -- -ksp_monitor -ksp_view"
    return main_parser
