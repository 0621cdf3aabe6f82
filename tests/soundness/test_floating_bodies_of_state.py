"""Free rigid motions: held bodies are never said to float; free ones always are."""

from __future__ import annotations

import math
import random
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import meshes
from app.foundation.errors import ConvergenceError, MantleError
from app.foundation.verdict import Reason
from app.soundness.floating_bodies_of_state import (
    texts_of_pulled_bodies,
    warnings_of_sliding_bodies,
)
from meshes import write_msh
from meshes.distribute import distribute
from tests import support
from tests.cases.blocks import box

ZONED = f"""{support.TWO_BLOCKS}regions:
  lower: {{youngs_modulus: 1000 MPa, poisson_ratio: 0.3}}
  upper: {{youngs_modulus: 500 MPa, poisson_ratio: 0.3}}
supports:
  floor: {{kind: fixed, boundary: bottom}}
"""
# A block on another, which is fixed; what holds the upper one is drawn.
BLOCKS = """
geometry:
  kind: blocks
  tilt: {tilt} deg
  blocks:
    - {{name: low, size: [{length} mm, {width} mm, 3 mm]}}
    - {{name: high, size: [{length} mm, {width} mm, {height} mm]}}
mesh: {{order: 1, size: {size} mm, far_size: {size} mm}}
regions:
  low: {{youngs_modulus: 6 GPa, poisson_ratio: 0.3, tissue: other}}
  high: {{youngs_modulus: {modulus} MPa, poisson_ratio: 0.3, tissue: other}}
interfaces:
  low_high: {{kind: contact, friction_coefficient: {friction}, gap: "{gap}"}}
supports:
  floor: {{kind: fixed, boundary: bottom}}
{supports}
loads:
  press: {{kind: force, boundary: top, force: "{press} N"}}
solver: {{linear: {linear}}}
"""


@dataclass(frozen=True)
class Drawn:
    """A random case, and whether something holds each body."""

    text: str
    held: bool

    def __str__(self) -> str:
        return f"{'held' if self.held else 'free'}\n{self.text}"


def draw(seed: int) -> Drawn:
    """A slender, soft-sprung, tilted or wedged block, held or with one free direction."""
    dice = random.Random(seed)
    length, width = dice.uniform(6, 20), dice.uniform(2, 4)
    height, force = dice.uniform(2, 6), 10 ** dice.uniform(0, 2)
    friction = dice.uniform(0.2, 0.6)
    values = {
        "length": f"{length:.3f}",
        "width": f"{width:.3f}",
        "height": f"{height:.3f}",
        "size": f"{dice.uniform(1.5, 2.5):.2f}",
        "modulus": f"{10 ** dice.uniform(3, 5):.4g}",
        "friction": f"{friction:.3f}",
        "linear": support.SOLVERS[seed % 3],
        "tilt": 0,
        "gap": "0 mm",
        "supports": "",
        "press": f"[0, 0, {-force:.4g}]",
    }
    springs = "  springs: {{kind: foundation, boundary: top, stiffness: '{} MPa/mm'}}"
    stiffness = 10 ** dice.uniform(-5, 0)
    held = seed % 2 == 0
    steepest = math.degrees(math.atan(0.9 * min(3.0, height) / length))
    kind = (seed // 2) % 4
    if held and kind == 0:  # a wedge-shaped gap, which touches along an edge
        values["gap"] = f"{10 ** dice.uniform(-5, -3.5):.3g} * x"
    elif held and kind == 1:  # a gap and soft springs
        values["gap"] = f"{10 ** dice.uniform(-3, -1):.3g} mm"
        soft = f"[{stiffness:.3g}, {stiffness:.3g}, {stiffness:.3g}]"
        values["supports"] = springs.format(soft)
        values["friction"] = dice.choice(["0", "0.3"])
    elif held and kind == 2:  # a slope that friction holds
        tilt = min(dice.uniform(2, 9), steepest)
        values["tilt"], values["friction"] = f"{tilt:.2f}", f"{dice.uniform(0.3, 0.7):.3f}"
    elif held:  # lifted against soft springs
        values["supports"] = springs.format([round(stiffness, 9)] * 3)
        values["press"] = f"[0, 0, {force:.4g}]"
    elif kind == 0:  # springs along x alone, pushed along y
        values["supports"] = springs.format(f"[{stiffness:.3g}, 0, 0]")
        values["friction"] = "0"
        values["press"] = f"[0, {0.2 * force:.4g}, {-force:.4g}]"
    elif kind == 1:  # pushed beyond friction
        values["press"] = f"[{1.2 * friction * force:.4g}, 0, {-force:.4g}]"
    elif kind == 2:  # a smooth slope
        values["tilt"], values["friction"] = f"{min(dice.uniform(4, 20), steepest):.2f}", "0"
    else:  # lifted, with supports along x alone
        values["supports"] = "  guide: {kind: roller, boundary: high_x_max, axis: x}"
        values["press"] = f"[0, 0, {force:.4g}]"
    return Drawn(BLOCKS.format(**values), held)


def judge(seed: int) -> None:
    """Solve a random case and compare the reason of its refusal."""
    drawn = draw(seed)
    try:
        support.solve(drawn.text)
        reasons = set()
    except MantleError as error:
        text = str(error)
        reasons = Reason.within(text)
        if drawn.held:
            assert error.exit_code == 4 and Reason.LARGE_DISPLACEMENT in reasons, f"{text}\n{drawn}"
    floats = Reason.FLOATING_BODY in reasons
    assert floats != drawn.held, f"{reasons}\n{drawn}"


@pytest.mark.parametrize("seed", range(12))
def test_floating_bodies_of_state_are_the_free_ones(seed: int) -> None:
    judge(seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100, 200))
