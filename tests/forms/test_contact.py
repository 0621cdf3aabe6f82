"""The contact law of a point: UFL derives it from eq. 65; it must satisfy the contact conditions.

The numpy side of these tests follows from the conditions (distances to convex sets, Signorini,
Coulomb), not from the form.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import nnls
from ufl.algorithms import expand_derivatives, strip_variables
from ufl.core.expr import Expr

from app.foundation.arrays import Floats
from app.laws.contact_laws import Contact
from app.mechanics.contact_state import ContactState, LocalPoints
from app.mechanics.point_forces import PointForces
from app.mechanics.point_laws import PointLaws
from app.mechanics.switches import Switches
from app.numerics.pointwise import Pointwise
from app.system.timing import Timing
from forms.contact import OPEN, SLIP, STICK, augmented_lagrangian

ALL = [(faces, friction) for faces in (1, 2, 3) for friction in (False, True)]
KINDS = pytest.mark.parametrize(
    ("faces", "friction"),
    [pytest.param(m, k, id=f"{m} faces, {'friction' if k else 'smooth'}") for m, k in ALL],
)


@dataclass(frozen=True)
class Points:
    """Random contact points: n rows of arguments of the law."""

    F: Floats
    jump: Floats
    gap: Floats
    old: Floats
    normals: Floats
    μ: Floats
    r: Floats

    @property
    def S(self) -> Floats:
        """Trial force with the whole gap."""
        return self.F + self.r[:, None] * (self.jump + self.gap)

    @property
    def dS(self) -> Floats:
        """Trial force with the change of the jump, whose tangential part counts."""
        return self.F + self.r[:, None] * (self.jump - self.old)

    @property
    def faces(self) -> int:
        return self.normals.shape[1]


def sample(n: int, faces: int, seed: int = 1) -> Points:
    """Random points with a committed state that does not penetrate."""
    rng = np.random.default_rng(seed)
    normals = unit(rng.normal(size=(n, 1, 3)))
    while normals.shape[1] < faces:
        # Independent and more than 30 degrees apart, as faces are.
        new = unit(rng.normal(size=(150, 3)))
        rows = []
        for k in range(n):
            c = np.abs(new @ normals[k].T).max(axis=1)
            trial = np.concatenate([np.repeat(normals[k][None], len(new), 0), new[:, None]], axis=1)
            good = (c < 0.85) & (np.linalg.det(trial @ trial.transpose(0, 2, 1)) > 0.1)
            rows.append(new[rng.choice(np.flatnonzero(good))])
        normals = np.concatenate([normals, np.array(rows)[:, None]], axis=1)
    μ = rng.uniform(0.05, 1.5, n)
    r = 10 ** rng.uniform(0, 4, n)
    jump, old = rng.normal(size=(n, 3)), rng.normal(size=(n, 3))
    padded = np.zeros((n, 3, 3))
    padded[:, :faces] = normals
    # Gap vector such that the old state touches or is open on every face; often it touches.
    before = np.maximum(rng.normal(size=(n, faces)), 0)
    g = solve_gram(normals, before - np.einsum("nki,ni->nk", normals, old))
    F = rng.normal(size=(n, 3)) * r[:, None]
    return Points(F, jump, g, old, normals, μ, r)


def unit(v: Floats) -> Floats:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def solve_gram(normals: Floats, b: Floats) -> Floats:
    """The vector in the span of the normals with the given components along them."""
    gram = normals @ normals.transpose(0, 2, 1)
    return np.einsum("nk,nki->ni", np.linalg.solve(gram, b[:, :, None])[:, :, 0], normals)


def derived(p: Points, friction: bool, *wanted: str) -> list[Floats]:
    """Energy of a law at n points, or its derivative by F or D."""
    normals = {f"n{k}": p.normals[:, k] for k in range(p.faces)}
    values = {"F": p.F, "D": p.jump, "gap": p.gap, "old": p.old, "star": 0 * p.F, "r": p.r}
    values |= normals | {"μ": p.μ}

    def build(x: dict[str, Expr]) -> list[Expr]:
        F, D, gap, r = ufl.variable(x["F"]), ufl.variable(x["D"]), x["gap"], x["r"]
        μ = x["μ"] if friction else None
        energy = augmented_lagrangian(F, D, gap, x["old"], x["star"], [x[n] for n in normals], μ, r)
        derivatives = {"energy": energy, "F": ufl.diff(energy, F), "D": ufl.diff(energy, D)}
        # The starred force takes its value after all derivatives. Labels of variables would make
        # each compilation a new one.
        star = {x["star"]: F + r * (D + gap)}
        return [
            strip_variables(ufl.replace(expand_derivatives(derivatives[name]), star))
            for name in wanted
        ]

    sizes = {name: v.size // len(v) for name, v in values.items()}
    return Pointwise(MPI.COMM_SELF, len(p.μ), sizes, build)(**values)


def law_of(p: Points, friction: bool, prescribed: Floats | None = None) -> PointLaws:
    """The compiled law, as the application uses it, with tangential directions (n, 3, 3) held."""
    n = len(p.μ)
    normals = np.zeros((n, 3, 3))
    normals[:, : p.faces] = p.normals
    faces = np.full(n, p.faces)
    none, tensors = np.zeros((n, 3)), np.zeros((n, 3, 3))
    number, sides = np.arange(n), np.zeros((n, 2), dtype=np.int64)
    held = tensors if prescribed is None else prescribed
    local_points = LocalPoints(number, number, none, sides, faces, normals, np.ones(n), held, held)
    law = PointLaws(MPI.COMM_SELF, local_points, Timing())
    laws = [Contact(friction_coefficient=float(μ) * friction) for μ in p.μ]
    law.begin(laws, {"μ": p.μ * friction}, 1.0, tensors + np.eye(3))
    return law


def force_of(law: PointLaws, p: Points, F: Floats | None = None) -> PointForces:
    law.augmentation = p.r
    state = replace(ContactState.at_rest(len(p.gap), {}), jump=p.old)
    none = Switches.off(len(p.μ))
    return law.evaluate(p.F if F is None else F, p.jump, p.gap, state, none)


def dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.einsum("ni,ni->n", a, b))


@pytest.mark.parametrize("friction", [False, True], ids=["smooth", "friction"])
def test_contact_of_one_face_is_eq_65(friction: bool) -> None:
    """Π = F·D + r/2 |D|² - dist²(S_n, R_-)/2r - dist²(S_T, C(P_{R-} S_n*))/2r, and its gradients.

    D has the whole gap along the normal and the change of the jump across it. The gradients are
    those of E8: the projected force by D, (P(S) - F)/r by F.
    """
    p = sample(400, 1)
    energy, by_D, by_F = derived(p, friction, "energy", "D", "F")
    n = p.normals[:, 0]
    D_n = dot(p.jump + p.gap, n)
    change = p.jump - p.old
    D_T = change - dot(change, n)[:, None] * n
    D = D_n[:, None] * n + D_T
    S = p.F + p.r[:, None] * D
    S_n = dot(S, n)
    S_T = S - S_n[:, None] * n
    size = np.linalg.norm(S_T, axis=1)
    pressure = np.maximum(-S_n, 0)
    radius = p.μ * pressure if friction else np.zeros_like(pressure)
    dist_n = np.maximum(S_n, 0)
    dist_T = np.maximum(size - radius, 0)
    Π = dot(p.F, D) + (p.r * dot(D, D) - (dist_n**2 + dist_T**2) / p.r) / 2
    P = -pressure[:, None] * n + np.minimum(1, radius / size)[:, None] * S_T
    scale = np.linalg.norm(S, axis=1).max()
    np.testing.assert_allclose(energy, Π, rtol=1e-10, atol=1e-9 * np.abs(Π).max())
    assert np.abs(by_D - P).max() < 1e-11 * scale
    assert np.abs(p.r[:, None] * by_F - (P - p.F)).max() < 1e-11 * scale
    out = force_of(law_of(p, friction), p)
    assert np.abs(out.force - P).max() < 1e-11 * scale
    assert np.abs(out.pressures[:, 0] - pressure).max() < 1e-11 * scale
    state = np.where(pressure == 0, OPEN, np.where(size <= radius, STICK, SLIP))
    assert (out.status == state).all()


@KINDS
def test_contact_gradients_are_return_mapping_and_jump(faces: int, friction: bool) -> None:
    """For any number of faces ∂Π/∂D = P(S) and ∂Π/∂F = (P(S) - F)/r."""
    p = sample(300, faces, seed=2)
    by_D, by_F = derived(p, friction, "D", "F")
    P = force_of(law_of(p, friction), p).force
    scale = np.linalg.norm(p.S, axis=1).max()
    assert np.abs(by_D - P).max() < 1e-11 * scale
    assert np.abs(p.r[:, None] * by_F - (P - p.F)).max() < 1e-11 * scale


@pytest.mark.parametrize("faces", [1, 2, 3])
def test_contact_without_friction_projects_on_cone_of_normals(faces: int) -> None:
    """P(S) is the point nearest to S of the cone spanned by -n_k, and 2 r Π = |P(S)|² - |F|²."""
    p = sample(400, faces, seed=3)
    # Without friction no history: the whole gap counts in all directions.
    p = Points(p.F, p.jump, p.gap, -p.gap, p.normals, p.μ, p.r)
    P = force_of(law_of(p, False), p).force
    for k in range(len(p.μ)):
        a, _ = nnls(-p.normals[k].T, p.S[k])
        nearest = -a @ p.normals[k]
        assert np.abs(P[k] - nearest).max() < 1e-9 * np.abs(p.S[k]).max()
    (energy,) = derived(p, False, "energy")
    exact = (dot(P, P) - dot(p.F, p.F)) / (2 * p.r)
    np.testing.assert_allclose(energy, exact, rtol=1e-9, atol=1e-9 * np.abs(exact).max())


@KINDS
def test_contact_generalized_jacobian(faces: int, friction: bool) -> None:
    """Taylor's formula P(S + h δ) = P(S) + h P' δ + O(h²) holds if no state changes."""
    p = sample(600, faces, seed=4)
    law = law_of(p, friction)
    rng = np.random.default_rng(5)
    base = force_of(law, p)
    size = np.linalg.norm(p.S, axis=1)
    direction = unit(rng.normal(size=(len(size), 3))) * size[:, None]
    steps = [0.04, 0.02, 0.01]
    remainders = []
    smooth = np.ones(len(size), dtype=bool)
    for h in steps:
        after = force_of(law, p, p.F + h * direction)
        smooth &= (after.status == base.status) & (
            (after.pressures > 0) == (base.pressures > 0)
        ).all(axis=1)
        linear = np.einsum("nij,nj->ni", base.by_multiplier, h * direction)
        remainders.append(np.linalg.norm(after.force - base.force - linear, axis=1) / size)
    assert smooth.mean() > 0.5
    first, _, third = (r[smooth] for r in remainders)
    # Linear where the point is open, sticks or has no friction; quadratic where it slips.
    slips = (base.status[smooth] == SLIP) & friction
    assert (third[~slips] < 1e-10).all()
    if slips.any() and faces == 1:
        curved = slips & (third > 1e-7)
        assert curved.sum() > 20
        orders = np.log2(first[curved] / third[curved]) / 2
        assert np.median(orders) == pytest.approx(2, abs=0.1)
        assert orders.min() > 1.5
    # First-order errors would leave some per cent; the second-order remainder is bounded.
    assert np.quantile(third / 0.01, 0.9) < 0.05


@dataclass(frozen=True)
class Broken:
    """Violation of the conditions by F = P(S), D = (S - F)/r, over |S|.

    Attributes:
        always: What has to hold at every point.
        coulomb: What has to hold where friction acts in what the touching faces leave free.
        jammed: Points whose faces all touch, where friction carries what pressures cannot.
    """

    always: dict[str, Floats]
    coulomb: dict[str, Floats]
    jammed: NDArray[np.bool_]


def conditions(p: Points, friction: bool, out: PointForces) -> Broken:
    P, faces = out.force, p.faces
    size = np.linalg.norm(p.S, axis=1) + np.linalg.norm(p.dS, axis=1)
    gap = np.einsum("nki,ni->nk", p.normals, p.S - P)  # times r
    slip = p.dS - P  # times r
    pressure = out.pressures[:, :faces]
    T = P + np.einsum("nk,nki->ni", pressure, p.normals)
    touches = pressure > 1e-9 * size[:, None]
    # Motion and friction along what the touching faces leave free.
    free = np.array(
        [
            np.eye(3) - (np.linalg.pinv(n[t]) @ n[t] if t.any() else 0)
            for n, t in zip(p.normals, touches, strict=True)
        ]
    )
    along = np.einsum("nij,nj->ni", free, slip)
    into = np.linalg.norm(T - np.einsum("nij,nj->ni", free, T), axis=1)
    shear = np.linalg.norm(T, axis=1)
    closed = (np.abs(gap) < 1e-9 * size[:, None]).all(axis=1)
    alone = ~touches.any(axis=1) & (shear > 1e-9 * size)
    jammed = closed & ((into > 1e-9 * size) | alone)
    limit = (p.μ if friction else 0) * pressure.sum(axis=1)
    motion = np.linalg.norm(along, axis=1)
    # Friction is conjugate to the slip: it points along it, at the limit, wherever it moves.
    opposes = np.abs(T * motion[:, None] - limit[:, None] * along).max(axis=1) / size
    always = {
        "penetration": np.maximum(-gap, 0).max(axis=1),
        "tension": np.maximum(-pressure, 0).max(axis=1),
        "pressure across a gap": np.minimum(np.abs(pressure), np.abs(gap)).max(axis=1),
    }
    coulomb = {
        "force without pressure": np.where(touches.any(axis=1), 0, np.linalg.norm(P, axis=1)),
        "friction into a face": into,
        "friction beyond the cone": np.maximum(shear - limit, 0),
        "friction not against the slip": np.where(touches.any(axis=1), opposes, 0),
    }
    return Broken(
        {name: value / size for name, value in always.items()},
        {name: np.where(jammed, 0, value / size) for name, value in coulomb.items()},
        jammed,
    )


def within_the_friction_cones(force: Floats, normals: Floats, μ: float) -> bool:
    """Return True if a force is a sum of forces within the friction cones of the faces, to 1 %."""
    edges = []
    for n in normals:
        a = unit(np.cross(n, np.eye(3)[np.argmin(np.abs(n))]))
        b = np.cross(n, a)
        angles = np.linspace(0, 2 * np.pi, 48, endpoint=False)
        edges += [-n + μ * (np.cos(φ) * a + np.sin(φ) * b) for φ in angles]
    _, distance = nnls(np.array(edges).T, force)
    return bool(distance < 0.01 * np.linalg.norm(force))


@KINDS
def test_contact_satisfies_signorini_and_coulomb(faces: int, friction: bool) -> None:
    """For any S the pair F = P(S), D = (S - F)/r satisfies all conditions on all faces.

    On an edge there may be no such force while friction acts across the directions that the
    touching faces leave free. Then all faces hold the point, and friction acts between them.
    """
    p = sample(1500, faces, seed=6)
    out = force_of(law_of(p, friction), p)
    broken = conditions(p, friction, out)
    for name, value in (broken.always | broken.coulomb).items():
        worst = int(np.argmax(value))
        assert value[worst] < 1e-8, (name, (value > 1e-8).sum(), p.S[worst], p.normals[worst])
    jammed = broken.jammed
    if faces == 1 or not friction:
        assert not jammed.any()
    else:
        assert jammed.mean() < 0.15
        held = [
            within_the_friction_cones(out.force[k], p.normals[k], p.μ[k])
            for k in np.flatnonzero(jammed)
        ]
        assert np.mean(held) > 0.9
    touching = (out.pressures > 0).sum(axis=1)
    # All sets of faces occur, and all states.
    assert set(range(faces + 1)) == set(touching.tolist())
    if friction:
        assert (out.status == STICK).sum() > 30 and (out.status == SLIP).sum() > 30
    assert (out.status[(touching == 0) & ~jammed] == OPEN).all()


EDGE = sample(1, 2, seed=7)


def test_contact_along_a_prescribed_edge() -> None:
    """The force along an edge of two faces is the one that the law without supports returns.

    Where the set of touching faces changes, that force can jump, and no value may fit.
    """
    n = 20_000
    p = sample(n, 2, seed=3)
    edge = unit(np.cross(p.normals[:, 0], p.normals[:, 1]))
    along = edge[:, :, None] * edge[:, None, :]
    F = p.F - dot(p.F, edge)[:, None] * edge
    free, held = law_of(p, True), law_of(p, True, along)
    out = force_of(held, p, F)
    assert np.isfinite(out.force).all() and np.isfinite(out.by_multiplier).all()
    scale = np.linalg.norm(F, axis=1) + p.r * np.linalg.norm(p.jump + p.gap, axis=1)
    f = dot(out.force, edge)
    returned = force_of(free, p, F + f[:, None] * edge).force
    fits = np.linalg.norm(returned - out.force, axis=1) < 1e-10 * scale
    assert 0.99 < fits.mean() < 1.0

    slides = fits & (out.status == SLIP) & (dot(p.jump - p.old, edge) > 0)
    assert slides.mean() > 0.1
    change = 1e-7 * scale[:, None] * unit(np.cross(edge, F))
    shifted = [force_of(held, p, F + sign * change).force for sign in (1, -1)]
    differences = np.linalg.norm(
        shifted[0] - shifted[1] - 2 * np.einsum("nij,nj->ni", out.by_multiplier, change), axis=1
    )
    smooth = differences < 1e-4 * np.linalg.norm(2 * change, axis=1)
    assert smooth[slides].mean() > 0.98


@cache
def edge_law() -> PointLaws:
    return law_of(EDGE, True)


@given(
    st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=3),
    st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=3),
    st.floats(0, 2),
)
def test_contact_at_edge_points_for_any_force(
    F: list[float], slip: list[float], gap: float
) -> None:
    """The edge touched on one face and was open on the other. Any force acts on it."""
    n = EDGE.normals
    before = solve_gram(n, np.array([[0.0, gap]]))
    old = np.array([[0.3, -0.2, 0.1]])
    p = Points(np.array([F]), old + np.array([slip]), before - old, old, n, EDGE.μ, np.ones(1))
    size = np.linalg.norm(p.S) + np.linalg.norm(p.dS)
    if size < 1e-6:
        return
    broken = conditions(p, True, force_of(edge_law(), p))
    for name, value in (broken.always | broken.coulomb).items():
        assert value[0] < 1e-8, name
