"""Section loads of a femur: force and moment that a cut across the shaft transmits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.case.case import Case
from app.case.hips import Hip
from app.foundation import layout
from app.laws.values import amplitude

# The highest level [mm], below the insertions at the greater trochanter.
TOP = 25.0
# Number of levels.
LEVEL_COUNT = 10
# Level of the knee [mm], 404 mm below the head; its centre is about on the axis of the shaft.
KNEE = -350.0


@dataclass(frozen=True)
class SectionLoad:
    """Resultant of the loads on the femur above a level; only of loads that name their point.

    Attributes:
        z: The level [mm].
        force: Sum of the loads (3,) [N].
        moment: Their moment about the shaft's axis at the level (3,) [N mm].
        medial_of_shaft: Place where the line of action of the sum, seen from the front, crosses the
            level [mm]; None without axial force.
        medial_of_head: The same from the centre of the head [mm].
    """

    z: float
    force: tuple[float, ...]
    moment: tuple[float, ...]
    medial_of_shaft: float | None
    medial_of_head: float | None


def section_loads(case: Case, time: float) -> list[SectionLoad]:
    """Section loads at ten levels and at the knee, where all loads act; none without such loads."""
    geometry = case.geometry
    loads = [
        (load.history, load.resultant, load.point)
        for load in case.loads.values()
        if load.point and load.resultant
    ]
    if not (isinstance(geometry, Hip) and loads):
        return []
    F = np.array([np.multiply(force, amplitude(history, time)) for history, force, _ in loads])
    x = np.array([point for *_, point in loads])
    sections = []
    for z in [*map(float, np.linspace(TOP, geometry.level, LEVEL_COUNT)), KNEE]:
        above = x[:, 2] > z
        force = F[above].sum(axis=0).tolist()
        moment = np.cross(x[above] - [0.0, 0.0, z], F[above]).sum(axis=0).tolist()
        medial = -moment[1] / force[2] if force[2] else None
        offset = None if medial is None else medial - geometry.head_centre[0]
        sections.append(SectionLoad(z, tuple(force), tuple(moment), medial, offset))
    return sections


def table_of_section_loads(sections: list[SectionLoad]) -> str:
    """Section loads as a text table, moments in N m."""
    # The last two: where the line of action of the force passes.
    head = ["z", "force x", "y", "z", "moment x", "y", "z", "line medial of shaft", "of head"]
    units = ["mm", *["N"] * 3, *["N m"] * 3, "mm", "mm"]
    rows = [
        [f"{s.z:.0f}", *(f"{f:z.0f}" for f in s.force), *(f"{m / 1e3:z.1f}" for m in s.moment)]
        + ["-" if v is None else f"{v:.0f}" for v in (s.medial_of_shaft, s.medial_of_head)]
        for s in sections
    ]
    return layout.text_table(head, rows, units)
