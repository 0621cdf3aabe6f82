"""Reasons to stop a run early: signals and the time limit."""

from __future__ import annotations

import os
import re
import signal
import time as clock
from collections.abc import Callable
from types import FrameType

from app.foundation.errors import InputError
from app.system import ranks

# Fraction of the wall time that is reserved for saving.
RESERVED = 0.05
# The longest time that is reserved [s].
MOST_RESERVED = 60.0
FORMS = "H:MM:SS, MM:SS, D-H:MM:SS, or a number with s, min, h or d"
UNITS = {"s": 1, "min": 60, "h": 3600, "d": 86400}


def seconds(text: str) -> float:
    """Seconds of a duration: as in batch systems, ``[D-]H:MM:SS`` or ``MM:SS``, or ``90 min``."""
    total = 0.0
    if with_unit := re.fullmatch(r"(\d+\.?\d*)\s*(s|min|h|d)", text.strip()):
        total = float(with_unit[1]) * UNITS[with_unit[2]]
    elif clock_time := re.fullmatch(r"(?:(?:(\d+)-)?(\d+):)?(\d+):(\d\d)", text.strip()):
        days, hours, minutes, rest = (int(part or 0) for part in clock_time.groups())
        total = float(((24 * days + hours) * 60 + minutes) * 60 + rest)
    if not total:
        raise InputError(f"--walltime {text}: not a duration; allowed: {FORMS}, e.g. 2:00:00")
    return total


def signals() -> Callable[[], str]:
    """Record signals that ask the run to stop; the function returns the first one's name, or "".

    The run calls it between Newton iterations. A second Ctrl-C, a second later or more, ends a
    single rank at once.
    """
    received: list[str] = []
    alone, first = ranks.world_size() is None, 0.0

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal first
        now = clock.monotonic()
        received.append(signal.Signals(number).name)
        if len(received) == 1:
            first = now
            if alone:
                ranks.notify("stopping when the state is saved (a second signal stops at once)")
        elif alone and number == signal.SIGINT and now > first + ranks.SAME_SIGNAL:
            ranks.notify(ranks.NOT_SAVED)
            os._exit(130)

    heard = ranks.stop_signals()
    for number in heard:
        signal.signal(number, note)
    if signal.SIGHUP not in heard:
        signal.signal(signal.SIGHUP, signal.SIG_IGN)  # again: PETSc ends a run that gets it
    # A reader that has left is an error where something is said, and no crash, as PETSc has it.
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)
    return lambda: received[0] if received else ""


class WallTime:
    """Reason to stop a run while there is time to save its state.

    It is asked between Newton iterations, and assumes that the time to the next call is the longest
    so far. The run began at ``begin`` of `time.perf_counter` and may take ``limit`` seconds.
    """

    def __init__(self, begin: float, limit: float) -> None:
        self._limit = limit
        self._end = begin + limit - min(RESERVED * limit, MOST_RESERVED)
        self._last: float | None = None
        self._longest = 0.0

    def __call__(self) -> str:
        """Reason to stop now, or ""."""
        now = clock.perf_counter()
        if self._last is not None:
            self._longest = max(self._longest, now - self._last)
        self._last = now
        late = now + self._longest >= self._end
        return f"its wall time of {self._limit:.0f} s" if late else ""
