"""Mass of the bone that remodels, of all and by Gruen zone.

Arrays are by vertex of this rank, ghosts too, and region (n, r).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypedDict

import numpy as np

from app.foundation.arrays import Floats
from app.mechanics.body_forms import linear_shape_functions
from app.results.hip import zone_integrals
from app.results.records import Record, RecordedModel

# Mass of 1 mm3 of 1 g/cm3 [g].
GRAM = 1e-3


class RemodellingNumbers(TypedDict):
    """Section ``remodelling`` of ``summary.json``.

    Attributes:
        seconds: Time of remodelling [s].
        steps: Number of its steps.
        mass: Mass [g] at ``start`` and ``end``, ``added`` and ``cut`` mass, and the relative
            defect ``audit`` of their balance [-].
    """

    seconds: float
    steps: int
    mass: dict[str, float]


class ZoneNumbers(TypedDict):
    """Numbers of a zone in section ``gruen`` of ``summary.json``.

    Attributes:
        bone_mass_change: Relative change of mass, of ``all`` bone and by region [-].
    """

    bone_mass_change: dict[str, float]


class BoneMass(Record):
    """Bone that remodels; made and called collectively.

    Attributes:
        problem: The mechanical problem, which has the density.
        forms: Forms of its bodies.
        stresses: Strain energy at points of the cells.
        volume: Integrals of the hat functions of the vertices (n, r) [mm3].
        mass: Mass at the start, added, and cut at the bounds of density [g].
        seconds: Time in which it has remodelled so far [s].
        steps: Number of steps so far.
    """

    saved = ("mass", "seconds", "steps")

    def __init__(self, mechanics: RecordedModel) -> None:
        self.problem = mechanics.problem
        self.forms = mechanics.problem.body_forms
        self.stresses = mechanics.stresses
        self._zones = mechanics.zones
        self.volume = self.integrals(lambda region: 1.0)
        self.mass = {"start": self.present, "added": 0.0, "cut": 0.0}
        self.seconds = 0.0
        self.steps = 0

    def integrals(self, density: Callable[[str], Floats | float]) -> Floats:
        """Integrals of a region's density (cells, points) times the hat functions of vertices."""
        forms, stresses = self.forms, self.stresses
        cells = {
            r: density(r)
            * stresses.points_and_volumes(r)[1]
            @ linear_shape_functions(stresses.points_of_region[r])
            for r in forms.density_regions
        }
        return np.array([forms.vertex_sums(forms.vertices(r), sums) for r, sums in cells.items()]).T

    @property
    def present(self) -> float:
        """Mass of the bone that remodels [g]; collective."""
        return self.grams(self.forms.density)

    def grams(self, density: Floats) -> float:
        """Mass of a density (n, r) [g]; collective."""
        owned = self.forms.scalars.dofmap.index_map.size_local
        local = float((self.volume * density)[:owned].sum())
        return GRAM * float(self.problem.comm.allreduce(local))

    def changes(self) -> dict[int, dict[str, float]]:
        """Relative change of mass since the start by zone: ``all``, then by region; collective."""
        forms, stresses, zones = self.forms, self.stresses, self._zones
        if zones is None:
            return {}
        masses = []
        for density in (forms.density_at_start, forms.density):
            densities = {
                region: forms.density_at(region, stresses.points_of_region[region], density)
                for region in forms.density_regions
            }
            masses.append(
                [
                    zone_integrals(self.problem, stresses, region, zones, rho)[0]
                    for region, rho in densities.items()
                ]
            )
        rows = [("all", *map(sum, masses)), *zip(forms.density_regions, *masses, strict=True)]
        return {
            zone: {
                name: float(masses_after[zone] / masses_before[zone] - 1)
                for name, masses_before, masses_after in rows
                if masses_before[zone]
            }
            for zone in zones.numbers
        }

    # Numbers and columns

    def numbers(self) -> dict[str, Any]:
        """Sections ``remodelling`` and ``gruen`` of the state last committed; collective."""
        mass = self.mass | {"end": self.present}
        mass["audit"] = (mass["end"] - sum(self.mass.values())) / mass["start"]
        remodelling: RemodellingNumbers = {
            "seconds": self.seconds,
            "steps": self.steps,
            "mass": mass,
        }
        zones: dict[str, ZoneNumbers] = {
            str(zone): {"bone_mass_change": change}
            for zone, change in self.changes().items()
            if change
        }
        return {"remodelling": remodelling} | ({"gruen": zones} if zones else {})

    def step_record(self) -> dict[str, float]:
        """Columns of ``history.csv`` after a step; collective."""
        columns = {"remodelled [s]": self.seconds, "bone mass [g]": self.present}
        for zone, change in self.changes().items():
            if change:
                columns[f"zone {zone} bone mass change [-]"] = change["all"]
        return columns
