"""A small run in an environment with a fault."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests import support

CASE = support.CONFIGS / "blocks.yaml"
# A run of some steps with all that is written.
OPTIONS = support.sets(
    *("mesh.order=1", "mesh.size=5 mm", "mesh.far_size=5 mm"),
    *("output.checkpoint.steps=1", "stages=[{name: press, increments: 3}]"),
)
UNSHARE = ("unshare", "-m", "--propagation", "unchanged")
DAMAGES = ["truncated", "garbage", "zero length", "tail lost"]

mounts = pytest.mark.skipif(
    os.geteuid() != 0
    or not shutil.which("mount")
    or subprocess.run([*UNSHARE, "true"], check=False).returncode != 0,
    reason="only root may mount a small disk",
)


def damage(path: Path, how: str) -> None:
    raw = path.read_bytes()
    cut = {"truncated": raw[: len(raw) // 3], "zero length": b"", "tail lost": raw[:-64]}
    path.write_bytes(cut.get(how, bytes(range(256)) * (len(raw) // 256)))


def arguments(output: Path, *more: str) -> list[str]:
    """Arguments of Python that run the case."""
    return ["-m", "mantle", "run", str(CASE), "-o", str(output), *OPTIONS, *more]


def command(output: Path, *more: str) -> list[str]:
    return [sys.executable, *arguments(output, *more)]


def start(output: Path, *more: str, session: bool = False, **environ: str) -> subprocess.Popen[str]:
    """Start the run without waiting; with ``session``, as leader of a process group."""
    return support.started(*arguments(output, *more), session=session, **environ)


def numbers(output: Path) -> dict[str, Any]:
    """Numbers rounded, because sums depend on the order of ranks."""
    q = support.summary(output)["interfaces"]
    return {name: round(v["pressure_mean"], 8) for name, v in q.items()}
