"""Search for the position with the most room for cement."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.case.geometries import Femur
from app.system import folders
from meshes import best_position, room
from meshes.best_position import Limits
from meshes.placement import Position
from meshes.room import StemSurface
from tests.meshes.canals import CUT, IMPLANT, RADIUS, START, rod, tube

WANTED = 4.0  # mm: all the room that a rod of 5 mm has in the middle of the canal
LIMITS = Limits(math.radians(3), math.radians(3), math.radians(10), 4.0, 4.0)


@pytest.fixture(autouse=True)
def new_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Use a cache without positions of earlier searches."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


def wanted(theta: object, z: object) -> float:
    """Thickness requested by the case [mm]."""
    return WANTED


@pytest.mark.parametrize(("varus", "flexion"), [(1.5, 0.0), (-1.0, 2.0), (0.0, 0.0)])
def test_best_position_is_the_axis_of_a_round_canal(varus: float, flexion: float) -> None:
    """A rod has the most room along the axis: the difference of the radii, to the grid's error."""
    lean = math.tan(math.radians(varus)), math.tan(math.radians(flexion))
    canal = room.canal_of(CUT, tube((1.5, -1.0), lean))
    rod_in = rod(5.0)
    best = best_position.roomiest_position(canal, rod_in, START, LIMITS, wanted)
    fit = room.fit(canal, rod_in, CUT.put(IMPLANT, best, False))
    assert fit.least == pytest.approx(RADIUS - 5.0, abs=0.1)
    assert math.degrees(best.varus) == pytest.approx(varus, abs=0.15)
    assert math.degrees(best.flexion) == pytest.approx(flexion, abs=0.15)
    assert best.version == pytest.approx(0.0, abs=1e-6)  # a turn of a rod gains nothing


def test_best_position_stays_within_limits_and_keeps_what_is_fixed() -> None:
    canal = room.canal_of(CUT, tube((6.0, 0.0), (0.0, 0.0)))
    limits = replace(LIMITS, varus=0.0, flexion=0.0, version=0.0, medial=2.0)
    best = best_position.roomiest_position(canal, rod(5.0), START, limits, wanted)
    assert (best.varus, best.flexion, best.version) == (0.0, 0.0, 0.0)
    assert best.medial == pytest.approx(2.0, abs=1e-6)


def test_best_position_with_nothing_free_is_the_given_one() -> None:
    canal = room.canal_of(CUT, tube((6.0, 0.0), (0.0, 0.0)))
    fixed = Limits(0.0, 0.0, 0.0, 0.0, 0.0)
    assert best_position.roomiest_position(canal, rod(5.0), START, fixed, wanted) == START
    given = {"varus": "0.04 deg", "flexion": "0.06 deg"}  # not rounded
    none = {"varus": "0 deg", "flexion": "0 deg", "version": "0 deg", "offset": "0 mm"}
    before = Femur.model_validate({"insertion": given})
    after = Femur.model_validate({"insertion": given | {"best": none}})
    np.testing.assert_array_equal(after.placement.rotation, before.placement.rotation)
    np.testing.assert_array_equal(after.placement.foot, before.placement.foot)


def test_best_position_with_enough_room_is_the_given_one() -> None:
    canal = room.canal_of(CUT, tube((0.5, 0.0), (0.0, 0.0)))
    best = best_position.roomiest_position(canal, rod(5.0), START, LIMITS, lambda theta, z: 3.0)
    assert best == START


def test_best_position_never_has_less_room_than_the_given_one() -> None:
    """A gain on every third line may be a loss on the others, and rounding may cost more."""
    for depth in ("0 mm", "2.428 mm"):
        given = {"depth": depth}
        before = Femur.model_validate({"insertion": given})
        after = Femur.model_validate({"insertion": given | {"best": {}}})
        canal, stem = room.widest_canal(before), StemSurface.of(before.implant, before.placement)
        least = [room.fit(canal, stem, femur.placement).least for femur in (before, after)]
        assert least[1] >= least[0]


def test_best_position_places_a_stem_that_does_not_fit() -> None:
    """A stem in 3 deg of varus cuts the cortex.

    The search finds room, and the case gets numbers for keys.
    """
    given = {"insertion": {"varus": "3 deg"}, "stem": {"length": "130 mm"}, "tip_z": "-101 mm"}
    before = Femur.model_validate(given)
    stem = StemSurface.of(before.implant, before.placement)
    canal = room.widest_canal(before)
    assert room.fit(canal, stem, before.placement).least < 0.0
    best = {"insertion": {"varus": "3 deg", "best": {}}}
    femur = Femur.model_validate(given | best)
    fit = room.fit(canal, stem, femur.placement)
    assert fit.least > 1.0
    assert femur.insertion and femur.insertion.best is None
    assert math.degrees(femur.insertion.varus) == pytest.approx(
        round(math.degrees(femur.insertion.varus), 1)
    )
    assert f"room at least {fit.least:.2f} mm" in femur.placement_details["best position"]
    assert Femur.model_validate({"insertion": "best"}).insertion is not None


def test_best_position_without_room_is_refused() -> None:
    thick = {"half_width": "11 mm", "half_depth": "10 mm", "tip_half_width": "7 mm"}
    thick |= {"tip_half_depth": "7 mm", "section_depth": "14 mm"}
    with pytest.raises(ValueError, match=r"no position .* leaves 1 mm .* cuts \d\.\d+ mm into"):
        Femur.model_validate({"insertion": "best", "stem": thick})


def test_best_position_is_searched_once_for_a_geometry(monkeypatch: pytest.MonkeyPatch) -> None:
    """Other cases and other processes read the position.

    A change of its inputs causes a new search.
    """
    searches: list[str] = []

    def counted(canal: object, stem: object, start: Position, *more: object) -> Position:
        searches.append("")
        return replace(start, varus=math.radians(0.4))

    monkeypatch.setattr(best_position, "roomiest_position", counted)
    given = {"insertion": "best", "stem": {"length": "130 mm"}, "tip_z": "-101 mm"}
    one, two = (Femur.model_validate(given) for _ in range(2))
    assert len(searches) == 1 and one == two
    assert one.placement_details == two.placement_details
    Femur.model_validate(given | {"cement_thickness": "3 mm"})
    assert len(searches) == 2
    folder = folders.cache("positions")
    assert folder
    for damaged in ("", "{}", "[]", '{"numbers": [1], "gain": ""}'):
        for path in folder.iterdir():
            path.write_text(damaged)
        assert Femur.model_validate(given) == one
    assert len(searches) == 6
