"""A scene pays only for what it contains: unknowns, blocks, compiled laws and forms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from app import mechanics, points
from app.problem import Problem
from app.solver import Solver
from tests import support

CASE = """
geometry:
  kind: blocks
  blocks:
    - {name: lower, size: [6 mm, 6 mm, 3 mm]}
    - {name: middle, size: [6 mm, 6 mm, 3 mm]}
    - {name: upper, size: [6 mm, 6 mm, 3 mm]}
mesh: {order: 1, size: 2 mm, far_size: 2 mm}
regions:
  lower: {youngs_modulus: 1000 MPa, poisson_ratio: 0.3}
  middle: {youngs_modulus: 500 MPa, poisson_ratio: 0.3}
  upper: {youngs_modulus: 1000 MPa, poisson_ratio: 0.3}
interfaces: {INTERFACES}
supports:
  floor: {kind: fixed, boundary: bottom}
loads:
  press: {kind: pressure, boundary: top, pressure: 1 MPa}
"""
CONTACT = "{{kind: contact, friction_coefficient: {}}}"


@dataclass(frozen=True)
class Cost:
    """What a scene cost to set up."""

    problem: Problem
    solver: Solver
    laws: list[tuple[int, bool]]
    forms: int

    @property
    def blocks(self) -> dict[str, int]:
        return self.solver.block_sizes


def cost(monkeypatch: pytest.MonkeyPatch, interfaces: str, *overrides: str) -> Cost:
    """Assemble a scene and note every contact law and every form that it compiles."""
    laws: list[tuple[int, bool]] = []
    forms: list[Any] = []
    law, form = points.contact_law, mechanics.fem.form

    def contact_law(*arguments: Any) -> Any:
        laws.append((len(arguments[5]), arguments[6] is not None))
        return law(*arguments)

    def compiled(*arguments: Any, **more: Any) -> Any:
        forms.append(arguments[0])
        return form(*arguments, **more)

    monkeypatch.setattr(points, "contact_law", contact_law)
    monkeypatch.setattr(mechanics.fem, "form", compiled)
    problem, solver = support.assemble(
        support.case(CASE.replace("INTERFACES", interfaces), *overrides)
    )
    monkeypatch.undo()
    return Cost(problem, solver, sorted(laws), len(forms))


def contact(one: float | None, two: float | None) -> str:
    names = {"lower_middle": one, "middle_upper": two}
    return ", ".join(f"{n}: {CONTACT.format(μ)}" for n, μ in names.items() if μ is not None)


def nodes(problem: Problem, *levels: float) -> int:
    x = problem.space.tabulate_dof_coordinates()
    return int(sum((np.abs(x[:, 2] - z) < 1e-9).sum() for z in levels))


def test_bonded_is_one_continuous_field(monkeypatch: pytest.MonkeyPatch) -> None:
    """No jump, no law, one block, one body; listing the interface as bonded changes nothing."""
    unlisted = cost(monkeypatch, "")
    listed = cost(monkeypatch, "lower_middle: {kind: bonded}, middle_upper: {kind: bonded}")
    for c in (unlisted, listed):
        assert c.laws == []
        assert c.problem.jumps == () and c.problem.scene.contacts == ()
        assert c.problem.moved == {}
        assert len(c.problem.bodies.names) == 1
        n = 3 * len(c.problem.space.tabulate_dof_coordinates())
        assert c.blocks == {"displacement": n}
    # The stiffness, the load and the volume terms: nothing for the interfaces.
    assert unlisted.forms == listed.forms <= 3


def test_contact_adds_jumps_at_interface_nodes_and_nothing_else(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bonded = cost(monkeypatch, "")
    one = cost(monkeypatch, contact(0.3, None))
    two = cost(monkeypatch, contact(0.3, 0.3))
    n = bonded.blocks["displacement"]
    first, both = nodes(one.problem, 3.0), nodes(two.problem, 3.0, 6.0)
    assert one.blocks == {"displacement": n, "jump": 3 * first}
    assert two.blocks == {"displacement": n, "jump": 3 * both}
    assert len(one.problem.bodies.names) == 2 and len(two.problem.bodies.names) == 3
    # Interfaces share the compiled law.
    assert one.laws == two.laws == [(1, True)]


def test_second_order_keeps_the_jump_linear(monkeypatch: pytest.MonkeyPatch) -> None:
    first = cost(monkeypatch, contact(0.3, None))
    second = cost(monkeypatch, contact(0.3, None), "mesh.order=2")
    assert second.blocks["jump"] == first.blocks["jump"]
    assert second.blocks["displacement"] > 4 * first.blocks["displacement"]


def test_no_friction_no_tangential_terms(monkeypatch: pytest.MonkeyPatch) -> None:
    """The frictionless law is another, smaller one, and only what the scene needs is compiled."""
    smooth = cost(monkeypatch, contact(0, 0))
    rough = cost(monkeypatch, contact(0.3, 0.4))
    mixed = cost(monkeypatch, contact(0, 0.4))
    assert smooth.laws == [(1, False)]
    assert rough.laws == [(1, True)]
    assert mixed.laws == [(1, False), (1, True)]
    assert smooth.blocks == rough.blocks
    assert smooth.forms == rough.forms == mixed.forms


def test_coefficients_recompile_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Friction, gap and moduli are values, not code: the number of laws and forms is the same."""
    a = cost(monkeypatch, contact(0.3, 0.3))
    b = cost(
        monkeypatch,
        contact(0.7, 0.1),
        "interfaces.lower_middle.gap=0.001 * x",
        "regions.middle.youngs_modulus=0.6 GPa",
    )
    assert (a.laws, a.forms, a.blocks) == (b.laws, b.forms, b.blocks)


def test_loads_cost_a_form_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the case does not contain is an empty tuple and costs nothing."""
    bare = cost(monkeypatch, "")
    scene = bare.problem.scene
    assert scene.foundations == () and scene.rigid == () and len(scene.loads) == 1
    assert all(e.eigenstrains == () for e in scene.elastic)
    sprung = cost(
        monkeypatch,
        "",
        "loads.weight={kind: body_force, density: [0 N/mm^3, 0 N/mm^3, -1 N/mm^3]}",
    )
    assert sprung.forms == bare.forms + 1
    assert sprung.blocks == bare.blocks
