"""The parametric femur, with a cemented stem and before the operation."""

from __future__ import annotations

import math
from functools import partial
from importlib import import_module
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator

from app.case.shapes import (
    Mantle,
    MeshOptions,
    Point3,
    Shape,
    Sides,
    Thickness,
    perimeter,
    spread,
)
from app.case.stems import StemFile
from app.schema.section import Section, fail
from app.schema.units import Angle, Dimension, Length, PositiveLength

BONE = ("cortical_bone", "cancellous_bone")
OF_BONE = dict.fromkeys(BONE, "bone")
# Centre of each muscle's insertion (mm): places from anatomy, moved radially onto the outer bone of
# `meshes.femur_bone`; that of vastus lateralis is on the shaft below the greater trochanter.
MUSCLES: dict[str, Point3] = {
    "gluteus_medius": (-25.395, -15.237, 28.0),
    "gluteus_minimus": (-30.723, 4.727, 27.0),
    "gluteus_maximus": (-5.795, -13.038, -49.0),
    "psoas": (21.035, -1.503, -7.0),
    "vastus_lateralis": (-15.067, 4.018, -25.0),
    "vastus_medialis": (2.540, 13.508, -132.0),
}

# Fraction of the lines along which the mantle fills the canal, beside and below the stem, by the
# thickness of the mantle less the widening of the canal (mm).
FILLED = (0.0, 0.05, 0.4, 0.64, 0.7, 0.74, 0.8, 0.85, 0.9)
FILLED_BELOW = (0.0, 0.0, 0.0, 0.75, 1.0)
# Mean widths of cancellous bone, and of cortical bone around a canal that is not widened (mm).
CANCELLOUS_WIDTH = 5.0
CORTICAL_WIDTH = 6.2
# Least fraction of the stem in the bone; range of the angle between neck and shaft (deg).
INSIDE, NECK_ANGLES = 2.0 / 3.0, (100.0, 145.0)
HALF_TIP = 10.0  # mm that a stem's end reaches from its axis, at most

# Beginnings of keys that a stem from a file replaces, all but `stem_tip_z`.
OF_STEM = ("stem_", "tip_rounding", "neck_", "trunnion_", "head_")


def _between(at: float, values: tuple[float, ...]) -> float:
    """Linear interpolation of values at 0, 1, 2, ..., constant beyond."""
    at = min(max(at, 0.0), len(values) - 1.0)
    low = min(int(at), len(values) - 2)
    return values[low] + (at - low) * (values[low + 1] - values[low])


def check_end(geometry: Any) -> None:
    """Refuse ends of a stem that cannot be meshed."""
    for name in ("tip_rounding", "tip_void"):  # cells in less are flat
        if 0.0 < getattr(geometry, name, 0.0) < 1.0:
            fail("is neither 0 nor 1 mm at least", at=(name,))
    if geometry.tip_void and geometry.tip_void > geometry.plug_length - 1.0:
        fail(f"leaves less than 1 mm of {geometry.plug_length:g} mm of plug", at=("tip_void",))


def check_stem(stem: Any, *sections: str) -> None:
    """Refuse a neck, and sections, by their keys, that cannot be meshed."""
    if not NECK_ANGLES[0] <= math.degrees(stem.neck_angle) <= NECK_ANGLES[1]:
        fail("is not between {:g} and {:g} deg".format(*NECK_ANGLES), at=("neck_angle",))
    for name in sections:
        half = min(getattr(stem, f"{name}half_width"), getattr(stem, f"{name}half_depth"))
        if getattr(stem, f"{name}corner_radius") >= half:
            text = f"is not below the half-width and half-depth, {half:g} mm"
            fail(text, at=(f"{name}corner_radius",))


def point(x: Any) -> Point3:
    """Numbers of a vector."""
    return float(x[0]), float(x[1]), float(x[2])


def placed_head(geometry: Any) -> Point3:
    """Centre of the head of a stem that is placed, in the model's axes (mm)."""
    implant = geometry.implant
    return point(geometry.placement.to_model([implant.head_offset, 0.0, implant.head_height]))


