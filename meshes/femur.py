"""A proximal femur with a stem, in cement or in contact with the bone, meshed in layers.

The mantle has the prescribed thickness where the canal has room for it and ends at the endosteal
surface elsewhere. Both surfaces, and those of stem and bone, are functions on one grid
(`layered_surfaces`), along which a cross-section is swept (`swept`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from app.foundation.arrays import Bools, Floats, Ints
from meshes import swept
from meshes.data import MeshData, Sides, facet_areas, interface_facets, mesh_data_of, number
from meshes.layered_surfaces import LayeredSurfaces

if TYPE_CHECKING:
    from app.case.hips import Hip, OperatedHip
    from app.case.shapes import MeshOptions

PATCH_RADIUS = 8.0  # of a muscle's attachment [mm]


def build(geometry: OperatedHip, mesh: MeshOptions) -> MeshData:
    """Mesh the femur with the regions and interfaces of the geometry.

    Boundaries are distal_cut, bone_surface, stem_trunnion, resection and six muscle patches;
    notes have the head centre, layers and messages. ``mesh`` are options of a case.

    Raises:
        GeometryError: The stem does not fit the canal (with the place), or its neck or shoulder
            does not go with the neck cut.
    """
    surfaces = geometry.surfaces(mesh)
    swept_mesh = swept.meshed_layers(surfaces, bool(mesh.curved))
    facets, owner = swept_mesh.facets
    bone = np.array([name.endswith("bone") for name in swept_mesh.names])[swept_mesh.region[owner]]
    masks = {
        "distal_cut": swept_mesh.on(facets, s=0),
        "bone_surface": bone & swept_mesh.on(facets, rho=4),
        "stem_trunnion": swept_mesh.on(facets, s=surfaces.collar[1] + surfaces.segments[-1].steps),
        "resection": bone & swept_mesh.on(facets, s=surfaces.cut),
    }
    x = geometry.placement.to_model(swept_mesh.nodes.x)
    data = assembled(
        geometry, swept_mesh, x, geometry.region_names, geometry.interface_sides, masks
    )
    messages = [*surfaces.bone.notes, *surfaces.notes]
    if "collar_bone" in data.interfaces:
        messages.append(_collar(data, surfaces))
    return replace(data, notes={**data.notes, "messages": messages}) if messages else data


def _collar(data: MeshData, surfaces: LayeredSurfaces) -> str:
    """Angle and areas on which a collar rests, in words."""
    facets, _, cells_below = interface_facets(data, "collar_bone")
    area = facet_areas(data.points, facets)
    on_cortex = area[data.cell_tags[cells_below] == data.regions["cortical_bone"]].sum()
    angle = 360.0 * len(surfaces.spans) / surfaces.around
    note = f"collar: rests on {area.sum():.0f} mm2 over {angle:.0f} deg around medial"
    return f"{note}, {on_cortex:.0f} mm2 of them on cortical bone"


def assembled(
    geometry: Hip,
    swept_mesh: swept.Swept,
    x: Floats,
    regions: tuple[str, ...],
    interfaces: Mapping[str, Sides],
    masks: dict[str, Bools],
) -> MeshData:
    """The mesh of nodes x with tags, patches and notes; masks are over its exterior facets."""
    tag_of = number(regions)
    tags = np.array([tag_of.get(name, 0) for name in swept_mesh.names])[swept_mesh.region]
    facets, _ = swept_mesh.facets
    masks |= _patches(geometry, x, facets, masks["bone_surface"])
    data = mesh_data_of(x, swept_mesh.cells, tags, tag_of, interfaces, masks, facets)
    notes = {"head_centre": list(geometry.head_centre), "layers": swept_mesh.describe()}
    return replace(data, notes=notes, given_neighbours=swept_mesh.partner.reshape(-1, 4) // 4)


def _patches(geometry: Hip, points: Floats, facets: Ints, surface: Bools) -> dict[str, Bools]:
    """Masks over exterior facets of the bone, for each muscle attachment.

    A patch is the facets nearest to the insertion with the total area of a disc of `PATCH_RADIUS`,
    exact to half a facet.
    """
    on_surface = np.flatnonzero(surface)
    centre = points[facets[on_surface][:, :3]].mean(axis=1)
    areas = facet_areas(points, facets[on_surface])
    masks: dict[str, Bools] = {}
    for name, insertion_point in geometry.points.items():
        if name == "head_centre":
            continue
        order = np.argsort(
            np.round(((centre - insertion_point) ** 2).sum(axis=1), 6), kind="stable"
        )
        total = np.cumsum(areas[order]) - 0.5 * areas[order]
        nearest_facets = order[: max(1, int((total <= np.pi * PATCH_RADIUS**2).sum()))]
        masks[name] = np.zeros(len(facets), dtype=bool)
        masks[name][on_surface[nearest_facets]] = True
    return masks
