"""Lifetime of PETSc's objects: all that were made for a run are destroyed with it.

Matrices, solvers and meshes hold communicators, of which MPICH has 2,048. Python's garbage
collector does not see what PETSc refers to. On several ranks petsc4py destroys no object that
Python has dropped: it waits for a clean-up of its communicator, since destroying is collective.
"""

from __future__ import annotations

import gc
from collections.abc import Callable
from itertools import count
from typing import Any, Protocol
from weakref import WeakMethod, ref

from mpi4py import MPI
from petsc4py import PETSc

from dolfinx import fem
from dolfinx.mesh import Mesh

_runs = count()  # of this process
# Meshes and spaces of several ranks, each with an object that keeps its communicator.
_communicators: list[tuple[ref[Mesh | fem.FunctionSpace], PETSc.IS]] = []
# Objects that Python drops may be the last to refer to others: solver, preconditioner, its factors.
COLLECTIONS = 3


def weak(method: Callable[..., Any]) -> Callable[..., Any]:
    """Return a callback for PETSc that does not keep the object of a method alive.

    An object that owns its PETSc object and is its callback, too, would never be destroyed.
    """
    reference = WeakMethod(method)

    def call(*arguments: Any) -> Any:
        target = reference()
        assert target is not None
        return target(*arguments)

    return call


class Preconditioner(Protocol):
    """Preconditioner in Python."""

    def setUp(self, pc: PETSc.PC) -> None:
        """Set up for the operators of a PC."""

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Apply to x, into y."""


class _WeakContext:
    def __init__(self, context: Preconditioner) -> None:
        self.setUp, self.apply = weak(context.setUp), weak(context.apply)


def python_pc(context: Preconditioner, comm: MPI.Comm) -> PETSc.PC:
    """Return a PETSc preconditioner that does not keep its context in Python alive.

    A clean-up that destroyed the context, too, would lose the PETSc objects that this drops.
    """
    return PETSc.PC().createPython(_WeakContext(context), comm=comm)


class Operator(Protocol):
    """Matrix in Python."""

    def mult(self, A: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Apply to x, into y."""


class _WeakOperator:
    def __init__(self, operator: Operator) -> None:
        self.mult = weak(operator.mult)


def python_mat(operator: Operator, size: tuple[int, int], comm: MPI.Comm) -> PETSc.Mat:
    """Return a square PETSc matrix that does not keep its operator in Python alive.

    ``size`` is the number of rows of this rank, and of all.
    """
    matrix = PETSc.Mat().createPython((size, size), _WeakOperator(operator), comm=comm)
    matrix.setUp()
    return matrix


def register(owner: Mesh | fem.FunctionSpace) -> None:
    """Have `release` clean up a communicator; collective.

    Matrices and solvers have that of their mesh, assembled vectors that of their space.
    """
    comm = owner.comm if isinstance(owner, Mesh) else owner.dofmap.index_map.comm
    if comm.size > 1:
        _communicators.append((ref(owner), PETSc.IS().createStride(0, comm=comm)))


def function_space(mesh: Mesh, element: Any) -> fem.FunctionSpace:
    """Make a function space for PETSc's vectors, which `release` cleans up; collective."""
    space = fem.functionspace(mesh, element)
    register(space)
    return space


def begin_run(comm: MPI.Comm) -> None:
    """Release what earlier runs of this process have left, failed ones too; collective.

    The first run of a process, often its only one, does not pay for it.
    """
    if next(_runs):
        release(comm)


def clean_up(comm: MPI.Comm) -> None:
    """Destroy the objects of PETSc that the ranks of a communicator have dropped; collective.

    Communicators of other ranks are left out, as those ranks may be solving something else: the
    companions of a run are solved one to a rank.
    """
    for _, keeper in _communicators:
        ranks = MPI.Comm.Compare(keeper.comm.tompi4py(), comm)
        if ranks in (MPI.IDENT, MPI.CONGRUENT):
            PETSc.garbage_cleanup(keeper.comm)


def release(comm: MPI.Comm) -> None:
    """Destroy all objects of PETSc and DOLFINx that nothing refers to any more; collective."""
    for _ in range(COLLECTIONS):
        gc.collect()
        comm.barrier()
        for _, keeper in _communicators:
            PETSc.garbage_cleanup(keeper.comm)
    is_gone = [comm.allreduce(owner() is None, MPI.LAND) for owner, _ in _communicators]
    for (_, keeper), owner_is_gone in zip(_communicators, is_gone, strict=True):
        if owner_is_gone:
            keeper.destroy()
    _communicators[:] = [
        communicator
        for communicator, owner_is_gone in zip(_communicators, is_gone, strict=True)
        if not owner_is_gone
    ]
