"""Checks of landmarks that a case gives: each must be at its place on the surface of the bone."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from app.foundation.arrays import Floats, unit_vectors
from app.foundation.errors import GeometryError
from app.patient.bone_surface import BoneSurface

# Largest distance of a landmark from the surface on which it is [mm]. Detected ones are within 1.4.
MOST_FROM_SURFACE = 10.0
# Least depth of the head's centre below the surface [mm]: half the radius of the smallest head.
LEAST_HEAD_DEPTH = 7.0
# Distance of the head's centre from that of the sphere that fits the head, above which a note is
# given [mm].
NOTED_HEAD_DISTANCE = 5.0
# Largest angle between the shaft and the long axis of the surface [deg].
MOST_TURNED = 45.0
# Level of the shaft below the head's centre at which its axis must be in the bone, in radii of the
# head: that of the lesser trochanter.
SHAFT_LEVEL = 1.75
# Signs of axes to left and posterior, as image software writes them, over those to right and
# anterior.
OTHER_SIGNS = np.array([-1.0, -1.0, 1.0])


class GivenLandmarks:
    """Landmarks that a case gives, and their places relative to the surface.

    Attributes:
        names: Names of those that are given.
        doubts: Names of those that are unusual, and notes on them.
    """

    def __init__(self, surface: BoneSurface, given: dict[str, Any]) -> None:
        """Keep the landmarks of a surface.

        Args:
            surface: The bone, in the axes of its file.
            given: The landmarks by name, and other keys of `landmarks.find_landmarks`.
        """
        self._surface, self._given = surface, given
        self.names = tuple(name for name in given if name != "side")
        self.doubts = list[tuple[str, str]]()

    def check_head(self, found: Floats) -> None:
        """Check the centre of the head against that of the sphere that fits it (3,) [mm].

        Raises:
            GeometryError: It is not inside the bone.
        """
        centre = np.array(self._given["head_centre"])
        depth = self._depth(centre)
        if depth < LEAST_HEAD_DEPTH:
            where = f"{abs(depth):.0f} mm {'below' if depth > 0 else 'outside'} the bone's surface"
            raise _refusal(
                "head_centre",
                centre,
                f"{where}; expected at least {LEAST_HEAD_DEPTH:g} mm below it",
                lambda x: self._depth(x) >= LEAST_HEAD_DEPTH,
            )
        distance = float(np.linalg.norm(centre - found))
        if distance > NOTED_HEAD_DISTANCE:
            doubt = f"it is {distance:.0f} mm from the centre of the sphere that fits the head,"
            self.doubts.append(("head_centre", f"{doubt} {_text(found)}; is it right?"))

    def check_shaft(self, head: Floats, radius: float, up: Floats) -> None:
        """Check the axis of the shaft against an estimate.

        Args:
            head: Centre of the head (3,) [mm].
            radius: Its radius [mm].
            up: Unit vector along the surface, proximal (3,).

        Raises:
            GeometryError: Its direction is another one, or it passes beside the bone.
        """
        distal, proximal = (np.array(point) for point in self._given["shaft"])
        if not np.any(proximal - distal):
            raise GeometryError(
                "geometry.landmarks.shaft: its points are equal; expected two points of the"
                " shaft's axis, the distal one first"
            )
        axis = unit_vectors(proximal - distal)
        angle = math.degrees(math.acos(max(-1.0, min(1.0, float(axis @ up)))))
        if angle > MOST_TURNED:
            raise GeometryError(
                f"geometry.landmarks.shaft: the given axis deviates by {angle:.0f} deg from the"
                f" bone's long axis; expected at most {MOST_TURNED:g} deg. Give the distal point"
                " first"
            )

        def at_trochanter(point: Floats, direction: Floats) -> Floats:
            """Point of a line at the level of the lesser trochanter (3,) [mm]."""
            height = (head - SHAFT_LEVEL * radius * up - point) @ up
            return np.asarray(point + height / float(direction @ up) * direction)

        def is_near(x: Floats) -> bool:
            """True if a line with other signs, through a point, passes through the bone."""
            other_axis = axis * OTHER_SIGNS
            return bool(other_axis @ up > 0) and self._is_near(at_trochanter(x, other_axis))

        place = at_trochanter(proximal, axis)
        if not self._is_near(place):
            raise _refusal(
                "shaft",
                proximal,
                f"on a line that passes the bone at a distance of {-self._depth(place):.0f} mm;"
                " expected two points of the shaft's axis",
                is_near,
            )

    def check_trochanter(
        self, axis_point: Floats, up: Floats, head: Floats, depths: tuple[float, float]
    ) -> None:
        """Check the lesser trochanter: on the surface, on the side of the head, below it.

        Args:
            axis_point: Point of the shaft's axis (3,) [mm].
            up: Direction of the axis, proximal (3,).
            head: Centre of the head (3,) [mm].
            depths: Usual range of its distance below the head's centre [mm].

        Raises:
            GeometryError: It is not on the surface, or on the other side.
        """
        apex = np.array(self._given["lesser_trochanter"])
        to_head = head - axis_point
        medial = unit_vectors(to_head - (to_head @ up) * up)

        def is_right(x: Floats) -> bool:
            """True if a point is near the surface, on the side of the head."""
            is_medial = (x - axis_point) @ medial > 0
            return bool(is_medial and self._distance(x) <= MOST_FROM_SURFACE)

        distance = self._distance(apex)
        if distance > MOST_FROM_SURFACE:
            fault = f"{distance:.0f} mm from the bone's surface"
            fault += f"; expected at most {MOST_FROM_SURFACE:g} mm"
            raise _refusal("lesser_trochanter", apex, fault, is_right)
        if not is_right(apex):
            lateral = -float((apex - axis_point) @ medial)
            fault = f"{lateral:.0f} mm lateral of the shaft's axis; expected the side of the head"
            raise _refusal("lesser_trochanter", apex, fault, is_right)
        depth, (least, largest) = float((head - apex) @ up), depths
        if not least <= depth <= largest:
            doubt = f"it is {depth:.0f} mm below the head's centre along the shaft; expected"
            doubt += f" {least:.0f} to {largest:.0f} mm. Is it right?"
            self.doubts.append(("lesser_trochanter", doubt))

    def check_condyles(self, up: Floats) -> None:
        """Check the points of the condyles that are not below the surface, by its proximal axis.

        Raises:
            GeometryError: One is not on the surface.
        """
        lowest = float((self._surface.points @ up).min())
        for point in self._given["condyles"]:
            x = np.array(point)
            distance = self._distance(x)
            if x @ up > lowest and distance > MOST_FROM_SURFACE:
                raise _refusal(
                    "condyles",
                    x,
                    f"{distance:.0f} mm from the bone's surface; expected at most"
                    f" {MOST_FROM_SURFACE:g} mm",
                    self._is_near,
                )

    def _is_near(self, x: Floats) -> bool:
        """True if a point is in the bone or near its surface."""
        return self._depth(x) > -MOST_FROM_SURFACE

    def _distance(self, x: Floats) -> float:
        """Distance of a point from the corners and centres of the triangles [mm]."""
        return float(self._tree.query(x)[0])

    def _depth(self, x: Floats) -> float:
        """Depth of a point below the surface [mm]; outside the bone it is negative."""
        a, b, c = (self._surface.corners - x).transpose(1, 0, 2)
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        volume = (a * np.cross(b, c)).sum(axis=1)
        scale = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
        # Solid angles of the triangles: 4 pi in all from inside, 0 from outside.
        is_inside = 2.0 * float(np.arctan2(volume, scale).sum()) > 2.0 * math.pi
        return self._distance(x) if is_inside else -self._distance(x)

    @cached_property
    def _tree(self) -> Any:
        """Tree of the corners and of the centres of the triangles."""
        return cKDTree(np.concatenate([self._surface.points, self._surface.corners.mean(axis=1)]))


def _refusal(name: str, x: Floats, fault: str, is_right: Callable[[Floats], bool]) -> GeometryError:
    """Return the error on a point, with a hint if it is right with other signs of x and y."""
    other = x * OTHER_SIGNS
    remedy = "Give mm in the axes of the bone's file"
    if is_right(other):
        remedy = (
            f"{_text(other)} would be right: image software such as 3D Slicer may give coordinates"
            " to left and posterior (LPS); change the signs of x and y"
        )
    return GeometryError(f"geometry.landmarks.{name}: {_text(x)} is {fault}. {remedy}")


def _text(x: Floats) -> str:
    """A point in words."""
    return "({:.4g}, {:.4g}, {:.4g}) mm".format(*x)
