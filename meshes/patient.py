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
    surfaces = PatientSurfaces(geometry, mesh, geometry.placement)
    told = [*(f"{k}: {v}" for k, v in geometry.told.items()), *surfaces.told]
    return operated(geometry, surfaces, geometry.placement.to_model, told)
