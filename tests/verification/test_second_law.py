r"""Second law (paper eq. 36): friction only dissipates, and contact without tension does no work.

The strong form at every contact point: friction times slip rate is not negative, and the pressure
times the rate of the gap is zero. In load steps the first holds for the implicit sum, the second up
to points that close or open within a step.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from app.campaigns.work_precision import fitted_order
from app.case.mesh_names import ALLOWED
from app.foundation.arrays import Floats
from forms.contact import SLIP
from tests import support
from tests.cases.stems import PEG, PEG_MESH
from tests.support import Solved

# Of the largest increment.
NEGATIVE = -1e-12

LAWS = pytest.mark.parametrize("law", ["contact", "penalty"])

STEM = f"""{support.stem("16 mm", "size: 4 mm, far_size: 5 mm")}
interfaces:
  stem_cement: {{kind: contact, friction_coefficient: 0.4, gap: -2e-3 mm}}
  cement_bone: {{kind: contact, friction_coefficient: 1.0}}
loads:
  push: {{kind: force, boundary: stem_top, force: [0 N, 0 N, -900 N]}}
  x: {{kind: force, boundary: stem_top, force: [300 N, 0 N, 0 N]}}
  y: {{kind: force, boundary: stem_top, force: [0 N, 300 N, 0 N]}}
"""
BLOCKS = """
geometry: {kind: blocks, blocks: [{name: lower, size: [8 mm, 6 mm, 3 mm]},
                                  {name: upper, size: [8 mm, 6 mm, 3 mm]}]}
mesh: {order: 1, size: 1.5 mm, far_size: 2 mm}
regions:
  lower: {youngs_modulus: 1000 MPa, poisson_ratio: 0.3}
  upper: {youngs_modulus: 500 MPa, poisson_ratio: 0.4}
interfaces:
  lower_upper: {kind: contact, friction_coefficient: 0.3}
supports:
  floor: {kind: fixed, boundary: bottom}
"""
DRAGGED = f"""{BLOCKS}
  push: {{kind: displacement, boundary: top, z: -0.03 mm}}
  x: {{kind: displacement, boundary: top, x: 0.03 mm}}
  y: {{kind: displacement, boundary: top, y: 0.03 mm}}
