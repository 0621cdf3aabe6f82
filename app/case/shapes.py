"""Shared parts of the geometries: mesh options, estimates, the cement mantle."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from pydantic import (
    BaseModel,
    Discriminator,
    Field,
    SerializerFunctionWrapHandler,
    Tag,
    model_serializer,
    model_validator,
)

from app.foundation.verdict import Verdict
from app.schema.section import UNION_TAG, Extensible, Scalar, Section, Truth, fail
from app.schema.units import Dimension, Plain, PositiveLength

if TYPE_CHECKING:
    from app.foundation.arrays import Bools, Floats

Point3 = tuple[float, float, float]
Sides = tuple[tuple[str, ...], tuple[str, ...]]

# Constants of meshes and their defaults. The hash of a mesh in the cache does not contain them:
# after a change of one, raise `MESHER_VERSION` in `meshes.cache`.
LEAST_CELL_SIZE = 1e-8  # size of a cell (mm), so that its powers do not underflow
COUNTLESS = 1e40  # bound of the number of cells
# Distance of lines around on a stem, over the size, in cement: pressure has ridges 1.5 to 3 mm wide
# there. Without cement it is smoother: with 36 lines at 6 mm, and with 28 at 8 mm, motions are
# within 1 % and the p95 of pressure within 5 % of those with 72 lines.
AROUND = 0.2
AROUND_IN_BONE = 0.3
# Distance (mm) that resolves the ridges in cement of the first thickness (mm). In thinner cement
# they are narrower, as the root of the thickness, down to the second.
RESOLVED = 1.2
RIDGES = (4.0, 2.0)
# Least number of lines around a femur by default; that of meshes above a size (mm).
LINES = 16
COMPANION = 4
COARSE = 10.0
MOST_LINES = 1000
# Area of an interface per node on it, over the squared edge length.
AREA_PER_NODE = 0.87
# Least length of a cell through cement, cancellous and cortical bone over the mesh size: in bone
# there are as many as have room, in cement at most as many as `through_cement`.
THROUGH = (0.25, 1.0, 1.25)
CANCELLOUS = 15.0  # widest cancellous bone (mm)
CORTICAL = 8.0  # widest cortical bone (mm)
# First and largest step, in multiples of `along`, and growth of a step per mm: `below` from the
# plug downwards, `stem` from the neck cut downwards, where gaps are largest.
GRADING = {"below": (1.8, 2.5, 0.2), "stem": (0.6, 1.0, 0.06)}
# Keys of a graded thickness: equally far apart from the tip to the neck cut, and around the stem.
HEIGHTS = ("distal", "middle", "proximal")
SIDES = ("medial", "anterior", "lateral", "posterior")
LEAST_CEMENT = 1.0  # thickness of cement (mm): thinner layers have flat cells
MOST_CEMENT = 8.0
_Thickness = Annotated[
    float, Dimension("mm", "a length", "4 mm", at_least=LEAST_CEMENT, at_most=MOST_CEMENT)
]


@dataclass(frozen=True)
class _UniformThickness(Dimension):
    """Marks the thickness of a mantle that may be absent."""

    def check(self, value: float, shown: str, unit: str = "") -> None:
        """Refuse a thickness above the largest, or positive but below the least."""
        super().check(value, shown, unit)
        if 0.0 < value < LEAST_CEMENT:
            fail(f"{shown} must be 0 (a stem without cement) or at least 1 mm")


_UNIFORM = _UniformThickness("mm", "a length", "4 mm", at_least=0.0, at_most=MOST_CEMENT)


class GradedThickness(Section):
    """Thickness of a mantle by height, by side, or both.

    Linear between heights, half a cosine wave between sides. With both, heights give the mean, and
    sides the ratios to it.
    """

    proximal: _Thickness | None = None
    """Where the stem's axis meets the neck cut, and above."""
    middle: _Thickness | None = None
    """Half-way between `distal` and `proximal`."""
    distal: _Thickness | None = None
    """At the stem's tip, and below."""
    medial: _Thickness | None = None
    """On the medial side."""
    anterior: _Thickness | None = None
    """On the anterior side."""
    lateral: _Thickness | None = None
    """On the lateral side."""
    posterior: _Thickness | None = None
    """On the posterior side."""

    @property
    def tables(self) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
        """Two tables: mean thickness (mm) by relative height, thickness over mean by turn."""
        heights, ring = (
            [
                (k / divisions, getattr(self, key))
                for k, key in enumerate(keys)
                if getattr(self, key) is not None
            ]
            for keys, divisions in ((HEIGHTS, 2), (SIDES, 4))
        )
        ring = [*ring, (ring[0][0] + 1.0, ring[0][1])] if ring else [(0.0, 1.0), (1.0, 1.0)]
        mean = _mean(ring)
        heights = heights or [(0.0, mean)]
        heights = [(0.0, heights[0][1]), *heights, (1.0, heights[-1][1])]
        return heights, [(turn, t / mean) for turn, t in ring]

    @model_validator(mode="after")
    def _possible(self) -> GradedThickness:
        given_keys = [
            [k for k in keys if getattr(self, k) is not None] for keys in (HEIGHTS, SIDES)
        ]
        for keys, keys_given in zip((HEIGHTS, SIDES), given_keys, strict=True):
            if len(keys_given) == 1 or not any(given_keys):
                fail(
                    f"is not enough; expected at least two of {', '.join(keys)}",
                    at=tuple(keys_given),
                )
        lowest, _, highest = (round(t, 9) for t in range_of_thickness(self))
        if lowest < LEAST_CEMENT or highest > MOST_CEMENT:
            fail(f"is {lowest:.3g} to {highest:.3g} mm by height and side; expected 1 to 8 mm")
        return self


