"""Mechanics driven by heat: their accuracy by `mechanical_step`, with cure, and their balances."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from app.results import verdicts
from tests import support

# A ring that sets around a frictionless rigid core, all at body temperature.
RING = """
geometry: {kind: cylinders, stem_radius: 7 mm, cement_thickness: 1.5 mm, bone_thickness: 1.5 mm,
           length: 1.5 mm, sector: quarter}
mesh: {size: 1.5 mm, far_size: 1.5 mm, order: 1}
regions:
  stem: {rigid: true, thermal: &heat {conductivity: 0.4 W/(m K), density: 1000 kg/m^3,
    specific_heat: 1500 J/(kg K), initial_temperature: 37 degC}}
  cement: &ring {youngs_modulus: 2200 MPa, poisson_ratio: 0.3}
  bone: *ring
interfaces:
  stem_cement: {kind: contact, friction_coefficient: 0}
  cement_bone: {kind: bonded}
supports:
  core: {kind: fixed, boundary: stem_top}
  symmetry_x: {kind: roller, boundary: symmetry_x, axis: x}
  symmetry_y: {kind: roller, boundary: symmetry_y, axis: y}
  bottom: {kind: roller, boundary: bottom, axis: z}
stages:
  - {name: set, duration: 600 s}
output: {fields: false}
"""
SHRINKAGE = 0.03  # by volume
GEL = 0.4  # degree of cure at gelation
FLOOR = 0.1  # part of the modulus at gelation
POWER = 2.0  # exponent of the modulus
SET = [
    f"""regions.{region}.thermal={{conductivity: 0.4 W/(m K), density: 1000 kg/m^3,
    specific_heat: 1500 J/(kg K), initial_temperature: 37 degC,
    cure: {{kinetics: {{kind: prescribed, rate: [[0 s, 1], [600 s, 1]]}}, heat: 7.5e7 J/m^3,
    initial: 0, gel: {GEL}, floor: {FLOOR}, exponent: {POWER}, shrinkage: {SHRINKAGE}}}}}"""
    for region in ("cement", "bone")
]
BATH = "heat={bath: {kind: temperature, regions: [stem, cement, bone], temperature: 37 degC}}"
SHRUNK = [
    "stages=[{name: shrink}]",
    "regions.stem={rigid: true}",
    *(f"regions.{r}.eigenstrains=[{{strain: {-SHRINKAGE / 3}}}]" for r in ("cement", "bone")),
]


def solve(folder: Path, *overrides: str) -> Any:
    """The summary of the ring, changed."""
    return support.run(RING, Path(tempfile.mkdtemp(dir=folder)), *overrides).summary


def pressure(summary: Any) -> float:
    return float(summary["interfaces"]["stem_cement"]["pressure_mean"])


def test_heated_mechanics_pressure_of_shrinking_cement(tmp_path: Path) -> None:
    """The pressure of the set ring times the mean of its modulus since gelation."""
    exact = pressure(solve(tmp_path, *SHRUNK)) * (FLOOR + (1 - FLOOR) / (POWER + 1))
    errors = []
    for step in (10, 2.5):
        summary = solve(tmp_path, *SET, BATH, f"time={{mechanical_step: {step} K}}")
        errors.append(abs(pressure(summary) / exact - 1))
        assert all(summary["balance"][k] < limit for k, limit in verdicts.BALANCES.items())
    # From gelation to full cure the heat is that of 30 K: some 3 and 12 steps; second order.
    assert errors[-1] < 5e-3
    assert errors[0] / errors[-1] > 8


def test_heated_mechanics_heat_balance_with_rounding(tmp_path: Path) -> None:
    """A cure that begins at 0 begins with a step of 1e-7 s, which warms by 1e-8 K."""
    alone = ("interfaces.stem_cement.conductance=0 W/(m^2 K)", "stages.0.duration=1 s")
    summary = support.run(RING, tmp_path, *SET, *alone).summary
    assert summary["balance"]["heat"] < 1e-7
    assert not verdicts.reasons_not_to_use(summary)
