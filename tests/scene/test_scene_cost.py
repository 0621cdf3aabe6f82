"""A scene costs only what it contains: unknowns, blocks, compiled laws and forms."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
import ufl

from app.heat import heat_forms, temperature_jumps
from app.mechanics import body_forms, point_laws
from app.mechanics.problem import Problem
from app.numerics.newton import Solver
from app.simulation import model
from app.stepping import stages
from app.system.timing import Timing
from tests import support

# What makes compiled code of a form; others put it on a mesh.
COMPILERS = ("form", "compile_form")


@dataclass(frozen=True)
class Bill:
    """Costs of setting up a model.

    Attributes:
        unknowns: By block.
        systems: Blocks that are solved together: names in each system's matrix.
        laws: Faces and friction of each compiled law of contact.
        heat_laws: Compiled laws of heat through interfaces.
        forms: Compiled forms of the mechanics.
        heat_forms: Of the heat.
        integrals: Integrals in all of them.
        problem: The mechanics.
    """

    unknowns: dict[str, int]
    systems: list[tuple[str, ...]]
    laws: list[tuple[int, bool]]
    heat_laws: int
    forms: int
    heat_forms: int
    integrals: int
    problem: Problem | None = field(default=None, compare=False)


def made(text: str, *overrides: str) -> Bill:
    """Set up a model, and count what it builds and compiles."""
    counts = dict.fromkeys(("heat_laws", "forms", "heat_forms", "integrals"), 0)
    systems: list[tuple[str, ...]] = []
    laws: list[tuple[int, bool]] = []
    law = point_laws._compile_law

    def count(where: Any, name: str, *keys: str) -> None:
        real = getattr(where, name)

        def counted(*arguments: Any, **more: Any) -> Any:
            for key in keys:
                integrals = [a.integrals() for a in arguments if isinstance(a, ufl.Form)]
                counts[key] += len(*integrals) if key == "integrals" else 1
            return real(*arguments, **more)

        patch.setattr(where, name, counted)

    def compiled(comm: Any, normals: Any, of: Any) -> Any:
        laws.append((normals.shape[1], of.largest_friction > 0))
        return law(comm, normals, of)

    def refuse(*arguments: Any) -> None:
        raise AssertionError("built what the scene does not contain")

    def solver(system: Any, *arguments: Any) -> Solver:
        systems.append(tuple(system.blocks()))
        return Solver(system, *arguments)

    case = support.case(text, *overrides)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(point_laws, "_compile_law", compiled)
        count(temperature_jumps.interface_heat, "flux_and_derivatives", "heat_laws")
        for name in COMPILERS:
            count(body_forms.fem, name, "forms", "integrals")
        count(heat_forms.HeatForms, "_form", "heat_forms")
        patch.setattr(stages, "Solver", solver)
        for name, key in (("Problem", "youngs_modulus"), ("HeatOperators", "thermal")):
            if key not in text:
                patch.setattr(stages, name, refuse)
        this = model.Model(case, support.MPI.COMM_WORLD, {}, Timing(), str)
    counts["forms"] -= counts["heat_forms"]
    problem = this.mechanics.problem if this.mechanics else None
    return Bill(this.sizes(), systems, sorted(laws), **counts, problem=problem)


# Mechanics

CASE = """
geometry: {kind: blocks, blocks: [{name: lower, size: [6 mm, 6 mm, 3 mm]},
                                  {name: middle, size: [6 mm, 6 mm, 3 mm]},
                                  {name: upper, size: [6 mm, 6 mm, 3 mm]}]}
mesh: {order: 1, size: 2 mm, far_size: 2 mm}
regions:
  lower: {youngs_modulus: 1000 MPa, poisson_ratio: 0.3}
  middle: {youngs_modulus: 500 MPa, poisson_ratio: 0.3}
  upper: {youngs_modulus: 1000 MPa, poisson_ratio: 0.3}
