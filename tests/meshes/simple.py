"""A stack of blocks and a rod in a tube, and their meshes."""

from __future__ import annotations

from typing import Any

import meshes
from app.case.geometries import Block, Blocks, Cylinders, MeshOptions
from meshes.data import MeshData

ROD = Cylinders(
    stem_radius="7 mm",
    cement_thickness="4 mm",
    bone_thickness="6 mm",
    length="20 mm",
    taper="1 deg",
)


def options(size: float, **more: Any) -> MeshOptions:
    return MeshOptions(size=f"{size} mm", **more)


def mesh(geometry: Any, size: float, **more: Any) -> MeshData:
    return meshes.build(geometry, options(size, **more))


STACK = Blocks(
    blocks=(
        Block(name="low", size=["10 mm", "8 mm", "5 mm"]),
        Block(name="mid", size=["10 mm", "8 mm", "4 mm"]),
        Block(name="high", size=["10 mm", "8 mm", "3 mm"]),
    ),
    tilt="5 deg",
)