def flanks_end(geometry: Any) -> float:
    """Level above which there are only flanks of a stem that is placed (mm)."""
    end = [0.0, 0.0, geometry.implant.stem_tip_z + geometry.implant.tip_height]
    tilt = math.tan(abs(geometry.insertion.varus))
    return float(geometry.placement.to_model(end)[2]) + HALF_TIP * tilt


_length = partial(Dimension, "mm", "a length")


class Version(Section):
    """Turn of the stem about the shaft's axis."""

    relative_to: Literal["neck", "condyles"] = "neck"
    """What it is measured against: the neck, or the line of the posterior condyles."""
    angle: Angle = 0.0
    """The turn, the head to anterior (rad)."""


class Resection(Section):
    """The cut across the neck."""

    height: Length = 8.0
    """Height above the lesser trochanter at which it leaves the medial cortex."""
    angle: Annotated[float, Dimension("rad", "an angle", "38 deg", at_least=0.0, below=1.2)] = (
        math.radians(38.0)
    )
    """Its angle to the transverse plane (rad), below 1.2."""
    azimuth: Angle | None = None
    """Direction of its normal about the shaft, from medial to anterior (rad); by default the
    neck's."""


class Insertion(Section):
    """Where the stem is put in the femur."""

    depth: Annotated[float, Dimension("mm", "a length", "0 mm", at_most=14.0)] | None = None
    """How deep the lateral edge of the shoulder is below the cut, at most 14 mm: there is cement
    above it. By default 0, and in mantle's own femur as `stem_tip_z` says."""
    varus: Annotated[float, Dimension("rad", "an angle", "2 deg", at_least=-0.2, at_most=0.2)] = 0.0
    """Tilt of the stem, its tip to lateral (rad), about where its axis meets the cut."""
    version: Version = Field(default_factory=Version)
    """Turn of the stem about the shaft's axis."""
    medial_offset: Length = 0.0
    """How far the stem's axis is medial of the shaft's, along the cut's azimuth."""
    anterior_offset: Length = 0.0
    """How far it is anterior of it."""


