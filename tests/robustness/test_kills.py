"""Runs killed at random moments leave no wrong or obstructive files."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest

from tests.robustness import faulty
from tests.robustness.faulty import numbers

pytestmark = pytest.mark.slow
# Every fifth begins with an empty cache: it is killed while it meshes and compiles.
COLD = 5
FILES = {"case.yaml", "fields.vtkhdf", "history.csv", "provenance.json", "summary.json", "DONE"}
FILES |= {"final.vtkhdf", "case.png", "report.html", "checkpoint-2.state", "checkpoint-3.state"}


def start(output: Path, folder: Path, *more: str) -> subprocess.Popen[str]:
    """A run with cache and temporary files in a folder, as leader of a process group."""
    (folder / "tmp").mkdir(exist_ok=True)
    environ = {"XDG_CACHE_HOME": str(folder / "cache"), "TMPDIR": f"{folder}/tmp"}
    return faulty.start(output, *more, session=True, **environ)


def finish(child: subprocess.Popen[str]) -> None:
    printed = child.communicate(timeout=600)[1]
    assert child.returncode == 0, printed


@pytest.fixture(scope="module")
def usual(
    warmed: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[dict[bool, float], object]:
    """Seconds of a run with an empty cache and with a full one, and its numbers."""
    folder = tmp_path_factory.mktemp("usual")
    seconds = {}
    for cold in (True, False):
        begin = time.monotonic()
        finish(start(folder / "out", folder, "--force"))
        seconds[cold] = time.monotonic() - begin
    return seconds, numbers(folder / "out")


@pytest.mark.parametrize("number", range(20))
def test_kills_at_any_moment(
    number: int, usual: tuple[dict[bool, float], object], warmed: Path, tmp_path: Path
) -> None:
    chance, cold = random.Random(number), number % COLD == 0
    if not cold:
        shutil.copytree(warmed, tmp_path / "cache")
    output = tmp_path / "out"
    child = start(output, tmp_path)
    try:
        child.wait(timeout=chance.uniform(0.0, 1.1) * usual[0][cold])
    except subprocess.TimeoutExpired:
        # The process, or all that it has started too, as a scheduler does it.
        os.killpg(child.pid, signal.SIGKILL) if number % 2 else child.kill()
    child.communicate(timeout=60)
    if (output / "DONE").exists():
        assert numbers(output) == usual[1]
    finish(start(output, tmp_path, "--force"))
    assert numbers(output) == usual[1]
    assert {p.name for p in output.iterdir()} == FILES
    left = [p.name for p in (tmp_path / "cache").rglob("*")]
    assert not [n for n in left if n.endswith((".part", ".partial", ".failed"))]
    sources = {n.removesuffix(".c") for n in left if n.endswith(".c")}
    assert sources == {n.removesuffix(".c.cached") for n in left if n.endswith(".c.cached")}
    assert not list((tmp_path / "tmp").iterdir())
