r"""Formulation B: frictional contact with a submesh per body and a multiplier field (tests only).

An implementation that shares no equation with the application. Every body has its displacement
space on a separate submesh. Every interface has a multiplier on the submesh of its facets. All are
unknowns of one monolithic Newton method with a direct solver. It reads the same configuration and
the same mesh, in series, on small cases; first order, isotropic bodies, contact on every interface.

D is u_slave - u_master, and n is the averaged nodal normal from master to slave. S is lambda + r D,
with the gap added in the normal direction and the last converged D subtracted in the tangential
plane. With

.. math:: P(S) = min(S_n, 0) n + \min(1, -μ \min(S_n, 0) / |S_T|) S_T,

the residuals are, for the displacements v and the multipliers m,

.. math:: \sum_b \int σ(u_b) : ε(v_b) - f(v_b) + \int P(S) \cdot (v_s - v_m) = 0, \qquad
          \int (P(S) - λ) \cdot m = 0,

the interface integrals by the vertex rule.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.fem import IntegralType
from dolfinx.mesh import entities_to_geometry
from numpy.typing import NDArray
from scipy.sparse import block_array, csc_array, csr_array, diags_array
from scipy.sparse.linalg import splu
from ufl.algorithms import expand_derivatives

from app.case.case import Case
from app.case.geometries import Cylinders
from app.foundation.arrays import Floats, Ints
from app.foundation.dolfinx_features import (
    entity_maps,
    exterior_facet_entities,
    facet_domain,
    submesh,
)
from app.laws.contact_laws import Contact
from app.laws.loads import BodyForce, Force, Pressure
from app.laws.materials import Isotropic
from app.laws.supports import Displacement, Fixed, Roller
from app.schema.expressions import values_at_points
from meshes.distribute import TaggedMesh

VERTEX_RULE = {"quadrature_rule": "vertex", "quadrature_degree": 1}
TOLERANCE = 1e-11
MAX_ITERATIONS = 60
SMALLEST_STEP = 1 / 64


@dataclass(frozen=True)
class InterfaceState:
    """An interface after a converged step, one row per vertex.

    Attributes:
        vertex: Vertex number of the mesh file (n,).
        normal: From master to slave (n, 3).
        area: Area of the vertex (n,) [mm2].
        jump: Displacement of the slave minus that of the master (n, 3) [mm].
        slip: Tangential jump of this step alone (n, 3) [mm].
        force: Multiplier: force per area conjugate to the jump (n, 3) [MPa].
    """

    vertex: Ints
    normal: Floats
    area: Floats
    jump: Floats
    slip: Floats
    force: Floats


@dataclass(frozen=True)
class State:
    """A converged step.

    Attributes:
        interfaces: State of each interface.
        displacement: For each body, vertex numbers (n,) and displacements (n, 3) [mm].
    """

    interfaces: dict[str, InterfaceState]
    displacement: dict[str, tuple[Ints, Floats]]


@dataclass(frozen=True)
class Part:
    """A submesh (a body or an interface), its space and unknown.

    Attributes:
        u: The unknown: displacement or multiplier.
        to_parent: Parent cell or facet of each of its cells.
        map: Its cell for each parent cell or facet, else -1.
        cell_map: The same as DOLFINx returns it.
        dof_of_node: Blocked dof at each node of the parent's geometry, else -1.
        vertex: Vertex number of the mesh file at each blocked dof.
    """

    u: fem.Function
    to_parent: NDArray[np.int32]
    map: NDArray[np.int32]
    cell_map: Any
    dof_of_node: NDArray[np.int32]
    vertex: Ints


class Interface:
    """A contact interface: names of its sides, its multiplier and its data at nodes.

    Attributes:
        master: Body whose side is '+' in the interface integrals: the stiffer one.
        slave: Body whose side is '-'.
        part: Facet submesh and multiplier.
        dofs: Blocked dofs of master and slave at its dofs (2, n).
        entities: Integration entities, the master's cell first.
        normal: Averaged nodal normal from master to slave.
        area: Area of each node (n,).
        free: 1 in components that can jump, 0 where supports hold both sides.
        gap: Current initial gap, negative where the bodies interfere.
        full_gap: The same at full amplitude.
        old: Jump of the last converged state.
        r: Augmentation parameter.
        friction: Friction coefficient.
        history: Amplitudes of the gap at the ends of the stages.
    """

    def __init__(self, case: Case, tagged: TaggedMesh, bodies: dict[str, Part], name: str) -> None:
        mesh, law = tagged.mesh, case.interfaces[name]
        assert isinstance(law, Contact)
        self.name, self.history = name, law.gap_history
        modulus = {r: _isotropic(case, r)[0] for side in tagged.interfaces[name] for r in side}
        self.master, self.slave = sorted(modulus, key=lambda r: -modulus[r])
        tags = tagged.cell_tags.values
        assert np.array_equal(tagged.cell_tags.indices, np.arange(len(tags)))
        cells_of = mesh.topology.connectivity(2, 3)
        wanted = sorted(tagged.regions[r] for r in modulus)
        facets = [
            f
            for f in range(mesh.topology.index_map(2).size_local)
            if sorted(tags[cells_of.links(f)]) == wanted
        ]
        part = self.part = _part(tagged, 2, np.array(facets, dtype=np.int32), name)
        self.entities = np.array(
            facet_domain(IntegralType.interior_facet, mesh.topology, part.to_parent)
        ).reshape(-1, 4)
        turned = tags[self.entities[:, 0]] != tagged.regions[self.master]
        self.entities[turned] = self.entities[turned][:, [2, 3, 0, 1]]
        # DOLFINx 0.9 maps both sides of a facet for every form on it, so each body's map must hold
        # some valid cell for the cells across; what is computed there is multiplied by nothing.
        plus, minus = self.entities[:, 0], self.entities[:, 2]
        m, s = bodies[self.master], bodies[self.slave]
        m.map[minus], s.map[plus] = m.map[plus], s.map[minus]
        nodes = np.flatnonzero(part.dof_of_node >= 0)
        nodes = nodes[np.argsort(part.dof_of_node[nodes])]
        self.dofs = np.stack([m.dof_of_node[nodes], s.dof_of_node[nodes]])
        space = part.u.function_space
        surface = space.mesh
        x = surface.geometry.x[surface.geometry.dofmap]
        edge = np.linalg.norm(x - x[:, [1, 2, 0]], axis=2).mean()
        self.normal, self.area = _nodal_normal(tagged, part, self.entities)
        if isinstance(case.geometry, Cylinders):
            _put_normals_of_cones(self.normal, case.geometry.taper)
        self.free, self.old = fem.Function(space), fem.Function(space)
        self.free.x.array[:] = 1
        self.gap = fem.Function(fem.functionspace(surface, ("Lagrange", 1)))
        at = self.gap.function_space.tabulate_dof_coordinates()
        gap = values_at_points(law.gap, at) if isinstance(law.gap, str) else law.gap
        self.full_gap: Floats = np.broadcast_to(gap, len(at))
        r = 0.3 * modulus[self.slave] / edge
        self.r = fem.Constant(mesh, default_scalar_type(r))
        self.friction = fem.Constant(mesh, default_scalar_type(law.friction_coefficient))


def solve(case: Case, tagged: TaggedMesh, times: Sequence[float]) -> list[State]:
    """Solve the case at each of the given times, one Newton solve each.

    Args:
        case: Isotropic bodies, each region one; contact on every interface.
        tagged: Its mesh, on one rank.
        times: Stage k runs from k to k + 1.

    Raises:
        RuntimeError: Newton does not converge.
    """
    assert tagged.mesh.comm.size == 1 and case.mesh.order == 1
    cells = {name: tagged.cell_tags.find(tagged.regions[name]) for name in case.regions}
    bodies = {name: _part(tagged, 3, of_body, name) for name, of_body in cells.items()}
    interfaces = [Interface(case, tagged, bodies, name) for name in case.interfaces]
    assert len(interfaces) == len(tagged.interfaces)
    amplitudes: list[tuple[fem.Constant, tuple[float, ...] | None]] = []
    residual = _residual(case, tagged, bodies, interfaces, amplitudes)
    parts = [*bodies.values(), *(i.part for i in interfaces)]
    newton = _Newton(tagged, parts, residual)
    held = _supports(case, tagged, bodies)
    both_held = [_held_on_both_sides(i, bodies, held) for i in interfaces]
    for i, rows in zip(interfaces, both_held, strict=True):
        i.free.x.array[rows] = 0
        # No normal in these components; none at all where nothing is left.
        n = i.normal.x.array.reshape(-1, 3)
        n.ravel()[rows] = 0
        size = np.linalg.norm(n, axis=1, keepdims=True)
        n /= np.where(size > 0, size, 1)
    states = []
    for time in times:
        for constant, history in amplitudes:
            constant.value = _amplitude(history, time)
        for i in interfaces:
            grown = i.full_gap * _amplitude(i.history, time)
            clear = (i.full_gap > 0) & (i.history is None)
            i.gap.x.array[:] = np.where(clear, i.full_gap, grown)
        # The application's rule: no force in components that supports hold on both sides.
        newton.solve(
            [
                *({d: v * _amplitude(h, time) for d, (v, h) in b.items()} for b in held),
                *(dict.fromkeys(rows, 0.0) for rows in both_held),
            ]
        )
        states.append(_state(bodies, interfaces))
        for i in interfaces:
            i.old.x.array[:] = _jump(i, bodies).ravel()
    return states


def _amplitude(history: tuple[float, ...] | None, time: float) -> float:
    """Multiplier at a time: it goes from 0 linearly to each stage's end value; 1 by default."""
    values = (0.0, *(history or (1.0,)))
    k = min(int(time), len(values) - 2) if history else 0
    s = min(time - k, 1.0)
    return (1 - s) * values[k] + s * values[k + 1]


