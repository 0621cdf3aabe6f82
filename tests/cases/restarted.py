"""Runs that are interrupted after every step and continued, and comparison of their numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from app.case.case import load_case
from app.simulation import checkpoint
from app.simulation.session import run
from app.system.folders import saved
from tests import frozen, support
from tests.support import LOWER, TWO_BLOCKS

# Pressed on, then dragged back and forth: what slips and how much it rubs is history.
RUBBING = (
    TWO_BLOCKS
    + """
regions:
  lower: {youngs_modulus: 1000 MPa, poisson_ratio: 0.3}
  upper: {youngs_modulus: 2000 MPa, poisson_ratio: 0.3}
interfaces:
  lower_upper: {kind: contact, friction_coefficient: 0.3}
supports:
  floor: {kind: fixed, boundary: bottom}
  press: {kind: displacement, boundary: top, z: "-0.005 + 0.006 * x / 6", history: [1, 1, 1]}
  slide: {kind: displacement, boundary: top, x: "0.006 + 0.004 * y / 4", y: 0 mm,
    history: [0, 1, -0.5]}
stages:
  - {name: press, increments: 2}
  - {name: slide, increments: 2}
  - {name: back, increments: 2}
"""
)
# Sets between a warm block and a holder that lets go; loaded on what that leaves.
SETTING = (
    TWO_BLOCKS
    + LOWER
    + """\
  upper:
    youngs_modulus: 2000 MPa
    poisson_ratio: 0.3
    thermal: {conductivity: 0.3 W/(m K), density: 1200 kg/m^3, specific_heat: 1500 J/(kg K),
      initial_temperature: 25 degC, thermal_expansion: 80e-6 1/K, cure: {kinetics: {
      kind: autocatalytic, rate_constant: 2.6397e8 1/s, activation_energy: 62866 J/mol, m: 0.98,
      n: 1.064}, heat: 1.55e8 J/m^3, initial: 1e-3, gel: 0.5, floor: 0.01, exponent: 1,
      shrinkage: 0.003}}
interfaces:
  lower_upper: {kind: contact, friction_coefficient: 0.3, conductance: 300 W/(m^2 K)}
heat:
  air: {kind: convection, boundary: lower_x_max, coefficient: 200 W/(m^2 K), ambient: 20 degC}
supports:
  floor: {kind: fixed, boundary: bottom}
  hold: {kind: fixed, boundary: top, stages: [setting]}
  hand: {kind: foundation, boundary: top, stiffness: 1 MPa/mm}
loads:
  press: {kind: pressure, boundary: top, pressure: 1 MPa, history: [0, 1]}
  side: {kind: force, boundary: upper_x_max, force: [-1 N, 0 N, 0 N], history: [0, 1]}
stages:
  - {name: setting, duration: 600 s, increments: 2}
  - {name: load, increments: 2}
time: {tolerance: 0.5 K, mechanical_step: 10 K}
"""
)
# What takes time and memory, how the equations were solved, and what rounding leaves of nothing.
APART = ("timing", "cpu", "memory", "balance", "solver", "verdicts")
# Columns of the table that depend on the way there.
WAY = ("wall", "step", "newton", "krylov", "residual", "balance", "augmentation")
# A restart begins with new preconditioners and without the states before the last: it is right to
# the tolerance of the solver, 1e-8 of the forces.
NUMBERS = 1e-6
# Below these [mm, MPa, N, N mm, ...] numbers are what rounding and the solver leave of nothing.
NOTHING = 1e-9


def numbers(folder: Path) -> dict[str, Any]:
    """The numbers of a run by dotted key, without places of maxima, which may be ambiguous."""
    kept = {k: v for k, v in support.summary(folder).items() if k not in APART}
    return {k: v for k, v in frozen.leaves(kept, "") if "_at." not in f"{k}."}


def rows(folder: Path) -> list[list[str]]:
    """The table of a run without times and without the course of the solver."""
    lines = [line.split(",") for line in (folder / "history.csv").read_text().splitlines()]
    apart = [k for k, name in enumerate(lines[0]) if name.rpartition(" [")[0].endswith(WAY)]
    return [[v for k, v in enumerate(line) if k not in apart] for line in lines]


def assert_same(
    one: Path, other: Path, relative: float = NUMBERS, nothing: float = NOTHING
) -> None:
    """Two runs have the same numbers and tables to the tolerance of the solver."""
    a, b = numbers(one), numbers(other)
    assert a == pytest.approx(b, rel=relative, abs=nothing)
    (names, *table), (others, *again) = rows(one), rows(other)
    assert names == others and len(table) == len(again)
    for line, other_line in zip(table, again, strict=True):
        values = [[float(v or "nan") for v in row] for row in (line, other_line)]
        assert values[0] == pytest.approx(values[1], rel=relative, abs=nothing, nan_ok=True)


def whole(text: str, folder: Path, *overrides: str) -> tuple[Path, list[Path]]:
    """A complete run, with its case file and a checkpoint after every step."""
    path = folder / "case.yaml"
    path.write_text(text)
    options = [*overrides, "output.checkpoint.steps=1"]
    (folder / "whole").mkdir()
    kept, checkpoint.KEPT = checkpoint.KEPT, 10**6
    try:
        run(load_case(path, options), folder / "whole")
    finally:
        checkpoint.KEPT = kept
    return path, sorted(saved(folder / "whole"), key=lambda p: int(p.stem.split("-")[1]))


def on(path: Path, folder: Path, file: Path, *overrides: str) -> Path:
    """Continue from a checkpoint in a separate folder."""
    output = folder / f"from-{file.stem}"
    output.mkdir(exist_ok=True)
    run(load_case(path, overrides), output, restart=str(file))
    return output
