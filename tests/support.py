"""Solving a case inside a test: the one place where the tests call the solver directly."""

from __future__ import annotations

import atexit
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from ruamel.yaml import YAML

import mantle
import meshes
from app.case import library
from app.case.case import Case, load_case, plain_data
from app.foundation.arrays import Floats
from app.mechanics.contact import TrialState
from app.mechanics.problem import Problem
from app.numerics.newton import Solver
from app.results.balance import Balance
from app.results.interface_numbers import ContactSamples
from app.results.reading import Results
from app.results.stresses import Stresses
from app.scene.scene import build_scene
from app.stepping import stages
from app.stepping.load_steps import LoadStep
from app.stepping.stages import Analysis, SolverSettings
from app.system import folders, form_cache, ranks
from meshes.data import MeshData
from meshes.distribute import TaggedMesh, distribute

# Tests compile into the cache that runs of other tests use at the same time.
form_cache.patch_ffcx()

TIMEOUT = 300.0  # of a program on ranks [s]
ROOT = Path(__file__).resolve().parents[1]
CONFIGS = ROOT / "configs"

# Values of `solver.linear` whose results have to agree.
SOLVERS = ("condensed", "direct", "multigrid")

# Numbers of ranks to run a program on.
RANKS = [1, *(pytest.param(n, marks=pytest.mark.parallel) for n in (2, 3))]
# Materials and contact of a stem in its cement and bone.
MATERIALS = """\
regions:
  stem: {youngs_modulus: 110 GPa, poisson_ratio: 0.3}
  cement: {youngs_modulus: 2200 MPa, poisson_ratio: 0.3}
  bone: {youngs_modulus: 17 GPa, poisson_ratio: 0.3}
"""
CONTACT = """\
interfaces:
  stem_cement: {kind: contact, friction_coefficient: 0.4}
  cement_bone: {kind: contact, friction_coefficient: 1.0}
"""
TISSUES = MATERIALS + CONTACT
# A block on another, and the first of their regions where they conduct heat.
HEAD_CUP = """
geometry: {kind: head_cup, head_diameter: 28 mm, radial_clearance: 0.1 mm, liner_thickness: 8 mm,
  inclination: 0 deg, version: 0 deg}
mesh: {size: 5 mm, far_size: 8 mm, order: 1}
regions:
  head: {rigid: true}
  liner: {youngs_modulus: 1 GPa, poisson_ratio: 0.4}
interfaces: {bearing: {kind: contact, friction_coefficient: 0.06, sliding: finite}}
supports: {outer: {kind: fixed, boundary: liner_outer}}
"""
TWO_BLOCKS = """
geometry:
  kind: blocks
  blocks:
    - {name: lower, size: [6 mm, 4 mm, 2 mm]}
    - {name: upper, size: [6 mm, 4 mm, 2 mm]}
mesh: {order: 1, size: 2 mm, far_size: 2 mm}
"""
LOWER = """\
regions:
  lower:
    youngs_modulus: 1000 MPa
    poisson_ratio: 0.3
    thermal: {conductivity: 0.5 W/(m K), density: 1800 kg/m^3, specific_heat: 1300 J/(kg K),
      initial_temperature: 37 degC, thermal_expansion: 20e-6 1/K}
"""


def stem(length: str = "20 mm", mesh: str = "size: 5 mm", taper: str = "1.5 deg") -> str:
    """A tapered stem in cement and bone held outside: a case without interfaces and loads.

    The case ends with supports, so a test can add more. The default mesh is solved at once.
    """
    return f"""
geometry: {{kind: cylinders, stem_radius: 7 mm, cement_thickness: 4 mm, bone_thickness: 5 mm,
           length: {length}, taper: {taper}}}
mesh: {{order: 1, {mesh}}}
{MATERIALS}supports:
  outer: {{kind: fixed, boundary: bone_surface}}
"""


STEM = f"""{stem()}{CONTACT}loads:
  hip: {{kind: force, boundary: stem_top, force: [300 N, 0 N, -900 N]}}
"""


@dataclass(frozen=True)
class Solved:
    """A solved case.

    Attributes:
        case: Its configuration.
        tagged: Its mesh.
        problem: The problem, in its last state.
        solver: Its solver.
        steps: The converged steps.
        samples: The contact points after each step; empty without contact.
        balances: Force, moment and energy balance after each step.
    """

    case: Case
    tagged: TaggedMesh
    problem: Problem
    solver: Solver
    steps: tuple[LoadStep, ...]
    samples: tuple[ContactSamples, ...]
    balances: Floats

    @property
    def last(self) -> ContactSamples:
        """The contact points after the last step."""
        return self.samples[-1]

    @property
    def interfaces(self) -> dict[str, dict[str, Any]]:
        """Reported quantities of each interface, after the last step."""
        return self.samples[-1].numbers if self.samples else {}

    def stress(self, region: str) -> Floats:
        """Stress at the quadrature points of a region (n, 3, 3) [MPa]."""
        return Stresses(self.problem).evaluate(region).reshape(-1, 3, 3)

    def displacement(self, region: str) -> tuple[Floats, Floats]:
        """Positions and displacements of the nodes of a region (n, 3), in series [mm]."""
        function = self.problem.displacements()[self.problem.bodies.body_of_region[region]]
        space = self.problem.space
        cells = self.tagged.cell_tags.find(self.tagged.regions[region])
        nodes = np.unique(space.dofmap.list[cells])
        x = space.tabulate_dof_coordinates()[nodes]
        return x, function.x.array.reshape(-1, 3)[nodes]


