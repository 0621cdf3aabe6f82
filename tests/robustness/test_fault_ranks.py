"""One rank is killed or has an error. All ranks end soon, and the next run works."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import time
from pathlib import Path

import pytest

from tests import support
from tests.robustness.faulty import arguments, numbers, start

pytestmark = pytest.mark.parallel
HANGS = 300.0  # s; what takes so long waits for ever, on any machine
CODES = {"internal": 70, "memory": 69, "stop": 5, "divergence": 4, "interrupt": 5}
TWO = ("-n", "2")


def processes(output: Path, environ: bytes = b"") -> list[int]:
    """Processes with this folder on their command line, or with this in their environment."""
    numbers = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            words = (path / "cmdline").read_text(errors="replace").split("\0")
            state = (path / "stat").read_text().rpartition(")")[2].split()[0]
            if str(output) in words and state != "Z" and environ in (path / "environ").read_bytes():
                numbers.append(int(path.name))
        except OSError:
            continue
    return sorted(numbers)


def ranks(output: Path) -> list[int]:
    return processes(output, b"OMPI_COMM_WORLD_RANK=")


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory) -> tuple[float, object]:
    """Duration of an undisturbed run, and its numbers."""
    folder = tmp_path_factory.mktemp("usual")
    begin = time.monotonic()
    support.python(*arguments(folder / "out", *TWO))
    return time.monotonic() - begin, numbers(folder / "out")


@pytest.mark.slow
@pytest.mark.parametrize("number", range(11))
def test_fault_ranks_killed_rank_ends_all(
    number: int, usual: tuple[float, object], tmp_path: Path
) -> None:
    chance = random.Random(number)
    output, temporary = tmp_path / "out", tmp_path / "tmp"
    temporary.mkdir()
    child = start(output, *TWO, TMPDIR=str(temporary))
    while len(ranks(output)) < 2:
        time.sleep(0.01)
    time.sleep(chance.uniform(0.05, 0.7 if number else 0.3) * usual[0])
    alive = ranks(output)
    if alive:
        os.kill(chance.choice(alive), signal.SIGKILL)
    _, errors = child.communicate(timeout=HANGS)
    if child.returncode:
        assert child.returncode == 70, errors
        # While MPI begins, the other rank may find out before mpirun does.
        assert "signal 9" in errors or "unable to reach each other" in errors
        assert "Traceback" not in errors
    if (output / "DONE").exists():  # it was killed on its way out
        assert numbers(output) == usual[1]
    else:
        assert child.returncode
    assert not processes(output)
    support.python(*arguments(output, *TWO, "--force"), TMPDIR=str(temporary))
    assert numbers(output) == usual[1]
    assert not list(output.glob("*.partial")) and not list(temporary.iterdir())


@pytest.mark.parametrize(
    ("phase", "error", "rank"),
    [
        pytest.param(
            phase,
            error,
            rank,
            marks=() if (phase, error) == ("solve", "internal") else pytest.mark.slow,
        )
        for phase in ("mesh", "distribution", "assembly", "solve", "output", "checkpoint")
        for error in CODES
        for rank in (0, 1)
        if (phase, rank) != ("mesh", 1)
    ],
)
def test_fault_ranks_error_on_one_ends_all(
    phase: str, error: str, rank: int, tmp_path: Path
) -> None:
    output = tmp_path / "out"
    done = subprocess.run(
        support.mpirun(2, "-m", "tests.robustness.faulty_rank", *arguments(output)[2:]),
        env=support.environment() | {"PHASE": phase, "ERROR": error, "RANK": str(rank)},
        capture_output=True,
        text=True,
        timeout=HANGS,
    )
    assert done.returncode == CODES[error], done.stderr
    assert error == "interrupt" or "thrown here" in done.stderr
    assert not (output / "DONE").exists()
    assert not processes(output)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(10))
def test_fault_ranks_end_with_a_killed_mpirun(number: int, tmp_path: Path) -> None:
    """Without it the ranks would deadlock."""
    output = tmp_path / "out"
    child = subprocess.Popen(
        support.mpirun(2, *arguments(output, "--set", "mesh.size=1 mm")),
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
