r"""Static condensation: the displacement is eliminated once, exactly; Newton solves for the jumps.

The Jacobian of contact, with T and B blocks of contact points, is

.. math:: J = \begin{pmatrix} K & C \\ T C^T & T D + B \end{pmatrix}, \qquad S = D - C^T K^{-1} C,

so that a step solves (T S + B) dq = r_q - T C^T K^{-1} r_u and K du = r_u - C dq. The ranks share
the elimination of the displacement (`numerics.substructures`). S is on rank 0, which solves for the
jumps of all ranks, and stays for all steps, stages and variations of one stiffness.

T S + B is singular in a state that holds a body in some directions only, such as the first iterate
of a belt that only contact holds. The bodies are then joined by weak springs in this step,

.. math:: (T S + B + \varepsilon \, diag(S)) dq = r_q,

so that unbalanced forces move the free bodies until contact stops them.

Rigid motions that nothing resists, columns of Z, need other springs: a frictionless stem may turn
about its axis. With springs along these motions only, T S + B + s Z Z^T, the step is exact, because
balanced forces cause no such motion.
Unknowns that points follow are last too, before the jumps: new pairs change S, but no factors
(`numerics.untied`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import get_lapack_funcs
from scipy.sparse import bsr_array, csr_array, diags_array, vstack

from app.foundation.arrays import Floats, Ints
from app.foundation.errors import on_root
from app.numerics.factor import library
from app.numerics.root_work import blas_threads, cores, wait
from app.numerics.substructures import Substructures, own_rows, unknowns_of
from app.numerics.untied import Untied

# Singular values of T, and parts of a row of B across its direction, that count as none.
NOTHING = 1e-10
# Newton steps at most; parts of one that are tried.
MOST, PARTS = 40, 2.0 ** -np.arange(8)
# Residual that a step in single precision may leave, and one in double; one after which the next
# step has its factors.
ROUGH, SINGULAR, CHORD = 1e-2, 1e-4, 1e-2
# Stiffness of the weak springs of a singular step, as a part of the diagonal of S.
SPRINGS = 1e-2
# Number of singular steps in a row within which the residual has to be halved.
SINGULAR_STEPS = 4
# Part of the tolerance that out-of-balance forces of a start may have without being removed.
LITTLE = 0.01


class Condensable(Protocol):
    """Interface between condensation and contact; arrays are those of own points.

    Attributes:
        factors: T and B at the last state, (n, 3, 3) each.
    """

    factors: tuple[Floats, Floats]

    def free_jumps(self) -> Floats:
        """Jumps of rigid motions that nothing resists at the last state (n, 3, k); collective."""

    @property
    def version(self) -> int:
        """Number of changes of the matrices."""

    @property
    def pairings(self) -> int:
        """Number of these by new pairs alone."""

    def ties(self) -> tuple[PETSc.Mat, PETSc.Mat] | None:
        """Displacement of points by unknowns they follow, and a matrix with all such columns."""

    def parts(self) -> tuple[PETSc.Mat, PETSc.Mat, PETSc.Mat]:
        """K, C without constrained rows, and D."""

    def forces(self, x: list[PETSc.Vec]) -> tuple[Floats, Floats, float]:
        """Residual of displacement and jumps without the law, and size of the forces [N]."""

    def law(self, e: Floats, q: Floats) -> tuple[Floats, float]:
        """Residual of the law at equilibrium e [N] and jumps q, and the forces' size."""


