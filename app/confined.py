"""What Linux has to confine a process: namespaces, rules for files, limits, no privileges."""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import struct
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

# Of linux/sched.h: mounts, IPC, processes, network; users.
SPACES, USERS = 0x00020000 | 0x08000000 | 0x20000000 | 0x40000000, 0x10000000
# Of linux/prctl.h.
DEATH_SIGNAL, DROP_BOUND, NO_NEW_PRIVILEGES = 1, 24, 38
# Of linux/landlock.h: system calls (the same on all of Linux's own processors) and their words.
CREATE_RULES, ADD_RULE, RESTRICT = 444, 445, 446
VERSION, BENEATH, READ = 1, 1, 1 << 2 | 1 << 3
CAPABILITIES = struct.pack("=Ii", 0x20080522, 0)  # of linux/capability.h
NOBODY = 65534
WRITTEN = 1 << 20  # bytes in a file: what a library prints is kept in memory
LIBC = ctypes.CDLL(None, use_errno=True)


def call(name: str, *arguments: object) -> int:
    """Call a function of the C library.

    Raises:
        OSError: It fails.
    """
    words = [os.fsencode(a) if isinstance(a, str | Path) else a for a in arguments]
    padded = [ctypes.c_ulong(a) if isinstance(a, int) and a >= 0 else a for a in words]
    result = int(getattr(LIBC, name)(*padded))
    if result < 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number), f"{name} {' '.join(map(str, arguments[:2]))}:")
    return result


def separate() -> None:
    """Leave the namespaces of the machine; where this user may not, in one of users.

    Raises:
        OSError: This machine does not let this user do so.
    """
    user, group = os.geteuid(), os.getegid()
    try:
        call("unshare", SPACES)
    except PermissionError:
        call("unshare", SPACES | USERS)
        Path("/proc/self/setgroups").write_text("deny")
        Path("/proc/self/uid_map").write_text(f"{user} {user} 1")
        Path("/proc/self/gid_map").write_text(f"{group} {group} 1")


def die_with_parent() -> None:
    """Have this process killed when the one that started it ends."""
    call("prctl", DEATH_SIGNAL, signal.SIGKILL)


def code_of(process: int) -> int:
    """Wait for a process; its exit code as a shell tells it."""
    code = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    return code if code >= 0 else 128 - code


def enter(folder: Path, memory: int, seconds: int) -> bool:
    """Leave this process nothing but to compute, and to read one folder.

    Namespaces, rules of Landlock and another root are used as far as the machine has them: no
    other file, no network, no other process. No program can be started, and what is open stays so.
    The process goes on as a child of itself, and has the child's exit code.

    Args:
        folder: What it can read.
        memory: Address space at most [bytes].
        seconds: Time of the processor at most.

    Returns:
        Whether files are out of reach; if not, the machine allows limits alone.
    """
    os.chdir(folder)
    die_with_parent()
    separated = _works(separate)
    if separated and (first := os.fork()):  # a namespace of processes begins with a child
        os._exit(code_of(first))
    call("prctl", NO_NEW_PRIVILEGES, 1, 0, 0, 0)
    ruled = _works(_only_this_folder)
    rooted = _works(lambda: os.chroot("."))
    most = {"AS": memory, "CPU": seconds, "FSIZE": WRITTEN, "NPROC": 0, "CORE": 0}
    for name, limit in most.items():
        resource.setrlimit(getattr(resource, f"RLIMIT_{name}"), (limit, limit))
    _become_nobody()
    die_with_parent()  # forgotten where the user changes
    return ruled or rooted


def _works(step: Callable[[], object]) -> bool:
    """Whether the machine allows it."""
    try:
        step()
    except OSError:
        return False
    return True


def _only_this_folder() -> None:
    """Deny all files but those below the working folder, which can be read.

    Raises:
        OSError: The kernel has no Landlock.
    """
    version = call("syscall", CREATE_RULES, None, 0, VERSION)
    actions = (1 << 13 + (version >= 2) + (version >= 3) + (version >= 5)) - 1
    attributes = struct.pack("=QQQ", actions, 3 * (version >= 4), 3 * (version >= 6))
    rules = call("syscall", CREATE_RULES, attributes, len(attributes), 0)
    here = os.open(".", os.O_PATH | os.O_DIRECTORY)
    call("syscall", ADD_RULE, rules, BENEATH, struct.pack("=Qi", READ, here), 0)
    call("syscall", RESTRICT, rules, 0)
    os.close(here)
    os.close(rules)


def _become_nobody() -> None:
    """Give up all privileges; root becomes a user whom nothing belongs to, where it can."""
    if os.geteuid() == 0:
        with suppress(OSError):
            os.setgroups([])
            os.setresgid(NOBODY, NOBODY, NOBODY)
            os.setresuid(NOBODY, NOBODY, NOBODY)
    call("capset", CAPABILITIES, bytes(24))
