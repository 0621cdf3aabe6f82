"""The cement mantle as meshed: thickness, clipped area, volume."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from app.foundation.arrays import Floats
from meshes.data import MeshData, cell_volumes, faces_of, facet_areas, interface_facets
from meshes.nearest_facets import distance_from_triangles, triangles

if TYPE_CHECKING:
    from meshes.gruen import Zones

CLIPPED_SHARE = 0.9  # of the nominal thickness: thinner is where the canal had no room
# Evenly spread points in a tetrahedron, for its fraction below a level (barycentric).
LATTICE = np.array(
    [(i, j, k, 5 - i - j - k) for i in range(6) for j in range(6 - i) for k in range(6 - i - j)]
)
LATTICE = (LATTICE + 0.25) / 6


def notes_on_mantle(
    data: MeshData, nominal: float, tip: float, zones: Zones | None = None
) -> dict[str, Any]:
    """Thickness and volume of the cement between interfaces stem_cement and cement_bone.

    Args:
        data: The mesh.
        nominal: Nominal thickness, the mean of a graded one [mm].
        tip: Level at which the stem's flanks end [mm]. Its end below and the plug have no
            thickness.
        zones: Zones of the bone around the stem.

    Returns:
        ``thickness`` [mm]: distance of the stem's surface from the bone's, with percentiles by the
        stem's area, and the part of that area where it is below `CLIPPED_SHARE` of the nominal one;
        ``volume`` of the cement and ``plug_volume`` below the flanks [mm^3]; with zones ``gruen``,
        the least, mean and largest thickness on the stem's surface in each.
    """
    facets, _, _ = interface_facets(data, "stem_cement")
    facets = facets[data.points[facets[:, :3], 2].max(axis=1) > tip + 1e-6]
    stem = triangles(data.points, facets)
    centres = stem.mean(axis=1)
    area = facet_areas(stem.reshape(-1, 3), np.arange(3 * len(stem)).reshape(-1, 3))
    bone = triangles(data.points, interface_facets(data, "cement_bone")[0])
    distances = distance_from_triangles(centres, bone)
    nominal_at = zones.thickness(centres) if zones else nominal
    order = np.argsort(distances)
    area_fraction = (np.cumsum(area[order]) - 0.5 * area[order]) / area.sum()
    p5, median, p95 = np.interp([0.05, 0.5, 0.95], area_fraction, distances[order])
    cells = data.cells[data.cell_tags == data.regions["cement"]]
    volumes = cell_volumes(data.points, cells)
    plug_fraction = _fraction_below(data.points[cells[:, :4], 2], tip)
    result: dict[str, Any] = {
        "thickness": {
            "nominal": nominal,
            "min": float(distances.min()),
            "p5": float(p5),
            "median": float(median),
            "mean": float(np.average(distances, weights=area)),
            "p95": float(p95),
            "max": float(distances.max()),
            "clipped_fraction": float(
                area[distances < CLIPPED_SHARE * nominal_at].sum() / area.sum()
            ),
        },
        "volume": float(volumes.sum()),
        "plug_volume": float(volumes @ plug_fraction),
    }
    if zones:
        zone_of = zones.zones_at(centres)
        in_zone = {zone: (zone_of == zone).any(axis=1) for zone in zones.numbers}
        result["gruen"] = {
            str(zone): {
                "min": float(distances[in_this_zone].min()),
                "mean": float(np.average(distances[in_this_zone], weights=area[in_this_zone])),
                "max": float(distances[in_this_zone].max()),
            }
            for zone, in_this_zone in in_zone.items()
            if in_this_zone.any()
        }
    return result


def _fraction_below(z: Floats, level: float) -> Floats:
    """Volume fraction of tetrahedra below a level [mm] (m,), from the heights z (m, 4) [mm]."""
    fraction = (z.max(axis=1) < level).astype(float)
    is_cut = (z.min(axis=1) < level) & (z.max(axis=1) >= level)
    fraction[is_cut] = (z[is_cut] @ LATTICE.T < level).mean(axis=1)
    return fraction


def least_cortex(data: MeshData, tip: float) -> float:
    """Least distance of the endosteum from the bone's surface, from the tip to z = 0 [mm]."""
    cell, face, behind = data.facets_between_regions
    cortex = data.cell_tags == data.regions["cortical_bone"]
    at_endosteum = cortex[cell] & ~cortex[behind]
    facets = faces_of(data.cells, cell[at_endosteum], face[at_endosteum])
    z = data.points[facets[:, :3], 2]
    facets = facets[(z.min(axis=1) > tip) & (z.max(axis=1) < 0)]
    surface = data.facets[np.isin(data.facet_tags, data.boundaries["bone_surface"])]
    distances = distance_from_triangles(
        triangles(data.points, facets).mean(axis=1), triangles(data.points, surface)
    )
    return float(distances.min())
