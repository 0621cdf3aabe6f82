"""A collar on the neck cut: its shape, its support, and meshes of random hips."""

from __future__ import annotations

import random
from functools import cache
from typing import Any

import numpy as np
import pytest

import meshes
from app.case.case import load_case
from app.case.geometries import Femur, MeshOptions
from app.foundation.errors import InputError
from meshes.data import MeshData, interface_facets
from tests.support import CONFIGS

THICKNESS = 3.0  # mm
STANCE = CONFIGS / "stance.yaml"
NO_CEMENT = (
    "geometry.cement_thickness=0 mm",
    "regions.cement=null",
    "interfaces={stem_bone: {kind: contact, friction_coefficient: 0.5}}",
)


def with_collar(angle: float = 90.0, **changes: Any) -> Femur:
    collar = {"thickness": f"{THICKNESS} mm", "angle": f"{angle} deg"}
    return Femur.model_validate({"stem": {"collar": collar}} | changes)


@cache
def meshed(cement: str, order: int = 1, angle: float = 90.0) -> MeshData:
    options = MeshOptions.model_validate({"size": "8 mm", "order": order, "around": 16})
    options = options.model_copy(update={"curved": order == 2})
    return meshes._make(with_collar(angle, cement_thickness=cement), options)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("cement", ["0 mm", "4 mm"])
def test_femur_collar_lies_on_the_cut(cement: str, order: int) -> None:
    data, geometry = meshed(cement, order), with_collar(cement_thickness=cement)
    placement = geometry.placement
    facets, _, under = interface_facets(data, "collar_bone")
    height = (data.points[facets] - placement.foot) @ placement.normal
    assert np.abs(height).max() < 1e-5
    x = data.points[np.unique(data.cells[data.cell_tags == data.regions["collar"], :4])]
    height = (x - placement.foot) @ placement.normal
    outside = np.hypot(*(x - placement.foot)[:, :2].T) > 20.0
    assert height.min() > -1e-5
    assert height[outside].max() == pytest.approx(THICKNESS, abs=1e-5)
    below = {name for name, tag in data.regions.items() if tag in data.cell_tags[under]}
    expected = {"cortical_bone", "cancellous_bone"}
    if geometry.is_cemented:
        expected.add("cement")
    assert below == expected


def test_femur_collar_extends_over_its_angle() -> None:
    """Of 16 lines, 90 deg are four spaces between lines, around medial."""
    data = meshed("0 mm")
    facets, *_ = interface_facets(data, "collar_bone")
    x = data.points[np.unique(facets)]
    edge = x[np.hypot(x[:, 0], x[:, 1]) > 0.8 * np.hypot(x[:, 0], x[:, 1]).max()]
    turns = np.degrees(np.arctan2(edge[:, 1], edge[:, 0]))
    assert turns.max() == pytest.approx(45.0, abs=0.1)
    assert turns.min() == pytest.approx(-45.0, abs=0.1)
    areas = data.notes["interface_areas_mm2"], meshed("0 mm", angle=180.0).notes
    wider = areas[1]["interface_areas_mm2"]["collar_bone"]
    assert 1.5 < wider / areas[0]["collar_bone"] < 2.5
    text = data.notes["messages"][-1]
    assert text.startswith("collar: rests on") and "over 90 deg around medial" in text


def test_femur_collar_leaves_the_bone_as_it_is() -> None:
    plain = Femur.model_validate({"cement_thickness": "0 mm"})
    options = MeshOptions.model_validate({"size": "8 mm", "order": 1, "around": 16})
    without = meshes._make(plain, options.model_copy(update={"curved": False}))
    volumes = [data.notes["volumes_mm3"] for data in (meshed("0 mm"), without)]
    for bone in ("cortical_bone", "cancellous_bone"):
        assert volumes[0][bone] == pytest.approx(volumes[1][bone], rel=1e-9)
    surface, cut = (
        [data.notes["boundary_areas_mm2"][name] for data in (meshed("0 mm"), without)]
        for name in ("bone_surface", "resection")
    )
    assert surface[0] == pytest.approx(surface[1], rel=1e-9)
    rests_on = meshed("0 mm").notes["interface_areas_mm2"]["collar_bone"]
    assert cut[1] - cut[0] == pytest.approx(rests_on, rel=1e-9)


def random_hip(seed: int) -> tuple[Femur, MeshOptions]:
    """A hip with a collar. Cement, cut, version and width of stem, and shoulder are random."""
    of = random.Random(seed)
    width = of.uniform(0.9, 1.1)
    keys = {
        "cement_thickness": of.choice(["0 mm", "2 mm", "3 mm"]),
        "canal_widening": f"{of.uniform(0.5, 2):.2f} mm",
        "anteversion": f"{of.uniform(0, 20):.1f} deg",
        "resection": {
            "height": f"{of.uniform(4, 12):.1f} mm",
            "angle": f"{of.uniform(28, 45):.1f} deg",
        },
        "stem": {
            "half_width": f"{8.5 * width:.2f} mm",
            "half_depth": f"{5 * width:.2f} mm",
            "collar": {
                "thickness": f"{of.uniform(1.5, 6):.2f} mm",
                "angle": f"{of.uniform(30, 180):.0f} deg",
            },
        },
    }
    if keys["cement_thickness"] == "0 mm":
        del keys["canal_widening"]  # it makes room for cement
    order = of.choice([1, 2])
    options = MeshOptions.model_validate({"size": "8 mm", "order": order})
    return Femur.model_validate(keys), options.model_copy(update={"curved": order == 2})


@pytest.mark.parametrize("seed", range(20))
def test_femur_collar_of_random_hips_is_meshed(seed: int) -> None:
    geometry, options = random_hip(seed)
    data = meshes._make(geometry, options)
    assert data.notes["quality"]["sicn_min_by_region"]["collar"] > 0.1
    area = data.notes["interface_areas_mm2"]["collar_bone"]
    volume = data.notes["volumes_mm3"]["collar"]
    # The neck leans over the collar's top.
    assert volume / area == pytest.approx(geometry.stem.collar.thickness, rel=0.1)


@pytest.mark.parametrize(
    ("collar", "text"),
    [
        ("{thickness: 0.5 mm}", "at least 1 mm"),
        ("{angle: 360 deg}", "not between 20 and 320 deg"),
        ("{width: 5 mm}", "width"),
    ],
)
def test_femur_collar_refuses(collar: str, text: str) -> None:
    with pytest.raises(InputError, match=text):
        load_case(STANCE, (f"geometry.stem.collar={collar}",))


def test_femur_collar_needs_a_material_and_a_law() -> None:
    with pytest.raises(InputError) as error:
        load_case(STANCE, (*NO_CEMENT, "geometry.stem.collar={}"))
    assert "no material for collar" in str(error.value)
    assert "no law for collar_bone" in str(error.value)
