"""Files that are whole or not there, and caches that nobody else can have written."""

from __future__ import annotations

import logging
import os
import pwd
import re
import secrets
import stat
from contextlib import suppress
from pathlib import Path

log = logging.getLogger("mantle")

# A file under this name is not finished.
PARTIAL = ".partial"
LEFT = re.compile(r"\.[0-9a-f]{16}\.partial$")
OTHERS = stat.S_IWGRP | stat.S_IWOTH
ROOT, EVERYBODY = 0, 2**32  # user id, number of user ids


def write_bytes(path: Path, content: bytes, mode: int = 0o666) -> None:
    """Write a file under another name, flush it to disk and rename it; all of it or nothing.

    Args:
        path: The file.
        content: What it holds.
        mode: Who may do what with it, beside what the umask forbids.
    """
    temporary = path.with_name(f"{path.name}.{secrets.token_hex(8)}{PARTIAL}")
    new = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    try:
        with open(os.open(temporary, new, mode), "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise
    with suppress(OSError):  # some file systems cannot
        folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def clear(folder: Path, name: str = "*") -> None:
    """Remove what killed processes have left of files, where no other process writes them."""
    for path in folder.glob(f"{name}.*{PARTIAL}"):
        if LEFT.search(path.name):
            path.unlink(missing_ok=True)


def lock_file(path: Path) -> int:
    """Open a file to be locked, which is made if need be; links are not followed.

    Raises:
        OSError: It is a link or cannot be written.
    """
    return os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)


def read_own(path: Path) -> bytes:
    """Read a file of a cache, if nobody but its user and root can have written it.

    Raises:
        OSError: It is missing, a link, or another could have written it, which is logged.
    """
    file = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    with open(file, "rb") as opened:
        status = os.fstat(file)
        why = fault_of(status) or ("" if stat.S_ISREG(status.st_mode) else "is no file")
        if why:
            log.warning("%s is not used: it %s", path, why)
            raise PermissionError(f"{path} {why}")
        return opened.read()


def fault_of(status: os.stat_result) -> str:
    """Why others than this user and root could have written a file; empty if they could not."""
    if status.st_uid not in (ROOT, os.geteuid()):
        return f"is owned by {_name(status.st_uid)}"
    return "can be written by others" if status.st_mode & OTHERS else ""


def fault_of_folder(folder: Path) -> str:
    """Why others could change what a folder holds, or exchange it; empty if they could not.

    A folder that is missing has no fault. In folders above, where others may write, each has to
    own what is in it (as in ``/tmp``).
    """
    folder = Path(os.path.realpath(folder))
    for place in (folder, *folder.parents):
        try:
            status = os.lstat(place)
        except FileNotFoundError:
            continue
        except OSError as error:
            return f"{place} cannot be looked at: {error.strerror}"
        above = place != folder
        owner = status.st_uid
        # In a namespace that knows one user, root owns what the namespace does not tell.
        if owner not in (ROOT, os.geteuid()) and not (above and owner == _overflow()):
            return f"{place} is owned by {_name(owner)}"
        if status.st_mode & OTHERS and not (above and status.st_mode & stat.S_ISVTX):
            return f"{place} can be written by others"
    return ""


def make_own(folder: Path) -> str:
    """Make a folder that is of this user alone, unless it is there; why it is of no use, or ""."""
    umask = os.umask(0o022)  # what a group can write is not used
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileExistsError):
            folder.mkdir(mode=0o700)
        if not os.access(folder, os.W_OK | os.X_OK):
            return f"{folder} cannot be written"
    except OSError as error:
        return f"{folder} cannot be made: {error.strerror}"
    finally:
        os.umask(umask)
    if why := fault_of_folder(folder):
        return why
    with suppress(OSError):  # root's
        folder.chmod(0o700)
    return ""


def _overflow() -> int:
    """User id that stands for users unknown to this namespace; -1 where it knows all."""
    try:
        *_, known = Path("/proc/self/uid_map").read_text().split()
        every = int(known) >= EVERYBODY - 1
        return -1 if every else int(Path("/proc/sys/kernel/overflowuid").read_text())
    except (OSError, ValueError):
        return -1


def _name(user: int) -> str:
    """Name of a user, or the number."""
    try:
        return pwd.getpwuid(user).pw_name
    except KeyError:
        return f"user {user}"
