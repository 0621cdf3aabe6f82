r"""Bone that follows its strain energy.

The stimulus is S = U / rho, the mean over load cases of strain energy per mass. With its value K in
the intact femur and a lazy zone of s,

.. math:: \dot ρ = B (S - (1 + s) K) \text{ above}, \quad B (S - (1 - s) K) \text{ below},
          \quad 0 \text{ between},

within bounds of the density, and Young's modulus is that of the density.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from app.case.case import Case
from app.foundation.arrays import Floats
from app.laws.densities import LEAST_DENSITY, Law, modulus_of_density
from app.schema.expressions import Varying
from app.schema.paths import File
from app.schema.section import ITEMS, Name, Pair, Section, fail
from app.schema.units import Dimension, PositiveLength, Share

_BoneDensity = Annotated[
    float, Dimension("g/cm^3", "a density", "1.74 g/cm^3", at_least=LEAST_DENSITY)
]
_Names = Annotated[tuple[Name, ...], ITEMS]


class Remodelling(Section):
    """Bone whose density follows its strain energy in stages with `remodels`."""

    law: Law
    """Modulus by density: `morgan_neck`, `keyak`, `carter_hayes`, or a section `law`. A region
    starts with the density that gives its modulus (the axial one, if it has two); all its moduli
    change in the same ratio."""
    regions: Annotated[_Names, Field(min_length=1)] | None = None
    """Regions that remodel; all of bone by default."""
    load_cases: Annotated[_Names, Field(min_length=1)]
    """Earlier stages that represent daily loads; the stimulus is the mean over them."""
    intact: File | None = None
    """Case of the intact femur with the same load cases, or `case.yaml` of a run of it; it is
    solved with the mesh section of this case, and its stimulus at each place is K."""
    stimulus: (
        Annotated[float | str, Varying(Dimension("J/g", "an energy per mass", "0.004 J/g"))] | None
    ) = None
    """K itself: energy per mass, an expression in x, y, z or a value; in place of `intact`."""
    rate: Annotated[
        float, Dimension("g^2/(cm^6*MPa*s)", "a rate", "30 g^2/(cm^6 MPa year)", above=0.0)
    ]
    """B: density per time and stimulus."""
    lazy_zone: Share
    """s: half the width of the zone around K in which nothing changes, over K."""
    density: Annotated[tuple[_BoneDensity, _BoneDensity], Pair("[0.01 g/cm^3, 1.74 g/cm^3]")]
    """Least and largest density."""
    filter: PositiveLength | None = None
    """Length l of a filter of the stimulus, S - l^2 div grad S = U / rho; none by default."""
    frozen: _Names | None = None
    """Boundaries whose bone stays as it is; those with loads and fixed supports by default."""
    tolerance: Annotated[float, Dimension("g/cm^3", "a density", "0.01 g/cm^3", above=0.0)] = 0.01
    """Largest error of the density in a step."""

    @model_validator(mode="after")
    def _sound(self) -> Remodelling:
        if (self.intact is None) == (self.stimulus is None):
            message = "needs a reference: expected intact (a case of the intact femur)"
            fail(f"{message} or stimulus (a value)")
        lowest, highest = self.density
        if lowest >= highest:
            message = f"{lowest:g} is not below {highest:g} g/cm^3; expected the smaller one first"
            fail(message, ("density",))
        E = modulus_of_density(
            self.law, [lowest + (highest - lowest) * k / 200 for k in range(201)]
        )
        if not all(E[1:] > E[:-1]):
            fail("does not rise between the bounds of the density", at=("law",))
        if isinstance(self.stimulus, float) and self.stimulus <= 0:
            fail(f"{self.stimulus:g} J/g must be positive", at=("stimulus",))
        return self

    def speed(self, S: Floats, K: Floats) -> Floats:
        """Change of the density in time [g/(cm3 s)] by the stimulus and its reference [J/g]."""
        above, below = S - (1 + self.lazy_zone) * K, S - (1 - self.lazy_zone) * K
        return np.asarray(self.rate * (np.maximum(above, 0.0) + np.minimum(below, 0.0)))


def remodelling_of(case: Case) -> Remodelling | None:
    """The section `remodelling` of a case."""
    return case.added("remodelling", Remodelling)


def regions_of(case: Case) -> tuple[str, ...]:
    """Regions of a case that remodel."""
    law = remodelling_of(case)
    return tuple(law.regions or case.of_tissue("bone")) if law else ()
