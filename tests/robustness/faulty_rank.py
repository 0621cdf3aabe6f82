"""``mantle run`` with an error in a phase on one rank, started by `test_fault_ranks`."""

from __future__ import annotations

import os
import sys
from typing import Any

from mpi4py import MPI

import meshes
from app import cli
from app.foundation.errors import ConvergenceError, StoppedError
from app.mechanics import problem, systems
from app.results.run_folder import Writer
from app.simulation import checkpoint
from meshes import distribute

# What is called in a phase, and the call that fails.
PHASES: dict[str, tuple[Any, str, int]] = {
    "mesh": (meshes, "build", 1),
    "distribution": (distribute, "connect", 1),
    "assembly": (problem.Problem, "__init__", 1),
    "solve": (systems.ContactSystem, "residual", 2),
    "output": (Writer, "add_row", 1),
    "checkpoint": (checkpoint, "write", 1),
}
ERRORS: dict[str, BaseException] = {
    "internal": RuntimeError("thrown here"),
    "memory": MemoryError("thrown here"),
    "stop": StoppedError("thrown here"),
    "divergence": ConvergenceError("thrown here"),
    "interrupt": KeyboardInterrupt("thrown here"),
}


def arm(phase: str, error: str, rank: int) -> None:
    """Make a call fail on a rank."""
    owner, name, at = PHASES[phase]
    usual, calls = getattr(owner, name), [0]

    def failing(*arguments: Any, **options: Any) -> Any:
        calls[0] += 1
        if MPI.COMM_WORLD.rank == rank and calls[0] == at:
            raise ERRORS[error]
        return usual(*arguments, **options)

    setattr(owner, name, failing)


if __name__ == "__main__":
    arm(os.environ["PHASE"], os.environ["ERROR"], int(os.environ["RANK"]))
    sys.exit(cli.main())
