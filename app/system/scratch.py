"""Folder for temporary files of MPI and compilers, removed by the next run.

Open MPI leaves the folder of its session behind, and where a rank is killed or aborts 16 MB of
shared memory for each. A folder is locked as long as its run lives, so that none is lost.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

PREFIX = "mantle-run-"
SHARED = Path("/dev/shm")
# Variables of the jobs of schedulers, whose ranks may be on other nodes: they have folders.
SCHEDULERS = {"SLURM_JOB_ID", "PBS_JOBID", "LSB_JOBID"}


@contextmanager
def variables() -> Iterator[dict[str, str]]:
    """Environment variables that make MPI and compilers use a folder, which is there for the block.

    Folders of runs that are over are removed. There are no variables under a scheduler, nor where
    no folder can be made.
    """
    if SCHEDULERS & os.environ.keys():
        yield {}
        return
    place = SHARED if os.access(SHARED, os.W_OK | os.X_OK) else Path(tempfile.gettempdir())
    for old_folder in place.glob(f"{PREFIX}*"):
        with suppress(OSError):
            if old_folder.stat().st_uid == os.geteuid():
                with _locked(old_folder):
                    shutil.rmtree(old_folder, ignore_errors=True)
    with ExitStack() as stack:
        variables = {}
        with suppress(OSError):
            folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=place))
            stack.callback(shutil.rmtree, folder, ignore_errors=True)
            # Another run may take it for an old one, until it is locked: then there is none.
            stack.enter_context(_locked(folder))
            variables = {"TMPDIR": str(folder)} if folder.exists() else {}
            if variables and place == SHARED:
                variables["OMPI_MCA_btl_sm_backing_directory"] = str(folder)
        yield variables


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(descriptor)
