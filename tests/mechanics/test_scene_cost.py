"""A scene pays only for what it contains: unknowns, blocks, compiled laws and forms."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import ufl

from app.heat import heat_forms, temperature_jumps
from app.mechanics import body_forms as mechanics_assembly
from app.mechanics import contact_law
from app.mechanics.problem import Problem
from app.numerics.newton import Solver
from app.simulation import model
from app.system.timing import Timing
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
# What makes compiled code of a form; others put it on a mesh.
COMPILERS = ("form", "compile_form")
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
    law = contact_law._compile

    def compile_law(comm: Any, normals: Any, of: Any) -> Any:
        laws.append((normals.shape[1], of.frictional))
        return law(comm, normals, of)

    def compiled(name: str) -> Any:
        compiler = getattr(mechanics_assembly.fem, name)

        def noted(*arguments: Any, **more: Any) -> Any:
            forms.append(arguments)
            return compiler(*arguments, **more)

        return noted

    monkeypatch.setattr(contact_law, "_compile", compile_law)
    for name in COMPILERS:
        monkeypatch.setattr(mechanics_assembly.fem, name, compiled(name))
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
        assert c.problem.contact is None and c.problem.scene.contacts == ()
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


# Scenes with heat

BLOCKS = """
geometry:
  kind: blocks
  blocks:
    - {name: lower, size: [6 mm, 6 mm, 3 mm]}
    - {name: upper, size: [6 mm, 6 mm, 3 mm]}
