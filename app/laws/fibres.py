"""Fibre directions: constant in a region, around an axis, or away from an axis."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, Discriminator, PlainSerializer, Tag

from app.schema.section import UNION_TAG, Kinds, Section, Triple
from app.schema.units import Axis, Length

if TYPE_CHECKING:
    from dolfinx import fem
    from dolfinx.mesh import Mesh
    from ufl.core.expr import Expr

    from app.foundation.arrays import Floats

Vector = tuple[float, float, float]


class Straight(Section):
    """Fibres along one direction. In a case it is written as a vector without a section."""

    kind: ClassVar[str] = "straight"
    # True if the direction varies in space.
    curved: ClassVar[Literal[False]] = False
    through: ClassVar[Vector] = (0.0, 0.0, 0.0)

    axis: Axis = (0.0, 0.0, 1.0)
    """Direction; a vector of any length except zero."""

    def direction(self, mesh: Mesh, constant: Callable[[Vector], fem.Constant]) -> Expr:
        """Unit direction (3,) on a mesh, in UFL; axis and point are UFL constants."""
        return constant(self.axis)


class Circumferential(Section):
    """Fibres around an axis, like hoops. The axis must be outside the region."""

    curved: ClassVar[Literal[True]] = True

    kind: Literal["circumferential"] = "circumferential"
    axis: Axis = (0.0, 0.0, 1.0)
    """Direction of the axis; a vector of any length except zero."""
    through: Annotated[tuple[Length, Length, Length], Triple("[0 mm, 0 mm, 0 mm]")] = (
        0.0,
        0.0,
        0.0,
    )
    """A point on the axis."""

    def direction(self, mesh: Mesh, constant: Callable[[Vector], fem.Constant]) -> Expr:
        """Unit direction (3,) on a mesh, in UFL; axis and point are UFL constants."""
        from ufl import SpatialCoordinate

        from forms import fibres

        form = fibres.radial if isinstance(self, Radial) else fibres.circumferential
        return form(SpatialCoordinate(mesh), constant(self.axis), constant(self.through))

    def frames(self, x: Floats) -> Floats:
        """Rotations (n, 3, 3) whose third column is the direction at points (n, 3)."""
        a = np.broadcast_to(self.axis, x.shape)
        r = x - self.through
        r = r - (r @ np.array(self.axis))[:, None] * a
        r /= np.linalg.norm(r, axis=1)[:, None]
        t = np.cross(a, r)
        return np.stack([t, a, r] if isinstance(self, Radial) else [a, r, t], axis=2)


class Radial(Circumferential):
    """Fibres perpendicular to an axis and away from it. The axis must be outside the region."""

    kind: Literal["radial"] = "radial"  # type: ignore[assignment]


def _form(value: object) -> str:
    """Form of a fibre direction: a vector, or a section with a kind."""
    is_axis = isinstance(value, Straight) or not isinstance(value, dict | BaseModel)
    return UNION_TAG + ("along" if is_axis else "about")


Fibre = Straight | Circumferential
if TYPE_CHECKING:
    FibreDirection = Fibre
else:
    FibreDirection = Annotated[
        Annotated[
            Axis,
            AfterValidator(lambda axis: Straight.model_construct(axis=axis)),
            PlainSerializer(lambda fibre: list(fibre.axis)),
            Tag(UNION_TAG + "along"),
        ]
        | Annotated[Circumferential | Radial, Kinds(), Tag(UNION_TAG + "about")],
        Discriminator(_form),
    ]