def test_floating_bodies_of_state_are_the_free_ones_drawn(seed: int) -> None:
    judge(seed)


# Small loads along free motions, beside large ones that contact bears

SMOOTH = "interfaces.stem_cement.friction_coefficient=0"
ALONG = "'stem': it is free to rotate about z, and the loads act in this direction"


def torque(moment: float, history: str = "[1]") -> tuple[str, ...]:
    """Overrides: a moment about the axis of the stem [N mm], by forces 20 mm apart."""
    return tuple(
        f"loads.{name}={{kind: force, boundary: stem_top, history: {history}, "
        f"force: [{side * moment / 20} N, 0 N, 0 N], at: [0 mm, {-10 * side} mm, 20 mm]}}"
        for name, side in (("one", 1), ("other", -1))
    )


@pytest.mark.parametrize("linear", support.SOLVERS)
@pytest.mark.parametrize("moment", [1e-3, 1.0, 200.0])
def test_floating_bodies_of_state_turn_by_a_small_torque(moment: float, linear: str) -> None:
    """Nothing bears a torque about the axis of a frictionless stem.

    The torque is small compared with 900 N.
    """
    with pytest.raises(ConvergenceError, match=ALONG) as error:
        support.solve(support.STEM, SMOOTH, *torque(moment), f"solver.linear={linear}")
    assert Reason.within(str(error.value)) == {Reason.FLOATING_BODY}


@pytest.mark.parametrize("moment", [1e-3, 200.0])
def test_floating_bodies_of_state_turn_in_a_later_stage(moment: float) -> None:
    stages = "stages=[{name: press}, {name: turn, max_cut_backs: 1}]"
    with pytest.raises(ConvergenceError, match=ALONG) as error:
        support.solve(support.STEM, SMOOTH, *torque(moment, "[0, 1]"), stages)
    assert "stage 'turn'" in str(error.value)
    assert Reason.within(str(error.value)) == {Reason.FLOATING_BODY}