def _isotropic(case: Case, region: str) -> tuple[float, float]:
    """Young's modulus [MPa] and Poisson's ratio of a region."""
    material = case.regions[region]
    assert isinstance(material, Isotropic) and not material.eigenstrains
    return material.youngs_modulus, material.poisson_ratio


# Submeshes


def _part(tagged: TaggedMesh, dim: int, entities: NDArray[np.int32], name: str) -> Part:
    mesh = tagged.mesh
    part, cell_map, to_parent, nodes = submesh(mesh, dim, entities)
    space = fem.functionspace(part, ("Lagrange", 1, (3,)))
    index_map = mesh.topology.index_map(dim)
    inverse = np.full(index_map.size_local + index_map.num_ghosts, -1, dtype=np.int32)
    inverse[to_parent] = np.arange(len(to_parent), dtype=np.int32)
    dof_of_node = np.full(len(mesh.geometry.x), -1, dtype=np.int32)
    dof_of_node[np.asarray(nodes)[part.geometry.dofmap]] = space.dofmap.list
    vertex = np.zeros(space.dofmap.index_map.size_local, dtype=np.int64)
    on = dof_of_node >= 0
    vertex[dof_of_node[on]] = np.asarray(mesh.geometry.input_global_indices)[on]
    u = fem.Function(space, name=name)
    return Part(u, to_parent, inverse, cell_map, dof_of_node, vertex)


