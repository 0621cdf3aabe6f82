"""A run that can change nothing but its output folder: for cases that somebody else wrote.

It sees the files of the machine, read-only, and neither its network, nor its devices, nor other
processes, in namespaces of its own without any capability.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import signal
import socket
import struct
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import FrameType
from typing import NoReturn

from app.confined import (
    DROP_BOUND,
    NO_NEW_PRIVILEGES,
    call,
    code_of,
    die_with_parent,
    separate,
)
from app.errors import EnvironmentProblem, InputError
from app.system.folders import cache_home
from app.system.scratch import SHARED

# Of linux/mount.h.
RDONLY, NOSUID, NODEV, NOEXEC, BIND, REC, PRIVATE = 1, 2, 4, 8, 4096, 16384, 1 << 18
SETATTR, RECURSIVE, HERE = 442, 0x8000, -100  # a system call on all of Linux's own processors
UP, GET_FLAGS, SET_FLAGS = 0x1, 0x8913, 0x8914  # of a network interface
DEVICES = ("null", "zero", "full", "random", "urandom", "tty")
LINKS = {"fd": "fd", "stdin": "fd/0", "stdout": "fd/1", "stderr": "fd/2"}
PASSED_ON = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1)


def run(command: Sequence[str], output: Path, needed: Iterable[Path]) -> int:
    """Run a program that can write to one folder alone; its exit code.

    Args:
        command: The program and its arguments.
        output: The folder.
        needed: What it has to see, even in ``/tmp``.

    Raises:
        InputError: The folder cannot be shown.
        EnvironmentProblem: This machine does not let this user make namespaces.
    """
    output = output.resolve()
    seen = [output, Path.cwd(), *(path.resolve() for path in (*needed, *map(Path, sys.path)))]
    if any(output.is_relative_to(place) for place in ("/dev", "/proc", "/sys")):
        raise InputError(f"-o {output}: --isolate: choose a folder elsewhere")
    told, tell = os.pipe2(os.O_CLOEXEC)
    sys.stdout.flush()
    sys.stderr.flush()
    middle = os.fork()
    if not middle:
        _enter(command, output, seen, tell)
    os.close(tell)
    with open(told, "rb") as pipe:
        number, error = pipe.readline().strip(), pipe.read().decode().strip()
    if not number or error:
        os.waitpid(middle, 0)
        raise EnvironmentProblem(
            f"--isolate: this machine does not let this user separate a run: {error}\nnamespaces "
            "of users are switched off, or this is a container, which separates it by itself "
            "(docker run --network none --cap-drop ALL --read-only)"
        )

    def pass_on(received: int, frame: FrameType | None) -> None:
        os.kill(int(number), received)

    before = {s: signal.signal(s, pass_on) for s in PASSED_ON}
    try:
        return code_of(middle)
    finally:
        for s, handler in before.items():
            signal.signal(s, handler)


def _enter(command: Sequence[str], output: Path, seen: Sequence[Path], tell: int) -> NoReturn:
    """In a process of its own: make the namespaces, and the process that is the first in them."""
    for s in PASSED_ON:
        signal.signal(s, signal.SIG_IGN)
    try:
        die_with_parent()
        separate()
        first = os.fork()
        if first:
            os.write(tell, f"{first}\n".encode())
            os.close(tell)
            os._exit(code_of(first))
        for s in PASSED_ON:
            signal.signal(s, signal.SIG_DFL)
        die_with_parent()
        _close_up(output, seen)
        _give_up()
        os.chdir(os.getcwd())  # the folder as it is mounted now
        os.closerange(3, tell)
        os.closerange(tell + 1, 1 << 16)
        os.execve(command[0], list(command), _environment(os.environ))
    except OSError as error:
        os.write(tell, f"\n{error.filename or ''} {error.strerror}".encode())
    os._exit(EnvironmentProblem.exit_code)


def _close_up(output: Path, seen: Sequence[Path]) -> None:
    """Make everything read-only but one folder; devices, sockets and processes are not there."""
    devices = {name: os.open(f"/dev/{name}", os.O_PATH) for name in DEVICES if _there(name)}
    call("mount", None, "/", None, REC | PRIVATE, None)
    call("mount", output, output, None, BIND, None)
    call("mount", "proc", "/proc", "proc", RDONLY | NOSUID | NODEV | NOEXEC, None)
    _set_attributes("/", RECURSIVE, RDONLY, 0)
    for place in ("/run", "/tmp"):
        if Path(place).is_dir() and not any(path.is_relative_to(place) for path in seen):
            call("mount", "none", place, "tmpfs", NOSUID | NODEV, "mode=1777")
    call("mount", "none", "/dev", "tmpfs", NOSUID, "mode=755")
    for name, file in devices.items():
        Path("/dev", name).touch()
        call("mount", f"/proc/self/fd/{file}", f"/dev/{name}", None, BIND, None)
    for name, target in LINKS.items():
        Path("/dev", name).symlink_to(f"/proc/self/{target}")
    SHARED.mkdir()
    SHARED.chmod(0o1777)
    _set_attributes(output, 0, NOSUID | NODEV, RDONLY)
    _loop_back()


def _there(device: str) -> bool:
    return Path("/dev", device).is_char_device()


def _set_attributes(place: Path | str, how: int, add: int, take: int) -> None:
    """Change what a mount allows."""
    attributes = ctypes.create_string_buffer(struct.pack("=QQQQ", add, take, 0, 0))
    call("syscall", SETATTR, HERE, place, how, attributes, 32)


def _loop_back() -> None:
    """Switch on the interface by which ranks may speak to each other."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        request = struct.pack("16sH14x", b"lo", 0)
        _, flags = struct.unpack("16sH14x", fcntl.ioctl(s, GET_FLAGS, request))
        fcntl.ioctl(s, SET_FLAGS, struct.pack("16sH14x", b"lo", flags | UP))


def _give_up() -> None:
    """Have no program that is started from here on any capability."""
    last = int(Path("/proc/sys/kernel/cap_last_cap").read_text())
    for capability in range(last + 1):
        call("prctl", DROP_BOUND, capability, 0, 0, 0)
    call("prctl", NO_NEW_PRIVILEGES, 1, 0, 0, 0)


def _environment(now: Mapping[str, str]) -> dict[str, str]:
    """Caches of this run alone, which begin with what this user's own hold."""
    own = {"XDG_CACHE_HOME": "cache", "MPLCONFIGDIR": "matplotlib", "TMPDIR": ""}
    changed = {name: str(SHARED / place) for name, place in own.items()}
    return {**now, **changed, "MANTLE_SEED": str(cache_home())}
