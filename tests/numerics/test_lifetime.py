"""Objects of PETSc and DOLFINx are destroyed at the end of each run, for any number of runs."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests import support
from tests.cases import coupled

# A new communicator has the lowest index that no other has.
RUNS = """
import sys
from mpi4py import MPI
import petsc4py
petsc4py.init(["runs", "-skip_petscrc", "-log_view", f":{sys.argv[2]}/log.txt"])
import mantle

def communicators():
    # Those in use below the highest of some new ones.
    new = [MPI.COMM_WORLD.Dup() for _ in range(100)]
    indices = [c.py2f() & 0xFFFF for c in new]  # the lower bits of MPICH's
    for c in new:
        c.Free()
    return max(indices) + 1 - len(set(indices))

def megabytes():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096 // 2**20

case = mantle.load("configs/blocks.yaml", **{
    "mesh.size": "5 mm", "mesh.order": 1, "output.fields": False, "output.report": False})
for _ in range(int(sys.argv[1])):
    mantle.run(case, f"{sys.argv[2]}/out", force=True)
    if MPI.COMM_WORLD.rank == 0:
        print("after:", communicators(), megabytes(), flush=True)
    else:
        communicators()
"""
# Objects of one kind that the last run and the loaded program may hold.
LEFT = 60
# Runs until communicators and memory are constant. On one rank both are from the second run on.
WARM_UP_RUNS = 2
# Communicators more than after the warm-up; measured: none.
MORE_COMMUNICATORS = 2
# Memory [MB] by which 20 more steps may raise the peak of two ranks.
GROWTH_OF_STEPS = 20


# Growth of memory after the warm-up [MB]; measured in 8 runs on one rank: 0 MB.
@pytest.mark.parametrize(
    ("ranks", "runs", "growth"),
    [
        (1, 8, 40),
        pytest.param(2, 8, 40, marks=pytest.mark.parallel),
        pytest.param(1, 300, 60, marks=pytest.mark.slow),
    ],
)
def test_lifetime_of_runs_leaves_no_communicators_matrices_or_memory(
    ranks: int, runs: int, growth: int, tmp_path: Path
) -> None:
    """Communicators and memory are constant after two runs; on one rank PETSc keeps no objects.

    MPICH has 2,048 communicators, and a run needs about twenty.
    """
    script = tmp_path / "runs.py"
    script.write_text(RUNS)
    if ranks == 1:
        printed = support.python(script, str(runs), tmp_path, timeout=1800).stdout
    else:
        printed = support.on_ranks(ranks, script, str(runs), tmp_path).stdout
    after_runs = [
        [int(word) for word in line.split()[1:]] for line in re.findall("after:.*", printed)
    ]
    assert len(after_runs) == runs
    communicators, megabytes = zip(*after_runs, strict=True)
    assert communicators[-1] <= communicators[WARM_UP_RUNS] + MORE_COMMUNICATORS, communicators
    assert megabytes[-1] <= megabytes[WARM_UP_RUNS] + growth, megabytes
    if ranks == 1:
        kinds = "Matrix|Vector|Preconditioner|Krylov Solver|SNES|Index Set"
        table = (tmp_path / "log.txt").read_text()
        counts = re.findall(rf"^ *({kinds}) +(\d+) +(\d+)", table, re.MULTILINE)
        assert len(counts) == 6
        left = {kind: int(made) - int(destroyed) for kind, made, destroyed in counts}
        assert {kind: number for kind, number in left.items() if number > LEFT} == {}


@pytest.mark.parallel
def test_lifetime_of_steps_leaves_no_memory_on_two_ranks(tmp_path: Path) -> None:
    """The peak of memory of a run does not grow with its number of steps."""
    (tmp_path / "case.yaml").write_text(coupled.CASE)
    peaks = []
    for steps in (5, 25):
        folder = tmp_path / str(steps)
        changes = support.sets("mesh.order=1", f"stages[1].increments={steps}")
        # New processes: a peak is that of all runs of a process.
        words = "-m", "mantle", "run", tmp_path / "case.yaml", "-o", folder, "-n", "2"
        support.python(*words, *changes)
        peaks.append(support.summary(folder)["memory"]["peak"])
    assert peaks[1] < peaks[0] + GROWTH_OF_STEPS