def _mean(table: list[tuple[float, float]]) -> float:
    """Mean over [0, 1] of the piecewise linear function through (place, value) pairs."""
    return sum(0.5 * (b[0] - a[0]) * (a[1] + b[1]) for a, b in pairwise(table))


Thickness = Annotated[
    Annotated[float, _UNIFORM, Tag(UNION_TAG + "uniform")]
    | Annotated[GradedThickness, Tag(UNION_TAG + "graded")],
    Discriminator(
        lambda t: UNION_TAG + ("graded" if isinstance(t, dict | BaseModel) else "uniform")
    ),
]


def range_of_thickness(thickness: float | GradedThickness) -> tuple[float, float, float]:
    """Least, mean and largest thickness of a mantle (mm)."""
    if not isinstance(thickness, GradedThickness):
        return thickness, thickness, thickness
    heights, ring = thickness.tables
    thicknesses = [mean * ratio for _, mean in heights for _, ratio in ring]
    return min(thicknesses), _mean(heights), max(thicknesses)


@dataclass(frozen=True)
class Mantle:
    """The cement between interfaces ``stem_cement`` and ``cement_bone``.

    Attributes:
        thickness: Nominal thickness, the mean of a graded one (mm).
        tip: Level of the end of the stem's flanks (mm), below which the cement is a plug without
            thickness; minus infinity without a plug.
    """

    thickness: float
    tip: float


