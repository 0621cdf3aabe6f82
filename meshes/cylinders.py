"""Concentric stem, cement and bone, straight or tapered: the fast verification scene."""

from __future__ import annotations

import math
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from app.foundation.arrays import Bools, Floats, Ints
from meshes.data import MeshData, exterior_facets, mesh_data_of, number
from meshes.gmsh_session import grade, session, tetrahedra
from meshes.quality import POOR, sicn

if TYPE_CHECKING:
    from app.case.geometries import Cylinders
    from app.case.shapes import MeshOptions

SLICE_LENGTH = 2.0  # mesh sizes: shorter cylinders may be swept
Radii = tuple[float, float, float]  # of the stem, the cement and the bone [mm]


def build(geometry: Cylinders, mesh: MeshOptions) -> MeshData:
    """Mesh concentric cylinders about the z axis, from z = 0 (distal) to ``length``.

    Regions are stem, cement and bone, interfaces stem_cement and cement_bone.

    Args:
        geometry: ``stem_radius``, ``cement_thickness``, ``bone_thickness``, ``length`` [mm];
            ``taper`` [rad], the half-angle of the two cones, narrower distally, whose radii hold
            at mid height; ``sector`` full, half (y >= 0) or quarter (x, y >= 0).
        mesh: ``size``, ``far`` [mm], ``curved``.

    Raises:
        GeometryError: gmsh fails.
    """
    middle = geometry.stem_radius + geometry.cement_thickness
    radii = (geometry.stem_radius, middle, middle + geometry.bone_thickness)
    points, cells, entity = _tetrahedra(geometry, mesh, radii, swept=False)
    if geometry.taper == 0 and geometry.length < SLICE_LENGTH * mesh.size:
        # Between two faces a cell apart the generator left a flat cell in 10 of 100 slices. Where
        # it does not, its cells give smoother pressures than swept ones.
        if sicn(points, cells).min() < POOR:
            points, cells, entity = _tetrahedra(geometry, mesh, radii, swept=True)
    # Volumes are recognised by the mean position of their cells.
    cell_tags = np.zeros(len(cells), dtype=np.int64)
    x, y, z = points[cells[:, :4]].mean(axis=1).T
    wider = math.tan(geometry.taper) * (z - geometry.length / 2)
    shell = np.searchsorted(radii[:2], np.hypot(x, y) - wider) + 1
    for volume in np.unique(entity):
        in_volume = entity == volume
        cell_tags[in_volume] = np.bincount(shell[in_volume]).argmax()
    regions, (facets, owner) = number(geometry.region_names), exterior_facets(cells)
    masks = _boundaries(points[facets[:, :3]], cell_tags[owner], regions, geometry, radii[2])
    return mesh_data_of(points, cells, cell_tags, regions, geometry.interface_sides, masks, facets)


def _tetrahedra(
    geometry: Cylinders, mesh: MeshOptions, radii: Radii, swept: bool
) -> tuple[Floats, Ints, Ints]:
    """Nodes, cells and the volume of each cell."""
    slope, length = math.tan(geometry.taper), geometry.length
    with session("cylinders") as gmsh:
        if swept:
            _slice(gmsh, radii, length, geometry.sector, max(1, round(length / mesh.size)))
        else:
            angle = 2 * math.pi * geometry.fraction
            _solids(gmsh, radii, slope * length / 2, length, angle)
        distances = [f"(sqrt(x*x+y*y)-{r}-({slope})*(z-{length / 2}))" for r in radii[:2]]
        grade(gmsh, distances, mesh.size, mesh.far_size_or_default)
        return tetrahedra(gmsh, bool(mesh.curved))


def _solids(gmsh: ModuleType, radii: Radii, rise: float, length: float, angle: float) -> None:
    occ = gmsh.model.occ
    solids = [
        (3, occ.addCone(0, 0, 0, 0, 0, length, radius - widening, radius + widening, angle=angle))
        if widening
        else (3, occ.addCylinder(0, 0, 0, 0, 0, length, radius, angle=angle))
        for radius, widening in zip(radii, (rise, rise, 0.0), strict=True)
    ]
    stem, cement, bone = solids
    occ.fragment([bone], [cement, stem])
    occ.synchronize()


def _slice(gmsh: ModuleType, radii: Radii, length: float, sector: str, layers: int) -> None:
    """Three nested rings, meshed in the plane and swept."""
    occ = gmsh.model.occ
    reach = 2 * radii[-1]
    corner = {"full": (-reach, -reach), "half": (-reach, 0.0), "quarter": (0.0, 0.0)}[sector]
    discs = []
    for radius in reversed(radii):
        disc = [(2, occ.addDisk(0, 0, 0, radius, radius))]
        if sector != "full":
            sector_face = [(2, occ.addRectangle(*corner, 0, reach - corner[0], reach - corner[1]))]
            disc, _ = occ.intersect(disc, sector_face)
        discs += disc
    faces, _ = occ.fragment(discs[:1], discs[1:])
    occ.extrude(faces, 0, 0, length, numElements=[layers])
    occ.synchronize()


def _boundaries(
    x: Floats, region: Ints, regions: dict[str, int], geometry: Cylinders, outer: float
) -> dict[str, Bools]:
    """Masks over facets with corners x (n, 3, 3): ends, planes of symmetry, the outer surface."""
    tolerance = 1e-6 * geometry.length
    on_x, on_y, is_bottom = np.all(np.abs(x) < tolerance, axis=1).T
    is_top = np.all(np.abs(x[..., 2] - geometry.length) < tolerance, axis=1)
    masks: dict[str, Bools] = {}
    for name, tag in regions.items():
        masks |= {
            f"{name}_bottom": is_bottom & (region == tag),
            f"{name}_top": is_top & (region == tag),
        }
    masks |= {"bottom": is_bottom, "top": is_top}
    planes = {"symmetry_x": on_x, "symmetry_y": on_y}
    is_side = ~is_bottom & ~is_top
    masks |= {n: mask & is_side for n, mask in planes.items() if n in geometry.boundary_names}
    masks["bone_surface"] = np.all(
        np.abs(np.hypot(x[..., 0], x[..., 1]) - outer) < 1e-6 * outer, axis=1
    )
    return masks
