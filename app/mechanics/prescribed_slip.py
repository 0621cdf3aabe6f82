r"""Contact force along jumps that supports prescribe, as functions of arrays.

Along a prescribed jump, equilibrium contains the support reaction. The interface force F_h there
follows from the law P alone:

.. math:: F_h = H P(λ + M F_h),

with λ the multiplier without F_h, H the projector on the prescribed directions and M the share of
the multiplier. Where the jump changes in the step, `respond` solves for F_h at each point. Where
the jump is at rest, F_h is the friction of the last converged state.

F_h is along the prescribed slip, so its size is one unknown per point. The residual H P - F_h is
>= 0 at F_h = 0 and < 0 at the upper bound, so between them it changes sign. Each iterate of
Newton's method replaces one of the bounds. Bisection replaces a Newton step if it leaves the bounds
or if the step before did not halve the residual.

At a point of one face the residual decreases and is concave on the side of the start, so that the
iterates approach the root from one side. They are slowest where the force across the slip equals
the limit of friction: a triple root, at which each iteration leaves 2/3 of the error. At an edge,
the set of touching faces can change with F_h. Where the force jumps across zero there, no root
exists, and the bounds close at the jump.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from app.foundation.arrays import Bools, Floats

# A prescribed slip below this fraction of the jumps counts as zero.
SLIP_ROUNDING = 1e-13
# A prescribed slip counts as zero, too, if r times the slip is below this fraction of the whole
# trial force. Errors of the friction would then exceed r times the slip and decide between stick
# and slip.
REST_TOLERANCE = 1e-11
# The force along a prescribed jump has converged within this fraction of the trial force.
FORCE_TOLERANCE = 1e-12
# Upper bound of that force over the trial force [-]: the larger of `LEAST_BOUND` and `BOUND_BY_μ`
# times μ. At an edge the pressures of the faces together may exceed the trial force.
LEAST_BOUND = 1e3
BOUND_BY_μ = 10.0

# Inputs and outputs of a law at n points, by name: (n, ...).
Inputs = Mapping[str, Floats]
Outputs = dict[str, Floats]
# A law at n points.
LawAtPoints = Callable[[Inputs], Outputs]


@dataclass(frozen=True)
class PrescribedSlip:
    """Prescribed slip of a step at n points.

    Attributes:
        is_sliding: True where the prescribed jump changes (n,).
        direction: Unit vector of the change (n, 3); not used where the jump is at rest.
        scale: Size of the trial force (n,) [MPa].
        last_friction: Last friction along the prescribed directions (n, 3) [MPa].
    """

    is_sliding: Bools
    direction: Floats
    scale: Floats
    last_friction: Floats

    @classmethod
    def of(cls, inputs: Inputs, H: Floats, last_friction: Floats) -> PrescribedSlip:
        """Return the prescribed slip between two states of points.

        Args:
            inputs: ``multiplier`` (n, 3) [MPa], ``jump``, ``jump_old`` of the last converged state
                and ``initial_gap`` (n, 3) [mm], and the augmentation ``r`` (n,) [MPa/mm].
            H: Projectors on the prescribed directions (n, 3, 3).
            last_friction: Friction in the last converged state (n, 3) [MPa].
        """
        jump, jump_old = inputs["jump"], inputs["jump_old"]
        slip = np.einsum("pij,pj->pi", H, jump - jump_old)
        size = np.linalg.norm(slip, axis=1)
        jump_sizes = np.linalg.norm(jump, axis=1) + np.linalg.norm(jump_old, axis=1)
        opening = np.linalg.norm(jump + inputs["initial_gap"], axis=1)
        scale = np.linalg.norm(inputs["multiplier"], axis=1) + inputs["r"] * opening
        is_sliding = size > SLIP_ROUNDING * jump_sizes
        is_sliding &= inputs["r"] * size > REST_TOLERANCE * scale
        return cls(
            is_sliding=is_sliding,
            direction=slip / np.where(is_sliding, size, 1.0)[:, None],
            scale=scale,
            last_friction=np.einsum("pij,pj->pi", H, last_friction),
        )


def respond(
    law: LawAtPoints,
    inputs: Inputs,
    H: Floats,
    M: Floats,
    last_friction: Floats,
    μ: Floats | float = 0.0,
) -> Outputs:
    """Return the outputs of a law, with its force along prescribed tangential jumps.

    Args:
        law: The law. Its outputs include ``force`` (n, 3) [MPa], and ``by_multiplier`` (n, 3, 3)
            or, if the force depends on the jump alone, ``by_jump`` (n, 3, 3).
        inputs: Inputs of the law, as in `PrescribedSlip.of`, without F_h in the multiplier.
        H: Projectors on the prescribed tangential directions (n, 3, 3).
        M: Share of the multiplier in the trial force (n, 3, 3) [-].
        last_friction: Friction in the last converged state (n, 3) [MPa].
        μ: Friction coefficients (n,) [-], for the upper bound of F_h.

    Returns:
        Outputs of the law. ``by_multiplier`` is the total derivative, with the change of F_h.
    """
    if not H.any():
        return law(inputs)
    slip = PrescribedSlip.of(inputs, H, last_friction)
    is_sliding, direction = slip.is_sliding, slip.direction
    n = len(is_sliding)
    bound = np.maximum(LEAST_BOUND, BOUND_BY_μ * μ)
    lower, upper = np.zeros(n), bound * slip.scale
    size, last_residual = upper.copy(), np.full(n, np.inf)
    # Rounding grows with the bound.
    tolerance = FORCE_TOLERANCE * slip.scale * (bound / LEAST_BOUND)

    def response_to(size: Floats) -> Outputs:
        """Return the outputs of the law for a size of F_h (n,) [MPa]."""
        F_h = np.where(is_sliding[:, None], size[:, None] * direction, slip.last_friction)
        multiplier = inputs["multiplier"] + np.einsum("pij,pj->pi", M, F_h)
        return law({**inputs, "multiplier": multiplier})

    response = response_to(size)
    if "by_jump" in response:
        # A traction that depends on the jump alone.
        return response
    while True:
        P_λ = response["by_multiplier"]
        residual = np.einsum("pi,pi->p", direction, response["force"]) - size
        slope = 1 - np.einsum("pi,pij,pjk,pk->p", direction, P_λ, M, direction)
        # A point that has converged stays: rounding could move it from slip to stick.
        is_unfinished = is_sliding & (np.abs(residual) > tolerance)
        is_unfinished &= upper - lower > tolerance
        if not is_unfinished.any():
            break
        np.copyto(lower, size, where=residual > 0)
        np.copyto(upper, size, where=residual < 0)
        # Without a positive slope the step is infinite, which leaves the bounds.
        step = np.divide(residual, slope, out=np.full(n, np.inf), where=slope > 0)
        is_within = (size + step >= lower) & (size + step <= upper)
        is_halved = np.abs(residual) <= last_residual / 2
        new_size = np.where(is_within & is_halved, size + step, (lower + upper) / 2)
        np.copyto(size, new_size, where=is_unfinished)
        last_residual = np.abs(residual)
        response = response_to(size)
    # Implicit derivative of F_h by the multiplier.
    factor = np.divide(1.0, slope, out=np.zeros(n), where=is_sliding & (slope != 0))
    F_h_by_λ = np.einsum("p,pi,pk,pkj->pij", factor, direction, direction, P_λ)
    return response | {"by_multiplier": P_λ + P_λ @ M @ F_h_by_λ}
