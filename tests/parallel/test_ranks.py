"""Equal results on 1, 2 and 3 ranks with the same mesh and steps, for any partition."""

from __future__ import annotations

import json
import os
import re
import subprocess
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.results.reading import Run
from app.system.folders import saved
from app.verification.changed_meshes import ROTATION, change
from tests import support
from tests.cases import coupled, restarted, varied_stem, worn_ball
from tests.cases.blocks import TORN
from tests.cases.shipped import COARSE
from tests.cases.stems import CREEPING, QUARTER, SETTING
from tests.cases.turning_head import COCR, CUP, DRIVEN, SWING, stages
from tests.support import vector

pytestmark = pytest.mark.parallel
# Residuals are below 1e-10 of the force scale (the default of `solver.tolerance`). A jump answers a
# residual at its node by at most some thousand times what it answers the whole load by.
TOLERANCE = 1e-6
# What tells of the machine, or is nothing but rounding.
ASIDE = ("solver", "timing", "cpu", "memory", "balance", "units")
# A tapered stem pressed in, then pushed down and sideways: parts of both interfaces are open,
# stick and slip. Steps are fixed.
STEM = """
geometry: {kind: cylinders, stem_radius: 7 mm, cement_thickness: 4 mm, bone_thickness: 5 mm,
  length: 24 mm, taper: 1.5 deg}
mesh: {order: 2, size: 5 mm, far_size: 6 mm}
regions:
  stem: {youngs_modulus: 110 GPa, poisson_ratio: 0.3}
  cement: {youngs_modulus: 2200 MPa, poisson_ratio: 0.35}
  bone: {youngs_modulus: 17 GPa, poisson_ratio: 0.3}
interfaces:
  stem_cement: {kind: contact, friction_coefficient: 0.3, gap: -0.002 mm, gap_history: [1, 1]}
  cement_bone: {kind: contact, friction_coefficient: 0.5}
supports:
  outer: {kind: displacement, boundary: bone_surface, x: 1e-5 * z, y: 0 mm, z: -1e-5 * x}
loads:
  push: {kind: force, boundary: stem_top, force: [0 N, 0 N, -900 N], history: [0, 1]}
  pull: {kind: body_force, regions: [cement], density: ["1e-3 * x", 0 N/mm^3, "-1e-4 * z"]}
  lateral: {kind: force, boundary: stem_top, force: [600 N, 200 N, 0 N], history: [0, 1]}
stages:
  - {name: fit, adaptive: false}
  - {name: push, increments: 2, adaptive: false}
solver: {tolerance: 1.0e-12}
output: {fields: false}
"""
# Nothing holds the stem that is lifted out.
VARIATIONS = (
    varied_stem.STEM
    + """
variations:
  tied: {interfaces.stem_cement: {kind: bonded}}
  lifted: {loads.aside.force: [0 N, 0 N, 2000 N]}
  slippery: {interfaces.stem_cement.friction_coefficient: 0.3, loads.*.history: [1, 1]}
  as_is: {loads.*.history: [1, 1]}
  slippery_twice: {interfaces.stem_cement.friction_coefficient: 0.3, loads.*.history: [2, 2]}
  twice: {loads.*.history: [2, 2]}
"""
)
QUICKLY = ("solver.max_iterations=12", "stages[1].adaptive=false", "stages[1].increments=1")
# Without sources, in steps so short that conduction has to be corrected.
SHORT = (
    "heat={outer: {kind: temperature, boundary: bone_surface, temperature: 37 degC}}",
    "regions.cement.thermal.cure=null",
    "stages[0].duration=0.02 s",
    "loads.push.force=[40 N, 10 N, -80 N]",
)
HEATING = "interfaces.lower_upper={kind: contact, friction_coefficient: 0.3, friction_heating: 0.3}"
GRUEN = ("mesh.size=6 mm", "mesh.order=1", "stages.0.increments=1", "output.error=false")
EXACT = "solver.tolerance=1e-12"
# Four ranks share two cores here: first order where the shipped second is tested elsewhere.
# Where a body hangs by friction alone, the residual that the default allows moves it by 1e-6 of
# what it moves; work that is zero is the residual times what closes.
COARSER = {
    "stance.yaml": "mesh.order=1",
    "stance_cocr.yaml": "mesh.order=1",
    "intact.yaml": "mesh.order=1",
    "variations.yaml": EXACT,
    "thermal_100C.yaml": EXACT,
    "sliding_block.yaml": EXACT,
}
CONDENSED = "solver.linear=condensed"
TIRING = "fatigue={region: corner, spectrum: {load: 1e6}, laws: {m: {kind: murphy_2000}}}"
STATES = ("open_fraction", "stick_fraction", "slip_fraction")
Summaries = dict[str, dict[str, Any]]