@pytest.mark.parametrize("digits", [12, 6, 4, 3, 2])
@pytest.mark.parametrize("taper", [1.5, 5])
@pytest.mark.parametrize("force", ["[300 N, 0 N, -900 N]", "[0 N, 0 N, -900 N]"])
def test_floating_bodies_of_state_are_not_those_with_an_axis_in_doubt(
    force: str, taper: float, digits: int
) -> None:
    """Rounded coordinates shift the axis, so loads through it have a small torque."""
    changes = (SMOOTH, f"geometry.taper={taper} deg", f"loads.hip.force={force}")
    case = support.case(support.STEM, *changes)
    data = meshes.build(case.geometry, case.mesh)
    data = replace(data, points=np.round(data.points, digits))
    problem, _ = support.assemble(case, distribute(data, support.MPI.COMM_WORLD))
    problem.set_time(1.0)
    assert problem.contact
    assert not texts_of_pulled_bodies(problem, problem.contact)


# A block on a floor and against a wall of one base, without friction.
CORNER = """
geometry: {{kind: file, path: {path}, interfaces: {{joint: [base, block]}}}}
mesh: {{order: 1, size: 1 mm}}
regions:
  base: {{youngs_modulus: 6 GPa, poisson_ratio: 0.3, tissue: other}}
  block: {{youngs_modulus: 6 GPa, poisson_ratio: 0.3, tissue: other}}
interfaces:
  joint: {{kind: contact, friction_coefficient: 0}}
supports:
  floor: {{kind: fixed, boundary: z0}}
  side: {{kind: roller, boundary: top_y0, axis: y}}
loads:
  press: {{kind: force, boundary: top_x1, force: [{push} N, 0 N, -900 N], at: [3 mm, 1.5 mm, 3 mm]}}
solver: {{linear: {linear}}}
"""


@pytest.mark.parametrize("linear", support.SOLVERS)
@pytest.mark.parametrize("push", [1e-2, 1.0, 0.0, -1.0])
def test_floating_bodies_of_state_leave_a_wall_by_a_small_force(
    push: float, linear: str, tmp_path: Path
) -> None:
    """A force of 900 N presses the block on the floor, and a small force pulls it off the wall."""
    blocks = {
        "base": lambda x: (x[:, 2] < 2) | (x[:, 0] < 2),
        "block": lambda x: (x[:, 2] > 2) & (x[:, 0] > 2),
    }
    write_msh(box(blocks, (4, 3, 4), (4, 3, 4)), tmp_path / "corner.msh")
    text = CORNER.format(path=tmp_path / "corner.msh", push=push, linear=linear)
    if push <= 0:
        support.solve(text)
        return
    with pytest.raises(ConvergenceError, match="'block': it is free to move along x") as error:
        support.solve(text)
    assert Reason.within(str(error.value)) == {Reason.FLOATING_BODY}


# Three blocks on each other: the middle one is pressed down, the upper one drawn away.
TOWER = """
geometry:
  kind: blocks
  blocks:
    - {{name: low, size: [4 mm, 3 mm, 2 mm]}}
    - {{name: middle, size: [4 mm, 3 mm, 2 mm]}}
    - {{name: high, size: [4 mm, 3 mm, 2 mm]}}
mesh: {{order: 1, size: 1 mm, far_size: 1 mm}}
regions:
  low: {{youngs_modulus: 6 GPa, poisson_ratio: 0, tissue: other}}
  middle: {{youngs_modulus: 6 GPa, poisson_ratio: 0, tissue: other}}
  high: {{youngs_modulus: 6 GPa, poisson_ratio: 0.3, tissue: other}}
interfaces:
  low_middle: {{kind: contact, friction_coefficient: 0.3}}
  middle_high: {{kind: contact, friction_coefficient: 0.3}}
supports:
  floor: {{kind: fixed, boundary: bottom}}
loads:
  press: {{kind: body_force, regions: [middle], density: "[0, 0, {density}] N/mm^3"}}
  draw: {{kind: force, boundary: top, force: "{force} N"}}
"""


