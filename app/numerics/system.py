"""Systems of equations as the solver sees them: blocks of unknowns, residual, Jacobian.

A system knows its own linear algebra: which blocks there are, how they are preconditioned, and how
large a residual may be. Block order is that of the Gauss-Seidel preconditioner.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from mpi4py import MPI
from petsc4py import PETSc

from app.arrays import Floats
from app.numerics.active_set import ActiveSet
from app.numerics.deflation import CoarseSpace
from app.numerics.preconditioners import Inverse, Options


@dataclass(frozen=True)
class Measure:
    """How large a part of a residual is.

    Attributes:
        norm: Its norm.
        scale: The size of what it balances.
        rounding: What rounding leaves of it.
        lasting: Whether the scale of a converged state holds for those after it: that of forces
            does, that of the heat in the first instant of a contact does not.
    """

    norm: float
    scale: float
    rounding: float
    lasting: bool = True

    def limit(self, tolerance: float) -> float:
        """Norm below which the part has converged, for a tolerance relative to the scale."""
        return max(tolerance * self.scale, self.rounding)


class System(Protocol):
    """Interface between the nonlinear solver and a system of equations.

    The answers given here are those of a system without contact; systems inherit them.
    """

    comm: MPI.Comm
    prefix: str
    # States of its contact points at the last iterates.
    active: ActiveSet
    # PETSc options of its Newton iteration that differ from the solver's.
    newton: Options = {}  # noqa: RUF012
    # Inverses of diagonal blocks that others use too, by block.
    inverses: Mapping[str, Inverse] = {}

    @property
    def version(self) -> int:
        """Counts changes of the matrices that outdate their preconditioners."""
        raise NotImplementedError

    def blocks(self) -> dict[str, PETSc.Vec]:
        """A new vector for each block, in the order of the preconditioner."""
        raise NotImplementedError

    def matrices(self) -> list[list[PETSc.Mat | None]]:
        """The blocks of the Jacobian; None where it is zero."""
        raise NotImplementedError

    def options(self, linear: str) -> dict[str, Options]:
        """PETSc options of each block's preconditioner; ``linear`` is direct, multigrid or auto."""
        raise NotImplementedError

    def impose(self, x: list[PETSc.Vec]) -> None:
        """Put prescribed values into a state."""
        raise NotImplementedError

    def residual(self, x: list[PETSc.Vec], f: list[PETSc.Vec]) -> None:
        """The residual of a state."""
        raise NotImplementedError

    def jacobian(self, x: list[PETSc.Vec]) -> None:
        """Set the blocks of the Jacobian to a state, unless they are constant."""
        return None

    def linearize_at(self, forces: Floats | None) -> None:
        """Take contact laws as linear about forces at own points (n, 3) [MPa], or as they are."""
        return None

    def record_active_set(self) -> None:
        """Record the states of the contact points at the last residual."""
        return None

    def measure(self, x: list[PETSc.Vec], f: list[PETSc.Vec]) -> list[Measure]:
        """How large the residual f of a state x is, by part; collective."""
        raise NotImplementedError

    def coarse_space(self) -> CoarseSpace | None:
        """Sliding motions that the last Jacobian hardly resists, to be deflated; None without."""
        return None

    def scale_augmentation(self, factor: float) -> bool:
        """Solve with this multiple of the augmentation in force; whether there is any."""
        return False

    def augmentation(self) -> dict[str, float]:
        """Augmentation in force on each interface [MPa/mm]; collective."""
        return {}

    def usual_augmentation(self) -> float:
        """Multiple of the augmentation asked for that would be chosen; collective."""
        return 1.0

    def tie(self, on: bool) -> bool:
        """Solve with interfaces tied that were open everywhere so far; whether there are any."""
        return False


def size(vectors: list[PETSc.Vec]) -> float:
    """Norm of a state or residual in several blocks; collective."""
    return math.sqrt(sum(v.norm() ** 2 for v in vectors))
