"""Pressure and gap of a stem, and strain of the bone around it, at the end of the insertion."""

from __future__ import annotations

import numpy as np

from app.case.case import Case
from app.case.summary import Numbers, Summary
from app.foundation.arrays import Bools, Floats
from app.mechanics.contact import TrialState
from app.results.interface_numbers import ContactSamples
from app.results.percentiles import percentile
from app.results.records import Record, RecordedModel
from app.results.surface_parts import in_parts
from app.stepping.load_steps import LoadStep, OnStep

# Numbers of an interface that are published.
OF_INTERFACE = (
    *("pressure_mean", "pressure_p95", "pressure_max"),
    *("gap_mean", "gap_p95", "open_fraction"),
)


def _of_insertion(numbers: Numbers) -> Numbers:
    """Numbers of an interface and its zones, under their names after the insertion."""
    renamed: Numbers = {f"insertion_{key}": numbers[key] for key in OF_INTERFACE}
    zones = {name: _of_insertion(zone) for name, zone in numbers.get("zones", {}).items()}
    return renamed | ({"zones": zones} if zones else {})


class AfterInsertion(Record):
    """Numbers of interfaces and bone when the interference has grown."""

    saved = ("numbers_at_insertion",)

    def __init__(self, case: Case, followed: RecordedModel) -> None:
        self._followed = followed
        problem = followed.problem
        elastic = {e.region for e in problem.scene.elastic}
        elastic -= problem.body_forms.path_dependent_regions
        self._bone = sorted(elastic.intersection(case.of_tissue("bone")))
        self.numbers_at_insertion: Summary = {}

    def before(self, on_step: OnStep) -> OnStep:
        """Return a hook of steps that keeps the numbers of the last step of the insertion."""

        def step(accepted: LoadStep, trial: TrialState | None) -> None:
            contact = self._followed.problem.contact
            assert contact is not None
            at_end = abs(accepted.time - contact.gaps.end_of_insertion) < 1e-6
            if at_end and trial is not None:
                self.numbers_at_insertion = {
                    "interfaces": self._interfaces(trial),
                    "regions": self._strains(),
                }
            on_step(accepted, trial)

        return step

    def numbers(self) -> Summary:
        """Pressures and gaps of interfaces, strains of bone."""
        return self.numbers_at_insertion

    def _interfaces(self, trial: TrialState) -> dict[str, Numbers]:
        """Pressures and gaps of the press fits after a step; collective."""
        problem, zones = self._followed.problem, self._followed.zones
        surface = trial.contact.points.surface
        levels = zones.borders(surface.x) if zones else {}
        interfaces = problem.scene.parting_interfaces
        surface_parts = in_parts(surface, [c.name for c in interfaces], levels)
        numbers = ContactSamples(problem, trial, None, surface_parts).numbers
        pressed = [c.name for c in interfaces if c.press_fit]
        return {name: _of_insertion(numbers[name]) for name in pressed}

    def _strains(self) -> dict[str, Numbers]:
        """Strains of each region of bone beside the stem; collective."""
        strains: dict[str, Numbers] = {}
        for region in self._bone:
            stresses = self._followed.stresses
            x, volume = stresses.points_and_volumes(region)
            hoop = stresses.hoop_strain(region).ravel()
            compressive = stresses.compressive_strain(region).ravel()
            *values, weight, beside = stresses.gather(
                np.stack([hoop, compressive, volume.ravel(), self._beside(x)])
            )
            rows = beside > 0
            if rows.any():
                hoop, compressive = (strain[rows] for strain in values)
                strains[region] = {
                    "insertion_hoop_strain_p99": percentile(hoop, weight[rows]),
                    "insertion_hoop_strain_max": float(hoop.max()),
                    "insertion_compressive_strain_p99": percentile(compressive, weight[rows]),
                }
        return strains

    def _beside(self, x: Floats) -> Bools:
        """True at points (n, 3) between the levels of the stem's tip and of the neck cut (n,)."""
        zones = self._followed.zones
        if zones is None:
            return np.ones(len(x), dtype=bool)
        return np.asarray((zones.borders(x)["tip"] > 0) & (zones.depth(x) > 0))