@pytest.mark.parametrize("density", [-4, -400])
@pytest.mark.parametrize(
    ("force", "motion"), [([0, 0, 0.1], "move along z"), ([0, 0.05, -0.1], "move along y")]
)
def test_floating_bodies_of_state_are_found_beside_one_that_is_pressed(
    force: Sequence[float], motion: str, density: float
) -> None:
    """Only loads on the body itself matter, not 96 N or 9.6 kN on another one."""
    with pytest.raises(ConvergenceError, match=f"'high': it is free to .*{motion}") as error:
        support.solve(TOWER.format(force=list(force), density=density))
    assert Reason.within(str(error.value)) == {Reason.FLOATING_BODY}


@pytest.mark.parametrize("density", [-4, -400])
@pytest.mark.parametrize("force", [[0, 0, -0.1], [0, 0.02, -0.1]])
def test_floating_bodies_of_state_are_not_those_pressed_by_a_small_load(
    force: Sequence[float], density: float
) -> None:
    """A load of 0.1 N with a friction of 0.3 holds 0.02 N. The body below has much larger loads."""
    text = TOWER.format(force=list(force), density=density)
    problem, _ = support.assemble(support.case(text))
    problem.set_time(1.0)
    assert problem.contact
    assert not texts_of_pulled_bodies(problem, problem.contact)
    if density > -10:
        numbers = support.solve(text).interfaces["middle_high"]
        assert numbers["pressure_mean"] == pytest.approx(0.1 / 12, rel=1e-6)


# The middle block of three, held sideways alone: what is above it moves away.
FLOATING = """
geometry:
  kind: blocks
  blocks:
    - {name: low, size: [3 mm, 2 mm, 4 mm]}
    - {name: middle, size: [3 mm, 2 mm, 1 mm]}
    - {name: high, size: [3 mm, 2 mm, 5 mm]}
mesh: {order: 1, size: 1 mm, far_size: 2 mm}
regions:
  low: &solid {youngs_modulus: 2 GPa, poisson_ratio: 0, tissue: other}
  middle: *solid
  high: *solid
interfaces:
  low_middle: &touch {kind: contact, friction_coefficient: 0.3}
  middle_high: *touch
supports:
  floor: {kind: fixed, boundary: bottom}
  x: {kind: roller, boundary: x_min, axis: x}
  y: {kind: roller, boundary: y_min, axis: y}
  top: {kind: displacement, boundary: top, z: -0.003 mm, history: [1, -1]}
stages: [{name: press}, {name: part}]
output: {fields: false, report: false}
"""


@pytest.mark.parametrize("linear", support.SOLVERS)
def test_floating_bodies_of_state_left_within_their_gaps_have_a_warning(
    linear: str, tmp_path: Path
) -> None:
    """Solvers leave the body at different places. Only the sum of both gaps has one value."""
    linear = f"solver.linear={linear}"
    numbers = support.run(FLOATING, tmp_path, linear).summary
    gaps = [q["gap_mean"] for q in numbers["interfaces"].values()]
    assert sum(gaps) == pytest.approx(0.003, rel=1e-9)
    said = "nothing holds body 'middle': it is free to move along z in the last state. Its position"
    assert [v["what"].startswith(said) for v in numbers["verdicts"] if v["where"] == "contact"] == [
        False,
        True,
    ]


@pytest.mark.parametrize(
    "change",
    [
        "supports.top.history=[-1, 1]",  # it is pressed again
        "supports.middle={kind: foundation, boundary: middle_x_min, stiffness: 1 MPa/mm}",
        "interfaces.low_middle={kind: bonded}",
        "interfaces.low_middle={kind: cohesive, friction_coefficient: 0, stiffness: 1e3 MPa/mm,"
        " tensile_strength: 9 MPa, shear_strength: 9 MPa, tensile_energy: 1 N/mm,"
        " shear_energy: 1 N/mm}",
        "supports.top.history=[1, 0]",  # nothing has moved away
    ],
)
def test_floating_bodies_of_state_held_within_their_gaps_have_no_warning(
    change: str, tmp_path: Path
) -> None:
    numbers = support.run(FLOATING, tmp_path, change).summary
    assert not [v for v in numbers["verdicts"] if "arbitrary" in v["what"]]


# Bodies that only the facets of a mesh hold