class Condensed:
    """Context of a PCPYTHON: the inverse of the Jacobian of contact; made collectively."""

    def __init__(self, contact: Condensable) -> None:
        self._contact = contact
        matrices = contact.parts()
        self._comm = matrices[0].comm.tompi4py()
        self._threads = cores(self._comm)
        self._jumps, self._own = matrices[2].getSize()[0], matrices[2].getLocalSize()[0]
        self._sizes = self._comm.gather(self._own)
        self._kept = self._followed()
        self._bodies = Substructures(matrices, self._kept)
        self._current = self._factored = -1
        self._untied: Untied | None = None
        self._sprung = False

    @property
    def work(self) -> tuple[float, float]:
        """Operations of the rank that has most, and entries of all factors."""
        return self._bodies.operations, self._bodies.entries

    # Factors

    def _followed(self) -> Ints:
        """Nodes that points may follow, sorted, on all ranks; collective."""
        ties = self._contact.ties()
        if ties is None:
            return np.zeros(0, dtype=np.int64)
        columns = np.unique(ties[1].getValuesCSR()[1] // 3)
        return np.unique(np.concatenate(self._comm.allgather(columns)))

    def _ties(self) -> csr_array | None:
        """Displacement of points by the nodes that they follow, on rank 0; collective."""
        ties = self._contact.ties()
        if ties is None:
            return None
        every = self._comm.gather(own_rows(ties[0]))
        return vstack(every, format="csr")[:, unknowns_of(self._kept)] if every else None

    def _renew(self) -> None:
        """Condense the bodies if their stiffness has changed; collective."""
        now = self._contact.version
        if self._current == now:
            return
        bodies = now - self._contact.pairings
        ties = self._ties()
        if self._factored != bodies:
            if self._factored >= 0:
                self._bodies.renew(self._contact.parts())
            S = self._bodies.factorize()
            if S is not None:
                self._S = S
                self._untied = None if ties is None else Untied(S, ties)
        if self._untied is not None:
            self._S = self._untied.tie(ties)
        if self._comm.rank == 0:
            self._single = self._S.astype(np.float32)
        self._current, self._factored = now, bodies

    def setUp(self, pc: PETSc.PC | None = None) -> None:
        """Set up for the current Jacobian; collective."""
        self._renew()
        rows = [self._gathered(v) for v in self._contact.factors]
        unresisted = self._contact.free_jumps()
        number = unresisted.shape[2]
        unresisted = self._gathered(unresisted)
        if self._comm.rank == 0:
            self._set_rows(*(v.reshape(-1, 3, 3) for v in rows))
            self._unresisted = np.linalg.qr(unresisted.reshape(self._jumps, number))[0]
            with blas_threads(self._threads):
                self._factor(self._single, self._B)

    def _gathered(self, own: Floats) -> Floats:
        """Values of all ranks one after the other, on rank 0; collective."""
        if self._comm.size == 1:
            return own
        every = self._comm.gather(own.ravel())
        return np.concatenate(every) if every else own

    def _set_rows(self, T: Floats, B: Floats) -> None:
        """Set the blocks, and the directions in which they tell the jump.

        Where a point sticks, or slides without opening, u^T T = 0 and u^T B is along u.
        """
        U, size, _ = np.linalg.svd(T)
        U = U.transpose(0, 2, 1)
        forces = U @ B
        along = np.einsum("pai,pai->pa", forces, U)
        across = np.linalg.norm(forces - along[..., None] * U, axis=2)
        known = ((size <= NOTHING) & (across <= NOTHING * np.abs(along)) & (along != 0)).ravel()
        self._T, self._B, directions = _blocks(T), _blocks(B), _blocks(U)
        self._known, self._free = directions[known], directions[~known]
        self._along = along.ravel()[known]

    def _factor(self, S: NDArray[np.floating], B: csr_array) -> None:
        """Factor T S + B in the other directions, in the precision of S."""
        free = self._free
        if not free.shape[0]:
            return
        moved = np.ascontiguousarray((free.astype(S.dtype) @ S).T)
        G = (free @ self._T).astype(S.dtype) @ moved
        G += (free @ B @ free.T).toarray().astype(S.dtype)
        if self._unresisted.shape[1]:
            Z = (free @ self._unresisted).astype(S.dtype)
            G += S.dtype.type(SPRINGS * np.abs(self._S.diagonal()).mean()) * (Z @ Z.T)
        getrf, self._getrs = get_lapack_funcs(("getrf", "getrs"), (G,))
        self._lu, self._pivots, _ = getrf(G.T, overwrite_a=True)  # in Fortran's order

    # Solution

    def apply(self, pc: PETSc.PC, r: PETSc.Vec, z: PETSc.Vec) -> None:
        """Solve J z = r; collective."""
        (ru, rq), (u, q) = (v.getNestSubVecs() for v in (r, z))
        pulled = self._pulled(ru.array_r)
        dq = self._on_root(lambda a, b: self._step(a - self._T @ b), rq.array_r, pulled)
        u.array = self._moved(dq)
        q.array = dq

    def iterate(self, x: list[PETSc.Vec], tolerance: float) -> int:
        """Newton in the jumps alone, from a state to a better one; collective.

        Stops below a tolerance of the residual over the forces, or where no step lowers it.

        Returns:
            The number of iterations.
        """
        self._renew()
        (u, q_vector), (ru, e, scale) = x, self._contact.forces(x)
        q, number = q_vector.array.copy(), 0
        if self._norm(ru) <= LITTLE * tolerance * scale:
            ru = np.zeros_like(ru)
        e = e - self._pulled(ru)
        r, scale = self._contact.law(e, q)
        norm, moving, kept = self._norm(r), True, False
        before_springs: list[float] = []
        # One at least: states that are only just in balance would drift from cycle to cycle.
        while norm > (tolerance * scale if number else 0.0) and moving and number < MOST:
            if not kept:
                self.setUp()
            dq = self._on_root(self._step, r)
            if not self._comm.bcast(self._sprung):
                before_springs = []
            else:
                before_springs.append(norm)
                if norm > min(before_springs[:-SINGULAR_STEPS], default=math.inf) / 2:
                    break  # what is free stays unbalanced
            de = self._on_root(lambda: self._pushed)
            for part in PARTS:
                there = e - part * de, q - part * dq
                r, scale = self._contact.law(*there)
                if moving := (new := self._norm(r)) < norm:
                    kept, norm = new < CHORD * norm, new
                    e, q = there
                    break
            number += 1
        u.array[:] -= self._moved(q_vector.array_r - q)
        q_vector.array[:] = q
        return number

    def _norm(self, own: Floats) -> float:
        return math.sqrt(self._comm.allreduce(float(own @ own)))

    def _on_root(self, function: Callable[..., Floats], *own: Floats) -> Floats:
        """Own part of jumps, a function of values of all ranks that rank 0 computes; collective."""
        every = [self._gathered(v) for v in own]
        if self._comm.rank:
            return self._scattered(None)
        with blas_threads(self._threads):
            return self._scattered(function(*every))

    def _scattered(self, jumps: Floats | None) -> Floats:
        """Own part of the jumps of all ranks, which rank 0 has; collective."""
        if self._comm.size == 1:
            assert jumps is not None
            return jumps
        wait(self._comm)
        own = np.empty(self._own)
        self._comm.Scatterv([jumps, self._sizes] if jumps is not None else None, own)
        return own

    def _pulled(self, ru: Floats) -> Floats:
        """Forces on own jumps that forces on own displacements cause, C^T K^-1 r_u; collective."""
        self._given = self._bodies.reduce(ru)
        if self._given is None:
            return self._scattered(None)
        if self._untied is None:
            return self._scattered(-self._given)
        return self._scattered(self._untied.solve(self._given, np.zeros(self._jumps))[0])

    def _moved(self, dq: Floats) -> Floats:
        """The displacement K^-1 (r_u - C dq), r_u as last given to `_pulled`; collective."""
        every = self._gathered(dq)
        if self._given is None:
            return self._bodies.expand(None)
        if self._untied is None:
            return self._bodies.expand(every)
        return self._bodies.expand(self._untied.solve(self._given, every)[1])

    # On rank 0

    def _step(self, r: Floats) -> Floats:
        """Solution of (T S + B) dq = r, with weak springs if it is singular; keeps S dq."""
        dq, self._sprung = self._by_factors(r), False
        if not self._solves(dq, r, ROUGH):
            self._factor(self._S, self._B)
            dq = self._by_factors(r)
            if not self._solves(dq, r, SINGULAR):
                self._sprung = True
                springs = diags_array(SPRINGS * np.abs(self._S.diagonal()))
                self._factor(self._S, csr_array(self._B + springs))
                dq = self._by_factors(r)
                self._times(dq)
        return dq

    def _solves(self, dq: Floats, r: Floats, tolerance: float) -> bool:
        """Return True if the residual of a step is a small part of r; keeps S dq."""
        left = np.linalg.norm(r - self._times(dq))
        return bool(left <= tolerance * np.linalg.norm(r))  # False if it is not finite

    def _times(self, dq: Floats) -> Floats:
        self._pushed = self._S @ dq
        return np.asarray(self._T @ self._pushed + self._B @ dq)

    def _by_factors(self, r: Floats) -> Floats:
        dq = self._known.T @ ((self._known @ r) / self._along)
        if self._free.shape[0]:
            # Beyond the range of single precision no step solves, and double precision takes over.
            with np.errstate(over="ignore", invalid="ignore"):
                left = (self._free @ (r - self._times(dq))).astype(self._lu.dtype)
            found, _ = self._getrs(self._lu, self._pivots, left, trans=1)
            dq += self._free.T @ found.astype(float)
        return np.asarray(dq)


def available(comm: MPI.Comm) -> bool:
    """Return True if there is a library for the factors; collective."""
    return bool(on_root(comm, lambda: library() is not None))


def _blocks(values: Floats) -> csr_array:
    """Block-diagonal matrix of blocks (n, 3, 3)."""
    n = len(values)
    return bsr_array((values, np.arange(n), np.arange(n + 1))).tocsr()
