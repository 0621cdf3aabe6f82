"""Linear solvers: each finds the same equilibrium, or refuses the same case for the same reason."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mantle
from app.case.case import load_case
from app.case.quantities import TABLE
from app.foundation.arrays import Floats
from app.foundation.errors import MantleError
from app.foundation.verdict import Reason
from app.results.reading import Results
from app.verification import suite
from tests import support

# Difference of a number between solvers over the largest number of its unit.
SAME = 1e-6
# Of a run on two ranks that share their cores with other programs [s].
LONGEST = 1200.0
# Slips of nanometres need more than the default tolerance to be the same.
TIGHT = ("solver.tolerance=1e-11",)

# A rigid slope, rising along x, and a heavy block on it that is pushed up.
SLOPE = """\
geometry:
  kind: blocks
  tilt: 9 deg
  blocks:
    - {name: slope, size: [16 mm, 7 mm, 7 mm]}
    - {name: block, size: [16 mm, 7 mm, 7 mm]}
mesh: {size: 2.6 mm, far_size: 2.6 mm, order: 1}
regions:
  slope: {rigid: true, tissue: other}
  block: {youngs_modulus: 210 GPa, poisson_ratio: 0.3, tissue: other}
interfaces:
  slope_block: {kind: contact, friction_coefficient: 0.46}
supports:
  slope: {kind: fixed, boundary: bottom}
  push: {kind: displacement, boundary: top, x: 0.3 mm, y: 0 mm, history: [0, 1]}
loads:
  weight: {kind: body_force, regions: [block], density: "[0, 0, -0.01] N/mm^3"}
stages:
  - {name: rest}
  - {name: push, increments: 2}
"""
WEIGHT = 0.01 * 16 * 7 * 7  # N

# Two arms, clamped at one end, that touch along their length and are pulled apart at the other.
ARMS = """\
geometry:
  kind: blocks
  blocks:
    - {name: lower, size: [50 mm, 1 mm, 2 mm]}
    - {name: upper, size: [50 mm, 1 mm, 2 mm]}
mesh: {size: 1 mm, order: 2}
regions:
  lower: {youngs_modulus: 20 GPa, poisson_ratio: 0, tissue: other}
  upper: {youngs_modulus: 20 GPa, poisson_ratio: 0, tissue: other}
interfaces:
  lower_upper: {kind: contact, friction_coefficient: 0.2}
supports:
  end: {kind: fixed, boundary: x_max}
loads:
  up: {kind: force, boundary: upper_x_min, force: "[0, 0, 0.1] N"}
  down: {kind: force, boundary: lower_x_min, force: "[0, 0, -0.1] N"}
"""

# The remedy by which arms open.
OVERLAP = "closing interfaces where the open bodies overlap"

# A belt over a quarter of a rigid drum: pulled below, held above.
BELT = """\
geometry: {kind: file, path: belt.geo, interfaces: {joint: [drum, belt]}}
mesh: {size: 1 mm, order: 2, curved: true}
regions:
  drum: {rigid: true, tissue: other}
  belt: {youngs_modulus: 10 GPa, poisson_ratio: 0, tissue: other}
interfaces:
  joint: {kind: contact, friction_coefficient: 0}
supports:
  drum: {kind: fixed, boundary: drum_in}
  hold: {kind: roller, boundary: hold, axis: x}
  side: {kind: roller, boundary: both_z, axis: z}
loads:
  pull: {kind: pressure, boundary: pull, pressure: -20 MPa}
