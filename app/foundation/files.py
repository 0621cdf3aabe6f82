"""Files written whole or not at all, and private folders."""

from __future__ import annotations

import errno
import os
import re
import secrets
from contextlib import suppress
from pathlib import Path

from app.foundation.errors import InputError

# A file under this name is not finished.
PARTIAL = ".partial"
# Reasons for which a system refuses a path that a user gave.
REFUSED = (errno.ENAMETOOLONG, errno.EACCES, errno.ELOOP, errno.ENOTDIR)
# Longest name that a message shows whole [characters].
LONGEST_NAME = 80
LEFT = re.compile(r"\.[0-9a-f]{16}\.partial$")


def write_bytes(path: Path, content: bytes, mode: int = 0o666) -> None:
    """Write a file under another name, flush it to disk and rename it; all of it or nothing."""
    temporary = path.with_name(f"{path.name}.{secrets.token_hex(8)}{PARTIAL}")
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    try:
        with open(os.open(temporary, flags, mode), "wb") as file:
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


def files_at(path: Path) -> list[Path]:
    """A file, or those in a folder, by name."""
    return sorted(filter(Path.is_file, path.iterdir())) if path.is_dir() else [path]


def error_of_refused_path(error: BaseException) -> InputError | None:
    """Error that explains why the system refuses a path; None for any other error."""
    if not isinstance(error, OSError) or error.errno not in REFUSED or error.filename is None:
        return None
    name = os.fsdecode(error.filename)
    short_name = name if len(name) <= LONGEST_NAME else f"{name[:LONGEST_NAME]}..."
    reason = (error.strerror or "").lower()
    return InputError(f"{short_name}: cannot be opened: {reason}; give another path")


def clear(folder: Path, name: str = "*") -> None:
    """Remove temporary files left by killed processes, unless another process writes them."""
    for path in folder.glob(f"{name}.*{PARTIAL}"):
        if LEFT.search(path.name):
            path.unlink(missing_ok=True)


def lock_file(path: Path) -> int:
    """Open a lock file, made if need be; links are not followed.

    Raises:
        OSError: It is a link or cannot be written.
    """
    return os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)


def make_private(folder: Path) -> None:
    """Make a folder that nobody but its user can read or write (mode 0700), unless it is there.

    Raises:
        OSError: It cannot be made or written, or it belongs to somebody else.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    folder.mkdir(mode=0o700, exist_ok=True)
    if folder.stat().st_uid == os.geteuid():
        folder.chmod(0o700)
    elif os.geteuid():
        raise PermissionError(errno.EPERM, "belongs to somebody else", folder)
    if not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(errno.EACCES, "is not writable", folder)
