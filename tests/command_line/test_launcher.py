"""The launcher: usage, set-up that is interrupted or runs twice, ranks, signals, exit codes.

The tests run inside a solver stack, so the launcher finds dolfinx natively. A stand-in of
mmdebstrap, which makes an empty tree, tests the set-up.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import dolfinx
import pytest

import mantle
from app.command_line.parser import parser
from docs import packages
from tests.cases.gmsh_scripts import CASE, LAYERS
from tests.cases.misleading import mislead
from tests.support import ROOT, python, started

MANTLE = ROOT / "mantle"

# A stand-in for the application on every rank.
RANK = """
import os, signal, sys, time
received = []
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1):
    signal.signal(number, lambda number, frame: received.append(number))
from mpi4py import MPI
world = MPI.COMM_WORLD
what, value = sys.argv[1], sys.argv[2]
if what == "leave":
    sys.exit(int(value))
if what == "crash":
    if world.rank == world.size - 1:
        os.kill(os.getpid(), signal.SIGSEGV)
    world.barrier()
if what == "wait":
    if world.rank == 0:
        print("ready", flush=True)
    start = time.monotonic()
    while time.monotonic() - start < 30 and not world.allreduce(len(received), MPI.MAX):
        time.sleep(0.05)
    time.sleep(float(value))  # saving the state
    print(f"saved after {signal.Signals(received[0]).name}", flush=True)
    world.barrier()
    sys.exit(5)