"""
BELT_GEO = """\
DefineConstant[ size = 1 ];
n = 40; R = 15; t = 0.2;
Point(1) = {0, 0, 0};
Point(2) = {12, 0, 0}; Point(3) = {0, 12, 0};
Point(4) = {R, 0, 0}; Point(5) = {0, R, 0};
Point(6) = {R + t, 0, 0}; Point(7) = {0, R + t, 0};
Circle(1) = {2, 1, 3}; Circle(2) = {4, 1, 5}; Circle(3) = {6, 1, 7};
Line(4) = {2, 4}; Line(5) = {3, 5}; Line(6) = {4, 6}; Line(7) = {5, 7};
Curve Loop(1) = {4, 2, -5, -1}; Plane Surface(1) = {1};
Curve Loop(2) = {6, 3, -7, -2}; Plane Surface(2) = {2};
Transfinite Curve{1, 2, 3} = n + 1; Transfinite Curve{4, 5} = 3; Transfinite Curve{6, 7} = 2;
Transfinite Surface{1}; Transfinite Surface{2};
a[] = Extrude{0, 0, 1}{ Surface{1}; Layers{1}; };
b[] = Extrude{0, 0, 1}{ Surface{2}; Layers{1}; };
Coherence;
Physical Volume("drum") = {a[1]};
Physical Volume("belt") = {b[1]};
Physical Surface("drum_in") = {a[5]};
Physical Surface("pull") = {b[2]};
Physical Surface("hold") = {a[4], b[4]};
Physical Surface("both_z") = {1, 2};
"""
TENSION = 20 * 0.2 * 1  # N


@pytest.fixture(params=support.SOLVERS)
def linear(request: pytest.FixtureRequest) -> str:
    """Override that asks for one of the solvers."""
    return f"solver.linear={request.param}"


@pytest.mark.parametrize(("degrees", "friction"), [(9, 0.46), (6, 0.3), (12, 0.6)])
def test_solvers_agree_on_a_block_on_a_slope(linear: str, degrees: float, friction: float) -> None:
    """The push is weight (tan a + mu) / (1 - mu tan a). The residual is that of the forces.

    A block that has left the slope and is far away is in balance but for rounding of K u.
    """
    changes = (
        f"geometry.tilt={degrees} deg",
        f"interfaces.slope_block.friction_coefficient={friction}",
    )
    solved = support.solve(SLOPE, *changes, linear)
    slope = math.tan(math.radians(degrees))
    contact = solved.problem.contact
    assert contact is not None
    push, _, lift = (contact.local.weight[:, None] * contact.state.force).sum(axis=0)
    assert abs(lift) == pytest.approx(WEIGHT, rel=1e-9)
    expected = WEIGHT * (slope + friction) / (1 - friction * slope)
    assert abs(push) == pytest.approx(expected, rel=1e-9)
    assert max(step.outcome.residuals[-1] for step in solved.steps) < 1e-9
    assert solved.interfaces["slope_block"]["slip_max"] < 0.35


def test_solvers_agree_on_two_arms(linear: str) -> None:
    """Each arm is a cantilever, so together they open by 8 F L^3 / (E b h^3)."""
    solved = support.solve(ARMS, linear)
    opening = 8 * 0.1 * 50**3 / (20e3 * 1 * 2**3)
    assert solved.interfaces["lower_upper"]["gap_max"] == pytest.approx(opening, rel=0.02)
    assert sum(step.outcome.iterations for step in solved.steps) < 60


# The arms glued beyond half of their length; 1e-11 of a point is broken at the tip of the crack.
GLUE = """\
interfaces.lower_upper={kind: cohesive, friction_coefficient: 0.3, stiffness: 1.0e+5 MPa/mm,
  tensile_strength: 50 MPa, shear_strength: 50 MPa, tensile_energy: 1 N/mm, shear_energy: 1 N/mm,
  unbonded: "min(1, max(0, 1000 * (25 - x)))"}
