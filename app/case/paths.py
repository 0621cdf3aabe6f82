"""Paths along which fields are written: lines, circles, sections, and sides of a stem."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, model_validator

from app.laws.loads import Point
from app.schema import units
from app.schema.section import ITEMS, Kinds, Name, Section, Text, fail, show

# Most points of a path: a line of the page has fewer.
MOST_POINTS = 10_000


def _some(points: int) -> int:
    """Refuse a path of one point, or of more than files and pages can hold."""
    if not 2 <= points <= MOST_POINTS:
        fail(f"{show(points)} points; expected 2 to {MOST_POINTS}")
    return points


class PathOptions(Section):
    """Base of the paths."""

    kind: Any
    points: Annotated[units.PositiveInteger, AfterValidator(_some)] = 101
    """Number of points, at equal distances, including both ends."""
    fields: Annotated[tuple[Text, ...], ITEMS] = ()
    """Fields, by their names in `fields.vtkhdf`; for a vector its magnitude. `displacement.x`,
    `stress.zz` are components. Fields of an interface are written without its name: `pressure`. By
    default the displacement, the von Mises stress and the temperature; on an interface with contact
    its pressure, shear, slip, gap and the temperature."""

    @property
    def interface_name(self) -> str:
        """Interface on which the path lies; empty for a path through bodies."""
        return ""


class LinePath(PathOptions):
    """A straight line between two points."""

    kind: Literal["line"] = "line"
    start: Point
    """First point."""
    end: Point
    """Last point."""
    region: Name | None = None
    """Region whose values are taken; by default every region on the line."""

    @model_validator(mode="after")
    def _long(self) -> LinePath:
        if self.start == self.end:
            fail("is the start; expected another point", at=("end",))
        return self


class CirclePath(PathOptions):
    """A circle, counterclockwise about its axis, from x (or from y if the axis is x)."""

    kind: Literal["circle"] = "circle"
    centre: Point
    """Centre."""
    radius: units.PositiveLength
    """Radius."""
    axis: units.Axis = (0.0, 0.0, 1.0)
    """Axis, a vector of any length except zero."""
    region: Name | None = None
    """Region whose values are taken; by default every region on the circle."""


class SectionPath(PathOptions):
    """The outline of a body or an interface at a height, from x to y (medial to anterior)."""

    kind: Literal["section"] = "section"
    height: units.Length
    """Height z of the section."""
    interface: Name | None = None
    """Interface whose outline it is."""
    region: Name | None = None
    """Region whose outer outline it is. With `interface`: the region on one of its sides whose
    values are taken; by default the first side."""

    @model_validator(mode="after")
    def _of_something(self) -> SectionPath:
        if self.interface is None and self.region is None:
            fail("has no outline; expected interface: NAME, or region: NAME")
        return self

    @property
    def interface_name(self) -> str:
        """The key `interface`."""
        return self.interface or ""


class SidePath(PathOptions):
    """A side of an interface around a stem, from its lower to its upper end.

    It lies in the half-plane from the axis of the stem to that side.
    """

    kind: Literal["side"] = "side"
    side: Literal["medial", "anterior", "lateral", "posterior"]
    """Side of the stem: medial is x, anterior is y."""
    interface: Name
    """Interface around the stem."""
    region: Name | None = None
    """Region on a side of the interface whose values are taken; by default the first side."""

    @property
    def interface_name(self) -> str:
        """The key `interface`."""
        return self.interface


AnyPath = Annotated[LinePath | CirclePath | SectionPath | SidePath, Kinds()]
