"""GetFEM on the arrays of a case, as a program of its own: python3 getfem_peer.py MODEL RESULT.

It imports nothing of mantle, so that its process is GetFEM's alone. Contact is GetFEM's basic brick
with Coulomb friction: an augmented Lagrangian with one multiplier for each pair of nodes, solved
by its Newton method with MUMPS. On meshes that match, its nodal contact of two bodies is the same.
The augmentation is its user's choice: with the first version of the brick 1e3 N/mm converges
on the tapered stem, 1e4 and 1e5 do not at 5 mm.
"""

from __future__ import annotations

import sys
from typing import Any

import getfem as gf
import numpy as np

AUGMENTATION = 1e3  # N/mm
VERSION = 1  # Alart and Curnier's, not symmetric
START = 1.0  # N: all pairs are pressed together at first, or nothing would hold the inner bodies
TOLERANCE, ITERATIONS = 1e-8, 200
FIXED = 1000  # number of a region that no material has


def solve(given: Any) -> Any:
    """Displacement of the nodes (n, 3) [mm], in their order.

    Args:
        given: The arrays that `peer_programs.arrays` makes, by name.

    Raises:
        RuntimeError: Newton's method has not converged.
    """
    points, cells = given["points"].copy(), given["cells"]
    # One mesh for all bodies, moved apart, for it joins points at one place. Neither elasticity nor
    # contact between pairs of nodes sees where bodies are.
    body = np.zeros(len(points))
    body[cells] = given["body"][:, None]
    points[:, 0] += 2.0 * float(np.ptp(points[:, 0])) * body
    mesh = gf.Mesh("empty", 3)
    cell = mesh.add_convex(gf.GeoTrans("GT_PK(3,1)"), points[cells].transpose(2, 1, 0))
    mf, mim = gf.MeshFem(mesh, 3), gf.MeshIm(mesh, gf.Integ("IM_TETRAHEDRON(1)"))
    mf.set_fem(gf.Fem("FEM_PK(3,1)"))
    dof = 3 * _rows(points, mf.basic_dof_nodes()[:, ::3].T)[:, None] + np.arange(3)
    md = gf.Model("real")
    md.add_fem_variable("u", mf)
    for r, (e, nu) in enumerate(zip(given["young"], given["poisson"], strict=True)):
        mesh.set_region(r + 1, cell[None, given["region"] == r])
        md.add_initialized_data(f"mu{r}", e / (2 * (1 + nu)))
        md.add_initialized_data(f"lambda{r}", e * nu / ((1 + nu) * (1 - 2 * nu)))
        md.add_isotropic_linearized_elasticity_brick(mim, "u", f"lambda{r}", f"mu{r}", r + 1)
    fixed = _rows(points[given["fixed"]], mesh.pts().T)
    mesh.set_region(FIXED, mesh.faces_from_pid(mesh.pid()[fixed]))
    md.add_Dirichlet_condition_with_simplification("u", FIXED)
    load = np.zeros(mf.nbdof())
    load[dof] = given["forces"]
    md.add_explicit_rhs("u", load)
    _contact(md, given, dof)
    count, converged = md.solve(
        *("noisy", "max_res", TOLERANCE, "max_iter", ITERATIONS),
        *("lsolver", "mumps", "lsearch", "simplest"),
    )
    if not converged:
        raise RuntimeError(f"not converged in {count} iterations")
    return md.variable("u")[dof]


def _contact(md: Any, given: Any, dof: Any) -> None:
    """Contact with friction between pairs of nodes."""
    n = len(given["normals"])
    along, across = gf.Spmat("empty", n, dof.size), gf.Spmat("empty", 2 * n, dof.size)
    for k, normal in enumerate(given["normals"]):
        tangents = np.linalg.svd(normal[None])[2][1:]
        for side, sign in (("first", 1.0), ("second", -1.0)):
            columns = dof[given[side][k]]
            along.add([k], columns, sign * normal[None])
            across.add([2 * k, 2 * k + 1], columns, sign * tangents)
    md.add_variable("pressure", n)
    md.add_variable("shear", 2 * n)
    md.set_variable("pressure", np.full(n, -START))
    md.add_initialized_data("r", AUGMENTATION)
    md.add_initialized_data("friction", given["friction"])
    md.add_initialized_data("gap", np.zeros(n))
    md.add_initialized_data("alpha", np.ones(n))
    md.add_basic_contact_brick(
        *("u", "pressure", "shear", "r", along, across, "friction", "gap", "alpha", VERSION)
    )


def _rows(points: Any, among: Any) -> Any:
    """Row of each point among others that it is one of, to the last bit (k,)."""
    rows = {tuple(x): k for k, x in enumerate(among.tolist())}
    return np.array([rows[tuple(x)] for x in points.tolist()])


if __name__ == "__main__":
    with np.load(sys.argv[1]) as file:
        found = solve(dict(file))
    np.save(sys.argv[2], found)
