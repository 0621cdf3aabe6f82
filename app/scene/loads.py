"""Loads of a scene: each knows its boundary and its work, so that nobody asks what kind it is.

To add one, derive from `LoadTerm` and register it with `scene.build.load_of`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import ufl
from ufl.core.expr import Expr

from app.arrays import Floats
from forms import loads

# Values at points (n, 3) [mm].
Field = Callable[[Floats], Floats]


@dataclass(frozen=True)
class Patch:
    """A boundary patch: area [mm2], centroid [mm] and second moments about it [mm4]."""

    area: float
    centroid: Floats
    moments: Floats


class Acting(Protocol):
    """Interface between a load and one body of a discrete problem.

    Attributes:
        x: Position, in UFL.
        n: Outward normal of facets, in UFL.
    """

    x: Expr
    n: Expr

    def ds(self, boundary: str) -> ufl.Measure | None:
        """Measure of the part of a boundary that belongs to the body, if any."""

    def patch(self, boundary: str) -> Patch:
        """Area, centroid and moments of a boundary, of all bodies; collective."""

    def constant(self, value: Any) -> Expr:
        """A constant, in UFL: another value of it compiles nothing anew."""

    def spread(self, density: Field, regions: Sequence[str]) -> list[tuple[Expr, ufl.Measure]]:
        """A field (3,) and the measure of each of the body's regions among some."""


class LoadTerm(ABC):
    """A load: a linear functional of the displacement, times its history.

    Attributes:
        name: Name in the case file.
        history: Amplitudes at the ends of the stages.
    """

    name: str
    history: tuple[float, ...]

    @property
    def boundaries(self) -> tuple[str, ...]:
        """Boundaries that it acts on; none if it acts inside."""
        return ()

    @abstractmethod
    def work(self, v: Expr, on: Acting) -> Any:
        """Work at full amplitude on a body in a displacement v, as a UFL form; 0 if none."""


@dataclass(frozen=True)
class ForceTerm(LoadTerm):
    """A resultant force [N] on a patch, through a point [mm] or spread evenly (no point)."""

    name: str
    boundary: str
    force: tuple[float, float, float]
    at: tuple[float, ...]
    history: tuple[float, ...]

    @property
    def boundaries(self) -> tuple[str, ...]:
        """The patch."""
        return (self.boundary,)

    def work(self, v: Expr, on: Acting) -> Any:
        """That of a traction that is linear over the patch."""
        # Of all bodies, and with its errors: on every rank, whoever has facets.
        patch, ds = on.patch(self.boundary), on.ds(self.boundary)
        if ds is None:
            return 0
        t = on.constant(np.array(self.force) / patch.area)
        if not self.at:
            return loads.traction_work(t, v) * ds
        moment = np.cross(np.array(self.at) - patch.centroid, self.force)
        ω = on.constant(np.linalg.solve(patch.moments, moment))
        return loads.linear_traction_work(t, ω, on.x, on.constant(patch.centroid), v) * ds


@dataclass(frozen=True)
class PressureTerm(LoadTerm):
    """A pressure [MPa] on a boundary, positive when it compresses."""

    name: str
    boundary: str
    pressure: float
    history: tuple[float, ...]

    @property
    def boundaries(self) -> tuple[str, ...]:
        """The boundary."""
        return (self.boundary,)

    def work(self, v: Expr, on: Acting) -> Any:
        """That of a traction along the normal."""
        ds = on.ds(self.boundary)
        return 0 if ds is None else loads.pressure_work(on.constant(self.pressure), on.n, v) * ds


@dataclass(frozen=True)
class BodyForceTerm(LoadTerm):
    """A force density (n, 3) [N/mm3] at points in regions."""

    name: str
    regions: tuple[str, ...]
    density: Field
    history: tuple[float, ...]

    def work(self, v: Expr, on: Acting) -> Any:
        """That of the density in the body's regions."""
        spread = on.spread(self.density, self.regions)
        return sum(loads.body_force_work(b, v) * dx for b, dx in spread)
