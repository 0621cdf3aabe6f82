"""Steps of given fracture energy on whole cases: snap-back, a law of the user."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from app.foundation.errors import InputError, MantleError
from app.results.reading import Run
from app.stepping.energy_control import EnergyControl, start_beyond_onset
from tests import support
from tests.support import CONFIGS

BAR = (CONFIGS / "verification/cohesive_bar.yaml").read_text()
FORCED = """supports:
  base: {kind: fixed, boundary: bottom}
loads:
  up: {kind: force, boundary: top, force: "[0, 0, 0] N"}
stages: [{name: pull, increments: 4}]
"""


def test_energy_control_follows_the_snap_back_of_a_bar(tmp_path: Path) -> None:
    """The end returns by N L/E less the end of softening. Each step takes two iterations."""
    # With condensed bodies a step takes one iteration at least.
    support.run(BAR, tmp_path, "solver.linear=direct")
    run = Run(tmp_path / "out")
    used = np.asarray(run.step_record["lower_upper dissipation [N mm]"])
    softens, newton = (used > 0) & (used < 1.599), np.asarray(run.step_record["newton [-]"])
    assert softens.sum() == 15 and newton[softens].max() <= 2
    # The rest is the load step that failed before, and the jump when all is broken.
    assert run.summary["solver"]["newton_iterations"] < 120
    end = 0.4 * np.asarray(run.step_record["time [-]"])[softens]
    part = used[softens] / 1.6
    jump = 1e-3 + part * (0.02 - 1e-3)
    np.testing.assert_allclose(end, (1 - part) * 10 * 40 / 2000 + jump, rtol=1e-6)


def test_energy_control_with_exponential_softening_and_unbonded_share(tmp_path: Path) -> None:
    """The preceding load step needs little augmentation, which would close an opening."""
    law = ("softening=exponential", "unbonded=30 %")
    support.run(BAR, tmp_path, *(f"interfaces.lower_upper.{change}" for change in law))
    used = np.asarray(Run(tmp_path / "out").step_record["lower_upper dissipation [N mm]"])
    assert used[-1] == pytest.approx(0.7 * 1.6, rel=1e-6)


def test_energy_control_leaves_the_tolerances_of_load_steps() -> None:
    """The linear solver serves both. A tolerance that the case gives is not set again."""
    case = support.case(BAR, "solver.linear=direct", "solver.petsc.ksp_rtol=1e-3")
    problem, solver = support.assemble(case)
    tolerances = solver.snes.getKSP().getTolerances()
    assert tolerances[0] == 1e-3
    fraction = start_beyond_onset(problem, solver, 0.1, (0.0, 1.0), problem.set_time)
    assert fraction is not None
    before = solver.snes.getKSP().getTolerances()
    outcome, _ = EnergyControl(problem, solver, problem.set_time).solve(0.1, fraction)
    assert outcome.converged
    assert solver.snes.getKSP().getTolerances() == before


# The law of the program with linear softening, as a package of the user's.
EXTENSION = '''
from typing import Literal
from ufl import conditional, dot, ge, gt, sqrt
from mantle import Traction
from app.laws.values import FractureEnergyField, StiffnessField, StrengthField


class OwnCohesion(Traction):
    """A bond that softens, without friction."""

    internal_variables = {"damage": (), "spent": (), "used": ()}

    kind: Literal["own_cohesion"] = "own_cohesion"
    stiffness: StiffnessField
    """Traction per displacement."""
    tensile_strength: StrengthField
    """Largest tension."""
    shear_strength: StrengthField
    """Largest shear."""
    tensile_energy: FractureEnergyField
    """Energy in tension."""
    shear_energy: FractureEnergyField
    """Energy in shear."""

    def traction(self, point):
        return (1 - point.internal_variables["damage"]) * self.stiffness * point.gap_vector

    def new_internal_variables(self, point):
        size = dot(point.gap_vector, point.gap_vector)
        some = conditional(gt(size, 1e-30), size, 1e-30)
        opening = dot(point.gap_vector, point.normals[0])
        slid = conditional(gt(size, 1e-30), 1 - opening**2 / some, 0)
        strength = 1 / sqrt((1 - slid) / self.tensile_strength**2 + slid / self.shear_strength**2)
        energy = self.tensile_energy + (self.shear_energy - self.tensile_energy) * slid**2
        onset, end = strength / self.stiffness, 2 * energy / strength
        m = sqrt(conditional(gt(size, onset**2), size, onset**2))
        m = conditional(gt(m, end), end, m)
        damage = end * (m - onset) / (m * (end - onset))
        before = point.internal_variables
        more = ge(damage, before["damage"])
        spent = (m - onset) / (end - onset)
        now = {"damage": damage, "spent": spent}
        now["used"] = before["used"] + energy * (spent - before["spent"])
        return {name: conditional(more, now[name], old) for name, old in before.items()}

    def stored(self, point):
        square = dot(point.gap_vector, point.gap_vector)
        return (1 - point.internal_variables["damage"]) * self.stiffness * square / 2

    def dissipated(self, point):
        return point.internal_variables["used"] - point.committed["used"]
'''


@pytest.mark.parametrize(
    "pull", ["x: 0 mm, y: 0 mm, z: 0.03 mm", "x: 0.03 mm, y: 0 mm, z: 0.01 mm"]
)
def test_energy_control_of_a_law_from_outside(tmp_path: Path, pull: str) -> None:
    """Tension alone and with shear has equal tractions, jumps and energies in every step."""
    text = BAR.replace("4 mm, 20 mm", "4 mm, 4 mm").replace("2 GPa", "20 GPa")
    text = text.replace("x: 0 mm, y: 0 mm, z: 0.4 mm", pull)
    text = text.replace("increments: 10", "increments: 20")
    support.run(text, tmp_path)
    case = text.replace("kind: cohesive\n    friction_coefficient: 0.3", "kind: own_cohesion")
    done = support.extended(tmp_path, EXTENSION, case, "run", "case.yaml", "-o", "outside")
    assert done.returncode == 0, done.stdout + done.stderr
    runs = [Run(tmp_path / name) for name in ("out", "outside")]
    for name in ("gap_max [mm]", "pressure_p95 [MPa]", "shear_p95 [MPa]", "dissipation [N mm]"):
        a, b = (np.asarray(run.step_record[f"lower_upper {name}"]) for run in runs)
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-8)
    used = np.asarray(runs[0].step_record["lower_upper dissipation [N mm]"])
    assert used[-1] > 1.5 and all(run.summary["balance"]["energy"] < 1e-8 for run in runs)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("stiffness=3000 - 600 * x", "stiffness: 600 MPa/mm is too soft for tensile strength"),
        ("unbonded=x", "unbonded: 3.33333 at (3.33333, "),
        ("shear_energy=0.2 - x", "shear_energy: -3.8 at (4, "),
    ],
)
def test_energy_control_refuses_values_at_points(tmp_path: Path, change: str, words: str) -> None:
    with pytest.raises(InputError, match=re.escape(f"interfaces.lower_upper.{words}")):
        support.run(BAR, tmp_path, f"interfaces.lower_upper.{change}")


def test_energy_control_is_advised_beyond_the_peak() -> None:
    """A load above the strength of the bond causes the advice to control the energy.

    The bond bears a load below it.
    """
    text = BAR[: BAR.index("supports:")] + FORCED
    size = [f"geometry.blocks.{k}.size=[4 mm, 4 mm, 2 mm]" for k in (0, 1)]
    strength = 16 * 10.0
    solved = support.solve(text, *size, f"loads.up.force=[0, 0, {0.95 * strength}] N")
    assert solved.interfaces["lower_upper"]["area_broken"] == 0
    with pytest.raises(MantleError, match="`fracture_step` in the stage") as error:
        support.solve(text, *size, f"loads.up.force=[0, 0, {1.05 * strength}] N")
    assert error.value.exit_code == 4
