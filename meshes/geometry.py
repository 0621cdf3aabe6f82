"""Properties of a case's geometries that meshers read; lengths in mm, angles in rad.

`GeometryKeys` has what every geometry answers. The other protocols add the properties of one kind.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, Self, TypeGuard

from app.mesh_files import Pick
from meshes.data import Sides
from meshes.femur_stem import Graded
from meshes.placement import PlacedStem

if TYPE_CHECKING:
    from meshes.bone_layers import LayeredBone, RadialBone  # scipy at run time

Point = tuple[float, float, float]
Vector = tuple[float, float, float]


class MantleKeys(Protocol):
    """A cement mantle between the interfaces ``stem_cement`` and ``cement_bone``."""

    @property
    def thickness(self) -> float:
        """Nominal thickness, the mean of a graded one."""

    @property
    def tip(self) -> float:
        """Level of the end of the stem's flanks; minus infinity without a plug."""


class GeometryKeys(Protocol):
    """A geometry of a case."""

    @property
    def kind(self) -> str:
        """Kind of geometry, as in the case."""

    @property
    def mesher(self) -> str:
        """Module that meshes it, by `build(geometry, mesh)`."""

    @property
    def shape_keys(self) -> str:
        """Keys to change where cells are poor, in words of a message."""

    @property
    def content(self) -> str:
        """Hash of the content of its files; empty without files."""

    @property
    def region_names(self) -> tuple[str, ...]:
        """Names of the regions."""

    @property
    def boundary_names(self) -> tuple[str, ...]:
        """Names of the boundaries."""

    @property
    def interface_sides(self) -> Mapping[str, Sides]:
        """Regions on the two sides of each interface."""

    @property
    def sliding_boundaries(self) -> Mapping[str, tuple[str, str]]:
        """Boundaries of the two sides of each interface between separately meshed bodies."""

    @property
    def joined(self) -> Collection[Collection[str]]:
        """Groups of regions that are bonded wherever they meet."""

    @property
    def mantles(self) -> Sequence[MantleKeys]:
        """Cement mantles."""

    @property
    def has_gruen_zones(self) -> bool:
        """True if it has the bone around a stem, or around a planned one."""

    @property
    def coarsest_size(self) -> float:
        """Largest edge length that it can be meshed with."""

    def model_copy(self, *, update: Mapping[str, Any]) -> Self:
        """The geometry with some keys changed."""

    def model_dump(self) -> dict[str, Any]:
        """Keys and values."""


class BlockKeys(Protocol):
    """One block of a stack."""

    @property
    def name(self) -> str:
        """Name of its region."""

    @property
    def size(self) -> Vector:
        """Edge lengths along x, y, z."""


class StackKeys(GeometryKeys, Protocol):
    """A stack of blocks along z."""

    @property
    def blocks(self) -> Sequence[BlockKeys]:
        """The blocks, the first at the bottom."""

    @property
    def tilt(self) -> float:
        """Angle of the interface planes about y, through the axis of the stack."""


class CylinderKeys(GeometryKeys, Protocol):
    """Concentric stem, cement and bone about z."""

    @property
    def stem_radius(self) -> float:
        """Radius of the stem at mid height."""

    @property
    def cement_thickness(self) -> float:
        """Radial thickness of the cement."""

    @property
    def bone_thickness(self) -> float:
        """Radial thickness of the bone at mid height."""

    @property
    def length(self) -> float:
        """Length along z."""

    @property
    def taper(self) -> float:
        """Half-angle of the two cones, which are narrower distally."""

    @property
    def sector(self) -> str:
        """Modelled sector: full, half (y >= 0) or quarter (x, y >= 0)."""

    @property
    def fraction(self) -> float:
        """Modelled part of the full circle."""


class FileKeys(GeometryKeys, Protocol):
    """A mesh file, or a script of gmsh."""

    @property
    def path(self) -> Path:
        """The file."""

    @property
    def unit(self) -> str:
        """Unit of its coordinates."""

    @property
    def parameters(self) -> Mapping[str, float]:
        """Constants of a script by name, as it reads them."""

    @property
    def is_script(self) -> bool:
        """True if it is a script."""

    @property
    def pick(self) -> Pick:
        """Parts of the file that make the model."""

    @property
    def interfaces(self) -> Mapping[str, Sides]:
        """Regions on the two sides of each interface."""

    @property
    def apart(self) -> Iterable[Sides]:
        """Sides of the interfaces whose coincident nodes are not merged."""

    def copy_files(self, folder: Path) -> str:
        """Copy the file and those that it names to a folder; return the hash of their content."""


class HipKeys(GeometryKeys, PlacedStem, Protocol):
    """A proximal femur with a stem, or with a planned one."""

    @property
    def femur(self) -> LayeredBone:
        """The bone before the operation."""

    @property
    def cement_thickness(self) -> float | Graded:
        """Thickness of the mantle where the canal has room."""

    @property
    def is_cemented(self) -> bool:
        """True if there is cement between stem and bone."""

    @property
    def level(self) -> float:
        """Level at which the shaft is cut."""

    @property
    def more_room(self) -> tuple[str, str]:
        """Key of the stem's position, and the remedies where the stem has no room."""

    @property
    def flanks_end(self) -> float:
        """Level of the end of the stem's flanks."""

    @property
    def head_centre(self) -> Point:
        """Centre of the head."""

    @property
    def points(self) -> Mapping[str, Point]:
        """Centre of the head and the muscles' insertions."""


class PlannedStemKeys(Protocol):
    """A planned stem by its numbers."""

    def model_copy(self, *, update: Mapping[str, Any]) -> Self:
        """The stem with some keys changed."""


class IntactHipKeys(HipKeys, Protocol):
    """A proximal femur before the operation."""

    @property
    def stem(self) -> PlannedStemKeys:
        """The planned stem, by the keys of the case."""

    @property
    def head_radius(self) -> float:
        """Radius of the femoral head."""


def is_file(geometry: GeometryKeys) -> TypeGuard[FileKeys]:
    """Return True if a geometry is a mesh file or a script."""
    return geometry.kind == "file"


def is_hip(geometry: GeometryKeys) -> TypeGuard[HipKeys]:
    """Return True if a geometry has the bone around a stem, or around a planned one."""
    return geometry.has_gruen_zones


def is_radial(bone: LayeredBone) -> TypeGuard[RadialBone]:
    """Return True if the surfaces of a bone are functions of angle and height."""
    return bone.is_radial
