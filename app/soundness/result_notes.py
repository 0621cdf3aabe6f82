"""Doubts about numbers of a solved case: strains that are not small, laws beyond their range."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

from app.case.case import Case
from app.case.summary import Summary
from app.case.summary_numbers import maximum_with_parts
from app.foundation.layout import two_digits
from app.foundation.verdict import Verdict, note
from app.laws.materials import Material

# Strain above which small-strain elasticity holds for no material.
STRAIN = 0.05

ResultNote = Callable[[Case, Summary], Iterable[Verdict]]
# Functions of other packages that return notes on the numbers of a case.
_RESULT_NOTES: list[ResultNote] = []


def result_note(function: ResultNote) -> ResultNote:
    """Register a function of a case and its numbers (``summary.json``) that returns notes."""
    _RESULT_NOTES.append(function)
    return function


def of_results(case: Case, numbers: Summary) -> list[Verdict]:
    """Return notes on results: large strains, stresses beyond a law's range, creep at order 1."""
    notes = [verdict for result_note in _RESULT_NOTES for verdict in result_note(case, numbers)]
    for name, q in numbers["regions"].items():
        creep = case.regions[name].creep
        if "creep_strain_max" in q and case.mesh.order == 1:
            message = "creep does not change the volume, and linear cells are then too stiff"
            notes.append(note(message, f"region '{name}'", "use mesh.order: 2"))
        lowest_stress, highest_stress = (creep and creep.stresses) or (0.0, math.inf)
        if "creep_strain_max" in q and not lowest_stress <= q["von_mises_p99"] <= highest_stress:
            message = (
                f"creeps at {two_digits(q['von_mises_p99'])} MPa (von Mises p99), but its law was"
                f" measured from {lowest_stress:g} to {highest_stress:g} MPa"
            )
            notes.append(note(message, f"region '{name}'"))
        E = smallest_modulus(case.regions[name])
        strain = maximum_with_parts(q, "von_mises_p99") / E if E else 0.0
        if strain > STRAIN:
            message = (
                f"is strained by {two_digits(100 * strain)} % (stress over modulus), which is not"
                " small: results are not valid there"
            )
            remedy = "check the units of moduli and loads"
            notes.append(note(message, f"region '{name}'", remedy))
    return notes


def smallest_modulus(region: Material) -> float:
    """Smallest Young's modulus of a region, 0 if it has none [MPa]."""
    return float(min(region.moduli, default=0.0))