class _Femur(Shape):
    """A proximal femur, the operation and the implant."""

    is_around_z: ClassVar[bool] = True
    has_gruen_zones: ClassVar[bool] = True
    has_curved_surfaces: ClassVar[bool] = True
    coarsest_size: ClassVar[float] = 20.0  # a few cells along the stem
    joined: ClassVar[tuple[tuple[str, ...], ...]] = (BONE,)

    kind: str
    cement_thickness: Thickness = 4.0
    """Thickness of the mantle where the canal has room, 1 to 8 mm: one, or by height and side."""
    canal_widening: Annotated[float, _length("1 mm", at_least=0.0, at_most=5.0)] = 0.0
    """Reaming: distance by which the endosteal surface is moved outwards, 0 to 5 mm."""
    metaphyseal_cortex: Annotated[float, _length("2 mm", at_least=1.5, at_most=4.0)] | None = None
    """Thickness of the cortex across the shaft's axis above z = -10 mm, reamed or not, 1.5 to 4 mm;
    down to -50 mm it goes over to that of the shaft. By default it is 3.5 to 7 mm there. In cells
    of 6 mm the worst shape (SICN) is 0.12 at 2 mm, 0.09 at 1.5 mm."""
    stem_length: PositiveLength = 147.0
    """From the shoulder to the tip; two thirds of it at least are below the neck cut."""
    stem_tip_z: Length = -118.0
    """Level of the tip."""
    stem_tip_half_width: PositiveLength = 3.0
    """Half the medio-lateral width at the tip."""
    stem_tip_half_depth: PositiveLength = 3.0
    """Half the antero-posterior depth at the tip."""
    stem_tip_corner_radius: PositiveLength = 2.1
    """Radius of the section's corners at the tip."""
    tip_rounding: Annotated[float, _length("2 mm", at_least=0.0, at_most=20.0)] = 2.0
    """Height of the stem's rounded end, 1 to 20 mm; 0: it is flat, as it is over a void."""
    tip_void: Annotated[float, _length("5 mm", at_least=0.0)] = 0.0
    """Length without cement below the stem's end, as of a hollow centraliser: nothing bears on the
    end. 1 mm at least, and 1 mm less than the plug at most; 0: none."""
    stem_section_z: Length = 15.0
    """Level of the proximal section that the next three describe."""
    stem_half_width: PositiveLength = 8.5
    """Half the medio-lateral width there."""
    stem_half_depth: PositiveLength = 5.0
    """Half the antero-posterior depth there."""
    stem_corner_radius: PositiveLength = 3.0
    """Radius of the section's corners there."""
    neck_diameter: Annotated[float, _length("10 mm", at_least=5.0)] = 13.0
    """Diameter of the neck where it leaves the body: at least 5 mm, at most the body's width."""
    neck_fillet: Annotated[float, _length("3 mm", at_least=2.0, at_most=10.0)] = 3.0
    """Radius where the stem turns into the neck, 2 to 10 mm; a blunt turn has a larger one."""
    trunnion_diameter: Annotated[float, _length("12 mm", at_least=5.0, at_most=22.0)] = 12.0
    """Diameter of the neck's end, which carries the head, 5 to 22 mm."""
    head_offset: Annotated[float, _length("43 mm", at_least=20.0, at_most=80.0)] = 43.0
    """Medial distance of the head's centre from the shaft axis, 20 to 80 mm."""
    head_height: Annotated[float, _length("54 mm", at_least=20.0, at_most=100.0)] = 54.0
    """Height of the head's centre above mid lesser trochanter, 20 to 100 mm; no part of the stem's
    body is higher. A low head bends the neck's root: in cells of 4 mm the worst shape (SICN) is
    0.13 down to 45 mm, that of the bone, 0.11 at 40 mm and 0.05 at 32 mm."""
    neck_angle: Annotated[float, Dimension("rad", "an angle", "130 deg")] = math.radians(130.0)
    """Angle between neck and shaft (rad), 100 to 145 deg."""
    anteversion: Angle = 0.0
    """Turn of stem, neck and neck cut about the shaft's axis, the head to anterior (rad)."""
    resection_height: Length = 5.0
    """Height above mid lesser trochanter at which the cut leaves the medial cortex."""
    resection_angle: Angle = math.radians(38.0)
    """Angle of the cut to the transverse plane (rad)."""
    plug_length: PositiveLength = 10.0
    """Length of cement below the tip."""
    distal_cut_z: Annotated[float, _length("-200 mm", at_least=-350.0)] = -200.0
    """Level at which the shaft is cut and held: below the plug, at least -350 mm."""

    @model_validator(mode="after")
    def _consistent(self) -> _Femur:
        self._check_stem()
        plug = self.stem_tip_z - self.plug_length
        if self.distal_cut_z >= plug:
            fail(f"is not below the cement plug; expected below {plug:g} mm", at=("distal_cut_z",))
        check_end(self)
        if not 0.0 <= self.resection_angle < math.pi / 2:
            fail("is not between 0 and 90 deg", at=("resection_angle",))
        if self._cut >= self.head_height:
            text = (
                f"puts the neck cut at z = {self._cut:.3g} mm on the shaft's axis, above the head's"
            )
            fail(f"{text} centre at {self.head_height:g} mm", at=("resection_height",))
        shoulder = self.stem_tip_z + self.stem_length
        inside = (self._cut - self.stem_tip_z) / INSIDE
        if self.stem_length > min(inside, longest := self.head_height - self.stem_tip_z):
            where = "out of the bone" if inside < longest else "above the head's centre"
            text = f"{self.stem_length:g} mm puts the shoulder at z = {shoulder:g} mm, too far"
            text += f" {where}; expected at most {min(inside, longest):.3g} mm"
            fail(text, at=("stem_length",))
        return self

    def _check_stem(self) -> None:
        shoulder, plug = self.stem_tip_z + self.stem_length, self.stem_tip_z - self.plug_length
        check_stem(self, "stem_", "stem_tip_")
        if not self.stem_tip_z < self.stem_section_z < shoulder:
            self._refuse_section(shoulder)
        width = 2.0 * self._check_section(shoulder, "the shoulder", 0.0)
        self._check_section(plug, "the end of the plug", spread(self.cement_thickness)[0])
        if self.neck_diameter > width:
            text = f"is wider than the stem's shoulder; expected at most {width:.3g} mm"
            fail(text, at=("neck_diameter",))

    def _refuse_section(self, shoulder: float) -> None:
        """Fail at the key that puts the proximal section beside the stem."""
        levels = ("stem_section_z", "stem_length", "stem_tip_z")
        key = next((k for k in levels if k in self.model_fields_set), levels[0])
        text = f"puts the stem between z = {self.stem_tip_z:g} and {shoulder:g} mm, without its"
        text = f"{text} proximal section at {self.stem_section_z:g} mm (stem_section_z)"
        if key == levels[0]:
            text = f"is not between the stem's tip at z = {self.stem_tip_z:g} mm and its"
            text = f"{text} shoulder at {shoulder:g} mm"
        default = type(self).model_fields
        usual = default["stem_tip_z"].default + default["stem_length"].default
        tip = usual - self.stem_length
        if key == "stem_length" and tip < self.stem_section_z < usual:
            text = f"{text}; set stem_tip_z: {tip:g} mm too to cut the stem at its tip"
        fail(text, at=(key,))

    def _check_section(self, z: float, where: str, offset: float) -> float:
        """Half-width of the section extrapolated linearly to a level (mm); refuse a degenerate one.

        ``where`` is the level in words, ``offset`` the thickness added around the section (mm).
        """
        part = (z - self.stem_tip_z) / (self.stem_section_z - self.stem_tip_z)
        sizes = {}
        for name in ("half_width", "half_depth", "corner_radius"):
            tip, top = getattr(self, f"stem_tip_{name}"), getattr(self, f"stem_{name}")
            slope = (top - tip) / (self.stem_section_z - self.stem_tip_z)
            grown = offset * (1.0 if name == "corner_radius" else math.hypot(1.0, slope))
            sizes[name] = tip + part * (top - tip) + grown
        radius = sizes["corner_radius"]
        for name, size in sizes.items():
            if size <= 0.0 or (name != "corner_radius" and size <= radius):
                text = f"at {where}, z = {z:g} mm, it has become {size:.3g} mm"
                least = "positive" if size <= 0.0 else f"above the corner radius, {radius:.3g} mm,"
                fail(f"{text}; expected sections that stay {least} there", at=(f"stem_{name}",))
        return sizes["half_width"]

    @property
    def implant(self) -> _Femur:
        """What has the keys of the stem: itself."""
        return self

    @property
    def femur(self) -> Any:
        """The bone before the operation (`meshes.femur_bone.FemurBone`)."""
        bone = import_module("meshes.femur_bone").FemurBone
        return bone(self.anteversion, self.canal_widening, self.metaphyseal_cortex)

    @property
    def resection(self) -> Resection:
        """The cut across the neck."""
        return Resection.model_construct(height=self.resection_height, angle=self.resection_angle)

    @property
    def shoulder_depth(self) -> float | None:
        """Depth of the stem's shoulder below the cut (mm); None: as `stem_tip_z` says."""
        return None

    @property
    def more_room(self) -> tuple[str, str]:
        """The key that says where the stem is, and what to change where it has no room."""
        text = "widen the canal (canal_widening), narrow the stem or move it proximally"
        return "geometry", f"{text} (stem_tip_z)"

    @property
    def placement(self) -> Any:
        """Cut and stem in the model's axes (`meshes.placement.Placement`)."""
        return import_module("meshes.placement").place(self)

    def surfaces(self, mesh: MeshOptions) -> Any:
        """The nested surfaces that are meshed (`meshes.layered_surfaces.LayeredSurfaces`)."""
        return import_module("meshes.layered_surfaces").LayeredSurfaces(self, mesh)

    @property
    def tip_height(self) -> float:
        """Height of the stem's rounded end (mm)."""
        return 0.0 if self.tip_void else self.tip_rounding

    @property
    def head_centre(self) -> Point3:
        """Centre of the femoral head in the model's axes (mm)."""
        medial, anterior = math.cos(self.anteversion), math.sin(self.anteversion)
        return (self.head_offset * medial, self.head_offset * anterior, self.head_height)

    @property
    def points(self) -> dict[str, Point3]:
        """Centre of the head and muscles' insertions (mm)."""
        return {"head_centre": self.head_centre, **MUSCLES}

    @property
    def _cut(self) -> float:
        """Approximate height at which the neck cut meets the shaft's axis (mm)."""
        return self.resection_height + 24.747 * math.tan(self.resection_angle)

    def _section(self) -> tuple[float, float, float]:
        """Half-width, half-depth and corner radius a quarter of the way from cut to tip (mm)."""
        middle = 0.75 * (self._cut - self.stem_tip_z)
        part = middle / (self.stem_section_z - self.stem_tip_z)
        half, depth, corner = (
            (1.0 - part) * getattr(self, f"stem_tip_{name}") + part * getattr(self, f"stem_{name}")
            for name in ("half_width", "half_depth", "corner_radius")
        )
        return half, depth, corner

    @property
    def stem_perimeter(self) -> float:
        """Length around the stem where lines are counted (mm)."""
        return perimeter(*self._section())

    def interface_nodes(self, mesh: MeshOptions) -> float:
        """Number of nodes on each interface: lines around at steps along."""
        around, stem, *_ = self.grid(mesh).values()
        return float(around * stem)

    def grid(self, mesh: MeshOptions) -> dict[str, Any]:
        """Lines around, steps along the stem and below it, cells through the layers."""
        plug = self.stem_tip_z - self.plug_length
        flank = self._cut - self.stem_tip_z - self.tip_height
        stem, more, _ = mesh.graded(flank, "stem")
        ends = 2.0 * (self.plug_length - self.tip_void), self.tip_height, self.tip_void
        below, equal, _ = mesh.graded(plug - self.distal_cut_z, "below")
        through = mesh.cells_through(self.cement_thickness)
        return {
            "lines around": mesh.lines_around(self._section()),
            "steps along the stem": len(stem) - 1 + more + sum(map(mesh.steps, filter(None, ends))),
            "steps below": len(below) - 1 + equal,
            "cells through cement, cancellous and cortical bone": through,
        }

    def _cells(self, mesh: MeshOptions) -> tuple[float, float, float]:
        """Tetrahedra below the neck cut, and in one step of the core and of all layers above it.

        Three for each triangle of the section. Where the mantle fills the canal, along a part of
        the circumference fitted to counted meshes, there is no cancellous bone. A wider canal has
        thinner cortical bone. Of 370 random hips, 367 have the number of cells within 12 %, and all
        within 18 %.
        """
        around, stem, below, (_, *bone) = self.grid(mesh).values()
        most = (mesh.along_cement(self.cement_thickness), *bone)
        core = 3.0 * max(around - 2.0, 0.041 * around**2 + 1.5 * around - 6.0)
        cement = spread(self.cement_thickness)[1]
        filled = cement - self.canal_widening
        open_, free = 1.0 - _between(filled, FILLED), 1.0 - _between(filled, FILLED_BELOW)
        widths = (1.0 + 0.7 * cement, CANCELLOUS_WIDTH, CORTICAL_WIDTH - self.canal_widening)
        through, cancellous, cortical = (
            min(cells, max(1.0, width / length))
            for cells, width, length in zip(most, widths, mesh.least_through, strict=True)
        )
        layers = stem * (through + cortical + cancellous * open_)
        layers += below * (through + cortical + cancellous * free)
        # In neck and head cancellous bone is wide, cortical bone thin.
        whole = 6.0 * around * (through + 0.2 * bone[0] + 0.8 * cancellous + 1.0)
        return (stem + below) * core + 6.0 * around * layers, core, core + whole


