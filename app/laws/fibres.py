"""Fibre directions: one for a whole region, or those that an axis gives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import BaseModel, GetCoreSchemaHandler
from pydantic_core import core_schema

from app.schema.section import TAG, Kinds, Section
from app.schema.units import Axis, Length
from app.schema.vectors import Triple


class Circumferential(Section):
    """Fibres around an axis, like rings and hoops. The axis has to run outside the region."""

    kind: Literal["circumferential"] = "circumferential"
    axis: Axis = (0.0, 0.0, 1.0)
    """Direction of the axis; any length but zero, normalised."""
    through: Annotated[tuple[Length, Length, Length], Triple("[0 mm, 0 mm, 0 mm]")] = (
        0.0,
        0.0,
        0.0,
    )
    """A point of the axis."""


class Radial(Circumferential):
    """Fibres away from an axis, at right angles to it. The axis has to run outside the region."""

    kind: Literal["radial"] = "radial"  # type: ignore[assignment]


@dataclass(frozen=True)
class _Direction:
    """Marks a direction that is a list, or a mapping with a kind."""

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """Tell them apart before pydantic tries both."""

        def tag(value: Any) -> str:
            return TAG + ("about" if isinstance(value, dict | BaseModel) else "along")

        about = handler.generate_schema(Annotated[Circumferential | Radial, Kinds()])
        choices = {TAG + "about": about, TAG + "along": handler.generate_schema(Axis)}
        return core_schema.tagged_union_schema(choices, tag)


FibreDirection = Annotated[
    Axis | Annotated[Circumferential | Radial, Kinds()],
    _Direction(),
]
