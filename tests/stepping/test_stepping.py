"""Steps that end a run: bodies that nothing holds."""

from __future__ import annotations

import dataclasses

import pytest

from app.errors import ConvergenceError
from app.numerics.newton import NewtonResult, Solver
from app.numerics.remedies import solve
from app.stepping import load_steps
from tests import coupled, support

PLUG = """
geometry: {kind: cylinders, stem_radius: 7 mm, cement_thickness: 4 mm, bone_thickness: 5 mm,
           length: 30 mm}
mesh: {order: 1, size: 4 mm}
regions:
  stem: {youngs_modulus: 110 GPa, poisson_ratio: 0.3}
  cement: {youngs_modulus: 2200 MPa, poisson_ratio: 0.3}
  bone: {youngs_modulus: 17 GPa, poisson_ratio: 0.3}
interfaces:
  stem_cement: {kind: contact, friction_coefficient: 0}
supports:
  outer: {kind: fixed, boundary: bone_surface}
loads:
  push: {kind: force, boundary: stem_top, force: [0 N, 0 N, -1800 N]}
"""


def test_a_body_held_by_the_facets_alone_is_no_answer() -> None:
    """A straight frictionless stem slides out; the facets of its mesh must not pass for a hold."""
    with pytest.raises(ConvergenceError, match=r"interface 'stem_cement'|body 'stem'"):
        support.solve(PLUG)


def test_a_step_that_is_cut_back_ends_where_its_increment_would(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Fields are written at the ends of the increments asked for, however they are reached."""
    calls = 0

    def failing_twice(solver: Solver) -> NewtonResult:
        nonlocal calls
        calls += 1
        outcome = solve(solver)
        return dataclasses.replace(outcome, converged=outcome.converged and calls > 2)

    monkeypatch.setattr(load_steps, "solve", failing_twice)
    steps = support.solve(
        PLUG,
        "interfaces.stem_cement.friction_coefficient=0.4",
        "stages=[{name: push, increments: 3}]",
    ).steps
    assert [s.time for s in steps if s.whole] == pytest.approx([1 / 3, 2 / 3, 1])
    assert len(steps) > 3


def test_a_lifted_body_is_named() -> None:
    """A block pulled off its base is free, and the message says which."""
    stack = """
geometry: {kind: blocks, blocks: [{name: base, size: [10 mm, 10 mm, 5 mm]},
                                  {name: lid, size: [10 mm, 10 mm, 5 mm]}]}
mesh: {order: 1, size: 4 mm}
regions:
  base: {youngs_modulus: 10 GPa, poisson_ratio: 0.3}
  lid: {youngs_modulus: 2 GPa, poisson_ratio: 0.3}
interfaces:
  base_lid: {kind: contact, friction_coefficient: 0.3}
supports:
  floor: {kind: fixed, boundary: bottom}
loads:
  pull: {kind: force, boundary: top, force: [0 N, 0 N, 500 N]}
"""
    with pytest.raises(ConvergenceError, match="nothing holds body 'lid'"):
        support.solve(stack)


CLOCK = """
geometry: {kind: blocks, blocks: [{name: cube, size: [2 mm, 2 mm, 2 mm]}]}
mesh: {order: 1, size: 2 mm}
regions:
  cube:
    kind: conductor
    thermal:
      conductivity: 0.2 W/(m K)
      density: 1200 kg/m^3
      specific_heat: 1450 J/(kg K)
      initial_temperature: 37 degC
      cure:
        kinetics: {kind: prescribed, rate: [[70 s, 2], [250 s, 1], [370 s, 1]]}
        heat: 1.55e8 J/m^3
        initial: 0
stages:
  - {name: set, duration: 420 s, increments: 7, adaptive: false}
"""


@pytest.mark.parametrize("method", ["sdirk4", "backward_euler"])
def test_equal_steps_do_not_cross_kinks(monkeypatch: pytest.MonkeyPatch, method: str) -> None:
    """A clock that jumps between the ends of 60 s steps: it releases all its heat, and no more."""
    run = coupled.solve(monkeypatch, f"time.method={method}", text=CLOCK)
    assert [s.seconds for s in run.steps] == [60, 70, 120, 180, 240, 250, 300, 360, 370, 420]
    released = sum(s.heats["cure cube"] for s in run.steps)
    whole = 8.0 * 155.0  # N mm
    # The rate is linear between the kinks: a rule of order 4 is exact, that of order 1 is not.
    if method == "sdirk4":
        assert released == pytest.approx(whole, rel=1e-12)
    (degree,) = run.model.thermal.heating.degrees().values()
    assert degree == pytest.approx(released / whole, rel=1e-12)
