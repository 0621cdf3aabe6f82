"""One rank is killed or meets an error: all end, soon, and the next run works."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests import support
from tests.robustness.faulty import CASE, OPTIONS, slow

pytestmark = pytest.mark.parallel
HANGS = 300.0  # s; what takes so long waits for ever, on any machine
CODES = {"internal": 70, "memory": 69, "stop": 5, "divergence": 4, "interrupt": 5}
# A run with all that is written.
ALL = (
    *OPTIONS,
    "--set",
    "output.checkpoint.steps=1",
    "--set",
    "stages=[{name: press, increments: 3}]",
)


def command(output: Path, *more: str) -> list[str]:
    """The small case on two ranks."""
    program = [sys.executable, "-m", "mantle", "run", str(CASE), "-o", str(output)]
    return [*program, *ALL, "-n", "2", *more]


def processes(output: Path) -> dict[int, list[str]]:
    """Whatever runs with this folder on its command line."""
    found = {}
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = path.read_bytes().decode(errors="replace").split("\0")
            state = (path.parent / "stat").read_text().rpartition(")")[2].split()[0]
        except OSError:
            continue
        if str(output) in words and state != "Z":
            found[int(path.parent.name)] = words
    return found


def ranks(output: Path) -> list[int]:
    """Processes of the ranks."""
    found = []
    for pid in processes(output):
        try:
            environ = Path(f"/proc/{pid}/environ").read_bytes()
        except OSError:
            continue
        if b"OMPI_COMM_WORLD_RANK=" in environ:
            found.append(pid)
    return sorted(found)


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory) -> tuple[float, str]:
    """How long the run takes where nothing happens, and its numbers."""
    folder = tmp_path_factory.mktemp("usual")
    begin = time.monotonic()
    subprocess.run(command(folder / "out"), env=support.environment(), check=True, timeout=HANGS)
    return time.monotonic() - begin, numbers(folder / "out")


def numbers(output: Path) -> str:
    """Rounded, as they depend on who comes first in a sum."""
    q = json.loads((output / "summary.json").read_text())["interfaces"]
    return str({name: round(v["pressure_mean"], 8) for name, v in q.items()})


@pytest.mark.parametrize("number", [0, *(pytest.param(k, marks=slow) for k in range(1, 11))])
def test_a_killed_rank_ends_all(number: int, usual: tuple[float, str], tmp_path: Path) -> None:
    chance = random.Random(number)
    output, temporary = tmp_path / "out", tmp_path / "tmp"
    temporary.mkdir()
    environ = support.environment() | {"TMPDIR": str(temporary)}
    child = subprocess.Popen(
        command(output), env=environ, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    while len(ranks(output)) < 2:
        time.sleep(0.01)
    time.sleep(chance.uniform(0.05, 0.7 if number else 0.3) * usual[0])
    alive = ranks(output)
    if alive:
        os.kill(chance.choice(alive), signal.SIGKILL)
    _, told = child.communicate(timeout=HANGS)
    if child.returncode:
        assert child.returncode == 70, told
        # While MPI begins, the other rank may find out before mpirun does.
        assert "signal 9" in told or "unable to reach each other" in told
        assert "Traceback" not in told
    if (output / "DONE").exists():  # it was killed on its way out
        assert numbers(output) == usual[1]
    else:
        assert child.returncode
    assert not processes(output)
    again = subprocess.run(
        command(output, "--force"), env=environ, capture_output=True, text=True, timeout=HANGS
    )
    assert again.returncode == 0, again.stderr
    assert numbers(output) == usual[1]
    assert not list(output.glob("*.partial")) and not list(temporary.iterdir())


FIRST = [("solve", "internal", 1), ("output", "stop", 1)]
REST = [
    (phase, error, rank)
    for phase in ("mesh", "distribution", "assembly", "solve", "output", "checkpoint")
    for error in CODES
    for rank in (0, 1)
    if (phase, error, rank) not in FIRST and (phase, rank) != ("mesh", 1)
]


@pytest.mark.parametrize(
    ("phase", "error", "rank"), [*FIRST, *(pytest.param(*case, marks=slow) for case in REST)]
)
def test_an_error_on_one_rank_ends_all(phase: str, error: str, rank: int, tmp_path: Path) -> None:
    output = tmp_path / "out"
    done = subprocess.run(
        support.mpirun(2, "-m", "tests.robustness.faulty_rank", "run", CASE, "-o", output, *ALL),
        env=support.environment() | {"PHASE": phase, "ERROR": error, "RANK": str(rank)},
        capture_output=True,
        text=True,
        timeout=HANGS,
    )
    assert done.returncode == CODES[error], done.stderr
    assert error == "interrupt" or "thrown here" in done.stderr
    assert not (output / "DONE").exists()
    assert not processes(output)


@pytest.mark.parametrize("number", [pytest.param(k, marks=slow) for k in range(10)])
def test_ranks_end_with_a_killed_mpirun(number: int, tmp_path: Path) -> None:
    """They would wait for each other for ever, at full speed."""
    output = tmp_path / "out"
    words = support.mpirun(2, "-m", "mantle", "run", CASE, "-o", output, *ALL)
    child = subprocess.Popen(
        [*words, "--set", "mesh.size=1 mm"],
        env=support.environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    begin = time.monotonic()
    while len(ranks(output)) < 2 and time.monotonic() - begin < HANGS:
        time.sleep(0.05)
    time.sleep(0.5 + 0.15 * number)
    assert child.poll() is None and len(ranks(output)) == 2
    child.kill()
    child.wait()
    begin = time.monotonic()
    while ranks(output) and time.monotonic() - begin < HANGS:
        time.sleep(0.1)
    left = ranks(output)
    for pid in left:
        os.kill(pid, signal.SIGKILL)
    assert not left
