"""Catch what libraries write to standard output and error, and send it to the log instead."""

from __future__ import annotations

import ctypes
import logging
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

log = logging.getLogger("mantle")
# File descriptors of standard output and error.
STREAMS = (1, 2)


@contextmanager
def captured(library: str) -> Iterator[Callable[[], list[str]]]:
    """Catch the output of a library in the block, and log it under its name afterwards (debug).

    The block itself logs nothing: it would be caught, too.

    Yields:
        A function that returns the lines caught so far.
    """
    caught = os.memfd_create(library)
    originals: dict[int, int] = {}

    def lines() -> list[str]:
        _flush()
        content = os.pread(caught, os.fstat(caught).st_size, 0)
        return [line for line in content.decode(errors="replace").splitlines() if line.strip()]

    _flush()
    for stream in STREAMS:
        with suppress(OSError):  # a closed stream has nothing to be caught
            originals[stream] = os.dup(stream)
            os.dup2(caught, stream)
    try:
        yield lines
    finally:
        captured_lines = lines()
        for stream, original in originals.items():
            os.dup2(original, stream)
            os.close(original)
        os.close(caught)
        for line in captured_lines:
            log.debug("%s: %s", library, line)


def _flush() -> None:
    """Write what Python and C have buffered."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, OSError, ValueError):  # it is closed
            stream.flush()
    ctypes.CDLL(None).fflush(None)
