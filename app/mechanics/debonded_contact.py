r"""Contact on the debonded share of a cohesive interface, as a function of arrays.

With the traction T of a law and its debonded share s, the force of a point is

.. math:: F = T + P(λ - T + r ΔG) \quad \text{with the friction coefficient } s μ,

with the law P, the multiplier λ and the vector ΔG of `forms.contact`. P is a separate kernel,
because ffcx needs minutes to compile T and P together.

The derivative of the friction with respect to s assumes that the radius of the friction disc is
proportional to the friction coefficient (`forms.contact._friction`): friction at the limit is then
proportional to s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.foundation.arrays import Floats, Ints
from app.mechanics.point_forces import normal_force
from app.mechanics.prescribed_slip import Inputs, LawAtPoints
from forms.contact import SLIP


@dataclass(frozen=True)
class Debonding:
    """Cohesive response of n debonded points without contact.

    Attributes:
        traction: Cohesive traction (n, 3) [MPa].
        traction_by_jump: Its derivative with respect to the jump (n, 3, 3) [MPa/mm].
        share: Debonded share of the area, above 0 (n,) [-].
        share_by_jump: Its derivative with respect to the jump (n, 3) [1/mm].
    """

    traction: Floats
    traction_by_jump: Floats
    share: Floats
    share_by_jump: Floats


@dataclass(frozen=True)
class DebondedContact:
    """Contact of n points, to be added to their cohesive response.

    Attributes:
        force: Contact force per area (n, 3) [MPa].
        by_multiplier: Derivative of the force with respect to the multiplier (n, 3, 3) [-].
        by_jump: Derivative of the force with respect to the jump (n, 3, 3) [MPa/mm].
        pressures: Contact pressure on each face (n, faces) [MPa].
        status: OPEN, STICK or SLIP (n,).
        friction_work: Energy per area that friction dissipates in the step (n,) [N/mm].
    """

    force: Floats
    by_multiplier: Floats
    by_jump: Floats
    pressures: Floats
    status: Ints
    friction_work: Floats


def debonded_contact(
    contact_law: LawAtPoints,
    inputs: Inputs,
    debonding: Debonding,
    normals: Floats,
    prescribed_tangents: Floats,
) -> DebondedContact:
    """Contact of the debonded share at n points.

    Args:
        contact_law: Law of contact P.
        inputs: Inputs of P by name: ``multiplier`` λ (n, 3) [MPa]; ``jump``, ``jump_old`` of the
            last converged state and ``initial_gap`` (n, 3) [mm]; augmentation ``r`` (n,) [MPa/mm];
            with friction, the coefficient ``μ`` of the whole area (n,) [-].
        debonding: Cohesive response.
        normals: Normals of the faces, zero beyond their number (n, 3, 3).
        prescribed_tangents: Projectors on the prescribed tangential directions (n, 3, 3). There T
            is no part of the multiplier.
    """
    r, share = inputs["r"], debonding.share
    other_directions = np.eye(3) - prescribed_tangents
    traction = np.einsum("pij,pj->pi", other_directions, debonding.traction)
    multiplier = inputs["multiplier"] - traction
    contact_inputs = {**inputs, "multiplier": multiplier}
    if "μ" in inputs:
        contact_inputs["μ"] = inputs["μ"] * share
    response = contact_law(contact_inputs)
    contact_force, pressures = response["force"], response["pressures"]
    by_multiplier = response["by_multiplier"]
    status = np.rint(response["status"]).astype(np.int64)
    friction = contact_force - normal_force(pressures, normals)
    is_slipping = status == SLIP
    traction_by_jump = other_directions @ debonding.traction_by_jump
    by_jump = by_multiplier @ (r[:, None, None] * np.eye(3) - traction_by_jump)
    # The radius of the friction disc is proportional to the share: d friction/d s = friction/s.
    by_share = np.where(is_slipping, 1 / share, 0.0)
    by_jump += by_share[:, None, None] * friction[:, :, None] * debonding.share_by_jump[:, None, :]
    force_deficit = np.einsum("pij,pj->pi", other_directions, multiplier - contact_force)
    slip = inputs["jump"] - inputs["jump_old"] + force_deficit / r[:, None]
    friction_work = np.where(is_slipping, np.einsum("pi,pi->p", friction, slip), 0.0)
    return DebondedContact(
        force=contact_force,
        by_multiplier=by_multiplier,
        by_jump=by_jump,
        pressures=pressures,
        status=status,
        friction_work=friction_work,
    )
