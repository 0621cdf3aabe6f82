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
TIME_UNITS = {"s": 1, "min": 60, "h": 3600, "d": 86400}


def seconds_of_duration(text: str) -> float:
    """Seconds of a duration: as in batch systems, ``[D-]H:MM:SS`` or ``MM:SS``, or ``90 min``."""
    total = 0.0
    if with_unit := re.fullmatch(r"(\d+\.?\d*)\s*(s|min|h|d)", text.strip()):
        total = float(with_unit[1]) * TIME_UNITS[with_unit[2]]
    elif clock_time := re.fullmatch(r"(?:(?:(\d+)-)?(\d+):)?(\d+):(\d\d)", text.strip()):
        days, hours, minutes, remaining_seconds = (int(part or 0) for part in clock_time.groups())
        total = float(((24 * days + hours) * 60 + minutes) * 60 + remaining_seconds)
    if not total:
        raise InputError(f"--walltime {text}: not a duration; allowed: {FORMS}, e.g. 2:00:00")
    return total


def signals() -> Callable[[], str]:
    """Record signals to stop. Return a function that gives the name of the first signal, or "".

    The run calls this function between Newton iterations. On a single rank, a second Ctrl-C ends
    the run at once if it comes at least one second after the first.
    """
    received: list[str] = []
    is_single = ranks.world_size() is None
    first_signal = 0.0

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal first_signal
        signal_time = clock.monotonic()
        received.append(signal.Signals(number).name)
        if len(received) == 1:
            first_signal = signal_time
            if is_single:
                ranks.notify("stopping when the state is saved (a second signal stops at once)")
        elif (
            is_single and number == signal.SIGINT and signal_time > first_signal + ranks.SAME_SIGNAL
        ):
            ranks.notify(ranks.NOT_SAVED)
            os._exit(130)

    stop_signals = ranks.stop_signals()
    for number in stop_signals:
        signal.signal(number, note)
    if signal.SIGHUP not in stop_signals:
        # PETSc has set a handler that ends the run.
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
    # Writing to a closed pipe then raises an error. PETSc would end the run.
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)
    return lambda: received[0] if received else ""


class WallTime:
    """Time limit of a run, with enough time left to save its state.

    It is called between Newton iterations. It assumes that the time to the next call is the longest
    time between two calls so far.

    Args:
        begin: Start of the run, as `time.perf_counter` gives it [s].
        limit: Time that the run may take [s].
    """

    def __init__(self, begin: float, limit: float) -> None:
        self._limit = limit
        self._end = begin + limit - min(RESERVED * limit, MOST_RESERVED)
        self._last: float | None = None
        self._longest = 0.0

    def __call__(self) -> str:
        """Reason to stop now, or ""."""
        current_time = clock.perf_counter()
        if self._last is not None:
            self._longest = max(self._longest, current_time - self._last)
        self._last = current_time
        late = current_time + self._longest >= self._end
        return f"its wall time of {self._limit:.0f} s" if late else ""
