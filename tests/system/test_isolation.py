"""Isolated runs: they write to one folder, and reach neither network, processes nor devices."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests import restarted, support

# What a case of somebody else may try, and whether it worked.
TRY = """
import ctypes, json, os, signal, socket, sys
from pathlib import Path
output, victim, port, process = sys.argv[1:]
def succeeds(action):
    try:
        action()
    except OSError:
        return False
    return True
def connect(family, address):
    with socket.socket(family) as s:
        s.connect(address)
def mounts():
    if ctypes.CDLL(None).mount(b"none", b"/mnt", b"tmpfs", 0, None):
        raise OSError
    os.unlink("/mnt/x")
found = {
    "output": succeeds(lambda: Path(output, "new").write_text("x")),
    "reads": succeeds(lambda: Path(victim).read_text()),
    "case": succeeds(lambda: Path(victim).write_text("changed")),
    "beside": succeeds(lambda: Path(victim).with_name("new").write_text("x")),
    "cache": succeeds(lambda: Path(os.environ["MANTLE_SEED"], "new").write_text("x")),
    "network": succeeds(lambda: connect(socket.AF_INET, ("127.0.0.1", int(port)))),
    "socket": succeeds(lambda: connect(socket.AF_UNIX, "\\0mantle-test-" + port)),
    "process": succeeds(lambda: os.kill(int(process), 0)),
    "processes": len([p for p in os.listdir("/proc") if p.isdigit()]) > 2,
    "disks": any(not Path("/dev", n).is_char_device() and n not in
                 ("shm", "fd", "stdin", "stdout", "stderr") for n in os.listdir("/dev")),
    "kernel": succeeds(lambda: Path("/proc/sys/kernel/core_pattern").open("r+")),
    "mounts": succeeds(mounts),
    "remounts": ctypes.CDLL(None).mount(None, b"/", None, 32 | 4096, None) == 0,
    "owner": os.geteuid() == 0 and succeeds(lambda: os.chown(Path(output, "new"), 1, 1)),
    "privileges": "NoNewPrivs:\\t1" not in Path("/proc/self/status").read_text(),
    "capabilities": any(int(line.split()[1], 16) for line in
                        Path("/proc/self/status").read_text().splitlines() if line[:3] == "Cap"),
}
Path(output, "found").write_text(json.dumps(found))
sys.exit(7)
"""
RUN = """
import sys
from pathlib import Path
from app.system import isolation
sys.exit(isolation.run(sys.argv[3:], Path(sys.argv[1]), [Path(sys.argv[2])]))
"""
NOBODY = 65534
AS_NOBODY = ["setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups"]


def possible(who: list[str]) -> bool:
    command = [*who, "unshare", *(["-r"] if who else []), "-mnpf", "--mount-proc", "true"]
    return subprocess.run(command, capture_output=True).returncode == 0


WHO = [
    pytest.param([], id="user"),
    pytest.param(
        AS_NOBODY,
        id="nobody",
        marks=pytest.mark.skipif(os.geteuid() != 0, reason="only root becomes somebody else"),
    ),
]


@pytest.fixture
def place() -> Iterator[Path]:
    """A folder that all may enter, in which ``out`` is everybody's and ``cases`` too."""
    with tempfile.TemporaryDirectory(dir="/tmp") as name:
        folder = Path(name)
        folder.chmod(0o755)
        for part in ("out", "cases", "cache"):
            (folder / part).mkdir()
            (folder / part).chmod(0o777)
        (folder / "cases" / "case.yaml").write_text("mine")
        (folder / "cases" / "case.yaml").chmod(0o666)
        yield folder


@pytest.mark.parametrize("who", WHO)
def test_a_program_writes_to_one_folder_alone(who: list[str], place: Path) -> None:
    if not possible(who):
        pytest.skip("no namespaces here")
    victim, output = place / "cases" / "case.yaml", place / "out"
    with socket.create_server(("127.0.0.1", 0)) as server, socket.socket(socket.AF_UNIX) as unix:
        port = server.getsockname()[1]
        unix.bind(f"\0mantle-test-{port}")
        unix.listen()
        done = subprocess.run(
            [
                *(*who, sys.executable, "-c", RUN, output, victim.parent),
                *(sys.executable, "-c", TRY, output, victim, str(port), str(os.getpid())),
            ],
            env=support.environment() | {"XDG_CACHE_HOME": str(place / "cache")},
            cwd=place,
            capture_output=True,
            text=True,
        )
    assert done.returncode == 7, done.stderr
    found = json.loads((output / "found").read_text())
    assert {name for name, worked in found.items() if worked} == {"output", "reads"}
    assert victim.read_text() == "mine" and not (place / "cases" / "new").exists()


def start(case: Path, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "mantle", "run", str(case), *arguments, "--isolate"],
        env=support.environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=case.parent,
    )


@pytest.fixture
def case(tmp_path: Path) -> Path:
    if not possible([]):
        pytest.skip("no namespaces here")
    path = tmp_path / "case.yaml"
    path.write_text(restarted.RUBBING)
    return path


def test_an_isolated_run_has_the_same_numbers(case: Path, tmp_path: Path) -> None:
    child = start(case, "-o", "isolated", "--set", "output.fields=false")
    _, told = child.communicate(timeout=60)
    assert child.returncode == 0, told
    restarted.whole(restarted.RUBBING, tmp_path, "output.fields=false")
    restarted.assert_same(tmp_path / "whole", tmp_path / "isolated")
    assert {p.name for p in tmp_path.iterdir()} == {"case.yaml", "isolated", "whole"}


def test_a_signal_stops_an_isolated_run_with_its_state_saved(case: Path, tmp_path: Path) -> None:
    child = start(case, "-o", "out", "--set", "stages.1.increments=400")
    assert child.stdout is not None
    while not child.stdout.readline().startswith("   1 "):
        assert child.poll() is None
    child.send_signal(signal.SIGTERM)
    _, told = child.communicate(timeout=60)
    assert child.returncode == 5 and "state saved in" in told
    assert list((tmp_path / "out").glob("checkpoint-*"))


def test_a_killed_launcher_takes_the_run_with_it(case: Path, tmp_path: Path) -> None:
    child = start(case, "-o", "out", "--set", "stages.1.increments=4000")
    assert child.stdout is not None
    while not child.stdout.readline().startswith("   1 "):
        assert child.poll() is None
    child.kill()
    child.communicate(timeout=60)
    end = time.monotonic() + 10
    while any(str(case).encode() in command(p) for p in Path("/proc").glob("[0-9]*")):
        assert time.monotonic() < end
        time.sleep(0.05)


def command(process: Path) -> bytes:
    try:
        return (process / "cmdline").read_bytes()
    except OSError:
        return b""


def test_a_machine_without_namespaces_is_told(tmp_path: Path) -> None:
    """As in a container: nothing runs that is not isolated."""
    (tmp_path / "case.yaml").write_text(restarted.RUBBING)
    refuse = (
        "import ctypes, os\n"
        "from app.system import isolation\n"
        "def refuse(): raise PermissionError(1, 'Operation not permitted', 'unshare')\n"
        "isolation.separate = refuse\n"
        "from app.cli import main\n"
        "raise SystemExit(main(['run', 'case.yaml', '-o', 'out', '--isolate']))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", refuse],
        env=support.environment(),
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 69 and not list((tmp_path / "out").iterdir())
    assert "does not let this user separate a run: unshare Operation not permitted" in done.stderr
