"""A folder for what MPI and compilers keep while a run goes on, which the next run clears away.

Open MPI leaves the folder of its session behind, and where a rank is killed or aborts 16 MB of
shared memory for each. In a folder that is locked as long as the run lives nothing is lost.
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
        The folder, and a file descriptor that keeps it while it is open.

    Raises:
        OSError: There is no place for it.
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
    """Remove a folder that is locked here."""
    shutil.rmtree(folder, ignore_errors=True)
    os.close(held)


def _lock(folder: Path) -> int:
    """Lock a folder.

    Raises:
        OSError: It is gone, or its run goes on.
    """
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
