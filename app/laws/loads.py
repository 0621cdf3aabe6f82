"""Loads: forces, pressures and body forces; their keys and their work in a displacement."""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Protocol, TypeAlias

import numpy as np
from pydantic import BeforeValidator, PrivateAttr, ValidationInfo, model_validator

from app.laws.cycle_tables import FACTOR, FORCES, CycleTable
from app.laws.values import LoadHistory, Named, Source, Status, amplitude, field
from app.schema.expressions import Varying
from app.schema.section import ITEMS, Extensible, Kinds, Name, Triple, distribute_unit, fail, show
from app.schema.units import Dimension, ForceVector, Length, Stress

if TYPE_CHECKING:
    from dolfinx import fem
    from ufl import Form, Measure
    from ufl.core.expr import Expr

    from app.foundation.arrays import Field, Floats

    # Work as a UFL form; 0 if the load does not act on the body.
    Work: TypeAlias = Form | Literal[0]

ForceDensityField = Annotated[
    float | str, Varying(Dimension("N/mm^3", "a force per volume", "1e-5 N/mm^3"))
]

# What is expected of the force beside a cycle table with a column `force`, and with components.
DIRECTION = "the direction, 1 N long"
NO_FORCE = "none: the cycle table has the components (over a base: `force: null`)"


def _point(value: object, info: ValidationInfo) -> object:
    """Replace the name of a point of the geometry by its coordinates."""
    value = distribute_unit(value)
    if not isinstance(value, str):
        return value
    points: dict[str, tuple[float, float, float]] | None = (info.context or {}).get("points", {})
    if points is None:
        return ["0 mm"] * 3  # the geometry is invalid, which is reported already
    if value not in points:
        known_points = (
            f" or one of {', '.join(points)}" if points else " (this geometry names no points)"
        )
        fail(f"{show(value)} is not a point; expected [x, y, z] lengths{known_points}")
    return [f"{c!r} mm" for c in points[value]]


Point = Annotated[
    tuple[Length, Length, Length], Triple("[0 mm, 0 mm, 50 mm]"), BeforeValidator(_point)
]


@dataclass(frozen=True)
class Patch:
    """A boundary patch: area [mm2], centroid [mm] and second moments about it [mm4]."""

    area: float
    centroid: Floats
    moments: Floats


class LoadedBody(Protocol):
    """One body as loads see it, in UFL: see `mechanics.body_forms.OnBody`.

    Attributes:
        x: Position (3,) [mm].
        n: Outward unit normal (3,).
    """

    x: Expr
    n: Expr

    def constant(self, value: Floats | float) -> fem.Constant:
        """Constant in UFL."""

    def patch(self, boundary: str) -> Patch:
        """Area, centroid and second moments of a boundary; collective."""

    def ds(self, boundary: str) -> Measure | None:
        """Measure of the facets of a boundary that belong to the body, if any."""

    def spread(self, density: Field, regions: Sequence[str] | None) -> list[tuple[Expr, Measure]]:
        """Field (3,) and measure of each of the body's regions, all by default."""


