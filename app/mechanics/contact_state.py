"""Committed state of the contact points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from app.arrays import Floats


@dataclass
class ContactState:
    """Converged state of the contact points of this rank: committed, never half-updated.

    Attributes:
        jump: Jump (n, 3) [mm].
        force: Interface force per area, conjugate to the jump (n, 3) [MPa].
        friction: Friction part of the force (n, 3) [MPa].
        opening: Jump plus initial gap (n, 3) [mm].
        slip: Net sliding while in contact (n, 3) [mm].
        path: Length of the sliding path (n,) [mm].
        dissipation: Friction dissipation so far (n,) [N mm].
        least: Smallest dissipation of any step so far, 0 at most (n,) [N mm].
        contact_work: Work of the pressures in the opening so far (n,) [N mm].
        work: Work of the whole interface force in the jump so far (n,) [N mm].
        own: History of the laws of the interfaces, by name: (n, ...).
    """

    jump: Floats
    force: Floats
    friction: Floats
    opening: Floats
    slip: Floats
    path: Floats
    dissipation: Floats
    least: Floats
    contact_work: Floats
    work: Floats
    own: Mapping[str, Floats]

    @classmethod
    def at_rest(cls, gap: Floats, history: Mapping[str, tuple[int, ...]]) -> ContactState:
        """Unloaded state, for a gap (n, 3) and the shapes of the laws' history."""
        zero, none = np.zeros_like(gap), np.zeros(len(gap))
        own = {name: np.zeros((len(gap), *shape)) for name, shape in history.items()}
        return cls(zero, zero, zero, gap, zero, none, none, none, none, none, own)
