"""The application (formulation A) against an independent implementation (formulation B).

Both solve the same discrete problem, so every nodal value agrees up to the solvers' tolerances:
displacement of each body, gap, slip of each step, interface force.
"""

from __future__ import annotations

import numpy as np
import pytest

from app.case.case import Case
from app.foundation.arrays import Floats, Ints
from app.mechanics.contact import ContactInterfaces, TrialState
from app.stepping.load_steps import LoadStep
from meshes.distribute import TaggedMesh
from tests import support
from tests.reference import formulation_b
from tests.reference.formulation_b import InterfaceState, State

TOLERANCE = 1e-6
# Ten times the rounding errors of the residual on these meshes, for either solver.
SOLVER = "solver.tolerance=1e-11"

# Two materials that want to spread differently under pressure, pushed sideways and back: part of
# each interface slips, part sticks, one corner opens. Nothing holds the two upper blocks but
# contact.
STACK = """
geometry: {kind: blocks, tilt: 4 deg, blocks: [{name: lower, size: [10 mm, 8 mm, 5 mm]},
                                               {name: middle, size: [10 mm, 8 mm, 4 mm]},
                                               {name: upper, size: [10 mm, 8 mm, 5 mm]}]}
mesh: {order: 1, size: 2 mm, far_size: 3 mm}
regions:
  lower: {youngs_modulus: 10 GPa, poisson_ratio: 0.1}
  middle: {youngs_modulus: 2 GPa, poisson_ratio: 0.45}
  upper: {youngs_modulus: 20 GPa, poisson_ratio: 0.2}
interfaces:
  lower_middle: {kind: contact, friction_coefficient: 0.3}
  middle_upper: {kind: contact, friction_coefficient: 0.3, gap: 0.001 * x * (y - 4)}
supports:
  base: {kind: fixed, boundary: bottom}
loads:
  press: {kind: pressure, boundary: top, pressure: 8 MPa, history: [1, 1, 0.8]}
  shear: {kind: force, boundary: upper_x_min, force: [150 N, 40 N, 0 N], history: [0, 1, -0.5]}
  side: {kind: force, boundary: middle_y_max, force: [0 N, -40 N, 10 N], history: [0, 1, 0.5]}
stages:
  - {name: press}
  - {name: shear, increments: 2}
  - {name: back}
"""

# Supports at interface nodes: both sides in x; the soft (slave) side alone in y, moved along; both
# sides in y, one of them moved; a frictionless interface.
HELD_STACK = """
geometry: {kind: blocks, blocks: [{name: lower, size: [8 mm, 8 mm, 4 mm]},
                                  {name: middle, size: [8 mm, 8 mm, 4 mm]},
                                  {name: upper, size: [8 mm, 8 mm, 4 mm]}]}
mesh: {order: 1, size: 2 mm, far_size: 2 mm}
regions:
  lower: {youngs_modulus: 10 GPa, poisson_ratio: 0.1}
  middle: {youngs_modulus: 2 GPa, poisson_ratio: 0.45}
  upper: {youngs_modulus: 20 GPa, poisson_ratio: 0.2}
interfaces:
  lower_middle: {kind: contact, friction_coefficient: 0.3}
  middle_upper: {kind: contact, friction_coefficient: 0}
supports:
  base: {kind: fixed, boundary: bottom}
  plane: {kind: roller, boundary: x_min, axis: x}
  side: {kind: displacement, boundary: middle_y_min, y: 0.004 mm, history: [0.2, 1]}
  rest: {kind: roller, boundary: upper_y_min, axis: y}
loads:
  press: {kind: pressure, boundary: top, pressure: 10 MPa, history: [1, 0.7]}
  tip: {kind: force, boundary: upper_x_max, force: [0 N, 100 N, 400 N]}
stages:
  - {name: press}
  - {name: more}
"""

