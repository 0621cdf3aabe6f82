"""The contact law at the contact points of one rank: UFL in, arrays out.

Points with the same number of faces and the same kind of friction form a group and share one
compiled law of `forms.contact`; a scene without friction or without edges never compiles the
others.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray
from ufl.core.expr import Expr

from mantle.forms import contact
from mantle.forms.contact import contact_law
from mantle.numerics import kernels, pointwise
from mantle.numerics.pointwise import Pointwise

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# All that says what the law is: another text of one of them is another law.
SOURCES = (contact, pointwise, sys.modules[__name__])


@dataclass(frozen=True)
class PointForces:
    """What the law says at n points: forces, generalized Jacobian, face pressures, status."""

    force: Floats
    jacobian: Floats
    pressures: Floats
    status: Ints


class PointLaw:
    """The compiled contact law of every point of this rank."""

    def __init__(
        self, comm: MPI.Comm, normals: Floats, faces: Ints, friction: Floats, frictional: NDArray
    ) -> None:
        """Compile the laws that the scene needs; collective.

        Args:
            comm: Communicator of the mesh: the law is compiled once and shared.
            normals: Unit normals of the faces (n, 3, 3).
            faces: Number of faces (n,); a point with none carries no force.
            friction: Friction coefficient (n,).
            frictional: Whether the point's interface has friction at all (n,).
        """
        kinds = sorted(
            set().union(
                *comm.allgather(
                    {(int(m), bool(k)) for m, k in zip(faces, frictional, strict=True) if m}
                )
            )
        )
        self._n = len(faces)
        self._groups = [
            (rows, _compile(comm, normals[rows, :m], friction[rows], k))
            for m, k in kinds
            for rows in [np.flatnonzero((faces == m) & (frictional == k))]
        ]

    def set_friction(self, friction: Floats) -> None:
        """Change the friction coefficient (n,) of points that have friction."""
        for rows, law in self._groups:
            law.set(μ=friction[rows])

    @property
    def laws(self) -> int:
        """Number of compiled laws."""
        return len(self._groups)

    def evaluate(
        self, force: Floats, jump: Floats, gap: Floats, jump_old: Floats, r: Floats
    ) -> PointForces:
        """Evaluate the law at every point.

        Args:
            force: Multiplier (n, 3) [MPa].
            jump: Jump (n, 3) [mm].
            gap: Initial gap vector (n, 3) [mm].
            jump_old: Jump of the last converged state (n, 3) [mm].
            r: Augmentation or penalty (n,) [MPa/mm].
        """
        n = self._n
        out = PointForces(
            np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((n, 3)), np.zeros(n, dtype=np.int64)
        )
        for rows, law in self._groups:
            f, b, p, s = law(
                force=force[rows], jump=jump[rows], gap=gap[rows], old=jump_old[rows], r=r[rows]
            )
            out.force[rows] = f
            out.jacobian[rows] = b
            out.pressures[rows, : p.shape[1]] = p
            out.status[rows] = np.rint(s).astype(np.int64)
        return out


def _compile(comm: MPI.Comm, normals: Floats, friction: Floats, frictional: bool) -> Pointwise:
    """The law of n points with the same number m of faces, normals (n, m, 3)."""
    faces = [f"normal_{k}" for k in range(normals.shape[1])]
    vectors = ["force", "jump", "gap", "old", "star", *faces]

    def law(x: dict[str, Expr]) -> tuple[Expr, ...]:
        μ = x["μ"] if frictional else None
        state = (x["force"], x["jump"], x["gap"], x["old"], x["star"])
        found = contact_law(*state, [x[f] for f in faces], μ, x["r"])
        return found.force, found.jacobian, found.pressures, found.status

    sizes = dict.fromkeys(vectors, 3) | {"μ": 1, "r": 1}
    note = kernels.note_of(f"contact {len(faces)} {frictional}", SOURCES)
    compiled = Pointwise(comm, len(normals), sizes, law, note)
    constant: dict[str, Any] = {f: normals[:, k] for k, f in enumerate(faces)}
    compiled.set(μ=friction, **constant)
    return compiled


def gap_vectors(normals: Floats, faces: Ints, gap: Floats) -> Floats:
    """Vectors g (n, 3) with g . n_k the given normal gap on every face of each point [mm].

    Args:
        normals: Unit normals of the faces, zero beyond their number (n, 3, 3).
        faces: Number of faces (n,).
        gap: Initial gap (n,) [mm].
    """
    gram = np.einsum("pki,pli->pkl", normals, normals)
    unused = np.arange(3)[None, :] >= faces[:, None]
    gram[unused[:, :, None] & np.eye(3, dtype=bool)] = 1
    right = np.where(unused, 0.0, gap[:, None])
    return np.einsum("pk,pki->pi", np.linalg.solve(gram, right[:, :, None])[:, :, 0], normals)