class Femur(_Femur):
    """A proximal femur with a straight tapered collarless stem in a cement mantle.

    Axes: z along the shaft, proximal positive, 0 at mid lesser trochanter; x medial; y anterior.
    The table of bone sections belongs to the mesher; the parameters here are those of the operation
    and the implant. Defaults: an Exeter-class 150 mm stem in an average femur.
    """

    tissues: ClassVar[dict[str, str]] = {"stem": "implant", "cement": "cement", **OF_BONE}
    boundary_names: ClassVar[tuple[str, ...]] = (
        *("distal_cut", "bone_surface", "stem_trunnion"),
        *MUSCLES,
        "resection",
    )
    interface_sides: ClassVar[dict[str, Sides]] = {
        "stem_cement": (("stem",), ("cement",)),
        "cement_bone": (("cement",), BONE),
    }

    kind: Literal["femur"] = "femur"
    stem: StemFile | None = None
    """A stem from a file of CAD, placed by `stem_tip_z`. The other keys of stem, neck, trunnion and
    head are left out then."""
    insertion: Insertion | None = None
    """Where the stem is put, other than along the shaft's axis, turned by `anteversion`."""

    @property
    def shoulder_depth(self) -> float | None:
        """Depth of the stem's shoulder below the cut (mm); None: as `stem_tip_z` says."""
        return self.insertion.depth if self.insertion else None

    @property
    def more_room(self) -> tuple[str, str]:
        """The key that says where the stem is, and what to change where it has no room."""
        if not self.insertion:
            return super().more_room
        text = "change insertion, widen the canal (canal_widening), or take a smaller or shorter"
        return "geometry.insertion", f"{text} stem"

    @property
    def head_centre(self) -> Point3:
        """Centre of the femoral head in the model's axes (mm)."""
        return placed_head(self) if self.insertion else super().head_centre

    @property
    def found(self) -> dict[str, Any]:
        """Values that a stem's file answers, by key."""
        return self.stem.values(self.stem_tip_z) if self.stem else {}

    @property
    def told(self) -> dict[str, Any]:
        """Where axis, head and neck of a stem are in its file."""
        return self.stem.told if self.stem else {}

    def _check_stem(self) -> None:
        if not self.stem:
            super()._check_stem()
            return
        for key in (k for k in Femur.model_fields if k.startswith(OF_STEM) and k != "stem_tip_z"):
            value = self.found.get(key)
            if key in self.model_fields_set and getattr(self, key) != value:
                fail("is the file's, where `stem` is one; expected no such key", at=(key,))
            self.__dict__[key] = value
        check_stem(self)

    def _section(self) -> tuple[float, float, float]:
        if not self.stem:
            return super()._section()
        half = float(self.stem.found["around"]) / 8  # of a square
        return half, half, 0.0

    @property
    def proud(self) -> float:
        """Height of the stem's shoulder above the neck cut, along the shaft's axis (mm)."""
        return self.stem_tip_z + self.stem_length - self._cut

    @property
    def mantles(self) -> tuple[Mantle, ...]:
        """The mantle around the stem, with a plug around its end."""
        tip = flanks_end(self) if self.insertion else self.stem_tip_z + self.tip_height
        return (Mantle(spread(self.cement_thickness)[1], tip),)

    @property
    def interface_area(self) -> float:
        """Approximate area of both interfaces (mm2): the stem's flanks and their offset."""
        half, depth, _ = self._section()
        flanks = 3.25 * (half + depth) * self.stem_length
        return 2.0 * flanks + 2.0 * math.pi * spread(self.cement_thickness)[1] * self.stem_length

    def estimate_cells(self, mesh: MeshOptions) -> int:
        """Estimated number of tetrahedra, to 12 %."""
        cells, core, _ = self._cells(mesh)
        length = self.head_offset / math.sin(self.neck_angle)
        above = mesh.steps(0.4 * length) + 1 + mesh.steps(0.6 * length)
        return round(cells + above * core)


class IntactFemur(_Femur):
    """The same femur before the operation: bone alone, with its head and neck.

    The operation and the implant are those that are planned: they do not change the bone, but say
    which of it will be left, and that is what Gruen zones are of. So their strain energy can be
    compared with that of a femur of the same numbers.
    """

    tissues: ClassVar[dict[str, str]] = OF_BONE
    boundary_names: ClassVar[tuple[str, ...]] = ("distal_cut", "bone_surface", "head", *MUSCLES)

    insertion: ClassVar[None] = None
    stem: ClassVar[None] = None

    kind: Literal["intact_femur"] = "intact_femur"
    head_radius: Annotated[float, _length("23 mm", at_least=18.0, at_most=30.0)] = 23.0
    """Radius of the femoral head, 18 to 30 mm; the neck has about two thirds of it."""

    def estimate_cells(self, mesh: MeshOptions) -> int:
        """Estimated number of tetrahedra, to 12 %."""
        cells, _, whole = self._cells(mesh)
        length = self.head_offset / math.sin(self.neck_angle)
        neck = mesh.steps(length - 1.07 * self.head_radius)
        return round(cells + whole * (neck + max(5, 1.4 * self.head_radius / mesh.step_along)))
