"""Interface laws at the contact points of one rank: UFL in, arrays out.

Points with the same number of faces and laws of the same form share one compiled law; a scene
without friction or without edges never compiles the others.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from mpi4py import MPI

import numpy as np
from ufl import as_ufl
from ufl.core.expr import Expr

from app.arrays import Floats, Ints
from app.laws import interface_laws
from app.laws.interface_laws import AtPoint, InterfaceLaw
from app.numerics import kernel_cache, pointwise
from app.numerics.pointwise import Pointwise
from forms import contact

# All that says what a law is, beside the module it is in: another text is another law.
SOURCES = (contact, interface_laws, pointwise, sys.modules[__name__])


@dataclass(frozen=True)
class PointForces:
    """Forces, derivatives and states of the laws at n points.

    Attributes:
        force: Interface force per area (n, 3) [MPa].
        jacobian: Its generalized derivative by the trial force, or what stands for it: the part of
            a change of the jump that is resisted (n, 3, 3) [-].
        by_jump: Its generalized derivative by the jump (n, 3, 3) [MPa/mm].
        pressures: Of each face, positive in compression (n, 3) [MPa].
        status: OPEN, STICK or SLIP (n,).
        history: What the laws will remember, by name: (n, ...).
    """

    force: Floats
    jacobian: Floats
    by_jump: Floats
    pressures: Floats
    status: Ints
    history: Mapping[str, Floats] = field(default_factory=dict)


class PointLaw:
    """The compiled law of every point of this rank.

    Attributes:
        history: Shapes of what the laws remember, by name.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        normals: Floats,
        faces: Ints,
        laws: Sequence[InterfaceLaw],
        interface: Ints,
    ) -> None:
        """Compile the laws that the scene needs; collective.

        Args:
            comm: Communicator of the mesh: the law is compiled once and shared.
            normals: Unit normals of the faces (n, 3, 3).
            faces: Number of faces (n,); a point with none carries no force.
            laws: The law of each interface.
            interface: Interface of each point (n,).
        """
        forms = list(dict.fromkeys(law.form for law in laws))
        form = np.array([forms.index(law.form) for law in laws], dtype=np.int64)[interface]
        here = {(int(m), int(k)) for m, k in zip(faces, form, strict=True) if m}
        kinds = sorted(set().union(*comm.allgather(here)))
        self._n, self._interface = len(faces), interface
        self.history = {k: shape for law in laws for k, shape in law.history.items()}
        self._groups = []
        for m, k in kinds:
            rows = np.flatnonzero((faces == m) & (form == k))
            law = next(law for law in laws if law.form == forms[k])
            self._groups.append((rows, law, _compile(comm, normals[rows, :m], law)))
        self.set(laws)

    def set(self, laws: Sequence[InterfaceLaw]) -> None:
        """Change the constants of the laws: one for each interface, of the same forms."""
        for rows, law, compiled in self._groups:
            for name in law.values:
                each = [own.values.get(name, 0.0) for own in laws]
                compiled.set(**{name: np.array(each)[self._interface[rows]]})

    @property
    def laws(self) -> int:
        """Number of compiled laws."""
        return len(self._groups)

    def evaluate(
        self,
        force: Floats,
        jump: Floats,
        gap: Floats,
        jump_old: Floats,
        r: Floats,
        history: Mapping[str, Floats] | None = None,
    ) -> PointForces:
        """Evaluate the laws at every point.

        Args:
            force: Multiplier (n, 3) [MPa].
            jump: Jump (n, 3) [mm].
            gap: Initial gap vector (n, 3) [mm].
            jump_old: Jump of the last converged state (n, 3) [mm].
            r: Stiffness of the trial force (n,) [MPa/mm].
            history: What the laws remember, by name: (n, ...).
        """
        n, known = self._n, dict(history or {})
        out = PointForces(
            np.zeros((n, 3)),
            np.zeros((n, 3, 3)),
            np.zeros((n, 3, 3)),
            np.zeros((n, 3)),
            np.zeros(n, dtype=np.int64),
            {name: values.copy() for name, values in known.items()},
        )
        for rows, law, compiled in self._groups:
            old = {name: known[name][rows] for name in law.history}
            given = {"force": force, "jump": jump, "gap": gap, "old": jump_old, "r": r}
            f, slope, p, s, *left = compiled(None, **{k: v[rows] for k, v in given.items()}, **old)
            stiffness = r[rows, None, None]
            out.force[rows] = f
            if law.by_trial_force:
                out.jacobian[rows], out.by_jump[rows] = slope, stiffness * slope
            else:
                out.jacobian[rows] = slope @ np.linalg.inv(slope + stiffness * np.eye(3))
                out.by_jump[rows] = slope
            out.pressures[rows, : p.shape[1]] = p
            out.status[rows] = np.rint(s).astype(np.int64)
            for name, values in zip(law.history, left, strict=True):
                out.history[name][rows] = values
        return out


def _compile(comm: MPI.Comm, normals: Floats, law: InterfaceLaw) -> Pointwise:
    """The law of n points with the same number m of faces, normals (n, m, 3)."""
    faces = [f"normal_{k}" for k in range(normals.shape[1])]
    vectors = ["force", "jump", "gap", "old", "star", *faces]

    def build(x: dict[str, Expr]) -> tuple[Expr, ...]:
        values = {name: x[name] for name in law.values}
        history = {name: x[name] for name in law.history}
        state = (x["force"], x["jump"], x["gap"], x["old"], x["star"])
        at = AtPoint(*state, [x[f] for f in faces], x["r"], values, history)
        found = law.response(at)
        left = [as_ufl(found.history[name]) for name in law.history]
        return found.force, found.slope, found.pressures, found.status, *left

    sizes = dict.fromkeys(vectors, 3) | dict.fromkeys((*law.values, "r"), 1)
    sizes |= {name: int(np.prod(shape)) for name, shape in law.history.items()}
    module = sys.modules[type(law).__module__]
    known = getattr(module, "__file__", None) is not None
    note = kernel_cache.note_of(f"{law.form} {len(faces)}", (*SOURCES, module)) if known else None
    compiled = Pointwise(comm, len(normals), sizes, build, note)
    constant: dict[str, Any] = {f: normals[:, k] for k, f in enumerate(faces)}
    compiled.set(**constant)
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