"""


def test_solvers_agree_on_two_bonded_arms(linear: str) -> None:
    """Arms are open over a length a. A bond that yields clamps them: 8 F (a + c h)^3 / (E b h^3).

    The c is 0.64 for an isotropic beam on its other half.
    """
    solved = support.solve(ARMS, GLUE, linear)
    opening = 8 * 0.1 * (25 + 0.64 * 2) ** 3 / (20e3 * 1 * 2**3)
    numbers = solved.interfaces["lower_upper"]
    assert numbers["gap_max"] == pytest.approx(opening, rel=0.05)
    # Once opened, the arms are linear, so the remedy that opens all interfaces finds the solution.
    assert solved.steps[0].outcome.tried[-1][0] == OVERLAP


@pytest.mark.slow
def test_solvers_agree_on_two_breaking_arms() -> None:
    """The load breaks the bond step by step. Krylov methods do not slow down."""
    law = GLUE.replace("1.0e+5", "1.0e+4").replace(": 50 MPa", ": 20 MPa")
    law = law.replace("energy: 1 N/mm", "energy: 0.25 N/mm").replace("25 - x", "15 - x")
    sizes = "size: [40 mm, 1 mm, 3 mm]"
    changes = (
        law,
        f"geometry.blocks=[{{name: lower, {sizes}}}, {{name: upper, {sizes}}}]",
        *(f"regions.{name}.youngs_modulus=70 GPa" for name in ("lower", "upper")),
        "loads.up.force=[0 N, 0 N, 14 N]",
        "loads.down.force=[0 N, 0 N, -14 N]",
        "stages=[{name: pull, increments: 10, fracture_step: 0.5 N mm}]",
    )
    solved = {s: support.solve(ARMS, *changes, f"solver.linear={s}") for s in support.SOLVERS}
    one = solved["condensed"]
    broken = [int((s.gap > 0.01).sum()) for s in one.samples]
    assert broken[-1] > 1.5 * broken[1]
    for solver, other in solved.items():
        assert [s.time for s in other.steps] == pytest.approx([s.time for s in one.steps], rel=1e-6)
        assert support.difference(one.last.motion, other.last.motion) < 1e-6
        krylov = [
            s.outcome.linear_iterations / s.outcome.iterations
            for s in other.steps
            if s.outcome.iterations and not s.outcome.changes  # of given energy
        ]
        if solver != "condensed":
            assert max(krylov) < 1.5 * min(krylov)


@pytest.mark.parametrize("friction", [0, 0.001, 0.25])
def test_solvers_agree_on_a_belt(
    linear: str, friction: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The force is pull exp(-mu pi / 2). Contact alone holds the belt across its length."""
    monkeypatch.setenv("MANTLE_ALLOW_SCRIPTS", "1")
    (tmp_path / "belt.geo").write_text(BELT_GEO)
    (tmp_path / "case.yaml").write_text(BELT)
    changes = f"interfaces.joint.friction_coefficient={friction}", linear
    solved = support.solve(load_case(tmp_path / "case.yaml", changes).config)
    contact = solved.problem.contact
    assert contact is not None
    # What the drum bears is the hold along x and the pull along y.
    borne = np.abs((contact.local.weight[:, None] * contact.state.force).sum(axis=0))
    hold = TENSION * math.exp(-friction * math.pi / 2)
    assert borne[:2] == pytest.approx([hold, TENSION], rel=0.01)


COLUMNS = """\
geometry: {kind: file, path: columns.geo, interfaces: {joint: [low, high]}}
mesh: {size: 1 mm, order: 2}
regions:
  low: {youngs_modulus: 10 GPa, poisson_ratio: 0, tissue: other}
  high: {youngs_modulus: 10 GPa, poisson_ratio: 0, tissue: other}
interfaces:
  joint: {kind: contact, friction_coefficient: 0.3, gap: "0.03 * max(0, min(1, x - 4))"}
supports:
  floor: {kind: fixed, boundary: bottom}
  first: {kind: displacement, boundary: top_0, x: 0 mm, y: 0 mm, z: -0.01 mm}
  second: {kind: displacement, boundary: top_1, x: 0 mm, y: 0 mm, z: -0.02 mm}
  third: {kind: displacement, boundary: top_2, x: 0 mm, y: 0 mm, z: -0.05 mm}
"""
COLUMNS_GEO = """\
DefineConstant[ size = 1 ];
SetFactory("OpenCASCADE");
For i In {0 : 2}
  Box(1 + i) = {3 * i, 0, 0, 2, 2, 2};
  Box(11 + i) = {3 * i, 0, 2, 2, 2, 3};
EndFor
Coherence;
Mesh.MeshSizeMax = size;
Physical Volume("low") = {1, 2, 3};
Physical Volume("high") = {11, 12, 13};
Physical Surface("bottom") = Surface In BoundingBox {-0.1, -0.1, -0.1, 9, 2.1, 0.1};
"""