class Shape(Extensible):
    """Base of the geometries: what a case may name in them, and defaults of their properties.

    A subclass with a `kind` is a geometry, in this package or another one.
    """

    mesher: ClassVar[str]
    """Module that meshes it, by `build(geometry, mesh)`."""
    shape_keys: ClassVar[str] = "geometry"
    """Keys to change where cells are poor, in words of a message."""
    is_around_z: ClassVar[bool] = False
    """True if z is the axis of a stem, or of a planned one."""
    has_gruen_zones: ClassVar[bool] = False
    """True if the geometry has the bone around a stem, or a planned one (`meshes.gruen`)."""

    kind: str

    @property
    def placement_details(self) -> dict[str, str]:
        """The stem's position, in words."""
        return {}

    def room_details(self) -> str:
        """Least room around a stem, in words; empty without one."""
        return ""

    @property
    def content(self) -> str:
        """Hash of the content of its files; empty without files."""
        return ""

    @property
    def region_names(self) -> tuple[str, ...]:
        """Names of the regions."""
        return tuple(self.tissues)

    @property
    def boundary_names(self) -> tuple[str, ...]:
        """Names of the boundaries."""
        return ()

    @property
    def interface_sides(self) -> dict[str, Sides]:
        """Regions on the two sides of each interface; none by default."""
        return {}

    @property
    def sliding_boundaries(self) -> dict[str, tuple[str, str]]:
        """Boundaries of the two sides of each interface that is meshed apart; none by default."""
        return {}

    @property
    def interface_area(self) -> float:
        """Approximate area of all interfaces (mm2); 0 if unknown."""
        return 0.0

    @property
    def medial_cut_height(self) -> float | None:
        """Height at which the neck cut leaves the medial cortex (mm); None without a cut."""
        return None

    @property
    def stem_length(self) -> float:
        """Height of a stem's shoulder over its tip (mm); 0 without a stem."""
        return 0.0

    @property
    def stem_perimeter(self) -> float:
        """Length around a stem where lines are counted (mm); 0 without lines."""
        return 0.0

    def interface_nodes(self, mesh: MeshOptions) -> float:
        """Approximate number of nodes on each interface, of about the same area; 0 if unknown."""
        if not mesh.size:
            return 0.0
        area = self.interface_area / max(1, len(self.interface_sides))
        return area / (AREA_PER_NODE * mesh.size**2)

    @property
    def has_curved_surfaces(self) -> bool:
        """Return True if curved cells follow it better than straight ones; False by default."""
        return False

    @property
    def spans(self) -> dict[tuple[str | int, ...], tuple[float, float]]:
        """Lengths (mm) that limit the edges of cells, and the largest ratio of an edge to each."""
        return {}

    @property
    def coarsest_size(self) -> float:
        """Largest edge length that it can be meshed with (mm)."""
        return min((ratio * length for length, ratio in self.spans.values()), default=math.inf)

    @property
    def is_mirrored(self) -> bool:
        """True if the model is the mirror image of the patient's bone: a right femur."""
        return False

    @property
    def continued_below(self) -> float | None:
        """Level below which bone is continued, not measured (mm); None: all of it is measured."""
        return None

    @property
    def other_bones(self) -> dict[str, Shape]:
        """The geometry with other bone where none was measured, by what differs, in words."""
        return {}

    @property
    def details(self) -> dict[str, Any]:
        """Lines about it for `mantle check`, by their captions."""
        return {}

    @property
    def former_keys(self) -> list[Verdict]:
        """Notes on former names of keys that were given, whose values are converted."""
        return []

    def without_effect(self, mesh: MeshOptions) -> dict[tuple[str, ...], str]:
        """Keys of the case that do nothing beside others, with the reason; given ones or not."""
        return {}

    @property
    def proud(self) -> float:
        """Height of a stem's shoulder above the neck cut, along the shaft's axis (mm)."""
        return 0.0

    @property
    def rounded_angle(self) -> float:
        """Angle (rad) up to which straight facets at an edge stand for a rounded one.

        0: the geometry does not know whether edges are rounded.
        """
        return 0.0

    def height_on_stem(self, x: Floats) -> Floats:
        """Height of points (n, 3) above a stem's tip along it, or z without a stem (n,) [mm]."""
        return x[:, 2]

    def on_flanks(self, x: Floats) -> Bools:
        """True at points (n, 3) that are neither on a stem's end nor on its shoulder (n,)."""
        return np.ones(len(x), dtype=bool)

    def off_bone(self, interface: str, x: Floats) -> Bools:
        """True at points (n, 3) of an interface where bone never touches a stem (n,)."""
        return np.zeros(len(x), dtype=bool)

    @property
    def laws_to_write(self) -> dict[str, str]:
        """Interfaces that are not bonded by default, with an example of their law."""
        return {}

    @property
    def press_fits(self) -> tuple[str, ...]:
        """Interfaces whose micromotion is reported, also without an interference."""
        return ()

    @property
    def left_out(self) -> dict[str, tuple[str, ...]]:
        """Names, by section, that the base's geometry has and this geometry lacks."""
        return {}

    def check_fit(self, mesh: MeshOptions) -> None:
        """Raise InputError if a stem does not fit into a measured bone."""

    def grid(self, mesh: MeshOptions) -> dict[str, Any]:
        """Lines around, steps along and cells through the layers, where there are layers."""
        return {}

    def estimate_cells(self, mesh: MeshOptions) -> int:
        """Estimated number of tetrahedra."""
        raise NotImplementedError

    def cells_apart(self, region: str, mesh: MeshOptions) -> int:
        """Estimated number of tetrahedra of a region that is meshed apart; 0 if unknown."""
        return 0

    @property
    def mantles(self) -> tuple[Mantle, ...]:
        """Cement mantles; none by default."""
        return ()

    @property
    def joined(self) -> tuple[tuple[str, ...], ...]:
        """Groups of regions that are bonded wherever they meet; none by default."""
        return ()

    @property
    def points(self) -> dict[str, Point3]:
        """Named points (mm) for loads; none by default."""
        return {}

    @property
    def tissues(self) -> dict[str, str]:
        """Default tissue of each region, where it is known."""
        return {}


