r"""Static condensation: the displacement is eliminated once, exactly; Newton solves for the jumps.

`Condensed` is the inverse of the Jacobian of displacement and jumps. `JumpSystem` is the system of
the jumps alone. The same loop solves both (`numerics.newton`). The first loop is for the jumps: its
iterations need no solution with the factors of the bodies. The second loop starts from there on the
whole system and tests the residual of all equations. Without the first loop, assembly and solution
of the bundled cases take a fifth (debonding.yaml) to half (head_cup.yaml) longer.

The Jacobian of contact, with T and B blocks of contact points, is

.. math:: J = \begin{pmatrix} K & C \\ T C^T & T D + B \end{pmatrix}, \qquad S = D - C^T K^{-1} C,

A step solves (T S + B) dq = r_q - T C^T K^{-1} r_u and K du = r_u - C dq. The ranks share the
elimination of the displacement (`numerics.substructures`). S is on rank 0, which solves for the
jumps of all ranks. It is kept for all steps, stages and variations of one stiffness.

T S + B is singular in a state that holds a body in some directions only. An example is the first
iterate of a belt that only contact holds. Weak springs then join the bodies in this step,

.. math:: (T S + B + \varepsilon \, diag(S)) dq = r_q,

so that unbalanced forces move the free bodies until contact stops them.

Rigid motions that nothing resists, columns of Z, need other springs: a frictionless stem may rotate
about its axis. With springs along these motions only, T S + B + s Z Z^T, the step is exact, because
balanced forces cause no such motion.

With finite sliding, unknowns that points follow come directly before the jumps. New pairs then
change S, but no factors (`numerics.paired_compliance`).
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
from app.foundation.collective import on_root
from app.numerics.factor import factor_class
from app.numerics.lifetime import python_mat
from app.numerics.paired_compliance import PairedCompliance
from app.numerics.root_work import blas_threads, usable_cores, wait
from app.numerics.sparse import owned_rows
from app.numerics.substructures import Substructures, unknowns_of
from app.numerics.system import SPRING_STIFFNESS, MatrixFree, Measure, Reduced

# Singular values of T below this are zero, and so are parts of a row of B across its direction,
# relative to the row [-].
ROUNDING_OF_SINGULAR_VALUES = 1e-10
# Residual that a step may leave, relative to its right-hand side: with factors in single precision.
SINGLE_TOLERANCE = 1e-2
# The same with factors in double precision.
DOUBLE_TOLERANCE = 1e-4
# The factors are kept for the next step if the residual has fallen to this fraction of itself.
REUSE_RATIO = 1e-2
# Fraction of the tolerance that out-of-balance forces of a start may have without being removed.
NEGLIGIBLE_IMBALANCE = 0.01


class Condensable(Protocol):
    """Interface between condensation and contact; arrays have rows of local points.

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

    def pair_matrices(self) -> tuple[PETSc.Mat, PETSc.Mat] | None:
        """Two matrices: from current master unknowns to the points, from all to the masters."""

    def uncondensed_matrices(self) -> tuple[PETSc.Mat, PETSc.Mat, PETSc.Mat]:
        """K, C without constrained rows, and D."""

    def forces(self, x: list[PETSc.Vec]) -> tuple[Floats, Floats, float]:
        """Residual of displacement and jumps without the law, and size of the forces [N]."""

    def law(self, e: Floats, q: Floats) -> tuple[Floats, float]:
        """Residual of the law at equilibrium e [N] and jumps q, and the forces' size."""

    @property
    def law_status(self) -> Ints:
        """States of local points at the last call of `law` (n,)."""

    def runs_away(self, x: list[PETSc.Vec]) -> bool:
        """Return True if jumps, the last block of x, exceed the size of the model; collective."""