def test_solvers_agree_on_separate_columns(
    linear: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each column bears E A / L times the part of the displacement d that its gap leaves.

    The jumps of each column are a branch in the elimination tree of the factors.
    """
    monkeypatch.setenv("MANTLE_ALLOW_SCRIPTS", "1")
    tops = [
        f'Physical Surface("top_{k}") = Surface In BoundingBox '
        f"{{{3 * k - 0.1}, -0.1, 4.9, {3 * k + 2.1}, 2.1, 5.1}};\n"
        for k in range(3)
    ]
    (tmp_path / "columns.geo").write_text(COLUMNS_GEO + "".join(tops))
    (tmp_path / "case.yaml").write_text(COLUMNS)
    solved = support.solve(load_case(tmp_path / "case.yaml", [linear]).config)
    contact = solved.problem.contact
    assert contact is not None
    column = contact.local.x[:, 0] // 3
    pushed = contact.local.weight * contact.state.force[:, 2]
    borne = [abs(pushed[column == k].sum()) for k in range(3)]
    # The gap of the second column is open at its left edge (x = 4) alone.
    assert borne[0] == pytest.approx(10e3 * 4 * 0.01 / 5, rel=1e-6)
    assert borne[2] == pytest.approx(10e3 * 4 * (0.05 - 0.03) / 5, rel=1e-6)
    assert 0 < borne[1] < 10e3 * 4 * 0.02 / 5


# A block that touches another along an edge: friction alone holds it until the wedge has closed.
WEDGE = """\
geometry:
  kind: blocks
  blocks:
    - {name: low, size: [6 mm, 3 mm, 4 mm]}
    - {name: high, size: [6 mm, 3 mm, 4 mm]}
mesh: {size: 1.5 mm, far_size: 1.5 mm, order: 1}
regions:
  low: {youngs_modulus: 4 GPa, poisson_ratio: 0.3, tissue: other}
  high: {youngs_modulus: 3 GPa, poisson_ratio: 0.3, tissue: other}
interfaces:
  low_high: {kind: contact, friction_coefficient: 0.2, gap: "0.0004 * x"}
supports:
  floor: {kind: fixed, boundary: bottom}
loads:
  press: {kind: force, boundary: top, force: "[0, 0, -63] N", at: [3 mm, 1.5 mm, 8 mm]}
"""


@pytest.mark.parametrize("gap", ["0.0004 * x", "0.0003 * (6 - x)", "0.0003 * (x + 1)"])
def test_solvers_agree_on_a_wedge(linear: str, gap: str) -> None:
    """The whole interface bears the force, about its axis."""
    solved = support.solve(WEDGE, f'interfaces.low_high.gap="{gap}"', linear)
    numbers, contact = solved.interfaces["low_high"], solved.problem.contact
    assert contact is not None
    assert numbers["pressure_mean"] == pytest.approx(63 / 18, rel=1e-6)
    assert numbers["open_fraction"] == 0
    pushed = contact.local.weight * contact.state.force[:, 2]
    # Its moments are those of the force, at z = 4 mm of friction's none.
    centre = pushed @ contact.local.x[:, :2] / pushed.sum()
    assert centre == pytest.approx([3, 1.5], abs=2e-3)


# A stiff block on soft springs, some way off a slope, pressed on and pushed along it.
CLEARANCE = """\
geometry:
  kind: blocks
  tilt: {degrees} deg
  blocks:
    - {{name: slope, size: [20 mm, 8 mm, 20 mm]}}
    - {{name: block, size: [20 mm, 8 mm, 20 mm]}}
mesh: {{size: 4 mm, order: 1}}
regions:
  slope: {{youngs_modulus: 2e6 MPa, poisson_ratio: 0, tissue: other}}
  block: {{youngs_modulus: 2e6 MPa, poisson_ratio: 0, tissue: other}}
interfaces:
  slope_block: {{kind: contact, friction_coefficient: 0.3, gap: {gap} mm}}
supports:
  slope: {{kind: fixed, boundary: bottom}}
  springs: {{kind: foundation, boundary: block_x_min, stiffness: "[1e-3, 1e-3, 1e-3] MPa/mm"}}
loads:
  press: {{kind: force, boundary: top, force: "{press} N", history: [1, 1], at: {at}}}
  push: {{kind: force, boundary: top, force: "{push} N", history: [0, 1], at: {at}}}
stages: [{{name: press}}, {{name: push, increments: 2}}]
"""


def clearance(degrees: float, gap: float, share: float, linear: str) -> support.Solved:
    """Solve the block, pushed up the slope by a share of the friction limit."""
    tangent, normal = (
        np.array([math.cos(a), 0.0, math.sin(a)])
        for a in (math.radians(degrees), math.radians(degrees + 90))
    )
    at = [10.0, 4.0, 20.0 + 10 * math.tan(math.radians(degrees))]
    text = CLEARANCE.format(
        degrees=degrees,
        gap=gap,
        press=(-1000 * normal).tolist(),
        push=(share * 300 * tangent).tolist(),
        at=f"[{', '.join(f'{c} mm' for c in at)}]",
    )
    return support.solve(text, linear)


@pytest.mark.parametrize(
    ("degrees", "gap", "share"), [(0, 0.4, 0.9), (20, 0.4, 0.0), (20, 0.2, 0.9), (20, 0.4, -0.9)]
)
def test_solvers_agree_on_a_clearance(
    linear: str, degrees: float, gap: float, share: float
) -> None:
    """The block moves along the normal of the slope until contact, and friction holds it."""
    solved = clearance(degrees, gap, share, linear)
    a = math.radians(degrees)
    _, u = solved.displacement("block")
    way = [gap * math.sin(a), 0, -gap * math.cos(a)]
    assert u.mean(axis=0) == pytest.approx(way, abs=5e-3 * gap)
    force = np.asarray(solved.interfaces["slope_block"]["force"])
    borne = force @ [-math.sin(a), 0, math.cos(a)], abs(force @ [math.cos(a), 0, math.sin(a)])
    assert borne == pytest.approx((1000, abs(share) * 300), rel=1e-2, abs=0.2)


def test_solvers_agree_to_refuse_a_block_on_weak_springs(linear: str) -> None:
    """The push exceeds friction. Springs hold the block 19 mm away, which is not small."""
    with pytest.raises(MantleError) as error:
        clearance(20, 0.4, 1.01, linear)
    assert error.value.exit_code == 4
    assert Reason.within(str(error.value)) == {Reason.LARGE_DISPLACEMENT}


# A stem pushed into soft cement, with an augmentation that is far too large.
PUSHED = (
    "regions.cement.youngs_modulus=110 MPa",
    "interfaces.stem_cement.friction_coefficient=0.05",
    "loads.push.force=[0 N, 0 N, -90 N]",
    "loads.lateral.force=[30 N, 20 N, 0 N]",
    *TIGHT,
)


def test_solvers_agree_on_a_large_augmentation(linear: str) -> None:
    """The augmentation changes no number, once a remedy has made it smaller."""
    stem = support.CONFIGS / "stress" / "stem.yaml"
    usual, large = (
        support.solve(load_case(stem, (*PUSHED, *changes)).config)
        for changes in (("solver.linear=direct",), ("solver.augmentation_factor=200", linear))
    )
    assert support.difference(usual.last.motion, large.last.motion) < 1e-6


# All that is shipped


def _shipped() -> Iterator[Any]:
    """Runs of verify and stress with contact, each once."""
    known: dict[tuple[str, tuple[str, ...]], None] = {}
    for name in ("verify", "stress"):
        for problem in suite.planned(name):
            for run in problem.runs:
                changes = tuple(c for c in run.overrides if not c.startswith("solver.linear"))
                if not run.mesh:
                    known[run.case, changes] = None
    for case, changes in known:
        yield pytest.param(case, changes, id=f"{Path(case).stem} {' '.join(changes)}")


def _numbers(summary: Mapping[str, Any]) -> dict[tuple[str, str], tuple[float, str]]:
    """Numbers of interfaces and regions with their units, without those of rounding."""
    numbers = {}
    for section in ("interfaces", "regions"):
        for name, quantities in summary[section].items():
            for key, value in quantities.items():
                row = TABLE[section].get(key)
                if key == "area":
                    numbers[f"{section}.{name}", key] = value, "mm^2"
                if row and isinstance(value, float) and not key.startswith("penetration"):
                    numbers[f"{section}.{name}", key] = value, row.unit
    return numbers


@dataclass(frozen=True)
class Outcome:
    """Exit code of a run, its numbers with their units, largest of its history by unit, times."""

    code: int
    numbers: Mapping[tuple[str, str], tuple[float, str]] = field(default_factory=dict)
    largest: Mapping[str, float] = field(default_factory=dict)
    times: Floats = field(default_factory=lambda: np.empty(0))

    def took_steps_of(self, other: Outcome) -> bool:
        """Return True if two runs have the same steps."""
        return self.times.shape == other.times.shape and np.allclose(
            self.times, other.times, rtol=1e-9, atol=0
        )

    def undecided(self) -> set[str]:
        """Interfaces that are neither pressed nor open, but for rounding."""
        of = {key: value for key, (value, _) in self.numbers.items()}
        return {
            name
            for name, key in of
            if key == "gap_max" and of[name, key] < 1e-11 and of[name, "pressure_max"] < 1e-6
        }


def _outcome(case: Path, changes: Sequence[str], folder: Path) -> Outcome:
    """Outcome of a run on one rank."""
    try:
        mantle.run(load_case(case, changes), folder)
    except mantle.UnusableError as error:
        return Outcome(error.exit_code, _numbers(support.summary(folder)))
    except mantle.MantleError as error:
        return Outcome(error.exit_code)
    return _solved(folder)


def _outcome_on_ranks(case: Path, changes: Sequence[str], folder: Path) -> Outcome:
    """Outcome of a run on two ranks."""
    words = ("-m", "mantle", "run", case, "-o", folder, *support.sets(*changes))
    code = support.on_ranks(2, *words, code=None, timeout=LONGEST).returncode
    if code:
        there = (folder / "summary.json").is_file()
        return Outcome(code, _numbers(support.summary(folder)) if there else {})
    return _solved(folder)


def _solved(folder: Path) -> Outcome:
    results = Results(folder)
    largest: dict[str, float] = {}
    for name, column in results.step_record.items():
        unit = name.rpartition("[")[2].removesuffix("]")
        values = np.abs(column)
        largest[unit] = max(largest.get(unit, 0.0), float(np.nanmax(values, initial=0.0)))
    numbers, times = _numbers(results.summary), results.step_record["time [-]"]
    return Outcome(0, numbers, largest, times)


@pytest.mark.slow
@pytest.mark.parametrize(("case", "changes"), _shipped())
def test_solvers_agree_on_shipped_cases(
    case: str, changes: tuple[str, ...], tmp_path: Path
) -> None:
    """The exit is the same, and numbers differ by `SAME` of the largest of their unit."""
    path = support.CONFIGS / case
    time = None
    with suppress(mantle.MantleError):
        config = load_case(path, changes).config
        time = config.time
        if not config.interfaces:
            pytest.skip("no interface")
    outcomes = {
        solver: _outcome(path, [*changes, *TIGHT, f"solver.linear={solver}"], tmp_path / solver)
        for solver in support.SOLVERS
    }
    outcomes["two ranks"] = _outcome_on_ranks(path, [*changes, *TIGHT], tmp_path / "two")
    direct = outcomes["direct"]
    assert {o.code for o in outcomes.values()} == {direct.code}, outcomes
    largest = dict(direct.largest)
    for value, unit in direct.numbers.values():
        largest[unit] = max(largest.get(unit, 0.0), abs(value))
    allowed = {unit: SAME * size for unit, size in largest.items()}
    # Motions below 1e-8 um, their works, and stresses below 1 Pa are rounding.
    force = largest.get("MPa", 0.0) * largest.get("mm^2", 0.0)
    for unit, rounding in (("mm", 1e-11), ("N mm", 1e-13 * force), ("MPa", 1e-6)):
        allowed[unit] = max(allowed.get(unit, 0.0), rounding)
    if time and not all(o.took_steps_of(direct) for o in outcomes.values()):
        # Steps follow their errors, which rounding changes: numbers err by those of the steps.
        # These are as large as the tolerance, so that half of it shows half of them.
        halved = f"time.tolerance={time.tolerance / 2} K"
        in_fine_steps = [*changes, *TIGHT, "solver.linear=direct", halved]
        finer = _outcome(path, in_fine_steps, tmp_path / "fine")
        for key, (value, unit) in finer.numbers.items():
            allowed[unit] = max(allowed[unit], 2 * abs(value - direct.numbers[key][0]))
    for solver, outcome in outcomes.items():
        # A run that ends early may have no numbers.
        shared = outcome.numbers.keys() & direct.numbers.keys()
        assert direct.code or shared == direct.numbers.keys() == outcome.numbers.keys()
        off = {
            key: (solver, outcome.numbers[key][0], direct.numbers[key][0])
            for key in shared
            if abs(outcome.numbers[key][0] - direct.numbers[key][0])
            > allowed[direct.numbers[key][1]]
        }
        # Whether a point that bears nothing is open or slips, and works of paths in other steps.
        undecided = direct.undecided() & outcome.undecided()
        off = {
            (name, key): values
            for (name, key), values in off.items()
            if not (name in undecided and key.startswith(("open_", "slip_", "area_slip_")))
            and not (key.endswith("_work") and not outcome.took_steps_of(direct))
        }
        assert not off