def case(text: str | Mapping[str, Any], *overrides: str) -> Case:
    """A configuration from YAML text or from a mapping.

    Args:
        text: The case.
        overrides: ``key.path=value``, as after ``--set``.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "case.yaml"
        if isinstance(text, str):
            path.write_text(text, encoding="utf-8")
        else:
            YAML().dump(dict(text), path)
        return load_case(path, overrides).config


def without_origin(case: Case) -> dict[str, Any]:
    """A case as data, without status and source of its regions and loads."""
    data = plain_data(case)
    for part in (*data["regions"].values(), *data["loads"].values()):
        for key in library.ORIGIN:
            part.pop(key, None)
    return data


def build(case: Case) -> MeshData:
    """The mesh of a case as arrays, from the cache of meshes if possible."""
    return meshes.build(case.geometry, case.mesh, folders.cache("meshes"))


def digest(data: MeshData) -> str:
    """Digest of a mesh, equal only for meshes that are equal to the last bit."""
    arrays = (data.points, data.cells, data.cell_tags, data.facets, data.facet_tags)
    return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()


def mesh(case: Case, comm: MPI.Comm = MPI.COMM_WORLD) -> TaggedMesh:
    """The mesh of a case."""
    data = meshes.build(case.geometry, case.mesh, None) if comm.rank == 0 else None
    return distribute(data, comm)


def analysis(case: Case, tagged: TaggedMesh | None = None) -> Analysis:
    """A case at rest, ready to be solved."""
    options = case.solver
    settings = SolverSettings(
        tolerance=options.tolerance,
        max_iterations=options.max_iterations,
        linear=options.linear,
        petsc=dict(options.petsc),
        augmentation_factor=options.augmentation_factor,
    )
    return stages.assemble(build_scene(case), tagged or mesh(case), settings)


def assemble(case: Case, tagged: TaggedMesh | None = None) -> tuple[Problem, Solver]:
    """Problem and solver of a case, at rest."""
    at_rest = analysis(case, tagged)
    assert at_rest.problem is not None and at_rest.solver is not None
    return at_rest.problem, at_rest.solver


def solve(
    text: str | Mapping[str, Any] | Case,
    *overrides: str,
    tagged: TaggedMesh | None = None,
    balances: bool = False,
) -> Solved:
    """Solve a case.

    Args:
        text: The case.
        overrides: ``key.path=value``, as after ``--set``; of a text or a mapping only.
        tagged: Its mesh if it is there already.
        balances: Whether to keep the balances, which costs some forms.

    Raises:
        MantleError: As the application does.
    """
    assert not (overrides and isinstance(text, Case))
    this = text if isinstance(text, Case) else case(text, *overrides)
    at_rest = analysis(this, tagged)
    problem, solver = at_rest.problem, at_rest.solver
    assert problem is not None and solver is not None
    balance = Balance(problem, np.zeros(3)) if balances else None
    steps: list[LoadStep] = []
    samples: list[ContactSamples] = []
    sums: list[tuple[float, float, float]] = []

    def on_step(step: LoadStep, trial: TrialState | None) -> None:
        steps.append(step)
        if trial is not None:
            samples.append(ContactSamples(problem, trial))
        if balance is not None:
            balance.update(solver.u_and_q()[0], trial)
            sums.append((balance.force, balance.moment, balance.energy))

    at_rest.run(on_step, on_trouble=print)
    return Solved(
        case=this,
        tagged=problem.tagged,
        problem=problem,
        solver=solver,
        steps=tuple(steps),
        samples=tuple(samples),
        balances=np.array(sums),
    )


def run(text: str, folder: Path, *overrides: str) -> Results:
    """Run a case of a folder as the command does, in this process: its results."""
    folder.mkdir(exist_ok=True)
    path = folder / "case.yaml"
    path.write_text(text)
    return mantle.run(load_case(path, overrides), folder / "out")


def vector(values: Any, unit: str = "") -> str:
    """A vector in the form of a case file."""
    return "[" + ", ".join(f"{v:.17g}{unit}" for v in values) + "]"


def sets(*changes: str) -> list[str]:
    """Changes of a case in the form of the command line."""
    return [word for change in changes for word in ("--set", change)]


def summary(folder: Path) -> dict[str, Any]:
    """The numbers of a run."""
    numbers: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    return numbers


def difference(a: Any, b: Any, floor: float = 0.0) -> float:
    """Largest difference over the largest value of b, or over a floor if that is larger."""
    one, two = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    return float(np.abs(one - two).max() / max(np.abs(two).max(), floor))


def python(
    *arguments: str | Path,
    code: int | None = 0,
    cwd: Path = ROOT,
    timeout: float = TIMEOUT,
    **environ: str,
) -> subprocess.CompletedProcess[str]:
    """Run Python with these arguments, to an exit code (None: to any)."""
    done = subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=cwd,
        env=environment() | environ,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=timeout,
    )
    assert code is None or done.returncode == code, done.stdout + done.stderr
    return done


def started(*arguments: str | Path, session: bool = False, **environ: str) -> subprocess.Popen[str]:
    """Start Python with these arguments; with ``session``, as leader of a process group."""
    return subprocess.Popen(
        [sys.executable, *map(str, arguments)],
        env=environment() | environ,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=session,
    )


def mpirun(ranks_: int, *arguments: str | Path) -> list[str]:
    """Command that runs Python with these arguments on a number of ranks."""
    return ["mpirun", "-n", str(ranks_), sys.executable, *map(str, arguments)]


class Ranks:
    """Ranks that run one program after another, see `tests.rank_server`."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._runs = 0
        self._folder = Path(tempfile.mkdtemp(prefix="mantle-ranks-"))
        with (self._folder / "start.err").open("w") as log:
            command = mpirun(size, "-m", "tests.rank_server", self._folder)
            self._process = subprocess.Popen(command, env=environment(), stdout=log, stderr=log)
        atexit.register(shutil.rmtree, self._folder, ignore_errors=True)
        atexit.register(self.end)  # which comes first

    @property
    def alive(self) -> bool:
        """Return True if they can run another program."""
        return self._process.poll() is None

    def end(self) -> None:
        """End the ranks, which wait for a program."""
        if self.alive:
            self._order([])
            self._process.wait(timeout=TIMEOUT)

    def run(self, arguments: list[str], timeout: float) -> subprocess.CompletedProcess[str]:
        """Run Python with these arguments.

        Raises:
            TimeoutExpired: The ranks are not done after ``timeout`` seconds; they are ended.
        """
        order = self._order(arguments)
        ends = [order.with_suffix(f".{rank}") for rank in range(self._size)]
        limit = time.monotonic() + timeout
        while self.alive and not all(e.exists() and e.read_text().endswith("\n") for e in ends):
            if time.monotonic() > limit:
                self._process.kill()
                raise subprocess.TimeoutExpired(arguments, timeout)
            time.sleep(0.02)
        codes = [int(e.read_text()) for e in ends] if self.alive else [self._process.returncode]
        out, err = (
            p.read_text() if p.exists() else ""
            for p in (order.with_suffix(".out"), order.with_suffix(".err"))
        )
        if not self.alive:
            err += (self._folder / "start.err").read_text()
        return subprocess.CompletedProcess(arguments, max(codes), out, err)

    def _order(self, arguments: list[str]) -> Path:
        order = self._folder / f"{self._runs}.json"
        self._runs += 1
        waiting = order.with_suffix(".order")
        waiting.write_text(json.dumps(arguments))
        return waiting.rename(order)