# What must not depend on ranks: the case, or the name of a shipped one; overrides on any number of
# ranks; further ones by number of ranks, those it runs on.
CASES: dict[str, tuple[str, tuple[str, ...], dict[int, tuple[str, ...]]]] = {
    # The stiffness factored, or by multigrid.
    "contact": (
        STEM,
        (),
        {
            1: ("solver.linear=direct",),
            2: ("solver.linear=direct",),
            3: ("solver.linear=multigrid",),
        },
    ),
    "condensed": (
        STEM,
        (),
        {
            1: ("solver.linear=direct",),
            2: (CONDENSED,),
            3: (CONDENSED,),
            4: (CONDENSED,),
        },
    ),
    "condensed, a support lets go": (
        STEM,
        (
            CONDENSED,
            "supports.held={kind: roller, boundary: stem_top, axis: x, stages: [first]}",
            "stages=[{name: first}, {name: second}]",
        ),
        {1: (), 2: ()},
    ),
    "condensed, a deformable head": (
        CUP,
        (COCR, DRIVEN, stages(3), EXACT, CONDENSED),
        {1: (), 2: (), 3: ()},
    ),
    "conductance": (coupled.CASE, ("stages[1].increments=2", EXACT), {1: (), 3: ()}),
    "friction heat": (coupled.CASE, (HEATING, EXACT), {1: (), 3: ()}),
    "fibres": ("verification/fibre_ring.yaml", ("mesh.size=1 mm",), {1: (), 2: ()}),
    "gruen zones": ("stance.yaml", (*GRUEN, EXACT, "output.fields=false"), {1: (), 2: ()}),
    "setting": (SETTING, (EXACT,), {1: (), 3: ()}),
    "tiring": ("verification/corner.yaml", ("mesh.size=2 mm", TIRING), {1: (), 3: ()}),
    "torn": ("verification/cohesive_bar.yaml", TORN, {1: (), 2: ()}),
    "creep": (CREEPING, (EXACT,), {1: (), 2: ()}),
    "corrected": (SETTING, (*SHORT, EXACT), {1: (), 3: ()}),
    "large slip": (CUP, (SWING, stages(6)), {1: (), 2: (), 3: ()}),
    "heat of a cycle": (worn_ball.CASE, (*worn_ball.WARM, EXACT), {1: (), 2: (), 3: ()}),
    "deformable head": (CUP, (COCR, DRIVEN, stages(3), EXACT), {1: (), 2: ()}),
}


def numbers(value: dict[str, Any], *path: str) -> Iterator[tuple[tuple[str, ...], float]]:
    """The numbers of a nested table with their places.

    Numbers of maxima, which may jump, are apart.
    """
    for key, inside in value.items():
        if isinstance(inside, dict):
            yield from numbers(inside, *path, key)
        elif not key.endswith(("_at", "_time")):
            for k, one in enumerate(inside if isinstance(inside, list) else [inside]):
                if isinstance(one, int | float) and not isinstance(one, bool):
                    yield (*path, f"{key}.{k}" if k else key), float(one)


def _kind(path: tuple[str, ...]) -> tuple[str, str]:
    """Section and kind of a number. Components of a vector, such as `force.1`, are of one kind."""
    return path[0], re.split(r"[_.]", path[-1])[0]


def summaries(output: Path) -> Summaries:
    """Summaries by folder: one, or that of each variation."""
    paths = [path for path in output.glob("**/summary.json") if (path.parent / "DONE").exists()]
    return {os.path.relpath(p.parent, output): support.summary(p.parent) for p in paths}


def compare(one: Summaries, other: Summaries, ranks: int, states: bool = True) -> None:
    """The numbers are those on one rank, relative to the largest of their kind."""
    assert one and one.keys() == other.keys()
    for folder, expected in one.items():
        actual = other[folder]
        assert actual["solver"]["ranks"] == ranks
        assert actual["solver"]["dofs"] == expected["solver"]["dofs"]
        for summary in (expected, actual):
            assert max(v for k, v in summary["balance"].items() if k != "heat_quadrature") < 1e-8
        a, b = (
            dict(numbers({k: v for k, v in s.items() if k not in ASIDE}))
            for s in (expected, actual)
        )
        assert a.keys() == b.keys()
        largest: dict[tuple[str, str], float] = {}
        for path, value in a.items():
            largest[_kind(path)] = max(abs(value), largest.get(_kind(path), 0.0))
        wrong = []
        for path, value in a.items():
            limit = max(TOLERANCE * largest[_kind(path)], 1e-12)
            if path[0] == "interfaces" and path[-1].startswith(("area_", *STATES)):
                # Whether a point at its limit sticks or slips is a matter of rounding.
                nodes = 2 * 3.0**2
                limit = nodes / (a[*path[:2], "area"] if path[-1] in STATES else 1.0)
                limit = limit if states else np.inf
            if path[0] == "cycles" and "change" in path:
                # It is relative to the number that changes.
                limit = TOLERANCE
            if abs(b[path] - value) > limit:
                wrong.append((".".join(path), value, b[path], limit))
        assert not wrong, (folder, wrong)


