"""A stack of blocks along z: patch tests, inclines, bars on a frictional foundation."""

from __future__ import annotations

import math
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from app.foundation.arrays import Bools, Floats, Ints
from meshes.data import MeshData, exterior_facets, mesh_data_of, number
from meshes.gmsh_session import grade, session, tetrahedra

if TYPE_CHECKING:
    from app.case.geometries import Blocks
    from app.case.shapes import MeshOptions


def build(geometry: Blocks, mesh: MeshOptions) -> MeshData:
    """Mesh a stack of blocks with the origin at its corner: interfaces are ``<lower>_<upper>``.

    Args:
        geometry: ``blocks``, each with ``name`` and ``size`` (lx, ly, lz) [mm], the first at the
            bottom; ``tilt`` [rad] of the interface planes about y through the stack's axis.
        mesh: ``size``, ``far`` [mm], ``curved``.

    Raises:
        GeometryError: gmsh fails.
    """
    lx, ly, _ = geometry.blocks[0].size
    levels = np.concatenate([[0.0], np.cumsum([block.size[2] for block in geometry.blocks])])
    slope, cosine = math.tan(geometry.tilt), math.cos(geometry.tilt)
    # z of plane k at x = 0 and x = lx; the outer planes stay horizontal.
    planes = np.array([levels, levels]).T
    planes[1:-1] += np.array([-0.5, 0.5]) * slope * lx
    with session("blocks") as gmsh:
        _stack(gmsh, lx, ly, planes)
        distances = [f"((z-{level})-({slope})*(x-{lx / 2}))*{cosine}" for level in levels[1:-1]]
        grade(gmsh, distances, mesh.size, mesh.far_size_or_default if distances else mesh.size)
        points, cells, block = tetrahedra(gmsh, bool(mesh.curved))
    facets, owner = exterior_facets(cells)
    regions, size = number(geometry.region_names), np.array([lx, ly, levels[-1]])
    masks = _boundaries(points[facets[:, :3]].mean(axis=1), block[owner], regions, size)
    return mesh_data_of(points, cells, block, regions, geometry.interface_sides, masks, facets)


def _stack(gmsh: ModuleType, width: float, depth: float, planes: Floats) -> None:
    """Volumes 1, 2, ... from the bottom, sharing their common faces."""
    geo = gmsh.model.geo
    corners, rims, covers = [], [], []
    for left_height, right_height in planes:
        ring = [
            (0, 0, left_height),
            (width, 0, right_height),
            (width, depth, right_height),
            (0, depth, left_height),
        ]
        points = [geo.addPoint(*map(float, xyz)) for xyz in ring]
        corners.append(points)
        rims.append([geo.addLine(points[i], points[(i + 1) % 4]) for i in range(4)])
        covers.append(geo.addPlaneSurface([geo.addCurveLoop(rims[-1])]))
    for k in range(len(planes) - 1):
        posts = [
            geo.addLine(*end_points) for end_points in zip(corners[k], corners[k + 1], strict=True)
        ]
        loops = [[rims[k][i], posts[(i + 1) % 4], -rims[k + 1][i], -posts[i]] for i in range(4)]
        sides = [geo.addPlaneSurface([geo.addCurveLoop(loop)]) for loop in loops]
        geo.addVolume([geo.addSurfaceLoop([*covers[k : k + 2], *sides])], tag=k + 1)
    geo.synchronize()


def _boundaries(x: Floats, block: Ints, regions: dict[str, int], size: Floats) -> dict[str, Bools]:
    """Masks over facets with centres x (n, 3): sides of the stack, and of each block."""
    tolerance = 1e-6 * size.max()
    at_minimum, at_maximum = (x < tolerance).T, (x > size - tolerance).T
    sides = {
        "x_min": at_minimum[0],
        "x_max": at_maximum[0],
        "y_min": at_minimum[1],
        "y_max": at_maximum[1],
    }
    masks = {**sides, "bottom": at_minimum[2], "top": at_maximum[2]}
    for name, tag in regions.items():
        masks |= {f"{name}_{side}": mask & (block == tag) for side, mask in sides.items()}
    return masks
