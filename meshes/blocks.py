"""A stack of blocks along z: patch tests, inclines, bars on a frictional foundation."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np

from app.arrays import Floats
from app.errors import GeometryError
from meshes.data import MeshData, exterior_facets
from meshes.gmsh_child import grade, session, tetrahedra
from meshes.tags import assemble, number


def build(geometry: Any, mesh: Any) -> MeshData:
    """Mesh a stack of blocks with the origin at its corner: interfaces are ``<lower>_<upper>``.

    Args:
        geometry: ``blocks``, each with ``name`` and ``size`` (lx, ly, lz) [mm], the first at the
            bottom; ``tilt`` [rad] of the interface planes about y through the stack's axis.
        mesh: ``size``, ``far_size`` [mm], ``curved``.

    Raises:
        GeometryError: The tilted planes cross, or gmsh fails.
    """
    blocks = geometry.blocks
    lx, ly, _ = blocks[0].size
    levels = np.concatenate([[0.0], np.cumsum([block.size[2] for block in blocks])])
    slope = math.tan(geometry.tilt)
    # z of plane k at x = 0 and x = lx; the outer planes stay horizontal.
    planes = np.array([levels, levels]).T
    planes[1:-1] += np.array([-0.5, 0.5]) * slope * lx
    if np.any(np.diff(planes, axis=0) <= 0):
        thinnest = min(block.size[2] for block in blocks)
        raise GeometryError(
            f"geometry.tilt: the interface planes, tilted by {math.degrees(geometry.tilt):g} deg"
            f" over a width of {lx:g} mm, cross each other or the ends (thinnest block"
            f" {thinnest:g} mm); tilt less or make the blocks thicker"
        )
    regions = number(block.name for block in blocks)
    far_size = mesh.far_size or 4 * mesh.size
    with session("blocks") as gmsh:
        _stack(gmsh, lx, ly, planes)
        cosine = math.cos(geometry.tilt)
        distances = [f"((z-{level})-({slope})*(x-{lx / 2}))*{cosine}" for level in levels[1:-1]]
        grade(gmsh, distances, mesh.size, far_size if distances else mesh.size)
        points, cells, entity = tetrahedra(gmsh, mesh.curved)
    exterior = exterior_facets(cells)
    names = [block.name for block in blocks]
    boundaries = _boundaries(
        points[exterior[0][:, :3]].mean(axis=1), entity[exterior[1]], names, (lx, ly, levels[-1])
    )
    interfaces = {
        f"{lower}_{upper}": ((lower,), (upper,)) for lower, upper in itertools.pairwise(names)
    }
    return assemble(
        points, cells, entity.astype(np.int32), regions, interfaces, boundaries, exterior
    )


def _stack(gmsh: Any, lx: float, ly: float, planes: Floats) -> None:
    """Volumes 1, 2, ... from the bottom, sharing their common faces."""
    geo = gmsh.model.geo
    corners, rims, covers, sides = [], [], [], []
    for left, right in planes:
        ring = [(0, 0, left), (lx, 0, right), (lx, ly, right), (0, ly, left)]
        corners.append([geo.addPoint(*map(float, xyz)) for xyz in ring])
        c = corners[-1]
        rims.append([geo.addLine(c[i], c[(i + 1) % 4]) for i in range(4)])
        covers.append(geo.addPlaneSurface([geo.addCurveLoop(rims[-1])]))
    for k in range(len(planes) - 1):
        posts = [geo.addLine(corners[k][i], corners[k + 1][i]) for i in range(4)]
        sides.append(
            [
                geo.addPlaneSurface(
                    [geo.addCurveLoop([rims[k][i], posts[(i + 1) % 4], -rims[k + 1][i], -posts[i]])]
                )
                for i in range(4)
            ]
        )
        loop = geo.addSurfaceLoop([covers[k], covers[k + 1], *sides[k]])
        geo.addVolume([loop], tag=k + 1)
    geo.synchronize()


def _boundaries(
    centres: Floats, entity: Any, names: list[str], size: tuple[float, float, float]
) -> dict[str, Any]:
    x, y, z = centres.T
    lx, ly, lz = size
    near = 1e-6 * max(size)
    sides = {
        "x_min": x < near,
        "x_max": x > lx - near,
        "y_min": y < near,
        "y_max": y > ly - near,
    }
    masks = {**sides, "bottom": z < near, "top": z > lz - near}
    for k, name in enumerate(names, start=1):
        masks |= {f"{name}_{side}": mask & (entity == k) for side, mask in sides.items()}
    return masks
