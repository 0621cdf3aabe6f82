"""Layers around a stem without cement: the stem is exact, the bone is cut."""

from __future__ import annotations

import numpy as np
import pytest

from app.case.femurs import Femur, IntactFemur
from app.case.shapes import MeshOptions
from app.foundation.errors import GeometryError
from meshes import _make
from meshes.data import MeshData, region_volumes
from meshes.gruen import Zones
from meshes.layered_surfaces import LayeredSurfaces

MESH = MeshOptions.model_validate({"size": "10 mm", "curved": True, "around": 20})
# Half-widths of a stem that fills the canal of the parametric femur.
TIP = {"tip_half_width": "5.5 mm", "tip_half_depth": "5.5 mm", "tip_corner_radius": "4 mm"}
FILLING = {"half_width": "12 mm", "half_depth": "8 mm", **TIP}
WIDER = {**FILLING, "tip_half_width": "12 mm", "tip_half_depth": "12 mm"}


def femur(**keys: object) -> Femur:
    return Femur.model_validate({"kind": "femur", "cement_thickness": "0 mm", **keys})


@pytest.fixture(scope="module")
def pressed() -> MeshData:
    return _make(femur(), MESH)


def test_layered_surfaces_without_cement_divide_the_same_femur(pressed: MeshData) -> None:
    """Bone replaces the cement. Stem and outside are those of a cemented femur."""
    volumes = region_volumes(pressed)
    cemented = region_volumes(_make(femur(cement_thickness="4 mm", tip_void="5 mm"), MESH))
    assert set(volumes) == {"stem", "cortical_bone", "cancellous_bone"}
    assert volumes["stem"] == pytest.approx(cemented["stem"], rel=1e-4)
    assert volumes["cortical_bone"] == pytest.approx(cemented["cortical_bone"], rel=0.01)
    assert sum(volumes.values()) == pytest.approx(sum(cemented.values()), rel=2e-3)
    assert list(pressed.interfaces) == ["stem_bone"]
    assert "mantle" not in pressed.notes


def test_layered_surfaces_without_cement_keep_good_cells(pressed: MeshData) -> None:
    assert pressed.notes["quality"]["sicn_min"] > 0.015


def test_layered_surfaces_stem_takes_what_it_needs_of_the_cortex() -> None:
    wide = femur(stem=FILLING)
    surfaces = LayeredSurfaces(wide, MESH)
    (note,) = surfaces.notes
    assert "the stem takes up to 2." in note
    lines = surfaces.lines(np.zeros(3), np.array([surfaces.tip, surfaces.cut - 5, surfaces.cut]))
    assert (lines.mantle == 0).all()
    assert (lines.endosteum >= 0).all()


def test_layered_surfaces_refuse_a_stem_that_leaves_too_little_cortex() -> None:
    with pytest.raises(GeometryError, match=r"of the cortex, of 1\.5 mm at least|outside the"):
        LayeredSurfaces(femur(stem=WIDER), MESH)


def test_layered_surfaces_zones_leave_out_the_cortex_that_a_stem_takes() -> None:
    """The bone of the intact femur is gone where a stem reaches into the cortex."""
    wide, cemented = femur(stem=FILLING), femur(cement_thickness="4 mm", stem=FILLING)
    z = -60.0
    x = np.array([[r, 0.0, z] for r in np.linspace(0.0, 14.0, 29)])
    taken = ~Zones(wide).is_left(x)
    half = wide.implant.section(z)[0]
    assert x[taken, 0].max() == pytest.approx(half, abs=0.5)
    assert not Zones(cemented).is_left(x[:10]).any()


def test_layered_surfaces_intact_femur_of_a_planned_stem_without_cement() -> None:
    keys = {"kind": "intact_femur", "cement_thickness": "0 mm", "stem": FILLING}
    planned = IntactFemur.model_validate(keys)
    here, usual = (region_volumes(_make(g, MESH)) for g in (planned, IntactFemur()))
    for name, volume in usual.items():
        assert here[name] == pytest.approx(volume, rel=0.02)