class LinesAround(Scalar):
    """Marks lines around a stem: their number (int), or their distance in mm (float)."""

    number = Plain(integer=True, at_least=COMPANION, at_most=MOST_LINES)
    length = Dimension("mm", "a number of lines or a length", "1.4 mm", above=0.0, at_most=1e10)

    def read(self, value: object) -> int | float:
        """A number as an int, a length as a float (mm).

        Raises:
            PydanticCustomError: It is neither, or out of bounds.
        """
        if isinstance(value, str):
            return self.length.read(value)
        if isinstance(value, float) and not value.is_integer():
            fail(f"{value} is not a whole number; a distance needs a unit, e.g. '{value} mm'")
        return int(self.number.read(value))

    def write(self, value: int | float) -> int | str:
        """The number, or the length with its unit."""
        return value if isinstance(value, int) else self.length.write(value)

    def __get_pydantic_json_schema__(self, *given: object) -> dict[str, Any]:
        """A number or a length."""
        forms = (self.number, self.length)
        return {"anyOf": [form.__get_pydantic_json_schema__(*given) for form in forms]}


def perimeter(half: float, depth: float, corner: float) -> float:
    """Length around a rectangle with rounded corners, by half-width, half-depth and radius (mm)."""
    return 4.0 * (half + depth - 2.0 * corner) + 2.0 * math.pi * corner


