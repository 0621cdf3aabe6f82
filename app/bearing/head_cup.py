"""A head in the cup of a total hip: parameters, and names of regions, boundaries, interfaces."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal

from pydantic import model_validator

from app.case.shapes import MeshOptions, Point3, Shape, Sides, graded_cells
from app.schema.section import fail
from app.schema.units import Angle, Dimension, Plain, PositiveLength

_AtLeast0 = Annotated[float, Dimension("mm", "a length", "0.1 mm", at_least=0.0)]
# Least and largest angle of cover of the cup [deg].
COVER = (29.999, 120.001)
# Largest distance of the bore from the head's centre, as a fraction of the head's radius.
NEAR = 0.9
# Largest edge of cells over the diameter of the head.
ROUND = 0.5


class HeadCup(Shape):
    """A head in the cup of a total hip, meshed apart; the head's centre is the origin.

    In a left hip x points medially, y anteriorly and z proximally. The pole of the cup, its deepest
    point, is proximal, medial and (by the version) posterior of the centre: a force along +z
    presses the head into the cup. The head's bore opens at the opposite side.
    """

    mesher: ClassVar[str] = "app.bearing.head_cup_mesh"
    has_curved_surfaces: ClassVar[bool] = True
    sliding_boundaries: ClassVar[dict[str, tuple[str, str]]] = {
        "bearing": ("head_surface", "liner_inner")
    }
    points: ClassVar[dict[str, Point3]] = {"head_centre": (0.0, 0.0, 0.0)}

    kind: Literal["head_cup"] = "head_cup"
    head_diameter: PositiveLength
    """Diameter of the head."""
    radial_clearance: _AtLeast0
    """Radius of the cup's bearing less that of the head: half of the difference of diameters."""
    liner_thickness: PositiveLength
    """Thickness of the liner."""
    shell_thickness: _AtLeast0 = 0.0
    """Thickness of the metal shell around the liner; without one the boundary is `liner_outer`."""
    cover_angle: Angle = math.pi / 2
    """Angle (rad) between the cup's pole and its rim, which is plane, 30 to 120 deg; 90 deg is half
    a sphere."""
    inclination: Angle = math.radians(45.0)
    """Angle (rad) between the cup's axis and z, seen along y (radiographic)."""
    version: Angle = math.radians(20.0)
    """Angle (rad) between the cup's axis and the plane xz; positive opens anteriorly."""
    bore_diameter: PositiveLength = 13.0
    """Diameter of the head's bore at its opening."""
    bore_depth: PositiveLength = 16.0
    """Depth of the bore along its axis."""
    bore_taper: Angle = math.radians(2.85)
    """Half-angle (rad) by which the bore narrows; that of a 12/14 taper by default."""
    head_size: Annotated[float, Plain(at_least=0.25, at_most=8.0)] = 1.15
    """Edge length on the head over that on the liner (`mesh.size`)."""

    @model_validator(mode="after")
    def _possible(self) -> HeadCup:
        if not COVER[0] <= math.degrees(self.cover_angle) <= COVER[1]:
            fail("is not within 30 to 120 deg", at=("cover_angle",))
        radius = self.bore_diameter / 2
        if not radius < NEAR * self.head_radius:
            largest_bore = 2 * NEAR * self.head_radius
            fail(
                f"leaves no material of the head; expected less than {largest_bore:.3g} mm",
                at=("bore_diameter",),
            )
        bottom = self.bore_depth - math.sqrt(self.head_radius**2 - radius**2)
        end = radius - self.bore_depth * math.tan(self.bore_taper)
        if abs(self.bore_taper) >= math.pi / 4 or end <= 0.1 * radius:
            fail("closes the bore before its end; expected a smaller angle", at=("bore_taper",))
        if math.hypot(end, bottom) >= NEAR * self.head_radius:
            fail(
                "brings the bore too close to the head's surface; expected a smaller depth",
                at=("bore_depth",),
            )
        return self

    @property
    def head_radius(self) -> float:
        """Radius of the head (mm)."""
        return self.head_diameter / 2

    @property
    def cup_radii(self) -> tuple[float, ...]:
        """Radii of the cup's spheres (mm): of the bearing, of the liner, of the shell if any."""
        inner = self.head_radius + self.radial_clearance
        outer = inner + self.liner_thickness
        if not self.shell_thickness:
            return (inner, outer)
        return (inner, outer, outer + self.shell_thickness)

    @property
    def tissues(self) -> dict[str, str]:
        """``implant`` for all."""
        return dict.fromkeys(("head", "liner", "shell")[: len(self.cup_radii)], "implant")

    @property
    def boundary_names(self) -> tuple[str, ...]:
        """Surface and bore of the head; bearing, rims and outside of the cup."""
        cup = self.region_names[1:]
        rims = tuple(f"{region}_rim" for region in cup)
        return ("head_surface", "head_bore", "liner_inner", *rims, f"{cup[-1]}_outer")

    @property
    def interface_sides(self) -> dict[str, Sides]:
        """The bearing, and the joint of liner and shell."""
        sides: dict[str, Sides] = {"bearing": (("head",), ("liner",))}
        return sides | ({"liner_shell": (("liner",), ("shell",))} if self.shell_thickness else {})

    @property
    def spans(self) -> dict[tuple[str | int, ...], tuple[float, float]]:
        """Lengths that limit the size of the cells, by key, with the factors on them.

        The diameter of the head, and the walls of the cup: there chords of both spheres may cross.
        """
        walls = {"liner_thickness": self.liner_thickness, "shell_thickness": self.shell_thickness}
        wall_spans = {n: (t, math.sqrt(self.head_radius / t)) for n, t in walls.items() if t}
        return {
            (n,): v
            for n, v in (("head_diameter", (self.head_diameter, ROUND)), *wall_spans.items())
        }

    @property
    def interface_area(self) -> float:
        """Area of the bearing and of the joint of liner and shell (mm2)."""
        solid_angle = 2.0 * math.pi * (1.0 - math.cos(self.cover_angle))
        return sum(solid_angle * radius**2 for radius in self.cup_radii[:-1])

    def estimate_cells(self, mesh: MeshOptions) -> int:
        """Estimated number of tetrahedra."""
        inner, outer = self.cup_radii[0], self.cup_radii[-1]
        solid_angle = 2.0 * math.pi * (1.0 - math.cos(self.cover_angle))
        volume = solid_angle / 3.0 * (outer**3 - inner**3)
        cup_cells = graded_cells(solid_angle * inner**2, volume, mesh)
        return self.cells_apart("head", mesh) + cup_cells

    def cells_apart(self, region: str, mesh: MeshOptions) -> int:
        """Estimated number of tetrahedra of the head, which has its fine cells on one side."""
        head_options = mesh.model_copy(update={"size": self.head_size * mesh.size})
        area, volume = 2 * math.pi * self.head_radius**2, 4 / 3 * math.pi * self.head_radius**3
        head_cells = graded_cells(area, volume, head_options)
        return head_cells if region == "head" else 0