def _entity_maps(parts: Sequence[Part]) -> Any:
    return entity_maps([(p.u.function_space.mesh, p.cell_map, p.map) for p in parts])


def _vertex_rule(tagged: TaggedMesh, entities: Sequence[NDArray[np.int32]]) -> Any:
    """Vertex rule over lists of interior facets numbered from 0, '+' the first cell of each."""
    data = [(k, e.ravel()) for k, e in enumerate(entities)]
    return ufl.Measure("dS", domain=tagged.mesh, subdomain_data=data, metadata=VERTEX_RULE)


def _nodal_normal(
    tagged: TaggedMesh, part: Part, entities: NDArray[np.int32]
) -> tuple[fem.Function, Floats]:
    """The master's facet normal averaged to the nodes, and their areas, by the vertex rule."""
    space = part.u.function_space
    m = ufl.TestFunction(space)
    dS = _vertex_rule(tagged, [entities])(0)

    def assemble(form: Any) -> Floats:
        compiled = fem.form(form, entity_maps=_entity_maps([part]))
        values = fem.assemble_vector(compiled)  # which its array does not keep alive
        return np.array(values.array).reshape(-1, 3)

    b = assemble(ufl.inner(ufl.FacetNormal(tagged.mesh)("+"), m("+")) * dS)
    normal = fem.Function(space)
    normal.x.array[:] = (b / np.linalg.norm(b, axis=1, keepdims=True)).ravel()
    return normal, assemble(m[0]("+") * dS)[:, 0]


