"""All experiments, by name."""

from __future__ import annotations

from app.validation import bearings, cement, femora, interfaces

EXPERIMENTS = {
    experiment.name: experiment
    for experiment in (
        cement.BENDING_CREEP,
        bearings.SIMULATOR_TORQUE,
        bearings.ROCKING_TORQUE,
        bearings.WEAR_SIZE,
        interfaces.PUSH_OUT,
        interfaces.PLUGS,
        interfaces.SECTIONS,
        cement.RESURFACING,
        femora.COMPOSITE_STRAIN,
        femora.COMPOSITE_BOND,
        interfaces.RODS,
        cement.DISC,
        cement.MANTLE,
        interfaces.SLAB,
    )
}
