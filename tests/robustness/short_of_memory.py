"""``mantle run`` that may take so much memory [MB] more than it has once everything is loaded."""

from __future__ import annotations

import os
import re
import resource
import sys
from pathlib import Path

from app import cli
from app.simulation import model, session
from app.soundness import memory


def limit(more: float) -> None:
    """Allow some more addresses than there are now."""
    (size,) = re.findall(r"VmSize:\s+(\d+) kB", Path("/proc/self/status").read_text())
    most = int(1024 * int(size) + 1e6 * more)
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


if __name__ == "__main__":
    assert model and session  # loaded
    memory.available = lambda environ=os.environ: 1e12
    usual = session.Session.solve

    def solve(*arguments: object) -> object:
        limit(float(os.environ["MORE"]))
        return usual(*arguments)  # type: ignore[arg-type]

    session.Session.solve = solve  # type: ignore[method-assign, assignment]
    sys.exit(cli.main())
