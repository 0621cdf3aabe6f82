"""Conductance that grows with the contact pressure, at edges of interfaces and in tension."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from tests import support
from tests.cases.meeting_blocks import (
    CORNER,
    EDGE,
    PRESSURE,
    STRONG,
    contact,
    press_on_all_sides,
    scene,
)

OPEN = 50.0  # W/(m2 K)
PER_PRESSURE = 400.0  # W/(m2 K MPa)
HOT = 80.0  # degC
COLD = 20.0  # degC


def heated(text: dict[str, Any], hot: str, cold: str) -> dict[str, Any]:
    """Blocks of nearly one temperature each, between two boundaries with given temperatures."""
    for region in text["regions"].values():
        region["thermal"] = {
            "conductivity": "1e6 W/(m K)",
            "density": "1000 kg/m^3",
            "specific_heat": "1000 J/(kg K)",
            "initial_temperature": "37 degC",
        }
    for law in text["interfaces"].values():
        law["conductance"] = {
            "kind": "pressure",
            "open": f"{OPEN} W/(m^2 K)",
            "per_pressure": f"{PER_PRESSURE} W/(m^2 K MPa)",
        }
    text["heat"] = {
        boundary: {"kind": "temperature", "boundary": boundary, "temperature": f"{value} degC"}
        for boundary, value in ((hot, HOT), (cold, COLD))
    }
    text["stages"] = [{"name": "rest", "steady": True}]
    return text


def flows(text: dict[str, Any], folder: Path) -> dict[str, float]:
    """Heat through the interfaces [mW]."""
    through = support.run(json.dumps(text), folder).summary["thermal"]["flows"]["through"]
    return {name: abs(value) for name, value in through.items()}


@pytest.mark.parametrize("cells", [(2, 3, 2), (4, 3, 2), (8, 6, 4)])
@pytest.mark.parametrize("layout", ["edge", "corner"])
def test_pressure_conductance_of_a_pressure_on_all_faces_of_an_edge(
    layout: str, cells: Sequence[int], tmp_path: Path
) -> None:
    """The flux is that of a plane interface with the same pressure, also where interfaces meet."""
    text = scene(tmp_path, EDGE if layout == "edge" else CORNER, contact(0.0), cells=cells)
    press_on_all_sides(text)
    heat_flows = flows(heated(text, "y0", "y1"), tmp_path)
    # The foot exchanges heat with the rest over the areas of its faces, and with the side.
    areas = {"foot_rest": 12.0, "foot_side": 8.0, "side_rest": 8.0}
    if layout == "corner":
        areas = {"foot_rest": 8.0, "foot_side": 4.0, "side_rest": 12.0}
    foot = (areas["foot_rest"] * HOT + areas["foot_side"] * COLD) / (
        areas["foot_rest"] + areas["foot_side"]
    )
    jumps = {"foot_rest": HOT - foot, "foot_side": foot - COLD, "side_rest": HOT - COLD}
    h = 1e-3 * (OPEN + PER_PRESSURE * PRESSURE)  # mW/(mm2 K)
    for name, area in areas.items():
        assert heat_flows[name] == pytest.approx(h * area * jumps[name], rel=1e-4)


@pytest.mark.parametrize("pressure", [PRESSURE, -PRESSURE])
def test_pressure_conductance_of_a_bond_in_tension_is_that_without_pressure(
    pressure: float, tmp_path: Path
) -> None:
    blocks = {"lower": lambda x: x[:, 2] < 2, "upper": lambda x: x[:, 2] > 2}
    text = scene(tmp_path, blocks, STRONG, cells=(2, 2, 4))
    text["loads"]["press"]["pressure"] = f"{pressure} MPa"
    (heat_flow,) = flows(heated(text, "z0", "z1"), tmp_path).values()
    h = 1e-3 * (OPEN + PER_PRESSURE * max(pressure, 0.0))
    assert heat_flow == pytest.approx(h * 12.0 * (HOT - COLD), rel=1e-4)
