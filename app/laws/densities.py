"""Young's moduli of bone by its density, and moduli that vary by what another package reads."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Discriminator, Tag, model_validator

from app.schema.section import ITEMS, UNION_TAG, Extensible, Four, Section, Truth, fail
from app.schema.units import Dimension, Modulus, Number, Stress

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from app.foundation.arrays import Floats

# Smaller densities of a law are taken as this [g/cm3].
LEAST_DENSITY = 0.01
Ranges = tuple[tuple[float, float, float, float], ...]
# Kind of density, and from which on [g/cm3] E = a + b rho^c: from, a [MPa], b [MPa], c.
LAWS: dict[str, tuple[str, Ranges]] = {
    "morgan_neck": ("apparent", ((0.0, 0.0, 6850.0, 1.49),)),
    "keyak": (
        "ash",
        ((0.0, 0.0, 33900.0, 2.2), (0.27, 469.0, 5307.0, 1.0), (0.6, 0.0, 10200.0, 2.01)),
    ),
    "carter_hayes": ("apparent", ((0.0, 0.0, 2875.0, 3.0),)),
}


_Density = Annotated[float, Dimension("g/cm^3", "a density", "0.004 g/cm^3")]
EXAMPLE = "[0 g/cm^3, 0 MPa, 6.85 GPa, 1.49]"


class DensityLaw(Section):
    """User-defined law E = a + b rho^c, rho in g/cm3, in ranges of rho."""

    density: Literal["qct", "ash", "apparent"]
    """Kind of density: by the phantom (`qct`), ash or apparent."""
    ranges: Annotated[
        tuple[Annotated[tuple[_Density, Stress, Modulus, Number], Four(EXAMPLE)], ...], ITEMS
    ]
    """Ranges: the density at which each begins, a, b and c."""

    @model_validator(mode="after")
    def _rising(self) -> DensityLaw:
        starts = [start for start, *_ in self.ranges]
        for i, (before, start) in enumerate(pairwise(starts), start=1):
            if start <= before:
                message = f"begins at {start:g} g/cm^3, not above {before:g} of the range before"
                fail(message, at=("ranges", i))
        return self


Law = Annotated[
    Annotated[Literal["morgan_neck", "keyak", "carter_hayes"], Tag(UNION_TAG + "known")]
    | Annotated[DensityLaw, Tag(UNION_TAG + "given")],
    Discriminator(lambda law: UNION_TAG + ("known" if isinstance(law, str) else "given")),
]


def table_of(law: str | DensityLaw) -> tuple[str, Ranges]:
    """Kind of density of a law and its ranges: start [g/cm3], a [MPa], b [MPa], c [-]."""
    return LAWS[law] if isinstance(law, str) else (law.density, law.ranges)


def modulus_of_density(law: str | DensityLaw, density: ArrayLike) -> Floats:
    """Young's modulus [MPa] for densities [g/cm3] of the law's kind."""
    rho = np.maximum(density, LEAST_DENSITY)
    start, a, b, c = np.transpose(table_of(law)[1])
    k = np.maximum(np.searchsorted(start, rho, side="right") - 1, 0)
    return np.asarray(a[k] + b[k] * rho ** c[k])


def density(law: str | DensityLaw, modulus: ArrayLike) -> Floats:
    """Density [g/cm3] for Young's moduli [MPa]; the law must increase."""
    start, a, b, c = np.transpose(table_of(law)[1])
    k = np.maximum(np.searchsorted(a + b * np.maximum(start, LEAST_DENSITY) ** c, modulus) - 1, 0)
    return np.asarray(((np.asarray(modulus) - a[k]) / b[k]) ** (1 / c[k]))


@dataclass(frozen=True)
class ChangingDensity:
    """Density of a region that another package changes in a run. All moduli are scaled by it.

    Attributes:
        law: Modulus by density.
        bounds: Least and largest density [g/cm3].
    """

    law: str | DensityLaw
    bounds: tuple[float, float]


class ModulusField(Extensible):
    """Base of Young's moduli that vary by what another package reads, such as an image.

    A subclass is a form of the key `youngs_modulus`.
    """

    per_cell: Truth = False
    """True for the mean over each cell, as other programs read it; at first order always so."""

    @property
    def largest(self) -> float:
        """Largest Young's modulus, to which others are related [MPa]."""
        raise NotImplementedError

    def modulus_at(self, x: Floats, geometry: Any) -> Floats:
        """Young's modulus at points (n, 3) of a geometry (n,) [MPa]."""
        raise NotImplementedError

    def details(self, geometry: Any) -> dict[str, str]:
        """Lines about it for `mantle check`, by their captions."""
        return {}
