"""Concentric stem, cement and bone, straight or tapered: the fast verification scene."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from app.arrays import Floats
from app.errors import GeometryError
from meshes.data import MeshData, exterior_facets
from meshes.gmsh_child import grade, session, tetrahedra
from meshes.quality import POOR, sicn
from meshes.tags import assemble, number

REGIONS = ("stem", "cement", "bone")
SLICE = 2.0  # mesh sizes: shorter cylinders may be swept
Radii = tuple[float, float, float]  # of the stem, the cement and the bone [mm]
ANGLES = {"full": 2 * math.pi, "half": math.pi, "quarter": math.pi / 2}


def build(geometry: Any, mesh: Any) -> MeshData:
    """Mesh concentric cylinders about the z axis, from z = 0 (distal) to ``length``.

    Regions are stem, cement and bone, interfaces stem_cement and cement_bone.

    Args:
        geometry: ``stem_radius``, ``cement_thickness``, ``bone_thickness``, ``length`` [mm];
            ``taper`` [rad], the half-angle of the two cones, narrower distally, whose radii hold
            at mid height; ``sector`` full, half (y >= 0) or quarter (x, y >= 0).
        mesh: ``size``, ``far_size`` [mm], ``curved``.

    Raises:
        GeometryError: A cone closes or leaves the bone, or gmsh fails.
    """
    inner = geometry.stem_radius
    middle = inner + geometry.cement_thickness
    rise = math.tan(geometry.taper) * geometry.length / 2
    if abs(rise) >= inner:
        raise GeometryError(
            f"geometry.taper: a half-angle of {math.degrees(geometry.taper):g} deg closes the stem"
            f" (radius {inner:g} mm, length {geometry.length:g} mm); taper less or shorten it"
        )
    if abs(rise) >= geometry.bone_thickness:
        raise GeometryError(
            f"geometry.taper: the cement ({rise:.3g} mm wider at the end) leaves the bone"
            f" ({geometry.bone_thickness:g} mm thick); taper less or thicken the bone"
        )
    radii = (inner, middle, middle + geometry.bone_thickness)
    slope = math.tan(geometry.taper)
    points, cells, entity = _tetrahedra(geometry, mesh, radii, swept=False)
    if geometry.taper == 0 and geometry.length < SLICE * mesh.size:
        # Between two faces a cell apart the generator left a flat cell in 10 of 100 slices. Where
        # it does not, its cells give smoother pressures than swept ones.
        if sicn(points, cells).min() < POOR:
            points, cells, entity = _tetrahedra(geometry, mesh, radii, swept=True)
    # Volumes are recognised by the mean position of their cells.
    cell_tags = np.zeros(len(cells), dtype=np.int32)
    x, y, z = points[cells[:, :4]].mean(axis=1).T
    shell = np.searchsorted(radii[:2], np.hypot(x, y) - slope * (z - geometry.length / 2)) + 1
    for volume in np.unique(entity):
        own = entity == volume
        cell_tags[own] = np.bincount(shell[own]).argmax()
    exterior = exterior_facets(cells)
    boundaries = _boundaries(points, exterior[0], cell_tags[exterior[1]], geometry, radii[2])
    interfaces = {
        "stem_cement": (("stem",), ("cement",)),
        "cement_bone": (("cement",), ("bone",)),
    }
    return assemble(points, cells, cell_tags, number(REGIONS), interfaces, boundaries, exterior)


def _tetrahedra(geometry: Any, mesh: Any, radii: Radii, swept: bool) -> tuple[Floats, Any, Any]:
    slope = math.tan(geometry.taper)
    with session("cylinders") as gmsh:
        if swept:
            layers = max(1, round(geometry.length / mesh.size))
            _slice(gmsh, radii, geometry.length, geometry.sector, layers)
        else:
            rise = slope * geometry.length / 2
            _solids(gmsh, radii, rise, geometry.length, ANGLES[geometry.sector])
        distances = [
            f"(sqrt(x*x+y*y)-{radius}-({slope})*(z-{geometry.length / 2}))" for radius in radii[:2]
        ]
        grade(gmsh, distances, mesh.size, mesh.far_size or 4 * mesh.size)
        return tetrahedra(gmsh, mesh.curved)


def _solids(gmsh: Any, radii: Radii, rise: float, length: float, angle: float) -> None:
    occ = gmsh.model.occ

    def solid(radius: float, rise: float) -> tuple[int, int]:
        if rise == 0:
            return 3, occ.addCylinder(0, 0, 0, 0, 0, length, radius, angle=angle)
        return 3, occ.addCone(0, 0, 0, 0, 0, length, radius - rise, radius + rise, angle=angle)

    stem, cement, bone = solid(radii[0], rise), solid(radii[1], rise), solid(radii[2], 0.0)
    occ.fragment([bone], [cement, stem])
    occ.synchronize()


def _slice(gmsh: Any, radii: Radii, length: float, sector: str, layers: int) -> None:
    """Three nested rings, meshed in the plane and swept."""
    occ = gmsh.model.occ
    reach = 2 * radii[-1]
    corner = {"full": (-reach, -reach), "half": (-reach, 0.0), "quarter": (0.0, 0.0)}[sector]
    discs = []
    for radius in reversed(radii):
        disc = [(2, occ.addDisk(0, 0, 0, radius, radius))]
        if sector != "full":
            part = [(2, occ.addRectangle(*corner, 0, reach - corner[0], reach - corner[1]))]
            disc, _ = occ.intersect(disc, part)
        discs += disc
    faces, _ = occ.fragment(discs[:1], discs[1:])
    occ.extrude(faces, 0, 0, length, numElements=[layers])
    occ.synchronize()


def _boundaries(
    points: Floats, facets: Any, region: Any, geometry: Any, outer: float
) -> dict[str, Any]:
    corners = points[facets[:, :3]]
    near = 1e-6 * geometry.length

    def plane(axis: int, at: float) -> Any:
        return np.all(np.abs(corners[:, :, axis] - at) < near, axis=1)

    bottom, top = plane(2, 0.0), plane(2, geometry.length)
    masks: dict[str, Any] = {}
    for name, tag in number(REGIONS).items():
        masks |= {f"{name}_bottom": bottom & (region == tag), f"{name}_top": top & (region == tag)}
    masks |= {"bottom": bottom, "top": top}
    symmetry = {"full": (), "half": ("symmetry_y",), "quarter": ("symmetry_x", "symmetry_y")}
    planes = {"symmetry_x": plane(0, 0.0), "symmetry_y": plane(1, 0.0)}
    masks |= {name: planes[name] & ~bottom & ~top for name in symmetry[geometry.sector]}
    masks["bone_surface"] = np.all(
        np.abs(np.hypot(corners[..., 0], corners[..., 1]) - outer) < 1e-6 * outer, axis=1
    )
    return masks
