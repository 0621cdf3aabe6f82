"""A patient's femur with a cemented stem, meshed in layers as the parametric one."""

from __future__ import annotations

from typing import Any

from meshes.data import MeshData
from meshes.femur import operated
from meshes.patient_surfaces import PatientSurfaces


def build(geometry: Any, mesh: Any) -> MeshData:
    """Mesh the femur: regions, interfaces and boundaries of the parametric one.

    Raises:
        GeometryError: The stem does not fit the bone, with the place.
    """
    placed = geometry.placement
    surfaces = PatientSurfaces(geometry, mesh, placed)
    lost = placed.trochanter_lost
    told = [*placed.told, *surfaces.told]
    if lost > 0.5:
        told.append(f"the greater trochanter's tip, {lost:.0f} mm above the cut, is left out")
    _, moved = placed.projected(geometry.muscles)
    told.append(f"muscles moved onto the bone (mm): {', '.join(moved)}")
    return operated(geometry, surfaces, placed.to_model, {"told": told})
