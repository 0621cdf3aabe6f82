"""Forces of the interface laws at contact points, as arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from app.foundation.arrays import Bools, Floats, Ints
from forms.contact import OPEN

# Outputs that a law may have, with their shapes (see `forms.contact.Response`).
OUTPUTS: dict[str, tuple[int, ...]] = {
    "slip": (3,),
    "stored": (),
    "dissipated": (),
    "dissipated_by_jump": (3,),
    "debonded_share": (),
    "debonded_share_by_jump": (3,),
}


@dataclass(frozen=True)
class PointForces:
    """Forces, derivatives and states of the laws at n points.

    Attributes:
        force: Interface force per area (n, 3) [MPa].
        by_multiplier: Generalized derivative of the force by the multiplier (n, 3, 3) [-].
        by_jump: Generalized derivative of the force by the jump (n, 3, 3) [MPa/mm].
        trial_force: Trial force S (n, 3) [MPa].
        augmentation: Augmentation r, the stiffness of the trial force (n,) [MPa/mm].
        pressures: Pressure on each face, positive in compression (n, 3) [MPa].
        status: OPEN, STICK or SLIP (n,). For a debonded share it is that of contact.
        bonded: True where a law other than contact still holds the point, if only in part (n,).
        internal_variables: New values of the internal variables of the laws, by name: (n, ...).
        debonded_friction_work: Energy per area that friction of the debonded area dissipates in the
            step (n,) [N/mm].
        outputs: Values of `OUTPUTS`, by name: (n, ...); 0 for laws without them.
    """

    force: Floats
    by_multiplier: Floats
    by_jump: Floats
    trial_force: Floats
    augmentation: Floats
    pressures: Floats
    status: Ints
    bonded: Bools
    internal_variables: Mapping[str, Floats]
    debonded_friction_work: Floats
    outputs: Mapping[str, Floats]

    @classmethod
    def zeros(
        cls, trial_force: Floats, augmentation: Floats, internal_variables: Mapping[str, Floats]
    ) -> PointForces:
        """Return no forces, at open points with unchanged internal variables.

        Args:
            trial_force: Trial force of the points (n, 3) [MPa].
            augmentation: Augmentation of the points (n,) [MPa/mm].
            internal_variables: Internal variables of the last converged state, by name: (n, ...).
        """
        n = len(augmentation)
        return cls(
            force=np.zeros((n, 3)),
            by_multiplier=np.zeros((n, 3, 3)),
            by_jump=np.zeros((n, 3, 3)),
            trial_force=trial_force,
            augmentation=augmentation,
            pressures=np.zeros((n, 3)),
            status=np.zeros(n, dtype=np.int64),
            bonded=np.zeros(n, dtype=bool),
            internal_variables={name: values.copy() for name, values in internal_variables.items()},
            debonded_friction_work=np.zeros(n),
            outputs={name: np.zeros((n, *shape)) for name, shape in OUTPUTS.items()},
        )

    @property
    def touching(self) -> Bools:
        """True where the sides touch, or where a bond still connects them (n,)."""
        return (self.status != OPEN) | self.bonded

    @property
    def traction_stiffness(self) -> Floats:
        """Stiffness of the traction alone: `by_jump` - r `by_multiplier` (n, 3, 3) [MPa/mm]."""
        return self.by_jump - self.augmentation[:, None, None] * self.by_multiplier

    @property
    def resisted(self) -> Floats:
        """Fraction of a jump increment that the law resists (n, 3, 3) [-].

        It is `by_multiplier` + k / (k + r), with k the positive principal values of
        `traction_stiffness`.
        """
        K, r = self.traction_stiffness, self.augmentation[:, None]
        sizes, axes = np.linalg.eigh((K + K.transpose(0, 2, 1)) / 2)
        shares = np.maximum(sizes, 0.0) / (np.abs(sizes) + r)
        return self.by_multiplier + (axes * shares[:, None, :]) @ axes.transpose(0, 2, 1)


def normal_force(pressures: Floats, normals: Floats) -> Floats:
    """Force (n, 3) of the pressures (n, k) of the first k faces, by normals (n, 3, 3) [MPa]."""
    return -np.einsum("pk,pki->pi", pressures, normals[:, : pressures.shape[1]])
