"""Bonded interfaces: would the bond hold?

A bond that cannot part carries whatever loads, shrinking and cooling ask of it. Its tractions, from
the stress of the softer side, are compared with the strength of cement on bone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from app.arrays import Floats
from app.mechanics.problem import Problem
from app.results.stresses import Stresses, extrapolated
from app.scene.bodies import FACET_NODES, facet_coordinates, facets_between
from meshes.contact_facets import QUADRATURE, surface

# Strength of the cement-bone interface [MPa]: Mann, Werner & Ayers 1999, as quoted by the paper in
# its section 4.5.
TENSILE_STRENGTH, SHEAR_STRENGTH = 1.35, 2.25


def bonds(problem: Problem, stresses: Stresses) -> dict[str, dict[str, float]]:
    """Published numbers of bonded interfaces with facets in the mesh, by name; collective.

    ``strength_fraction`` is the part of the area where
    (tension / 1.35 MPa)^2 + (shear / 2.25 MPa)^2 exceeds 1.
    """
    found = {}
    for b in problem.scene.bonds:
        local = np.concatenate([tractions(problem, stresses, r, b.master) for r in b.slave], axis=1)
        normal, shear, area = np.concatenate(problem.comm.allgather(local), axis=1)
        if not len(area):
            continue
        total = area.sum()
        load = (np.maximum(normal, 0) / TENSILE_STRENGTH) ** 2 + (shear / SHEAR_STRENGTH) ** 2
        found[b.name] = {
            "area": float(total),
            "strength_fraction": float(area[load > 1].sum() / total),
            "normal_mean": float(normal @ area / total),
            "normal_max": float(normal.max()),
            "shear_mean": float(shear @ area / total),
            "shear_max": float(shear.max()),
        }
    return found


def tractions(problem: Problem, stresses: Stresses, soft: str, stiff: Sequence[str]) -> Floats:
    """Normal traction, positive in tension, shear [MPa] and area [mm2] at own points (3, p).

    Those of the soft region where it meets the stiff ones.
    """
    f = facets_between(problem.tagged, [soft], stiff)
    x, centre = facet_coordinates(problem.tagged, f)
    n, size = surface(x, QUADRATURE)
    inward = np.einsum("fqi,fi->fq", n, centre - x[:, :3].mean(axis=1)) > 0
    n = np.where(inward[..., None], -n, n)
    # The facets' points in the reference cell (f, q, 3).
    vertices = np.vstack([np.zeros(3), np.eye(3)])
    X = np.einsum("qk,fki->fqi", QUADRATURE, vertices[FACET_NODES[f.local, :3]])
    σ = stresses.evaluate(soft)[np.searchsorted(stresses.cells[soft], f.cells)]
    t = np.einsum("fqij,fqj->fqi", extrapolated(σ, stresses.points[soft], X), n)
    normal = np.einsum("fqi,fqi->fq", t, n)
    shear = np.linalg.norm(t - normal[..., None] * n, axis=2)
    return np.stack([normal, shear, size / 6]).reshape(3, -1)
