"""The programs of ``mantle bench --peers``: how each is given a model, run and read.

Each runs as a process of its own, on one core. Its CPU time and its memory are those of the whole
process: start, input, solution and results.
"""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from app.arrays import Floats
from app.case.case import Case, dump
from app.errors import InputError
from app.results.reading import Run
from app.verification import calculix
from app.verification.peer_model import PeerModel

# What starts a program and measures it. It is small: Linux counts the memory of what starts a
# process as the process's own.
MEASURE = """
import json, os, resource, sys, time
limit, begin = int(sys.argv[1]), time.time()
child = os.fork()
if not child:
    resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
    os.execvp(sys.argv[2], sys.argv[2:])
_, status, used = os.wait4(child, 0)
cost = {"cpu": used.ru_utime + used.ru_stime, "wall": time.time() - begin,
        "memory": used.ru_maxrss / 1024, "exit_code": os.waitstatus_to_exitcode(status)}
with open("cost.json", "w") as file:
    json.dump(cost, file)
"""
MODEL, RESULT = "model.npz", "displacement.npy"


@dataclass(frozen=True)
class Cost:
    """What a process took.

    Attributes:
        cpu: CPU seconds, of user and system.
        wall: Seconds from start to end.
        memory: Largest resident memory [MB].
        exit_code: Its exit code; negative for the signal that ended it.
    """

    cpu: float
    wall: float
    memory: float
    exit_code: int


def measured(command: list[str], folder: Path, limit: int) -> Cost:
    """Run a program in a folder and measure it; what it says goes to ``log`` there.

    Args:
        command: The program and its arguments.
        folder: Where it runs.
        limit: CPU seconds after which it is ended.
    """
    one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "CCX_NPROC_STIFFNESS"), "1")
    with (folder / "log").open("wb") as log:
        subprocess.run(
            [sys.executable, "-S", "-I", "-c", MEASURE, str(limit), *command],
            cwd=folder,
            env=os.environ | one,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            check=True,
        )
    return Cost(**json.loads((folder / "cost.json").read_text(encoding="utf-8")))


class Program(ABC):
    """A program that is measured.

    Attributes:
        name: For tables.
        key: For names of folders.
        times: How often it is run; the median of CPU time counts.
    """

    name: str
    key: str
    times = 1

    def missing(self) -> str:
        """Why it cannot be run here; empty if it can."""
        return ""

    @abstractmethod
    def command(self, model: PeerModel, case: Case, folder: Path) -> list[str]:
        """Write its input into a folder; the command that solves it there."""

    @abstractmethod
    def displacement(self, model: PeerModel, folder: Path) -> Floats:
        """The displacement of the nodes that it has found (n, 3) [mm].

        Raises:
            OSError: It has written none.
            InputError: It has not come to the end.
        """


class MantleItself(Program):
    """This program as its users call it; the mesh is made before, and forms are compiled."""

    name, key = "mantle", "mantle"
    times = 3  # of which the first may compile

    def command(self, model: PeerModel, case: Case, folder: Path) -> list[str]:
        """The case, as it was understood."""
        (folder / "case.yaml").write_text(dump(case), encoding="utf-8")
        return [sys.executable, "-m", "mantle", "run", "case.yaml", "-o", "run", "--force"]

    def displacement(self, model: PeerModel, folder: Path) -> Floats:
        """That of the nodes of the same body at the same place."""
        return of_run(model, folder / "run")


class GetFem(Program):
    """GetFEM by its Python interface."""

    name, key = "GetFEM", "getfem"
    times = 3

    def missing(self) -> str:
        """Whether there is the interface."""
        found = importlib.util.find_spec("getfem")
        return "" if found else "not installed (Debian: python3-getfem)"

    def command(self, model: PeerModel, case: Case, folder: Path) -> list[str]:
        """The arrays in a file."""
        np.savez(folder / MODEL, **arrays(model))  # type: ignore[arg-type]
        script = Path(__file__).with_name("getfem_peer.py")
        return [sys.executable, str(script), MODEL, RESULT]

    def displacement(self, model: PeerModel, folder: Path) -> Floats:
        """The array that its script writes."""
        return np.asarray(np.load(folder / RESULT), dtype=np.float64)


class CalculiX(Program):
    """CalculiX with contact by penalty."""

    def __init__(self, penalty: float, slope: float) -> None:
        """Set the penalty.

        Args:
            penalty: Pressure per penetration [MPa/mm].
            slope: Shear per slip of points that stick [MPa/mm].
        """
        self.penalty, self.slope = penalty, slope
        self.name, self.key = f"CalculiX, {penalty:.0e} MPa/mm", f"calculix-{penalty:.0e}"

    def missing(self) -> str:
        """Whether there is the program."""
        if self._program():
            return ""
        return "not installed (no ccx on the PATH, and none that MANTLE_CCX names)"

    def command(self, model: PeerModel, case: Case, folder: Path) -> list[str]:
        """An input file."""
        text = calculix.input_text(model, self.penalty, self.slope)
        (folder / "peer.inp").write_text(text, encoding="ascii")
        return [self._program() or "ccx", "peer"]

    def displacement(self, model: PeerModel, folder: Path) -> Floats:
        """That of its results."""
        return calculix.displacement(folder / "peer.frd", len(model.points))

    def _program(self) -> str | None:
        return shutil.which(os.environ.get("MANTLE_CCX", "ccx"))


def of_run(model: PeerModel, folder: Path) -> Floats:
    """The displacement of the nodes of a model in the results of a run (n, 3) [mm].

    Args:
        model: The model; its nodes are some of the run's, whatever the order of its elements.
        folder: The run directory.

    Raises:
        OSError: It has no fields.
        InputError: It is of another mesh.
    """
    from scipy.spatial import cKDTree

    run = Run(folder)
    values, found = run.displacement(), np.empty_like(model.points)
    for number in np.unique(model.region):
        nodes = np.unique(model.cells[model.region == number])
        those = run.nodes_of(int(number) + 1)
        distance, row = cKDTree(run.points[those]).query(model.points[nodes])
        if distance.max() > 1e-9:
            raise InputError(f"{folder}: is of another mesh")
        found[nodes] = values[those[row]]
    return found


def arrays(model: PeerModel) -> dict[str, Floats]:
    """A model as arrays by name: its own, and of contact pairs of nodes, normals and friction."""
    names = ("points", "cells", "region", "body", "young", "poisson", "fixed", "forces")
    pairs = [interface.nodes() for interface in model.interfaces]
    return {name: getattr(model, name) for name in names} | {
        "first": np.concatenate([first for first, _ in pairs]),
        "second": np.concatenate([second for _, second in pairs]),
        "normals": np.concatenate([model.normals(i) for i in model.interfaces]),
        "friction": np.concatenate(
            [np.full(len(p[0]), i.friction) for p, i in zip(pairs, model.interfaces, strict=True)]
        ),
    }