class Condensed:
    """Context of a PCPYTHON: the inverse of the Jacobian of contact; made collectively.

    Attributes:
        reduced: The system of the jumps alone.
    """

    reduced: Reduced | None

    def __init__(self, contact: Condensable) -> None:
        self._contact = contact
        self.reduced = JumpSystem(self, contact)
        matrices = contact.uncondensed_matrices()
        self._comm = matrices[0].comm.tompi4py()
        self._threads = usable_cores(self._comm)
        self._jumps, self._local_size = matrices[2].getSize()[0], matrices[2].getLocalSize()[0]
        self._sizes = self._comm.gather(self._local_size)
        self._followed_nodes = self._find_followed_nodes()
        self._bodies = Substructures(matrices, self._followed_nodes)
        self._matrix_version = self._body_version = -1
        self._paired_compliance: PairedCompliance | None = None

    @property
    def entries(self) -> float:
        """Entries of all factors of the bodies."""
        return self._bodies.factor_entries

    # Factors

    def _find_followed_nodes(self) -> Ints:
        """Nodes that points may follow, sorted, on all ranks; collective."""
        pair_matrices = self._contact.pair_matrices()
        if pair_matrices is None:
            return np.zeros(0, dtype=np.int64)
        columns = np.unique(pair_matrices[1].getValuesCSR()[1] // 3)
        return np.unique(np.concatenate(self._comm.allgather(columns)))

    def _pair_matrix(self) -> csr_array | None:
        """Displacement of points by the nodes that they follow, on rank 0; collective."""
        pair_matrices = self._contact.pair_matrices()
        if pair_matrices is None:
            return None
        rows_of_ranks = self._comm.gather(owned_rows(pair_matrices[0]))
        return (
            vstack(rows_of_ranks, format="csr")[:, unknowns_of(self._followed_nodes)]
            if rows_of_ranks
            else None
        )

    def renew(self) -> None:
        """Condense the bodies if their stiffness has changed; collective."""
        matrix_version = self._contact.version
        if self._matrix_version == matrix_version:
            return
        body_version = matrix_version - self._contact.pairings
        pairs = self._pair_matrix()
        if self._body_version != body_version:
            if self._body_version >= 0:
                self._bodies.renew(self._contact.uncondensed_matrices())
            S = self._bodies.factorize()
            if S is not None:
                self._S = S
                self._paired_compliance = None if pairs is None else PairedCompliance(S, pairs)
        if self._paired_compliance is not None:
            self._S = self._paired_compliance.constrain(pairs)
        if self._comm.rank == 0:
            self._S_single = self._S.astype(np.float32)
        self._matrix_version, self._body_version = matrix_version, body_version

    def setUp(self, pc: PETSc.PC) -> None:
        """Set up for the current Jacobian; collective."""
        self.renew()
        self.factor()

    def factor(self) -> None:
        """Factor T S + B, with the blocks of the last state; collective."""
        blocks = [self._gathered(v) for v in self._contact.factors]
        unresisted = self._contact.free_jumps()
        motion_count = unresisted.shape[2]
        unresisted = self._gathered(unresisted)
        if self._comm.rank == 0:
            self._set_rows(*(v.reshape(-1, 3, 3) for v in blocks))
            self._unresisted = np.linalg.qr(unresisted.reshape(self._jumps, motion_count))[0]
            with blas_threads(self._threads):
                self._factor(self._S_single, self._B)

    def _gathered(self, local: Floats) -> Floats:
        """Values of all ranks one after the other, on rank 0; collective."""
        if self._comm.size == 1:
            return local
        of_all_ranks = self._comm.gather(local.ravel())
        return np.concatenate(of_all_ranks) if of_all_ranks else local

    def _set_rows(self, T: Floats, B: Floats) -> None:
        """Set the blocks, and divide the directions u of the jumps into direct and coupled ones.

        A direction is direct if u^T T = 0 and u^T B = b u^T: the row of the Jacobian then gives
        u^T dq = u^T r / b. This holds where a point sticks, or slides without opening. The factors
        have the coupled directions only.
        """
        # Left singular vectors of T, as rows of u (n, 3, 3).
        left_vectors, singular, _ = np.linalg.svd(T)
        u = left_vectors.transpose(0, 2, 1)
        uB = u @ B
        b = np.einsum("pai,pai->pa", uB, u)
        off_direction = np.linalg.norm(uB - b[..., None] * u, axis=2)
        is_eigenvector = (off_direction <= ROUNDING_OF_SINGULAR_VALUES * np.abs(b)) & (b != 0)
        is_direct = ((singular <= ROUNDING_OF_SINGULAR_VALUES) & is_eigenvector).ravel()
        self._T, self._B, directions = _blocks(T), _blocks(B), _blocks(u)
        self._direct, self._coupled = directions[is_direct], directions[~is_direct]
        self._direct_stiffness = b.ravel()[is_direct]

    def _factor(self, S: NDArray[np.floating], B: csr_array) -> None:
        """Factor T S + B in the coupled directions, in the precision of S."""
        u = self._coupled
        if not u.shape[0]:
            return
        S_u = np.ascontiguousarray((u.astype(S.dtype) @ S).T)
        G = (u @ self._T).astype(S.dtype) @ S_u
        G += (u @ B @ u.T).toarray().astype(S.dtype)
        if self._unresisted.shape[1]:
            Z = (u @ self._unresisted).astype(S.dtype)
            G += S.dtype.type(SPRING_STIFFNESS * np.abs(self._S.diagonal()).mean()) * (Z @ Z.T)
        getrf, self._getrs = get_lapack_funcs(("getrf", "getrs"), (G,))
        self._lu_factors, self._pivots, _ = getrf(G.T, overwrite_a=True)  # in Fortran's order

    # Solution

    def apply(self, pc: PETSc.PC, r: PETSc.Vec, z: PETSc.Vec) -> None:
        """Solve J z = r; collective."""
        (ru, rq), (u, q) = (v.getNestSubVecs() for v in (r, z))
        from_displacement = self.forces_on_jumps(ru.array_r)
        dq = self._solve_on_root(
            lambda a, b: self._step(a - self._T @ b), rq.array_r, from_displacement
        )
        u.array = self.displacement(dq)
        q.array = dq

    def step(self, r: Floats) -> Floats:
        """Solution of (T S + B) dq = r at local points; collective."""
        return self._solve_on_root(self._step, r)

    def times(self, dq: Floats) -> Floats:
        """(T S + B) dq at local points; collective."""
        return self._solve_on_root(self._times, dq)

    def forces(self, dq: Floats) -> Floats:
        """S dq, the forces at local points by jumps of the bodies in equilibrium; collective."""
        return self._solve_on_root(lambda jumps: self._S @ jumps, dq)

    def _solve_on_root(self, function: Callable[..., Floats], *local: Floats) -> Floats:
        """Owned part of jumps that rank 0 computes from the values of all ranks; collective."""
        gathered = [self._gathered(v) for v in local]
        if self._comm.rank:
            return self._scattered(None)
        with blas_threads(self._threads):
            return self._scattered(function(*gathered))

    def _scattered(self, jumps: Floats | None) -> Floats:
        """Owned part of the jumps of all ranks, which rank 0 has; collective."""
        if self._comm.size == 1:
            assert jumps is not None
            return jumps
        wait(self._comm)
        local = np.empty(self._local_size)
        self._comm.Scatterv([jumps, self._sizes] if jumps is not None else None, local)
        return local

    def forces_on_jumps(self, ru: Floats) -> Floats:
        """Forces C^T K^-1 r_u on owned jumps by forces on owned displacements; collective."""
        self._reduced_forces = self._bodies.reduce(ru)
        if self._reduced_forces is None:
            return self._scattered(None)
        if self._paired_compliance is None:
            return self._scattered(-self._reduced_forces)
        return self._scattered(
            self._paired_compliance.solve(self._reduced_forces, np.zeros(self._jumps))[0]
        )

    def displacement(self, dq: Floats) -> Floats:
        """The displacement K^-1 (r_u - C dq), r_u as last in `forces_on_jumps`; collective."""
        gathered = self._gathered(dq)
        if self._reduced_forces is None:
            return self._bodies.expand(None)
        if self._paired_compliance is None:
            return self._bodies.expand(gathered)
        return self._bodies.expand(self._paired_compliance.solve(self._reduced_forces, gathered)[1])

    # On rank 0

    def _step(self, r: Floats) -> Floats:
        """Solution of (T S + B) dq = r, with weak springs if it is singular."""
        dq = self._solve_by_factors(r)
        if self._is_solution(dq, r, SINGLE_TOLERANCE):
            return dq
        self._factor(self._S, self._B)
        dq = self._solve_by_factors(r)
        if self._is_solution(dq, r, DOUBLE_TOLERANCE):
            return dq
        springs = diags_array(SPRING_STIFFNESS * np.abs(self._S.diagonal()))
        self._factor(self._S, csr_array(self._B + springs))
        return self._solve_by_factors(r)

    def _is_solution(self, dq: Floats, r: Floats, tolerance: float) -> bool:
        """Return True if the residual of a step is a small part of r."""
        residual_norm = np.linalg.norm(r - self._times(dq))
        return bool(residual_norm <= tolerance * np.linalg.norm(r))  # False if it is not finite

    def _times(self, dq: Floats) -> Floats:
        return np.asarray(self._T @ (self._S @ dq) + self._B @ dq)

    def _solve_by_factors(self, r: Floats) -> Floats:
        """Solution of (T S + B) dq = r: the direct directions, then the coupled ones."""
        dq = self._direct.T @ ((self._direct @ r) / self._direct_stiffness)
        if self._coupled.shape[0]:
            # Beyond the range of single precision no step solves, and double precision takes over.
            with np.errstate(over="ignore", invalid="ignore"):
                residual = (self._coupled @ (r - self._times(dq))).astype(self._lu_factors.dtype)
            solved, _ = self._getrs(self._lu_factors, self._pivots, residual, trans=1)
            dq += self._coupled.T @ solved.astype(float)
        return np.asarray(dq)


class JumpSystem(MatrixFree, Reduced):
    """Contact of bodies in equilibrium: its unknowns are the jumps, its Jacobian is T S + B.

    Its inverse is the dense factors of the Jacobian.
    """

    prefix = "mantle_jump_"
    # One step at least: states that are only just in balance would drift from cycle to cycle.
    min_iterations = 1

    def __init__(self, condensed: Condensed, contact: Condensable) -> None:
        self._condensed, self._contact = condensed, contact
        D = contact.uncondensed_matrices()[2]
        self.comm = D.comm.tompi4py()
        self._jumps = D.createVecLeft()
        self.operator = python_mat(self, self._jumps.getSizes(), self.comm)
        self._initial_jumps = self._initial_equilibrium = np.zeros(self._jumps.getLocalSize())
        self._scale = self._norm = self._norm_before = 0.0

    def begin(self, x: list[PETSc.Vec], tolerance: float) -> PETSc.Vec:
        """Bring the bodies of a state into equilibrium with its jumps; return these; collective."""
        self._condensed.renew()
        forces, e, scale = self._contact.forces(x)
        if self._size(forces) <= NEGLIGIBLE_IMBALANCE * tolerance * scale:
            forces = np.zeros_like(forces)
        self._initial_jumps = x[1].array.copy()
        self._initial_equilibrium = e - self._condensed.forces_on_jumps(forces)
        self._norm_before = 0.0
        return x[1]

    def end(self, x: list[PETSc.Vec], q: PETSc.Vec) -> None:
        """Set a state to jumps, and to the displacement in equilibrium with them; collective."""
        x[0].array[:] -= self._condensed.displacement(self._initial_jumps - q.array_r)
        q.copy(x[1])

    def _size(self, local: Floats) -> float:
        return math.sqrt(self.comm.allreduce(float(local @ local)))

    # As a system

    @property
    def version(self) -> int:
        """Number of changes of the matrices."""
        return self._contact.version

    def blocks(self) -> dict[str, PETSc.Vec]:
        """The jumps."""
        return {"jump": self._jumps.duplicate()}

    def impose(self, x: list[PETSc.Vec]) -> None:
        """Do nothing: jumps that are prescribed have been set at the beginning."""

    def residual(self, x: list[PETSc.Vec], f: list[PETSc.Vec]) -> None:
        """Residual of the law at the jumps and at the equilibrium that they lead to."""
        q = x[0].array_r
        e = self._initial_equilibrium - self._condensed.forces(self._initial_jumps - q)
        f[0].array, self._scale = self._contact.law(e, q.copy())
        self._norm = self._size(f[0].array_r)

    def jacobian(self, x: list[PETSc.Vec]) -> None:
        """Factor the Jacobian at the state of the last residual, unless the last step was short."""
        if self._norm >= REUSE_RATIO * self._norm_before:
            self._condensed.factor()
        self._norm_before = self._norm

    def measure(self, x: list[PETSc.Vec], f: list[PETSc.Vec]) -> list[Measure]:
        """Out-of-balance forces of the contact points, with their scale [N]."""
        return [Measure(self._norm, self._scale, 0.0)]

    @property
    def status(self) -> Ints:
        """States of the contact points of this rank at the last residual (n,)."""
        return self._contact.law_status

    def runs_away(self, x: list[PETSc.Vec]) -> bool:
        """Return True if bodies have moved past each other by the size of the model; collective."""
        return self._contact.runs_away(x)

    # As operator and inverse of PETSc

    def mult(self, A: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Apply the Jacobian to x, into y."""
        y.array = self._condensed.times(x.array_r)

    def renew(self) -> None:
        """Condense the bodies if their stiffness has changed; collective."""
        self._condensed.renew()

    def setUp(self, pc: PETSc.PC) -> None:
        """Do nothing: `jacobian` has set up the factors."""

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Apply the inverse of the Jacobian to x, into y."""
        y.array = self._condensed.step(x.array_r)


def has_factor_library(comm: MPI.Comm) -> bool:
    """Return True if there is a library for the factors; collective."""
    return bool(on_root(comm, lambda: factor_class() is not None))


def _blocks(values: Floats) -> csr_array:
    """Block-diagonal matrix of blocks (n, 3, 3)."""
    n = len(values)
    return bsr_array((values, np.arange(n), np.arange(n + 1))).tocsr()
