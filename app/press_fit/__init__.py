"""Press fits: a stem without cement, after its insertion and under load.

`after_insertion` records pressure and strain of the bone at the end of the insertion, `findings`
has the faults and verdicts. Importing the package registers it. The core has what a press fit is:
the interference (`laws.interface_laws`) and the motion since it (`ContactState.jump_at_insertion`).
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from app.case.case import Case
from app.case.error_classes import MOTION_ERRORS, STRESS_ERRORS, TRACTION_ERRORS
from app.case.quantities import Quantity, add_quantity
from app.press_fit import findings as findings  # registers its checks
from app.results.records import RecordedModel, add_record

if TYPE_CHECKING:
    from app.press_fit.after_insertion import AfterInsertion


def _after_insertion(case: Case, followed: RecordedModel) -> AfterInsertion | None:
    """The record of a run, or None if nothing in its case is pressed in; collective."""
    contact = followed.problem.contact
    if contact is None or not contact.gaps.end_of_insertion > 0.5:  # stages end at whole times
        return None
    from app.press_fit.after_insertion import AfterInsertion  # starts MPI

    return AfterInsertion(case, followed)


add_record("after_insertion", _after_insertion)
_interface = partial(Quantity, "interfaces")
_region = partial(Quantity, "regions")
add_quantity(
    _interface(
        "insertion_pressure_mean",
        "MPa",
        label="pressure after the insertion, mean",
        error_class=TRACTION_ERRORS,
        on_page=True,
    ),
    _interface(
        "insertion_pressure_p95",
        "MPa",
        label="pressure after the insertion, p95",
        error_class=TRACTION_ERRORS,
        on_page=True,
    ),
    _interface(
        "insertion_pressure_max",
        "MPa",
        label="pressure after the insertion, max",
        peak=True,
        on_page=True,
    ),
    _interface(
        "insertion_gap_mean",
        "mm",
        "um",
        1,
        label="gap after the insertion, mean",
        error_class=MOTION_ERRORS,
    ),
    _interface(
        "insertion_gap_p95",
        "mm",
        "um",
        1,
        label="gap after the insertion, p95",
        error_class=MOTION_ERRORS,
    ),
    _interface(
        "insertion_open_fraction",
        "-",
        "%",
        0,
        label="open fraction of the area after the insertion",
    ),
    _region(
        "insertion_hoop_strain_p99",
        "-",
        "um/m",
        0,
        label="hoop strain after the insertion, p99",
        error_class=STRESS_ERRORS,
        on_page=True,
    ),
    _region(
        "insertion_hoop_strain_max",
        "-",
        "um/m",
        0,
        label="hoop strain after the insertion, max",
        peak=True,
        on_page=True,
    ),
    _region(
        "insertion_compressive_strain_p99",
        "-",
        "um/m",
        0,
        label="compressive strain after the insertion, p99",
        error_class=STRESS_ERRORS,
        on_page=True,
    ),
)