"""


def by(law: str, *interfaces: str) -> list[str]:
    """Overrides that give interfaces a law."""
    keys = ("kind=penalty", "penalty=600 MPa/mm") if law == "penalty" else ()
    return [f"interfaces.{name}.{key}" for name in interfaces for key in keys]


def random_path(moved: str, interface: str, seed: int, stages: int = 4) -> list[str]:
    """Random amplitudes at the ends of stages, each in two or three increments, as overrides.

    They are those of three loads or supports, ``moved``, and of the gap of an interface.
    """
    rng = np.random.default_rng(seed)

    def amplitudes(low: float) -> list[float]:
        return [round(float(a), 3) for a in rng.uniform(low, 1, stages)]

    listed = [f"{{name: s{k}, increments: {rng.integers(2, 4)}}}" for k in range(stages)]
    lowest = {"push": 0.2, "x": -1.0, "y": -1.0}
    return [
        f"stages=[{', '.join(listed)}]",
        *(f"{moved}.{name}.history={amplitudes(low)}" for name, low in lowest.items()),
        f"interfaces.{interface}.gap_history={amplitudes(0.5)}",
    ]


def increments(solved: Solved, what: str) -> Floats:
    """Increments of a sum of each point in each step (steps, n)."""
    return np.diff([getattr(s, what) for s in solved.samples], axis=0, prepend=0)


def assert_never_negative(solved: Solved) -> None:
    """Every increment of the dissipation, as measured here and as reported, is positive or zero."""
    dissipated = increments(solved, "dissipation")
    assert dissipated.min() >= NEGATIVE * dissipated.max()
    for q in solved.interfaces.values():
        assert 0 >= q["dissipation_min"] >= NEGATIVE * dissipated.max()
        assert q["dissipation"] > 0
    slips = [s.weight[s.status == SLIP].sum() / s.weight.sum() for s in solved.samples]
    assert np.mean(slips) > 0.05, slips


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
@LAWS
@pytest.mark.parametrize(
    ("text", "moved", "interfaces"),
    [
        pytest.param(STEM, "loads", ["stem_cement", "cement_bone"], id="stem"),
        pytest.param(DRAGGED, "supports", ["lower_upper"], id="blocks"),
    ],
)
def test_second_law_friction_dissipates_in_every_step(
    text: str, moved: str, interfaces: list[str], law: str, seed: int
) -> None:
    """Random loads reverse, and gaps change on the way."""
    path = [*by(law, *interfaces), *random_path(moved, interfaces[0], seed)]
    if text is DRAGGED:
        path.append("interfaces.lower_upper.gap=2e-3 * x")
    solved = support.solve(text, *path, balances=True)
    assert_never_negative(solved)
    assert solved.balances.max() < 1e-8
    if law == "penalty":
        return
    # Friction times slip, from forces and jumps alone: the points have one face each.
    j = solved.problem.contact
    assert (j.points.faces[~j.points.is_prescribed.any(axis=1)] == 1).all()
    normals = j.points.normals[:, 0]

    def tangential(v: Floats) -> Floats:
        return v - np.einsum("sni,ni->sn", v, normals)[:, :, None] * normals

    friction = tangential(np.array([-s.force for s in solved.samples]))
    slip = tangential(increments(solved, "motion"))
    expected = solved.last.weight * np.einsum("sni,sni->sn", friction, slip)
    assert np.abs(increments(solved, "dissipation") - expected).max() < 1e-9 * expected.max()


@LAWS
def test_second_law_edges_and_corners_dissipate(
    law: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(ALLOWED, "1")
    (tmp_path / "peg.geo").write_text(PEG_MESH)
    sides = "interfaces: {peg_socket: [socket, peg]}"
    geometry = f"geometry={{kind: file, path: {tmp_path / 'peg.geo'}, {sides}}}"
    path = [geometry, *by(law, "peg_socket"), *random_path("loads", "peg_socket", seed=3)]
    solved = support.solve(PEG, *path, balances=True)
    assert (np.bincount(solved.problem.contact.points.faces)[1:] > 3).all()
    assert_never_negative(solved)
    assert solved.balances.max() < 1e-8


# A block pressed on another and slid along it and back, further than the two can shear.
SLIDE = f"""{BLOCKS}
  behind: {{kind: displacement, boundary: upper_x_min, x: 1 mm}}
  before: {{kind: displacement, boundary: upper_x_max, x: 1 mm}}
loads:
  press: {{kind: pressure, boundary: top, pressure: 2 MPa}}
"""


def slid(law: str, way: list[float], increments: list[int], *overrides: str) -> Solved:
    """The block after sliding to some places, one in each stage."""
    stages = ", ".join(f"{{name: s{k}, increments: {n}}}" for k, n in enumerate(increments))
    return support.solve(
        SLIDE,
        *by(law, "lower_upper"),
        *(f"supports.{name}.history={way}" for name in ("behind", "before")),
        f"loads.press.history={[1] * len(way)}",
        f"stages=[{stages}]",
        *overrides,
    )


@LAWS
def test_second_law_full_slip_dissipates_friction_times_slip(law: str) -> None:
    """Steady sliding over a path s, there and back, dissipates μ p A s each time.

    Friction turns along the path, exponentially, only once the block slides.
    """
    slide = [0, 0.1, 0.16, 0.06, -0.01]
    solved = slid(law, slide, [1, 3, 3, 3, 3])
    total = dict(zip([s.time for s in solved.steps], solved.samples, strict=True))
    for start, end in ((2, 3), (4, 5)):
        assert (total[end].status == SLIP).all()
        dissipated = total[end].dissipation.sum() - total[start].dissipation.sum()
        way = abs(slide[end - 1] - slide[start - 1])
        assert dissipated == pytest.approx(0.3 * 2 * 48 * way, rel=1e-4)


# A block pressed on another, then tilted to one side and to the other: contact opens and closes.
TILT = f"""{BLOCKS}
loads:
  press: {{kind: force, boundary: top, force: [0 N, 0 N, -150 N], history: [1, 1, 1]}}
  tilt:
    {{kind: force, boundary: top, force: [30 N, 0 N, 0 N], at: [4 mm, 3 mm, 18 mm],
     history: [0, 1, -1]}}
