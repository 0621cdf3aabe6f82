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
    """Catch the output of a library, and log it under its name at the end (debug).

    Log records of mantle, also from other threads, are not caught.

    Yields:
        A function that returns the lines caught so far.
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
    """Redirect a stream of the process; handlers of the log keep the original."""
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
    try:
        return int(stream.fileno())  # type: ignore[attr-defined]
    except (AttributeError, OSError, ValueError):
        return None


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, OSError, ValueError):
            stream.flush()
    ctypes.CDLL(None).fflush(None)
