"""Probes: points whose displacement and temperature are recorded, and strain gauges."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import ConfigDict, model_validator

from app.laws.loads import Point
from app.schema import units
from app.schema.section import Kinds, Name, Section


class Probe(Section):
    """A point whose displacement and temperature are recorded."""

    model_config = ConfigDict(json_schema_extra={"type": ["object", "array", "string"]})

    kind: Literal["point"] = "point"
    at: Point
    """Position."""
    boundary: ClassVar[None] = None
    region: Name | None = None
    """Region of the point, if it is where two meet."""

    @model_validator(mode="before")
    @classmethod
    def _of_point(cls, value: object) -> object:
        return value if isinstance(value, dict | Probe) else {"at": value}


class StrainGauge(Section):
    """A strain gauge: mean strain over a circle on a surface, in the direction of its grid.

    Its mean displacement is recorded too.
    """

    kind: Literal["strain_gauge"] = "strain_gauge"
    boundary: Name
    """Surface to which the gauge is glued."""
    region: ClassVar[None] = None
    at: Point
    """Centre: the nearest point of the surface, at most a diameter away. With `towards` a point on
    the line of sight."""
    towards: units.Axis | None = None
    """Direction from `at` in which the line of sight leaves the surface for the last time; there is
    the centre."""
    direction: units.Axis
    """Direction of the grid; its part in the tangent plane counts."""
    diameter: units.PositiveLength
    """Diameter of the circle, the length of the grid."""


AnyProbe = Annotated[Probe | StrainGauge, Kinds("point")]