"""


def test_second_law_contact_work_vanishes_with_small_steps() -> None:
    r"""First order is required; the computed order is two.

    A point that closes or opens within a step contributes a pressure times a gap. Both are of the
    first order in the step. Each point does so a fixed number of times.
    """
    numbers = [2, 4, 8, 16]
    sums, tagged = [], None
    for n in numbers:
        stages = f"[{{name: a}}, {{name: b, increments: {n}}}, {{name: c, increments: {n}}}]"
        solved = support.solve(TILT, f"stages={stages}", tagged=tagged)
        tagged = solved.tagged
        work = increments(solved, "contact_work")
        # Of either sign: closing takes work, opening gives it.
        sums.append(float(np.abs(work).sum()))
        reported = solved.interfaces["lower_upper"]["contact_work"]
        assert reported == pytest.approx(work.sum(), rel=1e-12)
    order = fitted_order([1 / n for n in numbers], sums)
    assert order == pytest.approx(2, abs=0.3), sums
    assert max(a / b for a, b in zip(sums[1:], sums, strict=False)) < 0.5


def test_second_law_interference_work_is_not_contact_work() -> None:
    """A press fit stores energy through the jump. All of it is work against the changing gap."""
    solved = support.solve(
        STEM,
        "loads={}",
        "interfaces.stem_cement.gap_history=[0.5, 1]",
        "stages=[{name: a}, {name: b}]",
        balances=True,
    )
    j = solved.problem.contact
    assert solved.balances.max() < 1e-8
    work = abs(float(j.state.work.sum()))
    assert work > 1e-3
    assert np.abs(j.state.contact_work).sum() < 1e-10 * work


# A bar pressed against a rigid wall.
BAR = """
geometry: {kind: blocks, blocks: [{name: wall, size: [2 mm, 2 mm, 2 mm]},
                                  {name: bar, size: [2 mm, 2 mm, 10 mm]}]}
mesh: {order: 1, size: 1 mm, far_size: 2 mm}
regions:
  wall: {rigid: true}
  bar: {youngs_modulus: 2200 MPa, poisson_ratio: 0}
interfaces:
  wall_bar: {kind: penalty, penalty: 1000 MPa/mm, friction_coefficient: 0.3}
supports:
  wall: {kind: fixed, boundary: bottom}
  end: {kind: displacement, boundary: top, x: 0 mm, y: 0 mm, z: -0.01 mm}
solver: {tolerance: 1.0e-13}
"""


def test_second_law_contact_work_of_a_penalty_is_its_energy() -> None:
    """A bar presses against a wall with a penalty.

    The energy is r/2 g^2 A with g = K u / (K + r), and zero after the return.
    """
    K, u, r, A = 220.0, 0.01, 1e3, 4.0
    energies = [
        support.solve(
            BAR,
            f"supports.end.history={history}",
            f"stages={[{'name': f's{k}', 'increments': 2} for k in range(len(history))]}",
        ).interfaces["wall_bar"]["contact_work"]
        for history in ([1], [1, 0])
    ]
    stored = r / 2 * (K * u / (K + r)) ** 2 * A
    assert energies[0] == pytest.approx(stored, rel=1e-8)
    assert abs(energies[1]) < 1e-9 * stored
