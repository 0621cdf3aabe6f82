"""What goes on now, for whoever waits: records of a level between debug and info.

`command_line.streams` prints one where nothing has been printed for a while and drops it if
another one follows before. So a long phase is never silent, and a short one adds no line.
"""

import logging
from collections.abc import Iterator
from contextlib import contextmanager

LEVEL = 15

log = logging.getLogger("mantle")


def doing(text: str, blocking: bool = False) -> None:
    """Tell what begins or goes on now.

    Args:
        text: What, in words; nothing where something has ended.
        blocking: Whether PETSc or MPI does it for long, and nothing can be told meanwhile.
    """
    log.log(LEVEL, "%s", text, extra={"blocking": blocking})


@contextmanager
def during(text: str) -> Iterator[None]:
    """Tell what goes on while the block lasts."""
    doing(text)
    try:
        yield
    finally:
        doing("")
