"""Changes of the interface laws that remedies of Newton's method make for a while.

`numerics.remedies` makes and ends changes by `mechanics.contact_remedies`. The changes are one
value, `Switches`, that `PointLaws.evaluate` takes. The laws themselves keep no trace.

Remedies also scale the augmentation (`PointLaws.scale_augmentation`). It is no switch, because it
does not change the solution.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.foundation.arrays import Bools, Floats
from app.mechanics.contact_state import LocalPoints
from app.mechanics.point_forces import PointForces, normal_force
from app.mechanics.prescribed_slip import Inputs, LawAtPoints, Outputs
from forms.contact import OPEN, STICK


@dataclass(frozen=True)
class Switches:
    """Changes of the laws at n points. The object is immutable; remedies replace it.

    Attributes:
        freezes_variables: True while internal variables keep the values of the last converged
            state.
        stuck: Mask of points that are forced to stick (n,).
        opened: Mask of points whose contact is switched off (n,). Laws other than contact keep
            their forces.
        tresca_trial_force: Given trial forces (n, 3) whose pressures limit friction [MPa]. The
            problem is then that of Tresca. None: the pressures of the state limit friction, as in
            Coulomb's law.
    """

    freezes_variables: bool
    stuck: Bools
    opened: Bools
    tresca_trial_force: Floats | None

    @classmethod
    def off(cls, n: int) -> Switches:
        """Return no changes at n points."""
        none = np.zeros(n, dtype=bool)
        return cls(freezes_variables=False, stuck=none, opened=none, tresca_trial_force=None)


def tresca_response(
    law: LawAtPoints, inputs: Inputs, response: Outputs, normals: Floats, excess: Floats
) -> Outputs:
    """Replace the friction of a contact law by that under given pressures.

    Args:
        law: The law of contact.
        inputs: Inputs of the law by name, with ``initial_gap`` (n, 3) [mm] and the augmentation
            ``r`` (n,) [MPa/mm].
        response: Outputs of the law under the pressures of the state.
        normals: Normals of the faces, zero beyond their number (n, 3, 3).
        excess: Given trial force minus that of the state (n, 3) [MPa].

    Returns:
        Outputs of the law: normal force of the state, friction under the given pressures.
    """
    along_normals = _span_projectors(normals)
    change = np.einsum("pij,pj->pi", along_normals, excess) / inputs["r"][:, None]
    given = law({**inputs, "initial_gap": inputs["initial_gap"] + change})
    faces = response["pressures"].shape[1]
    pressed, given_pressed = (
        np.where(values["pressures"][:, :, None] > 0, normals[:, :faces], 0.0)
        for values in (response, given)
    )
    friction = given["force"] - normal_force(given["pressures"], normals)
    across_pressed = np.eye(3) - _span_projectors(given_pressed)
    across_normals = np.eye(3) - along_normals
    by_multiplier = _span_projectors(pressed)
    by_multiplier += across_pressed @ given["by_multiplier"] @ across_normals
    is_open = (response["status"] == OPEN) & (given["status"] == OPEN)
    return response | {
        "force": normal_force(response["pressures"], normals) + friction,
        "by_multiplier": by_multiplier,
        "status": np.where(is_open, OPEN, np.maximum(given["status"], STICK)),
    }


def stick_points(
    point_forces: PointForces, points: LocalPoints, stuck: Bools, trial_force: Floats
) -> None:
    """Replace the response of points by stick, in place.

    Args:
        point_forces: Response of the laws.
        points: The points.
        stuck: Mask of the points that are forced to stick (n,).
        trial_force: Trial force for stick on all faces (n, 3) [MPa].
    """
    by_jump = point_forces.augmentation[:, None, None] * np.eye(3)
    point_forces.force[stuck] = points.project_free(trial_force)[stuck]
    point_forces.by_multiplier[stuck] = np.eye(3)
    point_forces.by_jump[stuck] = by_jump[stuck]
    point_forces.status[stuck] = STICK


def open_points(point_forces: PointForces, opened: Bools) -> None:
    """Remove the forces of opened points, in place.

    Args:
        point_forces: Response of the laws.
        opened: Mask of the points whose contact is switched off (n,).
    """
    for values in (
        point_forces.force,
        point_forces.by_multiplier,
        point_forces.by_jump,
        point_forces.pressures,
    ):
        values[opened] = 0.0
    point_forces.status[opened] = OPEN


def _span_projectors(normals: Floats) -> Floats:
    """Projectors (n, 3, 3) on the span of normals (n, m, 3); zero rows do not contribute."""
    return np.asarray(np.linalg.pinv(normals) @ normals)
