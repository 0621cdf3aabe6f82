"""The femur before the operation: closed surface, quality of cells, shared cells of the shaft."""

from __future__ import annotations

import numpy as np
import pytest

from app.case.femurs import FemurResection
from app.case.geometries import IntactFemur
from meshes import femur_intact, quality
from meshes.data import MeshData, exterior_facets
from tests.meshes.femurs import built, hip, sized
from tests.patient.bones import cut


@pytest.mark.parametrize("around", [24, 28, 44])
def test_femur_intact_surface_is_closed(around: int) -> None:
    """Each edge of the surface is on two facets. Lines on flat sides of the stem leave no hole."""
    data = femur_intact.build(IntactFemur(), sized(6.0, around=around))
    facets, _ = exterior_facets(data.cells)
    edges = np.sort(facets[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()


# ------------------------------------------------------------------------------ shared shaft


def test_femur_intact_shares_the_shaft_cells() -> None:
    options = sized(6.0)
    whole, operated = femur_intact.build(IntactFemur(), options), built(6.0)
    normal, level = cut(hip())

    def below(data: MeshData) -> set[tuple[tuple[float, ...], ...]]:
        corners = data.points[data.cells]
        kept = corners[(corners @ normal < level + 1e-5).all(axis=1)]
        return {tuple(sorted(map(tuple, cell))) for cell in kept.tolist()}

    assert below(whole) == below(operated)
    assert len(below(whole)) > 3000


@pytest.mark.parametrize(
    ("curved", "size"),
    [(False, size) for size in (8.0, 7.0, 6.0, 5.01, 5.0, 4.0, 3.0, 2.5, 2.0)]
    + [(True, size) for size in (8.0, 6.0, 5.0, 3.0)]
    + [pytest.param(True, 2.0, marks=pytest.mark.slow)],
)
def test_femur_intact_cells_are_good(curved: bool, size: float) -> None:
    data = femur_intact.build(IntactFemur(), sized(size, curved))
    assert quality.quality_without_length(data.points, data.cells).min() > 0.07


@pytest.mark.parametrize(
    "values",
    [
        {"head_radius": 18.0},
        {"head_radius": 30.0},
        {"cement_thickness": 7.0, "canal_widening": 2.0},  # lines without a layer, up to the head
        {"resection": FemurResection(angle="0.87 rad")},
    ],
)
def test_femur_intact_with_other_parameters_meshes_well(values: dict[str, object]) -> None:
    geometry = IntactFemur().model_copy(update=values)
    for size in (8.0, 5.0):
        data = femur_intact.build(geometry, sized(size, False))
        assert quality.quality_without_length(data.points, data.cells).min() > 0.08, size
