"""Axes of fibres that run through the region whose fibres follow them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.arrays import Floats
from app.case.case import Case
from app.laws.fibres import Circumferential
from app.soundness.loose_bodies import place
from meshes.pieces import Parts

# An axis this close to a cell, in parts of its size, touches it.
CLOSE = 1e-6


def on_axis(case: Case, found: Parts) -> list[str]:
    """What is wrong with the axes: where one meets a cell, its fibres have no direction."""
    errors = []
    for name, region in case.regions.items():
        for key, owner in (
            (f"regions.{name}", region),
            (f"regions.{name}.thermal", region.thermal),
        ):
            fibre = getattr(owner, "fibre", None)
            if not isinstance(fibre, Circumferential):
                continue
            cells = found.corners[name]
            met = cells[_met(found.x[cells], np.array(fibre.axis), np.array(fibre.through))]
            if len(met):
                errors.append(
                    f"{key}.fibre: its axis meets the region, e.g. at "
                    f"{place(found.x[met[0]].mean(axis=0))}, and fibres have no direction there; "
                    "expected an axis outside the region"
                )
    return errors


def _met(x: Floats, axis: Floats, through: Floats) -> NDArray[np.bool_]:
    """Which tetrahedra of corners (n, 4, 3) a line meets.

    Seen along the line, it is outside of a cell whose corners all lie on one side of it.
    """
    across = np.linalg.svd(axis[None])[2][1:]
    y, z = np.einsum("ki,nci->knc", across, x - through)
    angle = np.sort(np.arctan2(z, y), axis=1)
    between = np.diff(angle, axis=1, append=angle[:, :1] + 2 * np.pi)
    radius = np.hypot(y, z)
    near = radius.min(axis=1) <= CLOSE * radius.max(axis=1)
    return np.asarray(near | (between.max(axis=1) <= np.pi + CLOSE))
