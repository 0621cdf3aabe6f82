"""Folder for temporary files of MPI and compilers, removed by the next run.

Open MPI leaves the folder of its session behind, and where a rank is killed or aborts 16 MB of
shared memory for each. A folder is locked as long as its run lives, so that none is lost.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path

PREFIX = "mantle-run-"
SHARED = Path("/dev/shm")


def make() -> tuple[Path, int]:
    """Make the folder of this run, and remove those of runs that are over.

    Returns:
        The folder, and a file descriptor that keeps it locked while open.

    Raises:
        OSError: No folder can be made.
    """
    place = SHARED if os.access(SHARED, os.W_OK | os.X_OK) else Path(tempfile.gettempdir())
    for old in place.glob(f"{PREFIX}*"):
        with suppress(OSError):
            if old.stat().st_uid == os.geteuid():
                held = _lock(old)
                remove(old, held)
    while True:
        folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=place))
        with suppress(OSError):
            held = _lock(folder)
            if folder.exists():  # nobody has taken it for an old one meanwhile
                return folder, held
            os.close(held)


def remove(folder: Path, held: int) -> None:
    """Remove a folder locked by this process."""
    shutil.rmtree(folder, ignore_errors=True)
    os.close(held)


def _lock(folder: Path) -> int:
    held = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(held)
        raise
    return held


def variables(folder: Path) -> dict[str, str]:
    """Environment variables that make MPI and compilers use a folder."""
    found = {"TMPDIR": str(folder)}
    if folder.parent == SHARED:
        found["OMPI_MCA_btl_sm_backing_directory"] = str(folder)
    return found