@pytest.mark.parametrize("name", CASES)
def test_ranks_numbers_are_equal(name: str, tmp_path: Path) -> None:
    text, overrides, on = CASES[name]
    case = support.CONFIGS / text if text.endswith(".yaml") else tmp_path / "case.yaml"
    if not case.exists():
        case.write_text(text)
    by_ranks = {}
    for ranks, more in on.items():
        output = tmp_path / f"on-{ranks}"
        sets = support.sets(*overrides, *more)
        support.on_ranks(ranks, "-m", "mantle", "run", case, "-o", output, *sets)
        by_ranks[ranks] = summaries(output)
    one = by_ranks.pop(1)
    # All kinds of points occur, or the comparison says little.
    first = next(iter(one.values()))
    for q in first["interfaces"].values():
        assert name == "gruen zones" or q["open_fraction"] + q["slip_fraction"] > 0.02
    assert len(dict(numbers(first.get("gruen", {})))) > 200 or name != "gruen zones"
    for ranks, other in by_ranks.items():
        compare(one, other, ranks)


def test_ranks_variations_are_equal(tmp_path: Path) -> None:
    """Failed variations are tried again, finished ones stay.

    A start from half the load converges.
    """
    case, output = tmp_path / "case.yaml", tmp_path / "2"
    case.write_text(VARIATIONS)
    command = ("-m", "mantle", "run", case, *support.sets(*QUICKLY), "-o")
    for ranks in (1, 2):
        support.on_ranks(ranks, *command, tmp_path / str(ranks), code=4)
    one, two = (summaries(tmp_path / str(ranks)) for ranks in (1, 2))
    assert len(one) == 5
    compare(one, two, 2, states=False)
    assert (output / "lifted" / "FAILED").exists() and not (output / "DONE").exists()
    rows = json.loads((output / "variations.json").read_text())
    assert rows[-1]["name"] == "twice"
    # Condensed bodies take one iteration in each step at least.
    assert rows[-1]["newton_iterations"] <= 2
    before = {p: p.stat().st_mtime_ns for p in output.glob("*/DONE")}
    again = support.on_ranks(2, *command, output, "--restart", "auto", code=4)
    assert again.stdout.count("5 of 6 variations are finished already") == 1
    assert {p: p.stat().st_mtime_ns for p in output.glob("*/DONE")} == before
    table = json.loads((output / "variations.json").read_text())
    assert [(r["name"], r["numbers"]) for r in table] == [(r["name"], r["numbers"]) for r in rows]


def test_ranks_error_on_one_is_printed_once_and_ends_all(tmp_path: Path) -> None:
    """An expression is not finite at a few nodes, which one of the ranks has."""
    case = tmp_path / "case.yaml"
    case.write_text(STEM)
    for key, value in (
        ("supports.outer.x", "sqrt(z - 1e-3)"),
        ("loads.pull.density[1]", "log(z - 0.5)"),
    ):
        run = ("-m", "mantle", "run", case, "-o", tmp_path / "out", "--force")
        done = support.on_ranks(3, *run, "--set", f"{key}={value}", code=2)
        assert done.stderr.count(f"{key}: expression '{value}' is not finite at (") == 1


