"""Keys and estimates of all femurs, parametric or a patient's: cut, stem and mantle."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, GetCoreSchemaHandler, GetJsonSchemaHandler, PrivateAttr
from pydantic_core import core_schema

from app.case.shapes import (
    GRADING,
    LEAST_CEMENT,
    Mantle,
    MeshOptions,
    Point3,
    Shape,
    Sides,
    Thickness,
    perimeter,
    range_of_thickness,
)
from app.case.stems import Stem, StemFile
from app.foundation.arrays import Bools, Floats
from app.foundation.implant import LEAST_CELL_HEIGHT, Implant
from app.laws.values import ROUNDING_OF_HEIGHTS
from app.schema.section import Section, did_you_mean, fail, show
from app.schema.units import Angle, Dimension, Length, PositiveLength
from app.system import folders
from meshes.placement import (
    Placement,
    head_in_words,
    placement_of,
    shoulder_level,
    stem_head,
)

# `best_position` and `room` are imported where they are used: scipy takes 0.15 s.
if TYPE_CHECKING:
    from app.case.femurs import FemurResection
    from meshes.bone_layers import LayeredBone
    from meshes.layered_surfaces import LayeredSurfaces

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


# Part of the lines around the stem on which cement reaches the cortex, so that no cancellous bone
# is left, for a mantle that is 0, 1, 2, ... mm thicker than the canal was widened. FILLED_BELOW:
# part of the lines below the stem.
FILLED = (0.0, 0.05, 0.4, 0.64, 0.7, 0.74, 0.8, 0.85, 0.9)
FILLED_BELOW = (0.0, 0.0, 0.0, 0.75, 1.0)
CANCELLOUS_WIDTH = 5.0  # mean width of cancellous bone (mm)
CORTICAL_WIDTH = 6.2  # mean width of cortical bone around a canal that is not widened (mm)
# Interfaces of a stem in its cement, and of a stem in bone.
CEMENTED: dict[str, Sides] = {
    "stem_cement": (("stem",), ("cement",)),
    "cement_bone": (("cement",), BONE),
}
UNCEMENTED: dict[str, Sides] = {"stem_bone": (("stem",), BONE)}
# Straight facets of a parametric stem that meet at less than this angle are one face (rad).
ROUNDED_ANGLE = math.radians(60.0)
COLLAR = "collar"  # region of a collar
ON_CUT = "collar_bone"  # interface under it
VOID = 5.0  # length without bone below a stem without cement (mm), by default
# Further steps at edges along a stem from CAD: fits the cells of eight stems within 16 %.
EDGE_STEPS = 8
INSIDE = 2.0 / 3.0  # least fraction of the stem in the bone
HALF_TIP = 10.0  # mm that a stem's end reaches from its axis, at most


def point(x: Floats) -> Point3:
    """Numbers of a vector."""
    return float(x[0]), float(x[1]), float(x[2])


class Resection(Section):
    """The cut across the neck."""

    height: Length = 8.0
    """Height above the lesser trochanter at which the cut leaves the medial cortex."""
    angle: Annotated[float, Dimension("rad", "an angle", "38 deg", at_least=0.0, below=1.2)] = (
        math.radians(38.0)
    )
    """Angle of the cut to the transverse plane (rad), below 1.2."""
    azimuth: Angle | None = None
    """Direction of the cut's normal about the shaft, from medial to anterior (rad); by default the
    neck's."""


class Version(Section):
    """Rotation of the stem about the shaft's axis."""

    relative_to: Literal["neck", "condyles"] = "neck"
    """Line from which the angle is measured: the neck, or the line of the posterior condyles."""
    angle: Angle = 0.0
    """Rotation (rad); positive moves the head anteriorly."""


def _tilt(largest: float) -> Dimension:
    """Largest change of a tilt or rotation (rad)."""
    return Dimension("rad", "an angle", "3 deg", at_least=0.0, at_most=largest)


class Search(Section):
    """Limits of the search for a stem's position. 0 keeps the given value."""

    varus: Annotated[float, _tilt(0.2)] = math.radians(3.0)
    """Largest change of `varus` (rad)."""
    flexion: Annotated[float, _tilt(0.2)] = math.radians(3.0)
    """Largest change of `flexion` (rad)."""
    version: Annotated[float, _tilt(1.0)] = math.radians(10.0)
    """Largest change of the angle of `version` (rad)."""
    offset: Annotated[float, Dimension("mm", "a length", "4 mm", at_least=0.0, at_most=20.0)] = 4.0
    """Largest change of `medial_offset` and of `anterior_offset`."""


