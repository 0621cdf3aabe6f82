"""Standard output and error of a command, also when they are closed."""

from __future__ import annotations

import atexit
import logging
import os
import signal
import sys
import threading
import time
from typing import TextIO

from mantle.system.progress import LEVEL
from mantle.system.ranks import rank, world_size

# What goes on is printed after so many seconds of silence, later after this share of the run.
SILENCE, SHARE = 1.0, 0.02
# What blocks is printed earlier.
BEFORE_BLOCKING = 0.3
LOOK = 0.25  # s
# Colours of a terminal: what is good, doubtful, bad; what merely goes on is dim.
TONES = {"good": "32", "doubtful": "33", "bad": "1;31", "dim": "2"}
# Set for ranks that print to a terminal: mpirun gives them one of its own in any case.
COLOURS = "MANTLE_COLOURS"


def coloured(stream: TextIO) -> bool:
    """Whether a stream is a terminal with colours, and they are wanted (no-color.org)."""
    if os.environ.get("NO_COLOR") or os.environ.get("TERM", "dumb") == "dumb":
        return False
    return COLOURS in os.environ if world_size() is not None else stream.isatty()


def painted(text: object, tone: str, stream: TextIO) -> str:
    """A text in one of the `TONES`, where a stream has colours."""
    return f"\033[{TONES[tone]}m{text}\033[m" if tone and coloured(stream) else str(text)


def pass_colours() -> None:
    """Let ranks that are started now have the colours of this terminal."""
    if coloured(sys.stdout) and coloured(sys.stderr):
        os.environ[COLOURS] = "1"
    else:
        os.environ.pop(COLOURS, None)


def silence(stream: TextIO) -> None:
    """The reader of a stream (head, less) has left: there is nobody to say anything to."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


class Handler(logging.StreamHandler[TextIO]):
    """Goes on without its reader: what a run is for stands in its folder."""

    def format(self, record: logging.LogRecord) -> str:
        """A record in the colour of its ``tone``: a warning is doubtful, an error bad."""
        tone = "doubtful" if record.levelno >= logging.WARNING else ""
        tone = "bad" if record.levelno >= logging.ERROR else tone
        return painted(super().format(record), getattr(record, "tone", tone), self.stream)

    def handleError(self, record: logging.LogRecord) -> None:
        """Forget a stream that has been closed."""
        if isinstance(sys.exc_info()[1], BrokenPipeError):
            silence(self.stream)
        else:
            super().handleError(record)


class ProgressHandler(Handler):
    """Prints what goes on (`system.progress`) where nothing has been printed for a while.

    A thread of its own repeats it with its seconds. It sleeps while PETSc computes, which does not
    let other threads run; therefore solvers tell of each iteration.
    """

    def __init__(self, stream: TextIO) -> None:
        """Begin to print to a stream."""
        super().__init__(stream)
        self._begun = self._printed = time.monotonic()
        self._current: tuple[str, float] | None = None
        self._told = ""  # what was printed last, if it is what goes on
        self._ended = threading.Event()
        self._watch: threading.Thread | None = None

    def emit(self, record: logging.LogRecord) -> None:
        """Print a record, or keep what goes on until the silence has lasted."""
        if record.levelno != LEVEL:
            self._current = None
            self._print(record)
            return
        text = record.getMessage()
        self._current = (text, time.monotonic()) if text else None
        # In a run that has been slow to here, what blocks next is told at once.
        blocking = 0.0 if self._told not in ("", text) else BEFORE_BLOCKING
        self._tell(blocking if getattr(record, "blocking", False) else 1.0)
        if self._watch is None:
            self._watch = threading.Thread(target=self._repeat, daemon=True)
            self._watch.start()
            atexit.register(self.end)

    def _print(self, record: logging.LogRecord) -> None:
        super().emit(record)
        self._printed, self._told = time.monotonic(), ""

    def _tell(self, share: float = 1.0) -> None:
        """Print what goes on if the silence has lasted, or this share of it."""
        now = time.monotonic()
        patience = share * max(SILENCE, SHARE * (now - self._begun))
        if self._current is None or now - self._printed < patience:
            return
        text, since = self._current
        took = f" ({now - since:.0f} s)" if now - since >= 1 else ""
        told = {"msg": f"     {text}{took}", "levelno": LEVEL, "tone": "dim"}
        self._print(logging.makeLogRecord(told))
        self._told = text

    def _repeat(self) -> None:
        # A reader that has left is an error here, and no crash: PETSc ends the process otherwise.
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGPIPE})
        while not self._ended.wait(LOOK):
            self.acquire()
            try:
                self._tell()
            finally:
                self.release()

    def end(self) -> None:
        """End before the interpreter does: a thread that prints then would hang it."""
        self._ended.set()
        if self._watch is not None:
            self._watch.join()


def configure_log(level: str, stream: TextIO | None = None) -> None:
    """Send progress to standard output and warnings to standard error, from rank 0 only.

    Args:
        level: Least level.
        stream: Where progress goes instead.
    """
    logger = logging.getLogger("mantle")
    logger.propagate = False
    logger.setLevel(logging.CRITICAL if rank() else LEVEL if level == "info" else level.upper())
    progress, trouble = ProgressHandler(stream or sys.stdout), Handler(sys.stderr)
    progress.addFilter(lambda record: record.levelno < logging.WARNING)
    trouble.setLevel(logging.WARNING)
    for before in logger.handlers:
        if isinstance(before, ProgressHandler):
            before.end()
    logger.handlers = [progress, trouble]