def _put_normals_of_cones(normal: fem.Function, taper: float) -> None:
    """Replace mean normals by those of cones about the z axis, narrower at z = 0, by formula."""
    n = normal.x.array.reshape(-1, 3)
    x = normal.function_space.tabulate_dof_coordinates()
    radial = x[:, :2] / np.linalg.norm(x[:, :2], axis=1, keepdims=True)
    exact = np.column_stack([np.cos(taper) * radial, np.full(len(x), -np.sin(taper))])
    n[:] = exact * np.sign(np.sum(exact * n, axis=1, keepdims=True))


# Supports


Held = dict[int, tuple[float, tuple[float, ...] | None]]


def _supports(case: Case, tagged: TaggedMesh, bodies: dict[str, Part]) -> list[Held]:
    """For each body: unrolled dof -> (value at full amplitude, history)."""
    held: list[Held] = [{} for _ in bodies]
    for support in case.supports.values():
        match support:
            case Fixed():
                values: dict[int, float] = {0: 0.0, 1: 0.0, 2: 0.0}
                history = None
            case Roller():
                values, history = {"xyz".index(support.axis): 0.0}, None
            case Displacement():
                given = (support.x, support.y, support.z)
                values = {c: v for c, v in enumerate(given) if isinstance(v, float)}
                history = support.history
            case _:
                raise NotImplementedError(support.kind)
        for part, dofs in zip(bodies.values(), held, strict=True):
            nodes = _boundary_nodes(tagged, part, support.boundary)
            for c, value in values.items():
                for dof in part.dof_of_node[nodes]:
                    dofs[3 * int(dof) + c] = (value, history)
    return held


def _boundary_facets(tagged: TaggedMesh, part: Part, boundary: str) -> NDArray[np.int32]:
    """Facets of a boundary whose cell belongs to a body."""
    mesh = tagged.mesh
    facets = np.concatenate([tagged.facet_tags.find(t) for t in tagged.boundaries[boundary]])
    cells_of = mesh.topology.connectivity(2, 3)
    in_body = np.isin([cells_of.links(f)[0] for f in facets], part.to_parent)
    return facets[in_body].astype(np.int32)


def _boundary_nodes(tagged: TaggedMesh, part: Part, boundary: str) -> Ints:
    facets = _boundary_facets(tagged, part, boundary)
    if not len(facets):  # entities_to_geometry divides by their number
        return np.zeros(0, dtype=np.int64)
    return np.unique(entities_to_geometry(tagged.mesh, 2, facets))


def _held_on_both_sides(
    interface: Interface, bodies: dict[str, Part], held: list[Held]
) -> list[int]:
    """Unrolled dofs of the multiplier in whose component supports hold both sides."""
    of_body = dict(zip(bodies, held, strict=True))
    m, s = of_body[interface.master], of_body[interface.slave]
    return [
        3 * k + c
        for k, (on_m, on_s) in enumerate(interface.dofs.T)
        for c in range(3)
        if 3 * on_m + c in m and 3 * on_s + c in s
    ]


# Forms