class MeshOptions(Section):
    """Mesh size and order of the displacement."""

    size: Annotated[PositiveLength, Field(json_schema_extra={"default": None})] = 0.0
    """Edge length at the interfaces. Required except for a mesh file, which has cells."""
    far_size: PositiveLength | None = None
    """Edge length far from the interfaces; four times `size` by default."""
    order: Annotated[int, Plain(integer=True, at_least=1, at_most=2)] = 2
    """Polynomial degree of the displacement."""
    curved: Truth | None = None
    """`true`: cells are curved (second order) and follow the geometry; needs `order: 2`. By default
    cells are curved if the geometry is and `order` is 2."""

    around: Annotated[int | float, LinesAround()] | None = None
    """Lines around the stem of a femur: their number, 4 to 1000, or their distance on the stem, a
    quarter of the way down from the neck cut. By default the distance is 0.2 of `size`, or less
    in cement thinner than 4 mm; without cement it is 0.3 of `size`. The number is a multiple of 4,
    and at least 16 up to a size of 10 mm."""
    along: PositiveLength | None = None
    """Largest step along the stem of a femur; by default `size`. All steps from the shaft to the
    head scale with it."""
    through_cement: Annotated[int, Plain(integer=True, at_least=1, at_most=100)] | None = None
    """Cells through the cement of a femur, 1 to 100; by default from its thickness over `size`, and
    at least 2."""

    @property
    def far_size_or_default(self) -> float:
        """Edge length far from the interfaces (mm); by default four times `size`."""
        return 4.0 * self.size if self.far_size is None else self.far_size

    @property
    def step_along(self) -> float:
        """Largest step along a stem (mm)."""
        return self.size if self.along is None else self.along

    def lines_around(self, section: tuple[float, float, float], cement: Thickness) -> int:
        """Lines around a stem: as given, or a multiple of 4, by the perimeter of a section.

        Args:
            section: Half-width, half-depth and corner radius of a rounded rectangle (mm).
            cement: Thickness of the cement (mm); 0 without cement.
        """
        if isinstance(self.around, int):
            return self.around
        if self.around is not None:
            return max(COMPANION, 4 * round(perimeter(*section) / self.around / 4.0))
        distance = self._distance_around(cement)
        fewest_lines = LINES if self.size <= COARSE else COMPANION
        return max(fewest_lines, 4 * round(perimeter(*section) / distance / 4.0))

    def _distance_around(self, cement: Thickness) -> float:
        """Distance of lines around a stem by default (mm), in cement of a thickness (mm)."""
        if not cement:
            return AROUND_IN_BONE * self.size
        wide, narrow = RIDGES
        thickness = min(max(range_of_thickness(cement)[1], narrow), wide)
        by_size = AROUND * self.size
        return min(by_size, max(by_size, RESOLVED) * math.sqrt(thickness / wide))

    def along_cement(self, cement: Thickness) -> float:
        """Cells through cement of a thickness (mm), by the mean of a graded one; 0 without cement.

        A fraction is the part, from the neck cut down, with one more.
        """
        if cement == 0.0:
            return 0.0
        return float(
            self.through_cement or max(2.0, 1.75 * range_of_thickness(cement)[1] / self.size - 0.5)
        )

    def cells_through(self, cement: Thickness) -> tuple[int, int, int]:
        """Cells at most through cement of a thickness (mm), cancellous and cortical bone."""
        _, cancellous, cortical = self.least_through
        bone = max(1, round(CANCELLOUS / cancellous)), max(1, round(CORTICAL / cortical))
        return math.ceil(self.along_cement(cement)), *bone

    @property
    def least_through(self) -> tuple[float, float, float]:
        """Least length of cells through cement, cancellous and cortical bone (mm)."""
        cement, cancellous, cortical = THROUGH
        return cement * self.size, cancellous * self.size, cortical * self.size

    def steps(self, length: float) -> int:
        """Equal steps of about the largest along a stem in a length (mm)."""
        return max(1, round(length / self.step_along))

    def graded(self, length: float, part: str) -> tuple[list[float], int, float]:
        """Divide a length (mm) into growing steps, down from the neck cut (stem) or plug (below).

        Returns:
            Distances from 0 where steps grow, and the number and size of equal steps after them.
        """
        first_size, largest_size, growth = GRADING[part]
        largest = min(largest_size * self.step_along, self.far_size_or_default)
        distances, step = [0.0], first_size * self.step_along
        while step < largest and distances[-1] + 0.5 * step < length:
            distances.append(distances[-1] + step)
            step = first_size * self.step_along + growth * distances[-1]
        return (
            distances,
            max(round((length - distances[-1]) / largest), int(len(distances) == 1)),
            largest,
        )

    def coarser(self, factor: float) -> MeshOptions:
        """The same mesh with cells that are larger by a factor, in all directions.

        A number of lines that is a multiple of 4 stays one.
        """
        changed_sizes: dict[str, float] = {
            "size": factor * self.size,
            "far_size": factor * self.far_size_or_default,
        }
        if self.along is not None:
            changed_sizes["along"] = factor * self.along
        if isinstance(self.around, float):
            changed_sizes["around"] = factor * self.around
        elif self.around is not None:
            multiple = 1 if self.around % 4 else 4
            changed_sizes["around"] = max(4, multiple * round(self.around / factor / multiple))
        if self.through_cement is not None:
            changed_sizes["through_cement"] = max(1, round(self.through_cement / factor))
        return self.model_copy(update=changed_sizes)

    @model_serializer(mode="wrap")
    def _without_unknown_sizes(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave `size` and `far_size` out of the written case if the mesh is a file."""
        fields: dict[str, Any] = handler(self)
        return {k: v for k, v in fields.items() if self.size or k not in ("size", "far_size")}

    @model_validator(mode="after")
    def _possible(self) -> MeshOptions:
        if self.curved and self.order == 1:
            # Linear functions on curved cells do not contain the linear displacements.
            fail(
                "curved cells need second order; set `curved: false` or `order: 2`", at=("curved",)
            )
        if 0.0 < self.size < LEAST_CELL_SIZE:
            fail(
                f"{self.size:g} mm is too small; expected at least {LEAST_CELL_SIZE:g} mm",
                at=("size",),
            )
        if self.far_size_or_default < self.size:
            fail(
                f"{self.far_size_or_default:g} mm is smaller than size, {self.size:g} mm",
                at=("far_size",),
            )
        return self


def graded_cells(area: float, volume: float, mesh: MeshOptions) -> int:
    """Estimated number of tetrahedra of a mesh that is fine at its interfaces.

    ``a A / h^2 + b V / H^3`` for an area A of all interfaces (mm2) and a volume V (mm3). The
    constants are fitted to meshes of the femur. The result is at most that of a uniform mesh.
    """
    uniform = 8.5 * volume / mesh.size**3
    graded = 8.0 * area / mesh.size**2 + 8.5 * volume / mesh.far_size_or_default**3
    return max(6, round(min(uniform, graded, COUNTLESS)))
