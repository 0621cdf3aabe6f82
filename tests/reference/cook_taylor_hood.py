r"""Cook's membrane by Taylor and Hood's elements: the origin of `verification.closed_forms.COOK`.

Plane strain in displacement u and pressure p, in two dimensions and with another discretisation
than the application's: cubic u and quadratic continuous p, which do not lock, on a mesh graded
towards the corners, where the stress is singular or jumps:

.. math:: \int 2μ ε(u):ε(v) - p\, div\, v - q\, div\, u - p q / λ = \int_{right} t v.

Run it (some seconds) to see the ladder::

    python3 tests/reference/cook_taylor_hood.py
"""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import basix.ufl
import gmsh
import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem.petsc import assemble_matrix, assemble_vector
from dolfinx.mesh import Mesh, locate_entities_boundary, meshtags

from app.foundation import dolfinx_features

POISSON_RATIOS = (0.3, 0.45, 0.49, 0.499, 0.4999)
# The outline, with the middle of the loaded edge as a vertex.
OUTLINE = ((0, 0), (48, 44), (48, 52), (48, 60), (0, 44))


def mesh(size: float) -> Mesh:
    """Triangles of a size [mm], shrinking to a thousandth of it at the corners."""
    gmsh.initialize(readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    geo = gmsh.model.geo
    points = [geo.addPoint(x, y, 0) for x, y in OUTLINE]
    lines = [geo.addLine(a, b) for a, b in zip(points, points[1:] + points[:1], strict=True)]
    surface = geo.addPlaneSurface([geo.addCurveLoop(lines)])
    geo.synchronize()
    gmsh.model.addPhysicalGroup(2, [surface])
    field = gmsh.model.mesh.field
    distance = field.add("Distance")
    field.setNumbers(distance, "PointsList", [points[k] for k in (0, 1, 3, 4)])
    field.add("MathEval", 2)
    field.setString(2, "F", f"{size} * (0.001 + 0.999 * (F{distance} / 30)^0.75)")
    field.setAsBackgroundMesh(2)
    gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 0)
    gmsh.option.setNumber("Mesh.MeshSizeFromPoints", 0)
    gmsh.model.mesh.generate(2)
    result = dolfinx_features.gmsh.model_to_mesh(gmsh.model, MPI.COMM_SELF, 0, gdim=2)[0]
    gmsh.finalize()
    return result


def displacement(
    ν: float, size: float, at: tuple[float, float], E: float = 250.0, F: float = 100.0
) -> np.ndarray:
    """Displacement (2,) of a vertex of the membrane [mm]."""
    domain = mesh(size)
    cell = domain.basix_cell()
    cubic = basix.ufl.element("Lagrange", cell, 3, shape=(2,))
    quadratic = basix.ufl.element("Lagrange", cell, 2)
    W = fem.functionspace(domain, basix.ufl.mixed_element([cubic, quadratic]))
    (u, p), (v, q) = ufl.TrialFunctions(W), ufl.TestFunctions(W)
    μ, λ = E / (2 * (1 + ν)), E * ν / ((1 + ν) * (1 - 2 * ν))

    def ε(w: ufl.core.expr.Expr) -> ufl.core.expr.Expr:
        return ufl.sym(ufl.grad(w))

    a = 2 * μ * ufl.inner(ε(u), ε(v)) - p * ufl.div(v) - q * ufl.div(u) - p * q / λ
    right = locate_entities_boundary(domain, 1, lambda x: np.isclose(x[0], 48))
    tags = meshtags(domain, 1, np.sort(right), np.ones(len(right), dtype=np.int32))
    ds = ufl.Measure("ds", domain, subdomain_data=tags)
    V, _ = W.sub(0).collapse()
    left = locate_entities_boundary(domain, 1, lambda x: np.isclose(x[0], 0))
    held = fem.locate_dofs_topological((W.sub(0), V), 1, left)
    fixed = fem.dirichletbc(fem.Function(V), held, W.sub(0))
    A = assemble_matrix(fem.form(a * ufl.dx), bcs=[fixed])
    A.assemble()
    b = assemble_vector(fem.form(F / 16 * v[1] * ds(1)))
    b.array[held[0]] = 0
    pc = PETSc.PC().create(MPI.COMM_SELF)
    pc.setOperators(A)
    pc.setType("lu")
    pc.setFactorSolverType("mumps")
    solution = fem.Function(W)
    pc.apply(b, solution.x.petsc_vec)
    u_h = solution.sub(0).collapse()
    x = u_h.function_space.tabulate_dof_coordinates()[:, :2]
    nearest = int(np.argmin(np.linalg.norm(x - np.array(at), axis=1)))
    return np.asarray(u_h.x.array.reshape(-1, 2)[nearest])


if __name__ == "__main__":
    for ratio in POISSON_RATIOS:
        for h in (16.0, 8.0, 4.0):
            print(ratio, h, *(displacement(ratio, h, at) for at in ((48, 60), (48, 52))))
    print("E = 240.565: corner and middle (8.063, 7.688 in the physics reference)")
    for place in ((48, 60), (48, 52)):
        print(place, displacement(0.4999, 4.0, place, E=240.565))
