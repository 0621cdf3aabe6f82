"""Runs of ``mantle bench``: a process each, and what it cost."""

from __future__ import annotations

import csv
import json
import logging
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

from mantle import configs
from mantle.errors import MantleError

log = logging.getLogger("mantle")

CASES = configs.FOLDER
MANTLE = (sys.executable, "-m", "mantle")
LOG_LINES = 6
# A mesh this coarse needs the same forms as any other.
WARM = "6 mm"
# Overrides that change no form.
SAME_FORMS = ("variations", "stages", "loads.")
# Phases of a run that are no part of set-up and solution.
APART = ("mesh", "compile", "output", "error", "total")
MEGA = 1e6


class NotMeasured(MantleError):
    """A run failed, or does not tell what is asked."""

    exit_code = 1


@dataclass(frozen=True)
class BenchCase:
    """A run to be measured.

    Attributes:
        name: For people, and of its folder.
        case: The case file, in `CASES`.
        size: Of the mesh; empty for that of the case.
        overrides: ``key=value`` each, as after ``--set``.
        ranks: Number of MPI ranks.
        sized: The keys that the size is the value of.
    """

    name: str
    case: str
    size: str = ""
    overrides: tuple[str, ...] = ()
    ranks: int = 1
    sized: tuple[str, ...] = ("mesh.size",)

    @property
    def options(self) -> list[str]:
        """The case with its overrides, on a command line."""
        sets = [*self.overrides, *(f"{key}={self.size}" for key in self.sized if self.size)]
        return [str(CASES / self.case), *(word for s in sets for word in ("--set", s))]

    @property
    def mesh(self) -> tuple[str, ...]:
        """Options that its mesh depends on."""
        return (self.case, self.size, *(o for o in self.overrides if o.startswith("mesh.")))


@dataclass(frozen=True)
class Cost:
    """Cost of a process.

    Attributes:
        wall: Start to finish [s].
        cpu: CPU time, that of its ranks included [s].
        memory: Peak memory, of all ranks together [MB].
        summary: The ``summary.json`` of a run that wrote one.
        history: The rows of its ``history.csv``.
    """

    wall: float
    cpu: float
    memory: float
    summary: dict[str, Any]
    history: tuple[dict[str, str], ...] = ()

    @property
    def unknowns(self) -> int:
        """Displacements and jumps."""
        return int(self.summary["solver"]["dofs"])

    @property
    def newton(self) -> int:
        """Newton iterations."""
        return int(self.summary["solver"]["newton_iterations"])

    @property
    def krylov(self) -> int:
        """Krylov iterations."""
        return int(self.summary["solver"]["linear_iterations"])

    @property
    def solution(self) -> float:
        """CPU time of assembly, set-up and solution, coarse problems included [s]."""
        return _solution(self.summary["cpu"])

    @property
    def solution_wall(self) -> float:
        """The same on the wall's clock, which is what more ranks make shorter [s]."""
        return _solution(self.summary["timing"])

    @property
    def step_seconds(self) -> list[float]:
        """Wall time of each load step, with what was tried in vain [s]."""
        return [float(row["step [s]"]) for row in self.history]

    def interfaces(self, key: str) -> dict[str, float]:
        """A number of each interface, by its name."""
        return {name: float(q[key]) for name, q in self.summary["interfaces"].items()}


def _solution(seconds: dict[str, float]) -> float:
    return sum(value for phase, value in seconds.items() if phase not in APART)


class Runs:
    """Runs what is asked for, once or several times in turn, and remembers what it cost.

    Attributes:
        known: The costs of what was run so far.
        meshing: Seconds it took to make each mesh, or to find it in the cache.
    """

    def __init__(self, folder: Path) -> None:
        """Begin with nothing.

        Args:
            folder: Where run directories and logs go.
        """
        self.known: dict[BenchCase, list[Cost]] = {}
        self.meshing: dict[tuple[str, ...], float] = {}
        self._folder = folder
        self._compiled: set[tuple[str, tuple[str, ...]]] = set()
        self._failed: dict[BenchCase, NotMeasured] = {}

    def costs(self, *settings: BenchCase, times: int = 1) -> list[list[Cost]]:
        """Costs of settings, each run so many times.

        They run in turn, so that what else happens on the machine meets them all.

        Raises:
            NotMeasured: A run failed, now or before.
        """
        for setting in settings:
            if setting in self._failed:
                raise self._failed[setting]
            self._warm(setting)
        for i in range(times):
            for setting in settings:
                if len(self.known.get(setting, [])) > i:
                    continue
                try:
                    cost = self._run(setting)
                except NotMeasured as error:
                    self._failed[setting] = error
                    raise
                self.known.setdefault(setting, []).append(cost)
                _log_cost(setting, cost)
        return [self.known[setting][:times] for setting in settings]

    def process(self, name: str, command: Sequence[str]) -> Cost:
        """Run a program.

        Raises:
            NotMeasured: It failed.
        """
        path = self._folder / f"{name}.log"
        path.parent.mkdir(parents=True, exist_ok=True)
        begin = perf_counter()
        with path.open("w") as output:
            child = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
            )
            _, status, usage = os.wait4(child.pid, 0)
        wall = perf_counter() - begin
        child.returncode = code = os.waitstatus_to_exitcode(status)
        if code:
            lines = [x for x in path.read_text(errors="replace").splitlines() if x.strip()]
            said = "\n".join(lines[-LOG_LINES:])
            raise NotMeasured(f"{name} failed with exit code {code}, see {path}:\n{said}")
        return Cost(wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1024 / MEGA, {})

    def _warm(self, setting: BenchCase) -> None:
        """Have mesh and compiled forms in their caches, so that no run that counts makes them."""
        same = tuple(o for o in setting.overrides if not o.startswith(SAME_FORMS))
        if (setting.case, same) not in self._compiled:
            self._compiled.add((setting.case, same))
            small = WARM if setting.size else ""
            try:
                self._run(replace(setting, name="warm", size=small, overrides=same, ranks=1))
            except NotMeasured as error:
                log.debug("%s", error)  # forms are compiled before anything can fail
        if setting.mesh not in self.meshing:
            check = [*MANTLE, "check", "--mesh", *setting.options]
            self.meshing[setting.mesh] = self.process("mesh", check).wall

    def _run(self, setting: BenchCase) -> Cost:
        """Run a case."""
        folder = self._folder / setting.name
        ranks = ["-n", str(setting.ranks)] if setting.ranks > 1 else []
        command = [*MANTLE, "run", *setting.options, "-o", str(folder), "--force", *ranks]
        cost = self.process(setting.name, command)
        if not (folder / "summary.json").exists():
            return cost  # of variations, which have a folder each
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        with (folder / "history.csv").open(encoding="utf-8", newline="") as file:
            rows = tuple(csv.DictReader(file))
        # Of several ranks the system tells the largest alone.
        memory = cost.memory if setting.ranks == 1 else summary["memory"]["peak"]
        return replace(cost, memory=memory, summary=summary, history=rows)


def _log_cost(setting: BenchCase, cost: Cost) -> None:
    """Write the cost of a run to the log."""
    if not cost.summary:
        log.info("%-22s %9.1f CPU s start to finish", setting.name, cost.cpu)
        return
    log.info(
        "%-22s %9d unknowns %3d Newton %5d Krylov %7.1f CPU s %7.1f s on the wall %6.0f MB",
        *(setting.name, cost.unknowns, cost.newton, cost.krylov, cost.solution),
        *(cost.solution_wall, cost.memory),
    )
