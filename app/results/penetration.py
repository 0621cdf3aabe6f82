"""Overlap of bodies between the contact points, where the law does not act.

The law holds at the points, along the mean normals of the facets around them. Between them the
surfaces move apart by the displacements of both bodies, along the normals of the facets themselves.
"""

from __future__ import annotations

import numpy as np

from app.arrays import Floats, Ints
from app.mechanics.contact import ContactInterfaces
from meshes.contact_facets import InterfaceFacets, shape_functions, surface

# Sampled points of a facet: corners, middles of edges, and between them (barycentric).
LATTICE = np.array([(i, j, 4 - i - j) for i in range(5) for j in range(5 - i)]) / 4


def overlap(contact: ContactInterfaces, jump: Floats) -> list[dict[str, float]]:
    """Penetration of each interface on its facets: largest and mean over the area; collective.

    Jumps are those of own contact points (n, 3) [mm].
    """
    motion, clearance = _motion(contact, jump), _clearance(contact)
    found = []
    for rows, triangles in zip(contact.points.facets, contact.points.triangles, strict=True):
        gap, area = gaps(contact.facets, rows, motion[rows], clearance[triangles])
        depth = np.maximum(-gap, 0.0)
        found.append(
            {
                "penetration_sampled": float(depth.max(initial=0.0)),
                "penetration_mean": float((depth * area).sum() / area.sum()) if len(rows) else 0.0,
            }
        )
    return found


def gaps(
    facets: InterfaceFacets, rows: Ints, motion: Floats, clearance: Floats
) -> tuple[Floats, Floats]:
    """Gap along the normals of facets at `LATTICE` (f, q) [mm], and the area of each.

    Args:
        facets: All facets.
        rows: Facets to evaluate (f,).
        motion: Displacement of their slave side against the master at their nodes (f, m, 3) [mm].
        clearance: Initial gap at their corners (f, 3) [mm].
    """
    x = facets.nodes[rows]
    normals, area = surface(x, LATTICE)
    inwards = np.sign(np.einsum("fi,fi->f", normals[:, -1], facets.normal[rows, 0]))
    apart = np.einsum("qn,fni->fqi", shape_functions(LATTICE, motion.shape[1]), motion)
    along = np.einsum("fqi,fqi->fq", apart, normals) * inwards[:, None]
    return along + clearance @ LATTICE.T, area


def _motion(contact: ContactInterfaces, jump: Floats) -> Floats:
    """Displacement of the slave side against the master at the nodes of all facets (f, m, 3)."""
    dofs, bodies = contact.facets.dofs, contact.facets.bodies
    nodes, place = np.unique(dofs, return_inverse=True)
    place = place.reshape(dofs.shape)
    moved = np.zeros((1 + int(bodies.max()), len(nodes), 3))
    for body, B in contact.coupling.jump_to_displacement.items():
        q, u = B.createVecs()
        q.array[:] = jump.ravel()
        B.mult(q, u)
        start, end = (k // 3 for k in u.getOwnershipRange())
        own = (nodes >= start) & (nodes < end)
        moved[body, own] = u.array.reshape(-1, 3)[nodes[own] - start]
    moved = contact.comm.allreduce(moved)
    return moved[bodies[:, 1:], place] - moved[bodies[:, :1], place]


def _clearance(contact: ContactInterfaces) -> Floats:
    """Initial gap at all contact points (n,) [mm]; 0 where supports constrain every component."""
    here = np.zeros(len(contact.points.weight))
    here[contact.own.rows] = np.einsum("pi,pi->p", contact.gap, contact.own.normals[:, 0])
    return contact.comm.allreduce(here)