"""
LAUNCH = """
import sys
from app.system import ranks
sys.exit(ranks.launch(int(sys.argv[1]), sys.argv[2:]))
"""


def run(
    *arguments: str | Path, cwd: Path | None = None, **more: str
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["sh", MANTLE, *arguments],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=120,
        env={**os.environ, **more},
        stdin=subprocess.DEVNULL,
    )


def on_ranks(number: int, tmp_path: Path, *arguments: str) -> list[str]:
    script = tmp_path / "rank.py"
    script.write_text(RANK)
    return ["-c", LAUNCH, str(number), sys.executable, str(script), *arguments]


@pytest.mark.parametrize(
    ("words", "code", "printed"),
    [
        ("", 2, "usage: mantle COMMAND"),
        ("--version", 0, f"mantle {mantle.__version__}\n"),  # without a solver stack
        ("doctor", 2, "'cloud' is not one of native, wheels, container, tree"),
        ("setup --update someday", 2, "--update"),
        ("setup --upgrade", 2, "--update"),
    ],
)
def test_launcher_commands_without_solver_stack(words: str, code: int, printed: str) -> None:
    path = "/bin:/usr/bin"
    result = run(*words.split(), MANTLE_BACKEND="cloud", MANTLE_INSIDE="", PATH=path)
    assert result.returncode == code and printed in result.stdout + result.stderr


def test_launcher_help_lists_every_command() -> None:
    result = run("--help")
    assert result.returncode == 0
    for word in ("test [ARGS]", "shell", "setup", "first steps", "MANTLE_BACKEND"):
        assert word in result.stdout
    (commands,) = (a for a in parser()._actions if isinstance(a, argparse._SubParsersAction))
    lines = [f"  {a.dest:<10} {a.help}" for a in commands._choices_actions]
    assert len(lines) == 15 and set(lines) <= set(result.stdout.splitlines())


def test_launcher_shell_has_dolfinx_and_one_thread(tmp_path: Path) -> None:
    python = 'python3 -c "import dolfinx, mantle; print(dolfinx.__version__)"'
    command = f"{python}; echo $OMP_NUM_THREADS; pwd; exit 4"
    native = {"MANTLE_BACKEND": "native", "MANTLE_INSIDE": "", "OMP_NUM_THREADS": ""}
    result = run("shell", "-c", command, cwd=tmp_path, **native)
    assert (result.returncode, result.stderr) == (4, "")
    assert result.stdout.split() == [dolfinx.__version__, "1", str(tmp_path)]


# Finds all that it is asked for, notes what it runs under which kernel, and fails under Haswell.
PYTHON = """[ "$1" != - ] || exit 0
echo "${OPENBLAS_CORETYPE:-}|${GLIBC_TUNABLES:-}|$*" >>"$CALLS"
[ "${OPENBLAS_CORETYPE:-}" != Haswell ]
"""


@pytest.mark.skipif("avx2" not in Path("/proc/cpuinfo").read_text(), reason="no processor for it")
def test_launcher_test_all_repeats_on_other_kernels_and_orders(tmp_path: Path) -> None:
    """The arguments are the same. One failure fails the whole command. A seed sets the order."""
    calls = tmp_path / "calls"
    program(tmp_path / "python3", PYTHON)
    more = {"PATH": f"{tmp_path}:{os.environ['PATH']}", "CALLS": str(calls)}
    more |= {"MANTLE_BACKEND": "native", "MANTLE_INSIDE": "", "XDG_CACHE_HOME": str(tmp_path)}
    result = run("test", "--all", OPENBLAS_CORETYPE="", GLIBC_TUNABLES="", **more)
    printed = result.stdout.splitlines()[-1]
    assert result.returncode == 1 and "Haswell FAILED" in printed and "Nehalem ok" in printed
    lines = [line.split("|") for line in calls.read_text().splitlines()]
    tests = [line for line in lines if "tests/verification" in line[2]]
    kernels = [kernel for kernel, _, _ in tests if kernel]
    assert kernels[:4] == ["Nehalem", "Sandybridge", "Haswell", "Zen"]
    assert kernels[4:] in ([], ["SkylakeX"])
    (without,) = [what for _, tunables, what in tests if "-AVX512F,-AVX2,-FMA" in tunables]
    (shuffled,) = [what for _, _, what in tests if "--random-order" in what]
    assert {what for kernel, _, what in tests if kernel} == {without}
    assert shuffled.startswith(f"{without} --random-order --random-order-seed=")
    calls.unlink()
    for some in (["-k", "name"], ["-m", "slow"]):
        run("test", "--all", *some, **more)
    assert "tests/verification" not in calls.read_text()


@pytest.mark.parametrize("home", ["/proc", "/dev/null/home", ""])
def test_launcher_with_a_read_only_home(home: str) -> None:
    result = run("shell", "-c", 'test -w "$XDG_CACHE_HOME"', HOME=home, XDG_CACHE_HOME="")
    assert result.returncode == 0, result.stderr


# ------------------------------------------------------------------------------------- set-up


def program(path: Path, text: str) -> None:
    path.parent.mkdir(exist_ok=True)
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)


def set_up(tmp_path: Path, mmdebstrap: str, *arguments: str) -> subprocess.Popen[str]:
    """Start a set-up in which ``mmdebstrap`` is a script; TARGET is the tree that it makes."""
    programs = tmp_path / "bin"
    head = 'for word; do case $word in *.part) TARGET=$word ;; esac; done; echo run >>"$LOG"\n'
    program(programs / "mmdebstrap", head + mmdebstrap)
    program(programs / "apt-config", APT)
    return subprocess.Popen(
        ["sh", MANTLE, "setup", *arguments],
        env={
            **os.environ,
            "PATH": f"{programs}:{os.environ['PATH']}",
            "MANTLE_BACKEND": "tree",
            "MANTLE_INSIDE": "",
            "MANTLE_TREE": "",
            "XDG_CACHE_HOME": str(tmp_path / "cache"),
            "LOG": str(tmp_path / "log"),
        },
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def trees(tmp_path: Path) -> list[Path]:
    return list((tmp_path / "cache" / "mantle").glob("tree-*"))


def set_ups(tmp_path: Path) -> int:
    """Number of calls of mmdebstrap."""
    return (tmp_path / "log").read_text().count("run")


def made(tmp_path: Path, mmdebstrap: str, *arguments: str) -> tuple[Path, str]:
    """The tree after a set-up, and the output."""
    _, printed = set_up(tmp_path, mmdebstrap, *arguments).communicate(timeout=60)
    (tree,) = trees(tmp_path)
    return tree, printed


as_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root sets up a tree")
MS_BIND = 4096
MNT_DETACH = 2
UNMOUNT = "import ctypes, sys; sys.exit(ctypes.CDLL(None).umount2(sys.argv[1].encode(), 2))"
EMPTY_TREE = 'mkdir -p "$TARGET/etc" "$TARGET/mnt"\n'
# As mmdebstrap keeps the options of apt and the archives.
KEEPING = """
for word; do case $word in --aptopt=*) OPTIONS=${word#*=} ;; esac; done
mkdir -p "$TARGET/etc/apt/apt.conf.d"
cp "$OPTIONS" "$TARGET/etc/apt/apt.conf.d/99mmdebstrap"
echo "deb http://me:secret@archive/debian trixie main" >"$TARGET/etc/apt/sources.list"
"""
APT = """[ "$1" = dump ] && echo 'Acquire::http::Proxy "http://me:secret@proxy:3128/";'"""


@as_root
def test_launcher_failed_set_up_is_removed_by_the_next(tmp_path: Path) -> None:
    failed = set_up(tmp_path, EMPTY_TREE + 'touch "$TARGET/half"; exit 1\n')
    _, output = failed.communicate(timeout=60)
    assert failed.returncode == 69
    assert "mmdebstrap failed" in output
    assert all(".part" in tree.name for tree in trees(tmp_path))
    tree, _ = made(tmp_path, EMPTY_TREE)
    assert ".part" not in tree.name and not (tree / "half").exists()


@as_root
def test_launcher_killed_set_up_mounts_are_not_removed(tmp_path: Path) -> None:
    """Folders of the host, such as /dev, were mounted below the unfinished tree."""
    failed = set_up(tmp_path, EMPTY_TREE + 'mkdir "$TARGET/dev"; exit 1\n')
    failed.communicate(timeout=60)
    (half,) = trees(tmp_path)
    host, libc = tmp_path / "host", ctypes.CDLL(None)  # the stack has no mount and umount
    host.mkdir()
    (host / "null").touch()
    program(tmp_path / "bin" / "umount", f"exec {sys.executable} -c '{UNMOUNT}' \"$2\"")
    if libc.mount(bytes(host), bytes(half / "dev"), None, MS_BIND, None):
        pytest.skip("this root may not mount")
    try:
        tree, _ = made(tmp_path, EMPTY_TREE)
    finally:
        libc.umount2(bytes(half / "dev"), MNT_DETACH)
    assert (host / "null").exists() and not (tree / "dev").exists()


@as_root
def test_launcher_set_up_has_private_mounts(tmp_path: Path) -> None:
    made(tmp_path, EMPTY_TREE + 'readlink /proc/self/ns/mnt >>"$LOG"\n')
    assert os.readlink("/proc/self/ns/mnt") not in (tmp_path / "log").read_text()


@as_root
def test_launcher_killed_set_up_is_repeated(tmp_path: Path) -> None:
    first = set_up(tmp_path, EMPTY_TREE + "exec sleep 1\n")
    while not (tmp_path / "log").exists():
        time.sleep(0.05)
    first.kill()
    first.communicate(timeout=60)
    made(tmp_path, EMPTY_TREE)
    assert set_ups(tmp_path) == 2


@as_root
def test_launcher_two_set_ups_make_one_tree(tmp_path: Path) -> None:
    both = [set_up(tmp_path, EMPTY_TREE + "sleep 1\n") for _ in range(2)]
    output = "".join(process.communicate(timeout=60)[1] for process in both)
    assert "another set-up is running; waiting for it" in output
    assert set_ups(tmp_path) == 1
    assert len(trees(tmp_path)) == 1


@as_root
def test_launcher_set_up_with_a_group_umask(tmp_path: Path) -> None:
    before = os.umask(0o002)
    try:
        for _ in range(2):
            assert "not used" not in made(tmp_path, EMPTY_TREE)[1]
    finally:
        os.umask(before)
    assert set_ups(tmp_path) == 1


@as_root
def test_launcher_tree_contains_no_password(tmp_path: Path) -> None:
    tree, _ = made(tmp_path, EMPTY_TREE + KEEPING)
    options = (tree / "etc/apt/apt.conf.d/99mmdebstrap").read_text()
    assert "Install-Recommends" in options and "Proxy" not in options
    sources = (tree / "etc/apt/sources.list").read_text()
    assert sources == "deb http://archive/debian trixie main\n"
    for path in (tmp_path / "cache").rglob("*"):
        assert not path.is_file() or "secret" not in path.read_text(), path


@as_root
def test_launcher_tree_is_renewed_if_older_than_given(tmp_path: Path) -> None:
    made(tmp_path, EMPTY_TREE + 'touch "$TARGET/first"\n')
    tree, _ = made(tmp_path, EMPTY_TREE, "--update", "2001-01-01")
    assert set_ups(tmp_path) == 1 and (tree / "first").exists()
    os.utime(tree / "etc/mantle-tree", (1e9, 1e9))
    tree, _ = made(tmp_path, EMPTY_TREE, "--update", "yesterday")
    assert set_ups(tmp_path) == 2 and not (tree / "first").exists()
    assert "slurm-wlm" not in (tree / "etc/mantle-tree").read_text().split()
    tree, _ = made(tmp_path, EMPTY_TREE, "--all")
    assert "slurm-wlm" in (tree / "etc/mantle-tree").read_text().split()


def test_launcher_tree_is_set_up_only_by_root(tmp_path: Path) -> None:
    program(tmp_path / "bin" / "id", "echo 1000")
    _, printed = set_up(tmp_path, EMPTY_TREE).communicate(timeout=60)
    assert "only root can set up a tree" in printed and "--wheels" in printed
    assert trees(tmp_path) == []


def test_launcher_named_tree_is_never_set_up(tmp_path: Path) -> None:
    more = {"MANTLE_BACKEND": "tree", "MANTLE_TREE": "/no/tree", "XDG_CACHE_HOME": str(tmp_path)}
    result = run("doctor", MANTLE_INSIDE="", **more)
    assert result.returncode == 69 and "no solver stack in MANTLE_TREE=/no/tree" in result.stderr
    assert trees(tmp_path) == []


# A Python with headers in HEADERS, whose environments note what they are asked.
HOST = """
case "$*" in
    *get_path*) echo "$HEADERS" ;;
    "-m venv "*) mkdir -p "$3/bin" && cp "$0" "$3/bin/python3" ;;
    *) echo "$*" >>"$LOG"; [ "$2" != pip ] || [ -z "${BROKEN:-}" ] ;;