_ranks: dict[int, Ranks] = {}


def on_ranks(
    ranks_: int, *arguments: str | Path, code: int | None = 0, timeout: float = TIMEOUT
) -> subprocess.CompletedProcess[str]:
    """Run Python with these arguments on a number of ranks, to an exit code (None: to any)."""
    if ranks_ not in _ranks or not _ranks[ranks_].alive:
        _ranks[ranks_] = Ranks(ranks_)
    done = _ranks[ranks_].run([str(a) for a in arguments], timeout)
    assert code is None or done.returncode == code, done.stdout + done.stderr
    return done


def results_on_one_and_two_ranks(text: str, folder: Path) -> tuple[Results, Results]:
    """Results of a case on one rank and on two, in a folder."""
    case = folder / "case.yaml"
    case.write_text(text)
    for ranks_ in (1, 2):
        on_ranks(ranks_, "-m", "mantle", "run", case, "-o", folder / str(ranks_))
    return Results(folder / "1"), Results(folder / "2")


def environment() -> dict[str, str]:
    """Environment of a new set of ranks, without variables of the MPI of this process."""

    foreign = ("OMPI_COMM_", "PMIX_", "PRTE_", "PMI_")
    here = {k: v for k, v in os.environ.items() if not k.startswith(foreign)}
    yielding = {"OMPI_MCA_mpi_yield_when_idle": "1"}  # others may use the cores, too
    return ranks.environment(here) | yielding | {"PYTHONPATH": str(ROOT)}


def extended(
    folder: Path, program: str, text: str, *arguments: str
) -> subprocess.CompletedProcess[str]:
    """Run a command with a package of the user, in the processes that it starts as well.

    Args:
        folder: Where package and ``case.yaml`` are written and the command runs.
        program: Text of the package.
        text: The case.
        arguments: Of the command line.
    """
    (folder / "own_package.py").write_text(program)
    (folder / "case.yaml").write_text(text)
    paths = os.pathsep.join((str(folder), str(ROOT)))
    variables = {"MANTLE_EXTENSIONS": "own_package", "PYTHONPATH": paths}
    return python("-m", "mantle", *arguments, code=None, cwd=folder, **variables)
