"""Bonded interfaces: would the bond hold?

A bond that cannot part carries whatever loads, shrinking and cooling ask of it. Its tractions, from
the stress of the softer side, are compared with the strength of cement on bone.
"""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

from app.arrays import Floats
from app.mechanics.problem import Problem
from app.results.stresses import Stresses, extrapolated
from app.scene.bodies import FACET_NODES, facet_coordinates, facets_between
from meshes.contact_facets import QUADRATURE, surface

# Strength of the cement-bone interface [MPa]: Mann, Werner & Ayers 1999, as quoted by the paper in
# its section 4.5.
TENSILE_STRENGTH, SHEAR_STRENGTH = 1.35, 2.25


class Bond:
    """A bonded interface, seen from its softer side.

    Attributes:
        facets: Number of its facets that this rank owns.

    Args:
        soft: Regions whose stress counts.
        stiff: Regions on the other side.
    """

    def __init__(
        self,
        problem: Problem,
        stresses: Stresses,
        name: str,
        soft: Sequence[str],
        stiff: Sequence[str],
    ) -> None:
        self.name, self._comm, self._stresses = name, problem.comm, stresses
        self._sides = []
        self.facets = 0
        vertices = np.vstack([np.zeros(3), np.eye(3)])
        for region in soft:
            f = facets_between(problem.tagged, [region], stiff)
            x, centre = facet_coordinates(problem.tagged, f)
            n, size = surface(x, QUADRATURE)
            inward = np.einsum("fqi,fi->fq", n, centre - x[:, :3].mean(axis=1)) > 0
            # The facets' points in the reference cell (f, q, 3).
            X = np.einsum("qk,fki->fqi", QUADRATURE, vertices[FACET_NODES[f.local, :3]])
            rows = np.searchsorted(stresses.cells[region], f.cells)
            self.facets += len(rows)
            self._sides.append((region, rows, np.where(inward[..., None], -n, n), size / 6, X))

    def tractions(self) -> Floats:
        """Normal traction, positive in tension, shear [MPa] and area [mm2] at own points (3, p)."""
        parts: list[Floats] = [np.zeros((3, 0))]
        for region, rows, n, area, X in self._sides:
            σ = self._stresses.evaluate(region)[rows]
            t = np.einsum("fqij,fqj->fqi", extrapolated(σ, self._stresses.points[region], X), n)
            normal = np.einsum("fqi,fqi->fq", t, n)
            shear = np.linalg.norm(t - normal[..., None] * n, axis=2)
            parts.append(np.stack([normal, shear, area]).reshape(3, -1))
        return np.concatenate(parts, axis=1)

    def numbers(self) -> dict[str, float]:
        """Published numbers; collective.

        ``strength_fraction`` is the part of the area where
        (tension / 1.35 MPa)^2 + (shear / 2.25 MPa)^2 exceeds 1.
        """
        pieces = self._comm.allgather(self.tractions())
        normal, shear, area = np.concatenate(pieces, axis=1)
        total = area.sum()
        load = (np.maximum(normal, 0) / TENSILE_STRENGTH) ** 2 + (shear / SHEAR_STRENGTH) ** 2
        return {
            "area": float(total),
            "strength_fraction": float(area[load > 1].sum() / total),
            "normal_mean": float(normal @ area / total),
            "normal_max": float(normal.max()),
            "shear_mean": float(shear @ area / total),
            "shear_max": float(shear.max()),
        }


def bonds(problem: Problem, stresses: Stresses) -> tuple[Bond, ...]:
    """Bonded interfaces of a scene with facets in its mesh; collective."""
    found = [Bond(problem, stresses, b.name, b.slave, b.master) for b in problem.scene.bonds]
    return tuple(b for b in found if problem.comm.allreduce(b.facets, MPI.SUM) > 0)