class Load(Extensible, Named):
    """Base of the loads: work in a displacement, times a load history.

    Each subclass with a `kind` is a load. Three keys have a meaning in every load: `boundary` is
    where it acts, `regions` are those of a body force, `force` is the resultant.
    """

    # True if its direction is fixed in space while its body rotates.
    fixed_in_space: ClassVar[bool] = False
    _followed: Callable[[float], float] | None = PrivateAttr(None)

    # A `Literal` in each subclass.
    kind: Any
    history: LoadHistory = None
    """Multiplier at the end of each stage, linear in between, from 0; all ones by default."""
    status: Status = None
    """Origin of the values: measured, assumed, or unverified if their source was not read."""
    source: Source = None
    """Source of the values. If a file changes a value, status and source are removed."""

    @property
    def form_key(self) -> tuple[str, str | None, tuple[str, ...] | None]:
        """Kind, boundary and regions. Loads that agree in these share their forms."""
        keys = dict(self)
        return self.kind, keys.get("boundary"), keys.get("regions")

    @property
    def boundaries(self) -> tuple[str, ...]:
        """Boundaries that it acts on; none for a body force."""
        keys = dict(self)
        return (keys["boundary"],) if "boundary" in keys else ()

    @property
    def volume_regions(self) -> tuple[str, ...] | None:
        """Regions of a body force, empty for all regions; None for a load on boundaries."""
        return None

    @property
    def followed_motion(self) -> str | None:
        """Motion with which the direction of the load rotates; None for a direction in space."""
        return None

    @property
    def normal_pressure(self) -> float | None:
        """Pressure on its boundaries [MPa]; None for other loads."""
        return None

    @property
    def point(self) -> tuple[float, float, float] | None:
        """Point at which the resultant acts [mm]; None if no point is given."""
        return None

    @property
    def cycle(self) -> CycleTable | None:
        """Cycle table of its values; None without."""
        return None

    @property
    def force_magnitudes(self) -> tuple[float, ...]:
        """Magnitudes of the force at the rows of its cycle table [N]; none without."""
        return ()

    def density_at(self, x: Floats) -> Floats:
        """Force per volume at points (n, 3) [N/mm3]."""
        return np.zeros_like(x)

    def as_moving_force(self, driven_boundaries: Container[str | None]) -> Force | None:
        """Return the load if it is a force with a cycle table or a motion, else None.

        Args:
            driven_boundaries: Boundaries that motions drive.
        """
        return None

    def work(self, v: Expr, body: LoadedBody) -> Work:
        """Work at full amplitude on a body in a displacement v, as a UFL form; 0 if none.

        Args:
            v: Displacement (3,), in UFL.
            body: The body.
        """
        raise NotImplementedError

    def amplitude(self, time: float) -> float:
        """Multiplier at a time (stage k runs from k to k + 1) [-]."""
        return self._followed(time) if self._followed else amplitude(self.history, time)

    def set_amplitude(self, amplitude_at: Callable[[float], float]) -> None:
        """Let the multiplier follow a function of time instead of the history."""
        self._followed = amplitude_at

    @property
    def resultant(self) -> tuple[float, float, float] | None:
        """Resultant at full amplitude [N]: the key `force`, None without it."""
        return dict(self).get("force")


