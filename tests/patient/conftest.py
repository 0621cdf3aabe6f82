"""A folder of DICOM slices."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.patient.bones import slices
from tests.patient.voxel_images import NUMBERS, PLACES


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return slices(tmp_path / "ct", NUMBERS, PLACES)
