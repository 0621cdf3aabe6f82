"""Full and read-only disks, and a folder of two runs.

Faults are reported, and the next run works.
"""

from __future__ import annotations

import random
import subprocess
from pathlib import Path

import pytest

from app.system import folders
from tests.robustness.faulty import UNSHARE, command, mounts, start
from tests.support import environment, summary


def script(lines: list[str], command: list[str], cache: Path, codes: int) -> tuple[list[str], str]:
    """Run a script in a separate mount namespace; return its exit codes and its output."""
    private = 'mount --make-rprivate "$(findmnt -n -o TARGET --target "$PWD")"'
    text = "\n".join([private, *lines])
    done = subprocess.run(
        [*UNSHARE, "sh", "-c", text, "sh", *command],
        env=environment() | {"XDG_CACHE_HOME": str(cache)},
        capture_output=True,
        text=True,
        timeout=300,
    )
    printed, _, codes_text = done.stderr.rpartition("codes ")
    assert len(codes_text.split()) == codes and "Traceback" not in printed, done.stderr
    return codes_text.split(), printed


def twice(command: list[str], size: int, disk: Path, cache: Path) -> tuple[list[int], str]:
    """Run on a disk of a size [kB], then again on a larger one; return exit codes and output."""
    lines = [
        f"mount -t tmpfs -o size={size}k,mode=777 none {disk}",
        '"$@"; first=$?',
        f"mount -o remount,size=200m {disk}",
        '"$@" --force; echo "codes $first $?" >&2',
        f"cp -r {disk} {disk}.kept",
    ]
    codes, printed = script(lines, command, cache, 2)
    return [int(code) for code in codes], printed


@mounts
@pytest.mark.slow
@pytest.mark.parametrize("size", [4, 12, 32, 64, 96, 160])
def test_fault_disk_full_output_folder(size: int, warmed: Path, tmp_path: Path) -> None:
    """Any of fields, history, checkpoints and summary may be the last before the disk is full."""
    (tmp_path / "out").mkdir()
    codes, printed = twice(command(tmp_path / "out"), size, tmp_path / "out", warmed)
    assert codes[0] in ((0, 5) if size > 64 else (5,)) and codes[1] == 0, printed
    if codes[0]:
        assert "No space left" in printed
    kept = tmp_path / "out.kept"
    assert (kept / "DONE").exists() and summary(kept)
    assert not list(kept.glob("*.partial"))


@mounts
@pytest.mark.slow
@pytest.mark.parametrize("size", [16, 128, 512, 1024, 2048])
def test_fault_disk_full_cache(size: int, tmp_path: Path) -> None:
    """Forms must be kept; meshes need not be kept."""
    (tmp_path / "cache").mkdir()
    codes, printed = twice(command(tmp_path / "out"), size, tmp_path / "cache", tmp_path / "cache")
    assert codes[0] in ((0, 69) if size > 64 else (69,)) and codes[1] == 0, printed
    if codes[0]:
        assert "a form cannot be compiled: " in printed and "MB free" in printed
    assert not list((tmp_path / "cache.kept").rglob("*.part"))


@mounts
@pytest.mark.slow
@pytest.mark.parametrize("number", range(4))
def test_fault_disk_becomes_read_only(number: int, warmed: Path, tmp_path: Path) -> None:
    """The disk becomes read-only at a random moment, like disks with errors."""
    out = tmp_path / "out"
    out.mkdir()
    moment = random.Random(number).uniform(0.3, 2.5)
    lines = [
        f"mount -t tmpfs -o mode=777 none {out}",
        '"$@" & pid=$!',
        f"sleep {moment}; until mount -o remount,ro {out} 2>/dev/null; do :; done",
        "wait $pid; first=$?",
        f"[ ! -e {out}/DONE ] || ended=yes",
        f"mount -o remount,rw {out}",
        '"$@" --force; echo "codes $first $? ${ended:-no}" >&2',
    ]
    (first, second, ended), printed = script(lines, command(out), warmed, 3)
    assert second == "0", printed
    assert (first, ended) in {("0", "yes"), ("5", "no"), ("2", "no")}, printed
    if first != "0":
        assert "Read-only file system" in printed or "is not writable" in printed


def test_fault_disk_folder_belongs_to_one_run(tmp_path: Path) -> None:
    with folders.claim(tmp_path):
        child = start(tmp_path)
        printed = child.communicate(timeout=60)[1]
    assert child.returncode == 2
    assert f"-o {tmp_path}: another run writes into it" in printed
    assert not list(tmp_path.iterdir())
    with folders.claim(tmp_path):
        pass