interfaces: {INTERFACES}
supports: {floor: {kind: fixed, boundary: bottom}}
loads: {press: {kind: pressure, boundary: top, pressure: 1 MPa}}
"""


def cost(interfaces: str, *overrides: str) -> Bill:
    """Three blocks with given interfaces."""
    return made(CASE.replace("INTERFACES", interfaces), *overrides)


def contact(one: float | None, two: float | None) -> Bill:
    return cost(touching(one, two))


def touching(one: float | None, two: float | None) -> str:
    names = {"lower_middle": one, "middle_upper": two}
    law = "{}: {{kind: contact, friction_coefficient: {}}}"
    return ", ".join(law.format(n, μ) for n, μ in names.items() if μ is not None)


def test_scene_cost_bonded_is_one_continuous_field() -> None:
    """There is no jump and no law, one block and one body.

    A listed bonded interface changes nothing.
    """
    unlisted = cost("")
    listed = cost("lower_middle: {kind: bonded}, middle_upper: {kind: bonded}")
    assert unlisted == listed
    assert (
        listed.laws == []
        and listed.problem.contact is None
        and listed.problem.jump_displacements == {}
    )
    assert listed.problem.scene.parting_interfaces == () and len(listed.problem.bodies.names) == 1
    nodes = len(listed.problem.space.tabulate_dof_coordinates())
    assert listed.unknowns == {"displacement": 3 * nodes}
    # What the case does not contain is an empty tuple and costs nothing.
    scene = listed.problem.scene
    assert scene.foundations == () and scene.rigid == () and len(scene.loads) == 1
    assert all(e.eigenstrains == () for e in scene.elastic)
    # The stiffness and the load; another load costs another form.
    density = "[0 N/mm^3, 0 N/mm^3, -1 N/mm^3]"
    heavy = cost("", f"loads.weight={{kind: body_force, density: {density}}}")
    assert heavy.forms == FORMS + 1
    assert listed.forms + 1 == FORMS + 1
    assert heavy.unknowns == listed.unknowns


def test_scene_cost_contact_adds_only_jumps() -> None:
    one, two = contact(0.3, None), contact(0.3, 0.3)
    x = one.problem.space.tabulate_dof_coordinates()
    first, second = (int((np.abs(x[:, 2] - z) < 1e-9).sum()) for z in (3.0, 6.0))
    assert one.unknowns == {"displacement": 3 * len(x), "jump": 3 * first}
    assert two.unknowns == {"displacement": 3 * len(x), "jump": 3 * (first + second)}
    assert len(one.problem.bodies.names) == 2 and len(two.problem.bodies.names) == 3
    # Interfaces share the compiled law; the jump stays linear in second order.
    assert one.laws == [(1, True)]
    assert two.laws == [(1, True)]
    fine = cost(touching(0.3, None), "mesh.order=2")
    assert fine.unknowns["jump"] == 3 * first and fine.unknowns["displacement"] > 12 * len(x)


def test_scene_cost_laws_are_compiled_only_as_needed() -> None:
    """The frictionless law is separate and smaller.

    Values of friction, gap and moduli compile nothing.
    """
    smooth, rough, mixed = contact(0, 0), contact(0.3, 0.4), contact(0, 0.4)
    assert smooth.laws == [(1, False)] and mixed.laws == [(1, False), (1, True)]
    assert smooth == replace(mixed, laws=smooth.laws)
    assert replace(rough, laws=smooth.laws) == replace(mixed, laws=smooth.laws)
    other = cost(
        touching(0.7, 0.1),
        "interfaces.lower_middle.gap=0.001 * x",
        "regions.middle.youngs_modulus=0.6 GPa",
    )
    assert other == rough


# Scenes with heat

BLOCKS = """
geometry: {kind: blocks, blocks: [{name: lower, size: [6 mm, 6 mm, 3 mm]},
                                  {name: upper, size: [6 mm, 6 mm, 3 mm]}]}
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
LAW = [(1, True)]


def bill(interface: str, elastic: bool = True, heated: bool = True, expands: bool = False) -> Bill:
    """Two blocks with an interface."""
    thermal = THERMAL % (EXPANDS if expands else "")
    region = ", ".join(
        ["kind: conductor"] * (not elastic) + [ELASTIC] * elastic + [thermal] * heated
    )
    text = BLOCKS + f"regions: {{lower: {{{region}}}, upper: {{{region}}}}}\n"
    text += f"interfaces: {{lower_upper: {{{interface}}}}}\n" + MECHANICAL * elastic
    return made(text + ("stages: [{name: first, duration: 1 s}]\n" if heated else ""))


