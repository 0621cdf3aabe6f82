"""Geometries of a case: parameters, and the names of regions, boundaries and interfaces.

No mesh is made here, so that the rest of a case can be checked without a mesher.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field, PrivateAttr, model_validator

from app.case.femurs import Femur, IntactFemur
from app.case.mesh_names import constants, content_hash, counts, physical_names
from app.case.shapes import Mantle, MeshOptions, Shape, Sides, graded_cells
from app.mesh_files import Pick
from app.mesh_files.named import stamps
from app.schema.paths import file
from app.schema.section import ITEMS, MAPPING, Kinds, Name, Pair, Section, fail, not_one_of
from app.schema.units import Angle, Number, PositiveLength, SizeVector

__all__ = ["Block", "Blocks", "Cylinders", "Femur", "Geometry", "IntactFemur"]
__all__ += ["MeshFile", "MeshOptions", "Sides"]

# Longest edges of cells. Beyond them gmsh fails or its cells are flat (measured). Rings of 20 and
# blocks of 25 are solved in `mantle stress`.
LONGEST_EDGE_IN_RADII = 2.0  # in radii
LONGEST_EDGE_IN_RINGS = 20.0  # in thicknesses of rings
LONGEST_EDGE_IN_BLOCKS = 25.0  # in thicknesses of blocks


class Block(Section):
    """One block of a stack."""

    name: Name
    """Name of its region."""
    size: SizeVector
    """Edge lengths along x, y, z."""


class Blocks(Shape):
    """Rectangular blocks stacked along z, corner at the origin; the scene of patch tests."""

    mesher: ClassVar[str] = "meshes.blocks"

    kind: Literal["blocks"] = "blocks"
    blocks: Annotated[tuple[Block, ...], ITEMS]
    """The blocks from bottom to top, all with the same x and y edges."""
    tilt: Angle = 0.0
    """Angle (rad) by which every interface is tilted about y, through the axis of the stack."""

    @model_validator(mode="after")
    def _stackable(self) -> Blocks:
        if not self.blocks:
            fail("is empty; expected at least one block", at=("blocks",))
        for i, block in enumerate(self.blocks):
            if block.name in [b.name for b in self.blocks[:i]]:
                message = f"'{block.name}' is the name of an earlier block too; choose another name"
                fail(message, at=("blocks", i, "name"))
            if block.size[:2] != self.blocks[0].size[:2]:
                fail(
                    "differs in x or y from the first block; all need the same cross-section",
                    at=("blocks", i, "size"),
                )
        if len({*self.region_names, *self.interface_sides}) < 2 * len(self.blocks) - 1:
            message = "two interfaces would have the same name, <block>_<block>; rename a block"
            fail(message, at=("blocks",))
        rise = 0.5 * self.blocks[0].size[0] * math.tan(abs(self.tilt))
        if abs(self.tilt) >= math.pi / 4 or rise >= 0.5 * min(b.size[2] for b in self.blocks):
            fail(
                "is too large: a tilted interface crosses its neighbour; expected a smaller angle",
                at=("tilt",),
            )
        return self

    @property
    def boundary_names(self) -> tuple[str, ...]:
        """The six sides of the stack, and the four sides of each block."""
        sides = ("x_min", "x_max", "y_min", "y_max")
        sides_of_blocks = tuple(f"{name}_{side}" for name in self.region_names for side in sides)
        return (*sides, "bottom", "top", *sides_of_blocks)

    @property
    def tissues(self) -> dict[str, str]:
        """``other`` for every block."""
        return {b.name: "other" for b in self.blocks}

    @property
    def interface_sides(self) -> dict[str, Sides]:
        """``<lower>_<upper>`` for each pair of neighbours."""
        region_names = self.region_names
        return {f"{a}_{b}": ((a,), (b,)) for a, b in itertools.pairwise(region_names)}

    @property
    def spans(self) -> dict[tuple[str | int, ...], tuple[float, float]]:
        """The edges of each block."""
        return {
            ("blocks", i, "size"): (min(b.size), LONGEST_EDGE_IN_BLOCKS)
            for i, b in enumerate(self.blocks)
        }

    @property
    def interface_area(self) -> float:
        """Area of all interfaces (mm2)."""
        width, depth, _ = self.blocks[0].size
        return (len(self.blocks) - 1) * width * depth / math.cos(self.tilt)

    def estimate_cells(self, mesh: MeshOptions) -> int:
        """Estimated number of tetrahedra."""
        width, depth, _ = self.blocks[0].size
        volume = width * depth * sum(b.size[2] for b in self.blocks)
        return graded_cells(self.interface_area, volume, mesh)


class Cylinders(Shape):
    """A stem in a cement mantle in a bone, concentric about z; distal end at z = 0.

    With a taper the interfaces are cones that narrow towards z = 0 and have the given radii at mid
    length. ``sector: half`` keeps y >= 0, ``quarter`` keeps x >= 0 and y >= 0.
    """

    mesher: ClassVar[str] = "meshes.cylinders"
    is_around_z: ClassVar[bool] = True
    has_curved_surfaces: ClassVar[bool] = True
    tissues: ClassVar[dict[str, str]] = {"stem": "implant", "cement": "cement", "bone": "bone"}
    interface_sides: ClassVar[dict[str, Sides]] = {
        "stem_cement": (("stem",), ("cement",)),
        "cement_bone": (("cement",), ("bone",)),
    }

    kind: Literal["cylinders"] = "cylinders"
    stem_radius: PositiveLength
    """Radius of the stem at mid length."""
    cement_thickness: PositiveLength
    """Radial thickness of the cement mantle."""
    bone_thickness: PositiveLength
    """Radial thickness of the bone at mid length."""
    length: PositiveLength
    """Length along z."""
    taper: Angle = 0.0
    """Half-angle of the cones (rad)."""
    sector: Literal["full", "half", "quarter"] = "full"
    """Modelled part of the full circle."""

    @model_validator(mode="after")
    def _solid(self) -> Cylinders:
        if abs(self.taper) >= math.pi / 4:
            fail("is not a half-angle below 45 deg", at=("taper",))
        rise = 0.5 * self.length * math.tan(abs(self.taper))
        if rise >= self.stem_radius:
            fail("makes the stem vanish at an end; expected a smaller angle", at=("taper",))
        if rise >= self.bone_thickness:
            fail("makes the bone vanish at an end; expected a smaller angle", at=("taper",))
        return self

    @property
    def boundary_names(self) -> tuple[str, ...]:
        """Ends by region and together, the outer surface, and the planes of symmetry."""
        ends = tuple(f"{r}_{end}" for r in self.region_names for end in ("top", "bottom"))
        planes = {"full": (), "half": ("symmetry_y",), "quarter": ("symmetry_x", "symmetry_y")}
        return (*ends, "top", "bottom", "bone_surface", *planes[self.sector])

    @property
    def fraction(self) -> float:
        """Modelled part of the full circle."""
        return {"full": 1.0, "half": 0.5, "quarter": 0.25}[self.sector]

    @property
    def spans(self) -> dict[tuple[str | int, ...], tuple[float, float]]:
        """Least radius of the stem, least thicknesses of the others, and the length."""
        rise = 0.5 * self.length * math.tan(abs(self.taper))
        return {
            ("stem_radius",): (self.stem_radius - rise, LONGEST_EDGE_IN_RADII),
            ("cement_thickness",): (self.cement_thickness, LONGEST_EDGE_IN_RINGS),
            ("bone_thickness",): (self.bone_thickness - rise, LONGEST_EDGE_IN_RINGS),
            ("length",): (self.length, LONGEST_EDGE_IN_BLOCKS),
        }

    @property
    def mantles(self) -> tuple[Mantle, ...]:
        """The mantle between stem and bone, from end to end."""
        return (Mantle(self.cement_thickness, -math.inf),)

    @property
    def interface_area(self) -> float:
        """Area of both interfaces (mm2)."""
        radii = 2.0 * self.stem_radius + self.cement_thickness
        return self.fraction * 2.0 * math.pi * radii * self.length / math.cos(self.taper)

    def estimate_cells(self, mesh: MeshOptions) -> int:
        """Estimated number of tetrahedra."""
        outer = self.stem_radius + self.cement_thickness + self.bone_thickness
        volume = self.fraction * math.pi * outer**2 * self.length
        return graded_cells(self.interface_area, volume, mesh)


_Side = Annotated[tuple[str, ...], BeforeValidator(lambda v: (v,) if isinstance(v, str) else v)]
_TwoSides = Annotated[tuple[_Side, _Side], Pair("[cement, [cortical, cancellous]]")]


def _has_regions(path: Path, keys: Mapping[str, Any]) -> None:
    if not physical_names(path, 3, Pick(keys.get("array") or "", keys.get("meshes") or ())):
        raise ValueError("names no region: it has no physical volume with a name")


class MeshFile(Shape):
    """A mesh file; its named volumes or sets of cells are regions, its named surfaces boundaries.

    Files of gmsh (``.msh``), Abaqus and CalculiX (``.inp``), FEBio (``.feb``), VTU (``.vtu``,
    ``.pvtu``), XDMF and MED are taken as they are. A ``.geo`` script of gmsh is meshed: it must
    declare ``DefineConstant[ size = 1 ];`` and may declare ``far_size``. The mesh section sets both
    (in the script's unit). Further constants are set by ``parameters``.
    """

    mesher: ClassVar[str] = "meshes.imported"

    kind: Literal["file"] = "file"
    # Before the path, whose check needs them.
    array: str | None = None
    """Array of cells whose values are the regions, where a VTU or XDMF file has several."""
    meshes: Annotated[tuple[str, ...], ITEMS] = ()
    """Meshes that make the model, where a MED file has several of tetrahedra."""
    path: Annotated[Path, file(check=_has_regions)]
    """The file; relative to the case file."""
    unit: Literal["mm", "cm", "m", "um", "inch"] = "mm"
    """Unit of the file's coordinates."""
    parameters: Annotated[dict[Name, Number], MAPPING] = Field(default_factory=dict)
    """Values of constants that a script declares by `DefineConstant`, by name: lengths in its
    unit, angles as it reads them."""
    interfaces: Annotated[dict[Name, _TwoSides], MAPPING] = Field(default_factory=dict)
    """For each interface, the regions on its two sides (a name or a list of names each)."""

    # Interfaces across which coincident nodes stay two; the case knows them.
    _apart: tuple[str, ...] = PrivateAttr(())

    @model_validator(mode="after")
    def _declared(self) -> MeshFile:
        if self.parameters and not self.is_script:
            fail("apply only to a .geo script; leave them out", at=("parameters",))
        declared_names = constants(self.path) if self.parameters else ()
        for name in self.parameters:
            if name in ("size", "far_size"):
                fail(
                    "is set by the mesh section: mesh.size, mesh.far_size", at=("parameters", name)
                )
            if name not in declared_names:
                fail(not_one_of(name, declared_names), at=("parameters", name))
        return self

    @model_validator(mode="after")
    def _known(self) -> MeshFile:
        for name, sides in self.interfaces.items():
            for i, side in enumerate(sides):
                for region in side:
                    if region not in self.region_names:
                        fail(not_one_of(region, self.region_names), at=("interfaces", name, i))
            if set(sides[0]) & set(sides[1]):
                fail("has the same region on both sides", at=("interfaces", name))
        return self

    @property
    def has_curved_surfaces(self) -> bool:
        """True for a script: its cells are straight where the surface is flat."""
        return self.is_script

    @property
    def coarsest_size(self) -> float:
        """Largest edge length (mm); 0 for a ``.msh`` file, which is meshed already."""
        return math.inf if self.is_script else 0.0

    @property
    def pick(self) -> Pick:
        """Parts of the file that make the model."""
        return Pick(self.array or "", self.meshes)

    @property
    def region_names(self) -> tuple[str, ...]:
        """Names of the physical volumes."""
        return physical_names(self.path, 3, self.pick)

    @property
    def boundary_names(self) -> tuple[str, ...]:
        """Names of the physical surfaces."""
        return physical_names(self.path, 2, self.pick)

    @property
    def details(self) -> dict[str, object]:
        """Regions and boundaries that the file names."""
        return {"regions": list(self.region_names), "boundaries": list(self.boundary_names)}

    @property
    def interface_sides(self) -> dict[str, Sides]:
        """The declared interfaces."""
        return dict(self.interfaces)

    @property
    def joined(self) -> tuple[tuple[str, ...], ...]:
        """Regions on one side of an interface are one body."""
        return tuple(side for sides in self.interfaces.values() for side in sides)

    @property
    def apart(self) -> tuple[Sides, ...]:
        """Sides of the interfaces across which nodes in one place stay two."""
        return tuple(self.interfaces[name] for name in self._apart)

    def parted(self, names: Iterable[str]) -> MeshFile:
        """The same with the interfaces that have finite sliding."""
        parted_file = self.model_copy()
        parted_file._apart = tuple(names)
        return parted_file

    def estimate_cells(self, mesh: MeshOptions) -> int:
        """Number of elements of any dimension in the file, an upper bound; 0 for a script."""
        return 0 if self.is_script else counts(self.path, self.pick)

    @property
    def is_script(self) -> bool:
        """True if the file is still to be meshed."""
        return self.path.suffix.lower() == ".geo"

    @cached_property
    def content(self) -> str:
        """Hash of the file at the first access."""
        return content_hash(self.path)

    @property
    def modified(self) -> float:
        """Time at which the file, or one that it names, was modified last [s]."""
        return max(stamp for _, stamp in stamps(self.path)) / 1e9

    def copy_files(self, folder: Path) -> str:
        """Copy the file, and files that it names, to a folder; return their hash."""
        return content_hash(self.path, folder)


Geometry = Annotated[Shape, Kinds()]