def _residual(
    case: Case,
    tagged: TaggedMesh,
    bodies: dict[str, Part],
    interfaces: list[Interface],
    amplitudes: list[tuple[fem.Constant, tuple[float, ...] | None]],
) -> Any:
    """The residual over the mixed space; the amplitudes of the loads are appended to a list."""
    mesh = tagged.mesh
    parts = [*bodies.values(), *(i.part for i in interfaces)]
    tests = ufl.TestFunctions(ufl.MixedFunctionSpace(*(p.u.function_space for p in parts)))
    v = dict(zip(bodies, tests, strict=False))
    dx = ufl.Measure(
        "dx",
        domain=mesh,
        subdomain_data=[(tagged.regions[name], part.to_parent) for name, part in bodies.items()],
    )
    F: Any = 0
    for name, part in bodies.items():
        E, ν = _isotropic(case, name)
        μ = fem.Constant(mesh, default_scalar_type(E / (2 * (1 + ν))))
        λ = fem.Constant(mesh, default_scalar_type(E * ν / ((1 + ν) * (1 - 2 * ν))))
        ε = ufl.sym(ufl.grad(part.u))
        σ = 2 * μ * ε + λ * ufl.tr(ε) * ufl.Identity(3)
        F += ufl.inner(σ, ufl.sym(ufl.grad(v[name]))) * dx(tagged.regions[name])
    ds, patches = _patches(case, tagged, bodies)
    for key, load in case.loads.items():
        a = fem.Constant(mesh, default_scalar_type(0))
        amplitudes.append((a, load.history))
        assert not isinstance(load, BodyForce)
        t = _traction(tagged, load, [ds(k) for k in patches[key].values()])
        for name, k in patches[key].items():
            F -= a * ufl.inner(t, v[name]) * ds(k)
    dS = _vertex_rule(tagged, [i.entities for i in interfaces])
    for k, (i, m) in enumerate(zip(interfaces, tests[len(bodies) :], strict=True)):
        u_m, u_s, λ_i = bodies[i.master].u, bodies[i.slave].u, i.part.u
        n, free = i.normal("+"), i.free("+")
        D, D_old = (
            ufl.as_vector([free[c] * d[c] for c in range(3)])
            for d in (u_s("-") - u_m("+"), i.old("+"))
        )
        S = λ_i("+") + i.r * D
        S_n = ufl.inner(S, n) + i.r * i.gap("+")
        S_T = S - i.r * D_old
        S_T = S_T - ufl.inner(S_T, n) * n
        P = _projected(S_n, S_T, i.friction, n)
        F += ufl.inner(P, v[i.slave]("-") - v[i.master]("+")) * dS(k)
        F += ufl.inner(P - λ_i("+"), m("+")) * dS(k)
    return F


def _projected(S_n: Any, S_T: Any, μ: Any, n: Any) -> Any:
    """The trial force on the cone of Coulomb: half line and disc.

    Equalities belong to contact and stick, so that the first iterate from zero is the tied state.
    """
    p = ufl.conditional(ufl.le(S_n, 0), -S_n, 0)
    square = ufl.inner(S_T, S_T)
    inside = ufl.le(square, (μ * p) ** 2)
    size = ufl.sqrt(ufl.conditional(inside, 1, square))
    return ufl.conditional(inside, 1, μ * p / size) * S_T - p * n


def _patches(
    case: Case, tagged: TaggedMesh, bodies: dict[str, Part]
) -> tuple[Any, dict[str, dict[str, int]]]:
    """Surface measure, and for each load the bodies it acts on with their subdomain number."""
    data: list[tuple[int, NDArray[np.int32]]] = []
    patches: dict[str, dict[str, int]] = {}
    for key, load in case.loads.items():
        assert not isinstance(load, BodyForce)
        patches[key] = {}
        for name, part in bodies.items():
            facets = _boundary_facets(tagged, part, load.boundary)
            if len(facets):
                patches[key][name] = len(data)
                data.append((len(data), exterior_facet_entities(tagged.mesh.topology, facets)))
    return ufl.Measure("ds", domain=tagged.mesh, subdomain_data=data), patches


def _traction(tagged: TaggedMesh, load: Force | Pressure, patches: list[Any]) -> Any:
    """Traction of a load at full amplitude on its patches [MPa]."""
    match load:
        case Force(at=None):
            one = fem.Constant(tagged.mesh, default_scalar_type(1))
            area = sum(float(fem.assemble_scalar(fem.form(one * ds))) for ds in patches)
            return fem.Constant(tagged.mesh, np.array(load.force) / area)
        case Pressure():
            p = fem.Constant(tagged.mesh, default_scalar_type(load.pressure))
            return -p * ufl.FacetNormal(tagged.mesh)
        case _:
            raise NotImplementedError(load.kind)


# Newton


