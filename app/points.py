"""The contact law at the contact points of one rank: UFL in, arrays out.

The law of `forms.contact` is pointwise, so it is compiled on a mesh whose cells are the contact
points (unconnected intervals on this rank alone) with one value per cell. Points with the same
number of faces and the same kind of friction form a group and share one compiled law; a scene
without friction or without edges never compiles the others.
"""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import create_mesh
from numpy.typing import NDArray

from forms.contact import contact_law

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


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
            _Group(comm, rows, normals[rows, :m], friction[rows], k)
            for m, k in kinds
            for rows in [np.flatnonzero((faces == m) & (frictional == k))]
        ]

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
        for group in self._groups:
            group.evaluate(out, force, jump, gap, jump_old, r)
        return out


class _Group:
    """Points with the same number of faces and the same kind of friction."""

    def __init__(
        self, comm: MPI.Comm, rows: Ints, normals: Floats, friction: Floats, frictional: bool
    ) -> None:
        self._rows = rows
        # A rank without such points still takes part in the compilation.
        cells = max(len(rows), 1)
        element = basix.ufl.element("Lagrange", "interval", 1, shape=(1,))
        self._mesh = create_mesh(
            MPI.COMM_SELF,
            np.arange(2 * cells, dtype=np.int64).reshape(-1, 2),
            np.arange(2 * cells, dtype=np.float64).reshape(-1, 1),
            ufl.Mesh(element),
        )
        original = self._mesh.topology.original_cell_index
        self._cells = np.arange(cells, dtype=np.int32)
        self._input_of_cell = original[: len(rows)]
        vectors = fem.functionspace(self._mesh, ("DG", 0, (3,)))
        scalars = fem.functionspace(self._mesh, ("DG", 0))
        self._dofs = vectors.dofmap.list[: len(rows), 0]
        self._force, self._jump, self._gap, self._old, star = (
            fem.Function(vectors) for _ in range(5)
        )
        faces = [fem.Function(vectors) for _ in range(normals.shape[1])]
        μ, self._r = fem.Function(scalars), fem.Function(scalars)
        self._r.x.array[:] = 1
        for k, face in enumerate(faces):
            face.x.array[:] = 1
            self._put(face, normals[:, k])
        self._put(μ, friction)
        law = contact_law(
            self._force,
            self._jump,
            self._gap,
            self._old,
            star,
            faces,
            μ if frictional else None,
            self._r,
        )
        centre = np.array([[0.5]])
        self._expressions = [
            fem.Expression(e, centre, comm=comm)
            for e in (law.force, law.jacobian, law.pressures, law.status)
        ]

    def _put(self, function: fem.Function, values: Floats) -> None:
        """Set a function from values in the order of this group's points."""
        if len(self._rows):
            size = function.function_space.dofmap.index_map_bs
            function.x.array.reshape(-1, size)[self._dofs] = values.reshape(-1, size)[
                self._input_of_cell
            ]

    def evaluate(
        self,
        out: PointForces,
        force: Floats,
        jump: Floats,
        gap: Floats,
        jump_old: Floats,
        r: Floats,
    ) -> None:
        """Fill the rows of this group."""
        if not len(self._rows):
            return
        rows = self._rows
        for function, values in (
            (self._force, force),
            (self._jump, jump),
            (self._gap, gap),
            (self._old, jump_old),
            (self._r, r),
        ):
            self._put(function, values[rows])
        f, b, p, s = (e.eval(self._mesh, self._cells) for e in self._expressions)
        at = rows[self._input_of_cell]
        out.force[at] = f.reshape(-1, 3)
        out.jacobian[at] = b.reshape(-1, 3, 3)
        out.pressures[at, : p.shape[-1]] = p.reshape(len(rows), -1)
        out.status[at] = np.rint(s.reshape(-1)).astype(np.int64)


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