esac
"""


def wheels(tmp_path: Path, **more: str) -> subprocess.CompletedProcess[str]:
    """Set up wheels with a stand-in of Python 3.12."""
    (tmp_path / "Python.h").touch()
    program(tmp_path / "bin" / "python3.12", HOST)
    environ = {"PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}", "LOG": str(tmp_path / "log")}
    environ |= {"XDG_CACHE_HOME": str(tmp_path / "cache"), "HEADERS": str(tmp_path)}
    return run("setup", "--wheels", MANTLE_INSIDE="", **environ | more)


def test_launcher_wheels_are_set_up_once(tmp_path: Path) -> None:
    assert wheels(tmp_path).returncode == 0
    assert wheels(tmp_path).returncode == 0
    asked = (tmp_path / "log").read_text()
    (installed,) = re.findall("^-m pip install.*", asked, re.MULTILINE)
    assert set(packages.requirements("wheel")) <= set(installed.split())
    (folder,) = (tmp_path / "cache" / "mantle").glob("wheels-*")
    assert (folder / "mantle-wheels").exists()


@pytest.mark.parametrize(
    ("more", "printed"),
    [
        ({"BROKEN": "yes"}, "wheels could not be installed"),
        ({"HEADERS": "/nowhere"}, "python3-dev"),
    ],
)
def test_launcher_failed_wheels_leave_nothing(
    more: dict[str, str], printed: str, tmp_path: Path
) -> None:
    result = wheels(tmp_path, **more)
    assert result.returncode == 69 and printed in result.stderr
    assert not [*(tmp_path / "cache" / "mantle").glob("wheels-*")]


def test_launcher_wheels_need_a_new_python(tmp_path: Path) -> None:
    for name in ("python3.12", "python3.13", "python3.14", "python3"):
        program(tmp_path / "bin" / name, "exit 1")
    path = f"{tmp_path / 'bin'}:{os.environ['PATH']}"
    cache = str(tmp_path / "cache")
    result = run("setup", "--wheels", PATH=path, MANTLE_INSIDE="", XDG_CACHE_HOME=cache)
    assert result.returncode == 69 and "Python 3.12 or newer" in result.stderr


def test_launcher_container_client_needs_an_engine(tmp_path: Path) -> None:
    for name in ("docker", "podman"):
        program(tmp_path / name, "echo 'cannot connect' >&2; exit 1")
    path = f"{tmp_path}:{os.environ['PATH']}"
    result = run("setup", PATH=path, MANTLE_BACKEND="container", MANTLE_INSIDE="")
    assert result.returncode == 69
    assert "neither docker nor podman has a running engine" in result.stderr


# -------------------------------------------------------------------------------------- ranks


@pytest.mark.parallel
@pytest.mark.parametrize("number", [1, 2, 3])
def test_launcher_returns_the_exit_code_of_ranks(number: int, tmp_path: Path) -> None:
    result = python(*on_ranks(number, tmp_path, "leave", "4"), code=4)
    assert (result.stdout, result.stderr) == ("", "")


@pytest.mark.parallel
def test_launcher_crash_of_one_rank_ends_all(tmp_path: Path) -> None:
    assert "signal 11" in python(*on_ranks(2, tmp_path, "crash", "0"), code=70).stderr


def ready(command: list[str]) -> subprocess.Popen[str]:
    """Start Python in a separate process group, and wait until it reports that it is ready."""
    process = started(*command, session=True)
    assert process.stdout is not None and process.stdout.readline() == "ready\n"
    return process


@pytest.mark.parallel
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_launcher_signal_lets_ranks_save_their_state(
    number: signal.Signals, tmp_path: Path
) -> None:
    process = ready(on_ranks(2, tmp_path, "wait", "2"))
    os.killpg(process.pid, number)  # as the terminal does it
    output, message = process.communicate(timeout=60)
    assert process.returncode == 5
    assert output.count("saved after SIGUSR1") == 2
    assert message == "mantle: stopping when the state is saved (a second signal stops at once)\n"


@pytest.mark.parallel
def test_launcher_early_signal_stops_the_run() -> None:
    process = ready(["-c", LAUNCH, "2", "sh", "-c", "echo ready; exec sleep 30"])
    os.killpg(process.pid, signal.SIGINT)
    _, message = process.communicate(timeout=30)
    assert process.returncode == 5
    assert message.splitlines()[-1].startswith("mantle: stopped")


@pytest.mark.parallel
def test_launcher_second_signal_stops_at_once(tmp_path: Path) -> None:
    process = ready(on_ranks(2, tmp_path, "wait", "60"))
    for _ in range(2):
        os.killpg(process.pid, signal.SIGINT)
        time.sleep(1.2)  # less would be taken for the same signal
    _, message = process.communicate(timeout=30)
    assert process.returncode == 130
    assert "stopped before the state was saved" in message


# ---------------------------------------------------------------------------------- who and where


INSTALLED = (
    "import sys; sys.path.insert(0, sys.argv.pop(1)); from app.cli import main; sys.exit(main())"
)
CHECKED = "import mantle; mantle.check(mantle.load('blocks.yaml'), meshed=True)"


@pytest.mark.parallel
@pytest.mark.parametrize(
    "command",
    [
        # Launcher, sweep, Snakemake, mpirun and ranks each start a Python.
        ["sh", MANTLE, "sweep", "sweep.yaml", "-o", "out"],
        # The script that pip makes has the program's folder in front, and no environment.
        [sys.executable, "-P", "-c", INSTALLED, ROOT, *"run blocks.yaml -n 2 -o out".split()],
        # One rank, and the process that meshes a script.
        ["sh", MANTLE, "run", "layers.yaml", "-o", "out", "--allow-scripts"],
        ["sh", MANTLE, "shell", "-c", f'python3 -c "{CHECKED}"'],
        ["sh", MANTLE, "shell", "-c", "python3 -m mantle mesh blocks.yaml"],
    ],
    ids=["sweep", "installed", "script", "API", "module"],
)
def test_launcher_ignores_modules_of_the_current_folder(
    command: list[str | Path], tmp_path: Path
) -> None:
    mislead(tmp_path)
    (tmp_path / "a.geo").write_text(f"{LAYERS}// {tmp_path}: in no cache\n")
    (tmp_path / "layers.yaml").write_text(CASE)
    result = subprocess.run(
        command,
        cwd=tmp_path,
        env={k: v for k, v in os.environ.items() if k not in ("PYTHONSAFEPATH", "PYTHONPATH")},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    assert not (tmp_path / "petsc.txt").exists()
    done = [*tmp_path.glob("out/**/DONE")]
    assert done or "shell" in command
    if "sweep" in command:
        assert json.loads((done[0].parent / "provenance.json").read_text())["ranks"] == 2


def test_launcher_other_users_write_only_cache_and_output(tmp_path: Path) -> None:
    # Not below tmp_path, whose parents are closed to others.
    with tempfile.TemporaryDirectory(dir="/tmp") as name:
        folder = Path(name)
        folder.chmod(0o755)
        for part in (folder / "home", folder / "work"):
            part.mkdir()
        who: list[str] = []
        if os.geteuid() == 0:
            for part in (folder / "home", folder / "work"):
                os.chown(part, 65534, 65534)
            who = ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups"]
            readable = subprocess.run([*who, "test", "-r", MANTLE], check=False).returncode == 0
            if not readable:
                pytest.skip(f"others cannot read {ROOT}")
        case = ROOT / "configs" / "blocks.yaml"
        done = subprocess.run(
            [*who, "sh", MANTLE, "mesh", case, "-o", "out/$(touch PWNED);'\"/mesh"],
            cwd=folder / "work",
            env={
                "PATH": os.environ["PATH"],
                "HOME": str(folder / "home"),
                "PYTHONPATH": str(ROOT),
                "MANTLE_BACKEND": "native",
                "PYTHONDONTWRITEBYTECODE": "1",
            },
            capture_output=True,
            text=True,
            timeout=120,
        )
        assert done.returncode == 0, done.stderr
        written = {p.relative_to(folder).parts[:2] for p in folder.rglob("*") if p.is_file()}
        assert written == {("home", ".cache"), ("work", "out")}