# The stem is pushed in and sideways, then partly unloaded and pushed to the other side.
STEM = f"""{support.stem("34 mm", "size: 2.2 mm")}
interfaces:
  stem_cement: {{kind: contact, friction_coefficient: 0.3}}
  cement_bone: {{kind: contact, friction_coefficient: 0.5}}
loads:
  push: {{kind: force, boundary: stem_top, force: [0 N, 0 N, -1800 N], history: [1, 0.6]}}
  lateral: {{kind: force, boundary: stem_top, force: [300 N, 100 N, 0 N], history: [1, -0.5]}}
stages: [{{name: load}}, {{name: back}}]
"""

# Half of it on a plane of symmetry (both sides of both interfaces held in y), pressed in.
HALF_STEM = f"""{support.stem("20 mm, sector: half", "size: 2.6 mm", "2 deg")}
  symmetry: {{kind: roller, boundary: symmetry_y, axis: y}}
interfaces:
  stem_cement: {{kind: contact, friction_coefficient: 0.3, gap: -0.004 mm, gap_history: [1, 1]}}
  cement_bone: {{kind: contact, friction_coefficient: 0.6}}
loads:
  push: {{kind: force, boundary: stem_top, force: [1600 N, 0 N, -1500 N], history: [0, 1]}}
stages: [{{name: fit}}, {{name: load}}]
"""

# Its cement clamped and its stem driven at the lower end, where supports give the whole jump of the
# nodes between them.
CLAMPED_STEM = HALF_STEM.replace(
    "supports:",
    """supports:
  cement_end: {kind: fixed, boundary: cement_bottom}
  stem_end:
    {kind: displacement, boundary: stem_bottom, x: 8 um, y: 0 mm, z: -2 um, history: [0.5, 1]}""",
)


def solve_a(case: Case, tagged: TaggedMesh) -> tuple[list[float], list[State], ContactInterfaces]:
    """The application's steps: times, states in the form of the reference's, and its jumps."""
    analysis = support.analysis(case, tagged)
    problem = analysis.problem
    assert problem is not None
    jumps = problem.contact
    assert (jumps.local.faces <= 1).all(), "the reference has one normal per node"
    vertex = jumps.points.vertex[jumps.local.rows]
    normal = jumps.local.normals[:, 0]
    dofs, nodes = problem.space.dofmap.list, tagged.mesh.geometry.dofmap
    number = np.zeros(len(tagged.mesh.geometry.x), dtype=np.int64)
    number[dofs] = np.asarray(tagged.mesh.geometry.input_global_indices)[nodes]
    times: list[float] = []
    states: list[State] = []
    before = np.zeros((len(vertex), 3))

    def on_step(step: LoadStep, trial: TrialState | None) -> None:
        assert trial is not None
        change = trial.jump - before
        before[:] = trial.jump
        slip = change - np.sum(change * normal, axis=1, keepdims=True) * normal
        force = jumps.forces(trial.equilibrium)
        interfaces = {
            c.name: InterfaceState(
                *(v[points] for v in (vertex, normal, jumps.local.weight, trial.jump, slip, force))
            )
            for k, c in enumerate(problem.scene.parting_interfaces)
            for points in [jumps.local.interface == k]
        }
        displacement: dict[str, tuple[Ints, Floats]] = {
            name: (number, u.x.array.reshape(-1, 3).copy())
            for name, u in zip(problem.bodies.names, problem.displacements(), strict=True)
        }
        times.append(step.time)
        states.append(State(interfaces, displacement))

    analysis.run(on_step, on_trouble=print)
    return times, states, jumps


