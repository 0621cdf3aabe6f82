"""Points of the paths of a case in the cells of its mesh."""

from __future__ import annotations

import math

import numpy as np

from app.case.case import Case
from app.case.paths import AnyPath, CirclePath, LinePath, SectionPath
from app.case.shapes import SIDES
from app.scene.scene import Scene
from meshes import paths
from meshes.data import MeshData
from meshes.geometry import is_hip
from meshes.paths import PathPoints


def path_points(case: Case, scene: Scene, data: MeshData, path: AnyPath) -> PathPoints:
    """Return the points of a path; none on an interface or a surface that it does not meet."""
    region = path.region or ""
    if isinstance(path, LinePath):
        return paths.on_line(data, region, path.start, path.end, path.points)
    if isinstance(path, CirclePath):
        return paths.on_circle(data, region, path.centre, path.axis, path.radius, path.points)
    if path.interface is None:
        facets = paths.facets_of_region(data, region)
    else:
        # Contact points of finite sliding lie on the slave, the second boundary.
        boundaries_of_contact = {
            c.name: (c.between[0], c.between[1]) for c in scene.parting_interfaces if c.between
        }
        facets = paths.facets_of_interface(
            data, path.interface, region, boundaries_of_contact.get(path.interface)
        )
    if isinstance(path, SectionPath):
        return paths.on_section(data, facets, path.height, path.points)
    geometry = case.geometry
    local = geometry.placement.to_stem(data.points) if is_hip(geometry) else data.points
    angle = SIDES.index(path.side) * math.pi / 2
    return paths.on_side(data, facets, np.asarray(local), angle, path.points)
