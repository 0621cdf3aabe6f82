"""Directions of fibres: the same throughout a region, or around or away from an axis."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from ufl import SpatialCoordinate
from ufl.core.expr import Expr

from app.arrays import Floats
from forms import fibres

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Fibre:
    """Fibres of a region.

    Attributes:
        axis: Unit direction (3,) of straight fibres, or of the axis that the others follow.
        through: A point of that axis (3,) [mm].
        lay: How they lie.
    """

    axis: Vector
    through: Vector = (0.0, 0.0, 0.0)
    lay: Literal["straight", "circumferential", "radial"] = "straight"

    @property
    def turns(self) -> bool:
        """Whether their direction differs from point to point."""
        return self.lay != "straight"

    def direction(self, mesh: Any, constant: Callable[[Vector], Any]) -> Expr:
        """Unit direction (3,) on a mesh, axis and point handed in as UFL constants."""
        if not self.turns:
            return constant(self.axis)
        form = fibres.radial if self.lay == "radial" else fibres.circumferential
        return form(SpatialCoordinate(mesh), constant(self.axis), constant(self.through))

    def frames(self, x: Floats) -> Floats:
        """Rotations (n, 3, 3) whose third column is the direction at points (n, 3), if it turns."""
        a = np.broadcast_to(self.axis, x.shape)
        r = x - self.through
        r = r - (r @ np.array(self.axis))[:, None] * a
        r /= np.linalg.norm(r, axis=1)[:, None]
        t = np.cross(a, r)
        return np.stack([t, a, r] if self.lay == "radial" else [a, r, t], axis=2)
