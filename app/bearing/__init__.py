"""Bearings: friction, wear and heat through the cycles of finite sliding.

`head_cup` is the geometry of a head in its cup; `head_cup_mesh` meshes it. `laws` has the key of
wear. `friction_cycles` records torque, slid distance and wear. `cycle_heat` sets the mean heat of a
cycle. `findings` has the faults and verdicts. Importing the package registers it. The core, which
pairs and solves finite sliding, does not know it.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import TYPE_CHECKING

from app.bearing import findings as findings  # registers its checks
from app.bearing import head_cup as head_cup  # registers the geometry
from app.case.case import Case
from app.case.error_classes import MOTION_ERRORS, TRACTION_ERRORS
from app.case.quantities import InterfaceField, Quantity, add_interface_field, add_quantity
from app.results.records import RecordedModel, add_record
from app.scene.scene import mean_exchange

if TYPE_CHECKING:
    from app.bearing.cycle_heat import CycleHeat
    from app.bearing.friction_cycles import Bearings


def _bearings(case: Case, followed: RecordedModel) -> Bearings | None:
    """The record of a run, or None without finite sliding; collective."""
    if not any(law.finite_sliding for law in case.interfaces.values()):
        return None
    from app.bearing.friction_cycles import Bearings  # starts MPI

    return Bearings(followed.problem, case)


def _cycle_heat(case: Case, followed: RecordedModel) -> CycleHeat | None:
    """The heat of a run, or None if none flows between sides with finite sliding; collective."""
    if followed.heat is None or not followed.problem.scene.sliding_heat:
        return None
    from app.bearing.cycle_heat import CycleHeat  # starts MPI

    return CycleHeat(followed.problem, followed.heat)


@mean_exchange
def _exchanging(case: Case) -> Iterable[str]:
    """Interfaces whose exchange `CycleHeat` sets."""
    return [name for name, law in case.interfaces.items() if law.finite_sliding]


add_record("bearings", _bearings)
add_record("cycle_heat", _cycle_heat)
add_interface_field(
    InterfaceField("wear", "wear in a million cycles", "mm", 1e6, loaded=True),
    InterfaceField("slid", "slid in a cycle", "mm"),
)
_interface = partial(Quantity, "interfaces")
add_quantity(
    # Finite sliding, at the end and over a cycle.
    _interface("torque", "N mm", error_class=MOTION_ERRORS, vector=True),
    _interface(
        "torque_size", "N mm", digits=1, label="torque, magnitude", error_class=MOTION_ERRORS
    ),
    _interface(
        "torque_along",
        "N mm",
        digits=1,
        label="friction torque along the motion",
        error_class=MOTION_ERRORS,
        step_record=True,
        curve=True,
    ),
    _interface(
        "torque_max",
        "N mm",
        digits=1,
        label="torque, max",
        error_class=MOTION_ERRORS,
        headline=True,
        on_page=True,
        sentence="{name}: largest friction torque of a cycle {torque_max}",
        caption="largest friction torque of {name}",
    ),
    _interface(
        "centre", "mm", label="displacement of the master", error_class=MOTION_ERRORS, vector=True
    ),
    _interface(
        "eccentricity",
        "mm",
        "um",
        1,
        label="displacement of the master, magnitude",
        error_class=MOTION_ERRORS,
        step_record=True,
        curve=True,
        on_page=True,
    ),
    _interface(
        "pressure_max_at", "mm", label="position of the largest pressure", exact=True, vector=True
    ),
    _interface(
        "dissipation_cycle",
        "N mm",
        label="dissipation in a cycle",
        error_class=MOTION_ERRORS,
        on_page=True,
        sentence="{name}: energy dissipated in a cycle {dissipation_cycle}, "
        "largest sliding distance {slid_max}",
        caption="friction energy of {name} in a cycle",
    ),
    _interface(
        "slid_max", "mm", label="slid in a cycle, max", error_class=MOTION_ERRORS, on_page=True
    ),
    _interface("slid_mean", "mm", label="slid in a cycle, mean", error_class=MOTION_ERRORS),
    _interface(
        "slid_max_master", "mm", label="slid in a cycle, max, master", error_class=MOTION_ERRORS
    ),
    # Wear by a cycle, and by a million of them.
    _interface(
        "wear_volume",
        "mm^3",
        digits=9,
        label="wear in a cycle, volume",
        error_class=MOTION_ERRORS,
        sentence="{name}: wear in a million cycles {wear_volume_million}, "
        "depth {wear_depth_max_million} (max), {wear_depth_p99_million} (p99)",
    ),
    _interface(
        "wear_depth_max",
        "mm",
        digits=9,
        label="wear in a cycle, depth, max",
        error_class=TRACTION_ERRORS,
        peak=True,
    ),
    _interface(
        "wear_depth_p99",
        "mm",
        digits=9,
        label="wear in a cycle, depth, p99",
        error_class=TRACTION_ERRORS,
    ),
    _interface(
        "wear_depth_max_master",
        "mm",
        digits=9,
        label="wear in a cycle, depth, max, master",
        error_class=TRACTION_ERRORS,
        peak=True,
    ),
    _interface(
        "wear_depth_p99_master",
        "mm",
        digits=9,
        label="wear in a cycle, depth, p99, master",
        error_class=TRACTION_ERRORS,
    ),
    _interface(
        "wear_volume_million",
        "mm^3",
        label="wear in a million cycles, volume",
        error_class=MOTION_ERRORS,
        headline=True,
        on_page=True,
        caption="wear of {name} in a million cycles",
        detail="99 % of the surface wears by less than {wear_depth_p99_million}.",
    ),
    _interface(
        "wear_depth_max_million",
        "mm",
        label="wear in a million cycles, depth, max",
        error_class=TRACTION_ERRORS,
        peak=True,
    ),
    _interface(
        "wear_depth_p99_million",
        "mm",
        label="wear in a million cycles, depth, p99",
        error_class=TRACTION_ERRORS,
        headline=True,
        on_page=True,
    ),
    _interface(
        "wear_depth_max_master_million",
        "mm",
        label="wear in a million cycles, depth, max, master",
        error_class=TRACTION_ERRORS,
        peak=True,
    ),
    _interface(
        "wear_depth_p99_master_million",
        "mm",
        label="wear in a million cycles, depth, p99, master",
        error_class=TRACTION_ERRORS,
        on_page=True,
    ),
    # Coverage and heat of finite sliding.
    _interface(
        "uncovered_fraction",
        "-",
        "%",
        1,
        label="fraction of the slave off the master",
        exact=True,
        sentence="{name}: {uncovered_fraction} of the slave surface left the master at some time",
    ),
    _interface("friction_power", "W", digits=3, error_class=MOTION_ERRORS, on_page=True),
    _interface(
        "temperature_swing",
        "K",
        label="temperature range in a cycle",
        error_class=TRACTION_ERRORS,
    ),
)
