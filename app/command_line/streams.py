"""Standard output and error of a command, also when they are closed."""

from __future__ import annotations

import atexit
import logging
import os
import signal
import socket
import subprocess
import sys
from contextlib import suppress
from typing import TextIO

from app.command_line import ticker
from app.system import privacy
from app.system.progress import LEVEL
from app.system.ranks import rank, world_size

# What goes on is printed after so many seconds of silence.
SILENCE = 1.0
SIGNALS = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1, signal.SIGUSR2}
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
        text = privacy.told(super().format(record))
        return painted(text, getattr(record, "tone", tone), self.stream)

    def handleError(self, record: logging.LogRecord) -> None:
        """Forget a stream that has been closed."""
        if isinstance(sys.exc_info()[1], BrokenPipeError):
            silence(self.stream)
        else:
            super().handleError(record)


class ProgressHandler(Handler):
    """Has what goes on (`system.progress`) printed by a `ticker` where nothing is for a while.

    A thread would sleep while PETSc computes, which does not let other threads run.
    """

    def __init__(self, stream: TextIO) -> None:
        """Begin to print to a stream."""
        super().__init__(stream)
        self._started = False
        self._ticker: subprocess.Popen[bytes] | None = None
        self._link: socket.socket | None = None

    def emit(self, record: logging.LogRecord) -> None:
        """Print a record, or pass on what goes on."""
        if record.levelno != LEVEL:
            super().emit(record)
            self._send(ticker.PRINTED)
            return
        if not self._started:
            self._start()
        self._send(ticker.message(record.getMessage(), getattr(record, "blocking", False)))

    def _start(self) -> None:
        """Start the ticker, if the stream is one that another process can have."""
        self._started = True
        template = painted("%s", "dim", self.stream)
        with suppress(OSError, ValueError):
            self.stream.flush()
            self._link, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            # Signals are for the run: the ticker ends when the run does.
            before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
            script = [sys.executable, "-IS", ticker.__file__]
            try:
                self._ticker = subprocess.Popen(
                    [*script, str(other.fileno()), str(SILENCE), template],
                    stdin=subprocess.DEVNULL,
                    stdout=self.stream.fileno(),
                    stderr=subprocess.DEVNULL,
                    pass_fds=[other.fileno()],
                )
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)
                other.close()
            atexit.register(self.end)

    def _send(self, message: bytes) -> None:
        """Send a message; one to a ticker that is gone, or stands still, is lost."""
        if self._link is not None:
            with suppress(OSError):
                self._link.send(message, socket.MSG_NOSIGNAL | socket.MSG_DONTWAIT)

    def end(self) -> None:
        """End the ticker."""
        if self._link is not None:
            self._link.close()
        if self._ticker is not None:
            self._ticker.wait()
        self._ticker = self._link = None


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