class _Newton:
    """Generalized Newton method on all blocks at once, halving steps that do not reduce."""

    def __init__(self, tagged: TaggedMesh, parts: list[Part], residual: Any) -> None:
        self._parts = parts
        spaces = [p.u.function_space for p in parts]
        maps = _entity_maps(parts)
        rows = ufl.extract_blocks(residual)
        trials = ufl.TrialFunctions(ufl.MixedFunctionSpace(*spaces))
        jacobian = [
            [
                None if (J := expand_derivatives(ufl.derivative(row, p.u, w))).empty() else J
                for p, w in zip(parts, trials, strict=True)
            ]
            for row in rows
        ]
        self._F = fem.form(rows, entity_maps=maps)
        self._J = fem.form(jacobian, entity_maps=maps)
        self._ends = np.cumsum([0, *(len(p.u.x.array) for p in parts)])

    def _set(self, x: Floats) -> None:
        for p, a, b in zip(self._parts, self._ends, self._ends[1:], strict=False):
            p.u.x.array[:] = x[a:b]

    def _evaluate(self, fixed: Ints) -> Floats:
        rows = [fem.assemble_vector(row) for row in self._F]
        f = np.concatenate([row.array for row in rows])
        f[fixed] = 0
        return f

    def _step(self, f: Floats, fixed: Ints) -> Floats:
        """Newton's step at the current state, zero in the fixed dofs."""
        blocks = [[J and _matrix(J) for J in row] for row in self._J]
        free = np.ones(len(f))
        free[fixed] = 0
        jacobian = diags_array(free) @ block_array(blocks) + diags_array(1 - free)
        lu = splu(csc_array(jacobian))
        step = lu.solve(-f)
        return np.asarray(step - lu.solve(jacobian @ step + f))

    def solve(self, fixed: list[dict[int, float]]) -> None:
        """Solve with given values of some dofs of each block.

        Raises:
            RuntimeError: No convergence.
        """
        given = {
            start + dof: value
            for start, dofs in zip(self._ends, fixed, strict=False)
            for dof, value in dofs.items()
        }
        rows = np.array(sorted(given), dtype=np.int64)
        x = np.concatenate([p.u.x.array for p in self._parts])
        x[rows] = [given[k] for k in rows.tolist()]
        self._set(x)
        f = self._evaluate(rows)
        scale, history = 0.0, []
        for iteration in range(MAX_ITERATIONS):
            norm = float(np.linalg.norm(f))
            scale = max(scale, norm)
            history.append(norm)
            if norm <= TOLERANCE * scale and iteration:
                return
            step = self._step(f, rows)
            if not np.isfinite(step).all():
                break
            t = 1.0
            while True:
                self._set(x + t * step)
                f = self._evaluate(rows)
                if np.linalg.norm(f) < (1 - 1e-4 * t) * norm or t <= SMALLEST_STEP:
                    break
                t /= 2
            x = x + t * step
        raise RuntimeError(f"formulation B does not converge: {history}")


def _matrix(form: fem.Form) -> csr_array:
    A = fem.assemble_matrix(form)
    A.scatter_reverse()
    return csr_array(A.to_scipy(), copy=True)


# Results


def _jump(i: Interface, bodies: dict[str, Part]) -> Floats:
    """Slave minus master at the dofs of the interface (n, 3)."""
    u_m, u_s = (bodies[name].u.x.array.reshape(-1, 3) for name in (i.master, i.slave))
    return u_s[i.dofs[1]] - u_m[i.dofs[0]]


def _state(bodies: dict[str, Part], interfaces: list[Interface]) -> State:
    result = {}
    for i in interfaces:
        jump, n = _jump(i, bodies), i.normal.x.array.reshape(-1, 3).copy()
        step = jump - i.old.x.array.reshape(-1, 3)
        slip = step - np.sum(step * n, axis=1, keepdims=True) * n
        force = i.part.u.x.array.reshape(-1, 3).copy()
        result[i.name] = InterfaceState(i.part.vertex, n, i.area, jump, slip, force)
    displacement = {
        name: (part.vertex, part.u.x.array.reshape(-1, 3).copy()) for name, part in bodies.items()
    }
    return State(result, displacement)
