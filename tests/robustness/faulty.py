"""A small run in an environment where something is wrong."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support import CONFIGS, environment

CASE = CONFIGS / "blocks.yaml"
OPTIONS = ("--set", "mesh.order=1", "--set", "mesh.size=5 mm", "--set", "mesh.far_size=5 mm")
UNSHARE = ("unshare", "-m", "--propagation", "unchanged")
DAMAGES = ["truncated", "garbage", "zero length", "tail lost"]


def damage(path: Path, how: str) -> None:
    raw = path.read_bytes()
    cut = {"truncated": raw[: len(raw) // 3], "zero length": b"", "tail lost": raw[:-64]}
    path.write_bytes(cut.get(how, bytes(range(256)) * (len(raw) // 256)))


def run(
    output: Path, path: str, cache: Path | str | None, *before: str, **more: str
) -> subprocess.CompletedProcess[str]:
    """Run a small case, after some commands of the shell in a mount namespace of its own."""
    command = [sys.executable, "-m", "mantle", "run", str(CASE), "-o", str(output), *OPTIONS]
    environ = environment() | {"PYTHONPATH": path} | more
    environ |= {"XDG_CACHE_HOME": str(cache)} if cache else {}
    if before:
        private = 'mount --make-rprivate "$(findmnt -n -o TARGET --target "$PWD")"'
        script = "; ".join(["set -e", private, *before])
        command = [*UNSHARE, "sh", "-c", script + '; exec "$@"', "sh", *command]
    return subprocess.run(command, env=environ, capture_output=True, text=True, timeout=300)


HERE = environment()["PYTHONPATH"]
slow = pytest.mark.slow
mounts = pytest.mark.skipif(
    os.geteuid() != 0
    or not shutil.which("mount")
    or subprocess.run([*UNSHARE, "true"], check=False).returncode != 0,
    reason="only root may mount a small disk",
)
