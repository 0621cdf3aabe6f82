"""Standard output and error of a command, also when they are closed."""

from __future__ import annotations

import logging
import os
import sys
from typing import TextIO

from mantle.system.ranks import rank


def silence(stream: TextIO) -> None:
    """The reader of a stream (head, less) has left: there is nobody to say anything to."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def configure_log(level: str) -> None:
    """Send progress to standard output and warnings to standard error, from rank 0 only."""
    logger = logging.getLogger("mantle")
    logger.propagate = False
    logger.setLevel(level.upper() if rank() == 0 else logging.CRITICAL)

    class Handler(logging.StreamHandler[TextIO]):
        """Goes on without its reader: what a run is for stands in its folder."""

        def handleError(self, record: logging.LogRecord) -> None:
            if isinstance(sys.exc_info()[1], BrokenPipeError):
                silence(self.stream)
            else:
                super().handleError(record)

    progress, trouble = Handler(sys.stdout), Handler(sys.stderr)
    progress.addFilter(lambda record: record.levelno < logging.WARNING)
    trouble.setLevel(logging.WARNING)
    logger.handlers = [progress, trouble]
