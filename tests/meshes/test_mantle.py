"""Mantles of known thickness."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import meshes
from app.case.femurs import Femur
from app.case.geometries import Blocks, Cylinders, MeshOptions
from app.plots import sections
from meshes import mantle
from meshes.data import MeshData
from meshes.gruen import Zones

INNER = 7.0  # radius of the stem [mm]
THICKNESS = 4.0  # of the cement [mm]
LENGTH = 20.0  # mm
ROD = Cylinders(
    stem_radius=f"{INNER} mm",
    cement_thickness=f"{THICKNESS} mm",
    bone_thickness="5 mm",
    length=f"{LENGTH} mm",
)


def mesh(geometry: Cylinders = ROD, size: str = "3 mm", curved: bool = True) -> MeshData:
    return meshes.build(geometry, MeshOptions(size=size, far_size="6 mm", curved=curved))


@pytest.mark.parametrize(("curved", "within"), [(True, 0.02), (False, 0.2)])
def test_mantle_thickness_of_concentric_cylinders(curved: bool, within: float) -> None:
    """Curved cells have an error of 0.02 mm, flat ones of 0.2 mm by chords of 3 mm."""
    note = mesh(curved=curved).notes["mantle"]
    thickness = note["thickness"]
    for key in ("nominal", "min", "p5", "median", "mean", "p95", "max"):
        assert thickness[key] == pytest.approx(THICKNESS, abs=within), key
    assert thickness["clipped_fraction"] == 0.0
    if curved:  # flanks of a cone are closer
        cone = mesh(ROD.model_copy(update={"taper": math.radians(10.0)})).notes["mantle"]
        apart = THICKNESS * math.cos(math.radians(10.0))
        assert cone["thickness"]["median"] == pytest.approx(apart, abs=0.02)
    exact = math.pi * ((INNER + THICKNESS) ** 2 - INNER**2) * LENGTH
    assert note["volume"] == pytest.approx(exact, rel=1e-3 if curved else 0.05)
    assert note["plug_volume"] == 0.0


def eccentric(by: float) -> MeshData:
    """The rod with its stem moved sideways, and the cement deformed."""
    data = mesh(size="2 mm")
    x = data.points.copy()
    r = np.hypot(x[:, 0], x[:, 1])
    x[:, 0] += by * np.clip((INNER + THICKNESS - r) / THICKNESS, 0.0, 1.0)
    return replace(data, points=x, notes={})


def test_mantle_percentiles_and_clipped_part_are_by_area() -> None:
    """The distance between eccentric circles is exact all around."""
    by = 1.5
    thickness = mantle.notes_on_mantle(eccentric(by), THICKNESS, -math.inf)["thickness"]
    turn = np.linspace(0.0, 2 * np.pi, 100_000)
    place = np.hypot(by + INNER * np.cos(turn), INNER * np.sin(turn))
    exact = INNER + THICKNESS - place
    assert thickness["min"] == pytest.approx(THICKNESS - by, abs=0.02)
    assert thickness["max"] == pytest.approx(THICKNESS + by, abs=0.02)
    for key, part in (("p5", 5), ("median", 50), ("p95", 95)):
        assert thickness[key] == pytest.approx(np.percentile(exact, part), abs=0.03), key
    assert thickness["mean"] == pytest.approx(exact.mean(), abs=0.01)
    clipped = np.mean(exact < mantle.CLIPPED_SHARE * THICKNESS)
    assert thickness["clipped_fraction"] == pytest.approx(clipped, abs=0.02)


def test_mantle_thickness_by_gruen_zone() -> None:
    """The stem is moved medially. The whole rod is in the proximal third."""
    by = 1.5
    zones = mantle.notes_on_mantle(eccentric(by), THICKNESS, -math.inf, Zones(Femur()))["gruen"]
    assert set(zones) == {"1", "7", "8", "14"}

    def exact(first: float, last: float) -> list[float]:
        turn = np.radians(np.linspace(first, last, 10_000))
        place = np.hypot(by + INNER * np.cos(turn), INNER * np.sin(turn))
        away = INNER + THICKNESS - place
        return [away.min(), away.mean(), away.max()]

    # The axis of the zones is not that of the stem: x = 0 is past 90 degrees by arcsin(by / INNER).
    edge = 90.0 + math.degrees(math.asin(by / INNER))
    for zone, first, last in (("7", -edge, edge), ("1", edge, 360 - edge), ("8", 0, 180)):
        assert [*zones[zone].values()] == pytest.approx(exact(first, last), abs=0.08), zone
    assert zones["14"] == pytest.approx(zones["8"], abs=0.03)


def test_mantle_below_the_tip_is_the_plug() -> None:
    """A level in the middle of the cells has half of the volume below it, and no thickness."""
    data = eccentric(0.0)
    half = mantle.notes_on_mantle(data, THICKNESS, 0.5 * LENGTH)
    assert half["plug_volume"] == pytest.approx(0.5 * half["volume"], rel=6e-3)
    # Thinning below the level does not change the thickness.
    x = data.points.copy()
    x[:, :2] *= np.where(x[:, 2] < 0.25 * LENGTH, 0.5, 1.0)[:, None]
    squeezed = replace(data, points=x)
    assert mantle.notes_on_mantle(squeezed, THICKNESS, -math.inf)["thickness"]["min"] < 3.0
    assert mantle.notes_on_mantle(squeezed, THICKNESS, 0.5 * LENGTH)["thickness"]["min"] > 3.8


@pytest.mark.parametrize("curved", [True, False])
def test_mantle_section_is_filled_with_closed_outlines(curved: bool) -> None:
    polygons, outlines, owner = sections.section_of_cells(mesh(curved=curved), 2, 0.37 * LENGTH)
    area = 0.0
    for x, _ in polygons:
        u, v = x[:, :, 0], x[:, :, 1]
        shoelace = u * np.roll(v, -1, axis=1) - v * np.roll(u, -1, axis=1)
        area += 0.5 * float(np.abs(shoelace.sum(axis=1)).sum())
    exact = math.pi * (INNER + THICKNESS + 5.0) ** 2
    assert area == pytest.approx(exact, rel=0.01 if curved else 0.03)
    # Around each cell two edges meet at every point.
    ends = np.column_stack([np.repeat(owner, 2), np.round(outlines[:, :, :2].reshape(-1, 2), 5)])
    _, times = np.unique(ends, axis=0, return_counts=True)
    assert (times == 2).all()


def test_mantle_is_absent_in_a_stack_of_blocks() -> None:
    """Names of parts do not matter."""
    blocks = [{"name": n, "size": "[4, 4, 4] mm"} for n in ("stem", "cement", "bone")]
    stack = Blocks.model_validate({"blocks": blocks})
    assert "mantle" not in meshes.build(stack, MeshOptions(size="3 mm")).notes