DEALT = """
from mpi4py import MPI
from app.foundation.collective import distribute_tasks
from app.foundation.errors import InputError

comm = MPI.COMM_WORLD

def fail():
    raise InputError("wrong")

for n in (0, 1, 3, 5):
    shares = distribute_tasks(comm, [lambda k=k: (k, comm.rank) for k in range(n)])
    assert shares == ([(k, k % comm.size) for k in range(n)] if comm.rank == 0 else [])
try:
    distribute_tasks(comm, [int, fail, int])
except InputError as error:
    assert str(error) == "wrong"
else:
    raise AssertionError
"""
# A product of small integers, with which single precision is exact; the last rank has no rows.
PRODUCT = """
from mpi4py import MPI
import numpy as np
from app.numerics.single_precision import SinglePrecision
from app.numerics.sparse import from_triplets

comm, points = MPI.COMM_WORLD, 20
rng = np.random.default_rng(2)
pairs = rng.integers(0, points, (60, 2))
dense = np.zeros((points, 3, points, 3))
for i, j in [*pairs, *zip(range(points), range(points))]:
    dense[i, :, j, :] = rng.integers(-9, 9, (3, 3))
dense = dense.reshape(3 * points, -1)
dense += dense.T
x = rng.integers(-9, 9, 3 * points).astype(float)
ends = np.append(0, np.linspace(0, points, comm.size).astype(int))
first, last = 3 * ends[comm.rank], 3 * ends[comm.rank + 1]
blocks = np.abs(dense).reshape(points, 3, points, 3).sum(axis=(1, 3))
rows, columns = np.nonzero(np.kron(blocks > 0, np.ones((3, 3))))
own = (rows >= first) & (rows < last)
rows, columns = rows[own], columns[own]
size = int(last - first)
A = from_triplets(comm, size, size, rows - first, columns, dense[rows, columns])
vector, product = A.createVecs()
vector.array[:] = x[first:last]
single = SinglePrecision(A)
single.matrix.mult(vector, product)
np.testing.assert_array_equal(product.array, (dense @ x)[first:last])
"""
# Draws the page of a folder on all ranks.
PAGE = """
import sys
from pathlib import Path
from mpi4py import MPI
from app.report import run_report

written = run_report.write(Path(sys.argv[1]), comm=MPI.COMM_WORLD)
assert bool(written) == (MPI.COMM_WORLD.rank == 0)
"""


def test_ranks_share_tasks_and_errors(tmp_path: Path) -> None:
    program = tmp_path / "tasks.py"
    program.write_text(DEALT)
    support.on_ranks(3, program)


@pytest.mark.parametrize("ranks", [2, 3])
def test_ranks_product_in_single_precision(ranks: int, tmp_path: Path) -> None:
    program = tmp_path / "product.py"
    program.write_text(PRODUCT)
    support.on_ranks(ranks, program)


def test_ranks_share_the_pictures_of_a_page(tmp_path: Path) -> None:
    """The page and its files are those of one rank, byte for byte."""
    program, folder = tmp_path / "page.py", tmp_path / "run"
    program.write_text(PAGE)
    case, sizes = support.CONFIGS / "cylinders.yaml", ("mesh.size=4 mm", "mesh.far_size=6 mm")
    sets = [word for size in (*sizes, "mesh.order=1") for word in ("--set", size)]
    support.on_ranks(2, "-m", "mantle", "run", case, "-o", folder, *sets)
    pages = []
    for ranks in (1, 2):
        (folder / "case.png").unlink()
        support.on_ranks(ranks, program, folder)
        assert (folder / "case.png").exists()
        pages.append((folder / "report.html").read_text())
    assert pages[0] == pages[1] and pages[0].count("data:image/png") == 4


@pytest.mark.parametrize("order", [1, 2])
def test_ranks_multigrid_iterations_are_equal(order: int, tmp_path: Path) -> None:
    """Each rank smooths its part. Longer steps of the smoother than on one rank would diverge."""
    case, counts = tmp_path / "case.yaml", {}
    case.write_text(STEM)
    changes = (f"mesh.order={order}", f"mesh.size={2 * order} mm", "solver.linear=multigrid")
    for ranks in (1, 2):
        output = tmp_path / str(ranks)
        support.on_ranks(ranks, "-m", "mantle", "run", case, "-o", output, *support.sets(*changes))
        counts[ranks] = support.summary(output)["solver"]["linear_iterations"]
    assert counts[2] < 1.4 * counts[1]


