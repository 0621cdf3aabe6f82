"""Patients whose bone is the parametric femur in triangles."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import pytest

import meshes
from app.case.geometries import Femur, MeshOptions
from app.patient.geometry import Patient
from meshes.data import MeshData
from tests.patient.bones import MEASURED, VERSION, cut

TURNED = Femur.model_validate({"anteversion": f"{VERSION} deg"})

COARSE = {"size": "8 mm", "order": 1, "around": 14}


def patient(folder: Path, **changes: Any) -> Patient:
    """A patient of the surfaces in a folder."""
    given: dict[str, Any] = {"kind": "patient", "bone": {"surface": "bone.stl"}}
    return Patient.model_validate(given | changes, context={"folder": folder})


def options(**given: Any) -> MeshOptions:
    """Mesh options, coarse ones by default."""
    mesh = MeshOptions.model_validate(COARSE | given)
    return mesh.model_copy(update={"curved": mesh.order == 2})


@cache
def made(geometry: Any) -> MeshData:
    """The mesh of a bone with its stem."""
    return meshes._make(geometry, options())


def as_own(folder: Path, **changes: Any) -> Patient:
    """The operation of the parametric femur on its triangles, with exact landmarks."""
    normal, level = cut(TURNED)
    # Depth of the shoulder's edge, at z = 29 mm, below the cut.
    depth = (level + normal[0] * 9.0789) / normal[2] - 29.0
    marks = {"lesser_trochanter": [20.0, -5.0, 0.0], "shaft": [[0, 0, -100], [0, 0, -20]]}
    operation = {"resection": {"height": "5 mm"}, "insertion": {"depth": f"{depth} mm"}}
    return patient(folder, landmarks=marks, distal_cut_z="-200 mm", **operation | changes)


# Tests of a measured femur, which is too large to be shipped.
measured = pytest.mark.skipif(not MEASURED.exists(), reason="no measured femur here")
