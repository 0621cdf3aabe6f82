r"""Goal-oriented error: how wrong one number is, and where in the mesh that comes from.

With u the solution, z that of the adjoint problem (the same linearized contact, transposed, under
the derivative of the number N by the state), the error is

.. math:: N(u) - N(u_h) ≈ a(u - u_h, z - z_h)
          ≈ \sum_K \int_K (σ^*_u - σ_u) : C^{-1} (σ^*_z - σ_z)
          + \sum_f \tfrac{A_f}{3} \sum_{e ⊂ f} (φ_z · n)(q · n),

with σ* the recovered stress of each. The states of the contact points are frozen. The second sum is
what the law leaves between its points: jumps q are linear along an edge e of a facet, and where
both ends are closed the middle slides on a chord while the surface is curved; φ_z is the force of
the adjoint solution per area, both are means of the ends, n is their mean normal.

References: Becker and Rannacher, An optimal control approach to a posteriori error estimation, Acta
Numerica 10 (2001); Zienkiewicz and Zhu, The superconvergent patch recovery, IJNME 33 (1992).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

import basix
import numpy as np
from dolfinx import la

from app.arrays import Bools, Floats, Ints
from app.case.case import Case
from app.mechanics.problem import Problem
from app.numerics.newton import Solver
from app.results.interface_numbers import ContactSamples, Facets
from app.results.recovery import recovered
from app.results.stem_motion import Gradient, corner_dofs, stem_gradient
from app.results.stresses import COMPONENTS, Stresses
from app.results.vtkhdf import (
    QUADRATIC_NODES,
    QUADRATIC_TETRAHEDRON,
    TETRAHEDRON,
    GridFile,
)
from app.scene.bodies import FACET_VERTICES, cell_tags
from forms.contact import OPEN
from meshes.distribute import TaggedMesh

# Residual of the adjoint equations at which they are solved: far below the error of the estimate.
TOLERANCE = 1e-3
# Points of a cell that integrate second order, with equal weights.
FOUR = np.asarray(basix.make_quadrature(basix.CellType.tetrahedron, 2)[0])
# Part of the error that cells have which are proposed to be divided.
SHARE = 0.5
FRACTIONS = {"p95": 0.95, "p99": 0.99, "mean": None}
ROWS, COLUMNS = np.array(COMPONENTS).T


@dataclass(frozen=True)
class Missing:
    """What is missing of a number, in its unit.

    Attributes:
        inside: Part that comes from the inside of bodies.
        interfaces: Part that comes from jumps between the contact points.
        cells: Part of each own cell (c,).
        volumes: Volume of each own cell (c,) [mm3].
        iterations: Krylov iterations of the adjoint solution.
    """

    inside: float
    interfaces: float
    cells: Floats
    volumes: Floats
    iterations: int


def missing(
    problem: Problem, solver: Solver, stresses: Stresses, case: Case, samples: ContactSamples | None
) -> Missing:
    """Estimate what is missing of ``output.goal`` in the state last committed; collective."""
    x, iterations = adjoint(problem, solver, case, samples)
    z, v = solver.parts(x)
    # Without displacement there is the stress of eigenstrains, which the adjoint has not.
    rest = solver.vector()
    states = (z, v), solver.parts(rest), solver.parts()
    σ_z, σ_0, σ_u = [_stress(problem, stresses, *state) for state in states]
    cells = np.zeros(problem.tagged.mesh.topology.index_map(3).size_local)
    volumes = np.ones(len(cells))
    for region, own in stresses.cells.items():
        both = σ_u[region], σ_z[region] - σ_0[region]
        cells[own] = _of_region(problem, stresses, region, *both)
        volumes[own] = stresses.places(region)[1].sum(axis=1)
    inside = float(problem.comm.allreduce(float(cells.sum()), MPI.SUM))
    interfaces = 0.0
    if samples is not None and v is not None:
        interfaces = _between(problem, samples, z, v, cells)
    return Missing(inside, interfaces, cells, volumes, iterations)


def adjoint(
    problem: Problem,
    solver: Solver,
    case: Case,
    samples: ContactSamples | None,
    tolerance: float = TOLERANCE,
) -> tuple[PETSc.Vec, int]:
    """The adjoint displacement and jumps of ``output.goal``, and Krylov iterations; collective.

    Their work with a change of the loads is what the number changes by.
    """
    owner, _, key = str(case.output.goal).partition(".")
    bodies, jumps = _gradient(problem, case, samples, owner, key)
    return solver.adjoint(_right_hand_side(problem, solver, bodies, jumps), tolerance)


def _gradient(
    problem: Problem, case: Case, samples: ContactSamples | None, owner: str, key: str
) -> tuple[Gradient, Floats | None]:
    """Derivatives of a number by the displacement of each body, and by own jumps (n, 3)."""
    if owner == "stem":
        return stem_gradient(problem, case, key), None
    assert samples is not None
    (j,) = problem.jumps
    names = [c.name for c in problem.scene.contacts]
    kind, _, part = key.rpartition("_")
    facets = Facets(samples, names.index(owner))
    if kind == "gap":
        gap = np.maximum(samples.gap, 0.0)
        by_face = np.where(gap > 0, facets.gradient(gap, FRACTIONS[part]), 0.0)[j.mine]
        jumps = np.einsum("pk,pki->pi", by_face, j.normals)
    else:
        vectors = samples.slip if kind == "slip" else samples.motion
        size = np.linalg.norm(vectors, axis=1)
        moves = size > 0 if kind == "motion" else (size > 0) & (samples.status != OPEN)
        direction = np.where(moves[:, None], vectors / np.where(size > 0, size, 1.0)[:, None], 0.0)
        weight = facets.gradient(size, FRACTIONS[part]) * samples.sign
        jumps = (weight[:, None] * direction)[j.mine]
    return [], jumps


def _right_hand_side(
    problem: Problem, solver: Solver, bodies: Gradient, jumps: Floats | None
) -> PETSc.Vec:
    """Derivatives by the unknowns, as the adjoint equations have them; collective."""
    b = solver.vector()
    u, q = solver.parts(b)
    work, parts = problem.u.copy(), {}
    for body in range(len(problem.bodies.names)):
        work.x.array[:] = 0.0
        for _, nodes, values in (of_body for of_body in bodies if of_body[0] == body):
            np.add.at(work.x.array.reshape(-1, 3), nodes, values)
        work.x.scatter_reverse(la.InsertMode.add)
        parts[body] = PETSc.Vec().createWithArray(
            work.x.array[: 3 * problem.space.dofmap.index_map.size_local].copy(), comm=problem.comm
        )
    action = problem.forces.action(parts)
    problem.reduction.vector(action.nodal).copy(u)
    u.array[problem.held] = 0.0
    if q is not None:
        (j,) = problem.jumps
        whole = action.jump.reshape(-1, 3) + (0.0 if jumps is None else jumps)
        q.array[:] = j.let(whole).ravel()
    b.stateIncrease()
    return b


def _stress(
    problem: Problem, stresses: Stresses, u: PETSc.Vec, q: PETSc.Vec | None
) -> dict[str, Floats]:
    """Stress of each region in a state (cells, points, 3, 3) [MPa]; collective."""
    problem.spread(u, q)
    return {region: stresses.evaluate(region) for region in stresses.cells}


def _of_region(problem: Problem, stresses: Stresses, region: str, σ: Floats, τ: Floats) -> Floats:
    """Integral of the product of both errors over each cell of a region (c,); collective."""
    cells, both = (
        stresses.cells[region],
        np.concatenate([s[..., ROWS, COLUMNS] for s in (σ, τ)], axis=2),
    )
    X = stresses.at(region)
    if len(X) == 1:  # constant stress: the recovered one is not
        X = FOUR
        both = np.broadcast_to(both, (len(cells), len(X), both.shape[2]))
    x, measure = stresses.places(region, X if X is FOUR else None)
    x = x.reshape(len(cells), len(X), 3)
    away = recovered(problem, cells, X, x, both) - both
    a, b = (_tensors(part) for part in np.split(away, 2, axis=2))
    return np.asarray((stresses.work(region, a, b, x.reshape(-1, 3)) * measure).sum(axis=1))


def _tensors(components: Floats) -> Floats:
    """Symmetric tensors (..., 3, 3) of six components."""
    full = np.zeros((*components.shape[:-1], 3, 3))
    full[..., ROWS, COLUMNS] = full[..., COLUMNS, ROWS] = components
    return full


def _between(
    problem: Problem, samples: ContactSamples, z: PETSc.Vec, v: PETSc.Vec, cells: Floats
) -> float:
    """What jumps between closed points add; half of it goes to the cell on either side."""
    (j,) = problem.jumps
    e = j.equilibrium(z, v, np.zeros(3 * len(j.mine)))
    force = np.concatenate(problem.comm.allgather(e / j.weight[:, None]))
    rows = np.concatenate(problem.comm.allgather(j.mine))
    φ = np.empty(force.shape)
    φ[rows] = force
    q = samples.motion * samples.sign[:, None]
    closed = samples.status != OPEN
    total = 0.0
    keys: list[Ints] = []
    amounts: list[Floats] = []
    for i in range(len(problem.scene.contacts)):
        facets = Facets(samples, i)
        corners, normals = facets.triangles, facets.normals(samples)
        amount = np.zeros(len(corners))
        for a, b in ((0, 1), (1, 2), (2, 0)):
            n = normals[:, a] + normals[:, b]
            n /= np.linalg.norm(n, axis=1)[:, None]
            ends = corners[:, [a, b]]
            both = closed[ends].all(axis=1)
            along = [np.einsum("fi,fi->f", f[ends].mean(axis=1), n) for f in (φ, q)]
            amount += np.where(both, along[0] * along[1], 0.0)
        amount *= facets.area / 3
        total += float(amount.sum())
        keys.append(np.sort(j.points.dof[corners], axis=1))
        amounts.append(amount)
    _share_out(problem, np.concatenate(keys), np.concatenate(amounts), cells)
    return total


def _share_out(problem: Problem, facets: Ints, amounts: Floats, cells: Floats) -> None:
    """Add half of the amount of each facet (f,), given by its nodes (f, 3), to either cell."""
    local = corner_dofs(problem, np.arange(len(cells)))
    numbers = problem.space.dofmap.index_map.local_to_global(local.ravel().astype(np.int32))
    numbers = numbers.reshape(local.shape)
    nodes = np.unique(facets)
    at = np.minimum(np.searchsorted(nodes, numbers), len(nodes) - 1)
    on: Bools = nodes[at] == numbers

    def key(corners: Ints) -> Ints:
        rows = np.sort(corners, axis=1)
        return np.asarray((rows[:, 0] * len(nodes) + rows[:, 1]) * len(nodes) + rows[:, 2])

    known = key(np.searchsorted(nodes, facets))
    order = np.argsort(known)
    for face in FACET_VERTICES:
        some = np.flatnonzero(on[:, face].all(axis=1))
        wanted = key(at[some][:, face])
        row = order[np.minimum(np.searchsorted(known[order], wanted), len(known) - 1)]
        cells[some] += np.where(known[row] == wanted, amounts[row] / 2, 0.0)


def to_divide(tagged: TaggedMesh, cells: Floats) -> list[list[float]]:
    """Centres [mm] of the cells that carry `SHARE` of the error, on rank 0; collective.

    The largest come first (Dörfler, A convergent adaptive algorithm, SINUM 33, 1996).
    """
    own = tagged.mesh.geometry.dofmap[: len(cells), :4]
    local = tagged.mesh.geometry.x[own].mean(axis=1), np.abs(cells)
    pieces = tagged.mesh.comm.gather(local)
    if pieces is None:
        return []
    x, size = (np.concatenate(part) for part in zip(*pieces, strict=True))
    rows = np.lexsort((*x.T, -size))
    sums = np.cumsum(size[rows])
    chosen = rows[: np.searchsorted(sums, SHARE * sums[-1]) + 1]
    found: list[list[float]] = x[chosen].tolist()
    return found


def write_map(path: Path, tagged: TaggedMesh, volumes: Floats, cells: Floats) -> None:
    """Write the error per volume of each cell as ``goal_error_density``; collective.

    Raises:
        OSError: The file cannot be written.
    """
    geometry = tagged.mesh.geometry
    nodes, index_map = geometry.dofmap[: len(cells)], geometry.index_map()
    quadratic = nodes.shape[1] > 4
    grid = GridFile(
        tagged.mesh.comm,
        path,
        geometry.x[: index_map.size_local],
        nodes[:, QUADRATIC_NODES] if quadratic else nodes,
        QUADRATIC_TETRAHEDRON if quadratic else TETRAHEDRON,
        {"region": cell_tags(tagged)[: len(cells)].astype(np.int32)},
        {"region_names": tuple(tagged.regions)},
        ghosts=index_map.ghosts,
    )
    grid.write(0.0, {}, {"goal_error_density": cells / volumes})
