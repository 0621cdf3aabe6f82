"""Standard output and error of a command, also when they are closed."""

from __future__ import annotations

import logging
import os
import sys
from typing import TextIO

from app.system.ranks import rank, world_size

# Terminal colours of good, doubtful and bad.
TONES = {"good": "32", "doubtful": "33", "bad": "1;31"}
# Set for ranks that print to a terminal: they cannot ask, as mpirun always gives them another one.
COLOURS = "MANTLE_COLOURS"


def coloured(stream: TextIO) -> bool:
    """Return True if a stream is a terminal with colours that are wanted (no-color.org)."""
    if os.environ.get("NO_COLOR") or os.environ.get("TERM", "dumb") == "dumb":
        return False
    return COLOURS in os.environ if world_size() is not None else stream.isatty()


def painted(text: object, tone: str, stream: TextIO) -> str:
    """Text in one of the `TONES`, where a stream has colours."""
    return f"\033[{TONES[tone]}m{text}\033[m" if tone and coloured(stream) else str(text)


def pass_colours() -> None:
    """Let child ranks use the colours of this terminal."""
    if coloured(sys.stdout) and coloured(sys.stderr):
        os.environ[COLOURS] = "1"
    else:
        os.environ.pop(COLOURS, None)


def silence(stream: TextIO) -> None:
    """Discard further output to a stream whose reader (head, less) has left."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


class Handler(logging.StreamHandler[TextIO]):
    """Log handler that colours warnings and errors, and survives a closed stream."""

    def format(self, record: logging.LogRecord) -> str:
        """Format a record in the colour of its ``tone``: a warning is doubtful, an error bad."""
        tone = "doubtful" if record.levelno >= logging.WARNING else ""
        tone = "bad" if record.levelno >= logging.ERROR else tone
        return painted(super().format(record), getattr(record, "tone", tone), self.stream)

    def handleError(self, record: logging.LogRecord) -> None:
        """Ignore a closed stream."""
        if isinstance(sys.exc_info()[1], BrokenPipeError):
            silence(self.stream)
        else:
            super().handleError(record)


def configure_log(level: str, stream: TextIO | None = None) -> None:
    """Send progress to standard output or ``stream``, warnings to standard error, from rank 0."""
    logger = logging.getLogger("mantle")
    logger.propagate = False
    logger.setLevel(logging.CRITICAL if rank() else level.upper())
    progress, trouble = Handler(stream or sys.stdout), Handler(sys.stderr)
    progress.addFilter(lambda record: record.levelno < logging.WARNING)
    trouble.setLevel(logging.WARNING)
    logger.handlers = [progress, trouble]