mesh: {order: 1, size: 2 mm, far_size: 2 mm}
"""
ELASTIC = "youngs_modulus: 1000 MPa, poisson_ratio: 0.3"
THERMAL = """thermal: {conductivity: 0.2 W/(m K), density: 1200 kg/m^3,
    specific_heat: 1450 J/(kg K), initial_temperature: 37 degC%s}"""
EXPANDS = ", thermal_expansion: 8e-5 1/K"
MECHANICAL = """
supports: {floor: {kind: fixed, boundary: bottom}}
loads: {press: {kind: pressure, boundary: top, pressure: 1 MPa}}
"""
FINITE = "conductance: 300 W/(m^2 K)"
PRESSED = "conductance: {kind: pressure, open: 50 W/(m^2 K), per_pressure: 400 W/(m^2 K MPa)}"
RUBS = "kind: contact, friction_coefficient: 0.3"


@dataclass(frozen=True)
class Bill:
    """What a model cost to set up.

    Attributes:
        unknowns: By block.
        systems: Blocks that are solved together: names in each system's matrix.
        laws: Compiled laws of contact.
        heat_laws: Compiled laws of heat through interfaces.
        forms: Compiled forms of the mechanics.
        heat_forms: Of the heat.
        integrals: Integrals in all of them.
    """

    unknowns: dict[str, int]
    systems: list[tuple[str, ...]]
    laws: int
    heat_laws: int
    forms: int
    heat_forms: int
    integrals: int


def bill(
    monkeypatch: pytest.MonkeyPatch,
    interface: str,
    *overrides: str,
    elastic: bool = True,
    heated: bool = True,
    expands: bool = False,
) -> Bill:
    """Set a model up and note what it builds and compiles."""
    thermal = THERMAL % (EXPANDS if expands else "")
    region = ", ".join(
        ["kind: conductor"] * (not elastic) + [ELASTIC] * elastic + [thermal] * heated
    )
    text = BLOCKS + f"regions: {{lower: {{{region}}}, upper: {{{region}}}}}\n"
    text += f"interfaces: {{lower_upper: {{{interface}}}}}\n" + MECHANICAL * elastic
    text += "stages: [{name: first, duration: 1 s}]\n" if heated else ""
    counts = dict.fromkeys(("laws", "heat_laws", "forms", "heat_forms", "integrals"), 0)
    systems: list[tuple[str, ...]] = []

    def count(where: Any, name: str, *keys: str) -> None:
        real = getattr(where, name)

        def counted(*arguments: Any, **more: Any) -> Any:
            for key in keys:
                integrals = [a.integrals() for a in arguments if isinstance(a, ufl.Form)]
                counts[key] += len(*integrals) if key == "integrals" else 1
            return real(*arguments, **more)

        patch.setattr(where, name, counted)

    def refuse(*arguments: Any) -> None:
        raise AssertionError("built what the scene does not contain")

    def solver(system: Any, *arguments: Any) -> Solver:
        systems.append(tuple(system.blocks()))
        return Solver(system, *arguments)

    with monkeypatch.context() as patch:
        count(contact_law, "_compile", "laws")
        count(temperature_jumps.interface_heat, "flux_and_derivatives", "heat_laws")
        for name in COMPILERS:
            count(mechanics_assembly.fem, name, "forms", "integrals")
        count(heat_forms.HeatForms, "_form", "heat_forms")
        patch.setattr(model, "Solver", solver)
        for name, absent in (("Problem", not elastic), ("HeatOperators", not heated)):
            if absent:
                patch.setattr(model, name, refuse)
        case = support.case(text, *overrides)
        made = model.Model(case, support.MPI.COMM_WORLD, {}, Timing(), str)
    counts["forms"] -= counts["heat_forms"]
    return Bill(made.sizes(), systems, **counts)


# Stiffness and pressure; contact uses the same stiffness beside the interface.
FORMS, SWELLING = 2, 2
# Of each region: conduction, and the volumes for which its nodes stand.
CONDUCTION = 4


@pytest.fixture(scope="module")
def size() -> tuple[int, int]:
    """Nodes of the mesh, and those of its interface: 1 unknown of temperature each, 3 of motion."""
    case = support.case(
        BLOCKS + f"regions: {{lower: {{{ELASTIC}}}, upper: {{{ELASTIC}}}}}\n" + MECHANICAL
    )
    x = support.mesh(case).mesh.geometry.x
    return len(x), int((np.abs(x[:, 2] - 3.0) < 1e-9).sum())


def test_thermal_only_has_no_mechanics(
    monkeypatch: pytest.MonkeyPatch, size: tuple[int, int]
) -> None:
    """No displacement, no form of the mechanics, no problem built; perfect joints cost nothing."""
    n, m = size
    perfect = bill(monkeypatch, "kind: bonded", elastic=False)
    assert perfect == Bill({"temperature": n}, [("temperature",)], 0, 0, 0, CONDUCTION, 4)
    finite = bill(monkeypatch, f"kind: bonded, {FINITE}", elastic=False)
    both = ("temperature", "temperature_jump")
    unknowns = {"temperature": n, "temperature_jump": m}
    assert finite == Bill(unknowns, [both], 0, 1, 0, CONDUCTION, 4)


def test_mechanics_only_has_no_heat(monkeypatch: pytest.MonkeyPatch, size: tuple[int, int]) -> None:
    """No temperature, no form or law of the heat, no conduction built."""
    n, m = size
    bonded = bill(monkeypatch, "kind: bonded", heated=False)
    assert bonded == Bill({"displacement": 3 * n}, [("displacement",)], 0, 0, FORMS, 0, 3)
    contact = bill(monkeypatch, RUBS, heated=False)
    unknowns = {"displacement": 3 * n, "jump": 3 * m}
    assert contact == Bill(unknowns, [("displacement", "jump")], 1, 0, FORMS, 0, 3)


def test_one_way_is_the_sum_of_both(monkeypatch: pytest.MonkeyPatch, size: tuple[int, int]) -> None:
    """Two systems, no block between them; expansion costs its forces and their work."""
    n, _ = size
    motion = bill(monkeypatch, RUBS, heated=False)
    heat = bill(monkeypatch, f"kind: bonded, {FINITE}", elastic=False)
    cold = bill(monkeypatch, f"{RUBS}, {FINITE}")
    assert cold == Bill(
        heat.unknowns | motion.unknowns,
        motion.systems + heat.systems,
        motion.laws,
        heat.heat_laws,
        motion.forms,
        heat.heat_forms,
        motion.integrals + heat.integrals,
    )
    warm = bill(monkeypatch, f"{RUBS}, {FINITE}", expands=True)
    assert warm == replace(cold, forms=cold.forms + SWELLING, integrals=cold.integrals + SWELLING)
    bonded = bill(monkeypatch, "kind: bonded", expands=True)
    assert bonded.unknowns == {"temperature": n, "displacement": 3 * n}
    assert (bonded.laws, bonded.heat_laws, bonded.forms) == (0, 0, FORMS + SWELLING)


def test_coupling_costs_one_system_and_no_form(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its blocks are products of what is there. Load steps have the mechanics for themselves."""
    one_way = bill(monkeypatch, f"{RUBS}, {FINITE}", expands=True)
    every = ("temperature", "temperature_jump", "displacement", "jump")
    coupled = replace(one_way, systems=[("displacement", "jump"), every])
    for interface in (PRESSED, f"{PRESSED}, friction_heating: 0.3"):
        assert bill(monkeypatch, f"{RUBS}, {interface}", expands=True) == coupled


def test_friction_heats_a_perfect_interface_without_jumps(
    monkeypatch: pytest.MonkeyPatch, size: tuple[int, int]
) -> None:
    n, m = size
    cost = bill(monkeypatch, f"{RUBS}, friction_heating: 0.3")
    assert cost.systems[1] == ("temperature", "displacement", "jump")
    assert cost.heat_laws == 0
    assert cost.unknowns == {
        "temperature": n,
        "displacement": 3 * n,
        "jump": 3 * m,
    }
