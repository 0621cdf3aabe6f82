"""Motions of regions with large rotations: angles through a cycle, about a point."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

from pydantic import model_validator

from app.laws.cycle_tables import ROTATIONS, CycleTable
from app.laws.loads import Point
from app.laws.values import Named
from app.schema.section import Name, Section, fail
from app.schema.units import PositiveAngle

if TYPE_CHECKING:
    from app.foundation.arrays import Floats


class Rotation(Section):
    """Given angles about the axes of space.

    `axes: yxz` is R = R_y(a_y) R_x(a_x) R_z(a_z): about z first, then about x and at last about y,
    all fixed in space. The same rotation is about y first, then about axes that rotate with the
    region.
    """

    axes: Literal["xyz", "xzy", "yxz", "yzx", "zxy", "zyx"]
    """Order of the product, the first letter outermost."""
    cycle_table: CycleTable
    """Angles in the columns `rotation x`, `rotation y`, `rotation z`; a missing column is zero."""

    @model_validator(mode="after")
    def _rotates(self) -> Rotation:
        columns = self.cycle_table.columns
        if not columns.keys() & {*ROTATIONS}:
            message = f"has {', '.join(columns)}; expected some of {', '.join(ROTATIONS)}"
            fail(message, at=("cycle_table",))
        return self


class Motion(Named):
    """Motion of a region as a whole; its small deformations are in the frame that moves with it."""

    region: Name
    """Region that moves; one motion for each."""
    about: Point
    """Centre of rotation (mm)."""
    boundary: Name | None = None
    """Driven boundary of an elastic region. It moves as a rigid body, and loads act on it."""
    rotation: Rotation | None = None
    """Prescribed angles; without them the region does not rotate."""
    translation: Literal["free", "held"] = "free"
    """Translation of the centre: free, or held at zero."""
    largest_step: PositiveAngle = math.radians(5.0)
    """Largest rotation in a load step; larger steps are divided."""

    @property
    def cycle(self) -> CycleTable | None:
        """Cycle table of its angles."""
        return self.rotation.cycle_table if self.rotation else None

    def rotation_at(self, s: float, part: float = 1.0) -> Floats:
        """Rotation R (3, 3) at a phase of the cycle: x = about + R (X - about).

        For `axes: yxz` it is R_y(a_y) R_x(a_x) R_z(a_z).

        Args:
            s: Phase in the cycle, from 0 to 1.
            part: Ramp factor of the angles, from 0 to 1.
        """
        from scipy.spatial.transform import Rotation as Rotations

        if self.rotation is None:
            return Rotations.identity().as_matrix()
        columns = [f"rotation {axis}" for axis in self.rotation.axes]
        angles = [part * angle for angle in self.rotation.cycle_table.values_at(columns, s)]
        # Capital letters are axes that rotate with the region.
        return Rotations.from_euler(self.rotation.axes.upper(), angles).as_matrix()
