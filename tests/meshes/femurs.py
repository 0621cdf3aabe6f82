"""Parametric femurs and their meshes."""

from __future__ import annotations

from functools import cache
from typing import Any

from app.case.geometries import Femur, MeshOptions
from app.case.stems import Stem
from meshes import femur
from meshes.data import MeshData


def hip(**values: Any) -> Femur:
    """A femur with some parameters, of itself or of its stem, in mm and radians."""
    numbers = {key: values.pop(key) for key in [*values] if key in Stem.model_fields}
    stem = Stem().model_copy(update=numbers)
    return Femur().model_copy(update=values | {"stem": stem})


@cache
def built(size: float, curved: bool = False, **values: Any) -> MeshData:
    return femur.build(hip(**values), sized(size, curved))


def sized(size: float, curved: bool = False, **values: Any) -> MeshOptions:
    return MeshOptions(size=f"{size!r} mm", curved=curved, **values)