def compare(a: State, b: State) -> dict[str, float]:
    """Relative differences in the maximum norm, matched by vertex number."""
    result = {}
    for body, (vertex, values) in b.displacement.items():
        numbers, others = a.displacement[body]
        row = np.argsort(numbers)[np.searchsorted(np.sort(numbers), vertex)]
        assert np.array_equal(numbers[row], vertex)
        result[f"displacement {body}"] = support.difference(others[row], values)
    floor = smallest(b)
    for name, i in b.interfaces.items():
        j = a.interfaces[name]
        one, two = np.argsort(j.vertex), np.argsort(i.vertex)
        assert np.array_equal(j.vertex[one], i.vertex[two])
        assert np.abs(j.normal[one] - i.normal[two]).max() < 1e-12
        for what, least in (("area", 0.0), ("jump", floor), ("slip", floor), ("force", 0.0)):
            x, y = getattr(j, what)[one], getattr(i, what)[two]
            result[f"{what} {name}"] = support.difference(x, y, least)
            if what in ("jump", "force"):
                along = [np.sum(v * i.normal[two], axis=1) for v in (x, y)]
                result[f"normal {what} {name}"] = support.difference(*along, least)
    return result


def sums(steps: list[InterfaceState]) -> tuple[Floats, Floats]:
    """Accumulated slip if the step ends in contact, and dissipation, by vertex number."""
    slip = work = np.zeros(len(steps[0].vertex))
    for s in steps:
        p = -np.sum(s.force * s.normal, axis=1)
        shear = s.force + p[:, None] * s.normal
        slip = slip + np.where(p > 1e-9 * p.max(), np.linalg.norm(s.slip, axis=1), 0)
        work = work + s.area * np.sum(shear * s.slip, axis=1)
    order = np.argsort(steps[0].vertex)
    return slip[order], work[order]


def smallest(state: State) -> float:
    """A jump that counts as zero, because jumps at rest are rounding errors."""
    return 1e-6 * max(float(np.abs(values).max()) for _, values in state.displacement.values())


def shares(state: State, friction: dict[str, float]) -> Floats:
    """Fractions of the nodes that are open, stick, slip (3,), summed over interfaces."""
    result = np.zeros(3)
    for name, i in state.interfaces.items():
        p = -np.sum(i.force * i.normal, axis=1)
        touches = p > 1e-9 * p.max()
        slips = touches & (np.linalg.norm(i.slip, axis=1) > smallest(state))
        open_, slip = 1 - touches.mean(), slips.mean()
        result += (open_, 1 - open_ - slip, slip)
        # Coulomb, on the reference itself.
        shear = np.linalg.norm(i.force + p[:, None] * i.normal, axis=1)
        assert (shear <= friction[name] * p + 1e-8 * p.max()).all()
    return result


@pytest.mark.parametrize(
    ("text", "steps"),
    [
        pytest.param(STACK, 4, id="stack"),
        pytest.param(HELD_STACK, 2, id="held_stack"),
        pytest.param(STEM, 2, id="tapered_stem", marks=pytest.mark.slow),
        pytest.param(HALF_STEM, 2, id="half_stem"),
        pytest.param(CLAMPED_STEM, 2, id="clamped_stem", marks=pytest.mark.slow),
    ],
)
def test_formulation_b_agrees_with_a(text: str, steps: int) -> None:
    case = support.case(text, SOLVER)
    tagged = support.mesh(case)
    friction = {name: i.largest_friction for name, i in case.interfaces.items()}
    times, a, jumps = solve_a(case, tagged)
    assert len(times) == steps
    b = formulation_b.solve(case, tagged, times)
    seen = np.zeros(3)
    for time, one, two in zip(times, a, b, strict=True):
        differences = compare(one, two)
        assert max(differences.values()) < TOLERANCE, (time, differences)
        seen += shares(two, friction)
    for k, name in enumerate(friction):
        points = jumps.local.interface == k
        slip, work = sums([s.interfaces[name] for s in b])
        order = np.argsort(jumps.points.vertex[jumps.local.rows][points])
        assert support.difference(jumps.state.path[points][order], slip) < TOLERANCE
        if friction[name]:
            assert support.difference(jumps.state.dissipation[points][order], work) < TOLERANCE
    # The case says something about history only if points of all kinds occur.
    assert (seen > 0.02).all(), seen