@pytest.mark.parametrize("ranks", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_ranks_nested_start(ranks: int, tmp_path: Path) -> None:
    """The jumps are the same, from a start that is closer to equilibrium."""
    output = tmp_path / "numbers.json"
    support.on_ranks(ranks, "-m", "tests.parallel.coarse_start_case", output)
    numbers = json.loads(output.read_text())
    assert numbers["difference"] < 1e-6 and numbers["start"] < 0.3


# Restarts

RESTARTS = [(1, 2), (2, 2), pytest.param(2, 1, marks=pytest.mark.slow)]


@pytest.mark.parametrize(("first", "then"), RESTARTS)
def test_ranks_restart_on_any_number(tmp_path: Path, first: int, then: int) -> None:
    case, out = tmp_path / "case.yaml", tmp_path / "out"
    case.write_text(restarted.RUBBING)
    command = ("-m", "mantle", "run", case)
    support.on_ranks(1, *command, "-o", tmp_path / "whole")
    support.on_ranks(first, *command, "-o", out, "--set", "output.checkpoint.steps=1")
    # As if it had been killed in the last step.
    saved(out)[0].unlink()
    for name in ("DONE", "summary.json", "history.csv"):
        (out / name).unlink()
    support.on_ranks(then, *command, "-o", out, "--restart", "auto")
    restarted.assert_same(tmp_path / "whole", out, 1e-6, 1e-9)
    one, other = Run(tmp_path / "whole"), Run(out)
    assert list(one.times) == list(other.times)
    for k in range(len(one.times)):
        # Nodes between the parts of ranks are there more than once, in another order.
        norms = [np.abs(r.displacement(k)).max() for r in (one, other)]
        assert norms[0] == pytest.approx(norms[1], rel=1e-6)
        mean = [np.average(r.stress(k)[:, 2, 2], weights=r.volumes()) for r in (one, other)]
        assert mean[0] == pytest.approx(mean[1], rel=1e-6)


def test_ranks_rotated_quarter_from_a_file(tmp_path: Path) -> None:
    """One side has its normal, the other that of its face. One case has one more stage."""
    text = QUARTER.replace("solver: ", "output: {fields: false}\nsolver: ")
    normals = [vector(np.pi * ROTATION[:, k]) for k in range(3)]
    straight = support.case(text)
    overrides = [
        *change(straight, "turned", tmp_path),
        "supports.symmetry_x={kind: roller, boundary: symmetry_x, normal: face}",
        f"supports.symmetry_y={{kind: roller, boundary: symmetry_y, normal: {normals[1]}}}",
        f"supports.under_bone={{kind: roller, boundary: bone_bottom, normal: {normals[2]}}}",
        f"supports.under_cement={{kind: roller, boundary: cement_bottom, normal: {normals[2]}}}",
        "supports.hand={kind: roller, boundary: bone_surface, normal: face, stages: [press_fit]}",
        f"loads.push.force={vector(ROTATION @ [0, 0, -900], ' N')}",
    ]
    case, files = restarted.whole(text, tmp_path, *overrides)
    output = tmp_path / "two"
    command = ("-m", "mantle", "run", case, "-o", output, *support.sets(*overrides))
    support.on_ranks(2, *command, "--restart", files[0])
    restarted.assert_same(output, tmp_path / "whole")


# Every shipped case, coarse


def run_divided(case: Path, ranks: int, way: str, *overrides: str) -> Summaries:
    """Run a case on ranks with the cells of a scheme; "" is the usual partition."""
    program = ["-m", "tests.parallel.divided"] if way else ["-m", "mantle"]
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder, "out")
        command = (*program, "run", case, "-o", output, *support.sets(*overrides))
        done = subprocess.run(
            support.mpirun(ranks, *command),
            env=support.environment() | {"DIVIDED": way},
            capture_output=True,
            text=True,
            timeout=900,
        )
        assert done.returncode == 0, done.stderr
        assert (output / "DONE").exists() and ("divided: " in done.stdout) == bool(way)
        return summaries(output)


@cache
def shipped(name: str, ranks: int, way: str = "") -> Summaries:
    """Run a shipped case, coarse."""
    more = [COARSER[name]] if name in COARSER else []
    return run_divided(support.CONFIGS / name, ranks, way, *COARSE[name], *more)


def test_ranks_without_cells() -> None:
    """Two regions are on three ranks, so the last rank has neither cells nor points."""
    compare(shipped("intact.yaml", 1), shipped("intact.yaml", 3, "bodies"), 3)


def test_ranks_without_temperatures(tmp_path: Path) -> None:
    """The case has heat, cure and contact. All ranks take part in the norm of changes."""
    case = tmp_path / "case.yaml"
    case.write_text(restarted.SETTING)
    one, three = (run_divided(case, n, way, EXACT) for n, way in ((1, ""), (3, "bodies")))
    compare(one, three, 3)


SHARES = [(2, ""), (3, ""), (4, ""), (2, "board"), (3, "bodies"), (3, "far")]


@pytest.mark.slow
@pytest.mark.parametrize(("ranks", "way"), SHARES)
@pytest.mark.parametrize("name", COARSE)
def test_ranks_shipped_cases(name: str, ranks: int, way: str) -> None:
    """Shipped cases run on 2 to 4 ranks, and on partitions that are as bad as possible."""
    compare(shipped(name, 1), shipped(name, ranks, way), ranks)