# Stiffness and pressure; contact uses the same stiffness beside the interface.
FORMS = 2
SWELLING = 2
# Of each region: conduction, and the volumes for which its nodes stand.
CONDUCTION = 4


@pytest.fixture(scope="module")
def size() -> tuple[int, int]:
    """Nodes of the mesh and of its interface. Each has 1 unknown of temperature and 3 of motion."""
    case = support.case(
        BLOCKS + f"regions: {{lower: {{{ELASTIC}}}, upper: {{{ELASTIC}}}}}\n" + MECHANICAL
    )
    x = support.mesh(case).mesh.geometry.x
    return len(x), int((np.abs(x[:, 2] - 3.0) < 1e-9).sum())


def test_scene_cost_heat_alone_has_no_mechanics(size: tuple[int, int]) -> None:
    """No displacement and no form of the mechanics is built. Perfect joints cost nothing."""
    n, m = size
    perfect = bill("kind: bonded", elastic=False)
    assert perfect == Bill({"temperature": n}, [("temperature",)], [], 0, 0, CONDUCTION, 4)
    finite = bill(f"kind: bonded, {FINITE}", elastic=False)
    unknowns = {"temperature": n, "temperature_jump": m}
    assert finite == Bill(unknowns, [tuple(unknowns)], [], 1, 0, CONDUCTION, 4)


def test_scene_cost_mechanics_alone_has_no_heat(size: tuple[int, int]) -> None:
    """No temperature, no form or law of heat, and no conduction is built."""
    n, m = size
    bonded = bill("kind: bonded", heated=False)
    assert bonded == Bill({"displacement": 3 * n}, [("displacement",)], [], 0, FORMS, 0, 3)
    unknowns = {"displacement": 3 * n, "jump": 3 * m}
    contact = bill(RUBS, heated=False)
    assert contact == Bill(unknowns, [tuple(unknowns)], LAW, 0, FORMS, 0, 3)


def test_scene_cost_one_way_coupling_is_the_sum_of_both(size: tuple[int, int]) -> None:
    """There are two systems and no block between them.

    Expansion costs its forces and their work.
    """
    n, _ = size
    motion = bill(RUBS, heated=False)
    heat = bill(f"kind: bonded, {FINITE}", elastic=False)
    cold = bill(f"{RUBS}, {FINITE}")
    assert cold == Bill(
        heat.unknowns | motion.unknowns,
        motion.systems + heat.systems,
        motion.laws,
        heat.heat_laws,
        motion.forms,
        heat.heat_forms,
        motion.integrals + heat.integrals,
    )
    warm = bill(f"{RUBS}, {FINITE}", expands=True)
    assert warm == replace(cold, forms=cold.forms + SWELLING, integrals=cold.integrals + SWELLING)
    bonded = bill("kind: bonded", expands=True)
    assert bonded.unknowns == {"temperature": n, "displacement": 3 * n}
    assert (bonded.laws, bonded.heat_laws, bonded.forms) == ([], 0, FORMS + SWELLING)
    # Coupled, its blocks are products of what is there, in one system more than for load steps.
    every = ("temperature", "temperature_jump", "displacement", "jump")
    coupled = replace(warm, systems=[("displacement", "jump"), every])
    for interface in (PRESSED, f"{PRESSED}, friction_heating: 0.3"):
        assert bill(f"{RUBS}, {interface}", expands=True) == coupled


def test_scene_cost_friction_heat_needs_no_temperature_jumps(size: tuple[int, int]) -> None:
    n, m = size
    cost = bill(f"{RUBS}, friction_heating: 0.3")
    assert cost.systems[1] == ("temperature", "displacement", "jump") and cost.heat_laws == 0
    assert cost.unknowns == {"temperature": n, "displacement": 3 * n, "jump": 3 * m}
