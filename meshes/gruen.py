"""Gruen zones of the bone around a stem.

Frontal view: 1 to 3 lateral from proximal to distal, 4 distal to the tip, 5 to 7 medial from distal
to proximal (Gruen, McNeice and Amstutz, Clin Orthop 141 (1979) 17). Lateral view, in the same
order: 8 to 10 anterior, 11 distal to the tip, 12 to 14 posterior (Johnston et al., J Bone Joint
Surg 72-A (1990) 161). From memory, not verified against the originals.

Heights are thirds of the length of the stem in the bone, measured on its axis from the tip to the
neck cut. Bone above the cut counts to the proximal third. Zones 4 and 11 begin where the end of the
stem is rounded. On radiographs they reach down to the end of the picture. Here they end 20 mm below
the tip, about the length measured there by X-ray absorptiometry (a habit, not a standard). Zones
down to the distal cut would depend on the place of the cut. Bone below is in no zone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from app.foundation.arrays import Bools, Floats, Ints
from meshes import femur_stem
from meshes.geometry import is_radial
from meshes.placement import shoulder_level

if TYPE_CHECKING:
    from app.case.hips import Hip

BELOW_TIP = 20.0  # mm below the tip that belong to zones 4 and 11
RIM_HEIGHT = 10.0  # mm below the neck cut whose interfaces are reported apart
# Part of the surface of a stem without cement that no bone touches.
SHOULDER = "shoulder"
# Layered meshes put points on the planes between zones, where rounding must not decide [mm].
ROUNDING_OF_ZONE_BORDERS = 1e-6


class Zones:
    """Zones of a femur with a stem, or with a planned one, in the frame of the stem.

    Attributes:
        tip: Level of the stem's tip [mm].
        top: Level at which its axis leaves the bone [mm].
    """

    numbers = range(1, 15)
    regions = ("cortical_bone", "cancellous_bone")

    def __init__(self, geometry: Hip) -> None:
        self._geometry, self._local = geometry, geometry.placement.to_stem
        placement, implant = geometry.placement, geometry.implant
        self._normal = placement.normal @ placement.rotation
        self._level = self._normal[2] * placement.top
        self.tip = implant.tip_z
        self._end = self.tip + implant.tip_height
        self.top = min(placement.top, implant.shoulder)
        self._thickness = femur_stem.thickness(geometry.cement_thickness, self.tip, placement.top)

    def zones_at(self, x: Floats) -> Ints:
        """Frontal zone 1 to 7 and lateral zone 8 to 14 of points (n, 3) [mm], 0: none; (n, 2)."""
        x = self._local(x)
        third = np.floor(
            3 * (x[:, 2] - self.tip + ROUNDING_OF_ZONE_BORDERS) / (self.top - self.tip)
        )
        third = np.clip(third, 0, 2)[:, None].astype(np.int64)
        # Medial and anterior to the stem's axis; lateral in the one view is posterior in the other.
        medial, anterior = (
            (x[:, :1] >= -ROUNDING_OF_ZONE_BORDERS),
            (x[:, 1:2] >= -ROUNDING_OF_ZONE_BORDERS),
        )
        frontal = np.where(medial, 5 + third, 3 - third)
        lateral = np.where(anterior, 10 - third, 12 + third)
        zones = np.concatenate([frontal, lateral], axis=1)
        zones[x[:, 2] < self._end + ROUNDING_OF_ZONE_BORDERS] = (4, 11)
        zones[x[:, 2] < self.tip - BELOW_TIP + ROUNDING_OF_ZONE_BORDERS] = 0
        return zones

    def depth(self, x: Floats) -> Floats:
        """Distance of points (n, 3) below the plane of the neck cut (n,) [mm]."""
        return np.asarray(self._level - self._local(x) @ self._normal)

    def thickness(self, x: Floats) -> Floats:
        """Nominal thickness of the mantle at points (n, 3); (n,) [mm]."""
        x = self._local(x)
        return self._thickness(np.arctan2(x[:, 1], x[:, 0]), x[:, 2])

    def borders(self, x: Floats) -> dict[str, Floats]:
        """Return levels of points (n, 3) by part (n,), not positive in it [mm].

        The height above the stem's end, and the depth below the rim. No bone touches the shoulder
        of a stem without cement.
        """
        levels = {} if self._geometry.is_cemented else {SHOULDER: self._shoulder_level(x)}
        levels["tip"] = self._local(x)[:, 2] - self._end - ROUNDING_OF_ZONE_BORDERS
        levels["rim"] = self.depth(x) - RIM_HEIGHT
        return levels

    def _shoulder_level(self, x: Floats) -> Floats:
        geometry = self._geometry
        return shoulder_level(geometry.implant, geometry.placement, x) - ROUNDING_OF_ZONE_BORDERS

    def touches(self, x: Floats) -> Bools:
        """Mask of the points (n, 3) of a stem's surface that bone or cement can touch (n,)."""
        if self._geometry.is_cemented:
            return np.ones(len(x), dtype=bool)
        return np.asarray(self._shoulder_level(x) > -2 * ROUNDING_OF_ZONE_BORDERS)

    def is_left(self, x: Floats) -> Bools:
        """Mask of the points (n, 3) [mm] of bone that the planned operation leaves (n,)."""
        geometry = self._geometry
        bone = geometry.femur
        if geometry.implant.cad is not None or not is_radial(bone):
            # The bone around such a stem is what the operation leaves.
            return np.ones(len(x), dtype=bool)
        canal = bone.endosteum(np.arctan2(x[:, 1], x[:, 0]), x[:, 2])
        x = self._local(x)
        z, r = x[:, 2], np.hypot(x[:, 0], x[:, 1])
        theta = np.arctan2(x[:, 1], x[:, 0])
        cavity = femur_stem.shaft_of(geometry.implant).outside(self._thickness, theta, z)
        if geometry.is_cemented:
            # The mantle ends at the endosteum; a stem without cement takes some of the cortex.
            cavity, end_level = np.minimum(cavity, canal), geometry.implant.plug
        else:
            end_level = geometry.implant.tip_z - geometry.implant.tip_void
        below_end = z < end_level + ROUNDING_OF_ZONE_BORDERS
        below_cut = x @ self._normal <= self._level + ROUNDING_OF_ZONE_BORDERS
        return np.asarray(below_cut & ((r >= cavity - ROUNDING_OF_ZONE_BORDERS) | below_end))
