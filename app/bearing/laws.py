"""Wear of contact with finite sliding: its key."""

from __future__ import annotations

from typing import Annotated

from app.laws.contact_laws import Contact
from app.laws.interface_laws import InterfaceLaw
from app.schema.section import add_key
from app.schema.units import Dimension

_WEAR = Dimension("mm^2/N", "a wear coefficient", "1.07e-6 mm^3/(N m)", above=0.0)
WearCoefficient = Annotated[float, _WEAR]

add_key(
    Contact,
    "wear_coefficient",
    WearCoefficient,
    "Worn volume per force and slid distance (Archard), where `sliding` is finite.",
)


def wear_coefficient_of(law: InterfaceLaw) -> float | None:
    """The wear coefficient of a law [mm2/N]; None without wear."""
    return law.added("wear_coefficient", float)