SMALL_STEM = (support.CONFIGS / "stress" / "stem.yaml").read_text(encoding="utf-8")
SMOOTH_SURFACES = tuple(
    f"interfaces.{name}.friction_coefficient=0" for name in ("stem_cement", "cement_bone")
)
TWIST = (
    "loads.lateral={kind: force, boundary: stem_top, force: [0 N, 10 N, 0 N], "
    "at: [100 mm, 0 mm, 24 mm]}"
)


def moved(*overrides: str) -> float:
    """Largest jump at the end of the first stage [mm]."""
    analysis = support.analysis(support.case(SMALL_STEM, *overrides))
    sizes: list[float] = []

    def note(step: object, trial: object) -> None:
        sizes.append(float(np.abs(trial.jump).max()))  # type: ignore[attr-defined]

    stepper = analysis.load_stepper(note, pytest.fail)
    assert stepper is not None
    stepper.run_stage(0, analysis.scene.stages[0], lambda: None)
    return sizes[-1]


@pytest.mark.parametrize(
    ("overrides", "mode"),
    [((TWIST,), "rotate about z"), (("geometry.taper=0 deg",), "move along z")],
)
def test_floating_bodies_of_state_stem_without_friction_is_free(
    overrides: tuple[str, ...], mode: str
) -> None:
    """The stem can rotate in its taper, and slide out of a straight hole."""
    with pytest.raises(ConvergenceError) as caught:
        moved(*SMOOTH_SURFACES, *overrides)
    assert re.search(rf"nothing holds body 'stem': .* free to {mode}", str(caught.value))


def test_floating_bodies_of_state_held_by_curved_facets_alone_are_named() -> None:
    """Quadratic facets resist the rotation of a smooth stem."""
    with pytest.raises(ConvergenceError) as caught:
        moved(*SMOOTH_SURFACES, TWIST, "mesh.order=2")
    message = str(caught.value)
    assert re.search(
        "only the facets of the mesh hold body 'stem': .* free to rotate about z", message
    )


@pytest.mark.parametrize(
    "overrides", [SMOOTH_SURFACES, (TWIST,), (*SMOOTH_SURFACES, "mesh.size=5 mm")]
)
def test_floating_bodies_of_state_are_not_those_held_by_surfaces(
    overrides: tuple[str, ...],
) -> None:
    """A smooth taper holds a stem that is pushed into it; friction holds a rotation."""
    assert moved(*overrides) > 0


@pytest.mark.parametrize("friction", [0, 0.3, 1])
def test_floating_bodies_of_state_stem_without_friction_is_free_for_any_friction_in_bone(
    friction: float,
) -> None:
    """A stem without friction leaves its cement if pushed aside.

    Friction of the cement in the bone does not hold the stem.
    """
    changes = (
        SMOOTH,
        f"interfaces.cement_bone.friction_coefficient={friction}",
        "loads.hip.force=[300 N, 0 N, 0 N]",
    )
    with pytest.raises(ConvergenceError, match=r"nothing holds body 'stem': .* along z, and the "):
        support.solve(support.STEM, *changes)


@pytest.mark.parametrize(("of_zone", "warned"), [(0.1, True), (0.3, False)])
def test_floating_bodies_of_state_slide_at_the_friction_of_zones(
    of_zone: float, warned: bool
) -> None:
    """Friction is a tenth of the pressure: the limit of a zone that covers the interface."""
    zone = f"{{all: {{above: 0 mm, friction_coefficient: {of_zone}}}}}"
    law = f"{{kind: contact, friction_coefficient: 0.5, zones: {zone}}}"
    problem, _ = support.assemble(support.case(ZONED, f"interfaces.lower_upper={law}"))
    contact = problem.contact
    assert contact is not None
    n = len(contact.local)
    contact.state.friction = np.tile([0.1, 0.0, 0.0], (n, 1))
    contact.state.force = np.tile([0.1, 0.0, 1.0], (n, 1))
    warnings = warnings_of_sliding_bodies(problem, contact)
    assert ["'upper'" in warning.what for warning in warnings] == [True] * warned
