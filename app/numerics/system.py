"""Systems of equations as the solver sees them: blocks of unknowns, residual, Jacobian.

A system defines its linear algebra: its blocks, their preconditioners, the limit of its
residual. Block order is that of the Gauss-Seidel preconditioner.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from app.foundation.arrays import Ints
from app.numerics.deflation import CoarseSpace
from app.numerics.lifetime import Preconditioner
from app.numerics.preconditioners import Inverse, Options

# Stiffness of weak springs where nothing holds a body, as a fraction of the diagonal of the matrix
# of the jumps.
SPRING_STIFFNESS = 1e-2


@dataclass(frozen=True)
class Measure:
    """Size of a part of a residual.

    Attributes:
        norm: Norm of the part.
        scale: Size of the terms that it balances.
        rounding: Rounding error of the norm.
        lasting: True if the scale of a converged state holds for later states. The scale of forces
            does; the scale of heat in the first instant of a contact does not.
    """

    norm: float
    scale: float
    rounding: float
    lasting: bool = True

    def limit(self, tolerance: float) -> float:
        """Norm below which the part has converged, for a tolerance relative to the scale."""
        return max(tolerance * self.scale, self.rounding)


class ContactLaw(Protocol):
    """Interface between the nonlinear solver and the laws of all contact points.

    `app.mechanics.point_laws.PointLaws` implements it, and says more.
    """

    def scale_augmentation(self, factor: float) -> None:
        """Multiply the augmentation of the case by a factor, until the next call."""

    def factor_to_default_augmentation(self) -> float:
        """Geometric mean of the ratio of the default augmentation to that of the case [-].

        Collective.
        """


class LawRemedies(Protocol):
    """Interface between the nonlinear solver and what it changes in the laws for a while.

    `app.mechanics.contact_remedies.ContactRemedies` implements it, and says more. A change lasts as
    long as its context. The value of the context is False if there is nothing to change.
    """

    def constraining(self) -> AbstractContextManager[bool]:
        """Constrain interfaces that have to close to hold a body; collective."""

    def opening(self) -> AbstractContextManager[bool]:
        """Open all interfaces that can open; collective."""

    def freezing(self) -> AbstractContextManager[bool]:
        """Freeze the internal variables."""

    def tresca_friction(self) -> AbstractContextManager[bool]:
        """Limit friction by given pressures, zero at first; collective."""

    def relax_tresca_friction(self, share: float) -> float:
        """Move the given pressures by a share towards those of the last evaluation; collective."""


class SolvedContact(Protocol):
    """Interface between the nonlinear solver and the contact of a system.

    `app.mechanics.contact.ContactInterfaces` implements it, and says more.
    """

    @property
    def laws(self) -> ContactLaw:
        """Laws at the local points."""

    @property
    def remedies(self) -> LawRemedies:
        """Changes of the laws that remedies ask for."""

    def augmentation(self) -> dict[str, float]:
        """Augmentation of each interface that can open [MPa/mm], by name; collective."""


class System(Protocol):
    """Interface between the nonlinear solver and a system of equations.

    The defaults hold for a system without contact.
    """

    comm: MPI.Comm
    prefix: str
    # PETSc options of its Newton iteration that differ from the solver's.
    newton: Mapping[str, str | float] = MappingProxyType({})
    # Shared inverses of diagonal blocks, by block.
    inverses: Mapping[str, Inverse] = MappingProxyType({})
    contact: SolvedContact | None = None
    # Newton iterations that are taken from a state that is in balance, if its residual is not zero.
    min_iterations: int = 0

    @property
    def version(self) -> int:
        """Number of changes of the matrices that outdate their preconditioners."""

    def blocks(self) -> dict[str, PETSc.Vec]:
        """A new vector for each block, in the order of the preconditioner."""

    def matrices(self) -> list[list[PETSc.Mat | None]]:
        """The blocks of the Jacobian; None where it is zero."""

    def options(self, linear: str) -> dict[str, Options]:
        """PETSc options of each block's preconditioner; ``linear`` is direct, multigrid or auto."""

    def impose(self, x: list[PETSc.Vec]) -> None:
        """Set prescribed values in a state."""

    def residual(self, x: list[PETSc.Vec], f: list[PETSc.Vec]) -> None:
        """The residual of a state."""

    def jacobian(self, x: list[PETSc.Vec]) -> None:
        """Set the blocks of the Jacobian to a state, unless they are constant."""
        return None

    @property
    def status(self) -> Ints:
        """States of the contact points of this rank at the last residual (n,)."""
        return np.zeros(0, dtype=np.int64)

    def measure(self, x: list[PETSc.Vec], f: list[PETSc.Vec]) -> list[Measure]:
        """Size of the residual f of a state x, by part; collective."""

    def runs_away(self, x: list[PETSc.Vec]) -> bool:
        """Return True if a state is far outside small displacements; collective."""
        return False

    def remove_free_motions(self, x: list[PETSc.Vec]) -> bool:
        """Remove rigid motions that nothing resists from the last step; True if the state changes.

        Collective.
        """
        return False

    def condensed(self, linear: str) -> Exact | None:
        """The inverse of the Jacobian, where it is to be used."""
        return None

    def coarse_space(self) -> CoarseSpace | None:
        """Sliding motions that the last Jacobian hardly resists, to be deflated; None without."""
        return None


class Reduced(System, Protocol):
    """A system in which linear unknowns of another one are eliminated."""

    def begin(self, x: list[PETSc.Vec], tolerance: float) -> PETSc.Vec:
        """Eliminate the linear unknowns at a state of the whole system; return the others."""

    def end(self, x: list[PETSc.Vec], q: PETSc.Vec) -> None:
        """Set a state of the whole system from a state of this one; collective."""


class Exact(Preconditioner, Protocol):
    """Exact inverse of a Jacobian, in Python.

    Attributes:
        reduced: The system in which it eliminates linear unknowns, if any.
    """

    reduced: Reduced | None

    def renew(self) -> None:
        """Factor what does not depend on the state, if it has changed; collective."""


class MatrixFree(System, Exact, Protocol):
    """A system that is operator (MATPYTHON) and inverse (PCPYTHON) of its Jacobian.

    Attributes:
        operator: The Jacobian, which calls ``mult``.
    """

    operator: PETSc.Mat
    reduced: Reduced | None = None

    def matrices(self) -> list[list[PETSc.Mat | None]]:
        """The Jacobian as an operator."""
        return [[self.operator]]

    def options(self, linear: str) -> dict[str, Options]:
        """Return no options: the inverse is exact."""
        return {}

    def condensed(self, linear: str) -> Exact:
        """Return the system itself."""
        return self


def block_norm(vectors: list[PETSc.Vec]) -> float:
    """Norm of a state or residual in several blocks; collective."""
    return math.sqrt(sum(v.norm() ** 2 for v in vectors))
