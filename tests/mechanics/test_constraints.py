"""Supports that hold in some stages only: other supports take over their forces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from app.foundation.errors import InputError
from app.scene.scene import Scene
from tests.cases.heated import Heated

# A column pushed down at its top while a second support holds the top sideways, or entirely.
COLUMN = """
geometry: {kind: blocks, blocks: [{name: lower, size: [4 mm, 4 mm, 4 mm]},
                                  {name: upper, size: [4 mm, 4 mm, 4 mm]}]}
mesh: {size: 2 mm, far_size: 2 mm, order: 2}
regions:
  lower: {youngs_modulus: 1000 MPa, poisson_ratio: 0.3}
  upper: {youngs_modulus: 3000 MPa, poisson_ratio: 0.3}
supports:
  floor: {kind: fixed, boundary: bottom}
  hand: {kind: displacement, boundary: top, x: 0.002 mm, y: 0 mm, z: -0.03 mm}
loads:
  push: {kind: force, boundary: top, force: [20 N, 0 N, -100 N], history: [1, 1]}
stages:
  - {name: held}
  - {name: free}
"""
RIGID = "regions.upper={rigid: true}"
CONTACT = "interfaces.lower_upper={kind: contact, friction_coefficient: 5}"


def active(**stages: tuple[str, ...]) -> Callable[[Scene], Scene]:
    """Make supports hold in some stages only."""

    def change(old: Scene) -> Scene:
        supports = tuple(s.named(s.name, stages=stages.get(s.name)) for s in old.supports)
        return replace(old, supports=supports)

    return change


@pytest.mark.parametrize("overrides", [(), (RIGID,), (CONTACT,), (CONTACT, RIGID)])
def test_constraints_released_support_equals_no_support(overrides: tuple[str, ...]) -> None:
    """The bodies are linear, or all points stick.

    So the state after the release depends on the loads alone.
    """
    released = Heated.make(COLUMN, active(hand=("held",)), *overrides)
    problem = released.problem
    problem.set_time(1.0)
    released.step()
    held = problem.displacements()[problem.bodies.body_of_region["upper"]].x.array.copy()
    assert problem.stiffness.version == 0
    u, _ = released.solver.u_and_q()
    problem.set_stage(0, u)
    assert problem.stiffness.version == 0
    problem.set_stage(1, u)
    assert problem.stiffness.version == 1
    # Nothing moves by letting go.
    problem.update_displacements(*released.solver.u_and_q())
    top = problem.displacements()[problem.bodies.body_of_region["upper"]]
    assert np.abs(top.x.array - held).max() < 1e-14
    problem.set_time(2.0)
    released.step()
    never = Heated.make(COLUMN, active(hand=()), *overrides)
    never.problem.set_time(1.0)
    never.step()
    expected = never.problem.displacements()[never.problem.bodies.body_of_region["upper"]].x.array
    assert np.abs(expected - held).max() > 1e-4
    assert np.abs(top.x.array - expected).max() < 1e-9 * np.abs(expected).max()
    # What held is no reaction any more: the floor carries all.
    assert max(released.balance.force, released.balance.moment) < 1e-9
    assert released.balance.energy < 1e-9


def test_constraints_support_holds_again_after_release() -> None:
    model = Heated.make(COLUMN, active(hand=("free",)))
    model.problem.set_time(1.0)
    model.step()
    model.problem.set_stage(1, model.solver.u_and_q()[0])
    model.problem.set_time(2.0)
    model.step()
    x = model.problem.space.tabulate_dof_coordinates()
    top = model.problem.u.x.array.reshape(-1, 3)[np.isclose(x[:, 2], 8)]
    assert np.abs(top - [0.002, 0, -0.03]).max() < 1e-15
    assert max(model.balance.force, model.balance.energy) < 1e-9


def test_constraints_refuse_release_of_prescribed_jumps() -> None:
    """Supports hold both sides of the interface where they touch.

    The message names the released support.
    """
    sides = (
        "supports.left={kind: roller, boundary: lower_x_min, axis: x}",
        "supports.right={kind: roller, boundary: upper_x_min, axis: x}",
    )
    with pytest.raises(
        InputError, match=r"supports\.right: is released in some stages.*foundation"
    ):
        Heated.make(COLUMN, active(right=("held",)), CONTACT, *sides)
    # A side that is held in all stages is held there by that support.
    again = "supports.again={kind: roller, boundary: upper_x_min, axis: x}"
    Heated.make(COLUMN, active(again=("held",)), CONTACT, *sides, again)