class Force(Load):
    """A resultant force, applied as a traction on a boundary; with `at`, also with its moment."""

    fixed_in_space: ClassVar[bool] = True

    kind: Literal["force"] = "force"
    boundary: Name
    """Boundary of the geometry."""
    force: ForceVector
    """Resultant. If the cycle table has a column `force`: its direction, as a vector of 1 N."""
    at: Point | None = None
    """Point at which the resultant acts (mm). By default the traction is uniform."""
    cycle_table: CycleTable | None = None
    """Force through each cycle of the last stage, in place of `history`. A column `factor`
    multiplies the key `force`. A column `force` multiplies the direction `force`, 1 N long. Columns
    `force x`, `force y` and `force z` replace the key."""
    follows: Name | None = None
    """Motion with which the force rotates; by default its direction is fixed in space."""

    @model_validator(mode="before")
    @classmethod
    def _add_zero_force(cls, value: object) -> object:
        if isinstance(value, dict) and value.get("cycle_table") is not None:
            return {"force": "[0, 0, 0] N"} | value
        return value

    @model_validator(mode="after")
    def _check_cycle_table(self) -> Force:
        if self.cycle_table is None:
            return self
        if self.history is not None:
            fail("the force has a cycle_table; leave one of the two out", at=("history",))
        column_groups = [("force",), (FACTOR,), FORCES]
        given_groups = [
            column_names
            for column_names in column_groups
            if self.cycle_table.columns.keys() & {*column_names}
        ]
        if len(given_groups) != 1:
            message = f"has {', '.join(self.cycle_table.columns)}; expected force, {FACTOR}"
            fail(f"{message}, or some of {', '.join(FORCES)}", at=("cycle_table",))
        size = math.hypot(*self.force)
        if given_groups == [(FACTOR,)]:
            if size == 0.0:
                message = "is zero; expected the force that the factors of the cycle table multiply"
                fail(message, at=("force",))
            return self
        if given_groups == [("force",)]:  # it multiplies a direction
            if abs(size - 1.0) > 1e-3:
                fail(f"is {size:g} N long; expected {DIRECTION}", at=("force",))
        elif size > 1e-3:  # components replace the key
            fail(f"is {size:g} N long; expected {NO_FORCE}", at=("force",))
        return self

    @property
    def point(self) -> tuple[float, float, float] | None:
        """The key `at`."""
        return self.at

    @property
    def cycle(self) -> CycleTable | None:
        """The key `cycle_table`."""
        return self.cycle_table

    @property
    def followed_motion(self) -> str | None:
        """The key `follows`."""
        return self.follows

    @property
    def force_magnitudes(self) -> tuple[float, ...]:
        """Magnitudes of the force at the rows of its cycle table [N]; none without."""
        if self.cycle_table is None:
            return ()
        first, *_, last = times = self.cycle_table.times
        return tuple(math.hypot(*self.force_at((t - first) / (last - first))) for t in times)

    def as_moving_force(self, driven_boundaries: Container[str | None]) -> Force | None:
        """Return the force if it has a cycle table, or it or its boundary has a motion."""
        moves = self.cycle_table or self.follows or self.boundary in driven_boundaries
        return self if moves else None

    def force_at(self, s: float) -> tuple[float, float, float]:
        """Force at a phase of the cycle, 0 to 1 (3,) [N]; `force` without a cycle table."""
        if self.cycle_table is None:
            return self.force
        size, factor, *components = self.cycle_table.values_at(("force", FACTOR, *FORCES), s)
        pairs = zip(self.force, components, strict=True)
        x, y, z = ((size + factor) * f + component for f, component in pairs)
        return x, y, z

    @property
    def resultant(self) -> tuple[float, float, float]:
        """Resultant at full amplitude, or at the end of the cycle table [N]."""
        return self.force_at(1.0)

    def work(self, v: Expr, body: LoadedBody) -> Work:
        """Work of a traction that varies linearly over the boundary."""
        from forms import loads

        # Collective, and may raise: on every rank, even without facets.
        patch, ds = body.patch(self.boundary), body.ds(self.boundary)
        if ds is None:
            return 0
        t = body.constant(np.array(self.force) / patch.area)
        if self.at is None:
            return loads.traction_work(t, v) * ds
        moment = np.cross(np.array(self.at) - patch.centroid, self.force)
        ω = body.constant(np.linalg.solve(patch.moments, moment))
        return loads.linear_traction_work(t, ω, body.x, body.constant(patch.centroid), v) * ds


class Pressure(Load):
    """A pressure normal to the boundary; positive compresses."""

    kind: Literal["pressure"] = "pressure"
    boundary: Name
    """Boundary of the geometry."""
    pressure: Stress
    """Pressure."""

    @property
    def normal_pressure(self) -> float:
        """The key `pressure`."""
        return self.pressure

    def work(self, v: Expr, body: LoadedBody) -> Work:
        """Work of a traction along the normal."""
        from forms import loads

        ds = body.ds(self.boundary)
        return (
            0 if ds is None else loads.pressure_work(body.constant(self.pressure), body.n, v) * ds
        )


class BodyForce(Load):
    """A force per volume, such as weight."""

    fixed_in_space: ClassVar[bool] = True

    kind: Literal["body_force"] = "body_force"
    regions: Annotated[tuple[Name, ...], ITEMS] | None = None
    """Regions it acts on; all by default."""
    density: Annotated[
        tuple[ForceDensityField, ForceDensityField, ForceDensityField],
        Triple("[0 N/mm^3, 0 N/mm^3, -1e-5 N/mm^3]"),
    ]
    """Force per volume along x, y, z; each may vary in space."""

    @property
    def volume_regions(self) -> tuple[str, ...]:
        """The key `regions`."""
        return self.regions or ()

    def density_at(self, x: Floats) -> Floats:
        """Force per volume at points (n, 3) [N/mm3]."""
        key = f"loads.{self.name}.density"
        columns = [field(f"{key}[{i}]", value)(x) for i, value in enumerate(self.density)]
        return np.stack(columns, axis=1)

    def work(self, v: Expr, body: LoadedBody) -> Work:
        """Work of the force density in the body's regions."""
        from forms import loads

        density_field = body.spread(self.density_at, self.regions)
        return sum(loads.body_force_work(b, v) * dx for b, dx in density_field)


AnyLoad = Annotated[Load, Kinds()]