class Insertion(Section):
    """Position of the stem in the femur."""

    depth: Annotated[float, Dimension("mm", "a length", "0 mm", at_most=14.0)] | None = None
    """Depth of the lateral edge of the shoulder below the cut, at most 14 mm: the space above it is
    filled with cement, or with bone. By default 0; in the parametric femur it follows from
    `tip_z`."""
    varus: Annotated[float, Dimension("rad", "an angle", "2 deg", at_least=-0.2, at_most=0.2)] = 0.0
    """Rotation of the stem (rad) about the point where its axis meets the cut; positive moves the
    tip laterally."""
    flexion: Annotated[float, Dimension("rad", "an angle", "2 deg", at_least=-0.2, at_most=0.2)] = (
        0.0
    )
    """Rotation of the stem (rad) about the same point; positive moves the tip posteriorly."""
    version: Version = Field(default_factory=Version)
    """Rotation of the stem about the shaft's axis."""
    medial_offset: Length = 0.0
    """Distance of the stem's axis from the shaft's to medial, along the cut's azimuth."""
    anterior_offset: Length = 0.0
    """Distance of the stem's axis from the shaft's to anterior."""
    best: Search | None = None
    """Search for the position with the most room around the stem, near the one that the other keys
    give; its depth stays. `insertion: best` is `insertion: {best: {}}`."""


