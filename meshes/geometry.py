"""Kinds of geometries, by what they answer: meshers do not import the classes of cases."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeGuard

if TYPE_CHECKING:
    from app.case.geometries import MeshFile
    from app.case.hips import Hip
    from app.case.shapes import Shape
    from meshes.bone_layers import LayeredBone, RadialBone  # scipy at run time


def is_file(geometry: Shape) -> TypeGuard[MeshFile]:
    """Return True if a geometry is a mesh file or a script."""
    return geometry.kind == "file"


def is_hip(geometry: Shape) -> TypeGuard[Hip]:
    """Return True if a geometry has the bone around a stem, or around a planned one."""
    return geometry.has_gruen_zones


def is_radial(bone: LayeredBone) -> TypeGuard[RadialBone]:
    """Return True if the surfaces of a bone are functions of angle and height."""
    return bone.is_radial
