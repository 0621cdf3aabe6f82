"""Catch what libraries write to standard output and error, and send it to the log instead."""

from __future__ import annotations

import ctypes
import logging
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress

log = logging.getLogger("mantle")


@contextmanager
def captured(library: str) -> Iterator[Callable[[], list[str]]]:
    """Catch what a library writes, and log it at the end (debug).

    What mantle logs meanwhile, also from other threads, goes where it always goes.

    Args:
        library: Its name, for the log.

    Yields:
        Gives the lines caught so far.
    """
    with ExitStack() as stack:
        caught = os.memfd_create(library)
        stack.callback(os.close, caught)

        def lines() -> list[str]:
            _flush()
            text = os.pread(caught, os.fstat(caught).st_size, 0)
            return [line for line in text.decode(errors="replace").splitlines() if line.strip()]

        with suppress(OSError):  # a closed stream has nothing to be caught
            _flush()
            for number in (1, 2):
                _redirect(number, caught, stack)
        try:
            yield lines
        finally:
            heard = lines()
            stack.pop_all().close()
            for line in heard:
                log.debug("%s: %s", library, line)


def _redirect(number: int, to: int, stack: ExitStack) -> None:
    """Send a stream of the process elsewhere, and leave the handlers of the log where it was."""
    kept = os.dup(number)
    stack.callback(os.close, kept)
    for handler in log.handlers:
        if isinstance(handler, logging.StreamHandler) and _number(handler.stream) == number:
            own = open(kept, "w", encoding="utf-8", errors="backslashreplace", closefd=False)
            stack.callback(own.close)
            stack.callback(handler.setStream, handler.stream)
            handler.setStream(own)
    os.dup2(to, number)
    stack.callback(os.dup2, kept, number)
    stack.callback(_flush)


def _number(stream: object) -> int | None:
    """The descriptor of a stream, if it has one."""
    try:
        return int(stream.fileno())  # type: ignore[attr-defined]
    except (AttributeError, OSError, ValueError):
        return None


def _flush() -> None:
    """Have C and Python write what they hold back."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, OSError, ValueError):
            stream.flush()
    ctypes.CDLL(None).fflush(None)
