r"""Unilateral contact with Coulomb friction at a point of an interface.

`contact_law` is the one formula of Coulomb's law in the program. `app.mechanics.point_laws`
evaluates it, `prescribed_slip` along jumps that supports prescribe, `debonded_contact` on the
debonded share of a cohesive interface, `switches` under given pressures.

Equations 57 and 63 to 65 are those of the paper, Ramaniraka and others (docs/theory.md).

A contact point has the gap vector G [mm], the jump (slave minus master) plus the initial gap, and
the interface force per area F [MPa]. The normal n points from the master to the slave:
G_n = G . n >= 0 is the opening and F_n = F . n <= 0 the contact force. Friction is incremental. So
the law takes ΔG, D in the paper: its normal part is that of G, and its tangential part is the
change of the jump since the last converged state. λ is the multiplier; without a layer in series it
is F. With the augmentation r [MPa/mm] and the trial force S = λ + r ΔG, the augmented Lagrangian
per area is

.. math:: Π = λ·ΔG + \tfrac r2 |ΔG|^2 - \tfrac1{2r} dist^2(S_n, R_-)
              - \tfrac1{2r} dist^2(S_T, disc(μ p^*)), \qquad p = -\min(S_n, 0),

with disc(R) the disc of radius R. A star marks an argument that is not differentiated. This is
eq. 65, which prints R_+ under the first distance; eq. 68 prints it correctly.

Completing the square gives, while the point touches,

.. math:: 2 r Π = S_n^2 + |S_T|^2 - dist^2(S_T, disc(μ p^*)) - |λ|^2,

and 2 r Π = -|λ|^2 while it is open. The code below uses this form. ∂Π/∂ΔG is the projected force
P(S), and the law is F = P(S). The generalized Jacobian is the derivative of P, with respect to the
starred argument too.

A point on an edge of an interface has up to three faces, each with its normal, but one jump and one
force. The normal direction is then the span of the normals of the touching faces. Friction acts in
the orthogonal complement: along the edge if two faces touch, not at all if three touch.

A set of faces is admissible if their pressures and the gaps of the other faces are not negative.
The admissible set touches. At an edge it can happen that no set is admissible, since friction on
one face balances pressure on another. Then all faces count as closed: nothing penetrates, and
friction carries the part that pressures cannot.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from dataclasses import replace as replace_state
from functools import partial, reduce
from itertools import combinations

from ufl import (
    And,
    Coefficient,
    as_ufl,
    as_vector,
    conditional,
    diff,
    dot,
    ge,
    inner,
    le,
    max_value,
    replace,
    sqrt,
    variable,
)
from ufl.algorithms import expand_derivatives
from ufl.core.expr import Expr
from ufl.variable import Variable

from forms import Scalar

# A face may overlap by this fraction of |S|/r and still count as open [-]. Rounding errors then do
# not decide.
ROUNDING = 1e-9
# The tangential trial force may exceed the limit of friction by this fraction, and the point still
# has the status STICK [-]. Rounding errors then do not decide while loads are constant.
LIMIT_ROUNDING = 1e-6

# Status of a point without contact.
OPEN = 0
# Status of a point in contact whose friction is below its limit.
STICK = 1
# Status of a point in contact whose friction is at its limit.
SLIP = 2

# Factor that makes an expression of a number.
_ONE = as_ufl(1.0)


class Faces(tuple[Expr, ...]):
    """Unit normals of the faces of a point, from master to slave, each (3,).

    Attributes:
        duals: Dual vectors of the normals, each (3,). Their products with a vector are the
            components of the vector along the normals.
    """

    duals: tuple[Expr, ...]

    @classmethod
    def of(cls, normals: Sequence[Expr], duals: Sequence[Expr]) -> Faces:
        """Make the faces of a point from normals and their duals."""
        faces = cls(normals)
        faces.duals = tuple(duals)
        return faces

    def components(self, vector: Expr) -> list[Expr]:
        """Coefficients of the projection of a vector on the span of the normals."""
        return [dot(vector, dual) for dual in self.duals]

    def span(self, a: Sequence[Scalar]) -> Expr:
        """Sum of a_k n_k over the faces."""
        return _combine(a, range(len(self)), self)


@dataclass(frozen=True)
class Response:
    """Response of a law at a point.

    Attributes:
        force: Interface force per area (3,), of contact P(S) [MPa].
        by_multiplier: Generalized derivative of the force with respect to the multiplier (3, 3)
            [-]; None if the law has no multiplier.
        by_jump: Generalized derivative of the force with respect to the jump (3, 3) [MPa/mm]. None
            if the force is a function of the trial force S: it is then r times `by_multiplier`.
        pressures: Pressure of each face, positive in compression [MPa].
        status: OPEN, STICK or SLIP, as a number.
        internal_variables: Internal variables after a converged step, by name.
        slip: Slip (3,) [mm], as `app.mechanics.contact.TrialState.slip` defines it. None for laws
            without slip and for contact, whose slip that method computes.
        stored: Stored energy per area [N/mm]; None if there is none.
        dissipated: Energy per area that a step dissipates [N/mm]. None for contact, where friction
            dissipates, and for laws without dissipation.
        dissipated_by_jump: Derivative of `dissipated` with respect to the jump (3,) [MPa], for laws
            that `fracture_step` controls; None for others.
        debonded_share: Debonded share of the area, on which contact acts [-]; None if there is
            none.
        debonded_share_by_jump: Its derivative with respect to the jump (3,) [1/mm].
    """

    force: Expr
    by_multiplier: Expr | None
    by_jump: Expr | None
    pressures: Expr
    status: Expr
    internal_variables: Mapping[str, Expr] = field(default_factory=dict)
    slip: Expr | None = None
    stored: Expr | None = None
    dissipated: Expr | None = None
    dissipated_by_jump: Expr | None = None
    debonded_share: Expr | None = None
    debonded_share_by_jump: Expr | None = None


@dataclass(frozen=True)
class _Touching:
    """State of a point while a given set of its faces touches; open if the set is empty.

    Attributes:
        faces: Indices of the touching faces.
        pressures: Pressures of these faces [MPa].
        tangential: Trial force tangential to these faces (3,) [MPa].
        radius: Radius of the friction disc [MPa]; None without friction.
        sticks: Condition of stick; None without friction.
        condition: Condition that this set of faces touches; None if it always holds.
    """

    faces: tuple[int, ...]
    pressures: list[Expr]
    tangential: Expr
    radius: Scalar
    sticks: Expr | None
    condition: Expr | None

    def pressure(self, face: int) -> Expr:
        """Pressure of a face, zero where it is open [MPa]."""
        return self.pressures[self.faces.index(face)] if face in self.faces else 0 * _ONE

    def status(self) -> Expr:
        """OPEN, STICK or SLIP. Three touching faces stick; without friction all others slip."""
        if not self.faces:
            return OPEN * _ONE
        if len(self.faces) == 3:
            return STICK * _ONE
        if self.sticks is None:
            return SLIP * _ONE
        limit = (1 + LIMIT_ROUNDING) * self.radius
        return conditional(le(inner(self.tangential, self.tangential), limit**2), STICK, SLIP)


def contact_law(
    λ: Expr,
    jump: Expr,
    initial_gap: Expr,
    jump_old: Expr,
    S_star: Coefficient,
    normals: Sequence[Expr],
    μ: Scalar | None,
    r: Scalar,
) -> Response:
    r"""Law of a contact point with one to three faces (eq. 65; eq. 57 with λ = 0).

    The derivative with respect to the jump is the projected force P(S). Faces touch if S presses
    them, and also at S = 0, where a point sticks. A law that is open at S = 0 would have no
    stiffness at rest, and bodies that nothing else holds would move away.

    Args:
        λ: Multiplier (3,) [MPa], from `ContactInterfaces.multiplier` of `mechanics.contact`. An
            elastic layer in series changes it; the penalty method is such a layer.
        jump: Displacement of the slave minus that of the master (3,) [mm].
        initial_gap: Vector g with g . n the initial gap of each face (3,) [mm]; an interference is
            negative.
        jump_old: Jump of the last converged state (3,) [mm].
        S_star: Stand-in for the frozen trial force (3,) [MPa].
        normals: Unit normals of the faces, from master to slave, each (3,).
        μ: Friction coefficient [-]; None leaves every tangential term out.
        r: Augmentation [MPa/mm].

    Returns:
        Force, its derivative by the multiplier, pressures and status.
    """
    multiplier = variable(λ)
    q = variable(jump)
    energy = augmented_lagrangian(multiplier, q, initial_gap, jump_old, S_star, normals, μ, r)
    S, dS = _trial_forces(multiplier, q, initial_gap, jump_old, r)
    force = replace(derivative(energy, q), {S_star: S})
    by_multiplier = derivative(force, multiplier)
    states = _states(S, dS, normals, μ)
    pressures, status = _pressures_and_status(states, len(normals))
    return Response(force, by_multiplier, None, pressures, status)


def augmented_lagrangian(
    λ: Expr,
    jump: Expr,
    initial_gap: Expr,
    jump_old: Expr,
    S_star: Coefficient,
    normals: Sequence[Expr],
    μ: Scalar | None,
    r: Scalar,
) -> Expr:
    """Augmented Lagrangian per area [N/mm], with S* still frozen; arguments as `contact_law`."""
    S, dS = _trial_forces(λ, jump, initial_gap, jump_old, r)
    states = _states(S, dS, normals, μ)
    # The same states with the frozen trial force in the radius of the friction disc.
    frozen_states = _states(S_star, dS, normals, μ)

    def carried_square(k: int) -> Expr:
        """Square of the part of S that the point carries in its state k [MPa^2]."""
        state = states[k]
        touching_normals = [normals[face] for face in state.faces]
        normal_part = _combine(components(S, touching_normals), state.faces, normals)
        friction_square = _square_in_disc(state, frozen_states[k].radius)
        return inner(normal_part, normal_part) + friction_square

    return (_choose(states, carried_square) - inner(λ, λ)) / (2 * r)


def _trial_forces(
    λ: Expr, jump: Expr, initial_gap: Expr, jump_old: Expr, r: Scalar
) -> tuple[Expr, Expr]:
    """Trial forces S, which has the normal part, and dS, which has the tangential one [MPa]."""
    return λ + r * (jump + initial_gap), λ + r * (jump - jump_old)


def _states(S: Expr, dS: Expr, normals: Sequence[Expr], μ: Scalar | None) -> list[_Touching]:
    """Possible states of a point in order of preference; the last has no condition.

    Single faces come first, so that friction belongs to one face.
    """
    states: list[_Touching] = []
    for set_size in range(1, len(normals) + 1):
        for touching_faces in combinations(range(len(normals)), set_size):
            states.append(_touching(touching_faces, S, dS, normals, μ))
    no_contact = _Touching((), [], 0 * S, None, None, None)
    if len(normals) == 1:
        return [*states, no_contact]
    all_open = reduce(And, [ge(dot(S, n), 0) for n in normals])
    # If no set satisfies its condition, all faces touch.
    all_touch = states[-1]
    pressures = [max_value(pressure, 0) for pressure in all_touch.pressures]
    radius, sticks = _friction(μ, pressures, all_touch.tangential)
    jammed = replace_state(
        all_touch, pressures=pressures, radius=radius, sticks=sticks, condition=None
    )
    return [*states, replace_state(no_contact, condition=all_open), jammed]


def derivative(value: Scalar, unknown: Variable) -> Expr:
    """Derivative with respect to a variable, expanded."""
    return expand_derivatives(diff(value, unknown))


def _pressures_and_status(states: Sequence[_Touching], face_count: int) -> tuple[Expr, Expr]:
    """Pressures of the faces and status of a point."""

    def pressure(face: int, k: int) -> Expr:
        return states[k].pressure(face)

    pressures = [_choose(states, partial(pressure, face)) for face in range(face_count)]
    return as_vector(pressures), _choose(states, lambda k: states[k].status())


def _choose(states: Sequence[_Touching], value: Callable[[int], Expr]) -> Expr:
    """Value of the first state whose condition holds; ``value`` is a function of its index."""
    chosen = value(len(states) - 1)
    for k in reversed(range(len(states) - 1)):
        chosen = conditional(states[k].condition, value(k), chosen)
    return chosen


def _touching(
    A: tuple[int, ...], S: Expr, dS: Expr, normals: Sequence[Expr], μ: Scalar | None
) -> _Touching:
    """Pressures, tangential force and validity of the set A of touching faces."""
    n = [normals[k] for k in A]
    p = [-a for a in components(S, n)]
    S_T = dS - _combine(components(dS, n), A, normals)
    radius, sticks = _friction(μ, p, S_T)
    condition = reduce(And, [ge(pressure, 0) for pressure in p])
    open_normals = [normal for k, normal in enumerate(normals) if k not in A]
    if open_normals:
        # r times the gap vector while A touches: the old gap without its part along the normals
        # of A, plus the slip.
        old_gap_force = S - dS
        gap_force = old_gap_force - _combine(components(old_gap_force, n), A, normals)
        if μ is None:
            gap_force = gap_force + S_T
        else:
            size = sqrt(conditional(sticks, 1, inner(S_T, S_T)))
            gap_force = gap_force + conditional(sticks, 0, 1 - radius / size) * S_T
        for normal in open_normals:
            is_open = ge(dot(gap_force, normal), -ROUNDING * sqrt(inner(S, S)))
            condition = And(condition, is_open)
    return _Touching(A, p, S_T, radius, sticks, condition)


def _friction(μ: Scalar | None, p: Sequence[Scalar], S_T: Scalar) -> tuple[Scalar, Scalar]:
    """Radius of the friction disc [MPa] and condition of stick; None without friction.

    `app.mechanics.debonded_contact` relies on a radius proportional to μ.
    """
    if μ is None:
        return None, None
    radius = μ * sum(p[1:], p[0])
    return radius, le(inner(S_T, S_T), radius**2)


def _square_in_disc(state: _Touching, radius: Scalar) -> Scalar:
    r"""Square :math:`|S_T|^2 - dist^2(S_T, disc)` [MPa^2]; zero without friction (a point)."""
    if state.sticks is None:
        return 0 * _ONE
    square = inner(state.tangential, state.tangential)
    size = sqrt(conditional(state.sticks, 1, square))
    return conditional(state.sticks, square, 2 * radius * size - radius**2)


def components(S: Expr, normals: Sequence[Expr]) -> list[Scalar]:
    """Coefficients a of the projection of S on the span of the normals (Cramer's rule)."""
    b = [dot(S, n) for n in normals]
    if len(b) < 2:
        return b
    gram = [[dot(n, m) for m in normals] for n in normals]
    determinant = _determinant(gram)
    coefficients: list[Scalar] = []
    for column in range(len(b)):
        replaced = [row.copy() for row in gram]
        for row, product in zip(replaced, b, strict=True):
            row[column] = product
        coefficients.append(_determinant(replaced) / determinant)
    return coefficients


def _determinant(matrix: list[list[Scalar]]) -> Scalar:
    """Determinant of a 2 x 2 or 3 x 3 array of scalars."""
    if len(matrix) == 2:
        return matrix[0][0] * matrix[1][1] - matrix[0][1] * matrix[1][0]
    a, b, c = matrix
    return (
        a[0] * (b[1] * c[2] - b[2] * c[1])
        + a[1] * (b[2] * c[0] - b[0] * c[2])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
    )


def _combine(a: Sequence[Scalar], faces: Sequence[int], normals: Sequence[Expr]) -> Expr:
    """Sum of a_k n_k over faces; ``a`` has one coefficient for each of them."""
    return sum((a_k * normals[k] for a_k, k in zip(a, faces, strict=True)), 0 * normals[0])