class _Best:
    """Marks a field as an insertion, or the word `best` for one that is searched."""

    def read(self, value: object) -> object:
        """The keys of an insertion.

        Raises:
            PydanticCustomError: Another word.
        """
        if isinstance(value, str) and value != "best":
            keys = ", ".join(Insertion.model_fields)
            hint = did_you_mean(value, ["best"])
            fail(f"{show(value)} is neither 'best' nor a mapping of the keys {keys}{hint}")
        return {"best": {}} if value == "best" else value

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """Replace the word before the keys are read."""
        return core_schema.no_info_before_validator_function(self.read, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """The keys, or the word."""
        return {"anyOf": [handler(schema), {"const": "best"}]}


InsertionOrBest = Annotated[Insertion, _Best()]


class Hip(Shape):
    """A proximal femur that is operated on, or for which an operation is planned.

    A subclass has the keys of its bone, of its cut and of its stem. It gives them as `femur`,
    `resection`, `insertion`, `shoulder_depth` and `implant`; `meshes` knows no others.
    """

    is_around_z: ClassVar[bool] = True
    has_gruen_zones: ClassVar[bool] = True
    has_curved_surfaces: ClassVar[bool] = True
    coarsest_size: ClassVar[float] = 20.0  # a few cells along the stem
    cement_thickness: Thickness = 4.0
    """Thickness of the mantle where the canal has room, 1 to 8 mm: one value, or values by height
    and side. `0 mm`: no cement. The stem is then in contact with the bone (interface
    `stem_bone`)."""
    plug_length: PositiveLength = 10.0
    """Length of cement below the tip. Without cement: length below the tip over which the cells
    keep the outline of the stem."""
    tip_void: Annotated[float, Dimension("mm", "a length", "5 mm", at_least=0.0)] | None = None
    """Length without cement or bone below the stem's end, as in a hollow centraliser. The end is
    then flat and carries no load. 0, or at least 1 mm and at most 1 mm less than the plug. By
    default 0 in cement, and 5 mm without cement."""

    if TYPE_CHECKING:
        stem: Stem | StemFile
        resection: Resection | FemurResection

        @property
        def insertion(self) -> Insertion | None:
            """Position of the stem; None: along the shaft's axis."""

    @property
    def medial_cut_height(self) -> float | None:
        """The key `resection.height`."""
        return self.resection.height

    @property
    def femur(self) -> LayeredBone:
        """The bone before the operation, as `meshes.bone_layers` describes it."""
        raise NotImplementedError

    @property
    def implant(self) -> Implant:
        """The stem in its axes."""
        raise NotImplementedError

    @property
    def more_room(self) -> tuple[str, str]:
        """Key of the stem's position, and the advice if the stem does not fit."""
        raise NotImplementedError

    def surfaces(self, mesh: MeshOptions) -> LayeredSurfaces:
        """The nested surfaces that are meshed."""
        raise NotImplementedError

    @property
    def shoulder_depth(self) -> float | None:
        """Depth of the stem's shoulder below the cut (mm); None: the implant has its level."""
        return None

    @property
    def proud(self) -> float:
        """Height of the stem's shoulder above the neck cut, along the shaft's axis (mm)."""
        if self.shoulder_depth is not None:
            return -self.shoulder_depth
        return self.implant.shoulder - self.cut_height

    @property
    def widening(self) -> float:
        """Distance by which the table's endosteum is moved outwards (mm)."""
        return 0.0

    @property
    def joined(self) -> tuple[tuple[str, ...], ...]:
        """The bone is one body."""
        return (BONE,)

    @property
    def placement(self) -> Placement:
        """Cut and stem in the model's axes."""
        return placement_of(self)

    @property
    def cut_height(self) -> float:
        """Height at which the cut meets the stem's axis, in the stem's axes (mm)."""
        return float(self.placement.top)

    @property
    def level(self) -> float:
        """Level at which the shaft is cut, in the model's axes (mm)."""
        raise NotImplementedError

    @property
    def distal_height(self) -> float:
        """Height at which the shaft is cut, in the stem's axes (mm)."""
        raise NotImplementedError

    @property
    def head_centre(self) -> Point3:
        """Centre of the head in the model's axes (mm)."""
        return point(stem_head(self))

    @property
    def flanks_end(self) -> float:
        """Level of the end of the stem's flanks in the model's axes (mm)."""
        implant = self.implant
        end = [0.0, 0.0, implant.tip_z + implant.tip_height]
        return float(self.placement.to_model(end)[2]) + HALF_TIP * self.placement.tilt

    @property
    def is_cemented(self) -> bool:
        """True if there is cement around the stem."""
        return self.cement_thickness != 0.0

    @property
    def void(self) -> float:
        """Length without cement or bone below the stem's end (mm)."""
        if self.tip_void is None:
            return 0.0 if self.is_cemented else VOID
        return self.tip_void

    @property
    def plug_end(self) -> str:
        """Words for the level `plug_length` below the tip."""
        return "the plug's end" if self.is_cemented else f"{self.plug_length:g} mm below the tip"

    @property
    def rounded_angle(self) -> float:
        """Angle (rad) up to which straight facets at an edge stand for a rounded one.

        Corners of a parametric stem are round, however coarse its mesh is.
        """
        return ROUNDED_ANGLE if self.implant.cad is None else 0.0

    def height_on_stem(self, x: Floats) -> Floats:
        """Height of points (n, 3) above the stem's tip, along the stem (n,) [mm]."""
        return np.asarray(self.placement.to_stem(x)[:, 2] - self.implant.tip_z)

    def on_flanks(self, x: Floats) -> Bools:
        """True at points (n, 3) that are neither on the stem's end nor on its shoulder (n,)."""
        implant, height = self.implant, self.height_on_stem(x)
        is_on_flanks = (height >= implant.tip_height - ROUNDING_OF_HEIGHTS) & (
            height <= implant.length + ROUNDING_OF_HEIGHTS
        )
        return np.asarray(is_on_flanks)

    def off_bone(self, interface: str, x: Floats) -> Bools:
        """True at points (n, 3) of an interface on the shoulder of a stem without cement (n,).

        The stem was pushed in from there, so no bone is above its shoulder.
        """
        if self.is_cemented or interface == ON_CUT:
            return np.zeros(len(x), dtype=bool)
        return np.asarray(shoulder_level(self.implant, self.placement, x) <= ROUNDING_OF_HEIGHTS)

    def check_end(self) -> None:
        """Refuse a void below the stem that cannot be meshed."""
        if 0.0 < self.void < LEAST_CELL_HEIGHT:
            fail("must be 0 or at least 1 mm", at=("tip_void",))
        if self.void and self.void > self.plug_length - LEAST_CELL_HEIGHT:
            message = (
                f"{self.void:g} mm leaves less than 1 mm of plug_length, {self.plug_length:g} mm"
            )
            fail(message, at=("tip_void",))

    def _section(self) -> tuple[float, float, float]:
        """Half-width, half-depth and corner radius a quarter of the way from cut to tip (mm)."""
        implant = self.implant
        return implant.section(0.25 * implant.tip_z + 0.75 * self.cut_height)

    @property
    def stem_length(self) -> float:
        """Height of the stem's shoulder over its tip (mm)."""
        return self.implant.length

    @property
    def stem_perimeter(self) -> float:
        """Length around the stem where lines are counted (mm)."""
        return perimeter(*self._section())

    def interface_nodes(self, mesh: MeshOptions) -> float:
        """Number of nodes on each interface: lines around at steps along."""
        lines_around, stem, *_ = self.grid(mesh).values()
        return float(lines_around * stem)

    def grid(self, mesh: MeshOptions) -> dict[str, Any]:
        """Lines around, steps along the stem and below it, cells through the layers."""
        implant = self.implant
        stem, further_steps, _ = mesh.graded(
            self.cut_height - implant.tip_z - implant.tip_height, "stem"
        )
        lengths_of_ends = 2.0 * (self.plug_length - self.void), implant.tip_height, self.void
        below, equal, _ = mesh.graded(implant.plug - self.distal_height, "below")
        cells_through = mesh.cells_through(self.cement_thickness)
        edges, about = (0, "") if implant.cad is None else (EDGE_STEPS, ", about")
        return {
            "lines around": mesh.lines_around(self._section(), self.cement_thickness),
            f"steps along the stem{about}": len(stem)
            - 1
            + further_steps
            + sum(map(mesh.steps, filter(None, lengths_of_ends)))
            + edges,
            "steps below": len(below) - 1 + equal,
            "cells through cement, cancellous and cortical bone": cells_through,
        }

    def _cells(self, mesh: MeshOptions) -> tuple[float, float, float]:
        """Estimated numbers of tetrahedra: below the neck cut, and in one step of core and layers.

        Three for each triangle of the section. Where the mantle fills the canal, along a part of
        the circumference fitted to counted meshes, there is no cancellous bone. A wider canal has
        thinner cortical bone. Of 370 random hips, 367 have the number of cells within 12 %, and all
        within 18 %.
        """
        lines_around, stem, below, (_, *bone) = self.grid(mesh).values()
        cells_through = (mesh.along_cement(self.cement_thickness), *bone)
        core = 3.0 * max(lines_around - 2.0, 0.041 * lines_around**2 + 1.5 * lines_around - 6.0)
        cement = range_of_thickness(self.cement_thickness)[1]
        filled_thickness = cement - self.widening
        open_ = 1.0 - float(np.interp(filled_thickness, range(len(FILLED)), FILLED))
        unfilled_below = 1.0 - float(
            np.interp(filled_thickness, range(len(FILLED_BELOW)), FILLED_BELOW)
        )
        widths = (1.0 + 0.7 * cement, CANCELLOUS_WIDTH, CORTICAL_WIDTH - self.widening)
        through, cancellous, cortical = (
            min(cells, max(1.0, width / length))
            for cells, width, length in zip(cells_through, widths, mesh.least_through, strict=True)
        )
        layers = stem * (through + cortical + cancellous * open_)
        layers += below * (through + cortical + cancellous * unfilled_below)
        # In neck and head cancellous bone is wide, cortical bone thin.
        full_section = 6.0 * lines_around * (through + 0.2 * bone[0] + 0.8 * cancellous + 1.0)
        return (stem + below) * core + 6.0 * lines_around * layers, core, core + full_section


class OperatedHip(Hip):
    """A proximal femur with a stem, in cement or in contact with the bone."""

    mesher: ClassVar[str] = "meshes.femur"
    boundary_names: ClassVar[tuple[str, ...]] = (
        *("distal_cut", "bone_surface", "stem_trunnion"),
        *MUSCLES,
        "resection",
    )

    @property
    def has_collar(self) -> bool:
        """True if the stem has a collar that rests on the neck cut."""
        return self.implant.collar_thickness > 0.0

    @property
    def joined(self) -> tuple[tuple[str, ...], ...]:
        """The bone is one body, and so are a stem and its collar."""
        return (BONE, ("stem", COLLAR)) if self.has_collar else (BONE,)

    @property
    def press_fits(self) -> tuple[str, ...]:
        """Interfaces of a stem without cement."""
        return () if self.is_cemented else ("stem_bone", ON_CUT)

    @property
    def tissues(self) -> dict[str, str]:
        """Tissue of each region."""
        tissues = {"stem": "implant"}
        if self.has_collar:
            tissues[COLLAR] = "implant"
        if self.is_cemented:
            tissues["cement"] = "cement"
        return tissues | OF_BONE

    @property
    def interface_sides(self) -> dict[str, Sides]:
        """Regions on the two sides of each interface."""
        sides = CEMENTED if self.is_cemented else UNCEMENTED
        if not self.has_collar:
            return sides
        return sides | {ON_CUT: ((COLLAR,), ("cement", *BONE) if self.is_cemented else BONE)}

    def without_effect(self, mesh: MeshOptions) -> dict[tuple[str, ...], str]:
        """Keys of the case that do nothing beside others, with the reason; given ones or not."""
        keys = super().without_effect(mesh)
        if self.void and not isinstance(self.stem, StemFile):
            reason = f"the end of the stem is flat above a void of {self.void:g} mm (tip_void)"
            keys["geometry", "stem", "tip_rounding"] = reason
        longest = max(step for _, step, _ in GRADING.values()) * mesh.step_along
        if mesh.far_size_or_default >= longest:
            keys["mesh", "far_size"] = f"no step along a femur is longer than {longest:g} mm"
        return keys

    @property
    def laws_to_write(self) -> dict[str, str]:
        """Interfaces of metal on bone: without a law they would be ingrown."""
        laws = {}
        if not self.is_cemented:
            laws["stem_bone"] = "{kind: contact, friction_coefficient: 0.5}"
        if self.has_collar:
            laws[ON_CUT] = "{kind: contact, friction_coefficient: 0.3}"
        return laws

    @property
    def left_out(self) -> dict[str, tuple[str, ...]]:
        """Region and interfaces of the cement, if there is none."""
        if self.is_cemented:
            return {"interfaces": tuple(UNCEMENTED)}
        return {"regions": ("cement",), "interfaces": tuple(CEMENTED)}

    # Gain of a position that was searched, in words.
    _gain: str = PrivateAttr("")

    @property
    def ways_to_widen_canal(self) -> tuple[str, ...]:
        """Ways to widen the canal, if there is one, for the advice if the stem does not fit."""
        raise NotImplementedError

    @property
    def least_room(self) -> float:
        """Room that the stem must have everywhere (mm): for cement, or none without cement."""
        return LEAST_CEMENT if self.is_cemented else 0.0

    def search(self) -> None:
        """Replace a position that is to be searched by the best one."""
        insertion = self.insertion
        if insertion and insertion.best:
            from meshes.best_position import searched

            best_insertion, self._gain = searched(self, insertion, folders.cache("positions"))
            self.__dict__["insertion"] = best_insertion

    @property
    def placement_details(self) -> dict[str, str]:
        """Head of the stem against the intact one, and the gain of a search, in words."""
        details = {"head of the stem": head_in_words(self)}
        return details | ({"best position": self._gain} if self._gain else {})

    def room_details(self) -> str:
        """Least room around the stem, in words."""
        from meshes.room import fit_of

        return fit_of(self).words(self.placement)

    @property
    def mantles(self) -> tuple[Mantle, ...]:
        """The mantle around the stem, with a plug around its end; none without cement."""
        if not self.is_cemented:
            return ()
        return (Mantle(range_of_thickness(self.cement_thickness)[1], self.flanks_end),)

    @property
    def interface_area(self) -> float:
        """Approximate area of all interfaces (mm2): the flanks, and their offset in cement."""
        half_width, depth, _ = self._section()
        length = self.implant.length
        flanks = 3.25 * (half_width + depth) * length
        if not self.is_cemented:
            return flanks
        return 2.0 * flanks + 2.0 * math.pi * range_of_thickness(self.cement_thickness)[1] * length

    def estimate_cells(self, mesh: MeshOptions) -> int:
        """Estimated number of tetrahedra, to 12 %."""
        cells, core, _ = self._cells(mesh)
        implant = self.implant
        length = implant.head_offset / math.sin(implant.neck_angle)
        above = mesh.steps(0.4 * length) + 1 + mesh.steps(0.6 * length)
        return round(cells + above * core)
