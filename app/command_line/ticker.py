"""Prints what goes on where nothing has been printed for a while: a process of its own.

PETSc, DOLFINx and compilers let no other thread of their process run. So `streams` starts this file
and sends it a message for each record: the time at which it came, whether what goes on blocks,
and what goes on; nothing where a line was printed instead. It ends when nobody can send any more.
"""

import os
import socket
import sys
import time

# What goes on is printed after this share of the run, if that is more than the least silence.
SHARE = 0.01
# What blocks is printed after this part of the silence; in a run that is slow to here, at once.
BLOCKING = 0.3
LONGEST = 4096  # bytes of a message


def message(text: str, blocking: bool = False) -> bytes:
    """What is sent of a record.

    Args:
        text: What goes on, on one line; nothing where it has ended.
        blocking: Whether nothing can be told of it meanwhile.
    """
    return f"{time.monotonic()} {blocking:d} {text}".encode(errors="replace")[:LONGEST]


PRINTED = b"printed"


class Ticker:
    """What has been printed, and what goes on."""

    def __init__(self, silence: float, template: str) -> None:
        """Nothing has been printed, nothing goes on.

        Args:
            silence: Least silence before what goes on is printed [s].
            template: A line with ``%s`` for what goes on.
        """
        self._silence, self._template = silence, template
        self._begun = self._printed = time.monotonic()
        self._told = ""  # what was printed last, if it is what goes on
        self._text = ""
        self._since = 0.0
        self._patience = 1.0

    def take(self, received: bytes) -> None:
        """Take a message."""
        if received == PRINTED:
            self._printed, self._told, self._text = time.monotonic(), "", ""
            return
        since, blocking, self._text = received.decode(errors="replace").split(" ", 2)
        self._since = float(since)
        at_once = self._told not in ("", self._text)
        self._patience = 1.0 if blocking == "0" else 0.0 if at_once else BLOCKING
        # Also where more has come since: what is next may be over as soon.
        if self.wait(self._since) == 0.0:
            self.tell()

    def wait(self, now: float) -> float | None:
        """Seconds from a time until something is to be printed; None if nothing goes on."""
        if not self._text:
            return None
        silence = max(self._silence, SHARE * (now - self._begun))
        return max(0.0, self._printed + self._patience * silence - now)

    def tell(self) -> None:
        """Print what goes on, with its seconds."""
        now = time.monotonic()
        took = f" ({now - self._since:.0f} s)" if now - self._since >= 1 else ""
        os.write(1, (self._template % f"     {self._text}{took}" + "\n").encode())
        self._printed, self._told, self._patience = now, self._text, 1.0


def main(number: int, silence: float, template: str) -> None:
    """Print until the other end is closed."""
    ticker = Ticker(silence, template)
    with socket.socket(fileno=number) as link:
        while True:
            link.settimeout(ticker.wait(time.monotonic()))
            try:
                received = link.recv(LONGEST)
            except (TimeoutError, BlockingIOError):
                ticker.tell()
                continue
            if not received:
                return
            ticker.take(received)


if __name__ == "__main__":
    try:
        main(int(sys.argv[1]), float(sys.argv[2]), sys.argv[3])
    except OSError:
        pass  # the reader has left
