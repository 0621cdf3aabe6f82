r"""Static condensation: the displacement is eliminated once, exactly; Newton solves for the jumps.

The Jacobian of contact, with T and B blocks of contact points, is

.. math:: J = \begin{pmatrix} K & C \\ T C^T & T D + B \end{pmatrix}, \qquad S = D - C^T K^{-1} C,

so that a step solves (T S + B) dq = r_q - T C^T K^{-1} r_u and K du = r_u - C dq. The factors of

.. math:: A' = \begin{pmatrix} K & C \\ C^T & D + \tau \end{pmatrix} = L L^T, \qquad \tau = diag(D),

with the jumps last hold both: the last block of L is the factor of S + tau. (S alone is singular: a
stem can slide and rotate without resistance.) S stays for all steps, stages and variations of one
stiffness.

T S + B is singular in a state that holds a body in some directions only, such as the first iterate
of a belt that only contact holds. The bodies are then joined by weak springs in this step,

.. math:: (T S + B + \varepsilon \, diag(S)) dq = r_q,

so that unbalanced forces move the free bodies until contact stops them.

Rigid motions that nothing resists, columns of Z, need other springs: a frictionless stem may turn
about its axis. With springs along these motions only, T S + B + s Z Z^T, the step is exact, because
balanced forces cause no such motion.
Unknowns that points follow are last too, before the jumps: new pairs change S, but no factors
(`numerics.untied`). One rank factors and solves for all.
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
from scipy.sparse import block_array, bsr_array, csc_array, csr_array, diags_array, vstack

from app.arrays import Floats
from app.errors import on_root
from app.numerics.cholesky import Cholesky, library
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
    """Context of a PCPYTHON: the inverse of the Jacobian of contact; made collectively.

    Attributes:
        cholesky: Factors of A', on rank 0.
    """

    def __init__(self, contact: Condensable) -> None:
        self._contact = contact
        K, _, D = contact.parts()
        self._comm = K.comm.tompi4py()
        self.size, self._jumps = K.getSize()[0], D.getSize()[0]
        self._order, self._kept = np.arange(self.size), self.size
        self._ties = self._gathered_ties()
        self._matrix: csc_array | None = self._gathered_matrix()
        self._made = self._bodies = -1
        self._untied: Untied | None = None
        self._sprung = False
        if self._matrix is not None:
            self.cholesky = self._analysed(self._matrix)

    @property
    def work(self) -> tuple[float, float]:
        """Operations and entries of the factors; collective."""
        c = None if self._comm.rank else self.cholesky
        return self._comm.bcast(c and (c.flops, c.entries))

    # Factors

    def _analysed(self, A: csc_array) -> Cholesky:
        return Cholesky(A, self.size + self._jumps - self._kept)

    def _gathered_ties(self) -> csr_array | None:
        """Displacement of points by the last unknowns, if they follow, on rank 0; collective."""
        if (ties := self._contact.ties()) is None:
            return None
        Q, every = (self._gathered_rows(A) for A in ties)
        if self._comm.rank:
            return None
        if self._kept == self.size:
            there = np.unique(every.indices // 3)
            last = (3 * there[:, None] + np.arange(3)).ravel()
            self._order = np.concatenate([np.setdiff1d(self._order, last), last])
            self._kept -= len(last)
        return Q[:, self._order[self._kept :]]

    def _gathered_matrix(self) -> csc_array | None:
        """A' on rank 0, its upper triangle right, None elsewhere; collective."""
        K, C, D = self._contact.parts()
        every = [self._gathered_rows(A) for A in (K, C, D)]
        if self._comm.rank:
            return None
        k, c, d = every
        self._tau = d.diagonal()
        if self._ties is not None:
            k, c = k[self._order][:, self._order], c[self._order]
        lower = block_array([[c.T, d + diags_array(self._tau)]], format="csr")
        k.resize(self.size, self.size + self._jumps)
        rows = vstack([k[: self._kept], _joined(vstack([k[self._kept :], lower]))], format="csr")
        # Rows of the lower triangle are columns of the upper one.
        return csc_array((rows.data, rows.indices, rows.indptr), shape=rows.shape)

    def _gathered_rows(self, A: PETSc.Mat) -> csr_array:
        """A matrix on rank 0, own rows elsewhere; collective."""
        starts, columns, values = A.getValuesCSR()
        own = csr_array((values, columns, starts), shape=(len(starts) - 1, A.getSize()[1]))
        every = self._comm.gather(own) if self._comm.size > 1 else [own]
        return vstack(every, format="csr") if every else own

    def _renew(self) -> None:
        """Factor the bodies if their stiffness has changed; collective."""
        if self._made == (now := self._contact.version):
            return
        self._made, bodies = now, now - self._contact.pairings
        self._ties = self._gathered_ties()
        if self._bodies != bodies:
            A = self._matrix if self._bodies < 0 else self._gathered_matrix()
            self._bodies, self._matrix = bodies, None
            if A is not None:
                if not self.cholesky.fits(A):  # a support may have let go
                    self.cholesky = self._analysed(A)
                self.cholesky.factorize(A)
                self._S = self.cholesky.schur()
                jumps = np.arange(len(self._S))[-self._jumps :]
                self._S[jumps, jumps] -= self._tau
                self._untied = None if self._ties is None else Untied(self._S, self._ties)
        if self._comm.rank == 0:
            if self._untied is not None:
                self._S = self._untied.tie(self._ties)
            self._single = self._S.astype(np.float32)

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
        pulled = self._on_root(self._pulled, q, ru.array_r)
        dq = self._on_root(lambda a, b: self._step(a - self._T @ b), q, rq.array_r, pulled)
        u.array = self._on_root(self._moved, u, dq)
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
        pulled = self._on_root(self._pulled, q_vector, ru)
        e = e - pulled
        r, scale = self._contact.law(e, q)
        norm, moving, kept = self._norm(r), True, False
        before_springs: list[float] = []
        # One at least: states that are only just in balance would drift from cycle to cycle.
        while norm > (tolerance * scale if number else 0.0) and moving and number < MOST:
            if not kept:
                self.setUp()
            dq = self._on_root(self._step, q_vector, r)
            if not self._comm.bcast(self._sprung):
                before_springs = []
            else:
                before_springs.append(norm)
                if norm > min(before_springs[:-SINGULAR_STEPS], default=math.inf) / 2:
                    break  # what is free stays unbalanced
            de = self._on_root(lambda: self._pushed, q_vector)
            for part in PARTS:
                there = e - part * de, q - part * dq
                r, scale = self._contact.law(*there)
                if moving := (new := self._norm(r)) < norm:
                    kept, norm = new < CHORD * norm, new
                    e, q = there
                    break
            number += 1
        u.array[:] -= self._on_root(self._moved, u, q_vector.array_r - q)
        q_vector.array[:] = q
        return number

    def _norm(self, own: Floats) -> float:
        return math.sqrt(self._comm.allreduce(float(own @ own)))

    def _on_root(self, function: Callable[..., Floats], like: PETSc.Vec, *own: Floats) -> Floats:
        """Own part, as of a vector, of a function of values of all ranks; collective."""
        every = [self._gathered(v) for v in own]
        if self._comm.size == 1:
            return function(*every)
        found = function(*every) if self._comm.rank == 0 else None
        part = np.empty(like.getLocalSize())
        sizes = self._comm.gather(len(part))
        self._comm.Scatterv([found, sizes] if found is not None else None, part)
        return part

    # On rank 0

    def _pulled(self, ru: Floats) -> Floats:
        """Forces on jumps of the displacement that other forces cause, C^T K^-1 r_u."""
        self._half = np.concatenate([ru[self._order], np.zeros(self._jumps)])
        if ru.any():
            self._half = self.cholesky.down(self._half)
        elif self._untied is None:  # as in cycles
            return self._half[self.size :].copy()
        self._given = self.cholesky.last(self._half[self._kept :])
        if self._untied is not None:
            return self._untied.solve(self._given, np.zeros(self._jumps))[0]
        return -self._given

    def _moved(self, dq: Floats) -> Floats:
        """The displacement K^-1 (r_u - C dq), r_u as last given to `_pulled`."""
        last = dq if self._untied is None else self._untied.solve(self._given, dq)[1]
        self._half[self._kept :] = self.cholesky.last(last, transposed=True)
        u = np.empty(self.size)
        u[self._order] = self.cholesky.up(self._half)[: self.size]
        return u

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
    """Whether CHOLMOD can be compiled against; collective."""
    return bool(on_root(comm, lambda: library() is not None))


def _joined(rows: csr_array) -> csr_array:
    """Add zero entries of the last unknowns in the columns of the first three of these.

    ``rows`` are the last rows of a matrix. CHOLMOD's postordering puts other unknowns between the
    last ones if these are in several branches of its elimination tree, such as the jumps of columns
    that supports hold. With these entries the last unknowns are one branch.
    """
    first = rows.shape[1] - rows.shape[0]
    i, j = np.indices((rows.shape[0], 3)).reshape(2, -1)
    a = rows.tocoo()
    at = np.concatenate([a.row, i]), np.concatenate([a.col, first + j])
    return csr_array((np.concatenate([a.data, np.zeros(len(i))]), at), shape=a.shape)


def _blocks(values: Floats) -> csr_array:
    """Block-diagonal matrix of blocks (n, 3, 3)."""
    n = len(values)
    return bsr_array((values, np.arange(n), np.arange(n + 1))).tocsr()
