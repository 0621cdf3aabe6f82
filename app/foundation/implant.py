"""A stem with its plug by numbers, as the keys of a case give it and a mesher takes it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from app.foundation.layout import alternatives

NECK_ANGLES = (100.0, 145.0)  # range of the angle between neck and shaft (deg)
LEAST_CELL_HEIGHT = 1.0  # mm: a rounded end or a void that is shorter has flat cells
SECTION = ("half_width", "half_depth", "corner_radius")


@dataclass(frozen=True, eq=False)  # arrays have no one truth
class Implant:
    """A stem with its plug, in the stem's axes: z along it, x towards its head.

    Sections are rounded rectangles, given at the tip and at `section_z`, and linear in z; of a stem
    from a file they are None. Levels are in the stem's axes, lengths in mm.

    Attributes:
        tip_z: Level of the tip.
        length: From the shoulder to the tip.
        section_z: Level of the proximal section.
        tip_rounding: Height of the rounded end, 0: flat.
        plug_length: Length of cement below the tip.
        tip_void: Length without cement or bone below the tip; the end is flat then.
        collar_thickness: Thickness of the collar on the neck cut; 0: none.
        collar_angle: Angle about the stem's axis over which it extends, half of it to each side of
            medial [rad].
        head_offset: Distance of the head's centre from the axis.
        head_height: Level of the head's centre.
        neck_angle: Angle between neck and stem [rad].
        cad: Shape of a stem from a file, as `meshes.stem_file.read` returns it; None for a stem by
            its numbers.
    """

    tip_z: float
    length: float
    section_z: float
    half_width: float
    half_depth: float
    corner_radius: float
    tip_half_width: float
    tip_half_depth: float
    tip_corner_radius: float
    neck_diameter: float
    neck_fillet: float
    trunnion_diameter: float
    head_offset: float
    head_height: float
    neck_angle: float
    tip_rounding: float
    plug_length: float
    tip_void: float
    collar_thickness: float = 0.0
    collar_angle: float = 0.0
    cad: Mapping[str, Any] | None = None

    @property
    def shoulder(self) -> float:
        """Level of the shoulder."""
        return self.tip_z + self.length

    @property
    def plug(self) -> float:
        """Level of the end of the cement plug."""
        return self.tip_z - self.plug_length

    @property
    def tip_height(self) -> float:
        """Height of the rounded end; 0: it is flat."""
        return 0.0 if self.tip_void else self.tip_rounding

    def section(self, z: float) -> tuple[float, float, float]:
        """Half-width, half-depth and corner radius at a level, of a file those of a square."""
        if self.cad is not None:
            half_width = float(self.cad["around"]) / 8
            return half_width, half_width, 0.0
        relative_height = (z - self.tip_z) / (self.section_z - self.tip_z)
        half_width, depth, corner = (
            (1.0 - relative_height) * getattr(self, f"tip_{name}")
            + relative_height * getattr(self, name)
            for name in SECTION
        )
        return half_width, depth, corner

    def faults(self, cement: float) -> Iterator[tuple[str, str]]:
        """Fields that cannot be meshed, with the reason; the section's level must be right.

        Args:
            cement: Least thickness of the mantle (mm); 0 without cement.
        """
        if 0.0 < self.tip_rounding < LEAST_CELL_HEIGHT:
            yield "tip_rounding", "must be 0 or at least 1 mm"
        if not NECK_ANGLES[0] <= math.degrees(self.neck_angle) <= NECK_ANGLES[1]:
            yield "neck_angle", "is not between {:g} and {:g} deg".format(*NECK_ANGLES)
        if self.cad is not None:
            return
        for end in ("", "tip_"):
            smaller_half = min(getattr(self, f"{end}half_width"), getattr(self, f"{end}half_depth"))
            if getattr(self, f"{end}corner_radius") >= smaller_half:
                message = f"is not below the half-width and half-depth, {smaller_half:g} mm"
                yield f"{end}corner_radius", message
        yield from self._degenerate(self.shoulder, "the shoulder", 0.0)
        below = "the end of the plug" if cement else f"{self.plug_length:g} mm below the tip"
        yield from self._degenerate(self.plug, below, cement)
        width = 2.0 * self.section(self.shoulder)[0]
        if self.neck_diameter > width:
            message = f"is wider than the stem's shoulder; expected at most {width:.3g} mm"
            yield "neck_diameter", message

    def _degenerate(self, z: float, level_name: str, offset: float) -> Iterator[tuple[str, str]]:
        """Fields of a section, extrapolated to a level, that has no width or no flats there.

        ``level_name`` is the level in words, ``offset`` the thickness around the section (mm).
        """
        sizes = {}
        for name, size in zip(SECTION, self.section(z), strict=True):
            rise = getattr(self, name) - getattr(self, f"tip_{name}")
            slope = rise / (self.section_z - self.tip_z)
            offset_factor = 1.0 if name == "corner_radius" else math.hypot(1.0, slope)
            sizes[name] = size + offset * offset_factor
        radius = sizes["corner_radius"]
        for name, size in sizes.items():
            if size <= 0.0 or (name != "corner_radius" and size <= radius):
                least = "0" if size <= 0.0 else f"the corner radius there, {radius:.3g} mm"
                # The end of the line at this level, and the other one.
                near, far = ("tip_", "") if z < self.tip_z else ("", "tip_")
                lower = [f"{far}{name}"] + [f"{near}corner_radius"] * (size > 0.0)
                with_cement = " with the cement" if offset else ""
                yield (
                    name,
                    f"is {size:.3g} mm{with_cement} at {level_name}, z = {z:g} mm; expected more"
                    f" than {least}. Raise {near}{name}, or reduce {alternatives(lower)}. (The size"
                    f" is linear: {getattr(self, name):.4g} mm at z = {self.section_z:.4g} mm,"
                    f" {getattr(self, f'tip_{name}'):.4g} mm at the tip, z = {self.tip_z:.4g} mm.)",
                )
